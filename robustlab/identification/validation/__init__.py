"""Model validation: the smallest Delta with which an uncertain model explains a record, with proofs on both sides."""

from robustlab.identification.validation.result import BlockSize, Validation
from robustlab.identification.validation.spectral_problem import FrequencyData
from robustlab.identification.validation.time_domain import validate

__all__ = ["BlockSize", "FrequencyData", "Validation", "validate"]
