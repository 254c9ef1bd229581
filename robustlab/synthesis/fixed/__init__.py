"""Controllers of a fixed structure or order, for one plant, several, or a whole uncertain set."""
