r"""Models with exact delays: a linear model whose first channels are closed by :math:`e^{-s \tau_i}`.

.. math:: G(s) = H_{22} + H_{21} E(s) (I - H_{11} E(s))^{-1} H_{12}, \qquad E(s) = \mathrm{diag}(e^{-s \tau_i})

Every interconnection of such models is one. Delays of equal length are the same operator and behave as a repeated block
of an uncertain model: `robustlab.uncertainty` computes the interconnections and removes redundant repetitions.

References
----------
Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 10.1; Gumussoy, Eryilmaz, Gahinet, "Working with
time-delay systems in MATLAB", IFAC Workshop on Time Delay Systems (2012).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.delays.approximation import SHORTEST, checked_order, error_weight, pade, phase_bound
from robustlab.display import Displayable, Facts, listed, number, short, with_units
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.feedback import wired
from robustlab.linear_analysis.frequency import CHUNK, at_pole, frequency_response
from robustlab.operators import TransferMatrix
from robustlab.provenance import Traced
from robustlab.signals import Signal, is_constant, picked, real_array
from robustlab.statespace import StateSpaceModel, append, as_model
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock
from robustlab.uncertainty.lft import (
    UncertainModel,
    Wiring,
    as_uncertain,
    feedback,
    interconnected,
    inverse,
    ones,
    parallel,
    product,
    star,
    upper_lft,
)


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
        if (lengths < 0).any():
            raise InputError("DelayedModel", f"a delay of {lengths.min():g} s", "0 s or more")
        extreme = lengths[(lengths > 0) & ((lengths < SHORTEST) | (lengths > 1 / SHORTEST))]
        if len(extreme):
            raise InputError(
                "DelayedModel", f"a delay of {extreme[0]:g} s", f"0, or {SHORTEST:g} to {1 / SHORTEST:g} s"
            )
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

    @property
    def n_inputs(self) -> int:
        return len(self.inputs)

    @property
    def n_outputs(self) -> int:
        return len(self.outputs)

    @property
    def input_names(self) -> tuple[str, ...]:
        return self.H.input_names[len(self.delays) :]

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.H.output_names[len(self.delays) :]

    dt: ClassVar[float] = 0.0  # continuous time
    is_discrete: ClassVar[bool] = False

    # --- behaviour ---------------------------------------------------------------------------------------------------

    def response_at(self, omega: ArrayLike) -> ComplexArray:
        """Exact frequency response, shape (n_omega, n_y, n_u). States and delays are solved for together, so that poles
        of open-loop parts, such as integrators, are no poles here.

        Raises
        ------
        InputError
            A frequency that is not finite: a delay has no limit there.
        NoTrustworthyNumber
            A pole is at a frequency.
        """
        w = real_array("omega", np.atleast_1d(omega), 1, "frequency_response")
        if not len(self.delays):
            return frequency_response(self.H, w)
        try:
            return self._solved(1j * w)
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("frequency_response", *at_pole(w, 1j * w, self._solved)) from None

    def values_at(self, s: ComplexArray) -> ComplexArray:
        """Return the transfer matrix ``G(s)`` at complex numbers (n,), shape (n, n_y, n_u)."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                found = self._solved(s)
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("G(s)", "s hits a pole exactly", "a number that is no pole") from None
        if not np.isfinite(found).all():
            raise NoTrustworthyNumber("G(s)", "exp(s tau) overflows", "a real part below 700 / tau")
        return found

    def _solved(self, s: ComplexArray) -> ComplexArray:
        """Return the transfer matrix at s; raises numpy's LinAlgError at a pole."""
        from scipy.linalg import matrix_balance

        # Unknowns: states and outputs of delays, balanced.
        H, k, n = self.H, len(self.delays), self.H.n_states
        inner, scale = np.block([[H.A, H.B[:, :k]], [H.C[:k], H.D[:k, :k]]]), np.ones(n + k)
        if len(scale):
            with np.errstate(invalid="ignore"):  # scipy casts the scales to an unused permutation
                balanced: Any = matrix_balance(inner, permute=False, separate=True)
            scale = np.asarray(balanced[1][0], dtype=float)
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
        r"""The model with each delay replaced by its Padé approximation of equal degrees.

        The error of one delay is proved: :math:`|e^{-j\omega\tau} - R_n| \le \min(2, c_n (\omega \tau)^{2n+1})`.
        `uncertain` bounds its effect on a loop.

        Parameters
        ----------
        order
            Order n of each approximation, 0 to 40; it adds as many states for each delay. 0 leaves the delays out.

        Returns
        -------
        StateSpaceModel
            Its states are those of the approximations, then those of H.

        Raises
        ------
        InputError
            Another order.
        NoTrustworthyNumber
            A loop through the approximations is not well posed.
        """
        return self._closed_by([as_uncertain(pade(t, order)) for t in self.delays], "pade").M

    def uncertain(self, order: int = 3, weight_order: int = 3) -> UncertainModel:
        r"""A set that holds the model with its exact delays: Padé's approximation, and a block for its error.

        .. math:: e^{-s \tau} = R_n(s) + W(s) \Delta(s), \qquad |e^{-j\omega\tau} - R_n(j\omega\tau)| \le |W(j\omega)|
           \text{ for all } \omega

        That is proved for all frequencies, not on a grid: see `robustlab.delays.approximation`. :math:`\Delta` is
        stable, because the error is, and has all zeros of the weight, which are at s = 0. A proof for the
        set (`robust_stability`, `peak_gain`) therefore holds for the model with its delays. Delays of one length share
        one repeated block. Delays known within a range only: `with_delays`.

        Parameters
        ----------
        order
            Order n of the approximations, 0 to 40. Higher orders cover the delay to higher frequencies: the weight
            passes 1 near :math:`\omega \tau = 2, 5, 6, 8, 10` for n = 1, 2, 3, 4, 6.
        weight_order
            Slope of the weight, 1 to 2n + 1, and its number of states; of more than 2n + 1 that many are used.

        Returns
        -------
        UncertainModel
            Blocks ``delay of 0.4 s (order 3, slope 3)``.

        Raises
        ------
        InputError
            An order out of range.
        NoTrustworthyNumber
            The nominal loop is not well posed.
        """
        return self._closed_by([covering(float(t), 0.0, order, weight_order) for t in self.delays], "uncertain")

    def _closed_by(self, parts: list[UncertainModel], where: str) -> UncertainModel:
        """Return H with each delay replaced by a model or set of one input and output."""
        n, n_u, n_y = len(self.delays), self.n_inputs, self.n_outputs
        u, y = 2 * n + n_u, 2 * n + n_y  # z of H enters the parts, their outputs w of H
        wiring = Wiring(ones(u, y, (0, n, n), (n, 0, n)), ones(u, n_u, (2 * n, 0, n_u)), ones(n_y, y, (0, 2 * n, n_y)))
        return interconnected([*parts, as_uncertain(self.H)], wiring, self.inputs, self.outputs, where)

    # --- parts and algebra, computed on sets with a repeated block for each length of delay --------------------------

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
        """The model from outputs to inputs.

        Raises
        ------
        InputError
            Not square.
        NoTrustworthyNumber
            The part without delay has no inverse: the inverse would not be causal.
        """
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
        """The closed loop ``u = K y``, its delays exact: y are the last ``K.n_inputs`` outputs, u the last inputs.

        ``rl.robust_stability`` and ``rl.peak_gain`` prove its stability and its gain. Signals of K and plant meet
        by name where they can, else by the names that K states (`robustlab.feedback`); K may have delays.
        """
        given = getattr(K, "K", K)
        k = given if isinstance(given, DelayedModel) else as_model(given, "close: K")
        if k.n_inputs > self.n_outputs or k.n_outputs > self.n_inputs:
            found = f"K of {k.n_outputs} x {k.n_inputs}"
            raise InputError("close", found, f"{self.n_inputs} x {self.n_outputs} at most")
        k = wired(k, self.outputs[self.n_outputs - k.n_inputs :], self.inputs[self.n_inputs - k.n_outputs :], "close")
        if isinstance(k, StateSpaceModel):  # without units, which a controller's file may not state
            ins, outs = [f"k.y{i}" for i in range(k.n_inputs)], [f"k.u{i}" for i in range(k.n_outputs)]
            k = StateSpaceModel(k.A, k.B, k.C, k.D, k.dt, ins, outs)
        return as_delayed(star(self, k, k.n_inputs, k.n_outputs), "close")

    def to_json(self) -> dict[str, object]:
        return {"H": self.H, "delays": self.delays}

    def headline(self) -> str:
        states = f"{self.H.n_states} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"
        return f"model with {len(self.delays)} exact delays, {states}"

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
    """``R + W Delta``: all delays within ``spread`` of ``tau``, as a set with one input and one output.

    Equal names of blocks are one uncertainty, so a name states what its Delta depends on: the length of the delay and
    both orders; with a spread that of its channel.
    """
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
        bound = phase_bound(order)
        words = f"what Padé's approximation of order {order} of a delay of {tau:g} s misses, at most min(2,"
        words += f" {bound.coefficient:.3g} (w {tau:g} s)^{bound.power}) for all w: proved"
        block = ComplexScalar(
            f"delay of {tau!r} s (order {order}, slope {weight.n_states})", origin=words, covers=covers
        )
    side = append(*(m.renamed([f"i{k}"], [f"o{k}"]) for k, m in enumerate((weight, rational))))
    into = np.array([[0.0, 1.0], [0.0, 1.0]])  # (w, z) into both
    D = side.D @ into
    D[1, 0] = 1.0
    model = StateSpaceModel(side.A, side.B @ into, side.C, D, 0.0, ["w", "in"], ["z", "out"], side.states)
    return UncertainModel(model, [block])
