"""Physical effects that a nominal model may lack, one file each."""
