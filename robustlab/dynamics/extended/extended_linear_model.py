r"""The linear model of a plant with effects, in deviations from an operating point, and what it does not have.

.. math:: A = A_0 + \sum_j b_j \Bigl(\frac{\partial f_j}{\partial v} c_j^T + \frac{\partial f_j}{\partial q} p_j^T\Bigr)

Slopes of force laws, inputs and sensors are local ones. Dry friction at rest has none: it is left out, and
`left_out` says so with its footprint; with an amplitude of the speed it is the middle of its sector there. A map
without any gain at the point (inside a dead band, beyond a limit) would leave no model at all: it has the gain 1 there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Footprint
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.law_forces import extrapolated, is_set_valued, slopes
from robustlab.dynamics.plant_contract import Trim
from robustlab.errors import InputError, did_you_mean
from robustlab.statespace import OperatingPoint, StateSpaceModel, append, series

if TYPE_CHECKING:
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant, LeftOut

__all__ = [
    "effect_delay",
    "effect_gain",
    "left_out",
    "linear_model",
    "pade_delay",
    "sector",
    "signal_gains",
    "signal_levels",
]

# Share of the signal over which the slope of an input or output map is taken, and the least absolute step.
SIGNAL_STEP = 1e-3
# The order up to which a rational delay is better than its own rounding.
HIGHEST_PADE = 8
# Amplitude at which footprints are given where none was asked for.
DEFAULT_AMPLITUDE = 1.0


def linear_model(
    plant: ExtendedPlant,
    at: Any,
    amplitude: Mapping[str, float],
    pade: int,
    stand_in: Mapping[int, Array] | None = None,
) -> StateSpaceModel:
    """A, B, C, D with the operating point.

    Parameters
    ----------
    at
        A trim, an operating point or (x, u), at rest or not; left out: the trim with nothing given.
    amplitude
        Name of a site -> amplitude of its speed or signal: effects there that have a sector are taken as its middle.
    pade
        Order of the Padé approximation of delays; 0 leaves them out.
    stand_in
        Index of a law -> row (n_x,) with which it is ``f = -row x`` here, whatever its slope or sector.

    Raises
    ------
    InputError
        An amplitude at a place without an effect, or not positive; an order outside 0..8.
    """
    x, u = _point(plant, at)
    _check_options(plant, amplitude, pade)
    model = plant.model
    a = model.A.copy()
    for j, (e, law, port) in enumerate(plant.laws):
        if stand_in is not None and j in stand_in:
            a -= np.outer(port.force, stand_in[j])
            continue
        q = 0.0 if port.position is None else float(port.position @ x)
        v = float(port.velocity @ x)
        middle = sector(e, amplitude, ("speed", "current"))
        if middle is not None:
            a -= np.outer(port.force, port.velocity) * 0.5 * (middle.gain_lower + middle.gain_upper)
            continue
        if v == 0.0 and is_set_valued(law, q):
            continue
        stiffness, damping = slopes(law, q, v)
        a += np.outer(port.force, damping * port.velocity)
        if port.position is not None:
            a += np.outer(port.force, stiffness * port.position)
    into, out = signal_gains(plant, x, u, amplitude)
    delays = {"input": [0.0] * len(into), "output": [0.0] * len(out)}
    for e, k, _ in signal_levels(plant, x, u):
        delays[e.site.kind][k] += effect_delay(e)
    linear = StateSpaceModel(
        a, model.B * into, out[:, None] * model.C, out[:, None] * model.D * into, 0.0, plant.inputs, plant.outputs,
        plant.states, OperatingPoint(x, u, plant.output(x, u)), plant.name,
    )  # fmt: skip
    return _delayed(linear, delays, pade) if pade and any(map(any, delays.values())) else linear


def signal_gains(plant: ExtendedPlant, x: Array, u: Array, amplitude: Mapping[str, float]) -> tuple[Array, Array]:
    """Gains of the inputs, (n_u,), and of the outputs, (n_y,), that the effects on them have at (x, u)."""
    into, out = np.ones(len(plant.inputs)), np.ones(len(plant.outputs))
    for e, k, level in signal_levels(plant, x, u):
        gains = into if e.site.kind == "input" else out
        gains[k] *= effect_gain(e, level, amplitude)
    return into, out


def left_out(plant: ExtendedPlant, at: Any, amplitude: Mapping[str, float], pade: int) -> tuple[LeftOut, ...]:
    """What `linear_model` of the same arguments does not have, with footprints at the amplitudes (or at 1)."""
    from robustlab.dynamics.extended.extended_plant import LeftOut

    x, u = _point(plant, at)
    _check_options(plant, amplitude, pade)
    found: dict[int, LeftOut] = {}

    def note(e: AttachedEffect, reason: str) -> None:
        found.setdefault(id(e), LeftOut(e, reason, _footprint(e, amplitude)))

    for e, law, port in plant.laws:
        q = 0.0 if port.position is None else float(port.position @ x)
        v = float(port.velocity @ x)
        if sector(e, amplitude, ("speed", "current")) is not None:
            note(e, "the middle of its sector at this amplitude stands for it")
        elif law.memory:
            note(e, "it remembers: the model has its slopes at the point only")
        elif v == 0.0 and is_set_valued(law, q):
            note(e, "set-valued at rest: the model is that of free motion")
        else:
            note(e, "nonlinear: the model has its slopes at the point only")
    for e, _, level in signal_levels(plant, x, u):
        seen_by = _footprint(e, amplitude)
        if effect_delay(e):
            words = f"as a Padé approximation of order {pade}" if pade else "left out"
            note(e, f"a delay of {effect_delay(e):g} s, {words}")
        elif seen_by is not None and _constant_gain(e) is None:
            chosen = e.site.name in amplitude
            dead = not chosen and _slope(e, level) == 0.0
            stands = "the middle of its sector" if chosen else "its slope"
            note(e, "no gain at the point: 1 stands for it" if dead else f"nonlinear: {stands} stands for it")
        elif seen_by is not None and seen_by.offset:
            note(e, "a bounded error that is no gain")
    return tuple(found.values())


def _point(plant: ExtendedPlant, at: Any) -> tuple[Array, Array]:
    if at is None:
        at = plant.equilibrium()
    if isinstance(at, (Trim, OperatingPoint)):
        return plant.point(at.x, at.u)
    if isinstance(at, (tuple, list)) and len(at) == 2:
        return plant.point(*at)
    raise InputError("linearise: at", f"{type(at).__name__}", "a trim or (x, u), or None for the rest of the plant")


def signal_levels(plant: ExtendedPlant, x: Array, u: Array) -> list[tuple[AttachedEffect, int, float]]:
    """Effects on inputs and outputs, the index of their signal, and its value before the effect."""
    seen, shown = u.copy(), plant.model.C @ x + plant.model.D @ plant.mapped_input(u)
    found = []
    for e in plant.effects:
        if e.site.kind in ("input", "output"):
            signals, level = (plant.inputs, seen) if e.site.kind == "input" else (plant.outputs, shown)
            k = [s.name for s in signals].index(e.site.name)
            found.append((e, k, float(level[k])))
            level[k] = _mapped(e, level[k])
    return found


def _check_options(plant: ExtendedPlant, amplitude: Mapping[str, float], pade: int) -> None:
    sites = tuple(dict.fromkeys(e.site.name for e in plant.effects))
    for name, value in amplitude.items():
        if name not in sites:
            hint = did_you_mean(name, sites)
            raise InputError(f"linearise: amplitude {name!r}", "no effect there", f"one of {', '.join(sites)}", hint)
        if not (isinstance(value, (int, float)) and 0 < value < math.inf):
            raise InputError(f"linearise: amplitude {name!r}", f"{value!r}", "a positive number")
    if isinstance(pade, bool) or not isinstance(pade, int) or not 0 <= pade <= HIGHEST_PADE:
        raise InputError("linearise: pade", f"{pade!r}", f"an order from 0 to {HIGHEST_PADE}")


# --- footprints ------------------------------------------------------------------------------------------------------


def _footprint(e: AttachedEffect, amplitude: Mapping[str, float]) -> Footprint | None:
    return e.effect.footprint(e.site, e.values, amplitude.get(e.site.name, DEFAULT_AMPLITUDE))


def sector(e: AttachedEffect, amplitude: Mapping[str, float], signals: tuple[str, ...]) -> Footprint | None:
    """The footprint at an amplitude that was asked for, if it is a sector in one of these signals."""
    if e.site.name not in amplitude:
        return None
    found = _footprint(e, amplitude)
    return found if found is not None and found.signal in signals and found.gain_upper > found.gain_lower else None


def effect_delay(e: AttachedEffect) -> float:
    """Pure delay in s that an effect stands for."""
    found = _footprint(e, {})
    return 0.0 if found is None else found.delay


def _mapped(e: AttachedEffect, level: float) -> float:
    """The constant signal after the effect."""
    if e.site.kind == "input":
        return float(e.effect.input(np.full(8, level), e.values, 1e-3)[-1])
    return float(e.effect.output(np.full((1, 8), level), e.values, 1e-3)[0, -1])


def effect_gain(e: AttachedEffect, level: float, amplitude: Mapping[str, float]) -> float:
    """Gain of an effect on an input or output about a level of its signal, or the middle of its sector."""
    seen = sector(e, amplitude, ("input", "output"))
    if seen is not None:
        return 0.5 * (seen.gain_lower + seen.gain_upper)
    constant = _constant_gain(e)  # perhaps with a delay or an offset
    return constant if constant is not None else _slope(e, level) or 1.0


def _constant_gain(e: AttachedEffect) -> float | None:
    """The gain that the footprint has at all amplitudes, or None."""
    seen = [e.effect.footprint(e.site, e.values, amplitude) for amplitude in (1e-6, 1.0, 1e6)]
    gains = {gain for f in seen if f is not None for gain in (f.gain_lower, f.gain_upper)}
    return gains.pop() if len(gains) == 1 else None


def _slope(e: AttachedEffect, level: float) -> float:
    return extrapolated(
        lambda h: (_mapped(e, level + h) - _mapped(e, level - h)) / (2 * h), SIGNAL_STEP * max(abs(level), 1e-3)
    )


# --- delays ----------------------------------------------------------------------------------------------------------


def pade_delay(delay: float, order: int) -> tuple[Array, Array, Array, Array]:
    r"""A, B, C, D of the Padé approximation of :math:`e^{-s d}` of equal orders; an all-pass with the gain 1.

    Phase variables in units of the delay, so that entries are of moderate size.
    """
    n = order
    c = np.array([math.factorial(2 * n - k) * math.comb(n, k) / math.factorial(2 * n) for k in range(n + 1)])
    denominator, numerator = c / c[n], c * (-1.0) ** np.arange(n + 1) / c[n]
    direct = numerator[n]
    a = np.diag(np.ones(n - 1), 1)
    a[-1] = -denominator[:n]
    b = np.zeros((n, 1))
    b[-1] = 1.0
    read = (numerator[:n] - direct * denominator[:n])[None]
    return a / delay, b / delay, read, np.array([[direct]])


def _delayed(model: StateSpaceModel, delays: Mapping[str, list[float]], order: int) -> StateSpaceModel:
    """The model with the delays of its inputs and outputs as rational ones."""
    before, after = (_bank(delays[side], order) for side in ("input", "output"))
    whole = series(series(before, model), after)
    names = [
        (f"delay_{side}_{s.name}_{i + 1}", "")
        for side, signals in (("input", model.inputs), ("output", model.outputs))
        for s, delay in zip(signals, delays[side], strict=True)
        for i in range(order if delay else 0)
    ]
    first = before.n_states
    states = [*names[:first], *model.states, *names[first:]]
    point = model.operating_point
    assert point is not None
    settled = [_settled(bank, levels) for bank, levels in ((before, point.u), (after, point.y))]
    x = np.concatenate([settled[0], point.x, settled[1]])
    return StateSpaceModel(
        whole.A, whole.B, whole.C, whole.D, 0.0, model.inputs, model.outputs, states,
        OperatingPoint(x, point.u, point.y), "delays",
    )  # fmt: skip


def _bank(delays: list[float], order: int) -> StateSpaceModel:
    unit = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1)
    channels = [StateSpaceModel(*(pade_delay(delay, order) if delay else unit)) for delay in delays]
    return append(*(m.renamed([f"u{k}"], [f"y{k}"]) for k, m in enumerate(channels)))


def _settled(bank: StateSpaceModel, levels: Array) -> Array:
    """States of the bank at constant inputs."""
    return np.asarray(-np.linalg.solve(bank.A, bank.B @ levels), dtype=np.float64)
