"""Where effects push on a linear plant and where their motion is seen, and the compiled step that runs them."""
