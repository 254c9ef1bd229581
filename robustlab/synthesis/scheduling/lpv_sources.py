"""LPV models of uncertain sets (proved interpolation error) and of functions (sampled error)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context, is_function
from robustlab.mu_analysis.matrix.certificate import EPS
from robustlab.signals import real_array
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.scheduling.parameter_varying import EXACT, PROVED, SAMPLED, LPVModel
from robustlab.uncertainty.blocks import block_slices
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["lpv_model"]


@error_context("lpv_model")
def lpv_model(
    source: UncertainModel | Callable[..., Any],
    points: Mapping[str, int | Sequence[float]] | None = None,
    rates: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    samples: int = 200,
    seed: int = 0,
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
    rates, units
        Name -> bound of ``|d rho/dt|`` in the parameter's unit per second (default: infinite), and unit.
    samples, seed
        For a function: number of points, the middles of the cells and random ones, at which the interpolation error is
        computed.

    Returns
    -------
    LPVModel
        Of a set ``known`` is ``"exact"`` (multi-affine dependence) or ``"proved"``, of a function ``"sampled"``: the
        largest error computed in each cell.

    Raises
    ------
    InputError
        Blocks other than real parameters, unknown names, values outside the ranges, a discrete model.
    NoTrustworthyNumber
        Cells too wide for a proved error: more points are required.

    Notes
    -----
    Models linearised at equilibria describe deviations from an equilibrium x0. They do not contain the motion of the
    equilibrium itself, ``- dx0/drho rho'``.

    Examples
    --------
    >>> from robustlab.uncertainty.parametric import parametric
    >>> spring = parametric([[0, 1], ["-k", -0.4]], [[0], [1]], [[1, 0]], [[0]], {"k": (2.0, 1.0, 3.0)})
    >>> lpv_model(spring, rates={"k": 0.5}).known
    'exact'
    """
    if isinstance(source, UncertainModel):
        return _of_uncertain(source, points or {}, rates, units or {})
    if not is_function(source):
        found = type(source).__name__
        raise InputError("lpv_model", f"a {found}", "an UncertainModel or a function of the parameters")
    return _of_function(source, points or {}, rates, units, samples, seed)


def _of_uncertain(
    source: UncertainModel, points: Mapping[str, Any], rates: Mapping[str, float] | None, units: Mapping[str, str]
) -> LPVModel:
    blocks: list[Any] = list(source.blocks)
    for b in blocks:
        if not (b.is_real and b.is_scalar):
            hint = "scheduling parameters must be measured: evaluate the set at a value of that block"
            raise InputError(f"lpv_model: block {b.name!r}", type(b).__name__, "real parameters only", hint)
    known = [b.name for b in blocks]
    for name in points:
        if name not in known:
            raise InputError("lpv_model: points", f"no parameter {name!r}", f"one of {', '.join(known)}")
    values = {b.name: _values(b, points.get(b.name, 2)) for b in blocks}
    spans = [(0.0, 1.0) if b.parameter is None else (b.parameter.nominal, b.parameter.radius) for b in blocks]
    entries = [(v - middle) / radius for v, (middle, radius) in zip(values.values(), spans, strict=True)]  # of Delta
    models = [
        source.evaluate({b.name: b.delta(float(e)) for b, e in zip(blocks, at, strict=True)})
        for at in product(*entries)
    ]
    deviation = _proved_deviation(source, entries)
    own = {b.name: b.parameter.unit for b in blocks if b.parameter is not None}
    return LPVModel(values, models, rates, {**own, **units}, deviation, PROVED if deviation.any() else EXACT)


def _values(block: Any, given: int | Sequence[float]) -> Array:
    """Return the values of a parameter within its range."""
    (low, high), where = block.ends, f"lpv_model: points of {block.name!r}"
    if isinstance(given, (int, np.integer)) and not isinstance(given, bool):
        number(where, given, "2 or more", at_least=2)
        return np.linspace(low, high, int(given))
    values = real_array(f"points of {block.name!r}", given, 1, "lpv_model")
    if (values < low - 1e-12 * abs(low)).any() or (values > high + 1e-12 * abs(high)).any():
        raise InputError(where, f"{values.min():g} .. {values.max():g}", f"{low:g} .. {high:g}")
    return values


def _proved_deviation(source: UncertainModel, entries: Sequence[Array]) -> Array:
    """Return a bound of the interpolation error in each cell, entry by entry."""
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
            raise NoTrustworthyNumber(
                "lpv_model", "a cell so wide that the set may not be well posed in it", None, "give more points"
            )
        W = at @ np.linalg.inv(np.eye(p) - loop)
        back = np.abs(np.linalg.inv(np.eye(q) - middle @ inner))
        V = np.linalg.inv(np.eye(q) - back @ radius @ size) @ back
        for share, (a, b) in zip(shares, ends, strict=True):
            returns = share @ W @ size @ share @ W  # E_i W D E_i W
            found[cell] += 0.25 * (b - a) ** 2 * left @ V @ returns @ right
    return found * (1 + 1e-12)  # rounding of these sums of absolute values


def _of_function(
    source: Callable[..., Any], points: Mapping[str, Any], rates: Any, units: Any, samples: int, seed: int
) -> LPVModel:
    if not points or any(isinstance(v, (int, np.integer)) for v in points.values()):
        raise InputError("lpv_model: points", f"{dict(points)!r}", "the values of each parameter of the function")
    values = {name: real_array(f"points of {name!r}", v, 1, "lpv_model") for name, v in points.items()}
    grid = product(*(v.tolist() for v in values.values()))
    models = [_called(source, dict(zip(values, at, strict=True))) for at in grid]
    plain = LPVModel(values, models, rates, units)
    cells, deviation = list(plain.cells()), np.array(plain.deviation)
    rng = np.random.default_rng(seed)
    for k in range(max(samples, len(cells))):
        cell = cells[k] if k < len(cells) else cells[int(rng.integers(len(cells)))]
        share = np.full(len(cell), 0.5) if k < len(cells) else rng.uniform(size=len(cell))
        at = np.array([v[i] + s * (v[i + 1] - v[i]) for v, i, s in zip(values.values(), cell, share, strict=True)])
        true = _called(source, dict(zip(values, at.tolist(), strict=True)))
        found = np.abs(np.block([[true.A, true.B], [true.C, true.D]]) - plain.matrix_at(at))
        found[found <= 16 * EPS * np.abs(plain.matrix_at(at))] = 0.0  # rounding
        deviation[cell] = np.maximum(deviation[cell], found)
    return LPVModel(values, models, rates, units, deviation, SAMPLED)


def _called(source: Callable[..., Any], values: Mapping[str, float]) -> StateSpaceModel:
    at = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    return as_model(source(**values), f"lpv_model: at {at}")
