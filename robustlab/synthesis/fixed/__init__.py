"""Controllers of fixed structure or order, for one plant, several plants, an uncertain set, or goals."""
