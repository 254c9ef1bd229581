r"""The error of a model, told as what would have to be added to its input.

An output error grows and is carried on by the model's own dynamics; where it comes from is plainer at the input. The
record is cut into short pieces, and in each a constant :math:`d` is fitted together with the initial state,

.. math:: y(t) \approx y_u(t) + S(t) x_0 + \Big( \int_0^t C e^{A s} B_j ds + D_j \Big) d,

so that the model with the input :math:`u_j + d` reproduces the piece best. Sorted by speed, d shows a friction that
the model lacks as a friction curve (with its sign turned round, in units of the input).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robustlab.identification.evidence import Evidence
from robustlab.identification.initial_state import weighted_least_squares
from robustlab.identification.localisation import REST, Motion
from robustlab.identification.response import Response, Stretch
from robustlab.record import UNIFORM_TOLERANCE

__all__ = ["InputDisturbance", "input_disturbance"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class InputDisturbance(Evidence):
    """Constant addition to one input that reproduces each piece of the record best; arrays have shape (n_pieces,).

    Attributes
    ----------
    seconds
        Length of a piece in s.
    time
        Middle of each piece in s.
    speed
        Mean measured speed over each piece, or None where there is no speed.
    value, std
        The addition d in the unit of the input, and its standard deviation if the error left were white; NaN in
        pieces where the outputs cannot tell d from the initial state.
    forward, backward
        Means of d over the pieces that move throughout in one direction; NaN where there are none.
    explained_share
        Share of the squared error of all pieces (each with its own initial state) that d removes, 0..1.
    """

    seconds: float
    time: Array
    speed: Array | None
    value: Array
    std: Array
    forward: float
    backward: float
    explained_share: float


def input_disturbance(response: Response, name: str, whole: Stretch, length: int, motion: Motion) -> InputDisturbance:
    """Fit an addition to the input ``name`` in every piece of ``length`` samples; a shorter rest is left out.

    Returns
    -------
    InputDisturbance
        With as many pieces as fit.
    """
    t, weight = whole.t, whole.weight
    edges = np.arange(0, len(t) + 1, length)
    value, std = np.full(len(edges) - 1, np.nan), np.full(len(edges) - 1, np.nan)
    before = after = 0.0
    # The responses are the same in all pieces where the clock is uniform.
    step = np.diff(t)
    uniform = len(t) >= length and bool(np.abs(step - step.mean()).max() <= UNIFORM_TOLERANCE * step.mean())
    shared = _responses(response, name, t[:length]) if uniform else None
    for k, (first, last) in enumerate(pairwise(edges.tolist())):
        piece = whole.cut(first, last)
        free, held = shared or _responses(response, name, piece.t)
        error = piece.y - response.simulate(piece.t, piece.u, np.zeros(response.n_states))
        x0, _, rank = weighted_least_squares(free, error, weight)
        both, spread, joint_rank = weighted_least_squares(np.concatenate([free, held], axis=2), error, weight)
        if joint_rank == rank:
            continue
        value[k], std[k] = both[-1], spread[-1]
        before += float((((error - free @ x0) * weight) ** 2).sum())
        after += float((((error - free @ both[:-1] - held @ both[-1:]) * weight) ** 2).sum())
    middle = 0.5 * (t[edges[:-1]] + t[edges[1:] - 1])
    share = 1.0 - after / before if before else 0.0
    seconds = length * float(t[-1] - t[0]) / (len(t) - 1)
    if motion.speed is None:
        return InputDisturbance(seconds, middle, None, value, std, np.nan, np.nan, share)
    pieces = motion.speed[: edges[-1]].reshape(-1, length)
    rest = REST * float(np.abs(motion.speed).max())
    forward, backward = _mean(value, pieces.min(axis=1) > rest), _mean(value, pieces.max(axis=1) < -rest)
    return InputDisturbance(seconds, middle, pieces.mean(axis=1), value, std, forward, backward, share)


def _responses(response: Response, name: str, t: Array) -> tuple[Array, Array]:
    """Free response, and the response to a unit step of the input."""
    return response.free_response(t), response.step_response(name, t)


def _mean(values: Array, chosen: NDArray[np.bool_]) -> float:
    known = values[chosen & np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan
