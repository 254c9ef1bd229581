"""Model validation: the smallest Delta with which an uncertain model explains a record, with proofs on both sides.

model_validation       `validate`: which domain, which noise
time_domain            sample by sample: constants, systems, both
  sampled_problem      model and record, sampled and in units of the noise
  time_varying         systems that vary with time: cone programmes, multipliers checked by a sweep
  constant_parameters  constants: descent
frequency_domain       line by line: cone programmes from above, multipliers from below
  spectral_problem     model and data at the lines, `FrequencyData`
cone_programme         rows, the cones they lie in, and the answer within a budget
validation_result      `Validation`, and what both domains end with
data_cover             the unmodelled dynamics that a plant's records need
"""

from robustlab.identification.validation.model_validation import validate
from robustlab.identification.validation.sampled_problem import NoiseNorm
from robustlab.identification.validation.spectral_problem import FrequencyData
from robustlab.identification.validation.validation_result import BlockSize, Validation

__all__ = ["BlockSize", "FrequencyData", "NoiseNorm", "Validation", "validate"]
