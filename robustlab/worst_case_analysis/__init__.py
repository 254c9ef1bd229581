"""Sampling of uncertain models and the search for their worst case.

Every result is attained by the returned Delta; none is a proved bound.
"""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "metrics": "METRICS make_metric",
        "sampling": "Responses Samples sample",
        "statistics": "Influence Quantile ViolationProbability clopper_pearson quantile_bounds violation_probability",
        "worst_case_search": "WorstCase worst_case",
    },
)
