r"""Models with exact delays: a linear model whose first channels are closed by :math:`e^{-s \tau_i}`.

.. math:: G(s) = H_{22} + H_{21} E(s) (I - H_{11} E(s))^{-1} H_{12}, \qquad E(s) = \mathrm{diag}(e^{-s \tau_i})

Every interconnection of such models is one. Delays of equal length are the same operator and behave as a repeated block
of an uncertain model: `robustlab.uncertainty` computes the interconnections and removes redundant repetitions. Zhou,
Doyle, Glover, *Robust and Optimal Control* (1996), section 10.1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import factorial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray, Indices, Mask
from robustlab.checks import whole
from robustlab.delays.approximation import SHORTEST, checked_order, error_weight, pade, phase_bound
from robustlab.display import Displayable, Facts, listed, number, short, with_units
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.feedback import wired
from robustlab.linear_analysis.frequency import CHUNK, frequency_response, solved_on_axis
from robustlab.linear_analysis.matrices import balancing_factors
from robustlab.operators import TransferMatrix
from robustlab.provenance import Traced
from robustlab.signals import Signal, is_constant, picked, real_array
from robustlab.statespace import StateSpaceModel, append, as_model, series
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock
from robustlab.uncertainty.lft import (
    UncertainModel,
    Wiring,
    as_uncertain,
    feedback,
    interconnected,
    inverse,
    lft,
    ones,
    parallel,
    product,
    unique_names,
    upper_lft,
)

# Samples of delay of a discrete model; each is a state.
MOST_SAMPLES = 2000
# How far from a whole number of samples a discrete delay may be, relative to one sample.
WHOLE = 1e-9

Hold = Literal["zoh", "foh"]
DEGREE = 7  # of the polynomials in a cell
PASSES = 7  # through delays after which a jump is smoother than a polynomial of that degree resolves
MOST_CELLS = 60_000
# Runs on finer and finer meshes. A cell is halved where its last coefficients exceed this share of rtol.
REFINEMENTS, SHARE, SMALLEST = 60, 0.1, 1e-12
# Points of the mesh nearer than this share of the whole time are one.
SAME_TIME = 1e-11
# At a node on a jump the limit from inside its cell is taken.
INWARDS = 1e-7


@dataclass(frozen=True, init=False, eq=False)
class DelayedModel(TransferMatrix, Displayable, Traced):
    r"""A linear model with exact delays anywhere in it; immutable, continuous in time.

    .. math:: \dot x = A x + B_1 w + B_2 u, \quad z = C_1 x + D_{11} w + D_{12} u, \quad y = C_2 x + D_{21} w + D_{22}
       u, \quad w_i(t) = z_i(t - \tau_i)

    Most are made by `robustlab.delay` and `robustlab.with_delays`, and by the operators ``@``, ``+``, ``feedback``.

    Parameters
    ----------
    H
        State-space model, continuous. Its first inputs are w and its first outputs z.
    delays
        :math:`\tau_i \ge 0` in s, shape (n,). Channels are put in the order of their delays; a delay of zero is closed.

    Raises
    ------
    InputError
        A discrete model, fewer channels than delays, a delay that is negative or not finite.
    NoTrustworthyNumber
        A channel without delay makes a loop that is not well posed.

    Examples
    --------
    >>> from robustlab.delays import delay
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> loop = (2.0 * lag @ delay(0.5)).feedback()
    >>> loop
    DelayedModel(1 state, delays of 0.5 s, [u1] -> [y1])
    >>> frequency_response(loop, [0.0])[0, 0, 0].real.round(12)
    np.float64(0.666666666667)
    """

    H: StateSpaceModel
    delays: Array

    def __init__(self, H: StateSpaceModel, delays: ArrayLike) -> None:
        model = as_model(H, "DelayedModel: H")
        lengths = real_array("delays", delays, 1, "DelayedModel")
        if model.is_discrete:
            found = f"a discrete model, dt = {model.dt:g} s"
            raise InputError("DelayedModel", found, "a continuous one", "with_delays gives a discrete model its states")
        if min(model.n_inputs, model.n_outputs) < len(lengths):
            found = f"H has {model.n_inputs} inputs and {model.n_outputs} outputs"
            raise InputError("DelayedModel", found, f"at least {len(lengths)}: the delays' channels come first")
        wrong = lengths[(lengths != 0) & ((lengths < SHORTEST) | (lengths > 1 / SHORTEST))]
        if len(wrong):
            expected = f"0 s or more: 0, or {SHORTEST:g} to {1 / SHORTEST:g} s"
            raise InputError("DelayedModel", f"a delay of {wrong[0]:g} s", expected)
        order, n = np.argsort(lengths, kind="stable"), len(lengths)
        ins, outs = ([*(names[k] for k in order), *names[n:]] for names in (model.input_names, model.output_names))
        none = int((lengths == 0).sum())
        try:
            model = upper_lft(model.select(ins, outs), np.eye(none))
        except NoTrustworthyNumber:
            singular = "a loop through a delay of zero is not well posed"
            raise NoTrustworthyNumber("DelayedModel", singular) from None
        lengths = lengths[order][none:]
        lengths.setflags(write=False)
        object.__setattr__(self, "H", model)
        object.__setattr__(self, "delays", lengths)

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Inputs, without the delays' channels."""
        return self.H.inputs[len(self.delays) :]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Outputs, without the delays' channels."""
        return self.H.outputs[len(self.delays) :]

    dt: ClassVar[float] = 0.0  # continuous time
    is_discrete: ClassVar[bool] = False

    def response_at(self, omega: ArrayLike) -> ComplexArray:
        """Exact frequency response, shape (n_omega, n_y, n_u); poles of open-loop parts are no poles here."""
        w = real_array("omega", np.atleast_1d(omega), 1, "frequency_response")
        if not len(self.delays):
            return frequency_response(self.H, w)
        return solved_on_axis(self._solved, w, 1j * w)

    def values_at(self, s: ComplexArray) -> ComplexArray:
        """Return the transfer matrix ``G(s)`` at (n,), shape (n, n_y, n_u); numpy's LinAlgError at a pole."""
        with np.errstate(over="ignore", invalid="ignore"):
            found = self._solved(s)
        if not np.isfinite(found).all():
            raise NoTrustworthyNumber("G(s)", "exp(s tau) overflows", "a real part below 700 / tau")
        return found

    def _solved(self, s: ComplexArray) -> ComplexArray:
        """Return the transfer matrix at s; raises numpy's LinAlgError at a pole."""
        # Unknowns: states and outputs of delays, balanced.
        H, k, n = self.H, len(self.delays), self.H.n_states
        inner = np.block([[H.A, H.B[:, :k]], [H.C[:k], H.D[:k, :k]]])
        scale = balancing_factors(inner)
        inner = inner / scale[:, None] * scale
        B, C = np.vstack([H.B, H.D[:k]])[:, k:] / scale[:, None], np.hstack([H.C, H.D[:, :k]])[k:] * scale
        found, place = np.empty((len(s), *H.D[k:, k:].shape), dtype=complex), np.arange(n + k)
        step = max(1, CHUNK // max(n + k, 1) ** 2)
        for first in range(0, len(s), step):
            part = s[first : first + step, None]
            matrix = np.broadcast_to(-inner, (len(part), *inner.shape)).astype(np.complex128)
            matrix[:, place, place] += np.hstack([np.repeat(part, n, axis=1), np.exp(part * self.delays)])
            solved = np.linalg.solve(matrix, np.broadcast_to(B, (len(part), *B.shape)))
            found[first : first + step] = H.D[k:, k:] + C @ solved
        return found

    def pade(self, order: int) -> StateSpaceModel:
        r"""Return the model with Padé approximations of order 0 to 40 (0: no delays), whose states come first.

        For each, :math:`|e^{-j\omega\tau} - R_n| \le \min(2, c_n (\omega \tau)^{2n+1})`.
        """
        return self._closed_by([as_uncertain(pade(t, order)) for t in self.delays], "pade").M

    def uncertain(self, order: int = 3, weight_order: int = 3) -> UncertainModel:
        r"""Return a set that holds the model with its exact delays: Padé approximations, and blocks for their errors.

        .. math:: e^{-s \tau} = R_n(s) + W(s) \Delta(s), \qquad |e^{-j\omega\tau} - R_n(j\omega\tau)| \le |W(j\omega)|
           \text{ for all } \omega

        This is proved, and :math:`\Delta` is stable: a proof for the set holds for the model with its delays. Delays
        of one length share one repeated block. ``order``: n, 0 to 40; the weight passes 1 near :math:`\omega \tau =
        2, 5, 6, 8, 10` for n = 1, 2, 3, 4, 6. ``weight_order``: its slope and number of states, 1 to 2n + 1.
        """
        return self._closed_by([covering(float(t), 0.0, order, weight_order) for t in self.delays], "uncertain")

    def _closed_by(self, parts: list[UncertainModel], where: str) -> UncertainModel:
        """Return H with each delay replaced by a model or set of one input and output."""
        n, n_u, n_y = len(self.delays), self.n_inputs, self.n_outputs
        u, y = 2 * n + n_u, 2 * n + n_y  # z of H enters the parts, their outputs w of H
        wiring = Wiring(ones(u, y, (0, n, n), (n, 0, n)), ones(u, n_u, (2 * n, 0, n_u)), ones(n_y, y, (0, 2 * n, n_y)))
        return interconnected([*parts, as_uncertain(self.H)], wiring, self.inputs, self.outputs, where)

    operator_rank = 2  # a delayed model and a model make a delayed model
    for_control = "G.pade(3).to_control() is G as a control.StateSpace, its delays approximated to order 3"
    no_model = "exact delays have no state-space model: take .pade(order), or .uncertain(order) for what is proved"

    def carried(self, function: Callable[..., UncertainModel], *operands: Any, **options: Any) -> DelayedModel:
        """Apply an interconnection of sets to delayed models and to operands that can be converted to one."""
        made = [as_delayed(operand, function.__name__) if not is_constant(operand) else operand for operand in operands]
        lengths = {_name(t): float(t) for m in made if isinstance(m, DelayedModel) for t in m.delays}
        sets = [m.as_set() if isinstance(m, DelayedModel) else m for m in made]
        try:
            found = function(*sets, **options)
        except NoTrustworthyNumber:
            singular = "what passes without delay makes it singular: it is not well posed"
            raise NoTrustworthyNumber(function.__name__, singular) from None
        return DelayedModel(found.M, [lengths[b.name] for b in found.blocks for _ in range(b.rows)])

    def as_set(self) -> UncertainModel:
        """H with one repeated block for each length of delay, named by it; the block represents the exact delay."""
        found, counts = np.unique(self.delays, return_counts=True)
        return UncertainModel(self.H, [ComplexScalar(_name(t), int(k)) for t, k in zip(found, counts, strict=True)])

    def _product(self, second: Any, first: Any) -> DelayedModel:
        return self.carried(product, second, first)

    def _sum(self, first: Any, second: Any, sign: int) -> DelayedModel:
        return self.carried(parallel, first, second, sign=sign)

    def _loop(self, forward: Any, back: Any, sign: int | None) -> DelayedModel:
        return self.carried(feedback, forward, back, sign=sign)

    def _identity(self) -> DelayedModel:
        if self.n_inputs != self.n_outputs:
            raise InputError("power", f"a model of {self.n_outputs} x {self.n_inputs}", "a square model")
        gain = StateSpaceModel([], [], [], np.eye(self.n_inputs), 0.0, self.inputs, self.outputs)
        return DelayedModel(gain, [])

    def inverse(self) -> DelayedModel:
        """The model from outputs to inputs; refused where the part without delay has no inverse: it is not causal."""
        return self.carried(inverse, self)

    def select(self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None) -> DelayedModel:
        """The same model with the named inputs and outputs only, in that order; states and delays are kept."""
        n = len(self.delays)
        ins = [*self.H.input_names[:n], *(self.input_names if inputs is None else inputs)]
        outs = [*self.H.output_names[:n], *(self.output_names if outputs is None else outputs)]
        return DelayedModel(self.H.select(ins, outs), self.delays)

    def __getitem__(self, key: Any) -> DelayedModel:
        """``G[outputs, inputs]`` by numbers, slices, names or lists of these; states and delays are kept."""
        outputs, inputs = picked(key, self.output_names, self.input_names)
        return self.select(inputs, outputs)

    def close(self, K: Any) -> DelayedModel:
        """Return the closed loop ``u = K y``, as `UncertainModel.close`; the delays are exact, and K may have some."""
        given = getattr(K, "K", K)
        k = given if isinstance(given, DelayedModel) else as_model(given, "close: K")
        if k.n_inputs > self.n_outputs or k.n_outputs > self.n_inputs:
            found = f"K of {k.n_outputs} x {k.n_inputs}"
            raise InputError("close", found, f"{self.n_inputs} x {self.n_outputs} at most")
        k = wired(k, self.outputs[self.n_outputs - k.n_inputs :], self.inputs[self.n_inputs - k.n_outputs :], "close")
        if isinstance(k, StateSpaceModel):  # without units, which a controller's file may not state
            ins, outs = [f"k.y{i}" for i in range(k.n_inputs)], [f"k.u{i}" for i in range(k.n_outputs)]
            k = StateSpaceModel(k.A, k.B, k.C, k.D, k.dt, ins, outs)
        return as_delayed(lft(self, k, k.n_inputs, k.n_outputs), "close")

    def to_json(self) -> dict[str, object]:
        return {"H": self.H, "delays": self.delays}

    def facts(self) -> Facts:
        return [
            ("time", "continuous"),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("states", str(self.H.n_states)),
            ("delays", listed(number(float(t), "s") for t in self.delays) or "none"),
        ]

    def _numbers(self) -> list[str]:
        lengths = ", ".join(number(float(t)) for t in self.delays)
        line = f"delays: {lengths} s, from the first outputs to the first inputs"
        return [*([line] if lengths else []), *self.H._numbers()]

    def __repr__(self) -> str:
        n = self.H.n_states
        lengths = listed(number(float(t)) for t in self.delays)
        delays = f"delays of {lengths} s" if lengths else "no delays"
        ins, outs = short(self.input_names), short(self.output_names)
        return f"DelayedModel({n} state{'s' * (n != 1)}, {delays}, [{ins}] -> [{outs}])"


def as_delayed(system: Any, where: str = "as_delayed") -> DelayedModel:
    """Return a delayed model unchanged, a model or a matrix as one without delays."""
    if isinstance(system, DelayedModel):
        return system
    if isinstance(system, UncertainModel) and system.blocks:
        found = "an uncertain model and exact delays"
        raise InputError(where, found, "one or the other", "cover the delays first: .uncertain(order) makes a set")
    return DelayedModel(as_model(system, where), [])


def _name(length: float) -> str:
    return f"{float(length)!r} s"


def covering(tau: float, spread: float, order: int, weight_order: int, name: str = "") -> UncertainModel:
    """Return ``R + W Delta``: all delays within ``spread`` of ``tau``, as a set with one input and one output."""
    # Equal names of blocks are one uncertainty: a name states the length of the delay, or its channel if it is a range.
    checked_order(order, "uncertain")
    if isinstance(weight_order, int):
        weight_order = min(weight_order, 2 * order + 1)
    rational = pade(tau, order)
    weight = error_weight(order, weight_order, spread / tau).scaled(tau)
    covers = (tau, spread, order, weight_order)
    if spread:
        words = f"a delay of {tau:g} s +- {spread:g} s, covered at all frequencies: proved"
        block: Block = FullBlock(f"{name}spread 1 of {tau!r} s +- {spread!r} s", 1, 1, origin=words, covers=covers)
    else:
        name = f"delay of {tau!r} s (order {order}, slope {weight.n_states})"
        words = f"what Padé's approximation of order {order} of a delay of {tau:g} s misses, at most min(2,"
        words += f" {phase_bound(order):.3g} (w {tau:g} s)^{2 * order + 1}) for all w: proved"
        block = ComplexScalar(name, origin=words, covers=covers)
    side = append(*(m.renamed([f"i{k}"], [f"o{k}"]) for k, m in enumerate((weight, rational))))
    into = np.array([[0.0, 1.0], [0.0, 1.0]])  # (w, z) into both
    D = side.D @ into
    D[1, 0] = 1.0
    model = StateSpaceModel(side.A, side.B @ into, side.C, D, 0.0, ["w", "in"], ["z", "out"], side.states)
    return UncertainModel(model, [block])


# --- delays of signals ------------------------------------------------------------------------------------------------


@error_context("delay")
def delay(tau: ArrayLike, n: int = 1, dt: float = 0.0) -> DelayedModel | StateSpaceModel:
    r"""A pure delay :math:`e^{-s \tau}` in each of n channels.

    Parameters
    ----------
    tau
        In s, 0 or more; one number, or one for each channel.
    n
        Number of channels, where tau is one number.
    dt
        Sample time in s of a discrete delay; 0 means continuous time.

    Returns
    -------
    DelayedModel or StateSpaceModel
        Exact; a discrete one is a model with a state for each sample of delay.

    Raises
    ------
    InputError
        A delay that is negative or not finite, or in discrete time no whole number of samples.

    Examples
    --------
    >>> delay(0.03, dt=0.01)
    StateSpaceModel(3 states, [u1] -> [y1], dt=0.01 s)
    """
    whole("delay: n", n, 1)
    given: Any = [tau] * n if np.ndim(tau) == 0 else tau
    lengths = real_array("tau", given, 1, "delay")
    gain = StateSpaceModel([], [], [], np.eye(len(lengths)), dt)
    found: Any = with_delays(gain, inputs=dict(enumerate(lengths.tolist())))  # numbers, not ranges: no set
    return found


@error_context("with_delays")
def with_delays(
    G: Any,
    inputs: Mapping[Any, float | Sequence[float]] | None = None,
    outputs: Mapping[Any, float | Sequence[float]] | None = None,
    order: int = 3,
) -> DelayedModel | StateSpaceModel | UncertainModel:
    r"""The model with exact delays of some of its inputs and outputs; with delays within ranges, a set that holds it.

    A proof for the set holds for the model with every such delay; see `DelayedModel.uncertain`. Delays in a range vary
    independently.

    Parameters
    ----------
    G
        A StateSpaceModel, a plant, a python-control object, a DelayedModel or an UncertainModel.
    inputs, outputs
        Name or number of a signal -> its delay in s, 0 or more, or its shortest and its longest delay.
    order
        Of a set: order of the approximations; see `DelayedModel.uncertain`.

    Returns
    -------
    DelayedModel, StateSpaceModel or UncertainModel
        For a discrete G a model with a state :math:`z^{-1}` for each sample of delay, else a DelayedModel. Where G is
        uncertain or a delay is a range, a set with the blocks of G and those of the delays.

    Raises
    ------
    InputError
        No such signal; a delay that is negative or not finite, a range that ends before it begins; for a discrete G no
        whole number of samples, or a range.

    Examples
    --------
    >>> motor = StateSpaceModel([[-2.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["omega"])
    >>> with_delays(motor, inputs={"u": 0.01}, outputs={"omega": 0.02})
    DelayedModel(1 state, delays of 0.01, 0.02 s, [u] -> [omega])
    >>> [b.name for b in with_delays(motor, inputs={"u": (0.1, 0.3)}).blocks]
    ['u: spread 1 of 0.2 s +- 0.1 s']
    """
    model = G if isinstance(G, DelayedModel | UncertainModel) else as_model(G, "with_delays")
    before, after = _ranges("input", inputs, model.inputs), _ranges("output", outputs, model.outputs)
    ranges = any(np.ndim(length) for side in (inputs, outputs) for length in (side or {}).values())
    exact = not ranges and not isinstance(model, UncertainModel)
    if exact and isinstance(model, StateSpaceModel) and model.is_discrete:
        whole = series(series(_shifts(before, model.dt), model), _shifts(after, model.dt))
        return whole.renamed(model.inputs, model.outputs)
    if exact:
        return _bank(after, model.outputs) @ as_delayed(model) @ _bank(before, model.inputs)
    if model.dt:
        raise InputError("with_delays", f"a discrete model, dt = {model.dt:g} s", "a continuous one")
    held = model.uncertain(order) if isinstance(model, DelayedModel) else as_uncertain(model, "with_delays")
    first, last = _held_bank(before, model.inputs, order), _held_bank(after, model.outputs, order)
    held = product(last, product(held, first))
    return UncertainModel(held.M, held.blocks)


def _ranges(side: str, given: Mapping[Any, Any] | None, signals: Sequence[Signal]) -> list[tuple[float, float]]:
    """Return the shortest and longest delay of each signal; zero where none is given."""
    names, found = [s.name for s in signals], [(0.0, 0.0)] * len(signals)
    for key, value in (given or {}).items():
        number = isinstance(key, (int, np.integer)) and not isinstance(key, bool)
        if not (key in names or (number and 0 <= int(key) < len(names))):
            raise InputError(f"with_delays: {side} {key!r}", "no such signal", f"one of {', '.join(names)}")
        ends = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
        real = all(isinstance(v, (int, float, np.number)) and not isinstance(v, bool) for v in ends)
        if not real or len(ends) != 2 or not 0 <= ends[0] <= ends[1] <= 1 / SHORTEST:
            raise InputError(f"with_delays: {side} {key!r}", f"{value!r}", "a delay of 0 s or more, or a range of such")
        found[int(key) if number else names.index(str(key))] = float(ends[0]), float(ends[1])
    return found


def _bank(delays: list[tuple[float, float]], signals: Sequence[Signal]) -> DelayedModel:
    """Return a diagonal model of exact delays, one for each signal."""
    n, eye = len(delays), np.eye(len(delays))
    ins, outs = (unique_names([*signals, *(Signal(f"{side}{k + 1}") for k in range(n))]) for side in "wz")
    D = np.block([[np.zeros((n, n)), eye], [eye, np.zeros((n, n))]])
    H = StateSpaceModel([], [], [], D, 0.0, ins[n:] + ins[:n], outs[n:] + outs[:n])
    return DelayedModel(H, [length for length, _ in delays])


def _held_bank(delays: list[tuple[float, float]], signals: Sequence[Signal], order: int) -> UncertainModel:
    """Return a diagonal set that holds the delays of each signal; to 12 digits, which the weights cover."""
    parts = [
        covering(float(f"{(a + b) / 2:.12g}"), float(f"{(b - a) / 2:.12g}"), order, 3, f"{s.name}: ")
        if b else as_uncertain(1.0) for (a, b), s in zip(delays, signals, strict=True)
    ]  # fmt: skip
    n = len(parts)
    return interconnected(parts, Wiring(np.zeros((n, n)), np.eye(n), np.eye(n)), signals, signals, "with_delays")


def _shifts(delays: list[tuple[float, float]], dt: float) -> StateSpaceModel:
    """Return a diagonal model of chains of z^-1, one for each channel."""
    parts: list[StateSpaceModel] = []
    for i, (length, _) in enumerate(delays):
        samples = length / dt
        text = f"{length:g} s is {samples:.6g} samples of {dt:g} s"
        if not samples < MOST_SAMPLES + 0.5:
            raise InputError("with_delays", text, f"at most {MOST_SAMPLES}")
        count = round(samples)
        if abs(samples - count) > WHOLE * max(count, 1):
            raise InputError("with_delays", text, "a whole number of samples", "delay the continuous model")
        b, c = np.eye(count, 1), np.eye(1, count, count - 1) if count else np.zeros((1, 0))
        names = [f"delay{i + 1}.{k + 1}" for k in range(count)]
        parts.append(StateSpaceModel(np.eye(count, k=-1), b, c, [[float(not count)]], dt, [f"i{i}"], [f"o{i}"], names))
    return append(*parts)


# --- responses over time ----------------------------------------------------------------------------------------------
#
# The method of steps on a mesh of samples and their delayed times, between which signals are smooth (Bellen, Zennaro,
# Numerical Methods for Delay Differential Equations): polynomials go through matrix exponentials without error (Van
# Loan 1978). A signal in a delay inside a loop is no polynomial: it is stored at Chebyshev points of each cell, and
# cells that do not resolve it are halved.


def delayed_response(model: DelayedModel, t: Array, u: Array, x0: Array, hold: Hold, rtol: float) -> Array:
    """Return the outputs (n, n_y) at the times t for samples u (n, n_u), from the state x0 of H, with empty delays."""
    H, n = model.H, len(model.delays)
    # the delays whose output enters a state or another delay
    moving: Mask = np.asarray(np.vstack([H.B, H.D[:n]])[:, :n].any(axis=0))
    inner = (moving & np.hstack([H.C[:n], H.D[:n, :n]]).any(axis=1)).any()  # some signal in them is no polynomial
    mesh = _mesh(model, t, moving, PASSES if inner else 1)
    if not inner:
        return _run(model, t, u, x0, hold, mesh, 1, moving)[0]
    mesh, resolved, y = _cut(mesh, float(model.delays[moving].min())), False, np.zeros((len(t), 0))
    for _ in range(REFINEMENTS):
        last, (y, tail) = y, _run(model, t, u, x0, hold, mesh, DEGREE, moving)
        if not np.isfinite(y).all():
            return y
        # Where all cells were resolved, halving each must not have changed the response.
        if resolved and np.abs(y - last).max(initial=0.0) <= rtol * np.abs(y).max(initial=0.0):
            return y
        rough = tail > max(SHARE * rtol, SMALLEST)
        resolved = not rough.any()
        cells = rough | resolved
        _limited(len(mesh) + int(cells.sum()))
        mesh = np.sort(np.concatenate([mesh, (0.5 * (mesh[:-1] + mesh[1:]))[cells]]))
    found = f"the response still changes when its {len(mesh)} cells are halved"
    raise NoTrustworthyNumber("simulate", found, f"a change of at most {rtol:g}", "a larger rtol")


def _limited(cells: int) -> None:
    if cells > MOST_CELLS:
        hint = "a clock whose step divides the delays, a shorter time, or .pade(order)"
        raise NoTrustworthyNumber("simulate", f"{cells} cells for the delays", f"at most {MOST_CELLS}", hint)


def _mesh(model: DelayedModel, t: Array, moving: Mask, most: int) -> Array:
    """Return all samples, their delayed times, and for each sample the earlier times of delayed outputs."""
    end, n, later = t[-1], len(moving), np.unique(model.delays[moving])
    points = new = t
    echoes = bool(model.H.D[:n, :n][moving][:, moving].any())  # jumps that no state smooths recur without end
    passes = 0
    while len(new) and (passes < most or echoes):
        passes += 1
        new = _merged(np.concatenate([[], *(new + tau for tau in later)]), t)
        new = new[new < end]
        points = _merged(np.concatenate([points, new]), t)
        _limited(len(points))
    earlier = np.concatenate([points, *(t - tau for tau in np.unique(model.delays[~moving]))])
    return _merged(earlier[earlier >= t[0]], t)


def _merged(points: Array, t: Array) -> Array:
    """Sort the points and merge those that differ by rounding; samples are unchanged."""
    same = SAME_TIME * (t[-1] - t[0])
    nearest = t[np.clip(np.searchsorted(t, points - same), 0, len(t) - 1)]
    points = np.sort(np.where(np.abs(nearest - points) <= same, nearest, points))
    return points[np.concatenate([[True], np.diff(points) > same])] if len(points) else points


def _cut(points: Array, longest: float) -> Array:
    """Return the mesh with steps of at most ``longest``, so that every delay refers to a finished cell."""
    pieces = np.maximum(1, np.ceil(np.diff(points) / longest * (1.0 - 1e-9))).astype(int)
    _limited(int(pieces.sum()))
    parts = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(points[:-1], points[1:], pieces, strict=True)]
    return np.append(np.concatenate(parts), points[-1])


def _run(
    model: DelayedModel, t: Array, u: Array, x0: Array, hold: Hold, mesh: Array, degree: int, moving: Mask
) -> tuple[Array, Array]:
    """Return the outputs after each sample, and of each cell the last relative coefficients of delayed signals."""
    H, n, cells = model.H, len(model.delays), len(mesh) - 1
    C1, D11, D12 = H.C[:n], H.D[:n, :n], H.D[:n, n:]
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
    coefficients = np.linalg.inv(_chebyshev(nodes, degree))  # from values at the nodes
    steps, middle = np.diff(mesh), 0.5 * (mesh[:-1] + mesh[1:])
    times = mesh[:-1, None] + steps[:, None] * nodes

    k = np.clip(np.searchsorted(t, middle, side="right") - 1, 0, len(t) - 2)
    share = (times - t[k][:, None]) / (t[k + 1] - t[k])[:, None] if hold == "foh" else np.zeros_like(times)
    force = u[k][:, None] + share[:, :, None] * (u[k + 1] - u[k])[:, None]  # inputs at the nodes of all cells

    def delayed(times: Array, middle: Array) -> tuple[Indices, Array]:
        """For each time and delay: the cell of the delayed time (-1: none), and the weights of its nodes there."""
        back = times[:, :, None] - model.delays
        inner = back + INWARDS * (middle[:, None] - times)[:, :, None]
        source = np.searchsorted(mesh, inner, side="right") - 1
        known = np.clip(source, 0, cells - 1)
        place = np.clip((back - mesh[known]) / steps[known], 0.0, 1.0)
        return np.where(source < 0, -1, known), _chebyshev(place, degree) @ coefficients

    source, weights = delayed(times, middle)
    maps, kind = _maps(H.A, H.B, steps, nodes, float(np.abs(mesh).max()))
    held = np.zeros((cells + 1, degree + 1, n))  # z at the nodes; the last row: before the first sample
    held[:-1] = force @ D12.T  # a delay of inputs alone may refer to the current cell
    states, came, each = np.zeros((cells + 1, H.n_states)), np.zeros((cells + 1, degree + 1, n)), np.arange(n)
    states[0] = x0
    for c in range(cells):
        # (nodes, n, nodes of the delayed cell)
        came[c] = w = np.einsum("jil,jil->ji", held[source[c], :, each], weights[c])
        free, forced = maps[kind[c]]
        x = free @ states[c] + np.tensordot(forced, np.hstack([w, force[c]]), ([2, 3], [0, 1]))
        held[c] = x @ C1.T + w @ D11.T + force[c] @ D12.T
        states[c + 1] = x[-1]
    last, weights = delayed(np.full((1, 1), mesh[-1]), np.full(1, mesh[-1] + steps[-1]))
    came[-1, 0] = np.einsum("jil,jil->ji", held[last[0], :, each], weights[0])
    at = np.searchsorted(mesh, t)
    y = states[at] @ H.C[n:].T + came[at, 0] @ H.D[n:, :n].T + u @ H.D[n:, n:].T
    signals = np.concatenate([held[:-1], came[:-1, :, moving]], axis=2)
    size = np.abs(signals).max(axis=(0, 1), initial=0.0)
    tail = np.abs(np.einsum("kj,cji->cki", coefficients[-2:], signals)).max(axis=1, initial=0.0)
    return y, (tail / np.where(size > 0, size, 1.0)).max(axis=1, initial=0.0)


def _chebyshev(place: Array, degree: int) -> Array:
    """Chebyshev's polynomials at each place in [0, 1], shape (*place.shape, degree + 1)."""
    return np.asarray(np.polynomial.chebyshev.chebvander(2.0 * place - 1.0, degree))


def _maps(A: Array, B: Array, steps: Array, nodes: Array, end: float) -> tuple[list[tuple[Array, Array]], Indices]:
    """Return for each length of step the maps from the first state and the inputs to the states at the nodes."""
    from scipy.linalg import expm

    same = 8.0 * np.finfo(float).eps * end  # steps of one period differ by rounding
    _, first, kind = np.unique(np.round(steps / same), return_index=True, return_inverse=True)
    n, m, count = len(A), B.shape[1], len(nodes)
    # The input's derivatives are additional states.
    factorials = np.array([factorial(k) for k in range(count)], dtype=float)
    derivatives = factorials[:, None] * np.linalg.inv(np.vander(nodes, increasing=True))
    made = []
    for h in steps[first]:
        block = np.zeros((n + m * count, n + m * count))
        block[:n, :n], block[:n, n : n + m] = A * h, B * h
        block[n : n + m * (count - 1), n + m :] = np.eye(m * (count - 1))
        e = np.asarray([expm(block * s)[:n] for s in nodes])
        forced = e[:, :, n:].reshape(count, n, count, m)
        made.append((e[:, :, :n], np.einsum("jnkm,kl->jnlm", forced, derivatives)))
    return made, kind
