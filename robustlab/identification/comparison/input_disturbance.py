"""Equivalent disturbance: the random walk at one input or joint with which the model reproduces the record best.

Plotted over the speed, a friction that the model lacks appears as a friction curve with the opposite sign.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array, Indices, Mask
from robustlab.display import Each
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import Port, linear_plant_of, port_model
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.comparison.error_analysis import REST, Bin, Motion, bins, speed_edges
from robustlab.identification.greybox.disturbance_smoother import SmoothedRecord, smooth_disturbance
from robustlab.identification.response.windowed_simulation import LinearResponse, MotionResponse, Windowed, fit_windows
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel

EXPLAINS = 0.5  # share of the squared error that a located disturbance removes at least
TIE = 2.0  # times the best: squared error that remains with another place that is as good
SURE = 3.0  # standard errors from zero, from which a mean is significant
LEAST_NOISE = 1e-7  # of a sensor, as a share of its range
SHORTEST = 8  # samples to estimate the noise of a sensor


@dataclass(frozen=True)
class InputDisturbance(Evidence):
    """Disturbance at a single place with which the model reproduces the record best."""

    place: str  # ``input u``, or ``torque at omega``
    unit: str
    value: Array  # at each sample, (n,)
    std: Array  # its standard deviation, (n,)
    speed: Array | None  # measured speed at each sample, (n,), or None without one
    speed_source: str
    over_speed: tuple[Bin, ...]  # the disturbance over bins of speed
    rms: float
    # mean, forward, backward: over all samples and over those that move in one direction (NaN without any), with
    # standard errors
    mean: float
    mean_std: float
    forward: float
    forward_std: float
    backward: float
    backward_std: float
    shares: Mapping[str, float]  # output -> removed share of its squared windowed error; negative where it grows
    explained_share: float  # the same over all outputs, 0..1, each in multiples of its noise

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("rms", "mean", "mean_std", "forward", "forward_std", "backward", "backward_std"), "*"),
        "shares": Each("outputs", float),
        "explained_share": float,
    }

    @property
    def sure_means(self) -> dict[str, tuple[float, float]]:
        """Return the means, by direction or of all, that differ significantly from zero, with standard errors."""
        ways = {"moving forward": (self.forward, self.forward_std), "backward": (self.backward, self.backward_std)}
        if not np.isfinite([self.forward, self.backward]).any():
            ways = {"over all": (self.mean, self.mean_std)}
        return {way: (mean, std) for way, (mean, std) in ways.items() if abs(mean) > SURE * std}

    def to_json(self) -> dict[str, object]:
        return {key: v for key, v in vars(self).items() if key not in ("value", "std", "speed")}


def located(found: Mapping[str, InputDisturbance]) -> tuple[InputDisturbance, ...]:
    """Return the best disturbances that explain half of the error, and equally good ones; inputs first."""
    left = min((1.0 - d.explained_share for d in found.values()), default=1.0)
    good = [d for d in found.values() if d.explained_share >= EXPLAINS and 1.0 - d.explained_share <= TIE * left]
    return tuple(sorted(good, key=lambda d: (not d.place.startswith("input "), -d.explained_share)))


def input_disturbances(
    plant: Any, response: LinearResponse, error: Array, edges: Indices, motion: Motion
) -> dict[str, InputDisturbance]:
    """Estimate a disturbance at each input (by name) and each joint without a direct input (``torque at omega``).

    ``error``: of the windows between ``edges``, (n, n_y). Empty for a discrete model, a nonuniform time base and too
    few samples.
    """
    model, whole, names = response.response.model, response.whole, response.response.output_names
    if model.is_discrete or not whole.is_uniform or len(whole.t) < SHORTEST:
        return {}
    model = model.select(outputs=names)
    u = np.column_stack([whole.u[name] for name in model.input_names])
    noise = _sensor_noise(whole.y)
    found: dict[str, InputDisturbance] = {}
    for key, place, unit, push in _places(plant, model):
        try:
            smoothed = smooth_disturbance(model, push[:, None], whole.t, u, whole.y, noise)
        except (InputError, NoTrustworthyNumber):  # no output responds to it, or the record is too short
            continue
        left = _remaining(replace(response, pushes=push[:, None]), smoothed.d, error, edges)[0] / whole.weight
        errors = [e / smoothed.noise_std for e in (error, left)]
        found[key] = _disturbance(place, unit, smoothed, 0, motion, names, *errors)
    return found


def joint_disturbances(
    response: MotionResponse, smoothed: SmoothedRecord, error: Array, edges: Indices, motions: Sequence[Motion]
) -> dict[str, InputDisturbance]:
    """Estimate a disturbance at each joint of a nonlinear plant, or at each input of one without joints.

    ``error``: of the windows between ``edges``, (n, n_y). ``motions``: of each joint or input, or a single one.
    """
    plant = response.plant
    joints = [(_force_at(p.name, next(s.unit for s in plant.states if s.name == p.name)), p.unit)
              for p in plant.port_places if p.kind == "joint"]  # fmt: skip
    places = joints or [(f"input {s.name}", s.unit) for s in plant.inputs]
    motions = motions if len(motions) == len(places) else [motions[0]] * len(places)
    left, before = _remaining(response, smoothed.d, error, edges), error * response.whole.weight
    names = [plant.outputs[k].name for k in response.columns]
    return {
        place.removeprefix("input "): _disturbance(place, unit, smoothed, j, motions[j], names, before, left[j])
        for j, (place, unit) in enumerate(places)
    }


def _remaining(model: Windowed, d: Array, error: Array, edges: Indices) -> Array:
    """Return the weighted error with each force of d (n, n_forces), starts refitted: (n_forces, n, n_y)."""
    left, sizes = np.empty((d.shape[1], *error.shape)), np.diff(edges)
    for size in np.unique(sizes):
        for windows in model.responses(edges[:-1][sizes == size], int(size), d):
            at = windows.samples
            for j in range(len(left)):
                left[j][at] = fit_windows(model, windows, error[at] - windows.pushed[..., j]).left
    return left


def _places(plant: Any, model: StateSpaceModel) -> Iterable[tuple[str, str, str, Array]]:
    """Yield key, text, unit and direction of each place, without inputs that have a direct feedthrough."""
    inputs = [k for k in range(model.n_inputs) if not model.D[:, k].any()]
    for k in inputs:
        yield model.input_names[k], f"input {model.input_names[k]}", model.inputs[k].unit, model.B[:, k]
    if not isinstance(plant, (LinearPlant, StateSpaceModel)):
        return
    try:
        ports: Iterable[Port] = port_model(linear_plant_of(plant)).ports.values()
    except (InputError, np.linalg.LinAlgError):
        return
    for port in ports:
        if port.kind != "joint" or port.force.shape != (model.n_states,):
            continue
        if all(np.linalg.matrix_rank(np.stack([port.force, model.B[:, k]])) == 2 for k in inputs):
            text = _force_at(port.name, port.speed_unit)
            yield text, text, port.unit, port.force


def _force_at(joint: str, speed_unit: str) -> str:
    return f"{'torque' if speed_unit == 'rad/s' else 'force'} at {joint}"


def _disturbance(
    place: str, unit: str, smoothed: SmoothedRecord, j: int, motion: Motion, names: Sequence[str], error: Array,
    left: Array,
) -> InputDisturbance:  # fmt: skip
    """Summarise a disturbance; ``error``, ``left``: without and with it, in multiples of each sensor's noise."""
    d, std, dt = smoothed.d[:, j], smoothed.d_std[:, j], float(smoothed.t[1] - smoothed.t[0])
    # Samples closer than half a period of the bandwidth are dependent.
    independent = min(1.0, 2.0 * float(smoothed.bandwidth.min()) * dt)

    def mean(chosen: Mask) -> tuple[float, float]:
        n = int(chosen.sum())
        if not n:
            return np.nan, np.nan
        spread = max(float(d[chosen].std()), float(np.sqrt((std[chosen] ** 2).mean())))
        return float(d[chosen].mean()), spread / float(np.sqrt(max(1.0, independent * n)))

    speed = motion.speed
    rest = 0.0 if speed is None else REST * float(np.abs(speed).max())
    none, every = np.zeros(len(d), dtype=bool), np.ones(len(d), dtype=bool)
    ways = [every, none, none] if speed is None else [every, speed > rest, speed < -rest]
    before, after = (error**2).sum(axis=0), (left**2).sum(axis=0)
    shares = np.divide(before - after, before, out=np.zeros_like(before), where=before > 0)
    total = float(before.sum())
    over_speed = () if speed is None else bins(speed, d, speed_edges(speed))
    (m, m_std), (forward, forward_std), (backward, backward_std) = (mean(way) for way in ways)
    return InputDisturbance(
        place, unit, d, std, speed, motion.speed_source, over_speed, float(np.sqrt((d**2).mean())),
        m, m_std, forward, forward_std, backward, backward_std, dict(zip(names, shares.tolist(), strict=True)),
        max(0.0, 1.0 - float(after.sum()) / total) if total else 0.0,
    )  # fmt: skip


def _sensor_noise(y: Array) -> Array:
    """Estimate the noise of each sensor from third differences, whose variance is 20 times that of white noise."""
    spread, level = np.ptp(y, axis=0), np.abs(y).max(axis=0)
    spread = np.where(spread > 0, spread, np.where(level > 0, level, 1.0))
    third = np.median(np.abs(np.diff(y, 3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0)
    return np.maximum(third, LEAST_NOISE * spread)
