r"""Models with exact delays: a linear model whose first channels are closed by :math:`e^{-s \tau_i}`.

.. math:: G(s) = H_{22} + H_{21} E(s) (I - H_{11} E(s))^{-1} H_{12}, \qquad E(s) = \mathrm{diag}(e^{-s \tau_i})

Every interconnection of such models is one. Delays of one length are one and the same operator, so that they behave as
a repeated block of an uncertain model does: `robustlab.uncertainty` carries the interconnections out, and takes away
what repetitions do not show.

References
----------
Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 10.1; Gumussoy, Eryilmaz, Gahinet, "Working with
time-delay systems in MATLAB", IFAC Workshop on Time Delay Systems (2012).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array, ComplexArray
from robustlab.delays.channels import chained, closed, covering, in_order, named
from robustlab.delays.pade import checked_order, pade
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.frequency import CHUNK, frequency_response
from robustlab.operators import TransferMatrix
from robustlab.provenance import Traced
from robustlab.shown import Facts, Shown, listed, number, short, with_units
from robustlab.signals import Signal, is_constant, picked, real_array
from robustlab.statespace import StateSpaceModel, append, as_model, series
from robustlab.uncertainty.blocks import ComplexScalar
from robustlab.uncertainty.interconnection import Wiring
from robustlab.uncertainty.lft import UncertainModel, as_uncertain, feedback, interconnected, inverse, parallel, product
from robustlab.uncertainty.upper_lft import upper_lft

# Samples of delay of a discrete model; each is a state.
MOST_SAMPLES = 2000
# How far from a whole number of samples a discrete delay may be, relative to one sample.
WHOLE = 1e-9


@dataclass(frozen=True, init=False, eq=False)
class DelayedModel(TransferMatrix, Shown, Traced):
    r"""A linear model with exact delays anywhere in it; immutable, continuous in time.

    .. math:: \dot x = A x + B_1 w + B_2 u, \quad z = C_1 x + D_{11} w + D_{12} u, \quad y = C_2 x + D_{21} w + D_{22}
       u, \quad w_i(t) = z_i(t - \tau_i)

    Most are made by `robustlab.delay` and `robustlab.with_delays`, and by the operators ``@``, ``+``, ``feedback``.

    Parameters
    ----------
    H
        State-space model, continuous. Its first inputs are w and its first outputs z.
    delays
        :math:`\tau_i \ge 0` in s, shape (n,). Channels are put in the order of their delays; a delay of zero is closed,
        and two that follow one another and feed nothing else become one.

    Raises
    ------
    InputError
        A discrete model, fewer channels than delays, a delay that is negative or not finite.
    NoTrustworthyNumber
        A channel without delay makes a loop that is not well posed.

    Examples
    --------
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
        put = object.__setattr__
        model, lengths = in_order(*chained(*closed(model, lengths)))
        lengths.setflags(write=False)
        put(self, "H", model)
        put(self, "delays", lengths)

    # --- sizes and names ---------------------------------------------------------------------------------------------

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
        """Number of inputs n_u."""
        return len(self.inputs)

    @property
    def n_outputs(self) -> int:
        """Number of outputs n_y."""
        return len(self.outputs)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(s.name for s in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(s.name for s in self.outputs)

    @property
    def dt(self) -> float:
        """0: continuous time."""
        return 0.0

    @property
    def is_discrete(self) -> bool:
        """False: a discrete delay is a row of states."""
        return False

    # --- behaviour ---------------------------------------------------------------------------------------------------

    def response_at(self, omega: ArrayLike) -> ComplexArray:
        """Exact frequency response, shape (n_omega, n_y, n_u): states and delays are solved for at once, so that a pole
        of the parts that the loop has moved, an integrator's for example, is no pole here.

        Raises
        ------
        InputError
            A frequency that is not finite: a delay has no limit there.
        NoTrustworthyNumber
            A pole lies at a frequency.
        """
        w = real_array("omega", np.atleast_1d(omega), 1, "frequency_response")
        if not len(self.delays):
            return frequency_response(self.H, w)
        try:
            return self._solved(1j * w)
        except np.linalg.LinAlgError:
            at_pole = "a frequency hits a pole exactly"
            raise NoTrustworthyNumber("frequency_response", at_pole, None, "leave that frequency out") from None

    def values_at(self, s: ComplexArray) -> ComplexArray:
        """The transfer matrix at complex numbers (n,), shape (n, n_y, n_u): what ``G(s)`` answers."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                found = self._solved(s)
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("G(s)", "s hits a pole exactly", "a number that is no pole") from None
        if not np.isfinite(found).all():
            raise NoTrustworthyNumber("G(s)", "exp(s tau) overflows", "a real part below 700 / tau")
        return found

    def _solved(self, s: ComplexArray) -> ComplexArray:
        """The same; numpy's LinAlgError at a pole."""
        inner, B, C, D = self.at_once()
        found = np.empty((len(s), *D.shape), dtype=complex)
        step = max(1, CHUNK // max(len(inner), 1) ** 2)
        for first in range(0, len(s), step):
            part = s[first : first + step]
            solved = np.linalg.solve(self.turned(-inner, part), np.broadcast_to(B, (len(part), *B.shape)))
            found[first : first + step] = D + C @ solved
        return found

    def at_once(self) -> tuple[Array, Array, Array, Array]:
        """``[A B1; C1 D11]``, ``[B2; D12]``, ``[C2 D21]``, D22 in balanced unknowns: states, what leaves delays."""
        from scipy.linalg import matrix_balance

        H, k = self.H, len(self.delays)
        inner, scale = np.block([[H.A, H.B[:, :k]], [H.C[:k], H.D[:k, :k]]]), np.ones(H.n_states + k)
        if len(scale):
            balanced: Any = matrix_balance(inner, permute=False, separate=True)
            scale = np.asarray(balanced[1][0], dtype=float)
        B, C = np.vstack([H.B, H.D[:k]])[:, k:], np.hstack([H.C, H.D[:, :k]])[k:]
        return inner / scale[:, None] * scale, B / scale[:, None], C * scale, H.D[k:, k:]

    def turned(self, matrix: Array, s: ComplexArray) -> ComplexArray:
        """A matrix over the unknowns of `at_once`, plus s and the delays' leads on its diagonal, for each s (n,)."""
        column, place = s[:, None], np.arange(len(matrix))
        found = np.broadcast_to(matrix, (len(s), *matrix.shape)).astype(np.complex128)
        found[:, place, place] += np.hstack([np.repeat(column, self.H.n_states, axis=1), np.exp(column * self.delays)])
        return found

    def undelayed(self) -> StateSpaceModel:
        """The model with all delays at zero.

        Raises
        ------
        NoTrustworthyNumber
            A loop through the delays is then not well posed.
        """
        return upper_lft(self.H, np.eye(len(self.delays)))

    def pade(self, order: int) -> StateSpaceModel:
        r"""The model with a rational approximation in the place of each delay: Padé's, of equal degrees.

        The error of one delay is proved: :math:`|e^{-j\omega\tau} - R_n| \le \min(2, c_n (\omega \tau)^{2n+1})`; what
        it does to a loop is what `uncertain` answers.

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
        checked_order(order, "pade")
        return self._closed_by([as_uncertain(named(pade(t, order), i)) for i, t in enumerate(self.delays)], "pade").M

    def uncertain(
        self, order: int = 3, spread: float | Sequence[float] = 0.0, weight_order: int = 3, name: str = ""
    ) -> UncertainModel:
        r"""A set that holds the model with its exact delays: Padé's approximation, and a block for what it misses.

        .. math:: e^{-s \tau} = R_n(s) + W(s) \Delta(s), \qquad |e^{-j\omega\tau} - R_n(j\omega\tau)| \le |W(j\omega)|
           \text{ for all } \omega

        That is proved for all frequencies, not on a grid: see `robustlab.delays.pade`. :math:`\Delta` is stable: the
        error is, and the weight has its zeros at s = 0 only, where the error has as many. So whatever is proved of the
        set (`robust_stability`, `worst_case_gain`, `worst_case_disk_margin`) is proved of the model with its delays.
        Delays of one length share one repeated block. A delay that is not known exactly gets a block of its own in each
        channel, :math:`|e^{-j\omega(\tau + \delta)} - R_n(j\omega\tau)| \le |W(j\omega)|` for all :math:`|\delta|` up
        to its spread.

        Parameters
        ----------
        order
            Order n of the approximations, 0 to 40. Each more covers the delay further up in frequency: the weight
            passes 1 near :math:`\omega \tau = 2, 5, 6, 8, 10` for n = 1, 2, 3, 4, 6.
        spread
            How far each delay may be off, in s; one number, or one for each of ``delays``. Not above the delay itself.
        weight_order
            Slope of the weight, 1 to 2n + 1, and its number of states; of more than 2n + 1 that many are used. With a
            spread the weight has the slope one at low frequencies, and needs 2 of them at least where n > 0.
        name
            Put before the names of the spreads' blocks. Equal names are one uncertainty: two sets whose delays vary
            each on its own need two.

        Returns
        -------
        UncertainModel
            Blocks ``delay of 0.4 s (order 3, slope 3)``, or ``spread 1 of 0.4 s +- 0.1 s`` where there is one.

        Raises
        ------
        InputError
            An order or a spread out of range.
        NoTrustworthyNumber
            The nominal loop is not well posed.
        """
        checked_order(order, "uncertain")
        width = np.broadcast_to(np.asarray(spread, dtype=float), self.delays.shape)
        if not ((width >= 0) & (width <= self.delays)).all():
            raise InputError("uncertain: spread", f"{spread!r}", "numbers from 0 s to the delay itself")
        if isinstance(weight_order, int):
            weight_order = min(weight_order, 2 * order + 1)
        parts = [
            covering(float(t), float(s), order, weight_order, i, name)
            for i, (t, s) in enumerate(zip(self.delays, width, strict=True))
        ]
        return self._closed_by(parts, "uncertain")

    def _closed_by(self, parts: list[UncertainModel], where: str) -> UncertainModel:
        """H with a model or set of one input and output in the place of each delay."""
        n, n_u, n_y = len(self.delays), self.n_inputs, self.n_outputs
        K, E, F = np.zeros((2 * n + n_u, 2 * n + n_y)), np.zeros((2 * n + n_u, n_u)), np.zeros((n_y, 2 * n + n_y))
        K[:n, n : 2 * n] = np.eye(n)  # z of H into the parts
        K[n : 2 * n, :n] = np.eye(n)  # and what leaves them into w of H
        E[2 * n :] = np.eye(n_u)
        F[:, 2 * n :] = np.eye(n_y)
        return interconnected([*parts, as_uncertain(self.H)], Wiring(K, E, F), self.inputs, self.outputs, where)

    # --- parts and algebra: carried out on sets with a repeated block for each length of delay -----------------------

    operator_rank = 2  # a delayed model and a model make a delayed model
    no_model = "exact delays have no state-space model: take .pade(order), or .uncertain(order) for what is proved"

    def carried(self, function: Callable[..., UncertainModel], *operands: Any, **options: Any) -> DelayedModel:
        """An interconnection that is written for sets, of delayed models and what can be made one."""
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
        """H with one repeated block for each length of delay, named by it; the block stands for the exact delay."""
        found, counts = np.unique(self.delays, return_counts=True)
        return UncertainModel(self.H, [ComplexScalar(_name(t), int(k)) for t, k in zip(found, counts, strict=True)])

    def _product(self, second: Any, first: Any) -> DelayedModel:
        return self.carried(product, second, first)

    def _sum(self, first: Any, second: Any, sign: int) -> DelayedModel:
        return self.carried(parallel, first, second, sign=sign)

    def _loop(self, forward: Any, back: Any, sign: int) -> DelayedModel:
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
            What passes without delay has no inverse: that of the whole would look ahead.
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

    def to_json(self) -> dict[str, object]:
        """H and delays as plain types."""
        return {"H": self.H, "delays": self.delays}

    def facts(self) -> Facts:
        """Signals with units, states, delays."""
        return [
            ("time", "continuous"),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("states", str(self.H.n_states)),
            ("delays", listed(number(float(t), "s") for t in self.delays) or "none"),
        ]

    def _numbers(self) -> list[str]:
        told = [
            f"delays: {', '.join(number(float(t)) for t in self.delays)} s, from the first outputs to the first inputs"
        ]
        return [*(told if len(self.delays) else []), *self.H._numbers()]

    def __repr__(self) -> str:
        n = self.H.n_states
        lengths = listed(number(float(t)) for t in self.delays)
        told = f"delays of {lengths} s" if lengths else "no delays"
        ins, outs = short(self.input_names), short(self.output_names)
        return f"DelayedModel({n} state{'s' * (n != 1)}, {told}, [{ins}] -> [{outs}])"


@told_as("delay")
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
    >>> frequency_response(delay(2.0), [0.25])[0, 0, 0].round(4)
    np.complex128(0.8776-0.4794j)
    >>> delay(0.03, dt=0.01)
    StateSpaceModel(3 states, [u1] -> [y1], dt=0.01 s)
    """
    if isinstance(n, bool) or not isinstance(n, int) or n < 1:
        raise InputError("delay: n", f"{n!r}", "a whole number of channels, 1 or more")
    given: Any = [tau] * n if np.ndim(tau) == 0 else tau
    lengths = real_array("tau", given, 1, "delay")
    gain = StateSpaceModel([], [], [], np.eye(len(lengths)), dt)
    return with_delays(gain, inputs=dict(enumerate(lengths.tolist())))


@told_as("with_delays")
def with_delays(
    G: Any, inputs: Mapping[Any, float] | None = None, outputs: Mapping[Any, float] | None = None
) -> DelayedModel | StateSpaceModel:
    r"""The model with exact delays of some of its inputs and outputs.

    Parameters
    ----------
    G
        A StateSpaceModel, a plant, a python-control object or a DelayedModel.
    inputs, outputs
        Name or number of a signal -> its delay in s, 0 or more.

    Returns
    -------
    DelayedModel or StateSpaceModel
        For a discrete G a model with a state :math:`z^{-1}` for each sample of delay, else a DelayedModel.

    Raises
    ------
    InputError
        No such signal; a delay that is negative or not finite, or for a discrete G no whole number of samples.

    Examples
    --------
    >>> motor = StateSpaceModel([[-2.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["omega"])
    >>> with_delays(motor, inputs={"u": 0.01}, outputs={"omega": 0.02})
    DelayedModel(1 state, delays of 0.01, 0.02 s, [u] -> [omega])
    """
    model = G if isinstance(G, DelayedModel) else as_model(G, "with_delays")
    before, longest = _ranges("input", inputs, model.input_names, "with_delays")
    after, latest = _ranges("output", outputs, model.output_names, "with_delays")
    if (before, after) != (longest, latest):
        raise InputError("with_delays", "a range of delays", "one length each", "uncertain_delays takes ranges")
    if isinstance(model, StateSpaceModel) and model.is_discrete:
        whole = series(series(_shifts(before, model.dt), model), _shifts(after, model.dt))
        return whole.renamed(model.inputs, model.outputs)
    whole = _bank(after) @ as_delayed(model) @ _bank(before)
    n = len(whole.delays)
    ins = [*whole.H.input_names[:n], *model.inputs]
    return DelayedModel(
        whole.H.renamed(_apart(ins, n), _apart([*whole.H.output_names[:n], *model.outputs], n)), whole.delays
    )


@told_as("uncertain_delays")
def uncertain_delays(
    G: Any,
    inputs: Mapping[Any, float | Sequence[float]] | None = None,
    outputs: Mapping[Any, float | Sequence[float]] | None = None,
    order: int = 3,
    weight_order: int = 3,
) -> UncertainModel:
    r"""An uncertain model, or any other, with delays of its inputs and outputs, exact or within a range, covered.

    What is proved of the result is proved of the model with every such delay; see `DelayedModel.uncertain`. Delays in
    a range vary each on its own.

    Parameters
    ----------
    G
        An UncertainModel, a StateSpaceModel, a plant or a DelayedModel; continuous.
    inputs, outputs
        Name or number of a signal -> its delay in s, or its shortest and its longest delay.
    order, weight_order
        Of the approximations and of the weights of their error, as in `DelayedModel.uncertain`.

    Returns
    -------
    UncertainModel
        With the blocks of G, and those of the delays.

    Raises
    ------
    InputError
        No such signal, a delay that is negative or not finite, a range that ends before it begins, a discrete model.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> [b.name for b in uncertain_delays(lag, inputs={0: (0.1, 0.3)}).blocks]
    ['u1: spread 1 of 0.2 s +- 0.1 s']
    """
    model = (
        G.uncertain(order, weight_order=weight_order)
        if isinstance(G, DelayedModel)
        else as_uncertain(G, "uncertain_delays")
    )
    if model.dt:
        raise InputError("uncertain_delays", f"a discrete model, dt = {model.dt:g} s", "a continuous one")
    banks: list[UncertainModel] = []
    for side, given, signals in (("input", inputs, model.inputs), ("output", outputs, model.outputs)):
        low, high = _ranges(side, given, tuple(s.name for s in signals))
        parts = [
            _bank([_short(0.5 * (a + b))]).uncertain(order, _short(0.5 * (b - a)), weight_order, f"{s.name}: ")
            if b
            else as_uncertain(1.0)
            for a, b, s in zip(low, high, signals, strict=True)
        ]
        n = len(parts)
        wiring = Wiring(np.zeros((n, n)), np.eye(n), np.eye(n))
        banks.append(interconnected(parts, wiring, signals, signals, "uncertain_delays"))
    whole = product(banks[1], product(model, banks[0]))
    return UncertainModel(whole.M, whole.blocks)


def as_delayed(system: Any, where: str = "as_delayed") -> DelayedModel:
    """A delayed model as it is; a model or a matrix as one without delays.

    Raises InputError: none of these; an uncertain model, whose blocks and exact delays do not mix.
    """
    if isinstance(system, DelayedModel):
        return system
    if isinstance(system, UncertainModel) and system.blocks:
        found = "an uncertain model and exact delays"
        raise InputError(where, found, "one or the other", "cover the delays first: .uncertain(order) makes a set")
    return DelayedModel(as_model(system, where), [])


# --- names and banks ---------------------------------------------------------------------------------------------


def _name(length: float) -> str:
    return f"{float(length)!r} s"


def _apart(names: Sequence[Any], n: int) -> list[Any]:
    """Names of the delays' channels that none of the other signals has."""
    taken = {s if isinstance(s, str) else s[0] for s in names[n:]}
    made: list[Any] = []
    for name in names[:n]:
        while name in taken:
            name = f"{name}'"
        taken.add(name)
        made.append(name)
    return [*made, *names[n:]]


def _ranges(
    side: str, given: Mapping[Any, Any] | None, names: tuple[str, ...], where: str = "uncertain_delays"
) -> tuple[list[float], list[float]]:
    """Shortest and longest delay of each signal; zero where none is given."""
    low, high = [0.0] * len(names), [0.0] * len(names)
    for key, value in (given or {}).items():
        number = isinstance(key, (int, np.integer)) and not isinstance(key, bool)
        if not (key in names or (number and 0 <= int(key) < len(names))):
            raise InputError(f"{where}: {side} {key!r}", "no such signal", f"one of {', '.join(names)}")
        ends = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
        real = all(isinstance(v, (int, float, np.number)) and not isinstance(v, bool) for v in ends)
        if not real or len(ends) != 2 or not 0 <= ends[0] <= ends[1] < np.inf:
            raise InputError(f"{where}: {side} {key!r}", f"{value!r}", "a delay of 0 s or more, or a range of such")
        place = int(key) if number else names.index(str(key))
        low[place], high[place] = float(ends[0]), float(ends[1])
    return low, high


def _short(length: float) -> float:
    """Without the rounding of its last digits, which the weights cover."""
    return float(f"{length:.12g}")


def _bank(lengths: list[float]) -> DelayedModel:
    """Delays side by side, one for each channel."""
    n, eye = len(lengths), np.eye(len(lengths))
    model = StateSpaceModel([], [], [], np.block([[np.zeros((n, n)), eye], [eye, np.zeros((n, n))]]))
    return DelayedModel(model, lengths)


def _shifts(lengths: list[float], dt: float) -> StateSpaceModel:
    """Rows of states z^-1 side by side, one for each channel."""
    parts: list[StateSpaceModel] = []
    for i, length in enumerate(lengths):
        count = round(length / dt)
        if abs(length / dt - count) > WHOLE * max(count, 1):
            found, hint = f"{length:g} s is {length / dt:.6g} samples of {dt:g} s", "delay the continuous model"
            raise InputError("with_delays", found, "a whole number of samples", hint)
        if count > MOST_SAMPLES:
            raise InputError("with_delays", f"{length:g} s is {count} samples", f"at most {MOST_SAMPLES}")
        row = np.diag(np.ones(max(count - 1, 0)), -1) if count else np.zeros((0, 0))
        b, c = np.eye(count, 1), np.eye(1, count, count - 1) if count else np.zeros((1, 0))
        names = [f"delay{i + 1}.{k + 1}" for k in range(count)]
        parts.append(StateSpaceModel(row, b, c, [[float(count == 0)]], dt, [f"i{i}"], [f"o{i}"], names))
    return append(*parts)
