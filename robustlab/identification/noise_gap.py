"""The gap of a model against the noise floor of a record that repeats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.identification.evidence import Evidence
from robustlab.identification.initial_state import fit_state
from robustlab.identification.noise_floor import Excess, NoiseFloor
from robustlab.identification.response import Response, Stretch
from robustlab.identification.windowed_simulation import window_edges
from robustlab.record import Record

__all__ = ["NoiseGap", "noise_gaps"]

Array = NDArray[np.float64]


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


def noise_gaps(
    response: Response,
    whole: Stretch,
    repeats: tuple[Record, ...],
    floor: NoiseFloor,
    length: int,
    rms: Mapping[str, tuple[float, float]],
) -> dict[str, NoiseGap]:
    """Gap against the floor for every output.

    Parameters
    ----------
    response, whole
        Model and record as `compare` uses them.
    repeats
        The further records, matched with the model, where the floor comes from such.
    floor
        Noise floor of the outputs.
    length
        Samples of a window; it is shortened so that every repeat is cut at the same phases.
    rms
        Output name -> RMS of the free run's error and of the windowed error.
    """
    if floor.source == "periods":
        starts = floor.first + floor.samples * np.arange(floor.count)
        stretches = [whole.cut(int(a), int(a) + floor.samples) for a in starts]
    else:
        stretches = [s.cut(0, floor.samples) for s in (whole, *(response.stretch(r) for r in repeats))]
    errors = np.stack([_windowed_error(response, s, length, whole.weight) for s in stretches])
    result: dict[str, NoiseGap] = {}
    for k, name in enumerate(response.output_names):
        std = floor.std[name]
        free, windowed = (100.0 * value / std if std else None for value in rms[name])
        result[name] = NoiseGap(std, free, windowed, floor.excess(errors[:, :, k]))
    return result


def _windowed_error(response: Response, part: Stretch, length: int, weight: Array) -> Array:
    """Measured minus windowed simulation of one repeat, shape (samples, n_y)."""
    edges = window_edges(len(part.t), length)
    free = response.free_response(part.t[: int(np.diff(edges).max())])
    part = Stretch(part.t, part.u, part.y, weight)
    error = np.empty_like(part.y)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        window = part.cut(a, b)
        error[a:b] = window.y - fit_state(response, window, free[: b - a]).y
    return error
