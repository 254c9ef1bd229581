"""Linear parameter-varying (LPV) models: state-space models at the points of a grid, multi-linear between them.

Of uncertain sets with a proved interpolation error, of functions with one that is sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.checks import choice, whole
from robustlab.display import Displayable, Facts, listed, number, short, with_units
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, error_context, is_function
from robustlab.operators import Behaviour
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.signals import Signal, law, real_array
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.lft import UncertainModel

# Origin of the bound of the deviation between the points of the grid.
KNOWN = EXACT, PROVED, SAMPLED = "exact", "proved", "sampled"


@dataclass(frozen=True)
class SchedulingParameter:
    """A measured parameter with the ascending values over its range at which the model is given."""

    name: str
    points: tuple[float, ...]
    rate: float = np.inf
    unit: str = ""

    def __post_init__(self) -> None:
        where = f"LPVModel: parameter {self.name!r}"
        values = real_array("points", self.points, 1, where)
        if len(values) < 2 or not (np.diff(values) > 0).all():
            raise InputError(where, f"points {listed(values)}", "at least two, ascending")
        if isinstance(self.rate, bool) or not isinstance(self.rate, (int, float, np.number)) or not self.rate >= 0:
            raise InputError(where, f"rate {self.rate!r}", "a bound >= 0 in its unit per second, or inf")
        self.__dict__.update(points=tuple(values.tolist()), rate=float(self.rate))

    @property
    def words(self) -> str:
        low, high = number(self.points[0]), number(self.points[-1], self.unit)
        rate = "any rate" if np.isinf(self.rate) else f"rate <= {number(self.rate, f'{self.unit or 1}/s')}"
        return f"{self.name} = {low} .. {high} ({len(self.points)} points, {rate})"


@dataclass(frozen=True, init=False, eq=False)
class LPVModel(Behaviour, Displayable, Traced):
    r"""A family of continuous state-space models over a box of measured parameters; immutable.

    .. math:: M(\rho) = \sum_v \alpha_v(\rho) M_v + E(\rho), \qquad M = \begin{bmatrix} A & B \\ C & D \end{bmatrix}

    with multi-linear weights within each cell of the grid. The states must be in the same coordinates at all points.
    Their names are checked, their coordinates are not: physical states have equal coordinates, states of balanced or
    reduced models do not.

    Parameters
    ----------
    points, models
        Name of each parameter -> its values, ascending (two values each give a polytopic model); list of the models at
        all points, the last parameter varying fastest.
    rates, units
        Name -> bound of ``|d rho/dt|`` (default: infinite), and unit of the parameter.
    deviation, known
        Bound of ``|M(rho) - interpolation|`` for each cell, shape (n_1 - 1, ..., n_k - 1, n_x + n_y, n_x + n_u)
        (default: zero), and its origin: ``"exact"`` (no deviation), ``"proved"`` or ``"sampled"``.

    Raises
    ------
    InputError
        Points that do not ascend, a wrong number of models, unequal sizes, names or units, a discrete model.

    Examples
    --------
    >>> slow, fast = (StateSpaceModel([[-a]], [[a]], [[1.0]], [[0.0]]) for a in (1.0, 4.0))
    >>> model = LPVModel({"a": [1.0, 4.0]}, [slow, fast], rates={"a": 2.0})
    >>> model.at(a=2.5).A
    array([[-2.5]])
    """

    for_control = "G.at(...).to_control() is G as a control.StateSpace at one value of every parameter"
    no_model = (
        "freeze it: .at(...) is the model at one value of every parameter; "
        "close a loop before rl.lpv_model makes the family of it"
    )

    parameters: tuple[SchedulingParameter, ...]
    matrices: Array
    n_states: int
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[Signal, ...]
    deviation: Array
    known: str

    def __init__(
        self,
        points: Mapping[str, ArrayLike],
        models: Sequence[Any],
        rates: Mapping[str, float] | None = None,
        units: Mapping[str, str] | None = None,
        deviation: ArrayLike | None = None,
        known: str = EXACT,
    ) -> None:
        rates, units = rates or {}, units or {}
        for word, given in (("points", points), ("rates", rates), ("units", units)):
            if not isinstance(given, Mapping):
                raise InputError(f"LPVModel: {word}", f"{given!r}", "parameter -> value, such as {'a': ...}")
        for name in (*rates, *units):
            _require_name("LPVModel", name, tuple(points))
        if not points:
            raise InputError("LPVModel", "no parameter", "at least one", "a model without any is a StateSpaceModel")
        each = ((n, tuple(np.atleast_1d(p)), rates.get(n, np.inf), units.get(n, "")) for n, p in points.items())
        found = [SchedulingParameter(*one) for one in each]
        grid, flat = tuple(len(p.points) for p in found), [as_model(m, "LPVModel: models") for m in models]
        if len(flat) != int(np.prod(grid)):
            raise InputError("LPVModel", f"{len(flat)} models", f"{' x '.join(map(str, grid))}, one for each point")
        for k, other in enumerate(flat):
            _check_alike(k, flat[0], other)
        stack, one = np.array([_whole(m) for m in flat]), flat[0]
        matrices = stack.reshape(*grid, *stack.shape[1:])
        made = LPVModel.of(found, matrices, one.n_states, one.inputs, one.outputs, one.states, deviation, known)
        self.__dict__.update(vars(made))

    @classmethod
    def of(
        cls, parameters: Sequence[SchedulingParameter], matrices: Array, n_states: int, inputs: Sequence[Signal],
        outputs: Sequence[Signal], states: Sequence[Signal], deviation: ArrayLike | None = None, known: str = EXACT,
    ) -> LPVModel:  # fmt: skip
        """Return the model of stacked matrices ``[A B; C D]``, shape (n_1, ..., n_k, n_x + n_y, n_x + n_u)."""
        choice("LPVModel: known", known, KNOWN)
        cells = (*(len(p.points) - 1 for p in parameters), *matrices.shape[-2:])
        given = np.zeros(cells) if deviation is None else real_array("deviation", deviation, len(cells), "LPVModel")
        if given.shape != cells or (given < 0).any():
            found = "a negative entry" if given.shape == cells else f"shape {given.shape}"
            raise InputError("LPVModel: deviation", found, f"shape {cells}, entries >= 0")
        if known == EXACT and given.any():
            raise InputError("LPVModel: known", "'exact' with a deviation that is not zero", "'proved' or 'sampled'")
        arrays = np.array(matrices), np.array(given)
        for array in arrays:
            array.setflags(write=False)
        made, sides = object.__new__(cls), (tuple(inputs), tuple(outputs), tuple(states))
        fields = (tuple(parameters), arrays[0], n_states, *sides, arrays[1], known)
        made.__dict__.update(zip(cls.__dataclass_fields__, fields, strict=True))
        return made

    def changed(self, **fields: Any) -> LPVModel:
        return LPVModel.of(**({name: getattr(self, name) for name in type(self).__dataclass_fields__} | fields))

    @property
    def grid(self) -> tuple[int, ...]:
        """Numbers of points of the parameters."""
        return self.matrices.shape[:-2]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    def model_of(self, matrix: Array) -> StateSpaceModel:
        """Return a matrix ``[A B; C D]`` as a model with the names of this one."""
        n = self.n_states
        parts = matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:]
        return StateSpaceModel(*parts, 0.0, self.inputs, self.outputs, self.states, where="LPVModel")

    def nodes(self) -> Iterator[tuple[dict[str, float], StateSpaceModel]]:
        """Yield the values of the parameters and the model at each point of the grid."""
        for index in np.ndindex(self.grid):
            values = {p.name: p.points[i] for p, i in zip(self.parameters, index, strict=True)}
            yield values, self.model_of(self.matrices[index])

    def cells(self) -> Iterator[tuple[int, ...]]:
        """Yield the index of the lowest vertex of each cell."""
        return iter(np.ndindex(*(n - 1 for n in self.grid)))

    def at(self, rho: Mapping[str, float] | Sequence[float] | None = None, **values: float) -> StateSpaceModel:
        """Return the model at one value of every parameter: a mapping, a sequence in their order, or by name."""
        return self.model_of(self.matrix_at(self.place(rho, **values)))

    def place(self, rho: Mapping[str, float] | Sequence[float] | None = None, **values: float) -> Array:
        """Return the checked values of the parameters in their order, shape (k,)."""
        if rho is not None and not isinstance(rho, Mapping):
            array = real_array("rho", rho, 1, "LPVModel.at")
            if len(array) != len(self.names):
                raise InputError("LPVModel.at", f"{len(array)} values", f"{len(self.names)}: {', '.join(self.names)}")
            rho = dict(zip(self.names, array.tolist(), strict=True))
        given = {**(rho or {}), **values}
        for name in given:
            _require_name("LPVModel.at", name, self.names)
        for p in self.parameters:
            if p.name not in given or not p.points[0] <= given[p.name] <= p.points[-1]:
                found = f"{p.name} = {given[p.name]:g}" if p.name in given else f"{p.name} is missing"
                raise InputError("LPVModel.at", found, f"{p.points[0]:g} .. {p.points[-1]:g} {p.unit}".strip())
        return np.array([float(given[name]) for name in self.names])

    def matrix_at(self, rho: Array) -> Array:
        """Return ``[A B; C D]`` at the unchecked values rho (k,), clipped to the ranges."""
        found = self.matrices
        for p, value in zip(self.parameters, rho, strict=True):
            i = min(max(int(np.searchsorted(p.points, value)) - 1, 0), len(p.points) - 2)
            share = (value - p.points[i]) / (p.points[i + 1] - p.points[i])
            share = min(max(share, 0.0), 1.0)
            # Keeps constant entries, and those at the points, exactly.
            found = found[i + 1] if share == 1 else found[i] + share * (found[i + 1] - found[i])
        return found

    def refined(self, pieces: int = 2) -> LPVModel:
        """Return the model on a grid with every cell cut into ``pieces`` along each parameter."""
        whole("LPVModel.refined: pieces", pieces, 1)
        parameters, deviation = [], self.deviation
        for axis, p in enumerate(self.parameters):
            cuts = np.arange(pieces * (len(p.points) - 1) + 1) / pieces
            parameters.append(replace(p, points=tuple(np.interp(cuts, range(len(p.points)), p.points))))
            deviation = np.repeat(deviation, pieces, axis)
        places = product(*(p.points for p in parameters))
        matrices = np.array([self.matrix_at(np.array(at)) for at in places])
        shape = *(len(p.points) for p in parameters), *matrices.shape[1:]
        return self.changed(parameters=parameters, matrices=matrices.reshape(shape), deviation=deviation)

    def with_rates(self, **rates: float) -> LPVModel:
        """Return the model with other bounds of the rates of the named parameters."""
        for name in rates:
            _require_name("with_rates", name, self.names)
        return self.changed(parameters=[replace(p, rate=rates.get(p.name, p.rate)) for p in self.parameters])

    def headline(self) -> str:
        models = f"{int(np.prod(self.grid))} models, {self.n_states} states"
        return f"model scheduled by {', '.join(p.name for p in self.parameters)}: {models}"

    def facts(self) -> Facts:
        kind = "polytopic" if set(self.grid) == {2} else "gridded"
        size, word = number(float(self.deviation.max(initial=0.0))), "proved" if self.known == PROVED else "sampled"
        within = f"within {size} of the interpolation, entry by entry ({word})"
        return [
            ("parameters", "; ".join(p.words for p in self.parameters)),
            ("models", f"{int(np.prod(self.grid))}, {kind}, {self.n_states} states"),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("between the points", "the model is multi-linear there" if self.known == EXACT else within),
        ]

    def __repr__(self) -> str:
        ins, outs = (short([s.name for s in side]) for side in (self.inputs, self.outputs))
        size = " x ".join(map(str, self.grid))
        return f"LPVModel({size} over {', '.join(self.names)}, {self.n_states} states, [{ins}] -> [{outs}])"

    def to_json(self) -> dict[str, object]:
        sides = {side: [list(s) for s in getattr(self, side)] for side in ("inputs", "outputs", "states")}
        own = {name: getattr(self, name) for name in ("matrices", "deviation", "known")}
        return {"parameters": [vars(p) for p in self.parameters], **sides, **own}


def _whole(m: StateSpaceModel) -> Array:
    return np.block([[m.A, m.B], [m.C, m.D]])


def _require_name(where: str, name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise InputError(where, f"no parameter {name!r}", f"one of {', '.join(known)}", did_you_mean(name, known))


def _check_alike(k: int, first: StateSpaceModel, other: StateSpaceModel) -> None:
    """Require a continuous model with the sizes, names and units of the first."""
    where = f"LPVModel: model {k}"
    if other.is_discrete:
        raise InputError(where, f"discrete, dt = {other.dt:g} s", "a continuous model")
    for side in ("states", "inputs", "outputs"):
        mine, theirs = getattr(first, side), getattr(other, side)
        if mine != theirs:
            hint = "the coordinates must be the same at all points" if side == "states" else None
            raise InputError(where, f"{side} {with_units(theirs)}", f"{with_units(mine)} as model 0", hint)


@dataclass(frozen=True, eq=False)
class LPVController(Displayable, Traced):
    """A controller ``u = K(rho) y`` with positive feedback, scheduled by measured parameters.

    ``K``: the controllers at the points of the grid, interpolated between them. ``gamma``, ``status``: induced gain of
    the design's loop as proved by `rl.peak_gain`, if any.
    """

    K: LPVModel
    gamma: float | None = None
    status: Status = Status.INCONCLUSIVE
    method: str = ""

    def at(self, rho: Any = None, **values: float) -> StateSpaceModel:
        """Return the controller at one value of every parameter; see `LPVModel.at`."""
        return self.K.at(rho, **values)

    def facts(self) -> Facts:
        own = [("gamma", number(self.gamma, digits=6)), ("method", self.method), ("loop", law(self.K.inputs))]
        return [*own, *self.K.facts()]

    def to_json(self) -> dict[str, object]:
        return {"K": self.K, "gamma": self.gamma, "status": self.status, "method": self.method}


# --- sources ----------------------------------------------------------------------------------------------------------


@error_context("lpv_model")
def lpv_model(
    source: Any,
    points: Mapping[str, int | Sequence[float]] | None = None,
    rates: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    samples: int = 200,
) -> LPVModel:
    r"""Return the LPV model of an uncertain set with measured parameters, or of a function of the parameters.

    Parameters
    ----------
    source
        An `UncertainModel` with real scalar blocks only: each becomes a scheduling parameter of its name, in the unit
        of its physical parameter or else normalised. Or a function of keywords that returns the model at these values,
        for example ``lambda tz: rl.linearise(platform, at=[0, 0, tz, 0, 0, 0])``, with the same physical states
        everywhere.
    points
        Name -> ascending values, or a number of equidistant values (2, the default of a set: the ends). A function
        requires values for all parameters.
    rates, units, samples
        Name -> bound of ``|d rho/dt|`` in the parameter's unit per second (default: infinite), and unit. Number of
        middles of cells and random points at which the interpolation error of a function is computed.

    Returns
    -------
    LPVModel
        Of a set ``known`` is ``"exact"`` (multi-affine dependence) or ``"proved"``, of a function ``"sampled"``: the
        largest error computed in each cell.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Blocks other than real parameters, unknown names, values outside the ranges, a discrete model. Cells too wide
        for a proved error: more points are required.

    Examples
    --------
    >>> from robustlab.uncertainty.parametric import parametric
    >>> spring = parametric([[0, 1], ["-k", -0.4]], [[0], [1]], [[1, 0]], [[0]], {"k": (2.0, 1.0, 3.0)})
    >>> lpv_model(spring, rates={"k": 0.5}).known
    'exact'
    """
    points, units = points or {}, units or {}
    if isinstance(source, UncertainModel):
        return _of_uncertain(source, points, rates, units)
    if not is_function(source):
        found = type(source).__name__
        raise InputError("lpv_model", f"a {found}", "an UncertainModel or a function of the parameters")
    return _of_function(source, points, rates, units, samples)


def _of_uncertain(
    source: Any, points: Mapping[str, Any], rates: Mapping[str, float] | None, units: Mapping[str, str]
) -> LPVModel:
    blocks: list[Any] = list(source.blocks)
    for b in blocks:
        if not (b.is_real and b.is_scalar):
            hint = "scheduling parameters must be measured: evaluate the set at a value of that block"
            raise InputError(f"lpv_model: block {b.name!r}", type(b).__name__, "real parameters only", hint)
    for name in points:
        _require_name("lpv_model: points", name, tuple(b.name for b in blocks))
    values = {b.name: _values(b, points.get(b.name, 2)) for b in blocks}
    spans = [(0.0, 1.0) if b.parameter is None else (b.parameter.nominal, b.parameter.radius) for b in blocks]
    entries = [(v - middle) / radius for v, (middle, radius) in zip(values.values(), spans, strict=True)]  # of Delta
    at_points = (zip(blocks, at, strict=True) for at in product(*entries))
    models = [source.evaluate({b.name: b.delta(float(e)) for b, e in at}) for at in at_points]
    deviation = _proved_deviation(source, entries)
    own = {b.name: b.parameter.unit for b in blocks if b.parameter is not None}
    return LPVModel(values, models, rates, {**own, **units}, deviation, PROVED if deviation.any() else EXACT)


def _values(block: Any, given: int | Sequence[float]) -> Array:
    """Return the values of a parameter within its range."""
    (low, high), where = block.ends, f"lpv_model: points of {block.name!r}"
    if isinstance(given, (int, np.integer)) and not isinstance(given, bool):
        whole(where, given, 2)
        return np.linspace(low, high, int(given))
    values = real_array(f"points of {block.name!r}", given, 1, "lpv_model")
    if (values < low - 1e-12 * abs(low)).any() or (values > high + 1e-12 * abs(high)).any():
        raise InputError(where, f"{values.min():g} .. {values.max():g}", f"{low:g} .. {high:g}")
    return values


def _proved_deviation(source: Any, entries: Sequence[Array]) -> Array:
    """Return a bound of the interpolation error in each cell, entry by entry."""
    from robustlab.uncertainty.blocks import block_slices

    (q, p), m, n = source.delta_shape, source.M, source.M.n_states
    inner, size = m.D[:p, :q], np.abs(m.D[:p, :q])
    left = np.abs(np.vstack([m.B[:, :q], m.D[p:, :q]]))
    right = np.abs(np.hstack([m.C[:p], m.D[:p, q:]]))
    shares = [np.zeros((q, p)) for _ in entries]
    for share, (rows, cols) in zip(shares, block_slices(source.blocks), strict=True):
        share[rows, cols] = np.eye(rows.stop - rows.start)
    cells = tuple(len(e) - 1 for e in entries)
    found = np.zeros((*cells, n + m.n_outputs - p, n + m.n_inputs - q))
    for cell in np.ndindex(*cells):
        ends = [(e[i], e[i + 1]) for e, i in zip(entries, cell, strict=True)]
        middle = np.sum([0.5 * (a + b) * s for s, (a, b) in zip(shares, ends, strict=True)], axis=0)
        radius = np.sum([0.5 * (b - a) * s for s, (a, b) in zip(shares, ends, strict=True)], axis=0)
        # |W| and |V| over the cell; only the terms that return to their own parameter contribute.
        at = np.abs(np.linalg.inv(np.eye(p) - inner @ middle))
        loop = size @ radius @ at
        if loop.size and not np.abs(np.linalg.eigvals(loop)).max() < 1 - 1e-6:
            text = "a cell so wide that the set may not be well posed in it"
            raise NoTrustworthyNumber("lpv_model", text, None, "give more points")
        W = at @ np.linalg.inv(np.eye(p) - loop)
        back = np.abs(np.linalg.inv(np.eye(q) - middle @ inner))
        V = np.linalg.inv(np.eye(q) - back @ radius @ size) @ back
        for share, (a, b) in zip(shares, ends, strict=True):
            returns = share @ W @ size @ share @ W  # E_i W D E_i W
            found[cell] += 0.25 * (b - a) ** 2 * left @ V @ returns @ right
    return found * (1 + 1e-12)  # rounding of these sums of absolute values


def _of_function(
    source: Callable[..., Any], points: Mapping[str, Any], rates: Any, units: Any, samples: int
) -> LPVModel:
    if not points or any(isinstance(v, (int, np.integer)) for v in points.values()):
        raise InputError("lpv_model: points", f"{dict(points)!r}", "the values of each parameter of the function")
    values = {name: real_array(f"points of {name!r}", v, 1, "lpv_model") for name, v in points.items()}
    grid = product(*(v.tolist() for v in values.values()))
    models = [_called(source, dict(zip(values, at, strict=True))) for at in grid]
    plain = LPVModel(values, models, rates, units)
    cells, deviation = list(plain.cells()), np.array(plain.deviation)
    rng = np.random.default_rng(0)
    for k in range(max(samples, len(cells))):
        cell = cells[k] if k < len(cells) else cells[int(rng.integers(len(cells)))]
        share = np.full(len(cell), 0.5) if k < len(cells) else rng.uniform(size=len(cell))
        at = np.array([v[i] + s * (v[i + 1] - v[i]) for v, i, s in zip(values.values(), cell, share, strict=True)])
        true = _called(source, dict(zip(values, at.tolist(), strict=True)))
        found = np.abs(_whole(true) - plain.matrix_at(at))
        found[found <= 16 * np.finfo(float).eps * np.abs(plain.matrix_at(at))] = 0.0  # rounding
        deviation[cell] = np.maximum(deviation[cell], found)
    return LPVModel(values, models, rates, units, deviation, SAMPLED)


def _called(source: Callable[..., Any], values: Mapping[str, float]) -> StateSpaceModel:
    at = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    return as_model(source(**values), f"lpv_model: at {at}")
