"""Questions asked of any system: one function a question, which looks at the kind of system it is given.

A plain model, one with delays, an uncertain or a scheduled one, frequency data, a plant with named effects: each kind's
method stays in its own package, and is imported when a system of that kind comes.
"""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "performance_comparison": "compare_performance",
    },
)
