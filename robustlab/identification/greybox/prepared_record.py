"""A record prepared for effect identification: windows, their initial states, the nominal model's residual force."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from robustlab.arrays import Array, Indices, Mask
from robustlab.dynamics.extended.simulator import SampledInput, Windows, rising
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Course, PortModel, motion_model, port_model
from robustlab.errors import InputError
from robustlab.identification import constants
from robustlab.identification.greybox.disturbance_smoother import (
    SmoothedRecord,
    output_shares,
    resolution_of,
    smooth_disturbance,
)
from robustlab.identification.greybox.motion_smoother import smooth_motion
from robustlab.identification.response.response import longest_period, slowest_time_constant
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel

WINDOWS_WANTED = 12  # in the shortest record: shorter windows drift less and are less sensitive to slow effects
LONGEST_WINDOW = 480  # samples; up to twice that for a slow plant
POINTS_PER_WINDOW = 80  # of averaged errors: more would resolve faster effects and take more time
LONGEST_GUESS = 2  # samples in a row without outputs over which the input counts as held
AVERAGED_SHARE = 0.125  # of the period of the fastest measured motion: longest average of errors
# Standard deviation of an unmeasured current over its value from voltage and speed; with the inflation below a fit may
# change an initial current by 0.3 of that value.
CURRENT_SHARE = 0.01
# Prior standard deviation of a window's initial state over that of the smoother, which has used the window itself.
START_INFLATION = 30.0
MOST_GROWTH = 20.0  # of the deviation of an unstable nonlinear plant over a window
POINTS = 60  # of a motion at which ports are computed
CONTENT = 0.99  # share of an output's power that determines its highest frequency


@dataclass(frozen=True, eq=False)
class PreparedRecord:
    """One record, cut into windows."""

    record: Record  # on a uniform time base
    # u, y: inputs (n, n_u) and outputs (n, n_measured); NaN without a valid sample
    u: Array
    y: Array
    columns: tuple[int, ...]  # index of each measured output among the plant's outputs
    windows: Windows  # in order of time, without gaps of more than LONGEST_GUESS samples
    # x0, x0_std: smoothed states at the window starts and their prior standard deviations, (n_windows, n_x)
    x0: Array
    x0_std: Array
    smoothed: SmoothedRecord
    # state_shares: part of each measured output in the smoothed states, linear in the record: (n_measured, n, n_x);
    # constant: that of one unit more of each output at all samples
    state_shares: Array
    constant: Array
    push: Array  # directions of the unknown forces, (n_x, n_forces)
    thin: int  # samples averaged into one point of the error
    resolution: Array  # smallest step of each measured output, (n_measured,); 0 where it has none
    motion: Array | None = None  # states (n, n_x) about which a nonlinear plant is linear
    begun: float = 0.0  # offset of its time in s for effects over time (`in_phase`)

    @property
    def count(self) -> int:
        return len(self.windows.starts)

    @property
    def samples(self) -> Indices:
        """Return the samples of the windows, (n_windows, length)."""
        return self.windows.starts[:, None] + np.arange(self.windows.length)

    @cached_property
    def measured(self) -> Array:
        """Return measured outputs in the windows, (n_windows, length, n_measured)."""
        return self.y[self.samples]

    @property
    def sensor_noise(self) -> Array:
        """Return the standard deviation of each measured output's noise or resolution in an averaged error."""
        return np.maximum(self.smoothed.noise_std, self.resolution / np.sqrt(12.0)) / np.sqrt(self.thin)

    def starts_seen(
        self, lag: float, shown: Mapping[int, float], biased: Mapping[int, float] = {}, late: Mapping[int, float] = {}
    ) -> Array:
        """Return states at the window starts, (n_windows, n_x), corrected for late, scaled or biased sensors."""
        # lag: delay of all sensors in s; shown, biased, late: gain, bias and delay by index of an output of the plant.
        x0 = self._at(self.smoothed.x, lag) if lag else self.x0.copy()
        for j, share, unit in self._corrections(shown, biased):
            x0 += share * self._at(self.state_shares[j], lag) - unit * self._at(self.constant[j], lag)
        for j, column in enumerate(self.columns):
            if column in late:
                x0 += self._at(self.state_shares[j], late[column]) - self.state_shares[j][self.windows.starts]
        return x0

    def motion_seen(
        self, shown: Mapping[int, float], biased: Mapping[int, float], late: Mapping[int, float]
    ) -> Array | None:
        """Return the motion of a nonlinear plant, (n, n_x), corrected for scaled, biased or late sensors."""
        if self.motion is None or not (shown or biased or late):
            return self.motion
        x = self.motion.copy()
        for j, share, unit in self._corrections(shown, biased):
            x += share * self.state_shares[j] - unit * self.constant[j]
        clock = np.arange(len(x), dtype=float)
        for j, column in enumerate(self.columns):
            for k in np.flatnonzero(self.state_shares[j].any(axis=0)) if column in late else ():
                part = self.state_shares[j][:, k]
                x[:, k] += np.interp(clock + late[column] / self.record.dt, clock, part) - part
        return x

    def _corrections(self, shown: Mapping[int, float], biased: Mapping[int, float]) -> list[tuple[int, float, float]]:
        """Return output index, factor of its part and factor of its constant for each scaled or biased output."""
        found = []
        for j, column in enumerate(self.columns):
            gain, bias = shown.get(column, 1.0), biased.get(column, 0.0)
            if gain != 1.0 or bias:
                found.append((j, 1.0 / gain - 1.0, bias / gain))
        return found

    def _at(self, x: Array, lag: float) -> Array:
        """Interpolate x (n, n_x) at ``lag`` seconds after the window starts."""
        at = np.minimum(self.windows.starts + lag / self.record.dt, len(x) - 1.001)
        k = at.astype(int)
        part = (at - k)[:, None]
        return (1.0 - part) * x[k] + part * x[k + 1]


def ports_of(plant: AnyPlant, record: Record) -> PortModel:
    """Return matrices and ports of a plant; of a nonlinear one about some points of the record's motion."""
    if isinstance(plant, LinearPlant):
        return port_model(plant)
    u, y, columns = _signals(plant, record)
    x = smooth_motion(plant, record.t, u, y, columns)[0].x
    points = np.unique(np.linspace(0, record.n - 2, POINTS).astype(np.int64))
    return motion_model(Course(plant, x, u, record.dt), {}, points, 1, 1).model


def window_length(plant: AnyPlant, records: Sequence[Record], model: PortModel | None = None) -> int:
    """Return the samples of a window: a twelfth of the shortest record, or more for a slow plant."""
    # At least the slowest time constant and two periods of the slowest resonance, if four windows fit. For a nonlinear
    # plant the fastest instability grows at most MOST_GROWTH times over a window.
    n, dt = min(r.n for r in records), records[0].dt
    length = min(max(20 * n // (20 * WINDOWS_WANTED + 1), constants.SHORTEST_WINDOW), LONGEST_WINDOW)
    if isinstance(plant, LinearPlant):
        linear = plant.state_space()
        slowest = min(round(slowest_time_constant(linear) / dt), 2 * LONGEST_WINDOW)
        return min(max(length, slowest, round(2.0 * longest_period(linear) / dt)), n // constants.FEWEST_WINDOWS)
    about = ports_of(plant, records[0]) if model is None else model
    growth = float(np.linalg.eigvals(about.A).real.max(initial=0.0))
    stable = math.log(MOST_GROWTH) / (growth * dt) if growth > 0.0 else math.inf
    return int(min(length, max(stable, constants.SHORTEST_WINDOW / 2), n // constants.FEWEST_WINDOWS))


def prepare(
    plant: AnyPlant, model: PortModel, record: Record, length: int, valid: dict[str, Mask] | None = None,
    outputs: Collection[str] = (),
) -> PreparedRecord:  # fmt: skip
    """Cut a uniform record into windows of ``length`` samples and smooth it."""
    # valid: output -> mask of the measured samples; outputs: those to use, by default the record's.
    names = [s.name for s in plant.outputs]
    u, y, columns = _signals(plant, record, outputs)
    own = [j for j, k in enumerate(columns) if names[k] in record.outputs]
    resolution = np.array([resolution_of(column) if j in own else 0.0 for j, column in enumerate(y.T)])
    for j, k in enumerate(columns):
        if valid is not None and names[k] in valid:
            y[~valid[names[k]], j] = np.nan
    where, fewest = f"discover {record.name}", constants.FEWEST_WINDOWS
    if record.n // length < fewest:
        raise InputError(where, f"{record.n} samples", f"at least {fewest * length} ({fewest} windows)")
    joints = [p for p in model.ports.values() if p.kind == "joint"]
    push = np.stack([p.force for p in joints], axis=-1) if joints else model.B[..., : len(plant.inputs)]
    push = push.reshape(-1, *push.shape[-2:]).mean(axis=0)
    smoothed, parts, constant = _states(plant, record, u, y, columns, own, push)
    measured = np.isfinite(y[:, own])
    known, starts = np.asarray(measured.all(axis=1)), list[int]()
    # Remaining samples are skipped at the beginning, where a plant with a delay responds to the time before.
    for a, b in _between_gaps(~np.asarray(measured.any(axis=1))):
        starts += range(a + min((b - a) % length, length // 20), b - length + 1, length)
    usable = [s for s in starts if known[s : s + length].mean() > 0.5]
    if len(usable) < fewest:
        text, hint = f"{len(usable)} windows of {length} samples without gaps", "shorter windows, or fewer gaps"
        raise InputError(where, text, f"at least {fewest}", hint)
    windows = Windows(np.array(usable, dtype=np.int64), length)
    if isinstance(plant, LinearPlant):
        seen = plant.state_space().select(None, [names[columns[j]] for j in own]).C
        smoothed = _with_plausible_currents(smoothed, model, seen, u)
    std = START_INFLATION * smoothed.x_std[windows.starts]
    fastest = _fastest_seen(model, y[:, own], record.dt, smoothed.noise_std[own])
    thin = max(1, min(length // POINTS_PER_WINDOW, int(AVERAGED_SHARE * fastest)))
    return PreparedRecord(
        record, u, y, columns, windows, smoothed.x[windows.starts].copy(), std, smoothed, parts, constant, push, thin,
        resolution, None if isinstance(plant, LinearPlant) else smoothed.x,
    )  # fmt: skip


def _signals(plant: AnyPlant, record: Record, outputs: Collection[str] = ()) -> tuple[Array, Array, tuple[int, ...]]:
    """Return inputs (n, n_u), measured outputs (n, n_measured) and the index of each among the plant's outputs."""
    where, names = f"discover {record.name}", [s.name for s in plant.outputs]
    for signal in plant.inputs:
        if signal.name not in record.inputs:
            raise InputError(where, f"no input {signal.name!r}", f"all inputs of {plant.name}")
    columns = tuple(k for k, name in enumerate(names) if name in (outputs or record.outputs))
    if not any(names[k] in record.outputs for k in columns):
        raise InputError(where, f"outputs {', '.join(record.outputs)}", f"at least one of {', '.join(names)}")
    u = np.column_stack([record.inputs[s.name] for s in plant.inputs])
    y = np.column_stack([record.outputs.get(names[k], np.full(record.n, np.nan)) for k in columns])
    return u, y, columns


def _states(
    plant: AnyPlant, record: Record, u: Array, y: Array, columns: tuple[int, ...], own: list[int],
    push: Array,
) -> tuple[SmoothedRecord, Array, Array]:  # fmt: skip
    """Return the smoothed record, and the part and constant of each measured output (`PreparedRecord`)."""
    seen = y[:, own]
    if isinstance(plant, LinearPlant):
        bare = plant.state_space().select(None, [plant.outputs[columns[j]].name for j in own])
        smoothed, driven, inputs = _smoothed(bare, push, record.t, u, seen)
        shares = output_shares(driven, push, record.t, inputs, seen, smoothed)
    else:
        smoothed, *shares = smooth_motion(plant, record.t, u, seen, [columns[j] for j in own])
    parts, constant, noise_std = *np.zeros((2, len(columns), *smoothed.x.shape)), np.zeros(len(columns))
    parts[own], constant[own] = shares
    noise_std[own] = smoothed.noise_std
    return replace(smoothed, noise_std=noise_std), parts, constant


def alike(prepared: Sequence[PreparedRecord]) -> list[PreparedRecord]:
    """Average the errors of all records over equally many samples, for one noise model."""
    thin = min(r.thin for r in prepared)
    return [replace(r, thin=thin) for r in prepared]


def averaged(error: Array, thin: int) -> Array:
    """Return means over ``thin`` samples, (n_windows, n_points, n_y); NaN without samples."""
    # Without the first twentieth of a window, in which a late sensor measures the time before the window.
    error = error[:, error.shape[1] // 20 :]
    count, length, n_y = error.shape
    points = length // thin
    blocks = error[:, : points * thin].reshape(count, points, thin, n_y)
    known = np.isfinite(blocks)
    if known.all():
        return blocks.mean(axis=2)
    number = known.sum(axis=2)
    total = np.where(known, blocks, 0.0).sum(axis=2)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _with_plausible_currents(smoothed: SmoothedRecord, model: PortModel, seen: Array, u: Array) -> SmoothedRecord:
    """Replace unmeasured currents by their values from voltage and speed."""
    # (u - K omega) / R, with a share of its size as deviation: effects may delay or change the voltage.
    x, std = smoothed.x.copy(), smoothed.x_std.copy()
    for port in model.ports.values():
        if port.kind != "current" or seen[:, port.velocity != 0.0].any():
            continue
        k = int(np.argmax(np.abs(port.velocity)))
        rate = model.A[k, k]
        steady = x[:, k] - (x @ model.A[k] + u @ model.B[k]) / rate if rate < 0 else np.zeros(len(x))
        own = CURRENT_SHARE * (float(np.abs(steady).max()) or float(np.ptp(x[:, k])))
        x[:, k] = np.where(std[:, k] > own, steady, x[:, k])
        std[:, k] = own
    return replace(smoothed, x=x, x_std=std)


def _fastest_seen(model: PortModel, y: Array, dt: float, noise_std: Array) -> float:
    """Return the period in samples of the fastest measured motion: of a resonance of the plant, or of the outputs."""
    poles = np.linalg.eigvals(model.A).reshape(-1, model.A.shape[-1])[0]
    swings = np.abs(poles.imag[np.abs(poles.imag) > np.abs(poles.real)])
    periods = [p for p in 2.0 * np.pi / (swings * dt) if p > 2.0]
    window = np.hanning(len(y))
    for column, noise in zip(y.T, noise_std, strict=True):
        at = np.arange(len(column))
        known = np.isfinite(column)
        filled = np.interp(at, at[known], column[known])
        rest = filled - np.polyval(np.polyfit(at, filled, 1), at)
        power = np.maximum(np.abs(np.fft.rfft(window * rest)) ** 2 - float(window @ window) * noise**2, 0.0)
        if power.any():
            last = int(np.searchsorted(np.cumsum(power), CONTENT * power.sum()))
            periods.append(len(column) / max(last, 1))
    return min(periods, default=float(len(y)))


def _smoothed(
    bare: StateSpaceModel, push: Array, t: Array, u: Array, y: Array
) -> tuple[SmoothedRecord, StateSpaceModel, Array]:
    """Smooth with inputs that are held or, if more probable, smooth between their samples."""
    # A smooth input enters by its means over the samples, and by its rises in further columns. Always held: dry
    # friction of an axis came with a ripple that is not there (characterisation, "axis, dry friction").
    halves = np.stack([SampledInput(column, "smooth").steps(1) for column in u.T])  # (n_u, n, 2)
    inputs = np.vstack([halves.mean(axis=2), halves[:, :, 1] - halves[:, :, 0]]).T
    b, d = np.hstack([bare.B, rising(bare.A, bare.B, float(t[1] - t[0]))]), np.hstack([bare.D, -bare.D])
    kinds = [(bare, u), (StateSpaceModel(bare.A, b, bare.C, d), inputs)]
    found = [(smooth_disturbance(model, push, t, seen, y), model, seen) for model, seen in kinds]
    return max(found, key=lambda f: f[0].log_likelihood)


def _between_gaps(lost: Mask) -> list[tuple[int, int]]:
    """Return first sample and end of each stretch between runs of more than `LONGEST_GUESS` lost samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    gaps = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > LONGEST_GUESS]
    return list(zip([0, *(b for _, b in gaps)], [*(a for a, _ in gaps), len(lost)], strict=True))
