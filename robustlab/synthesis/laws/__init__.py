"""Controller structures and parameterised controller laws."""
