"""Measurement against model: how large the gap is, what is missing, what remains, and whether a set explains a record.

Rooms, each importing from those above it only:

response       a linear model's response to a record, whole or in windows with their own starts
record_check   is a record what it is taken for: clock, channels, fitness for naming
comparison     `compare`: how large the gap is, where it lives, what the residual still contains
hypotheses     one hypothesis about what is missing: which effects may be, and their fit to prepared records
experiment     what to measure next: a menu of experiments, and how far apart hypotheses are in each
naming         `discover`: the search over hypotheses, its verdict, and the plant and uncertainty after it
monitoring     `watch`: does a model go on explaining a running log, and what changes where it does not
validation     `validate`: the smallest Delta with which an uncertain model explains a record
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

# What other rooms ask for, beside the functions that `robustlab` itself hands out; name -> module.
_WORDS = {
    "compare": "comparison.comparison",
    "Comparison": "comparison.comparison_result",
    "OutputGap": "comparison.comparison_result",
    "cover": "comparison.envelope",
    "discover": "naming.discovery",
    "Discovery": "naming.discovery_result",
    "watch": "monitoring.watch",
    "Watch": "monitoring.watch",
    "check_record": "record_check.suitability",
    "suitability": "record_check.suitability",
    "join_clocks": "record_check.resampling",
    "validate": "validation.model_validation",
    "Validation": "validation.validation_result",
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.identification.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.identification' has no attribute {name!r}")
