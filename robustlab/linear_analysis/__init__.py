"""What is computed of a linear model alone: responses, zeros, stability, controllability, matrix equations."""
