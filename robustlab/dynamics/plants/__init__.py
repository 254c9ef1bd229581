"""The plants that come with robustlab, one file each."""
