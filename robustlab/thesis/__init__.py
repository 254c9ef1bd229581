"""The thesis: its printed numbers beside ours, its simulated experiments, its figures."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "numbers": "PublishedNumber published_numbers",
        "figures": "case_figure over_time",
    },
)
