"""Uncertain frequency-response data: a set of responses at given frequencies only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import AnyArray, Array, ComplexArray
from robustlab.display import Displayable, Facts, listed, number, short, with_units
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.operators import Behaviour
from robustlab.provenance import Traced
from robustlab.signals import Signal, SignalLike, picked, real_array, signals
from robustlab.statespace import as_model
from robustlab.uncertainty.blocks import Block, ComplexScalar, FullBlock, as_blocks, delta_matrix, structure_size
from robustlab.uncertainty.lft import ILL_POSED, UncertainModel, closed_response, return_path


@dataclass(frozen=True, init=False, eq=False)
class UncertainFrequencyData(Behaviour, Displayable, Traced):
    r"""Frequency responses :math:`F_u(M_k, \Delta)` at N frequencies; immutable. See `frequency_data`.

    They define neither the response between the frequencies nor poles. ``.feedback(K)`` connects a controller of any
    kind; K includes all other models of the loop.

    Parameters
    ----------
    omega
        Frequencies in rad/s, shape (N,), 0 or more, increasing.
    M
        Complex, shape (N, p + n_y, q + n_u); the channels of Delta come first.
    blocks
        The blocks of Delta; none for plain frequency-response data.
    inputs, outputs
        Signals without the channels of Delta; ``u1``, ``y1``, ... by default.
    """

    omega: Array
    M: ComplexArray
    blocks: tuple[Block, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    operator_rank = 3  # with data and a controller of any kind the result is data
    no_model = "frequency-response data have no state-space model: rl.robust_stability and rl.peak_gain"
    for_control = "control.frd(np.moveaxis(G.nominal, 0, 2), G.omega) is its nominal response"

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
            found = "frequencies that do not increase from 0 on"
            raise InputError(f"{where}: omega", found, "increasing ones, in rad/s")
        response = _complex("M", M, where)
        checked = as_blocks(blocks)
        q, p = structure_size(checked)
        if response.ndim != 3 or len(response) != len(w) or response.shape[1] < p or response.shape[2] < q:
            raise InputError(f"{where}: M", f"shape {response.shape}", f"({len(w)}, {p} or more, {q} or more)")
        bad = np.flatnonzero(~np.isfinite(response).all(axis=(1, 2)))
        if len(bad):
            raise InputError(f"{where}: M", f"NaN or infinite at {w[bad[0]]:g} rad/s", "finite numbers")
        response.setflags(write=False)
        inputs = signals(inputs, response.shape[2] - q, "u", where)
        outputs = signals(outputs, response.shape[1] - p, "y", where)
        self.__dict__.update(omega=w, M=response, blocks=checked, inputs=inputs, outputs=outputs)

    @classmethod
    def read(cls, path: str | Path, name: str = "measured", **options: Any) -> UncertainFrequencyData:
        """Read measured responses from a text table: frequencies first, then columns such as ``y from u real``."""
        from robustlab.files.text_table import read_response

        table = read_response(path, **options)
        try:
            return frequency_data(**table, name=name)
        except InputError as error:
            raise InputError(str(path), f"{error.where}: {error.found}", error.expected, error.hint) from None

    @property
    def delta_shape(self) -> tuple[int, int]:
        """Return ``(q, p)``, the shape of Delta."""
        return structure_size(self.blocks)

    @property
    def nominal(self) -> ComplexArray:
        """Return the responses at Delta = 0, shape (N, n_y, n_u)."""
        q, p = self.delta_shape
        return self.M[:, p:, q:]

    @property
    def delta_channels(self) -> ComplexArray:
        """Return M11 at each frequency, shape (N, p, q), the matrix of `robustlab.mu` for ``blocks``."""
        q, p = self.delta_shape
        return self.M[:, :p, :q]

    def response(self, delta: Any) -> ComplexArray:
        """Return the responses of the member for a Delta, by block names, shape (N, n_y, n_u)."""
        return closed_at(self.omega, self.M, delta_matrix(self.blocks, delta), "response")

    def _loop(self, forward: Any, back: Any, sign: int | None) -> UncertainFrequencyData:
        if forward is not self:
            raise InputError("feedback", "frequency-response data fed back", "data.feedback(K), K a model")
        n_y, n_u = self.nominal.shape[1:]
        h, sign = return_path(self, back, sign, lambda given: frequency_data(given, self.omega), "data")
        (q, p), rows, cols = self.delta_shape, self.M.shape[1], self.M.shape[2]
        both = np.zeros((len(self.omega), rows + h.M.shape[1], cols + h.M.shape[2]), dtype=complex)
        both[:, :rows, :cols], both[:, rows:, cols:] = self.M, h.M
        z, y, z2, v = np.split(np.arange(both.shape[1]), [p, rows, rows + h.delta_shape[1]])
        w, u, w2, e = np.split(np.arange(both.shape[2]), [q, cols, cols + h.delta_shape[0]])
        both = both[:, np.hstack([y, v, z, z2, y])][:, :, np.hstack([u, e, w, w2, u])]
        wires = np.block([[np.zeros((n_u, n_y)), sign * np.eye(n_u)], [np.eye(n_y), np.zeros((n_y, n_u))]])
        M = closed_at(self.omega, both, wires, "feedback")
        return UncertainFrequencyData(self.omega, M, (*self.blocks, *h.blocks), self.inputs, self.outputs)

    def __getitem__(self, key: Any) -> UncertainFrequencyData:
        """Return ``G[outputs, inputs]`` by numbers, slices, names or lists of these; blocks are kept."""
        ins, outs = tuple(s.name for s in self.inputs), tuple(s.name for s in self.outputs)
        o, i = ([every.index(n) for n in some] for every, some in zip((outs, ins), picked(key, outs, ins), strict=True))
        q, p = self.delta_shape
        M = self.M[:, [*range(p), *(p + k for k in o)]][:, :, [*range(q), *(q + k for k in i)]]
        signals = [self.inputs[k] for k in i], [self.outputs[k] for k in o]
        return UncertainFrequencyData(self.omega, M, self.blocks, *signals)

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

    def __repr__(self) -> str:
        (q, p), n = self.delta_shape, len(self.omega)
        ins, outs = (short(tuple(s.name for s in side)) for side in (self.inputs, self.outputs))
        ends = number(float(self.omega[0])) + (f" .. {number(float(self.omega[-1]))}" if n > 1 else "")
        count = f"{n} frequenc{'y' if n == 1 else 'ies'}, {ends} rad/s"
        return f"UncertainFrequencyData({count}, Delta {q} x {p}, [{ins}] -> [{outs}])"


@error_context("frequency_data")
def frequency_data(
    given: Any,
    omega: ArrayLike,
    *,
    radius: ArrayLike | None = None,
    name: str = "measured",
    inputs: Sequence[SignalLike] | None = None,
    outputs: Sequence[SignalLike] | None = None,
) -> UncertainFrequencyData:
    r"""Return frequency-response data: a measured response with its uncertainty, or a model at frequencies.

    .. math:: |G_{ij}(j\omega_k) - \hat G_{k,ij}| \le r_{k,ij} \qquad \text{or} \qquad \bar\sigma(G(j\omega_k) - \hat
       G_k) \le r_k

    Parameters
    ----------
    given
        Responses, complex, shape (N, n_y, n_u), (N,) for one channel, or (n_y, n_u) for one constant over frequency;
        or a model: StateSpaceModel, UncertainModel (its blocks are kept), DelayedModel (delays exact).
    omega
        Frequencies in rad/s, shape (N,), increasing.
    radius
        Of a measured response: one number or shape (N,), the largest singular value of the error, a full block; or
        shape (N, n_y, n_u), each entry by itself, a complex scalar for each. Cover an ellipse by the circle of its
        longer half axis. None: the response is exact.
    name
        Prefix of the names of the blocks.
    inputs, outputs
        Signals of a response; those of a model are kept.

    Returns
    -------
    UncertainFrequencyData
        Blocks ``measured`` (full), or ``measured y1 from u1`` and so on.

    Raises
    ------
    InputError
        Shapes that do not fit, a radius that is negative, a radius of a model.
    NoTrustworthyNumber
        A model has a pole at one of the frequencies.

    Examples
    --------
    >>> found = frequency_data([1.0, 0.5 - 0.5j], [0.0, 1.0], radius=[0.01, 0.02])
    >>> [b.name for b in found.blocks], found.delta_channels.shape
    (['measured y1 from u1'], (2, 1, 1))
    """
    w = real_array("omega", np.atleast_1d(omega), 1, "frequency_data")
    if not isinstance(given, (np.ndarray, list, tuple, int, float, complex)):
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
    try:
        return np.array(given, dtype=np.complex128)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: {name}", repr(given), "an array of numbers") from None


def _with_radius(plain: UncertainFrequencyData, given: ComplexArray, name: str) -> UncertainFrequencyData:
    """Return the data with a block for each entry, or one for all."""
    (n, n_y, n_u), r = plain.M.shape, np.where(given.imag == 0, given.real, np.nan)
    r = np.broadcast_to(r, (n,)) if r.ndim == 0 else r
    if r.shape not in ((n,), plain.M.shape) or not (np.isfinite(r) & (r >= 0)).all():
        found = f"shape {r.shape}" if r.shape not in ((n,), plain.M.shape) else "negative or not finite"
        expected = f"a number, or numbers of 0 or more, ({n},) or {plain.M.shape}"
        raise InputError("frequency_data: radius", found, expected)
    blocks: list[Block]
    if r.ndim == 1 and n_y * n_u > 1:
        blocks = [FullBlock(name, n_y, n_u)]
        left, right = np.eye(n_y), r[:, None, None] * np.eye(n_u)
    else:
        r = r.reshape(plain.M.shape)
        i, j = np.nonzero(r.any(axis=0))
        pairs = zip(i.tolist(), j.tolist(), strict=True)
        blocks = [ComplexScalar(f"{name} {plain.outputs[a].name} from {plain.inputs[b].name}") for a, b in pairs]
        left, right = np.eye(n_y)[:, i], r[:, i, j][:, :, None] * np.eye(n_u)[j]
    q, p = structure_size(blocks)
    M = np.zeros((n, p + n_y, q + n_u), dtype=complex)
    M[:, :p, q:], M[:, p:, :q], M[:, p:, q:] = right, left, plain.M
    return UncertainFrequencyData(plain.omega, M, blocks, plain.inputs, plain.outputs)


def closed_at(omega: Array, m: AnyArray, delta: AnyArray, where: str) -> ComplexArray:
    """Return `closed_response`; NoTrustworthyNumber where it is ill-conditioned at a frequency."""
    q, p = delta.shape
    with np.errstate(all="ignore"):
        condition = np.linalg.cond(np.eye(p) - m[:, :p, :q] @ delta) if p else np.zeros(len(omega))
    if not (condition <= ILL_POSED).all():
        found = f"the interconnection is singular at {omega[~(condition <= ILL_POSED)][0]:g} rad/s"
        raise NoTrustworthyNumber(where, found, None, "a pole is there: omit that frequency")
    return np.asarray(closed_response(m, delta), dtype=np.complex128)
