"""What no effect of the catalogue explains: a residual force over its coordinates."""
