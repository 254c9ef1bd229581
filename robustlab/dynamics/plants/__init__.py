"""Built-in linear plants."""
