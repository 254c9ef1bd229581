r"""The gap of a model on two other scales: as an addition to its input, and in multiples of the noise.

An output error grows and is carried on by the model's own dynamics; where it comes from is plainer at the input. The
record is cut into short pieces, and in each a constant :math:`d` is fitted together with the initial state,

.. math:: y(t) \approx y_u(t) + S(t) x_0 + \Big( \int_0^t C e^{A s} B_j ds + D_j \Big) d,

so that the model with the input :math:`u_j + d` reproduces the piece best. Sorted by speed, d shows a friction that
the model lacks as a friction curve (with its sign turned round, in units of the input).

Where a record repeats, the same gap is set against its noise floor: 1 is a model as good as the noise allows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.identification.comparison.localisation import REST, Motion
from robustlab.identification.comparison.noise_floor import Excess, NoiseFloor
from robustlab.identification.response.response import Response, Stretch
from robustlab.identification.response.windowed_simulation import fit_state, weighted_least_squares, window_edges
from robustlab.result import Evidence

__all__ = [
    "InputDisturbance",
    "NoiseGap",
    "input_disturbance",
    "noise_gaps",
    "repeated",
    "sorted_disturbance",
    "windowed_error",
]


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
    speed_source
        The speed it is sorted by, as in `robustlab.identification.comparison.localisation.Motion`.
    """

    seconds: float
    time: Array
    speed: Array | None
    value: Array
    std: Array
    forward: float
    backward: float
    explained_share: float
    speed_source: str = ""


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
    shared = _responses(response, name, t[:length]) if len(t) >= length and whole.is_uniform else None
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
    return sorted_disturbance(t, edges, value, std, 1.0 - after / before if before else 0.0, motion)


def sorted_disturbance(
    t: Array, edges: NDArray[np.int_], value: Array, std: Array, share: float, motion: Motion
) -> InputDisturbance:
    """Additions to an input in pieces between ``edges``, all equally long, sorted by the speed of a motion."""
    length = int(edges[1] - edges[0]) if len(edges) > 1 else 0
    middle = 0.5 * (t[edges[:-1]] + t[edges[1:] - 1])
    seconds = length * float(t[-1] - t[0]) / (len(t) - 1)
    if motion.speed is None or not length:
        return InputDisturbance(seconds, middle, None, value, std, np.nan, np.nan, share)
    pieces = motion.speed[: edges[-1]].reshape(-1, length)
    rest = REST * float(np.abs(motion.speed).max())
    forward, backward = _mean(value, pieces.min(axis=1) > rest), _mean(value, pieces.max(axis=1) < -rest)
    speed = pieces.mean(axis=1)
    return InputDisturbance(seconds, middle, speed, value, std, forward, backward, share, motion.speed_source)


def _responses(response: Response, name: str, t: Array) -> tuple[Array, Array]:
    """Free response, and the response to a unit step of the input."""
    return response.free_response(t), response.step_response(name, t)


def _mean(values: Array, chosen: NDArray[np.bool_]) -> float:
    known = values[chosen & np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


@dataclass(frozen=True)
class NoiseGap(Evidence):
    """Gap of one output in multiples of its noise.

    Attributes
    ----------
    std
        Noise of a single sample of the output, in its unit (`NoiseFloor.std`).
    rms_percent, windowed_rms_percent
        RMS of the free run's and of the windowed error in percent of ``std``: 100 is a model as good as the noise
        allows. None where the repeats are equal to the last bit.
    excess
        `Excess` of the windowed error, with windows at the same phases of every repeat. Its ``noise`` is the floor of
        the windowed error itself: in closed loop it is larger than ``std``, as the noise enters at the input too.
    """

    std: float
    rms_percent: float | None
    windowed_rms_percent: float | None
    excess: Excess


def repeated(floor: NoiseFloor, whole: Stretch, others: Sequence[Stretch]) -> list[Stretch]:
    """The repeats that a floor is of, at equal phases: periods of the record, or the record and the others."""
    if floor.source == "periods":
        starts = floor.first + floor.samples * np.arange(floor.count)
        return [whole.cut(int(a), int(a) + floor.samples) for a in starts]
    return [replace(s.cut(0, floor.samples), weight=whole.weight) for s in (whole, *others)]


def noise_gaps(
    outputs: Sequence[str], errors: Array, floor: NoiseFloor, rms: Mapping[str, tuple[float, float]]
) -> dict[str, NoiseGap]:
    """Gap against the floor for every output.

    Parameters
    ----------
    errors
        Measured minus windowed simulation of every repeat, cut at the same phases, (count, samples, n_y).
    rms
        Output name -> RMS of the free run's error (NaN where there is none) and of the windowed error.
    """
    result: dict[str, NoiseGap] = {}
    for k, name in enumerate(outputs):
        std = floor.std[name]
        free, windowed = (100.0 * value / std if std else None for value in rms[name])
        result[name] = NoiseGap(std, free, windowed, floor.excess(errors[:, :, k]))
    return result


def windowed_error(response: Response, part: Stretch, length: int) -> Array:
    """Measured minus windowed simulation of one repeat, shape (samples, n_y)."""
    edges = window_edges(len(part.t), length)
    free = response.free_response(part.t[: int(np.diff(edges).max())])
    error = np.empty_like(part.y)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        window = part.cut(a, b)
        error[a:b] = window.y - fit_state(response, window, free[: b - a]).y
    return error
