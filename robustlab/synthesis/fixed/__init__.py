"""Controllers of fixed structure or order, for one plant, several, an uncertain set, or goals."""
