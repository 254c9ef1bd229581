"""Ports of plants for effects, and the compiled stepping with force laws."""
