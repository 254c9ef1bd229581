"""Plants under feedback, and the two-layer control of the thesis' machine."""
