"""Uncertain models: sets ``F_u(M, Delta)`` over structured perturbations Delta.

Names are loaded on first use: ``import robustlab.uncertainty`` costs nothing.
"""

from importlib import import_module
from typing import Any

_NAMES = {
    "as_blocks": "blocks", "Block": "blocks", "block_slices": "blocks", "delta_matrix": "blocks",
    "delta_values": "blocks", "structure_size": "blocks",
    "STRUCTURES": "elementwise", "elementwise_cover": "elementwise", "endpoint_residual": "elementwise",
    "FORMS": "unstructured", "coprime_factors": "distances.coprime",
    "four_block": "distances.coprime",
    "error_sizes": "covering.unstructured_cover", "realise_delta": "realised_delta",
    "MatrixPolynomial": "decomposition_tree", "polynomial_lft": "decomposition_tree",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        return getattr(import_module(f"robustlab.uncertainty.{_NAMES[name]}"), name)
    raise AttributeError(f"module 'robustlab.uncertainty' has no attribute {name!r}")
