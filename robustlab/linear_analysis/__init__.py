"""Analysis of a linear model: responses, zeros, stability, controllability, matrix equations."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "zeros": "all_left determinant exactly_stable from_the_circle on_axis roots",
        "frequency": "default_grid",
        "matrices": "care dare equilibrating_exponents hamiltonian_riccati lyapunov",
        "structural": "drop_unconnected strong_components",
    },
)
