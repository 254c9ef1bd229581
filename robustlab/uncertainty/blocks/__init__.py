"""The blocks of a structured perturbation Delta, each normalised: ``|delta| <= 1`` or ``sigma_max(Delta_i) <= 1``."""

from robustlab.uncertainty.blocks.base import SAMPLED, Block, ParameterRange, Pattern, Sign
from robustlab.uncertainty.blocks.kinds import (
    ComplexScalar,
    FullBlock,
    RealScalar,
    as_blocks,
    block_slices,
    delta_matrix,
    delta_values,
    structure_size,
)

__all__ = [
    "KINDS",
    "Block",
    "ComplexScalar",
    "FullBlock",
    "ParameterRange",
    "Pattern",
    "RealScalar",
    "SAMPLED",
    "Sign",
    "as_blocks",
    "block_slices",
    "delta_matrix",
    "delta_values",
    "structure_size",
]

# The kinds that files know, by their word there.
KINDS: dict[str, type[Block]] = {k.stored_as: k for k in (RealScalar, ComplexScalar, FullBlock)}
