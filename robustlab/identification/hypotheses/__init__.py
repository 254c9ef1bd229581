"""One hypothesis about what is missing: prepared records, admissible effects, the fit, and what it leaves."""
