"""Plants with effects as plants; the linear part of a linear one with its tolerances as an exact LFT."""
# Uncertain delays: Wang, Lundström, Skogestad, "Representation of uncertain time delays in the H-infinity framework",
# Int. J. Control 59 (1994).

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.delays.approximation import checked_order
from robustlab.delays.model import covering
from robustlab.dynamics.extended.attached_effect import POSITION_STEP, AttachedEffect, attach
from robustlab.dynamics.extended.extended_equations import NOMINAL_STEP, ExtendedEquations, extended_model
from robustlab.dynamics.extended.simulator import (
    About,
    Drive,
    Simulator,
    Windows,
    factors_of,
    load_coordinates,
    march,
    point_model,
    scaled,
    with_linear_parts,
)
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant, with_factors
from robustlab.dynamics.parameters import Parameter
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel, linear_plant_of, local_port_model
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, error_context
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.blocks import FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel, product

# Steps of a nonlinear plant are halved until the states change by less than this share of their RMS, and largest number
# of halvings.
HALVED = 1e-4
MOST_HALVINGS = 5
# Allowed difference of entries of an exact form, relative to the largest of the matrix.
FORM_ROUNDING = 1e-9

STILL = 1e-6  # rad, m, rad/s, m/s, A: smallest reference of relative differences


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedNonlinearPlant(ExtendedEquations):
    """A nonlinear plant with effects; made by `robustlab.dynamics.extended.extended_plant.with_effects`."""

    plant: NonlinearPlant
    changed: NonlinearPlant = field(init=False)  # with the parameters changed by effects

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "changed", scaled(self.plant, self.effects))

    def about(self, x: Array, seen: Array) -> About:
        return point_model(self.changed, self.effects, x, seen)

    def inertia_jacobian(self, x: Array, seen: Array, forces: Mapping[str, float]) -> Array:
        own, n = len(self.plant.states), len(self.states)
        rows = load_coordinates(self.plant, self.effects)
        at = rows @ x
        here, n_u = self.changed.local_models(at[None], seen[None]), len(seen)
        steps = POSITION_STEP * np.maximum(np.abs(at), 1.0)
        shifts = np.concatenate([k * np.diag(steps) for k in (1.0, -1.0, 0.5, -0.5)])
        local = self.changed.local_models(at + shifts, np.tile(seen, (len(shifts), 1)))
        model = with_linear_parts(local_port_model(self.changed, local), self.effects)
        if model.A is local.A and not any(forces.values()):
            return np.zeros((n, n))
        entering = model.B[..., n_u:]
        rates = model.A @ x + entering @ here.rates[0] - (entering @ local.A) @ at
        rates = rates + (model.B[..., :n_u] - entering @ local.B) @ seen
        for port, force in forces.items():
            rates = rates + force * model.ports[port].force
        up, down, near_up, near_down = rates.reshape(4, own, n)
        wide, narrow = ((a - b) / steps[:, None] for a, b in ((0.5 * up, 0.5 * down), (near_up, near_down)))
        return ((4.0 * narrow - wide) / 3.0).T @ rows

    def motion(
        self, u: Array, dt: float, t0: float, x0: Array, step: float | None, hold: Literal["zoh", "foh"] = "zoh"
    ) -> tuple[Array, Array]:
        parts = max(1, int(np.ceil(dt / (step or NOMINAL_STEP) - 1e-9)))
        states, outputs = self._stepped(_drive(self, u, dt, t0, parts, hold), x0, None)
        if step is not None:
            return states[::parts], outputs[::parts]
        off, units = np.inf, np.array([s.unit for s in self.states])
        for _ in range(MOST_HALVINGS):
            coarse, parts = states, 2 * parts
            between = np.arange(len(u) * parts) / 2.0
            guess = np.column_stack([np.interp(between, np.arange(len(coarse)), column) for column in coarse.T])
            states, outputs = self._stepped(_drive(self, u, dt, t0, parts, hold), x0, guess)
            found = states[::parts]
            size, off_by = (np.sqrt(np.mean(x**2, axis=0)) for x in (found, found - coarse[:: parts // 2]))
            # RMS difference, relative to the largest state of the same unit
            shares = [off_by[units == unit].max() / max(size[units == unit].max(), STILL) for unit in set(units)]
            off = float(max(shares, default=0.0))
            if off <= HALVED:
                return found, outputs[::parts]
        raise NoTrustworthyNumber(
            f"{self.name}: simulate",
            f"steps of {1e6 * dt / parts:.3g} us still change the motion by {off:.2g} of its size",
            None,
            "a step of your own, without error control: simulate(..., step=1e-4)",
        )

    def _stepped(self, drive: Drive, x0: Array, guess: Array | None) -> tuple[Array, Array]:
        """Return states and outputs at all steps of a drive."""
        own = len(self.plant.states)
        states = march(self.changed, self.effects, drive, self.whole_state(x0), guess)
        outputs = self.changed.outputs_along(states[:, :own], drive.mean - drive.rise).copy()
        for e in self.effects:
            if e.site.kind == "output":
                k = [s.name for s in self.outputs].index(e.site.name)
                outputs[:, k] = e.effect.output(outputs[None, :, k], e.values, drive.h)[0]
        return states, outputs

    def search_start(self, where: Mapping[str, Any]) -> tuple[Array, Mapping[str, Any]]:
        signals = {s.name for s in (*self.states, *self.inputs, *self.outputs)}
        given = {name: value for name, value in where.items() if name in signals}
        other = {name: value for name, value in where.items() if name not in signals}
        try:
            rest = self.changed.equilibrium(**where)
        except (InputError, NoTrustworthyNumber):
            if not other:
                return np.zeros(len(self.states) + len(self.inputs)), given
            rest = self.changed.equilibrium(**other)
        x, names = self.whole_state(rest.x).copy(), [s.name for s in self.states]
        joints = [p for p in self.plant.port_places if p.position]
        x[[names.index(p.name) for p in joints]] = 0.0  # rounding would mean sliding
        if other and rest.pose is not None:
            given |= {p.position: x[names.index(p.position)] for p in joints}
        return np.concatenate([x, rest.u]), given


def _drive(plant: ExtendedNonlinearPlant, u: Array, dt: float, t0: float, parts: int, hold: str) -> Drive:
    """Return the effective inputs in steps, ``parts`` per sample."""
    h = dt / parts
    if hold == "foh":  # of a loop, whose effects are not on its inputs
        between = np.arange(len(u) * parts + 1) / parts
        fine = np.column_stack([np.interp(between, np.arange(len(u)), column) for column in u.T])
        rise = 0.5 * np.diff(fine, axis=0)
        return Drive(fine[:-1] + rise, rise, h, t0)
    pairs, held = [(e.effect, e.site) for e in plant.effects], np.repeat(u, parts, axis=0)
    motion = np.zeros((2, len(plant.plant.states)))  # not simulated
    simulator = Simulator(plant.plant, pairs, held, h, sub=1, motion=motion)
    return Drive(*simulator.seen_input([e.values for e in plant.effects]), h, t0)


@dataclass(frozen=True, eq=False, repr=False)
class ExtendedPlant(ExtendedEquations):
    """A linear plant with effects; made by `with_effects`."""

    plant: LinearPlant

    def about(self, x: Array, seen: Array) -> About:
        model = self.model
        return About(model, model.A @ x + model.B @ seen, model.C @ x + model.D @ seen)

    def motion(self, u: Array, dt: float, t0: float, x0: Array, step: float | None) -> tuple[Array, Array]:
        return self.forced(u, dt, t0, x0, step)[:2]

    def forced(self, u: Array, dt: float, t0: float, x0: Array, step: float | None) -> tuple[Array, Array, Array]:
        """Return states, outputs, and the mean of each law's force over the samples, (n, n_laws)."""
        parts = max(1, int(np.ceil(dt / (step or NOMINAL_STEP) - 1e-9)))
        held = np.repeat(u, parts, axis=0)
        run = Simulator(self.plant, [(e.effect, e.site) for e in self.effects], held, dt / parts, t0)
        whole = Windows(np.zeros(1, dtype=np.int64), len(held))
        motion = run.run({}, [e.values for e in self.effects], x0[None], whole)
        forces = motion.forces[0, [*range(1, len(held)), -1]].reshape(len(u), parts, -1).mean(axis=1)
        return motion.states[0, ::parts], motion.outputs[0, ::parts], forces

    def to_model(self) -> StateSpaceModel:
        return self.linear_model()

    def uncertain(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, outputs: Sequence[str] | None = None, sigmas: float = 2.0
    ) -> UncertainModel:
        """Return all models within the tolerances as an exact LFT, without the effects in `left_out`."""
        width = number("uncertain: sigmas", sigmas, "0 or more", at_least=0)
        linear = self.linear_model()
        point = linear.operating_point
        assert point is not None
        signals = self.signal_levels(point.x, point.u)
        whole = with_signals(without_signals(self, linear, width).uncertain(), signals, {}, width)
        _check(self, whole, linear, width)
        if outputs is None:
            return UncertainModel(whole.M, whole.blocks, point)
        return UncertainModel(drop_unconnected(whole.select(outputs=outputs).M), whole.blocks)


@error_context("with_effects")
def with_effects(
    plant: AnyPlant | StateSpaceModel,
    effects: Mapping[str, Mapping[str, Any]] | Iterable[AttachedEffect] | AttachedEffect,
) -> Any:
    """Attach effects to a plant.

    Parameters
    ----------
    plant
        A linear plant, a continuous model whose velocity states have units, a nonlinear plant that declares where
        forces act, or a plant with effects.
    effects
        ``{"coulomb-friction": {"Fc": 5e-3}}``, with a value or (value, standard deviation) for each parameter of the
        effect, and ``"coulomb-friction@omega"`` if there are several places. Or attached effects.

    Returns
    -------
    ExtendedPlant or ExtendedNonlinearPlant
        A plant for `simulate`, `trim`, `linearise` and `save`.

    Raises
    ------
    InputError
        Unknown effect, parameter or place, no place or several, NaN, a nonlinear plant without linear models along a
        motion.

    Examples
    --------
    >>> from robustlab.dynamics import plant, simulate
    >>> axis = with_effects(plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    >>> simulate(axis, [0.0, 0.1, 0.2], [0.5, 0.5, 0.5])["v"]  # 0.5 V push with 17.6 N: it sticks
    array([0., 0., 0.])
    """
    base: AnyPlant
    if isinstance(plant, ExtendedEquations):
        base, attached = plant.plant, list(plant.effects)
    else:
        base, attached = plant if isinstance(plant, NonlinearPlant) else linear_plant_of(plant, "with_effects"), []
    if not isinstance(effects, AttachedEffect | Iterable):
        raise InputError("with_effects: effects", repr(effects), "effects with their parameters, {name: {...}}")
    given: Any = (effects,) if isinstance(effects, AttachedEffect) else effects
    for one in given:
        model = extended_model(base, attached)
        e = attach(one, given[one], base, model) if isinstance(effects, Mapping) else _checked(one, base, model)
        if any((other.effect.id, other.site) == (e.effect.id, e.site) for other in attached):
            raise InputError(f"effect {e.effect.id} at {e.site}", "given twice", "each effect once at a site")
        attached.append(e)
    if not attached:
        raise InputError("with_effects", "no effect", "at least one")
    model, states = extended_model(base, attached), list(base.states)
    for k in range(model.own, len(model.A)):  # added by effects, named after their ports
        unit = np.eye(len(model.A))[k]
        name, of = f"effect_state_{k - model.own + 1}", ""
        for port in model.ports.values():
            if port.position is not None and np.array_equal(port.position, unit):
                name, of = port.name, port.position_unit
            elif np.array_equal(port.velocity, unit):
                name, of = f"{port.name}.rate", port.speed_unit
        states.append(Signal(name, of))
    signals = base.inputs, base.outputs, tuple(states)
    if isinstance(base, NonlinearPlant):
        return ExtendedNonlinearPlant(base.name, base.parameters, *signals, base, tuple(attached))
    return ExtendedPlant(base.name, base.parameters, *signals, base, tuple(attached))


def _checked(e: Any, base: AnyPlant, model: PortModel) -> AttachedEffect:
    """Return the attached effect if the plant has its place."""
    if not isinstance(e, AttachedEffect):
        raise InputError("with_effects", f"{e!r}", "a table of effects, or attached effects")
    names = [site.name for site in e.effect.sites(base, model) if site.kind == e.site.kind]
    if e.site.name not in names:
        hint = did_you_mean(e.site.name, names)
        raise InputError(f"effect {e.effect.id}: site {e.site.name!r}", "no such place", ", ".join(names), hint)
    return e


def without_signals(plant: ExtendedPlant, linear: StateSpaceModel, width: float) -> LinearPlant:
    """Return the linear model as a plant in descriptor form, affine in the parameters with tolerances."""
    base, scaled = plant.plant, _scaled_values(plant)
    parameters = {name: replace(p, value=scaled[name]) for name, p in base.parameters.items()}
    tied: dict[str, list[str]] = {}
    for e in plant.effects:
        names = list(factors_of(base, [e]))
        if not (names and e.scale and e.scale_std):
            continue
        tolerance = width * e.scale_std / e.scale
        for name in names:
            parameters[name] = replace(parameters[name], tolerance=tolerance if len(names) == 1 else 0.0)
        if len(names) > 1:
            label = f"{e.effect.id}({e.site.name})"
            parameters[label] = Parameter(
                label, 1.0, "", tolerance, e.source, f"{e.effect.title}, over the fitted value"
            )
            tied[label] = names
    terms = _joint_terms(plant, linear, width)
    parameters |= {label: parameter for label, (parameter, _) in terms.items()}
    structure = _structure(plant, linear)
    nominal = structure(scaled)
    constant = nominal[0] @ linear.A - nominal[1]
    matrices = with_factors(structure, base.parameters, scaled, tied)

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f, g, c, d = matrices(p)
        for label, (parameter, per_unit) in terms.items():
            f = f + (p[label] - parameter.value) * per_unit
        return Descriptor(e, f + constant, g, c, d)

    return LinearPlant(plant.name, parameters, plant.inputs, plant.outputs, plant.states, equations, base.exact)


def _scaled_values(plant: ExtendedPlant) -> dict[str, float]:
    base, factors = plant.plant, factors_of(plant.plant, plant.effects)
    return base.values | {name: base.parameters[name].reference * factor for name, factor in factors.items()}


def _joint_terms(plant: ExtendedPlant, linear: StateSpaceModel, width: float) -> dict[str, tuple[Parameter, Array]]:
    """Return fitted springs and dampers at joints: parameter, and the entries of F per unit of it."""
    found: dict[str, tuple[Parameter, Array]] = {}
    inertia = _structure(plant, linear)(_scaled_values(plant))[0]
    for e in plant.effects:
        if e.site.kind not in ("joint", "current") or e.laws() or e.effect.structural:  # a split joint stays nominal
            continue
        for parameter in e.parameters:
            value, std = e.values[parameter.name], e.std.get(parameter.name, 0.0)
            if not std:
                continue
            first, second = (
                extended_model(plant.plant, [other if item is e else item for item in plant.effects]).A - plant.model.A
                for share in (1.25, 1.5)
                for other in [replace(e, values={**e.values, parameter.name: share * value})]
            )
            if not np.allclose(second, 2.0 * first, rtol=FORM_ROUNDING, atol=0.0):
                continue
            label = f"{e.key}.{parameter.name}"
            tolerance = width * std / abs(value)
            per_unit = inertia @ first / (0.25 * value)
            found[label] = Parameter(label, value, parameter.unit, tolerance, e.source, e.effect.title), per_unit
    return found


def _structure(plant: ExtendedPlant, linear: StateSpaceModel) -> Callable[[Mapping[str, float]], list[Array]]:
    """Return a function from parameter values to E, F, G, C, D of all states, without a constant part of F."""
    base, own, size = plant.plant, plant.model.own, len(plant.states)
    inertia = base.matrices(_scaled_values(plant))[0]
    split: list[tuple[int, int, float]] = []  # joint, its relative position, the load's share
    for name, port in plant.model.ports.items():
        if name.endswith(".load"):
            joint = [s.name for s in plant.states].index(name.removesuffix(".load"))
            rate = int(np.flatnonzero(port.velocity[own:])[0]) + own
            split.append((joint, rate - 1, 1.0 / (float(port.velocity @ port.force) * inertia[joint, joint])))

    def matrices(values: Mapping[str, float]) -> list[Array]:
        e0, f0, g0, c0, d0 = base.matrices(values)
        e, f, g = np.eye(size), np.zeros((size, size)), np.zeros((size, g0.shape[1]))
        e[:own, :own], f[:own, :own], g[:own] = e0, f0, g0
        for joint, first, share in split:
            e[joint, joint] = (1.0 - share) * e0[joint, joint]
            f[joint, first : first + 2] = e[joint, joint] * linear.A[joint, first : first + 2]
            e[first + 1, joint] = -1.0
        return [e, f, g, np.hstack([c0, np.zeros((len(c0), size - own))]), d0]

    return matrices


def _check(plant: ExtendedPlant, whole: UncertainModel, linear: StateSpaceModel, width: float) -> None:
    """Check that the set includes the nominal model, and the plant with every deviation at its upper end."""
    changed = {n: (p.value + p.radius, 0.0) for n, p in plant.parameters.items() if p.tolerance}
    terms, effects = _joint_terms(plant, linear, width), []
    for e in plant.effects:
        scaled_by = factors_of(plant.plant, [e])
        for name in scaled_by if e.scale_std else ():
            changed.pop(name, None)
        moved = {n for n in e.std if f"{e.key}.{n}" in terms or (n == e.effect.scale and (e.on_signal or scaled_by))}
        effects.append(replace(e, values={n: v + width * e.std[n] if n in moved else v for n, v in e.values.items()}))
    rebuilt = with_effects(plant.plant.with_parameters(**changed), effects)
    point = linear.operating_point
    for delta, other in ((0.0, linear), (1.0, rebuilt.linear_model(point))):
        found = whole.evaluate({block.name: delta for block in whole.blocks})
        for name in "ABCD":
            off = np.abs(getattr(found, name) - getattr(other, name)).max(initial=0.0)
            if off > FORM_ROUNDING * np.abs(getattr(other, name)).max(initial=0.0):
                raise NoTrustworthyNumber(
                    f"{plant.name}: uncertain",
                    f"the form is not exact: {name} is off by {off:.2g} at delta = {delta:g}",
                    None,
                    "take the tolerances off the parameters that act together with an effect, or take it off",
                )


def _lag_block(time: float, spread: float, name: str, origin: str) -> UncertainModel:
    """Return the exact set of all lags :math:`1 / (1 + s T)` with T within ``spread`` of ``time``, in s."""
    if not 0.0 <= spread < time:
        raise InputError(f"lag {name}", f"{time:g} s +- {spread:g} s", "a time constant that stays positive")
    a = -1.0 / time
    if not spread:
        return UncertainModel(StateSpaceModel([[a]], [[-a]], [[1.0]], [[0.0]]), [])
    model = StateSpaceModel([[a]], [[a * spread, -a]], [[a], [1.0]], [[a * spread, -a], [0.0, 0.0]])
    return UncertainModel(model, [RealScalar(name, 1, ParameterRange(time, spread, "s"), origin=origin)])


def delay_block(delay: float, spread: float, pade: int, name: str, origin: str = "") -> UncertainModel:
    r"""Return a cover :math:`P + w \Delta` of all delays from ``delay - spread`` (at least 0) to ``delay + spread``."""
    n = checked_order(pade, "delay_block", 1)
    # With a spread the error's slope changes from 1 to 2 n + 1: a weight of lower order fits better.
    made = covering(delay, spread, n, n + 1 if spread else min(n + 2, 2 * n + 1))
    return UncertainModel(made.M, [FullBlock(name, 1, 1, origin=origin, covers=made.blocks[0].covers)])


def with_signals(
    whole: UncertainModel,
    signals: Sequence[tuple[AttachedEffect, int, float]],
    amplitude: Mapping[str, float],
    width: float,
    pade: int = 0,
) -> UncertainModel:
    """Add uncertain gains of effects (effect, index of signal, level), and with ``pade`` their delays and lags."""
    into, out = ([s for s in signals if s[0].site.kind == kind] for kind in ("input", "output"))
    for e, k, level in [*reversed(into), *out]:  # the effect next to the plant first
        for block in _signal_blocks(e, level, amplitude, width, pade):
            if e.site.kind == "input":
                whole = product(whole, _at_channel(block, whole.inputs, k, e.key))
            else:
                whole = product(_at_channel(block, whole.outputs, k, e.key), whole)
    return whole


def _signal_blocks(
    e: AttachedEffect, level: float, amplitude: Mapping[str, float], width: float, pade: int
) -> list[UncertainModel]:
    """Return the blocks of an effect in its signal: an uncertain gain, a delay, a lag."""
    found: list[UncertainModel] = []
    gain, seen = e.gain(level, amplitude), e.sector(amplitude, ("input", "output"))
    reach = width * e.scale_std if seen is None else 0.5 * (seen.gain_upper - seen.gain_lower)
    if reach:
        words = f"{e.in_words}" + ("" if seen is None else " as a sector") + f"; {e.values_in_words}"
        block = RealScalar(e.key, 1, ParameterRange(gain, reach), origin=words)
        found.append(UncertainModel(StateSpaceModel([], [], [], [[0.0, reach], [1.0, gain]]), [block]))
    elif gain != 1.0:
        found.append(UncertainModel(StateSpaceModel([], [], [], [[gain]]), []))
    if e.delay and pade:
        spread = width * e.std.get(e.effect.delay, 0.0)
        words = f"{e.in_words}, {e.delay:.6g} s +- {spread:.3g} s, as Padé of order {pade} and a weight proved to cover"
        words = f"{words} what that misses; {e.values_in_words}"
        found.append(delay_block(e.delay, spread, pade, e.key, words))
    if e.time_constant and pade:
        spread = width * e.std.get(e.effect.time_constant, 0.0)
        words = f"{e.in_words}, {e.time_constant:.6g} s +- {spread:.3g} s; {e.values_in_words}"
        found.append(_lag_block(e.time_constant, spread, e.key, words))
    return found


def _at_channel(block: UncertainModel, signals: Sequence[Signal], k: int, name: str) -> UncertainModel:
    """Return the block of this name in signal k, with identity in all others."""
    g, (q, p), n = block.M, block.delta_shape, len(signals)
    into, out = np.zeros((q + 1, q + n)), np.zeros((p + n, p + 1))
    into[:q, :q], into[q, q + k] = np.eye(q), 1.0
    out[:p, :p], out[p + k, p] = np.eye(p), 1.0
    passed = np.zeros((p + n, q + n))
    passed[p:, q:] = np.diag(np.arange(n) != k)
    model = StateSpaceModel(
        g.A, g.B @ into, out @ g.C, out @ g.D @ into + passed, 0.0,
        [*(f"w_{name}" for _ in range(q)), *signals], [*(f"z_{name}" for _ in range(p)), *signals],
        [f"{name} {i + 1}" for i in range(g.n_states)], where="effect_blocks",
    )  # fmt: skip
    return UncertainModel(model, block.blocks)
