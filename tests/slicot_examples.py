"""Models of the examples in SLICOT's documentation (5.0)."""

import numpy as np

import robustlab as rl


def model_of_ab09ad() -> rl.StateSpaceModel:
    """The model of the examples of AB09AD, AB09CD and AB09HD: 7 states, 2 inputs, 3 outputs."""
    A = np.array([
        [-0.04165, 0.0000, 4.9200, -4.9200, 0.0000, 0.0000, 0.0000],
        [-5.2100, -12.500, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000],
        [0.0000, 3.3300, -3.3300, 0.0000, 0.0000, 0.0000, 0.0000],
        [0.5450, 0.0000, 0.0000, 0.0000, -0.5450, 0.0000, 0.0000],
        [0.0000, 0.0000, 0.0000, 4.9200, -0.04165, 0.0000, 4.9200],
        [0.0000, 0.0000, 0.0000, 0.0000, -5.2100, -12.500, 0.0000],
        [0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 3.3300, -3.3300],
    ])  # fmt: skip
    B = np.zeros((7, 2))
    B[1, 0] = B[5, 1] = 12.5
    C = np.zeros((3, 7))
    C[0, 0] = C[1, 3] = C[2, 4] = 1.0
    return rl.StateSpaceModel(A, B, C, np.zeros((3, 2)))
