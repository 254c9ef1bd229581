"""Analysis functions that dispatch on the type of system.

The method for each type (model, delays, uncertain, scheduled, frequency data, plant with effects) is in its own package
and is imported on first use.
"""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "performance_comparison": "compare_performance",
    },
)
