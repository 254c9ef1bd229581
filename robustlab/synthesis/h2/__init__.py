"""H2 synthesis."""
