r"""Checks of the sign, unit and name of every recorded channel against the model.

Outputs that are derivatives of one another are compared directly. All others are checked by the factors s of the
inputs' responses, :math:`y_j \approx \sum_i s_{ji} G_{ji} u_i`, in windows with free initial state, constant
disturbance and sensor error: wrong is an s near -1 or near the factor of a unit, if the response explains the output.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import Course
from robustlab.dynamics.simulation import transition
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.greybox.disturbance_smoother import SmoothedRecord
from robustlab.identification.greybox.motion_smoother import smooth_motion
from robustlab.identification.response.response import MotionResponse, Stretch, fit_windows, rates, stretch_of
from robustlab.record import Record
from robustlab.result import Evidence
from robustlab.statespace import StateSpaceModel
from robustlab.units import unit_family
from robustlab.worst_case_analysis.batched_members import recursion

LONGEST = 600  # samples used
WINDOW = 100  # samples
SUSPECT = 10.0  # times the sensors' scatter: a smaller error is not due to a channel
LEAST_NOISE = 1e-6  # of an output's range: rounding does not set the weight of a record without noise
LEFT = 0.1  # share of the squared error that may remain with an inverted channel


def turned_channels(plant: NonlinearPlant, record: Record) -> dict[str, float]:
    """Return the channel with a wrong sign -> share of the squared error that remains when inverted; empty for none."""
    # Raises InputError if the position of a joint is missing, NoTrustworthyNumber if the plant cannot have such
    # a motion with any channel inverted.
    names = [s.name for s in plant.outputs if s.name in record.outputs]
    first = max(0, (record.n - LONGEST) // 2)
    whole = stretch_of(record, [s.name for s in plant.inputs], names).cut(first, first + LONGEST)
    left, impossible = dict[str, float](), None
    for turned in ("", *whole.u, *names):
        u = {name: -x if name == turned else x for name, x in whole.u.items()}
        y = whole.y * np.where([name == turned for name in names], -1.0, 1.0)
        try:
            left[turned] = _error(plant, replace(whole, u=u, y=y), names)
        except NoTrustworthyNumber as none:
            left[turned], impossible = np.inf, none if turned == "" else impossible
        if left[""] < SUSPECT**2:
            return {}
    now = left.pop("")
    best = min(left, key=lambda name: left[name])
    if impossible is not None and not left[best] < SUSPECT**2:
        raise impossible
    share = left[best] / now
    return {best: share} if share < LEFT else {}


def _error(plant: NonlinearPlant, whole: Stretch, names: Sequence[str]) -> float:
    """Compute the mean square of the windowed error in units of the sensors' scatter."""
    response, _ = along_motion(plant, whole, names)
    length = min(WINDOW, len(whole.t))
    starts = np.arange(0, len(whole.t) - length + 1, length)
    left = [fit_windows(response, windows).left for windows in response.responses(starts, length)]
    return float(np.mean(np.concatenate(left) ** 2))


def along_motion(plant: NonlinearPlant, whole: Stretch, names: Sequence[str]) -> tuple[MotionResponse, SmoothedRecord]:
    """Return the response about the smoothed motion of a uniform record, weighted by the noise of each sensor."""
    columns = tuple(k for k, s in enumerate(plant.outputs) if s.name in names)
    u, dt = np.column_stack(list(whole.u.values())), float(whole.t[-1] - whole.t[0]) / (len(whole.t) - 1)
    smoothed = smooth_motion(plant, whole.t, u, whole.y, columns)[0]
    noise = np.maximum(smoothed.noise_std, LEAST_NOISE / whole.weight)
    return MotionResponse(Course(plant, smoothed.x, u, dt), columns, replace(whole, weight=1.0 / noise)), smoothed


# For a channel in no known unit: thousands, hundreds, degrees, turns, turns per minute.
ANY_FACTORS = tuple(both for f in (1e3, 1e2, 180 / math.pi, 2 * math.pi, 30 / math.pi) for both in (f, 1.0 / f))
RANK = 1e-8
GROWTH = 1e6  # windows over which an unstable model grows by more are not simulated
EXPLAINED = 0.8  # share of an output that must be explained
NEEDED = 0.25  # share of the error without an input that may remain with it
NEAR, NEAR_SMALL, SMALL = 2.5, 1.45, 20.0  # tolerance of a factor about -1 or a unit; of units that differ by less
LIKELY = 0.3  # share explained, with which one of two channels is blamed
RAW_SHARE = 0.5  # share of the raw response that determines a sign
SLOPE_FIT = 0.9  # R² from which the slope of a derivative relation is used
SLOPE_RANGE = (0.6, 1.6)  # of a correct slope with sensor gains and filters
SLOPE_MATCH = 1.3


@dataclass(frozen=True)
class Finding(Evidence):
    """A property of a record that is relevant for effect identification."""

    # may be fatal: too-short, unexcited, constant-output, sign, unit, motion; never: clipped, gaps, quantisation
    kind: str
    channel: str  # signal, or ``"t"`` for the time base; two signals are separated by a comma
    found: str
    expected: str
    hint: str
    fatal: bool  # effects must not be identified from this record
    evidence: dict[str, object]

    @property
    def message(self) -> str:
        """``CHANNEL: FOUND, expected EXPECTED``."""
        text = f"{self.channel}: {self.found}"
        return f"{text}, expected {self.expected}" if self.expected else text

    def to_json(self) -> dict[str, object]:
        return {**vars(self), "message": self.message}


def unit_factors(unit: str) -> dict[float, str]:
    """Return factor -> unit in which a channel may have been recorded instead of ``unit``.

    Examples
    --------
    >>> {round(f, 3): name for f, name in unit_factors("rad/s").items()}
    {57.296: 'deg/s', 9.549: 'rpm', 0.159: 'turns/s', 1000.0: 'mrad/s'}
    """
    found = unit_family(unit)
    if found is None:
        return dict.fromkeys(ANY_FACTORS, "")
    family, own = found
    return {own / size: other for other, size in family.items() if size != own}


def contradictions(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, good: Mask, factors: Sequence[Factors]
) -> list[Finding]:
    """Find the channels that contradict the model, the most reliable test first; ``good``: measured samples, (n,)."""
    units = {s.name: record.units.get(s.name) or s.unit for s in (*model.inputs, *model.outputs)}
    found = _from_derivatives(model, outputs, record, good, units, factors)
    taken = {name for one in found for name in one.channel.split(", ")}
    return found + _from_responses(model, outputs, units, factors, taken)


# --- one output the derivative of another ----------------------------------------------------------------------------


def derivative_pairs(model: StateSpaceModel) -> list[tuple[str, str, float]]:
    """Return the outputs (a, b, kappa) of a continuous model with ``dy_a/dt = kappa y_b`` for any input.

    Examples
    --------
    >>> from robustlab.dynamics import plant
    >>> derivative_pairs(plant("dc-motor").state_space())
    [('phi', 'omega', 1.0)]
    """
    if model.is_discrete:
        return []
    pairs = []
    for a, name in enumerate(model.output_names):
        rate, through = model.C[a] @ model.A, model.C[a] @ model.B
        if model.D[a].any() or not rate.any():
            continue
        for b, other in enumerate(model.output_names):
            size = float(model.C[b] @ model.C[b])
            kappa = float(rate @ model.C[b]) / size if size and a != b else 0.0
            whole = np.linalg.norm(rate) + np.linalg.norm(through)
            miss = np.linalg.norm(rate - kappa * model.C[b]) + np.linalg.norm(through - kappa * model.D[b])
            if kappa and miss <= 1e-9 * whole:
                pairs.append((name, other, kappa))
    return pairs


def derivative_slope(y_a: Array, y_b: Array, dt: float, good: Mask) -> tuple[float, float]:
    """Fit the slope of ``y_a`` over the integral of ``y_b``, with its R², in the windows with the best fit."""
    integral = np.concatenate([[0.0], np.cumsum((y_b[1:] + y_b[:-1]) / 2) * dt])
    best = (0.0, 0.0)
    for length in (len(y_a) // parts for parts in (1, 5, 20)):
        kept = _windows(good, length)
        if length < 20 or not kept:
            continue
        line = _orthonormal(np.column_stack([np.ones(length), np.linspace(-1.0, 1.0, length)]))
        a, b = (_projected(np.stack([x[k : k + length] for k in kept]), line) for x in (y_a, integral))
        slope, share = _fit(a, b[:, None])
        best = max(best, (float(slope[0]), share), key=lambda found: found[1])
    return best


def _windows(good: Mask, length: int) -> list[int]:
    """Return the starts of the windows in which all samples are good."""
    return [k for k in range(0, len(good) - length + 1, max(length, 1)) if good[k : k + length].all()]


def _from_derivatives(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, good: Mask, units: dict[str, str],
    factors: Sequence[Factors],
) -> list[Finding]:  # fmt: skip
    found: list[Finding] = []
    own = {name: (f.s[0], f.share) for name, f in zip(outputs, factors, strict=True)}
    for a, b, kappa in derivative_pairs(model):
        if a not in outputs or b not in outputs:
            continue
        slope, share = derivative_slope(record[a], kappa * record[b], record.dt, good)
        if share < SLOPE_FIT or SLOPE_RANGE[0] <= slope <= SLOPE_RANGE[1]:
            continue
        test, (s_a, sure_a), (s_b, sure_b) = f"{a} against the integral of {b}", *(own[n] for n in (a, b))
        because = f"{test}: slope {slope:.3g} instead of 1, R² {share:.3g}"
        evidence: dict[str, object] = {"test": test, "slope": slope, "r2": share}
        if slope < 0:  # the one that moves against the model's response; both if the record does not determine it
            known = s_a * s_b < 0 and max(sure_a, sure_b) >= 0.5
            wrong = (a, b) if not known else (a,) if s_a < 0 else (b,)
            found += _contradiction(wrong, -1.0, because, evidence, units)
        size = abs(slope)
        if SLOPE_RANGE[0] <= size <= SLOPE_RANGE[1]:
            continue
        near = [(abs(math.log(size / f)), a, f) for f in unit_factors(units[a])]
        near += [(abs(math.log(size * f)), b, f) for f in unit_factors(units[b])]
        best: dict[str, float] = {}
        for distance, name, f in sorted(near):
            if distance < math.log(SLOPE_MATCH):
                best.setdefault(name, f)
        if len(best) == 2 and min(sure_a, sure_b) >= 0.3 and s_a and s_b:
            best.pop(b if abs(math.log(abs(s_a))) > abs(math.log(abs(s_b))) else a)
        if best:
            found += _contradiction(tuple(best), next(iter(best.values())), because, evidence, units)
    return found


# --- responses to the inputs -----------------------------------------------------------------------------------------


def _from_responses(
    model: StateSpaceModel, outputs: tuple[str, ...], units: dict[str, str], factors: Sequence[Factors], taken: set[str]
) -> list[Finding]:
    """Find inputs whose factor is wrong in every output that determines it, else outputs with only wrong factors."""
    free = [j for j, name in enumerate(outputs) if name not in taken]
    sure, likely = np.full((2, len(free), model.n_inputs), np.nan)
    for k, j in enumerate(free):
        for i, name in enumerate(model.input_names):
            sure[k, i], likely[k, i] = _snapped(factors[j], i, units[outputs[j]], units[name])
    found: list[Finding] = []
    for i, name in enumerate(model.input_names):
        wrong = np.flatnonzero(np.isfinite(sure[:, i]) & (sure[:, i] != 1.0))
        own = likely[:, i][np.isfinite(likely[:, i])]
        if len(wrong) and np.allclose(own, own[0]) and (len(own) > 1 or (sure[wrong[0]] == 1.0).any()):
            because, data = factors[free[wrong[0]]].evidence(i)
            found += _contradiction((name,), 1.0 / sure[wrong[0], i], because, data, units)
    if found:
        return found
    for row, j in zip(sure, free, strict=True):
        wrong = np.flatnonzero(np.isfinite(row) & (row != 1.0))
        if len(wrong) and np.allclose(row[np.isfinite(row)], row[wrong[0]]):
            channels = (outputs[j], *model.input_names) if np.isfinite(likely).sum() == 1 else (outputs[j],)
            found += _contradiction(channels, row[wrong[0]], *factors[j].evidence(int(wrong[0])), units)
    return found


def _contradiction(
    channels: tuple[str, ...], factor: float, because: str, evidence: dict[str, object], units: dict[str, str]
) -> list[Finding]:
    """Interpret recorded over expected values of a channel, or of one of several, as a wrong sign, unit, or both."""
    found = [turned_sign(channels, because, {**evidence, "factor": -1.0, "unit": ""})] if factor < 0 else []
    first, size = channels[0], abs(float(factor))
    if not math.isclose(size, 1.0):
        known = unit_factors(units[first]).items() if len(channels) == 1 else ()
        unit = next((name for f, name in known if abs(math.log(f / size)) < 1e-6), "")
        expected, either = units[first] or "the model's unit", " or ".join(channels)
        text = f"{either} seems to be recorded in {unit or 'another unit'}: its values are about {size:.4g} times "
        text, hint = f"{text}those in {expected} ({because})", f"if it is so, divide {first} by {size:.6g}"
        own = {**evidence, "factor": size, "unit": unit}
        found.append(Finding("unit", ", ".join(channels), text, expected, hint, True, own))
    return found


def turned_sign(channels: tuple[str, ...], because: str, evidence: dict[str, object]) -> Finding:
    either = " or ".join(channels)
    text = f"{either} seems to be measured with the other sign ({because})"
    hint = f"check the wiring and the counting direction; if it is so, turn the sign of {either} in the record"
    return Finding("sign", ", ".join(channels), text, "the model's sign", hint, True, evidence)


class Factors(NamedTuple):
    """Factors s (n_u,) of the inputs' responses in one output, in the windows of ``window`` s with the best fit."""

    s: Array
    share: float  # of the output that these explain
    left: Array  # squared error with each input over that without it, (n_u,)
    raw: Array  # signs of the raw responses, 0 if undetermined, (n_u,)
    window: float

    def evidence(self, i: int) -> tuple[str, dict[str, object]]:
        """Return the text and the figures of the factor of input i."""
        text = f"its response is {self.s[i]:.3g} times the model's, R² {self.share:.3g}"
        return text, {"test": "response in windows", "found": float(self.s[i]), "r2": self.share, "window": self.window}


def _snapped(found: Factors, i: int, output_unit: str, input_unit: str) -> tuple[float, float]:
    """Round the factor of input i to 1, -1 or the factor of a unit: the certain value and the likely one, else NaN."""
    sizes = [1.0, *unit_factors(output_unit), *(1.0 / f for f in unit_factors(input_unit))]

    def nearest(s: float) -> float:
        return math.copysign(min(sizes, key=lambda f: abs(math.log(abs(s) / f))), s)

    s = float(found.s[i])
    likely = nearest(s) if s and found.share >= LIKELY else math.nan
    if found.share < EXPLAINED or found.left[i] > NEEDED or not s or s < 0 < found.raw[i]:
        return math.nan, likely
    size = nearest(s)
    apart = max(abs(size), 1.0 / abs(size))
    near = NEAR_SMALL if 1.0 < apart < SMALL else NEAR
    return (size, size) if abs(math.log(s / size)) <= math.log(near) else (math.nan, likely)


def response_factors(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, good: Mask
) -> tuple[Factors, ...]:
    """Fit the factors of each output in windows of the whole record, a sixth or a thirtieth, whichever fits best."""
    u = np.column_stack([record.inputs[name] for name in model.input_names])
    y = np.column_stack([record.outputs[name] for name in outputs])
    if point := model.operating_point:
        u, y = u - point.u, y - [point.y[model.output_names.index(name)] for name in outputs]
    growth, shortest = float(rates(model).real.max(initial=0.0)), max(40, 8 * (2 * model.n_states + 1))
    lengths = [n for n in (record.n // parts for parts in (1, 6, 30))
               if n >= shortest and growth * n * record.dt < math.log(GROWTH)]  # fmt: skip
    found = [each for n in lengths if (each := _factors(model, outputs, record.dt, u, y, good, n))]
    none = np.zeros(model.n_inputs)
    if not found:
        return (Factors(none, 0.0, none + 1, none, 0.0),) * len(outputs)
    return tuple(max(each, key=lambda f: f.share) for each in zip(*found, strict=True))


def _factors(
    model: StateSpaceModel, outputs: tuple[str, ...], dt: float, u: Array, y: Array, good: Mask, length: int
) -> list[Factors]:
    kept = _windows(good, length)
    if not kept:
        return []
    u, y = (np.stack([x[k : k + length] for k in kept]) for x in (u, y))
    n_u, n_x = model.n_inputs, model.n_states
    phi, gamma = model.A, np.hstack([model.B, np.eye(n_x)])  # with a constant input on the equation of every state
    if not model.is_discrete:
        phi, gamma, _ = transition(StateSpaceModel(phi, gamma, model.C, np.zeros((len(model.C), gamma.shape[1]))), dt)
    forced = []  # outputs (windows, n, n_y_of_model) of each input from zero state
    for i in range(n_u):
        x = recursion(phi[None], u[:, :-1, i, None] * gamma[:, i], np.zeros(n_x))
        forced.append(x @ model.C.T + u[..., i : i + 1] * model.D[:, i])
    free_states = recursion(phi[None], np.zeros((n_x, length - 1, n_x)), np.eye(n_x)[:, None])
    found = []
    for row, y_j in zip([model.output_names.index(name) for name in outputs], np.moveaxis(y, 2, 0), strict=True):
        free = (free_states @ model.C[row]).T  # output over a window from a unit of each state at its start
        held = np.vstack([np.zeros((1, n_x)), np.cumsum(free[:-1] @ gamma[:, n_u:], axis=0)])
        constant = _orthonormal(np.column_stack([free, held, np.ones(length)]))
        target = _projected(y_j, constant)
        inputs = np.column_stack([_projected(f[..., row], constant) for f in forced])
        s, share = _fit(target, inputs)
        without = [_fit(target, np.delete(inputs, i, axis=1))[1] for i in range(n_u)]
        left = np.array([(1.0 - share) / max(1.0 - part, 1e-300) for part in without])
        start = _orthonormal(free)  # includes the response to a steady input
        signs, fit = _fit(_projected(y_j, start), np.column_stack([_projected(f[..., row], start) for f in forced]))
        raw = np.sign(signs) if fit >= RAW_SHARE else np.zeros(n_u)
        found.append(Factors(s, share, left, raw, length * dt))
    return found


def _projected(x: Array, basis: Array) -> Array:
    """Project each window of x (windows, n) onto the complement of a basis (n, r), as one vector."""
    return (x - (x @ basis) @ basis.T).ravel()


def _fit(target: Array, columns: Array) -> tuple[Array, float]:
    """Fit factors of the columns by least squares, with the share of the target's square that they explain."""
    size = np.linalg.norm(columns, axis=0)
    use = size > 1e-12 * max(float(size.max(initial=0.0)), 1e-300)
    found, total = np.zeros(columns.shape[1]), float(target @ target)
    if not total or not use.any():
        return found, 0.0
    scaled = columns[:, use] / size[use]
    x = np.linalg.lstsq(scaled, target, rcond=RANK)[0]
    found[use] = x / size[use]
    return found, 1.0 - float(((target - scaled @ x) ** 2).sum()) / total


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis (n, r) of the span of the columns."""
    from scipy.linalg import orth

    size = np.linalg.norm(columns, axis=0)
    return orth(columns[:, size > 0] / size[size > 0], RANK) if size.any() else np.zeros((len(columns), 0))
