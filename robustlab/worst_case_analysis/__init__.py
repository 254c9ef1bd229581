"""Sampling of uncertain models and the search for their worst case.

Whatever this package finds is attained by a Delta that it returns; none of it proves that nothing is worse.
"""

from robustlab.worst_case_analysis.metrics import METRICS, MetricBatch, MetricRequest
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
    "MetricBatch",
    "MetricRequest",
    "Quantile",
    "Responses",
    "Samples",
    "ViolationProbability",
    "WorstCase",
    "clopper_pearson",
    "quantile_bounds",
    "sample",
    "violation_probability",
    "worst_case",
]
