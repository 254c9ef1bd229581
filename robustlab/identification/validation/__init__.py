"""Model validation: the smallest Delta with which an uncertain model explains a record, with proofs on both sides."""

from robustlab.identification.validation.result import BlockSize, Validation
from robustlab.identification.validation.smallest_delta import validate

__all__ = ["BlockSize", "Validation", "validate"]
