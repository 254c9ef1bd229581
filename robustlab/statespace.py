"""Linear time-invariant models in state space, with named signals and units, and their interconnection."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array, is_rank_deficient
from robustlab.display import SHOWN_BLOCKS, Displayable, Facts, Part, matrix_lines, number, short, with_units
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.operators import TransferMatrix
from robustlab.provenance import Traced
from robustlab.signals import (
    COMPLEX,
    Signal,
    SignalLike,
    inputs_of_product,
    is_constant,
    is_number,
    names_of,
    picked,
    real_array,
    same_units,
    signal_positions,
    signals,
)

if TYPE_CHECKING:
    import control

MAX_STATES = 5000


@dataclass(frozen=True)
class OperatingPoint:
    """Where a model was linearised: ``x (n_x,)``, ``u (n_u,)``, ``y (n_y,)``, in the model's units."""

    x: Array
    u: Array
    y: Array


@dataclass(frozen=True, init=False, eq=False)
class StateSpaceModel(TransferMatrix, Displayable, Traced):
    r"""A linear time-invariant model with named signals; immutable.

    .. math:: \dot x = A x + B u, \quad y = C x + D u \quad (dt = 0) \qquad x_{k+1} = A x_k + B u_k \quad (dt > 0)

    Parameters
    ----------
    A, B, C, D
        Real matrices of shape (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u). Zero states (a static gain) are allowed.
    dt
        Sample time in s; 0 means continuous time.
    inputs, outputs, states
        Names, or (name, unit) pairs; ``u1.., y1.., x1..`` where left out.
    operating_point
        Where the model was linearised.
    where
        Name of this model in error messages (a file name, for example).

    Raises
    ------
    InputError
        Shapes that do not fit, NaN or Inf, complex entries, names used twice, a negative ``dt``.

    Examples
    --------
    >>> motor = StateSpaceModel([[-2.0]], [[1.0]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("omega", "rad/s")])
    >>> motor.poles()
    array([-2.+0.j])
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[Signal, ...]
    operating_point: OperatingPoint | None

    quantities: ClassVar[Mapping[str, Any]] = {
        "states": "1", "inputs": [str], "outputs": [str], "spectral_abscissa": float,
        "poles": [{"re": float, "im": float}],
    }  # fmt: skip

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        dt: float = 0.0,
        inputs: Iterable[SignalLike] | None = None,
        outputs: Iterable[SignalLike] | None = None,
        states: Iterable[SignalLike] | None = None,
        operating_point: OperatingPoint | None = None,
        where: str = "StateSpaceModel",
    ) -> None:
        if all(isinstance(m, (list, tuple)) and not m for m in (A, B, C)):  # a static gain: [] has no shape
            gain = real_array("D", D, 2, where)
            A, B, C = np.zeros((0, 0)), np.zeros((0, gain.shape[1])), np.zeros((gain.shape[0], 0))
        a, b, c, d = (real_array(name, m, 2, where) for name, m in zip("ABCD", (A, B, C, D), strict=True))
        _check_shapes(a, b, c, d, where)
        if isinstance(dt, bool) or not isinstance(dt, (int, float, np.number)) or not 0 <= dt < np.inf:
            raise InputError(where, f"dt is {dt}", "0 (continuous) or a positive sample time in s")
        # The dataclass is frozen.
        vars(self).update(
            A=a, B=b, C=c, D=d, dt=float(dt),
            inputs=signals(inputs, d.shape[1], "u", f"{where}: inputs"),
            outputs=signals(outputs, d.shape[0], "y", f"{where}: outputs"),
            states=signals(states, a.shape[0], "x", f"{where}: states"),
            operating_point=_checked_operating_point(operating_point, a, d, where),
        )  # fmt: skip

    def _in_states(self, A: Array, B: Array, C: Array, D: Array | None = None, *, rate: float = 1.0) -> StateSpaceModel:
        """Return the model in as many other states and the time unit ``1 / rate``, with its poles, unchecked."""
        model = object.__new__(type(self))
        known = vars(self).get("_poles")
        parts = {"A": A, "B": B, "C": C, "D": self.D if D is None else D}
        for matrix in parts.values():
            matrix.setflags(write=False)
        vars(model).update(vars(self) | parts | {"operating_point": None})
        if known is not None and rate != 1:
            vars(model)["_poles"] = known / rate
        return model

    @property
    def n_states(self) -> int:
        """Number of states n_x."""
        return self.A.shape[0]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(s.name for s in self.states)

    @property
    def is_discrete(self) -> bool:
        """Return whether ``dt > 0``."""
        return self.dt > 0

    def poles(self) -> NDArray[np.complex128]:
        """Return the eigenvalues of A, shape (n_x,)."""
        return self._poles.copy()

    @cached_property
    def _poles(self) -> NDArray[np.complex128]:
        return np.linalg.eigvals(self.A).astype(np.complex128) if self.n_states else np.zeros(0, np.complex128)

    def spectral_abscissa(self) -> float:
        """Return the largest real part of the poles (dt = 0), or the largest modulus minus one; -inf without states.

        It is negative for asymptotically stable models.
        """
        poles = self._poles
        if not len(poles):
            return -np.inf
        return float(np.abs(poles).max() - 1.0) if self.is_discrete else float(poles.real.max())

    def is_stable(self) -> bool:
        """Return whether all poles lie in the open left half plane (dt = 0) or inside the unit circle (dt > 0)."""
        return self.spectral_abscissa() < 0

    def dc_gain(self) -> Array:
        """Return the steady-state gain (n_y, n_u): ``D - C A^-1 B``, or ``D + C (I - A)^-1 B`` in discrete time.

        Raises InputError: the model has a pole at s = 0 (z = 1).
        """
        lhs = np.eye(self.n_states) - self.A if self.is_discrete else -self.A
        if self.n_states and np.linalg.matrix_rank(lhs) < self.n_states:
            raise InputError("dc_gain", "the model has a pole at zero frequency", "a model without integrators")
        return self.D + self.C @ np.linalg.solve(lhs, self.B) if self.n_states else self.D.copy()

    def select(self, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None) -> StateSpaceModel:
        """Return the model with the named inputs and outputs only, in that order; all states are kept."""
        i = signal_positions(inputs, self.input_names, "select: input")
        o = signal_positions(outputs, self.output_names, "select: output")
        point = self.operating_point
        if point is not None:
            point = replace(point, u=point.u[i], y=point.y[o])
        matrices = {"B": self.B[:, i], "C": self.C[o], "D": self.D[np.ix_(o, i)]}
        signals = {"inputs": [self.inputs[k] for k in i], "outputs": [self.outputs[k] for k in o]}
        return replace(self, **matrices, **signals, operating_point=point)

    def renamed(
        self, inputs: Iterable[SignalLike] | None = None, outputs: Iterable[SignalLike] | None = None
    ) -> StateSpaceModel:
        """Return the model with other signal names; names left out are kept."""
        given = {"inputs": inputs, "outputs": outputs}
        return replace(self, **{side: names for side, names in given.items() if names is not None})

    def __getitem__(self, key: Any) -> StateSpaceModel:
        """Return ``G[outputs, inputs]`` by numbers, slices, names or lists of these; all states are kept."""
        outputs, inputs = picked(key, self.output_names, self.input_names)
        return self.select(inputs, outputs)

    def _product(self, second: Any, first: Any) -> StateSpaceModel:
        return product(second, first)

    def _sum(self, first: Any, second: Any, sign: int) -> StateSpaceModel:
        return parallel(first, second, sign)

    def _loop(self, forward: Any, back: Any, sign: int | None) -> StateSpaceModel:
        around, closed, _ = import_module("robustlab.feedback").feedback_loop(forward, back, sign)
        return feedback(forward, around, closed)

    def _identity(self) -> StateSpaceModel:
        if self.n_inputs != self.n_outputs:
            raise InputError("power", f"a model of {self.n_outputs} x {self.n_inputs}", "a square model")
        return StateSpaceModel([], [], [], np.eye(self.n_inputs), self.dt, self.inputs, self.outputs)

    def inverse(self) -> StateSpaceModel:
        """Return the inverse of a square model with regular D, from the outputs to the inputs."""
        if self.n_inputs != self.n_outputs:
            raise InputError("inverse", f"{self.n_outputs} x {self.n_inputs}", "a square model")
        if self.n_inputs and is_rank_deficient(self.D):
            raise NoTrustworthyNumber("inverse", "D is singular: the inverse is not proper")
        d = np.linalg.inv(self.D)
        matrices = self.A - self.B @ d @ self.C, self.B @ d, -d @ self.C, d
        return StateSpaceModel(*matrices, self.dt, self.outputs, self.inputs, self.states, where="inverse")

    @classmethod
    def from_control(cls, system: Any) -> StateSpaceModel:
        """Convert a ``control.StateSpace`` or ``control.TransferFunction``.

        ``dt=None`` (unspecified) and ``dt=True`` (discrete, unknown sample time) are refused: neither can be simulated.
        """
        import control

        if not isinstance(system, control.StateSpace | control.TransferFunction):
            found = type(system).__name__
            raise InputError("from_control", found, "a control.StateSpace or control.TransferFunction")
        if system.dt is True or (system.dt is None and len(system.poles())):
            found = "True (discrete, sample time unknown)" if system.dt else "None (timebase unspecified)"
            raise InputError("from_control", f"dt={found}", "dt = 0 or a sample time in s")
        if isinstance(system, control.TransferFunction):
            one = (system.ninputs, system.noutputs) == (1, 1)
            num, den = (side[0][0] if one else side for side in (system.num, system.den))
            tf = import_module("robustlab.conversion").tf
            return tf(num, den, float(system.dt or 0.0), system.input_labels, system.output_labels)
        ins, outs, states = map(list, (system.input_labels, system.output_labels, system.state_labels))
        return cls(system.A, system.B, system.C, system.D, float(system.dt or 0.0), ins, outs, states)

    def to_control(self) -> control.StateSpace:
        """Convert to a ``control.StateSpace``, which has no units."""
        import control

        names = {"inputs": self.input_names, "outputs": self.output_names, "states": self.state_names}
        sides = {side: list(known) for side, known in names.items()}
        matrices = (getattr(self, name).copy() for name in "ABCD")
        system = control.StateSpace(*matrices, self.dt, **sides, remove_useless_states=False)
        return cast("control.StateSpace", system)

    def to_json(self) -> dict[str, object]:
        """Return matrices and signals as plain types."""
        sides = {side: [list(s) for s in getattr(self, side)] for side in ("inputs", "outputs", "states")}
        return {"A": self.A, "B": self.B, "C": self.C, "D": self.D, "dt": self.dt, **sides}

    def numbers(self) -> dict[str, Any]:
        return {
            "states": self.n_states, "inputs": list(self.input_names), "outputs": list(self.output_names),
            "spectral_abscissa": self.spectral_abscissa(), "poles": self.poles(),
        }  # fmt: skip

    def headline(self) -> str:
        return f"model with {self.n_states} states, {len(self.inputs)} inputs, {len(self.outputs)} outputs"

    def details(self) -> list[Part]:
        poles = sorted(self.poles(), key=lambda p: (-p.real, p.imag))[:SHOWN_BLOCKS]
        return [Part("", (f"pole{'' if self.is_discrete else ' [1/s]'}",), [(number(p, "", 6),) for p in poles])]

    def facts(self) -> Facts:
        abscissa = self.spectral_abscissa()
        kind = "stable" if abscissa < 0 else "on the stability boundary" if abscissa == 0 else "unstable"
        where, time = f"rightmost {number(abscissa, '1/s')}", "continuous"
        if self.is_discrete:
            where, time = f"largest modulus {number(1 + abscissa)}", f"discrete, dt = {self.dt:g} s"
        return [
            ("time", time),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("states", f"{self.n_states}: {with_units(self.states)}" if self.n_states else "none: a static gain"),
            ("poles", f"{where}: {kind}" if self.n_states else ""),
        ]

    def _numbers(self) -> list[str]:
        given = {name: getattr(self, name) for name in "ABCD"}
        return [line for name, m in given.items() for line in matrix_lines(name, m.tolist(), m.shape[1])]

    def __repr__(self) -> str:
        time = f"dt={self.dt:g} s" if self.is_discrete else "continuous"
        ins, outs = (short(names) for names in (self.input_names, self.output_names))
        return f"StateSpaceModel({self.n_states} states, [{ins}] -> [{outs}], {time})"


def as_model(system: Any, where: str = "model") -> StateSpaceModel:
    """Return a StateSpaceModel of one, of anything with ``.to_model()``, or of an object of python-control."""
    if isinstance(system, StateSpaceModel):
        return system
    to_model = getattr(system, "to_model", None)
    if callable(to_model):
        return as_model(to_model(), where)
    if type(system).__module__.split(".")[0] == "control":
        return StateSpaceModel.from_control(system)
    hint = COMPLEX if isinstance(system, complex) else getattr(system, "no_model", None)
    raise InputError(where, type(system).__name__, "a StateSpaceModel or a control.StateSpace", hint)


# --- interconnection -------------------------------------------------------------------------------------------------


def append(*models: StateSpaceModel) -> StateSpaceModel:
    """Return the block-diagonal model with the inputs and outputs of all models, under unique names."""
    from scipy.linalg import block_diag

    dt = _common_dt(models, "append")
    empty = np.zeros((0, 0))
    A, B, C, D = (np.asarray(block_diag(empty, *(getattr(m, name) for m in models))) for name in "ABCD")
    inputs, outputs = ([s for m in models for s in getattr(m, side)] for side in ("inputs", "outputs"))
    return StateSpaceModel(A, B, C, D, dt, inputs, outputs, _states(*models), where="append")


def series(first: StateSpaceModel, second: StateSpaceModel) -> StateSpaceModel:
    """Return ``second * first``: the outputs of ``first`` drive the inputs of ``second``, channel by channel."""
    dt = _common_dt((first, second), "product")
    if first.n_outputs != second.n_inputs:
        raise InputError("product", f"{first.n_outputs} outputs into {second.n_inputs} inputs", "equal numbers")
    same_units("product", zip(first.outputs, second.inputs, strict=True))
    n1, n2 = first.n_states, second.n_states
    a = np.block([[first.A, np.zeros((n1, n2))], [second.B @ first.C, second.A]])
    b = np.vstack([first.B, second.B @ first.D])
    c = np.hstack([second.D @ first.C, second.C])
    states = _states(first, second)
    return StateSpaceModel(a, b, c, second.D @ first.D, dt, first.inputs, second.outputs, states, where="product")


def product(second: Any, first: Any) -> StateSpaceModel:
    """Return ``second @ first``: outputs of ``first`` enter ``second``; a number multiplies every channel."""
    if is_number(second):
        second = float(second) * np.eye(_operand(first, "product").n_outputs)
    elif is_number(first):
        first = float(first) * np.eye(_operand(second, "product").n_inputs)
    g2, g1 = _operand(second, "product"), _operand(first, "product")
    inputs = inputs_of_product(second, first, g2.inputs, g1.inputs)
    outputs = names_of(first, second, g2.outputs, g1.outputs)
    return series(g1, g2).renamed(inputs, outputs)


def parallel(first: Any, second: Any, sign: int = 1) -> StateSpaceModel:
    """Return ``first + sign * second`` of one size, with the signals of the first; a number is a 1 x 1 gain."""
    a, b = _operand(first, "sum"), _operand(second, "sum")
    if a.D.shape != b.D.shape:
        found = f"{a.n_outputs} x {a.n_inputs} and {b.n_outputs} x {b.n_inputs}"
        raise InputError("sum", found, "equal sizes", "write a number c as c * numpy.eye(n), or as a full matrix")
    same_units("sum", [*zip(a.inputs, b.inputs, strict=True), *zip(a.outputs, b.outputs, strict=True)])
    n1, n2 = a.n_states, b.n_states
    A = np.block([[a.A, np.zeros((n1, n2))], [np.zeros((n2, n1)), b.A]])
    matrices = A, np.vstack([a.B, b.B]), np.hstack([a.C, sign * b.C]), a.D + sign * b.D
    inputs, outputs = names_of(second, first, a.inputs, b.inputs), names_of(second, first, a.outputs, b.outputs)
    return StateSpaceModel(*matrices, _common_dt((a, b), "sum"), inputs, outputs, _states(a, b), where="sum")


def feedback(plant: Any, controller: Any = 1.0, sign: int = -1) -> StateSpaceModel:
    """Return the closed loop from r to y for ``y = G e``, ``e = r + sign * K y``, with the names of ``plant``."""
    g = _operand(plant, "feedback")
    if is_number(controller):
        if g.n_inputs != g.n_outputs:
            found = f"the number {controller} around {g.n_outputs} x {g.n_inputs} channels"
            raise InputError("feedback", found, "a matrix or a model")
        controller = float(controller) * np.eye(g.n_inputs)
    k = _operand(controller, "feedback")
    dt = _common_dt((g, k), "feedback")
    if k.n_inputs != g.n_outputs or k.n_outputs != g.n_inputs:
        wanted = f"{g.n_inputs} x {g.n_outputs} for a plant of {g.n_outputs} x {g.n_inputs}"
        raise InputError("feedback", f"controller is {k.n_outputs} x {k.n_inputs}", wanted)
    same_units("feedback", [*zip(g.outputs, k.inputs, strict=True), *zip(k.outputs, g.inputs, strict=True)])
    twice = np.hstack([g.B, g.B]), np.vstack([g.C, g.C]), np.tile(g.D, (2, 2))
    signed = StateSpaceModel(k.A, k.B, sign * k.C, sign * k.D, dt, states=k.states)
    return lower_lft(StateSpaceModel(g.A, *twice, dt, states=g.states), signed).renamed(g.inputs, g.outputs)


def lower_lft(P: StateSpaceModel, K: StateSpaceModel) -> StateSpaceModel:
    """Return ``P11 + P12 K (I - P22 K)^-1 P21``: u = K y around the last inputs and outputs of P."""
    dt = _common_dt((P, K), "lower_lft")
    n_u, n_y = K.n_outputs, K.n_inputs
    if n_u > P.n_inputs or n_y > P.n_outputs:
        found = f"K is {n_u} x {n_y}, P is {P.n_outputs} x {P.n_inputs}"
        raise InputError("lower_lft", found, "a K no larger than P transposed")
    n_w, n_z = P.n_inputs - n_u, P.n_outputs - n_y
    b1, b2 = P.B[:, :n_w], P.B[:, n_w:]
    c1, c2 = P.C[:n_z], P.C[n_z:]
    d11, d12, d21, d22 = P.D[:n_z, :n_w], P.D[:n_z, n_w:], P.D[n_z:, :n_w], P.D[n_z:, n_w:]
    # u = (I - DK D22)^-1 (CK xk + DK (C2 x + D21 w))
    with np.errstate(over="ignore", invalid="ignore"):
        f = np.hstack([K.D @ c2, K.C, K.D @ d21])
        if d22.any() and K.D.any():
            e = np.eye(n_u) - K.D @ d22
            if np.linalg.cond(e) > 1e12:
                found = "I - D_K D22 is singular: the loop is not well posed"
                raise InputError("lower_lft", found, "a well-posed loop")
            f = np.linalg.solve(e, f)
        n, nk = P.n_states, K.n_states
        u_x, u_k, u_w = f[:, :n], f[:, n : n + nk], f[:, n + nk :]
        y_x, y_k, y_w = c2 + d22 @ u_x, d22 @ u_k, d21 + d22 @ u_w
        a = np.hstack([np.vstack([P.A + b2 @ u_x, K.B @ y_x]), np.vstack([b2 @ u_k, K.A + K.B @ y_k])])
        b = np.vstack([b1 + b2 @ u_w, K.B @ y_w])
        c = np.hstack([c1 + d12 @ u_x, d12 @ u_k])
        d = d11 + d12 @ u_w
    if not all(np.isfinite(part).all() for part in (a, b, c, d)):
        raise NoTrustworthyNumber("lower_lft", "a product of entries of P and K overflows", "numbers below 1e308")
    return StateSpaceModel(a, b, c, d, dt, P.inputs[:n_w], P.outputs[:n_z], _states(P, K), where="lower_lft")


def _check_shapes(a: Array, b: Array, c: Array, d: Array, where: str) -> None:
    n, n_u, n_y = a.shape[0], d.shape[1], d.shape[0]
    if n > MAX_STATES:
        raise InputError(where, f"A has {n} states", f"at most {MAX_STATES}")
    wanted = {"A": (a, (n, n)), "B": (b, (n, n_u)), "C": (c, (n_y, n))}
    wrong = [f"{name} is {m.shape}, expected {shape}" for name, (m, shape) in wanted.items() if m.shape != shape]
    if wrong:
        raise InputError(where, "; ".join(wrong))


def _checked_operating_point(point: OperatingPoint | None, a: Array, d: Array, where: str) -> OperatingPoint | None:
    if point is None:
        return None
    if not isinstance(point, OperatingPoint):
        raise InputError(f"{where}: operating_point", repr(point), "an OperatingPoint, or None")
    sizes = {"x": a.shape[0], "u": d.shape[1], "y": d.shape[0]}
    vectors: dict[str, Array] = {}
    for name, size in sizes.items():
        vector = real_array(f"operating_point.{name}", getattr(point, name), 1, where)
        if len(vector) != size:
            raise InputError(where, f"operating_point.{name} has {len(vector)} entries", f"{size}")
        vectors[name] = vector
    return OperatingPoint(**vectors)


def _operand(operand: Any, where: str) -> StateSpaceModel:
    if is_constant(operand):
        return StateSpaceModel([], [], [], real_array("gain", operand, 2, where))
    return as_model(operand, where)


def _states(*models: StateSpaceModel) -> list[Signal] | None:
    """Return the states of all models under their own names if these are unique, else None."""
    states = [s for m in models for s in m.states]
    return states if len({s.name for s in states}) == len(states) else None


def _common_dt(models: Sequence[StateSpaceModel], where: str) -> float:
    times = {m.dt for m in models if m.n_states or m.dt}
    if len(times) > 1:
        raise InputError(where, f"sample times {sorted(times)} s", "one common sample time")
    return times.pop() if times else 0.0
