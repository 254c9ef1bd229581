"""The thesis: its printed numbers beside ours, its simulated experiments, its figures."""

from robustlab.thesis.numbers import PublishedNumber, published_numbers

__all__ = ["PublishedNumber", "published_numbers"]
