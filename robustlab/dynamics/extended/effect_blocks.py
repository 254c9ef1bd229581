r"""Effects become uncertainty: the linear model of a plant with effects, and a block for all that it is not.

==========================  ==========================================================================================
what                        becomes
==========================  ==========================================================================================
tolerance of a parameter    a real parameter with its range; so do fitted gains, springs and dampers, by their std
force law                   a real parameter (a gain between the ends of its sector) or an input of size one (a bounded
                            force), or both: see `robustlab.dynamics.extended.force_blocks`
sector at an input, output  a real parameter at that signal
delay                       Padé approximation P and one dynamic block, :math:`P + w \Delta`, with
                            :math:`|w(j\omega)| \ge |e^{-j\omega d} - P(j\omega)|` for all d within its std
bounded error               an input of its own, scaled so that its signal is at most one: quantisation as noise of half
                            a step, a constant load, a bias
==========================  ==========================================================================================

Every block says where it comes from and for which motions it holds (``origin``). What none of these holds is listed
with a reason.

References
----------
Gelb, Vander Velde, *Multiple-Input Describing Functions* (1968), chapter 2; Wang, Lundström, Skogestad, "Representation
of uncertain time delays in the H-infinity framework", Int. J. Control 59 (1994); Březina 2010, section 4.2.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_linear_model import (
    effect_delay,
    effect_gain,
    linear_model,
    pade_delay,
    sector,
    signal_levels,
)
from robustlab.dynamics.extended.extended_uncertainty import GAINS, without_signals
from robustlab.dynamics.extended.force_blocks import (
    Amplitude,
    Dry,
    ForceParts,
    ForceSector,
    check_amplitudes,
    force_columns,
    force_parts,
    largest_offset,
    values_in_words,
)
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant, tied_plant
from robustlab.dynamics.ports.port_model import port_model
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.frequency import frequency_response
from robustlab.result import Status
from robustlab.statespace import Signal, StateSpaceModel, real_array
from robustlab.structural import drop_unconnected
from robustlab.uncertainty.blocks import FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.covering.overbound import Overbound, overbound
from robustlab.uncertainty.lft import UncertainModel, product

if TYPE_CHECKING:
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

__all__ = ["EffectBlocks", "NoiseInput", "delay_block", "effect_blocks", "with_forces"]


# The nominal set must be the plant's own linear model to this share of its largest response.
EXACT = 1e-8
# The weight of a delay need not go below this: far beneath any other error.
LEAST_ERROR = 1e-3
# The error grows with the power 2 n + 1 of the frequency: the weight's order over that of the Padé part.
WEIGHT_EXTRA = 2


@dataclass(frozen=True)
class NoiseInput:
    """An input of the set that stands for a bounded error: its signal is at most one.

    Attributes
    ----------
    name
        Of the input.
    bound, unit
        What one stands for.
    origin
        Where it comes from.
    """

    name: str
    bound: float
    unit: str
    origin: str

    def to_json(self) -> dict[str, Any]:
        """All fields."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class EffectBlocks:
    """A plant with effects as an uncertain model.

    Attributes
    ----------
    model
        Its inputs are those of ``noise``, then the plant's.
    noise
        Inputs for bounded errors.
    left_out
        Effect at its place -> why it is in no block.
    approximate
        Names of the blocks that hold by harmonic balance only: for oscillations, not for every motion.
    status
        CONVERGED: the nominal member was found to be the plant's own linear model.
    """

    model: UncertainModel
    noise: tuple[NoiseInput, ...]
    left_out: Mapping[str, str]
    approximate: tuple[str, ...] = ()
    status: Status = Status.CONVERGED

    @property
    def origins(self) -> dict[str, str]:
        """Block name -> where it comes from."""
        return {b.name: b.origin for b in self.model.blocks}

    def rest(self) -> list[str]:
        """One line for each noise input and each effect that is left out."""
        return [
            *(f"input {n.name}: at most {n.bound:.4g} {n.unit}, {n.origin}" for n in self.noise),
            *(f"not in it: {name}: {reason}" for name, reason in self.left_out.items()),
        ]

    def summary(self) -> str:
        """One line for each block, input and effect that is left out."""
        return "\n".join([*(f"{name}: {origin}" for name, origin in self.origins.items()), *self.rest()])

    def to_json(self) -> dict[str, Any]:
        """All attributes and the origins."""
        return {"type": "EffectBlocks", **vars(self), "origins": self.origins}


def effect_blocks(
    plant: Any,
    outputs: Sequence[str] | None = None,
    *,
    sigmas: float = 2.0,
    amplitude: Mapping[str, Amplitude] | None = None,
    dry: Dry | None = None,
    pade: int = 2,
    unnamed: tuple[float, str] | None = None,
    tied: Sequence[tuple[str, tuple[str, ...]]] = (),
) -> EffectBlocks:
    """The uncertain model of a plant with or without effects.

    Parameters
    ----------
    plant
        `LinearPlant` or `ExtendedPlant`.
    outputs
        Outputs to keep, all where left out.
    sigmas
        Half width of the range of a fitted value in its standard deviations.
    amplitude
        Name of a joint, position state, input or output -> amplitude of its signal at which the effects there are
        described, or (least, largest) amplitude. Needed for a force that grows with the motion, and for a driver's or
        sensor's sector. For dry friction the least that matters: the gain of its describing function is
        4 Fc / (pi amplitude) there and falls from there on.
    dry
        What becomes of bounded forces such as dry friction: ``"load"`` an input, exact at every speed; ``"gain"`` a
        gain with the range of its describing function; ``"both"``. Where left out, a gain where an amplitude is given,
        else an input.
    pade
        Order of the Padé approximation of delays, 1..8.
    unnamed
        Bound and origin of a force at the first joint that nothing explains; none where left out.
    tied
        Groups of parameters that move together, as `robustlab.dynamics.linear_plant.tied_plant` takes them.

    Raises
    ------
    InputError
        An effect with a sector at a place without an amplitude; an amplitude at a place without an effect; no plant.
    NoTrustworthyNumber
        The blocks do not give back the plant's own linear model.
    """
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

    width = float(real_array("sigmas", sigmas, 0, "effect_blocks"))
    if width < 0:
        raise InputError("effect_blocks: sigmas", f"{width:g}", "0 or more")
    if isinstance(pade, bool) or not isinstance(pade, int) or not 1 <= pade <= 8:
        raise InputError("effect_blocks: pade", f"{pade!r}", "an order from 1 to 8")
    if isinstance(plant, LinearPlant):
        if amplitude:
            raise InputError("effect_blocks: amplitude", f"{plant.name} has no effects", "none")
        loads = _unnamed(port_model(plant), unnamed)
        inner = tied_plant(plant, tied)
        whole = _told(with_forces(inner, [port for _, port in loads]).uncertain(), inner)
        return _kept(_with_noise(plant, whole, loads, ()), outputs)
    if not isinstance(plant, ExtendedPlant):
        raise InputError("effect_blocks", type(plant).__name__, "a linear plant, with or without effects")
    if dry not in (None, *get_args(Dry)):
        raise InputError("effect_blocks: dry", f"{dry!r}", f"one of {', '.join(get_args(Dry))}")
    return _kept(_of_extended(plant, width, dict(amplitude or {}), dry, pade, unnamed, tied), outputs)


def _kept(made: EffectBlocks, outputs: Sequence[str] | None) -> EffectBlocks:
    if outputs is None:
        return made
    m, (_, p) = made.model.M, made.model.delta_shape
    kept = drop_unconnected(m.select(m.input_names, [*m.output_names[:p], *outputs]))
    return dataclasses.replace(made, model=UncertainModel(kept, made.model.blocks))


def _of_extended(
    plant: ExtendedPlant,
    width: float,
    amplitude: dict[str, Amplitude],
    dry: Dry | None,
    pade: int,
    unnamed: tuple[float, str] | None,
    tied: Sequence[tuple[str, tuple[str, ...]]],
) -> EffectBlocks:
    check_amplitudes(plant, amplitude)
    parts = force_parts(plant, amplitude, dry, width)
    levels = _signal_amplitudes(plant, amplitude)
    linear = linear_model(plant, None, levels, 0, parts.stand_in)
    point = linear.operating_point
    assert point is not None
    loads = [*_loads(parts), *_unnamed(plant.model, unnamed)]
    drivers = _driver_errors(plant, amplitude, width)
    inner = tied_plant(without_signals(plant, linear, width), tied)
    ways = [*(s.port for s in parts.sectors), *(port for _, port in loads)]
    whole = _told(with_forces(inner, ways, parts.sectors).uncertain(), inner)
    whole, approximate = _with_sectors(whole, parts.sectors, len(plant.inputs))
    signals = signal_levels(plant, point.x, point.u)
    for e, k, level in reversed([s for s in signals if s[0].site.kind == "input"]):
        for gadget in _gadgets(e, level, levels, width, pade):
            whole = product(whole, _at_channel(gadget, whole.inputs, k))
    for e, k, level in [s for s in signals if s[0].site.kind == "output"]:
        for gadget in _gadgets(e, level, levels, width, pade):
            whole = product(_at_channel(gadget, whole.outputs, k), whole)
    made = _with_noise(plant, whole, loads, signals, width, drivers)
    _check(linear_model(plant, None, levels, pade, parts.stand_in), plant.name, made)
    left = {**parts.left_out, **_left_out(signals)}
    return dataclasses.replace(made, left_out=left, approximate=tuple(approximate))


def _signal_amplitudes(plant: ExtendedPlant, amplitude: Mapping[str, Amplitude]) -> dict[str, float]:
    """The amplitudes of drivers and sensors; those with a sector must have one."""
    missing = {
        e.site.name: e.effect.title
        for e in plant.effects
        if e.site.kind in ("input", "output")
        and e.site.name not in amplitude
        and sector(e, {e.site.name: 1.0}, ("input", "output")) is not None
        and e.effect.id not in GAINS
        and not _is_bounded_error(plant, e)
    }
    if missing:
        name, title = next(iter(missing.items()))
        raise InputError(
            "effect_blocks", f"{title} at {name} without an amplitude", f"amplitude for {', '.join(missing)}",
            "the amplitude of the signal there at which the effect is to be described",
        )  # fmt: skip
    places = {e.site.name for e in plant.effects if e.site.kind in ("input", "output")}
    return {n: float(a[1] if isinstance(a, (tuple, list)) else a) for n, a in amplitude.items() if n in places}


def _is_bounded_error(plant: ExtendedPlant, e: AttachedEffect) -> bool:
    """Whether a driver adds no more than a bounded error to an input that nothing else scales."""
    others = [o for o in plant.effects if o.site == e.site and o is not e and o.effect.id in GAINS]
    return e.site.kind == "input" and e.effect.input_error(e.values) is not None and not others


def _driver_errors(
    plant: ExtendedPlant, amplitude: Mapping[str, Amplitude], width: float
) -> list[tuple[NoiseInput, int]]:
    """A driver without an amplitude as what it adds to its input at most, and the number of the input."""
    found = []
    for e in plant.effects:
        if e.site.name in amplitude or not _is_bounded_error(plant, e):
            continue
        k = [s.name for s in plant.inputs].index(e.site.name)
        largest = {n: v + width * e.std.get(n, 0.0) for n, v in e.values.items()}
        bound = e.effect.input_error(largest)
        assert bound is not None
        words = f"{e.effect.title} at {e.site.name} as a bounded error, for every motion; {values_in_words(e)}"
        found.append((NoiseInput(f"load {e.site.name}: {e.effect.id}", bound, plant.inputs[k].unit, words), k))
    return found


def _loads(parts: ForceParts) -> list[tuple[NoiseInput, Any]]:
    """An input for every bounded force."""
    found, taken = [], []
    for b in parts.bounded:
        e = b.effect
        (name,) = _free([f"load {e.site.name}: {e.effect.id}"], taken)
        taken.append(name)
        words = f"{e.effect.title} at {e.site.name} as a bounded force, for every motion; {values_in_words(e)}"
        found.append((NoiseInput(name, b.bound, b.port.unit, words), b.port))
    return found


def _unnamed(model: Any, given: tuple[float, str] | None) -> list[tuple[NoiseInput, Any]]:
    """An input for a force that nothing explains, at the first joint."""
    if given is None:
        return []
    port = next((p for p in model.ports.values() if p.kind == "joint"), None)
    if port is None:
        raise InputError("effect_blocks: unnamed", "a plant without joints", "a joint at which the force acts")
    bound = float(real_array("unnamed", given[0], 0, "effect_blocks"))
    if bound <= 0:
        raise InputError("effect_blocks: unnamed", f"a force of {bound:g} {port.unit}", "a positive bound")
    return [(NoiseInput(f"load {port.name}: unnamed", bound, port.unit, given[1]), port)]


# --- the plant between drivers and sensors ---------------------------------------------------------------------------


def with_forces(plant: LinearPlant, ports: Sequence[Any], sectors: Sequence[ForceSector] = ()) -> LinearPlant:
    """The plant with a force at each port as further inputs, and what the first ones' sectors see as outputs, too."""
    if not ports:
        return plant
    nominal = np.asarray(plant.matrices(plant.values)[0], dtype=np.float64)
    original = plant.equations

    def equations(p: Mapping[str, float]) -> Descriptor:
        given = original(p)
        e, f, g, c = (np.asarray(m, dtype=np.float64) for m in (given.E, given.F, given.G, given.C))
        d = np.zeros((len(c), g.shape[1])) if given.D is None else np.asarray(given.D, dtype=np.float64)
        push, seen_c, seen_d = force_columns((nominal, f, g), ports, sectors)
        wide = np.vstack([np.hstack([d, np.zeros((len(c), len(ports)))]), seen_d])
        return Descriptor(e, f, np.hstack([g, push]), np.vstack([c, seen_c]), wide)

    inputs = (*plant.inputs, *(Signal(f"force {i} at {p.name}", p.unit) for i, p in enumerate(ports)))
    seen = (Signal(f"{s.signal} {i} at {s.port.name}", s.port.speed_unit) for i, s in enumerate(sectors))
    return LinearPlant(
        plant.name, plant.parameters, inputs, (*plant.outputs, *seen), plant.states, equations, plant.exact
    )


def _told(uncertain: UncertainModel, plant: LinearPlant) -> UncertainModel:
    """The same with an origin for every parameter."""
    blocks = []
    for b in uncertain.blocks:
        p = plant.parameters[b.name]
        text = f"parameter {b.name} = {p.value:.6g} {p.unit}".rstrip()
        text += f", {p.meaning}" if p.meaning else ""
        blocks.append(dataclasses.replace(b, origin=text + (f"; {p.source}" if p.source else "")))
    return UncertainModel(uncertain.M, blocks, uncertain.operating_point)


def _with_sectors(whole: UncertainModel, sectors: Sequence[ForceSector], n_u: int) -> tuple[UncertainModel, list[str]]:
    """The forces of the sectors closed over what they see: ``f = -r delta s``; the middle is in the plant already.

    Also the names of the blocks that hold by harmonic balance only.
    """
    k = len(sectors)
    if not k:
        return whole, []
    m, (q, p) = whole.M, whole.delta_shape
    n_y = len(whole.outputs)
    force = list(range(q + n_u, q + n_u + k))
    rest_in = [j for j in range(m.n_inputs) if j not in force]
    seen = list(range(p + n_y - k, p + n_y))
    columns = rest_in[:q] + force + rest_in[q:]
    rows = [*range(p), *seen, *range(p, p + n_y - k)]
    scale = np.ones(m.n_inputs)
    scale[q : q + k] = [s.radius if s.signal == "force" else -s.radius for s in sectors]
    names = _free([f"{s.effect.effect.id}@{s.effect.site.name}" for s in sectors], [b.name for b in whole.blocks])
    ins, outs = list(m.inputs), list(m.outputs)
    model = StateSpaceModel(
        m.A, m.B[:, columns] * scale, m.C[rows], m.D[np.ix_(rows, columns)] * scale, m.dt,
        [*ins[:q], *(f"w_{n}" for n in names), *(ins[j] for j in rest_in[q:])],
        [*outs[:p], *(f"z_{n}" for n in names), *outs[p : p + n_y - k]],
        m.states, where="effect_blocks",
    )  # fmt: skip
    blocks = [
        RealScalar(name, 1, ParameterRange(s.middle, s.radius, s.unit), origin=_sector_words(s))
        for name, s in zip(names, sectors, strict=True)
    ]
    found = UncertainModel(model, [*whole.blocks, *blocks], whole.operating_point)
    return found, [name for name, s in zip(names, sectors, strict=True) if s.approximate]


def _sector_words(s: ForceSector) -> str:
    e = s.effect
    seen = "of the force there" if s.signal == "force" else f"of its {s.signal}"
    return f"{e.effect.title} at {e.site.name} as a sector {seen}; {s.valid}; {values_in_words(e)}"


# --- drivers and sensors ---------------------------------------------------------------------------------------------


def _gadgets(
    e: AttachedEffect, level: float, amplitude: Mapping[str, float], width: float, pade: int
) -> list[UncertainModel]:
    """What an effect puts into its signal: a gain with a range, a delay."""
    found, name = [], f"{e.effect.id}@{e.site.name}"
    gain = effect_gain(e, level, amplitude)
    seen = sector(e, amplitude, ("input", "output"))
    reach = width * e.std.get("s", 0.0) if e.effect.id in GAINS else 0.0
    if seen is not None:
        reach = 0.5 * (seen.gain_upper - seen.gain_lower)
    if reach:
        words = (
            f"{e.effect.title} at {e.site.name}" + ("" if seen is None else " as a sector") + f"; {values_in_words(e)}"
        )
        block = RealScalar(name, 1, ParameterRange(gain, reach), origin=words)
        found.append(UncertainModel(StateSpaceModel([], [], [], [[0.0, reach], [1.0, gain]]), [block]))
    elif gain != 1.0:
        found.append(UncertainModel(StateSpaceModel([], [], [], [[gain]]), []))
    delay = effect_delay(e)
    if delay:
        spread = width * e.std.get("d", 0.0)
        model, _ = delay_block(delay, spread, pade, name)
        words = f"{e.effect.title} at {e.site.name}, {delay:.6g} s +- {spread:.3g} s, as Padé of order {pade}"
        block = dataclasses.replace(
            model.blocks[0], origin=f"{words} and a weight over what that misses; {values_in_words(e)}"
        )
        found.append(UncertainModel(model.M, [block]))
    return found


def delay_block(delay: float, spread: float, pade: int, name: str) -> tuple[UncertainModel, Overbound]:
    r"""All delays from ``delay - spread`` (at least 0) to ``delay + spread`` as :math:`P + w \Delta`.

    .. math:: |w(j\omega)| \ge \max_{d} |e^{-j \omega d} - P(j\omega)| = 2 \sin\bigl(\tfrac12 \min(\pi,
       \max_d |\omega d + \arg P(j\omega)|)\bigr)

    Parameters
    ----------
    delay, spread
        In s; the delay positive.
    pade
        Order of P.
    name
        Of the block.

    Returns
    -------
    tuple
        The set, and the weight with its bound, ``hypot(bound, 1e-3)``.
    """
    if not 0 < delay < np.inf or not 0 <= spread < np.inf:
        raise InputError("delay_block", f"{delay:g} s +- {spread:g} s", "a positive delay, a spread of 0 s or more")
    a, b, c, d = pade_delay(delay, pade)
    rational = StateSpaceModel(a, b, c, d)
    zeros = -rational.poles()

    def error(omega: Array) -> Array:
        # The phase of an all-pass is that of its poles and zeros, counted without wrapping.
        s = 1j * np.asarray(omega)[:, None]
        lag = -2.0 * np.angle((zeros - s) / zeros).sum(axis=1)
        low, high = omega * max(delay - spread, 0.0), omega * (delay + spread)
        off = np.maximum(np.abs(low - lag), np.abs(high - lag))
        return np.hypot(2.0 * np.sin(0.5 * np.minimum(off, np.pi)), LEAST_ERROR)

    omega = np.geomspace(1e-3, 1e3, 160) / delay
    fit = overbound(omega, error(omega), pade + WEIGHT_EXTRA, 0.1, exact=error)
    fit = _above_beyond(fit, np.geomspace(1e3, 1e8, 200) / delay, error)
    w, n = fit.weight, pade
    model = StateSpaceModel(
        np.block([[a, np.zeros((n, w.n_states))], [np.zeros((w.n_states, n)), w.A]]),
        np.block([[np.zeros((n, 1)), b], [np.zeros((w.n_states, 1)), w.B]]),
        np.block([[np.zeros((1, n)), w.C], [c, np.zeros((1, w.n_states))]]),
        np.array([[0.0, w.D[0, 0]], [1.0, d[0, 0]]]),
    )
    return UncertainModel(model, [FullBlock(name, 1, 1)]), fit


def _above_beyond(fit: Overbound, omega: Array, error: Callable[[Array], Array]) -> Overbound:
    """The weight, lifted where it falls below the error at frequencies above those of its fit."""
    w = fit.weight
    lift = float((error(omega) / np.abs(frequency_response(w, omega)[:, 0, 0])).max())
    if lift <= 1.0:
        return fit
    excess, lowest = ((1.0 + x) * lift - 1.0 for x in (fit.excess, fit.lowest))
    raised = StateSpaceModel(w.A, w.B, lift * w.C, lift * w.D)
    return dataclasses.replace(fit, weight=raised, excess=excess, lowest=lowest, magnitude=lift * fit.magnitude)


def _at_channel(gadget: UncertainModel, signals: Sequence[Signal], k: int) -> UncertainModel:
    """The gadget in signal k, all others passed on."""
    g, (q, p), n = gadget.M, gadget.delta_shape, len(signals)
    b, c = np.zeros((g.n_states, q + n)), np.zeros((p + n, g.n_states))
    b[:, :q], b[:, q + k] = g.B[:, :q], g.B[:, q]
    c[:p], c[p + k] = g.C[:p], g.C[p]
    d = np.zeros((p + n, q + n))
    d[p:, q:] = np.eye(n)
    d[:p, :q], d[:p, q + k], d[p + k, :q], d[p + k, q + k] = g.D[:p, :q], g.D[:p, q], g.D[p, :q], g.D[p, q]
    name = gadget.blocks[0].name if gadget.blocks else "gain"
    model = StateSpaceModel(
        g.A, b, c, d, 0.0, [*(f"w_{name}" for _ in range(q)), *signals], [*(f"z_{name}" for _ in range(p)), *signals],
        [f"{name} {i + 1}" for i in range(g.n_states)], where="effect_blocks",
    )  # fmt: skip
    return UncertainModel(model, gadget.blocks)


def _with_noise(
    plant: LinearPlant | ExtendedPlant,
    whole: UncertainModel,
    loads: Sequence[tuple[NoiseInput, Any]],
    signals: Sequence[tuple[AttachedEffect, int, float]],
    width: float = 0.0,
    drivers: Sequence[tuple[NoiseInput, int]] = (),
) -> EffectBlocks:
    """Bounded errors as inputs of size one, before the plant's own."""
    m, (q, p) = whole.M, whole.delta_shape
    n_u = len(plant.inputs)
    noise: list[NoiseInput] = []
    columns_b, columns_d = [], []
    for i, (load, _) in enumerate(loads):
        j = q + n_u + i
        noise.append(load)
        columns_b.append(load.bound * m.B[:, j])
        columns_d.append(load.bound * m.D[:, j])
    for load, k in drivers:
        noise.append(load)
        columns_b.append(load.bound * m.B[:, q + k])
        columns_d.append(load.bound * m.D[:, q + k])
    for e, k, _ in signals:
        bound = largest_offset(e, width)
        if e.site.kind == "output" and bound:
            signal = plant.outputs[k]
            noise.append(NoiseInput(f"noise {signal.name}: {e.effect.id}", bound, signal.unit, _bounded(e)))
            columns_b.append(np.zeros(m.n_states))
            columns_d.append(bound * np.eye(m.n_outputs)[p + k])
    between_b = np.array(columns_b).reshape(len(noise), m.n_states).T
    between_d = np.array(columns_d).reshape(len(noise), m.n_outputs).T
    model = StateSpaceModel(
        m.A,
        np.hstack([m.B[:, :q], between_b, m.B[:, q : q + n_u]]),
        m.C,
        np.hstack([m.D[:, :q], between_d, m.D[:, q : q + n_u]]),
        m.dt,
        [*m.inputs[:q], *((n.name, "1") for n in noise), *plant.inputs],
        [*m.outputs[:p], *plant.outputs],
        m.states,
        where="effect_blocks",
    )
    return EffectBlocks(UncertainModel(model, whole.blocks), tuple(noise), {})


def _bounded(e: AttachedEffect) -> str:
    return f"{e.effect.title} at {e.site.name} as a bounded error; {values_in_words(e)}"


def _free(names: list[str], taken: Sequence[str]) -> list[str]:
    found: list[str] = []
    for name in names:
        while name in taken or name in found:
            name += "'"
        found.append(name)
    return found


# --- is it so? -------------------------------------------------------------------------------------------------------


def _check(own: StateSpaceModel, name: str, made: EffectBlocks) -> None:
    """The nominal member is the plant's own linear model."""
    found = made.model.nominal.select(own.input_names, own.output_names)
    size = np.abs(own.poles())
    omega = np.geomspace(max(size[size > 0].min(initial=1.0), 1e-6), max(size.max(initial=1.0), 1e-5), 7) * 1.0371
    a, b = (frequency_response(m, omega) for m in (found, own))
    off = float(np.abs(a - b).max() / max(float(np.abs(b).max()), 1e-300))
    if off > EXACT:
        raise NoTrustworthyNumber(
            f"{name}: effect_blocks", f"the nominal member is off the linear model by {off:.2g} of its response"
        )


def _left_out(signals: Sequence[tuple[AttachedEffect, int, float]]) -> dict[str, str]:
    """Bounded errors of drivers."""
    left = {}
    for e, _, _ in signals:
        seen = e.effect.footprint(e.site, e.values, 1.0)
        if e.site.kind == "input" and seen is not None and seen.offset:
            left[f"{e!r}"] = "a bounded error of an input"
    return left
