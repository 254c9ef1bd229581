r"""Is every recorded channel what the model takes it for: its sign, its unit, its name?

Where one output of the model is the derivative of another the record must show the same: over windows, with constant
and slope projected out, :math:`y_a \approx s\,\kappa \int y_b\,dt` with s = 1. All else is judged in windows with free
start, constant disturbance and constant sensor error: :math:`P y_j = n\,P (G u)_j` with n of order one.

A channel is called wrong only where turning it explains the record far better than the channel as it is together with
the effects that a model may lack: friction, damping, springs, gains of 0.05 to 2.5, delays up to 20 ms. Of a nonlinear
plant only where turning it takes nearly all of the error away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.motion_model import Course
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.hypotheses.motion_smoother import smooth_motion
from robustlab.identification.response.motion_response import MotionResponse, fit_windows
from robustlab.identification.response.response import Stretch, stretch_of
from robustlab.identification.response.windowed_simulation import ResponseWindows, explained
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel
from robustlab.units import unit_family

LONGEST = 600  # samples that are looked at
WINDOW = 100  # samples
SUSPECT = 10.0  # times the sensors' scatter: a smaller error is no channel's
LEFT = 0.1  # share of the squared error that a turned channel may leave


def turned_channels(plant: NonlinearPlant, record: Record) -> dict[str, float]:
    """The channel whose sign is wrong, with the share of the squared error that it leaves when turned; empty for none.

    The record is on a uniform clock, with all inputs of the plant; an InputError says that the position of a joint is
    not in it, a NoTrustworthyNumber that the plant cannot have such a motion, whichever channel is turned.
    """
    names = [s.name for s in plant.outputs if s.name in record.outputs]
    first = max(0, (record.n - LONGEST) // 2)
    whole = stretch_of(record, [s.name for s in plant.inputs], names).cut(first, first + LONGEST)
    columns = tuple(k for k, s in enumerate(plant.outputs) if s.name in names)
    u = np.column_stack(list(whole.u.values()))
    reason: NoTrustworthyNumber | None = None
    try:
        error = _error(plant, whole, u, whole.y, columns)
    except NoTrustworthyNumber as none:
        error, reason = np.inf, none
    if error < SUSPECT**2:
        return {}
    left = {}
    for kind, signals, labels in (("u", u, list(whole.u)), ("y", whole.y, names)):
        for j, name in enumerate(labels):
            turned = signals.copy()
            turned[:, j] *= -1.0
            try:
                left[name] = _error(plant, whole, *((turned, whole.y) if kind == "u" else (u, turned)), columns)
            except NoTrustworthyNumber:
                left[name] = np.inf
    best = min(left, key=lambda name: left[name])
    if reason is not None and not left[best] < SUSPECT**2:
        raise reason
    share = left[best] / error
    return {best: share} if share < LEFT else {}


def _error(plant: NonlinearPlant, whole: Stretch, u: Array, y: Array, columns: Sequence[int]) -> float:
    """Mean square of the windowed error in units of the sensors' scatter."""
    smoothed = smooth_motion(plant, whole.t, u, y, columns).smoothed
    noise = np.maximum(smoothed.noise_std, 1e-6 / whole.weight)
    judged = Stretch(whole.t, whole.u, y, 1.0 / noise)
    response = MotionResponse(Course(plant, smoothed.x, u, float(whole.t[1] - whole.t[0])), tuple(columns), judged)
    length = min(WINDOW, len(whole.t))
    starts = np.arange(0, len(whole.t) - length + 1, length)
    left = [fit_windows(w, response.errors(w), judged.weight).left for w in response.responses(starts, length)]
    return float(np.mean(np.concatenate(left) ** 2))


Fits = Sequence[ResponseWindows]

# Of a channel in no known unit: thousands, hundreds, degrees, turns, turns a minute.
ANY_FACTORS = (
    1e3,
    1e-3,
    1e2,
    1e-2,
    180 / math.pi,
    math.pi / 180,
    2 * math.pi,
    0.5 / math.pi,
    30 / math.pi,
    math.pi / 30,
)

FAR = 8.0  # factors further than this from the plain one are not tried
PLAUSIBLE_GAIN = (0.25, 4.0)  # plain factors within are no ground for suspicion
RIVAL_GAIN = (0.05, 2.5)  # what missing effects may leave of a response, or add to it
BEFORE_FRICTION = (0.35, 2.5)  # gains before friction takes its share
TURNED_GAIN = (0.2, 2.5)  # the same for a channel whose sign is turned back
UNIT_GAIN = (0.4, 1.8)  # for a channel converted to another unit, by a factor of 20 or more
SMALL_UNIT_GAIN = (0.7, 1.45)  # by less: there gains and effects come close to units
SMALL_UNIT = 20.0
EXPLAINED = 0.8  # share that the turned channel must explain
MUCH_BETTER = 0.25  # share of the error as it is that may remain when the channel is turned
EXPLAINED_AS_IT_IS = 0.9  # share from which a channel is not turned: what is left of it is no matter of its sign
RAW_SHARE = 0.5  # share of the raw response that tells a sign
OWN_RESPONSE = 0.99  # an output that its own response explains so far, at any gain, is no other one
SLOPE_FIT = 0.9  # R² from which the slope of a derivative relation is taken at its word
SLOPE_RANGE = (0.6, 1.6)  # what sensor gains and filters may make of a slope of 1
SLOPE_MATCH = 1.3


@dataclass(frozen=True)
class Contradiction:
    """A channel that is not what the model takes it for."""

    kind: str  # "sign", "unit", "swapped-outputs" or "swapped-inputs"
    # the channel; two where they are swapped, or where one of two is wrong and the record cannot say which
    channels: tuple[str, ...]
    factor: float  # the recorded values are this many times those the model expects (NaN for swapped channels)
    unit: str  # unit in which a channel of kind "unit" seems to be recorded; empty where not known
    evidence: dict[str, object]  # the figures behind it


def unit_factors(unit: str) -> dict[float, str]:
    """Factor -> unit in which a channel may have been recorded instead of ``unit``.

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
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, good: Mask, fits: Fits
) -> list[Contradiction]:
    """Channels that contradict the model, the surest test first.

    ``model``: linear model; outputs that are not named in ``outputs`` are left aside. ``record``: record on a uniform
    clock, with the model's inputs and the named outputs. ``good``: samples that were measured, shape (n,). ``fits``:
    the same record in windows: `robustlab.identification.response.windowed_simulation.response_windows`.
    """
    found = _from_derivatives(model, outputs, record, good, fits)
    taken = {name for one in found for name in one.channels}
    found += _from_responses(model, outputs, record, fits, taken)
    return found


# --- one output the derivative of another ----------------------------------------------------------------------------


def derivative_pairs(model: StateSpaceModel) -> list[tuple[str, str, float]]:
    """Outputs (a, b, kappa) of a continuous model with ``dy_a/dt = kappa y_b`` whatever the input does.

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
    """Slope s of ``y_a`` over the integral of ``y_b`` and its R², over the windows that show it best."""
    integral = np.concatenate([[0.0], np.cumsum((y_b[1:] + y_b[:-1]) / 2) * dt])
    best = (0.0, 0.0)
    for parts in (1, 5, 20):
        length = len(y_a) // parts
        if length < 20:
            continue
        line = np.linalg.qr(np.column_stack([np.ones(length), np.linspace(-1.0, 1.0, length)]))[0]
        ab = bb = aa = 0.0
        for first in range(0, length * parts, length):
            part = slice(first, first + length)
            if not good[part].all():
                continue
            a, b = (x[part] - line @ (line.T @ x[part]) for x in (y_a, integral))
            ab, bb, aa = ab + float(a @ b), bb + float(b @ b), aa + float(a @ a)
        if aa > 0 and bb > 0 and ab * ab / (aa * bb) > best[1]:
            best = (ab / bb, ab * ab / (aa * bb))
    return best


def _from_derivatives(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, good: Mask, fits: Fits
) -> list[Contradiction]:
    found: list[Contradiction] = []
    units = {s.name: record.unit(s.name) or s.unit for s in model.outputs if s.name in outputs}
    for a, b, kappa in derivative_pairs(model):
        if a not in outputs or b not in outputs:
            continue
        slope, share = derivative_slope(record[a], kappa * record[b], record.dt, good)
        if share >= SLOPE_FIT and SLOPE_RANGE[0] <= slope <= SLOPE_RANGE[1]:
            continue
        evidence: dict[str, object] = {"test": f"{a} against the integral of {b}", "slope": slope, "r2": share}
        back, back_share = derivative_slope(record[b], kappa * record[a], record.dt, good)
        if back_share >= SLOPE_FIT and SLOPE_RANGE[0] <= back <= SLOPE_RANGE[1]:
            more = {"slope_swapped": back, "r2_swapped": back_share}
            found.append(Contradiction("swapped-outputs", (a, b), math.nan, "", {**evidence, **more}))
            continue
        if share < SLOPE_FIT:
            continue
        if slope < 0:
            who = _sign_owner(a, b, outputs, fits)
            found.append(Contradiction("sign", who, -1.0, "", evidence))
        found += _unit_of_slope(a, b, abs(slope), units, outputs, fits, evidence)
    return found


def _sign_owner(a: str, b: str, outputs: tuple[str, ...], fits: Fits) -> tuple[str, ...]:
    """Which of two outputs moves against the model's response; both where the record cannot say."""
    (s_a, sure_a), (s_b, sure_b) = (_best_factor(outputs.index(name), fits) for name in (a, b))
    if s_a * s_b < 0 and max(sure_a, sure_b) >= 0.5:
        return (a,) if s_a < 0 else (b,)
    return a, b


def _unit_of_slope(
    a: str,
    b: str,
    slope: float,
    units: dict[str, str],
    outputs: tuple[str, ...],
    fits: Fits,
    evidence: dict[str, object],
) -> list[Contradiction]:
    choices = [(abs(math.log(slope / f)), a, f, name) for f, name in unit_factors(units[a]).items()]
    choices += [(abs(math.log(slope * f)), b, f, name) for f, name in unit_factors(units[b]).items()]
    near = sorted(choice for choice in choices if choice[0] < math.log(SLOPE_MATCH))
    if not near or SLOPE_RANGE[0] <= slope <= SLOPE_RANGE[1]:
        return []
    best: dict[str, tuple[float, str]] = {}
    for _, name, f, unit in near:
        best.setdefault(name, (f, unit))
    if len(best) == 2:
        (s_a, sure_a), (s_b, sure_b) = (_best_factor(outputs.index(name), fits) for name in (a, b))
        if min(sure_a, sure_b) >= 0.3 and s_a and s_b:
            best.pop(b if abs(math.log(abs(s_a))) > abs(math.log(abs(s_b))) else a)
    channels = tuple(best)
    factor, unit = next(iter(best.values()))
    return [Contradiction("unit", channels, factor, unit if len(channels) == 1 else "", evidence)]


def _best_factor(j: int, fits: Fits) -> tuple[float, float]:
    """Plain factor of the first input's response in output j, and its R², in the windows that show it best."""
    options = [fit.plain(j) for fit in fits]
    if not options:
        return 0.0, 0.0
    s, share = max(options, key=lambda one: one[1])
    return float(s[0]), share


# --- channels turned, converted and swapped --------------------------------------------------------------------------


class _Explanation:
    """How much of output ``channel`` the model's output ``row`` explains in one set of windows, under hypotheses."""

    def __init__(self, fit: ResponseWindows, channel: int, row: int) -> None:
        self.fit, self.row = fit, row
        y = fit.y[..., channel]
        self.target = fit.project(row, y)
        self.effects = fit.effects(row, fit.rows[row], y)

    def share(self, factor: float, gain: tuple[float, float], forced: list[Array], *, net: bool = True) -> float:
        """Share explained of the channel divided by ``factor``, with the responses' gains within ``gain``.

        With ``net`` the gains are what friction and damping leave of the response; without, what they begin with.
        """
        effects, sign = self.effects, math.copysign(1.0, factor)
        main = np.column_stack(forced)
        losses = np.column_stack(effects.losses) if effects.losses else np.zeros((len(main), 0))
        springs = np.column_stack(effects.springs) / factor if effects.springs else np.zeros((len(main), 0))
        most = np.array(effects.largest)
        # Of each port's three losses the last two follow the sign of the motion alone, whatever its unit.
        losses = losses * np.tile([sign / abs(factor), sign, sign], losses.shape[1] // 3)
        if net:
            q = np.linalg.qr(main[:, np.linalg.norm(main, axis=0) > 0])[0]
            losses, most = losses - q @ (q.T @ losses), np.full(len(most), np.inf)
            held = np.zeros((len(main), 0))
        else:  # at rest static friction may hold all of the input
            held = -np.column_stack(effects.held)
        n_u, n_rest = main.shape[1], springs.shape[1] + losses.shape[1] + held.shape[1]
        lower = np.concatenate([np.full(n_u, gain[0]), np.zeros(n_rest)])
        upper = np.concatenate([np.full(n_u, gain[1]), effects.stiffest, most, np.full(held.shape[1], gain[1])])
        return explained(self.target / factor, np.hstack([main, springs, losses, held]), lower, upper)[0]

    def corrected(self, factor: float) -> float:
        """Share explained of the channel divided by ``factor``, whether friction takes much of it or little."""
        gain = _gain_of(factor)
        forced = self.fit.forced[self.row]
        return max(self.share(factor, gain, forced, net=net) for net in (True, False))

    def as_it_is(self, factor: float = -1.0) -> float:
        """Share explained by a delay of up to 20 ms, gains and effects, as the rival of a channel off by ``factor``."""
        fit = self.fit
        late = [[fit.project(self.row, f[..., fit.rows[self.row]]) for f in forced] for forced in fit.late]
        options = (fit.forced[self.row], *late)
        best = max(self.share(1.0, BEFORE_FRICTION, forced, net=False) for forced in options)
        # A factor near 1 lies within what friction may leave of a response: there that is no rival.
        if 1.0 < max(abs(factor), 1 / abs(factor)) < SMALL_UNIT:
            return best
        return max(best, *(self.share(1.0, RIVAL_GAIN, forced) for forced in options))


def _gain_of(factor: float) -> tuple[float, float]:
    size = max(abs(factor), 1 / abs(factor))
    if size == 1.0:
        return TURNED_GAIN
    return UNIT_GAIN if size >= SMALL_UNIT else SMALL_UNIT_GAIN


def _convincing(turned: float, as_it_is: float) -> bool:
    return turned >= EXPLAINED and 1.0 - turned <= MUCH_BETTER * (1.0 - as_it_is)


def _suspicious(fit: ResponseWindows, j: int) -> bool:
    """Whether the plain factors of output j lie where no gain error is looked for."""
    factors, share = fit.plain(j)
    energy = np.array([float(f @ f) for f in fit.forced[j]]) * factors**2
    heavy = energy > 0.05 * energy.sum()
    low, high = PLAUSIBLE_GAIN
    return share >= 0.3 and bool((heavy & ((factors < low) | (factors > high))).any())


def _from_responses(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, fits: Fits, taken: set[str]
) -> list[Contradiction]:
    free = [j for j, name in enumerate(outputs) if name not in taken]
    found = _swapped_outputs(outputs, fits, free)
    taken = taken | {name for one in found for name in one.channels}
    free = [j for j in free if outputs[j] not in taken]
    if len(model.inputs) > 1:
        found += _wrong_inputs(model, outputs, record, fits, free)
        if found:
            return found
    wrong = {j: one for j in free if (one := _wrong_output(model, outputs, record, fits, j))}
    if not wrong:
        return found
    if len(model.inputs) == 1:
        return found + _of_one_input(model, outputs, record, fits, free, wrong)
    for j, (factor, evidence) in wrong.items():
        found += _named((outputs[j],), factor, unit_factors(_unit(model, record, outputs[j])), evidence)
    return found


def _unit(model: StateSpaceModel, record: Record, name: str) -> str:
    stated = {s.name: s.unit for s in (*model.inputs, *model.outputs)}
    return record.unit(name) or stated[name]


def _wrong_output(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, fits: Fits, j: int
) -> tuple[float, dict[str, object]] | None:
    """Factor by which output j is off (or the only input by its inverse), where that is convincing."""
    sizes = {1.0, *unit_factors(_unit(model, record, outputs[j]))}
    if len(model.inputs) == 1:
        sizes |= {1.0 / f for f in unit_factors(_unit(model, record, model.input_names[0]))}
    for fit in fits:
        if not _suspicious(fit, j):
            continue
        plain, share = fit.plain(j)
        typical = float(np.median(plain))
        sign = math.copysign(1.0, typical)
        near = [sign * f for f in sizes if sign * f != 1.0 and abs(math.log(abs(typical) / f)) < math.log(FAR)]
        if not near:
            continue
        explanation = _Explanation(fit, j, j)
        turned = {f: explanation.corrected(f) for f in near}
        # Friction takes away from a response: of factors that explain alike, the one closest to the plain one is taken.
        best = max(turned.values())
        alike = [f for f in near if 1.0 - turned[f] <= 2.0 * (1.0 - best) + 1e-3]
        factor = min(alike, key=lambda f: abs(math.log(typical / f)))
        as_it_is = explanation.as_it_is(factor)
        if factor < 0 and (as_it_is > EXPLAINED_AS_IT_IS or _raw_sign(fits, j, 0) > 0):
            continue
        if _convincing(turned[factor], as_it_is) and not _denied(fits, j, factor):
            return factor, {
                "test": "response in windows",
                "plain_factor": typical,
                "plain_r2": share,
                "explained_as_it_is": as_it_is,
                "explained_when_corrected": turned[factor],
                "window": fit.length * fit.dt,
            }
    return None


def _denied(fits: Fits, j: int, factor: float) -> bool:
    """Whether windows of another length show clearly another factor."""
    for fit in fits:
        factors, share = fit.plain(j)
        ratio = float(np.median(factors)) / factor
        if share >= 0.5 and not 0.2 < ratio < 5.0:
            return True
    return False


def _raw_sign(fits: Fits, j: int, i: int) -> float:
    """Sign that the raw response of output j to input i has; 0 where it says none.

    The test in windows leaves out what a constant may do, and with it all that a steady input did: of a motor at
    nearly constant current it sees the ripple alone, which follows the motor's own disturbances with either sign.
    """
    options = [fit.raw(j) for fit in fits]
    factors, share = max(options, key=lambda one: one[1], default=(np.zeros(i + 1), 0.0))
    return float(np.sign(factors[i])) if share >= RAW_SHARE else 0.0


def _of_one_input(
    model: StateSpaceModel,
    outputs: tuple[str, ...],
    record: Record,
    fits: Fits,
    free: list[int],
    wrong: dict[int, tuple[float, dict[str, object]]],
) -> list[Contradiction]:
    """Outputs that are off, or the only input where every output that moves says the same."""
    source = model.input_names[0]
    moving = {j: s for j in free for s, share in [_best_factor(j, fits)] if share >= 0.3 or j in wrong}
    first, evidence = next(iter(wrong.values()))
    low, high = PLAUSIBLE_GAIN
    # What the derivative relation holds together is wrong together.
    bound = {outputs.index(n) for a, b, _ in derivative_pairs(model) for n in (a, b) if {a, b} <= set(outputs)}
    bound = {j for j in bound if j in free} if bound & wrong.keys() else set()
    moving.update(dict.fromkeys({*bound, *(j for j, (factor, _) in wrong.items() if factor == first)}, first))
    agreed = all(low < s / first < high or (s < 0 and first == -1.0) for s in moving.values())
    if len(moving) > 1 and agreed:
        return _named((source,), 1.0 / first, unit_factors(_unit(model, record, source)), evidence)
    found: list[Contradiction] = []
    for j, (factor, figures) in wrong.items():
        channels = (outputs[j], source) if len(moving) == 1 else (outputs[j],)
        found += _named(channels, factor, unit_factors(_unit(model, record, outputs[j])), figures)
    return found


def _named(
    channels: tuple[str, ...], factor: float, units: dict[float, str], evidence: dict[str, object]
) -> list[Contradiction]:
    """A factor as a wrong sign, a wrong unit, or both."""
    found: list[Contradiction] = []
    if factor < 0:
        found.append(Contradiction("sign", channels, -1.0, "", evidence))
    size = abs(factor)
    if size != 1.0:
        unit = next((name for f, name in units.items() if abs(math.log(f / size)) < 1e-6), "")
        found.append(Contradiction("unit", channels, size, unit, evidence))
    return found


def _swapped_outputs(outputs: tuple[str, ...], fits: Fits, free: list[int]) -> list[Contradiction]:
    for fit in fits:
        poor = [j for j in free if fit.plain(j)[1] < OWN_RESPONSE]
        as_it_is = {j: _Explanation(fit, j, j).as_it_is() for j in poor} if len(poor) > 1 else {}
        as_it_is = {j: share for j, share in as_it_is.items() if share < OWN_RESPONSE}
        for j, k in combinations(as_it_is, 2):
            crossed = [_Explanation(fit, a, b).share(1.0, UNIT_GAIN, fit.forced[b]) for a, b in ((j, k), (k, j))]
            if all(_convincing(c, as_it_is[m]) for c, m in zip(crossed, (j, k), strict=True)):
                evidence: dict[str, object] = {
                    "test": "response in windows",
                    "explained_as_it_is": [as_it_is[j], as_it_is[k]],
                    "explained_when_corrected": crossed,
                    "window": fit.length * fit.dt,
                }
                return [Contradiction("swapped-outputs", (outputs[j], outputs[k]), math.nan, "", evidence)]
    return []


def _good(fit: ResponseWindows, j: int) -> bool:
    """Whether plain gains of 0.25 to 4 explain 95 % of the output."""
    columns = np.column_stack(fit.forced[j])
    low, high = PLAUSIBLE_GAIN
    return explained(fit.target[j], columns, np.full(columns.shape[1], low), high)[0] >= 0.95


def _wrong_inputs(
    model: StateSpaceModel, outputs: tuple[str, ...], record: Record, fits: Fits, free: list[int]
) -> list[Contradiction]:
    """One input turned or in another unit, or two inputs of one unit exchanged, by all outputs together."""
    names = model.input_names
    for fit in fits:
        if all(_good(fit, j) for j in free):
            continue
        rows = {j: _Explanation(fit, j, j) for j in free if float(fit.target[j] @ fit.target[j]) > 0}
        before = {j: row.as_it_is() for j, row in rows.items()}
        best: tuple[float, list[Contradiction]] = (-np.inf, [])
        for channels, factor, order in _input_hypotheses(model, record):
            changed = fit.response(fit.u[..., list(order)], np.arange(len(names)))
            after = {}
            for j, row in rows.items():
                forced = [fit.project(j, f[..., fit.rows[j]]) for f in changed]
                for i, name in enumerate(names):
                    if math.isfinite(factor) and name in channels:
                        forced[i] = forced[i] / factor
                gain = RIVAL_GAIN if not math.isfinite(factor) else (max(RIVAL_GAIN[0], _gain_of(factor)[0]), 2.5)
                after[j] = row.share(1.0, gain, forced)
            said = [j for j in rows if max(after[j], before[j]) >= 0.5]
            if not said:
                continue
            new, old = (float(np.mean([shares[j] for j in said])) for shares in (after, before))
            if factor < 0:
                raw = sum(_raw_sign(fits, j, names.index(channels[0])) for j in said)
                if raw > 0 or old > EXPLAINED_AS_IT_IS:
                    continue
            if _convincing(new, old) and new > best[0]:
                evidence: dict[str, object] = {
                    "test": "response in windows",
                    "explained_as_it_is": old,
                    "explained_when_corrected": new,
                    "window": fit.length * fit.dt,
                }
                best = new, _input_finding(model, record, outputs, channels, factor, evidence, said)
        if best[1]:
            return best[1]
    return []


def _input_hypotheses(model: StateSpaceModel, record: Record) -> list[tuple[tuple[str, ...], float, tuple[int, ...]]]:
    """(channels, factor of the recorded input, order in which the recorded inputs drive the model)."""
    names = model.input_names
    same = tuple(range(len(names)))
    options: list[tuple[tuple[str, ...], float, tuple[int, ...]]] = []
    for name in names:
        sizes = (1.0, *unit_factors(_unit(model, record, name)))
        options += [((name,), sign * f, same) for f in sizes for sign in (1.0, -1.0) if sign * f != 1.0]
    for i, k in combinations(same, 2):
        if _unit(model, record, names[i]) == _unit(model, record, names[k]):
            order = list(same)
            order[i], order[k] = k, i
            options.append(((names[i], names[k]), math.nan, tuple(order)))
    return options


def _input_finding(
    model: StateSpaceModel,
    record: Record,
    outputs: tuple[str, ...],
    channels: tuple[str, ...],
    factor: float,
    evidence: dict[str, object],
    said: list[int],
) -> list[Contradiction]:
    if not math.isfinite(factor):
        return [Contradiction("swapped-inputs", channels, factor, "", evidence)]
    units = unit_factors(_unit(model, record, channels[0]))
    if len(said) == 1 and len(outputs) == 1:
        channels = (*channels, outputs[said[0]])
    return _named(channels, factor, units, evidence)
