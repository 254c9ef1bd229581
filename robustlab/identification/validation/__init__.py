"""Model validation: the smallest Delta with which an uncertain model explains a record, with proofs on both sides."""

from robustlab.identification.validation.frequency_domain import FrequencyData
from robustlab.identification.validation.model_validation import validate
from robustlab.identification.validation.validation_result import Validation

__all__ = ["FrequencyData", "Validation", "validate"]
