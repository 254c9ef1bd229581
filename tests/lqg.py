"""The H2 design of a plant with quadratic costs and white noises."""

from typing import Any

import numpy as np

import robustlab as rl


def lqg(G: rl.StateSpaceModel, Q: Any, R: Any, W: Any, V: Any) -> Any:
    """Return `rl.h2` of G with costs Q, R and intensities W, V, all positive definite."""
    q, r, w, v = (np.linalg.cholesky(np.asarray(weight, float)) for weight in (Q, R, W, V))
    n, m, p, zero = G.n_states, G.n_inputs, G.n_outputs, np.zeros
    B, C = np.hstack([w, zero((n, p)), G.B]), np.vstack([q.T, zero((m, n)), G.C])
    D = np.block([[zero((n, n + p + m))], [zero((m, n + p)), r.T], [zero((p, n)), v, G.D]])
    return rl.h2(rl.StateSpaceModel(G.A, B, C, D, G.dt), p, m)
