"""Sampling of uncertain models and the search for their worst case.

Whatever this room finds is attained by a Delta that it returns; none of it proves that nothing is worse.
"""

from robustlab.worst_case_analysis.metrics import METRICS
from robustlab.worst_case_analysis.sampling import Responses, Samples, StreamedResponses, sample
from robustlab.worst_case_analysis.search import WorstCase, worst_case

__all__ = ["METRICS", "Responses", "Samples", "StreamedResponses", "WorstCase", "sample", "worst_case"]
