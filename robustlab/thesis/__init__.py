"""The thesis: comparison with its printed numbers, its simulated experiments, its figures."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(__name__, {"numbers": "PublishedNumber published_numbers", "figures": "case_figure"})
