"""The thesis: its printed numbers beside ours, its simulated experiments, its figures."""
