"""The blocks of a structured perturbation Delta."""
