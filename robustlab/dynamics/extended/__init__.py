"""Plants with effects: linear model, equilibrium, simulation, uncertainty."""
