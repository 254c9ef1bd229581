r"""Uncertain frequency-response data: a set of responses at given frequencies, and nothing between them.

.. math:: F_u(M_k, \Delta) = M_{k,22} + M_{k,21} \Delta (I - M_{k,11} \Delta)^{-1} M_{k,12}, \qquad k = 1, \dots, N

for the responses :math:`M_k` at the frequencies :math:`\omega_k`: a measured response with what is not known of it, or
any model at frequencies. Data and models are interconnected as sets are. Each response stands in the interconnection as
a full block with a name of its own, so that `robustlab.uncertainty` carries it out; what it makes of the signals is
then closed at each frequency.

References
----------
Bendat, Piersol, *Random Data* (2010), section 9.2, for the confidence of a measured response; Zhou, Doyle, Glover,
*Robust and Optimal Control* (1996), section 10.1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array, ComplexArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.operators import TransferMatrix
from robustlab.provenance import Traced
from robustlab.shown import SHOWN, Facts, Shown, listed, matrix_lines, number, short, with_units
from robustlab.signals import Signal, SignalLike, is_constant, picked, real_array, signals
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock, as_blocks, block_slices, structure_size
from robustlab.uncertainty.lft import UncertainModel, feedback, parallel, product
from robustlab.uncertainty.upper_lft import ILL_POSED, closed_response

SAME = 1e-12  # frequencies this close, relative, are one


@dataclass(frozen=True, init=False, eq=False)
class UncertainFrequencyData(TransferMatrix, Shown, Traced):
    r"""Frequency responses :math:`F_u(M_k, \Delta)` at N frequencies; immutable. Most come of `frequency_data`.

    Nothing is known between the frequencies, and nothing of poles. Interconnections (``@``, ``+``, ``feedback``,
    `robustlab.star`, `robustlab.beside`, `robustlab.stacked`) take data at the same frequencies, models of any kind,
    matrices and numbers.

    Parameters
    ----------
    omega
        Frequencies in rad/s, shape (N,), 0 or more, increasing.
    M
        Complex, shape (N, p + n_y, q + n_u); the channels of Delta come first.
    blocks
        The blocks of Delta; none for plain frequency-response data.
    inputs, outputs
        Signals without the channels of Delta; ``u1``, ``y1``, ... where left out.

    Raises
    ------
    InputError
        Shapes that do not fit, numbers that are not finite, frequencies that do not increase.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> loop = frequency_data([[2.0]], [0.0, 1.0], radius=0.1).feedback(lag)
    >>> loop
    UncertainFrequencyData(2 frequencies, 0 .. 1 rad/s, Delta 1 x 1, [u1] -> [y1])
    >>> loop.response({"measured y1 from u1": 1.0})[0, 0, 0].real.round(6)
    np.float64(0.677419)
    """

    omega: Array
    M: ComplexArray
    blocks: tuple[Block, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    def __init__(
        self,
        omega: ArrayLike,
        M: ArrayLike,
        blocks: Any = (),
        inputs: Sequence[SignalLike] | None = None,
        outputs: Sequence[SignalLike] | None = None,
    ) -> None:
        where = "UncertainFrequencyData"
        w = real_array("omega", np.atleast_1d(omega), 1, where)
        if not len(w) or w[0] < 0 or (np.diff(w) <= 0).any():
            raise InputError(
                f"{where}: omega", "frequencies that do not increase from 0 on", "increasing ones, in rad/s"
            )
        response = _complex("M", M, where)
        checked = as_blocks(blocks)
        q, p = structure_size(checked)
        if response.ndim != 3 or len(response) != len(w) or response.shape[1] < p or response.shape[2] < q:
            raise InputError(f"{where}: M", f"shape {response.shape}", f"({len(w)}, {p} or more, {q} or more)")
        bad = np.flatnonzero(~np.isfinite(response).all(axis=(1, 2)))
        if len(bad):
            raise InputError(f"{where}: M", f"NaN or infinite at {w[bad[0]]:g} rad/s", "finite numbers")
        response.setflags(write=False)
        put = object.__setattr__
        put(self, "omega", w)
        put(self, "M", response)
        put(self, "blocks", checked)
        put(self, "inputs", signals(inputs, response.shape[2] - q, "u", where))
        put(self, "outputs", signals(outputs, response.shape[1] - p, "y", where))

    @classmethod
    def read(cls, path: str | Path, name: str = "measured", **options: Any) -> UncertainFrequencyData:
        """Measured responses from a table in a text file, with radii where the table has them.

        Parameters
        ----------
        path
            The file: frequencies first, then columns such as ``y from u real``; see
            `robustlab.files.text_table.read_response`.
        name
            Beginning of the names of the blocks, as for `frequency_data`.
        **options
            ``units`` (column -> unit), ``delimiter``, ``decimal``, as there.

        Raises
        ------
        InputError
            What is wrong with the table, or with the numbers in it.
        """
        from robustlab.files.text_table import read_response

        table = read_response(path, **options)
        try:
            return frequency_data(**table, name=name)
        except InputError as error:
            raise InputError(str(path), f"{error.where}: {error.found}", error.expected, error.hint) from None

    @property
    def delta_shape(self) -> tuple[int, int]:
        """``(q, p)``: shape of Delta."""
        return structure_size(self.blocks)

    @property
    def nominal(self) -> ComplexArray:
        """The responses at Delta = 0, shape (N, n_y, n_u)."""
        q, p = self.delta_shape
        return self.M[:, p:, q:]

    @property
    def delta_channels(self) -> ComplexArray:
        """M11 at each frequency, shape (N, p, q): what `robustlab.mu` takes together with ``blocks``."""
        q, p = self.delta_shape
        return self.M[:, :p, :q]

    def response(self, delta: Any) -> ComplexArray:
        """The responses of the member for a Delta, by block names, shape (N, n_y, n_u).

        Raises
        ------
        InputError
            Unknown names, wrong shapes, a complex value for a real block.
        """
        from robustlab.uncertainty.blocks import delta_matrix

        return _closed(self.M, delta_matrix(self.blocks, delta), self.omega, "response")

    def values_at(self, s: ComplexArray) -> ComplexArray:
        """The nominal responses at s = j omega, for frequencies of the data, shape (n, n_y, n_u): for ``G(s)``."""
        places = np.abs(self.omega[None] - s.imag[:, None]).argmin(axis=1)
        off = (s.real != 0) | (np.abs(self.omega[places] - s.imag) > SAME * self.omega[places])
        if off.any():
            k = int(np.flatnonzero(off)[0])
            expected = f"1j * omega of the data, the nearest of them {self.omega[places[k]]:.6g} rad/s"
            raise InputError("G(s)", f"s = {s[k]:.6g}", expected, "nothing is known between the frequencies")
        return self.nominal[places]

    # --- algebra: carried out on sets, each response a block of its own ----------------------------------------------

    operator_rank = 3  # data and a model make data
    for_control = "control.frd(np.moveaxis(G.nominal, 0, 2), G.omega) is its nominal response"
    no_model = "frequency-response data have no state-space model: rl.robust_stability and rl.peak_gain"

    def carried(self, function: Callable[..., Any], *operands: Any, **options: Any) -> UncertainFrequencyData:
        """An interconnection that is written for sets, of data and what has a response at their frequencies."""
        where = function.__name__
        made = [o if is_constant(o) else self.matched(o, where) for o in operands]
        data = [o for o in made if isinstance(o, UncertainFrequencyData)]
        names = [f"response {k + 1} of an interconnection" for k in range(len(data))]
        named = iter(names)
        sets = [o.as_set(next(named)) if isinstance(o, UncertainFrequencyData) else o for o in made]
        found = function(*sets, **options)
        places = dict(zip((b.name for b in found.blocks), block_slices(found.blocks), strict=True))
        order = [*names, *(b.name for b in found.blocks if b.name not in names)]
        q, p = found.delta_shape
        ins = [k for name in order for k in range(q)[places[name][0]]] + list(range(q, found.M.n_inputs))
        outs = [k for name in order for k in range(p)[places[name][1]]] + list(range(p, found.M.n_outputs))
        rows, cols = np.cumsum([[0, 0], *(o.M.shape[1:] for o in data)], axis=0).T
        held = np.zeros((len(self.omega), rows[-1], cols[-1]), dtype=complex)
        for k, o in enumerate(data):
            held[:, rows[k] : rows[k + 1], cols[k] : cols[k + 1]] = o.M
        whole = _closed(found.M.D[np.ix_(outs, ins)][None], held, self.omega, where)
        rest = [b for b in found.blocks if b.name not in names]
        return UncertainFrequencyData(self.omega, whole, rest, found.inputs, found.outputs)

    def matched(self, operand: Any, where: str) -> UncertainFrequencyData:
        """The other operand at these frequencies."""
        if not isinstance(operand, UncertainFrequencyData):
            return frequency_data(operand, self.omega)
        if not np.array_equal(operand.omega, self.omega):
            found = f"data at {len(operand.omega)} and at {len(self.omega)} frequencies, not the same ones"
            raise InputError(where, found, "data at the same frequencies", "nothing is known between them")
        return operand

    def as_set(self, name: str) -> UncertainModel:
        """Wires alone: the response as a full block of this name, then the blocks of the data."""
        (_, outs, ins), (q, p) = self.M.shape, self.delta_shape
        D = np.block([[np.zeros((ins, outs)), np.eye(ins)], [np.eye(outs), np.zeros((outs, ins))]])
        w, z = [f"{name}: w{k}" for k in range(outs + q)], [f"{name}: z{k}" for k in range(ins + p)]
        model = StateSpaceModel([], [], [], D, 0.0, [*w, *self.inputs], [*z, *self.outputs])
        return UncertainModel(model, [FullBlock(name, outs, ins), *self.blocks])

    def _product(self, second: Any, first: Any) -> UncertainFrequencyData:
        return self.carried(product, second, first)

    def _sum(self, first: Any, second: Any, sign: int) -> UncertainFrequencyData:
        return self.carried(parallel, first, second, sign=sign)

    def _loop(self, forward: Any, back: Any, sign: int | None) -> UncertainFrequencyData:
        return self.carried(feedback, forward, back, sign=sign)

    def _identity(self) -> UncertainFrequencyData:
        if len(self.inputs) != len(self.outputs):
            raise InputError("power", f"data of {len(self.outputs)} x {len(self.inputs)}", "a square response")
        one = np.broadcast_to(np.eye(len(self.inputs)), self.nominal.shape)
        return UncertainFrequencyData(self.omega, one, (), self.inputs, self.outputs)

    def inverse(self) -> UncertainFrequencyData:
        """The responses from outputs to inputs.

        Raises
        ------
        InputError
            Not square.
        NoTrustworthyNumber
            The nominal response is singular at a frequency.
        """
        if len(self.inputs) != len(self.outputs):
            raise InputError("inverse", f"{len(self.outputs)} x {len(self.inputs)}", "a square response")
        (q, p), n = self.delta_shape, len(self.inputs)
        # y = M21 w + M22 u solved for u: the first channels carry e = y - M21 w + (I - M22) u, closed by u = e
        wired = np.zeros((len(self.omega), p + 2 * n, q + 2 * n), dtype=complex)
        wired[:, n : n + p, n : n + q], wired[:, n : n + p, :n] = self.M[:, :p, :q], self.M[:, :p, q:]
        wired[:, n + p :, :n] = np.eye(n)
        wired[:, :n, :n] = np.eye(n) - self.M[:, p:, q:]
        wired[:, :n, n : n + q], wired[:, :n, n + q :] = -self.M[:, p:, :q], np.eye(n)
        found = _closed(wired, np.eye(n), self.omega, "inverse")
        return UncertainFrequencyData(self.omega, found, self.blocks, self.outputs, self.inputs)

    def __getitem__(self, key: Any) -> UncertainFrequencyData:
        """``G[outputs, inputs]`` by numbers, slices, names or lists of these; blocks are kept."""
        ins, outs = [s.name for s in self.inputs], [s.name for s in self.outputs]
        some_outs, some_ins = picked(key, tuple(outs), tuple(ins))
        (q, p), i, o = self.delta_shape, [ins.index(n) for n in some_ins], [outs.index(n) for n in some_outs]
        M = self.M[:, [*range(p), *(p + k for k in o)]][:, :, [*range(q), *(q + k for k in i)]]
        return UncertainFrequencyData(
            self.omega, M, self.blocks, [self.inputs[k] for k in i], [self.outputs[k] for k in o]
        )

    def facts(self) -> Facts:
        ends = f"{number(float(self.omega[0]))} .. {number(float(self.omega[-1]), 'rad/s')}"
        return [
            ("frequencies", f"{len(self.omega)}, {ends}; nothing is known between them"),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("blocks", listed(f"{b.name} {b.rows} x {b.cols}" for b in self.blocks) or "no uncertainty"),
        ]

    def to_json(self) -> dict[str, Any]:
        return {"omega": self.omega, "M": self.M, "blocks": [b.to_json() for b in self.blocks]}

    def _numbers(self) -> list[str]:
        first = zip(self.omega[:SHOWN].tolist(), self.nominal[:SHOWN].tolist(), strict=True)
        lines = [line for w, G in first for line in matrix_lines(f"{w:.6g} rad/s", G, len(self.inputs))]
        return [*lines, *([f"and {len(self.omega) - SHOWN} frequencies more"] if len(self.omega) > SHOWN else [])]

    def __repr__(self) -> str:
        (q, p), n = self.delta_shape, len(self.omega)
        ins, outs = (short(tuple(s.name for s in side)) for side in (self.inputs, self.outputs))
        ends = number(float(self.omega[0])) + (f" .. {number(float(self.omega[-1]))}" if n > 1 else "")
        count = f"{n} frequenc{'y' if n == 1 else 'ies'}, {ends} rad/s"
        return f"UncertainFrequencyData({count}, Delta {q} x {p}, [{ins}] -> [{outs}])"


@told_as("frequency_data")
def frequency_data(
    given: Any,
    omega: ArrayLike,
    *,
    radius: ArrayLike | None = None,
    coherence: ArrayLike | None = None,
    averages: int | None = None,
    confidence: float = 0.95,
    name: str = "measured",
    inputs: Sequence[SignalLike] | None = None,
    outputs: Sequence[SignalLike] | None = None,
) -> UncertainFrequencyData:
    r"""Frequency-response data: a measured response with what is not known of it, or a model at frequencies.

    .. math:: |G_{ij}(j\omega_k) - \hat G_{k,ij}| \le r_{k,ij} \qquad \text{or} \qquad \bar\sigma(G(j\omega_k) - \hat
       G_k) \le r_k

    For a response of one input that was estimated with a coherence :math:`\gamma^2` from n independent averages (the
    estimate :math:`\hat G = S_{yu} / S_{uu}`, Gaussian noise at the output, none at the input), r is the quantile of
    the F distribution with 2 and 2n - 2 degrees of freedom in closed form:

    .. math:: r^2 = |\hat G|^2 \, \frac{1 - \gamma^2}{\gamma^2} \left( (1 - c)^{-1/(n-1)} - 1 \right)

    Parameters
    ----------
    given
        Responses, complex, shape (N, n_y, n_u), (N,) for one channel, or (n_y, n_u) for one that is the same at all
        frequencies; or a model: StateSpaceModel, UncertainModel (its blocks are kept), DelayedModel (delays exact).
    omega
        Frequencies in rad/s, shape (N,), increasing.
    radius
        Of a measured response: one number or shape (N,), the largest singular value of the error, a full block; or
        shape (N, n_y, n_u), each entry by itself, a complex scalar for each. An ellipse is held by the circle of its
        longer half axis. None: the response is exact, or its radius is that of the coherence.
    coherence, averages
        In place of a radius: the coherence at the same points as the response, between 0 and 1, and the number n of
        independent records, 2 or more; overlapping ones count as fewer.
    confidence
        c, between 0 and 1: the probability that r holds the true response, at each frequency on its own; for all N at
        once take ``1 - (1 - c) / N``.
    name
        Beginning of the names of the blocks. Equal names are one uncertainty.
    inputs, outputs
        Signals of a response; those of a model are kept.

    Returns
    -------
    UncertainFrequencyData
        Blocks ``measured`` (full), or ``measured y1 from u1`` and so on.

    Raises
    ------
    InputError
        Shapes that do not fit, a radius that is negative, a radius of a model, a coherence outside [0, 1] or without
        averages.
    NoTrustworthyNumber
        A pole of a model lies at a frequency.

    Examples
    --------
    >>> found = frequency_data([1.0, 0.5 - 0.5j], [0.0, 1.0], radius=[0.01, 0.02])
    >>> [b.name for b in found.blocks], found.delta_channels.shape
    (['measured y1 from u1'], (2, 1, 1))
    >>> frequency_data([2.0], [1.0], coherence=[0.9], averages=20).delta_channels.shape
    (1, 1, 1)

    References
    ----------
    Bendat, Piersol, *Random Data* (2010), section 9.2.3.
    """
    if coherence is not None or averages is not None:
        if coherence is None or averages is None or radius is not None:
            parts = {"radius": radius, "coherence": coherence, "averages": averages}
            found = ", ".join(part for part, value in parts.items() if value is not None)
            raise InputError("frequency_data", found, "a radius, or coherence and averages")
        radius = response_radius(given, coherence, averages, confidence)
    w = real_array("omega", np.atleast_1d(omega), 1, "frequency_data")
    if isinstance(given, UncertainModel) or not _is_response(given):
        if radius is not None:
            found, hint = "a radius of a model", "rl.unstructured gives a model a weight at all frequencies"
            raise InputError("frequency_data: radius", found, "a measured response", hint)
        model = given if hasattr(given, "response_at") or isinstance(given, UncertainModel) else as_model(given)
        M = frequency_response(getattr(model, "M", model), w)
        return UncertainFrequencyData(w, M, getattr(model, "blocks", ()), model.inputs, model.outputs)
    G = _complex("response", given, "frequency_data")
    G = G[:, None, None] if G.ndim == 1 else np.broadcast_to(G, (len(w), *G.shape)) if G.ndim == 2 else G
    plain = UncertainFrequencyData(w, G, (), inputs, outputs)
    return plain if radius is None else _with_radius(plain, _complex("radius", radius, "frequency_data"), name)


def _complex(name: str, given: ArrayLike, where: str) -> ComplexArray:
    """Numbers as a new complex array."""
    try:
        return np.array(given, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: {name}", repr(given), "an array of numbers") from None


def _is_response(given: Any) -> bool:
    return isinstance(given, (np.ndarray, list, tuple, int, float, complex))


def _with_radius(plain: UncertainFrequencyData, given: ComplexArray, name: str) -> UncertainFrequencyData:
    """The data with a block for each entry, or one for all."""
    radius = np.where(given.imag == 0, given.real, np.nan)
    n, n_y, n_u = plain.M.shape
    if n_y == n_u == 1 and radius.shape == (n,):
        radius = radius[:, None, None]
    r = np.broadcast_to(radius, (n,)) if radius.ndim == 0 else radius
    if r.shape not in ((n,), plain.M.shape) or not (np.isfinite(r) & (r >= 0)).all():
        found = f"shape {r.shape}" if r.shape not in ((n,), plain.M.shape) else "negative or not finite"
        raise InputError(
            "frequency_data: radius", found, f"a number, or numbers of 0 or more, ({n},) or {plain.M.shape}"
        )
    if n_y == n_u == 1:
        r = r.reshape(n, 1, 1)
    blocks: list[Block]
    if r.ndim == 1:
        blocks = [FullBlock(name, n_y, n_u)]
        left = np.eye(n_y)
        right = r[:, None, None] * np.eye(n_u)
    else:
        pairs = [(i, j) for i in range(n_y) for j in range(n_u) if r[:, i, j].any()]
        blocks = [ComplexScalar(f"{name} {plain.outputs[i].name} from {plain.inputs[j].name}") for i, j in pairs]
        left, right = np.zeros((n_y, len(pairs))), np.zeros((n, len(pairs), n_u))
        for k, (i, j) in enumerate(pairs):
            left[i, k], right[:, k, j] = 1.0, r[:, i, j]
    q, p = structure_size(blocks)
    M = np.zeros((n, p + n_y, q + n_u), dtype=complex)
    M[:, :p, q:], M[:, p:, :q], M[:, p:, q:] = right, left, plain.M
    return UncertainFrequencyData(plain.omega, M, blocks, plain.inputs, plain.outputs)


def response_radius(response: ArrayLike, coherence: ArrayLike, averages: int, confidence: float = 0.95) -> Array:
    """Radius about a measured response of one input that holds the true one with a probability; see `frequency_data`.

    Examples
    --------
    >>> response_radius([2.0], [0.9], 20).round(4)
    array([0.2755])
    """
    G, given = (_complex(k, v, "frequency_data") for k, v in (("response", response), ("coherence", coherence)))
    g2 = np.where(given.imag == 0, given.real, np.nan)
    if G.shape != g2.shape or not ((g2 >= 0) & (g2 <= 1)).all():
        raise InputError("frequency_data: coherence", f"shape {g2.shape}", f"numbers from 0 to 1, shape {G.shape}")
    if isinstance(averages, bool) or not isinstance(averages, (int, np.integer)) or averages < 2:
        raise InputError("frequency_data: averages", f"{averages!r}", "a whole number, 2 or more")
    if not 0 < confidence < 1:
        raise InputError("frequency_data: confidence", f"{confidence!r}", "a number between 0 and 1")
    with np.errstate(divide="ignore"):
        noise = np.where(g2 > 0, (1.0 - g2) / g2, np.inf)
    return np.abs(G) * np.sqrt(noise * np.expm1(-np.log1p(-confidence) / (averages - 1)))


def _closed(m: AnyArray, delta: Any, omega: Array, where: str) -> ComplexArray:
    """`closed_response`, refused where it has no digits left at a frequency."""
    q, p = delta.shape[-2:]
    with np.errstate(all="ignore"):
        condition = np.broadcast_to(np.linalg.cond(np.eye(p) - m[:, :p, :q] @ delta) if p else 1.0, (len(omega),))
    if not (condition <= ILL_POSED).all():
        k = int(np.flatnonzero(~(condition <= ILL_POSED))[0])
        found = f"the interconnection is singular at {omega[k]:g} rad/s"
        raise NoTrustworthyNumber(where, found, None, "a pole lies there: leave that frequency out")
    return np.asarray(closed_response(m, np.asarray(delta)), dtype=np.complex128)
