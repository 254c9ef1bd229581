"""A plant with effects: its linear model, its rest, its simulation, its uncertainty."""
