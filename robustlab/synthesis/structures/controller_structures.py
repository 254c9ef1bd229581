r"""Controllers as functions of named parameters, and the structures that give them.

A law is the packed matrix :math:`\Theta(p) = [A_K, B_K; C_K, D_K]`. Structures can be combined; they have short forms
in Python (an order, a mask) and words, in commands and recipes, too (``pid``, ``order:3``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray, Mask
from robustlab.checks import choice, whole
from robustlab.errors import InputError
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.synthesis.problem.generalized_plant import GeneralizedPlant, common_scaling, signal_positions

Signals = tuple[Signal, ...]
WHERE = "fixed structure"
GAINS = ("full", "diagonal", "scalar")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a controller."""

    name: str
    unit: str = ""  # empty: not stated
    low: float = -np.inf
    high: float = np.inf
    start: float = 0.0  # where a search starts
    centre: float = 0.0  # centre of random starts, in units of its natural size and relative to `start`


@dataclass(frozen=True, eq=False)
class Law:
    """``Theta(p) = base + sum of entries``; an entry at (row, column) is ``weight * p[top] / (p[below] + dt)``.

    ``top``, ``below`` -1: that factor is one.
    """

    parameters: tuple[Parameter, ...]
    sizes: tuple[int, int, int]  # numbers of states, controls and measurements
    base: AnyArray
    top: AnyArray
    row: AnyArray
    column: AnyArray
    weight: AnyArray
    below: AnyArray
    dt: float = 0.0  # of the backward differences of a sampled derivative filter; 0: continuous

    def _factors(self, p: AnyArray) -> tuple[AnyArray, AnyArray]:
        return np.append(p, 1.0)[self.top], 1 / np.append(p + self.dt, 1.0)[self.below]

    def packed(self, p: AnyArray) -> AnyArray:
        """Return ``[A_K, B_K; C_K, D_K]``, shape (n_states + n_controls, n_states + n_measurements)."""
        top, share = self._factors(p)
        theta = self.base.astype(np.result_type(self.base, p))
        np.add.at(theta, (self.row, self.column), self.weight * top * share)
        return theta

    def steepness(self, p: AnyArray, scale: AnyArray) -> AnyArray:
        """Return the norm of ``scale * dTheta/dp_j`` for every parameter; 0 for one that only divides."""
        by = self.weight * self._factors(p)[1] * scale[self.row, self.column]
        return np.sqrt(np.bincount(self.top % (len(p) + 1), by**2, len(p) + 1)[:-1])

    def pullback(self, p: AnyArray, G: AnyArray) -> AnyArray:
        """Return ``sum(G * dTheta/dp_j)`` for every parameter."""
        n, (top, share) = len(p), self._factors(p)
        by = self.weight * G[self.row, self.column] * share
        above = np.bincount(self.top % (n + 1), by, n + 1)
        return (above - np.bincount(self.below % (n + 1), by * top * share, n + 1))[:n]

    def model(self, p: AnyArray, dt: float, inputs: Any = None, outputs: Any = None) -> StateSpaceModel:
        k = self.sizes[0]
        return StateSpaceModel(*unpacked(self.packed(p), k), dt, inputs, outputs, [f"k{i + 1}" for i in range(k)])


def unpacked(theta: AnyArray, n_states: int) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return ``(A_K, B_K, C_K, D_K)`` of packed matrices."""
    k = n_states
    return theta[:k, :k], theta[:k, k:], theta[k:, :k], theta[k:, k:]


@dataclass
class LawBuilder:
    """Builder of a law from its parameters and the entries of the packed matrices that they fill."""

    n_states: int
    n_controls: int
    n_measurements: int
    parameters: list[Parameter] = field(default_factory=list)
    entries: list[tuple[int, int, int, float, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.base = np.zeros((self.n_states + self.n_controls, self.n_states + self.n_measurements))

    def parameter(self, parameter: Parameter, *entries: tuple[int, int, float], below: int = -1) -> None:
        """Add a parameter with its entries ``(row, column, weight)``, divided by that of number ``below``."""
        self.entries += [(len(self.parameters), row, column, weight, below) for row, column, weight in entries]
        self.parameters.append(parameter)

    def direct_term(self, measurements: Signals, controls: Signals, name: str = "D", mask: Any = None) -> None:
        """Add the free entries of D_K as parameters."""
        k = self.n_states
        for i, j in np.argwhere(_mask(mask, len(controls), len(measurements))).tolist():
            u, y = controls[i], measurements[j]
            self.parameter(Parameter(f"{name}[{u.name},{y.name}]", _unit(u, y)), (k + i, k + j, 1.0))

    def law(self, dt: float = 0.0) -> Law:
        sizes = self.n_states, self.n_controls, self.n_measurements
        rows = np.array(self.entries, dtype=float).reshape(-1, 5)
        top, row, column, below = rows[:, [0, 1, 2, 4]].T.astype(int)
        return Law(tuple(self.parameters), sizes, self.base, top, row, column, rows[:, 3], below, dt)


# --- structures -------------------------------------------------------------------------------------------------------


class Structure(ABC):
    """A structure of controllers from measurements to controls."""

    @abstractmethod
    def law(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        """Return the controller as a function of parameters for these signals and sample time (s; 0: continuous)."""

    def __add__(self, other: Structure) -> Structure:
        return Decentralised([Part(self), Part(other)])


def _unit(out: Signal, into: Signal, suffix: str = "") -> str:
    """Return the unit of a gain from ``into`` to ``out``; empty where neither has a unit."""
    if not out.unit and not into.unit:
        return f"1{suffix}" if suffix else ""
    below = f"({into.unit or '1'}{suffix.replace('/', ' ')})" if suffix else into.unit or "1"
    return f"{out.unit or '1'}/{below}"


def _mask(mask: Any, n_u: int, n_y: int) -> Mask:
    if mask is None:
        return np.ones((n_u, n_y), dtype=bool)
    free = np.asarray(mask)
    if free.shape != (n_u, n_y):
        raise InputError(f"{WHERE}: mask", f"shape {free.shape}", f"{(n_u, n_y)}: controls x measurements")
    if not np.isin(free, (0, 1)).all() or not free.any():
        raise InputError(f"{WHERE}: mask", "no mask", "zeros and ones, at least one of them 1")
    return free.astype(bool)


@dataclass(frozen=True, eq=False)
class StaticGain(Structure):
    """``u = K y`` with a constant gain."""

    mask: Any = None  # free entries of K, shape (n_con, n_meas), default: all; the others are zero

    def law(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        builder = LawBuilder(0, len(controls), len(measurements))
        builder.direct_term(measurements, controls, "K", self.mask)
        return builder.law()


@dataclass(frozen=True)
class FixedOrder(Structure):
    """A controller of a given number of states; A_K is tridiagonal, as any with simple poles can be."""

    order: int  # number of states
    strictly_proper: bool = False  # True for D_K = 0

    def law(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        k = whole(f"{WHERE}: order", self.order, 0, 500)
        if k == 0 and self.strictly_proper:
            raise InputError(WHERE, "a strictly proper controller without states", "an order of at least 1")
        builder = LawBuilder(k, len(controls), len(measurements))
        for i in range(k):
            for j in range(max(i - 1, 0), min(i + 2, k)):
                centre = -1.0 if i == j and not dt else 0.0
                builder.parameter(Parameter(f"A[{i + 1},{j + 1}]", "" if dt else "1/s", centre=centre), (i, j, 1.0))
        for i, j in np.ndindex(k, len(measurements)):
            builder.parameter(Parameter(f"B[{i + 1},{measurements[j].name}]"), (i, k + j, 1.0))
        for i, j in np.ndindex(len(controls), k):
            builder.parameter(Parameter(f"C[{controls[i].name},{j + 1}]"), (k + i, j, 1.0))
        if not self.strictly_proper:
            builder.direct_term(measurements, controls)
        return builder.law()


@dataclass(frozen=True, eq=False)
class MultichannelPID(Structure):
    r"""PID with matrices of gains, or the I-PD and two-layer laws of several axes (Brezina 2010, eqs 9.1-9.4).

    ``layout="pid"``: :math:`u = K_p y + K_i \int y\,dt + K_d \dot y_f` where
    :math:`\tau \dot y_f + y_f = y` filters the derivative; from any measurements to any controls.

    ``layout="ipd"``: n controls m, measurements r, phi, phidot (n each):
    :math:`m = K_i \int (r - \varphi)\,dt - K_p \varphi - K_d \dot\varphi`.

    ``layout="two-layer"``: the I-PD gives reference torques for one inner torque loop per axis, which gives the
    controls; measurements r, phi, phidot, torque: :math:`u = \sigma - k_d m,\ \dot\sigma = k_i \xi - k_p m,\ \dot\xi =
    m_{ref} - m`, as `robustlab.dynamics.control.platform.two_layer`; continuous time.
    """

    layout: str = "pid"
    gains: Any = "full"  # form of Kp, Ki, Kd, also "diagonal", "scalar" (one for all channels), or a boolean mask
    terms: str = "PID"  # of layout "pid": those among P, I, D
    tau: Any = None  # of the derivative filters in s, required with D: a number, or (low, high) to optimise it

    def law(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        if choice(f"{WHERE}: layout", self.layout, ("pid", "ipd", "two-layer")) == "pid":
            return self._pid(measurements, controls, dt)
        if dt and self.layout == "two-layer":
            raise InputError(f"{WHERE}: two-layer", f"a plant with dt = {dt:g} s", "a continuous plant")
        return self._layers(measurements, controls, dt)

    # --- u = Kp y + Ki int y + Kd dy/dt -------------------------------------------------------------------------------

    def _pid(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        n_u, n_y = len(controls), len(measurements)
        if not self.terms or set(self.terms) - set("PID"):
            raise InputError(f"{WHERE}: terms", f"{self.terms!r}", 'letters of "PID"')
        groups = self._groups(n_u, n_y)
        n_i, n_d = n_y * ("I" in self.terms), n_y * ("D" in self.terms)
        k, rate = n_i + n_d, dt or 1.0
        builder = LawBuilder(k, n_u, n_y)
        builder.base[range(k), range(k)] = 1.0 if dt else 0.0
        builder.base[range(n_i), range(k, k + n_i)] = rate
        terms = [t for t in "PID" if t in self.terms]
        tau = len(terms) * len(groups)  # index of that parameter, after all gains
        for term in terms:
            for name, places in groups:
                unit = _unit(controls[places[0][0]], measurements[places[0][1]], "/s" if term == "I" else "")
                if term == "D":
                    unit = unit.replace("/", " s/", 1) or "s"
                first, sign = {"P": (k, 0.0), "I": (0, 0.0), "D": (k, -1.0)}[term]
                entries = [(k + i, first + j, 1.0) for i, j in places]
                entries += [(k + i, n_i + j, sign) for i, j in places if sign]
                builder.parameter(Parameter(f"K{term.lower()}{name}", unit), *entries, below=tau if sign else -1)
        for i in range(n_i, k):  # tau x' = -x + y, sampled by backward differences; acts as (y - x) / tau
            builder.entries += [(-1, i, i, -rate, tau), (-1, i, k + i - n_i, rate, tau)]
        if n_d:
            low, high = np.broadcast_to(np.nan if self.tau is None else self.tau, 2).astype(float).tolist()
            if not 0 < low <= high < np.inf:
                found = "missing" if self.tau is None else f"{self.tau}"
                raise InputError(f"{WHERE}: tau", found, "the derivative filter's time constant in s, or (low, high)")
            builder.parameter(Parameter("tau", "s", low, high, float(np.sqrt(low * high))))
        return builder.law(dt)

    def _groups(self, n_u: int, n_y: int) -> list[tuple[str, list[tuple[int, int]]]]:
        """Return the index text of every free gain and the entries of the gain matrix that it fills."""
        form = choice(f"{WHERE}: gains", self.gains, GAINS, "or a mask") if isinstance(self.gains, str) else "mask"
        if form in ("diagonal", "scalar") and n_u != n_y:
            raise InputError(f"{WHERE}: gains", f"{n_u} controls for {n_y} measurements", "as many of both")
        if form == "diagonal":
            return [(f"[{i + 1}]", [(i, i)]) for i in range(n_u)]
        if form == "scalar":
            return [("", [(i, i) for i in range(n_u)])]
        free = _mask(None if form == "full" else self.gains, n_u, n_y)
        return [(f"[{i + 1},{j + 1}]", [(i, j)]) for i, j in np.argwhere(free).tolist()]

    # --- I-PD and two-layer ------------------------------------------------------------------------------------------

    def _layers(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        n, two = len(controls), self.layout == "two-layer"
        wanted = (4 if two else 3) * n
        if len(measurements) != wanted:
            order = "r, phi, phidot, torque" if two else "r, phi, phidot"
            found = f"{len(measurements)} measurements for {n} controls"
            raise InputError(f"{WHERE}: {self.layout}", found, f"{wanted}: {order}")
        k = 3 * n if two else n
        builder = LawBuilder(k, n, wanted)
        r, phi, rate, torque = (k + g * n for g in range(4))
        for j in range(n):  # the integral of r - phi
            builder.base[j, j] = 1.0 if dt else 0.0
            builder.base[j, r + j], builder.base[j, phi + j] = dt or 1.0, -(dt or 1.0)
            if two:  # xi' = m_ref - m, u = sigma - kd m
                builder.base[n + j, torque + j] = -1.0
                builder.base[k + j, 2 * n + j] = 1.0
        row = n if two else k  # of m_ref
        out = Signal("torque", measurements[3 * n].unit) if two else controls[0]
        for matrix, column, sign, signal, power in (
            ("Kp", phi, -1.0, measurements[n], ""),
            ("Kd", rate, -1.0, measurements[2 * n], ""),
            ("Ki", 0, 1.0, measurements[0], "/s"),
        ):
            for name, places in self._groups(n, n):
                entries = [(row + i, column + j, sign) for i, j in places]
                builder.parameter(Parameter(matrix + name, _unit(out, signal, power)), *entries)
        if two:  # one kp, ki, kd for the loops of all axes
            m, u, axes = measurements[3 * n], controls[0], range(n)
            for name, first, column, sign, power in (
                ("kp", 2 * n, torque, -1.0, "/s"),
                ("kd", k, torque, -1.0, ""),
                ("ki", 2 * n, n, 1.0, "/s2"),
            ):
                entries = [(first + j, column + j, sign) for j in axes]
                builder.parameter(Parameter(name, _unit(u, m, power)), *entries)
        return builder.law()


def PID(terms: str = "PID", tau: Any = None) -> MultichannelPID:
    """Return one PID per channel, from measurement i to control i; see `MultichannelPID`."""
    return MultichannelPID("pid", "diagonal", terms, tau)


@dataclass(frozen=True, eq=False)
class FixedPoles(Structure):
    r"""Given poles, free residues and free direct term: :math:`K = D + \sum_i R_i/(s - p_i)`."""

    # Poles in rad/s (of a sampled controller: in the z-plane), complex ones in conjugate pairs, each used once per
    # measurement so that the residues have full rank.
    poles: Sequence[complex]
    strictly_proper: bool = False  # True for no direct term

    def law(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        poles = np.asarray(self.poles, dtype=complex).ravel()
        if not len(poles) or not np.isfinite(poles).all():
            raise InputError(f"{WHERE}: poles", f"{list(poles)}", "at least one finite pole")
        upper = [p for p in poles if p.imag > 0]
        if not np.allclose(np.sort_complex(poles), np.sort_complex(poles.conj())):
            raise InputError(f"{WHERE}: poles", "a complex pole without its conjugate", "conjugate pairs")
        n_u, n_y = len(controls), len(measurements)
        blocks = [np.array([[p.real]]) for p in poles if p.imag == 0]
        blocks += [np.array([[p.real, p.imag], [-p.imag, p.real]]) for p in upper]
        k = n_y * sum(len(b) for b in blocks)
        builder = LawBuilder(k, n_u, n_y)
        at = 0
        for (number, block), (j, y) in product(enumerate(blocks, start=1), enumerate(measurements)):
            size = len(block)
            builder.base[at : at + size, at : at + size] = block
            builder.base[at, k + j] = 1.0
            for part, i in np.ndindex(size, n_u):
                text = f"R{number}{'ab'[part] if size > 1 else ''}[{controls[i].name},{y.name}]"
                builder.parameter(Parameter(text, _unit(controls[i], y, "" if dt else "/s")), (k + i, at + part, 1.0))
            at += size
        if not self.strictly_proper:
            builder.direct_term(measurements, controls)
        return builder.law()


@dataclass(frozen=True, eq=False)
class Part:
    """A structure on named channels, for `Decentralised`; on all where none are named."""

    structure: Structure
    measurements: Sequence[str] | None = None
    controls: Sequence[str] | None = None


@dataclass(frozen=True, eq=False)
class Decentralised(Structure):
    """Controllers side by side, each on its own channels; shared controls add up.

    Parameters get the number of their part as a prefix.
    """

    parts: Sequence[Part | Structure]  # structures alone: one per channel in order

    def law(self, measurements: Signals, controls: Signals, dt: float) -> Law:
        y_names, u_names = [s.name for s in measurements], [s.name for s in controls]
        plain = all(isinstance(part, Structure) for part in self.parts)
        if not self.parts or (plain and not len(self.parts) == len(measurements) == len(controls)):
            found = f"{len(self.parts)} parts for {len(measurements)} measurements and {len(controls)} controls"
            raise InputError(f"{WHERE}: decentralised", found, "one for each channel, or Part(structure, names, names)")
        made = list[tuple[Law, list[int], list[int]]]()
        for i, given in enumerate(self.parts):
            part = Part(given, y_names[i : i + 1], u_names[i : i + 1]) if isinstance(given, Structure) else given
            y = signal_positions(part.measurements or y_names, y_names, f"{WHERE}: measurement")
            u = signal_positions(part.controls or u_names, u_names, f"{WHERE}: control")
            law = part.structure.law(tuple(measurements[j] for j in y), tuple(controls[j] for j in u), dt)
            made.append((law, u, y))
        builder = LawBuilder(sum(law.sizes[0] for law, _, _ in made), len(controls), len(measurements))
        k, state = builder.n_states, 0
        for number, (law, u, y) in enumerate(made, start=1):
            own, first = range(state, state + law.sizes[0]), len(builder.parameters)
            rows, columns = (np.array([*own, *(k + i for i in channels)], dtype=int) for channels in (u, y))
            builder.base[rows[:, None], columns] += law.base
            top, below = (np.where(at < 0, -1, at + first) for at in (law.top, law.below))
            entries = (top, rows[law.row], columns[law.column], law.weight, below)
            builder.entries += zip(*(each.tolist() for each in entries), strict=True)
            builder.parameters += [replace(p, name=f"{number}.{p.name}") for p in law.parameters]
            state = own.stop
        return builder.law(max(law.dt for law, _, _ in made))


WORDS = ("static", "p", "i", "pi", "pd", "pid", "ipd", "two-layer", "order", "poles", "decentralised")


def as_structure(structure: Any, plant: GeneralizedPlant) -> Structure:
    """Return a structure from words (``"pid"``, ``"order:3"``), an order, a mask, or a list (decentralised)."""
    if isinstance(structure, Structure):
        return structure
    if isinstance(structure, str):
        return _of_words(structure, plant)
    if isinstance(structure, (int, np.integer)) and not isinstance(structure, bool):
        return StaticGain() if structure == 0 else FixedOrder(int(structure))
    if isinstance(structure, (list, tuple)) and structure and all(isinstance(s, (Structure, Part)) for s in structure):
        return Decentralised(structure)
    if isinstance(structure, (list, tuple, np.ndarray)):
        return StaticGain(np.asarray(structure))
    raise InputError(f"{WHERE}: structure", f"{type(structure).__name__}", "a Structure, a name, an order or a mask")


def _of_words(text: str, plant: GeneralizedPlant) -> Structure:
    where = f"structure {text!r}"
    word, _, rest = text.strip().lower().partition(":")
    choice(where, word, WORDS)
    if word == "order":
        if not rest.isdigit() or int(rest) > 1000:
            raise InputError(where, f"{rest!r}", "a whole number from 0 to 1000: order:3")
        return as_structure(int(rest), plant)
    if word == "poles":
        try:
            return FixedPoles([complex(part.strip()) for part in rest.split(",")])
        except ValueError:
            raise InputError(where, f"{rest!r}", "numbers: poles:-1,-20 or poles:-1+2j,-1-2j") from None
    if word in ("ipd", "two-layer"):
        return MultichannelPID(word, choice(f"{where}: gains", rest or "full", GAINS))
    if word == "decentralised":
        return Decentralised([_of_words(rest, plant)] * plant.n_con)
    if rest:
        raise InputError(where, f"{rest!r} after {word}", "nothing")
    rate = common_scaling([plant])[0].rate
    return StaticGain() if word == "static" else PID(word.upper(), (0.01 / rate, 10 / rate))
