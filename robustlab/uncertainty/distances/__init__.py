"""Distances between models for feedback, and coprime factors."""
