"""Uncertain models: sets ``F_u(M, Delta)`` over structured perturbations Delta."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "blocks": "as_blocks Block block_slices delta_matrix delta_values structure_size",
        "elementwise": "STRUCTURES elementwise_cover endpoint_residual",
        "unstructured": "FORMS",
        "gap_metric": "coprime_factors four_block",
        "covers": "error_sizes",
        "perturbation_systems": "realise_delta",
    },
)
