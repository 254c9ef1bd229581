"""Physical effects that a nominal model may lack, a class each, in files by where they act."""
