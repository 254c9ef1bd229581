"""Sampling of uncertain models and the search for their worst case.

Every result is attained by the returned Delta; none is a proved bound.
"""

from robustlab.worst_case_analysis.metrics import METRICS, make_metric
from robustlab.worst_case_analysis.sampling import Responses, Samples, sample
from robustlab.worst_case_analysis.statistics import (
    Influence,
    Quantile,
    ViolationProbability,
    clopper_pearson,
    quantile_bounds,
    violation_probability,
)
from robustlab.worst_case_analysis.worst_case_search import WorstCase, worst_case

__all__ = [
    "METRICS",
    "Influence",
    "Quantile",
    "Responses",
    "Samples",
    "ViolationProbability",
    "WorstCase",
    "clopper_pearson",
    "make_metric",
    "quantile_bounds",
    "sample",
    "violation_probability",
    "worst_case",
]
