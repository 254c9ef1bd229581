"""mu of constant matrices: upper bounds with their scalings, lower bounds with their Delta."""
