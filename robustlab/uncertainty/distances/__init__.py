"""Distances between models that count for feedback, and coprime factors."""
