"""Analysis functions that take any type of system; the method of each type is in its own package."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(__name__, {"performance": "compare_performance"})
