"""The aero-engine of Skogestad and Postlethwaite, section 13.3.3: a published two-degree-of-freedom loop shaping.

G5 has 18 states, three inputs and outputs; W1 = I/s times the alignment of the plant at 7 rad/s times diag(1, 2.5,
0.3), the reference model 1/(0.018 s + 1), 1/(0.008 s + 1), 1/(0.2 s + 1), rho = 1. Published in the book's own files:
gamma_min 2.3297 (Sec13_33.m), final gamma 2.9091 (Aero2DOF.m), and the controller (aeroKold.mat). The models come from
those files, in their version that stores plain matrices, and are not kept here:

    python benchmarks/aero_engine.py aero1old.mat aeroKold.mat > benchmarks/results/aero_engine.txt
"""

from __future__ import annotations

import sys

import numpy as np
from scipy.io import loadmat

import robustlab as rl
from robustlab.arrays import Array
from robustlab.statespace import lower_lft
from robustlab.synthesis.hinf.two_degree import two_degree_plant


def model_of(packed: Array) -> rl.StateSpaceModel:
    """``[A B n; C D 0; 0 0 -inf]``."""
    n = int(packed[0, -1])
    A, B, C, D = packed[:n, :n], packed[:n, n:-1], packed[n:-1, :n], packed[n:-1, n:-1]
    return rl.StateSpaceModel(A, B, C, D)


def alignment(response: np.ndarray) -> np.ndarray:
    """The real matrix K for which ``response @ K`` is as near to a diagonal of units as it can be."""
    weight = np.linalg.inv((response.conj().T @ response).real)
    half = np.exp(0.5j * np.angle(np.diag(response @ weight @ response.T)))
    return weight @ (response.conj().T * half).real


def main(engine: str, controller: str) -> None:
    G = model_of(loadmat(engine)["G5"])
    response = rl.frequency_response(G, [7.0])[0] / 7j
    before = rl.StateSpaceModel(
        np.zeros((3, 3)), alignment(response) @ np.diag([1, 2.5, 0.3]), np.eye(3), np.zeros((3, 3))
    )
    rates = np.diag([1 / 0.018, 1 / 0.008, 1 / 0.2])
    wanted = rl.StateSpaceModel(-rates, rates, np.eye(3), np.zeros((3, 3)))
    print(f"condition number of the plant at 7 rad/s {np.linalg.cond(response):.4f}, published 3.77")
    for factor in (1.1, 1.01, 1.0002):
        design = rl.ncf(G, before, reference_model=wanted, rho=1.0, factor=factor)
        print(
            f"factor {factor:6}: gamma {design.gamma:.4f} ({design.status.value}), published 2.9091; "
            f"without references {design.gamma_min:.4f}, published 2.3297"
        )
    stored = {name: model_of(value) for name, value in loadmat(controller).items() if name in ("K", "Gs", "Mo")}
    problem = two_degree_plant(stored["Gs"], stored["Mo"], 1.0, np.eye(3)).model
    norm = rl.peak_gain(lower_lft(problem, stored["K"]))
    print(f"the published controller on the problem posed here: {norm.lower:.4f} .. {norm.upper:.4f}, published 2.9091")


if __name__ == "__main__":
    main(*sys.argv[1:])
