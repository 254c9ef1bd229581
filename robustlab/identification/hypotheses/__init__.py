"""One hypothesis about what is missing: which effects may be, and their fit to prepared records."""
