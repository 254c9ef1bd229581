"""Analysis of a linear model: responses, zeros, stability, controllability, matrix equations."""

from importlib import import_module
from typing import Any

_PLACES = {
    "all_left": "exact", "determinant": "exact", "exactly_stable": "exact", "from_the_circle": "exact",
    "normal_rank": "exact", "on_axis": "exact", "roots": "exact", "default_grid": "frequency",
    "equilibrating_exponents": "magnitude", "care": "matrix_equations", "dare": "matrix_equations",
    "hamiltonian_riccati": "matrix_equations", "lyapunov": "matrix_equations", "drop_unconnected": "structural",
    "strong_components": "structural",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
