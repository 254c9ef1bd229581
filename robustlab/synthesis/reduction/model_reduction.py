"""Reduction of models by truncation, residualisation, Hankel, stochastic or coprime methods; errors are certified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, overload

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.magnitude import refuse_extremes
from robustlab.norms import HinfNorm, bilinear_to_continuous, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, append, as_model, parallel, series
from robustlab.synthesis.reduction.balancing import Balancing, Projection, block_factor, gramian_factors, split_stable
from robustlab.synthesis.reduction.coprime_reduction import CoprimeReduction
from robustlab.synthesis.reduction.hankel_norm import error_bound, hankel_bound, hankel_norm, nearest_in_hankel_norm
from robustlab.synthesis.reduction.reduced_model import ReducedModel
from robustlab.synthesis.reduction.relative_error import Spectrum, relative_bound
from robustlab.synthesis.reduction.split_error import SplitError, widened
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.reduction import Reduction, reduction

Weights = tuple[StateSpaceModel | None, StateSpaceModel | None]  # W_i and W_o
Method = Literal["truncation", "residualisation", "hankel", "stochastic", "coprime"]

METHODS = get_args(Method)
# A certified error may exceed what theory promises by this share of the largest Hankel value: rounding of the model.
BOUND_ROUNDING = 1e-10
# Relative widths of the bracket of an error, and of one that may be what is promised.
RTOL, CLOSE_RTOL = 1e-6, 1e-9
# Share of the error that splitting parts off may add to it, before frequencies next to a mode on the boundary are left
# out; the error counts as at least the second share of the largest Hankel value for that.
SPLIT_SHARE, OVERLOOKED = 1e-3, 1e-9
TINY = float(np.finfo(float).tiny)


@told_as("hankel_singular_values")
def hankel_singular_values(model: Any) -> Array:
    r"""Hankel singular values of the stable part of a model, shape (n_stable,), in decreasing order.

    .. math:: \sigma_i = \sqrt{\lambda_i(P Q)}

    with the controllability and observability Gramians P, Q (continuous or discrete), from factors of them.

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object; states of modes that are not stable are left out.

    Returns
    -------
    numpy.ndarray
        Shape (n_stable,), in output units per input unit.

    Raises
    ------
    NoTrustworthyNumber
        Stable modes cannot be told from the others, or Gramians that are no floating-point numbers.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[3.0]], [[0.0]])
    >>> hankel_singular_values(lag)
    array([1.5])
    """
    where = "hankel_singular_values"
    full = as_model(model, where)
    refuse_extremes(full, where)
    return Balancing.of(*gramian_factors(split_stable(full).stable)).values


@overload
def reduce_model(  # pyright: ignore[reportOverlappingOverload]
    model: UncertainModel, *, tolerance: float | None = None
) -> Reduction: ...
@overload
def reduce_model(
    model: Any,
    order: int | None = None,
    *,
    tolerance: float | None = None,
    method: Method = "truncation",
    input_weight: Any = None,
    output_weight: Any = None,
    floor: float = 0.0,
) -> ReducedModel: ...
@told_as("reduce_model")
def reduce_model(
    model: Any,
    order: int | None = None,
    *,
    tolerance: float | None = None,
    method: Method = "truncation",
    input_weight: Any = None,
    output_weight: Any = None,
    floor: float = 0.0,
) -> ReducedModel | Reduction:
    r"""A model of lower order, with its error certified and, where there is one, the a-priori bound beside it.

    .. math:: \|G - G_r\|_\infty \le 2 \sum_{i > r} \sigma_i \quad \text{(truncation, residualisation)}, \qquad
       \|G - G_r\|_H = \sigma_{r+1}, \; \|G - G_r\|_\infty \le \sum_{i > r} \sigma_i \quad \text{(hankel)}

    .. math:: \sup_\omega \sigma_{max}( (G G^* + \beta^2 I)^{-1/2} (G - G_r) ) \le
       \prod_{i > r} \frac{1 + \mu_i}{1 - \mu_i} - 1 \quad \text{(stochastic)}

    Balanced truncation where no ``method`` is given; no model of order r is nearer than :math:`\sigma_{r+1}`.
    Modes that are not stable are split off and kept, and what rounding may add there is part of the error; those that
    no input moves or no output shows are removed (`minimal`).
    ``method="coprime"`` reduces them too, through the normalised right coprime factors ``G = N M^{-1}``, whose error is
    then the H-infinity norm of ``[N - N_r; M - M_r]`` (a bound of the gap between the two models).

    Of an uncertain model the repetitions of its blocks are reduced, exactly: those that cannot be reached or do not
    show are removed, block by block, then jointly, until none is left (`UncertainModel.reduce` gives the set alone).

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object with n states; continuous or discrete, stable or not. Or an
        UncertainModel: ``tolerance`` alone goes with it.
    order
        Number of states of the result, those kept apart included. Fewer come out where the rest is not minimal.
    tolerance
        In place of ``order``: the lowest order whose certified error is at most this is taken; in output units per
        input unit, for ``"stochastic"`` a share. Of an uncertain model: singular values below ``tolerance`` times the
        largest count as zero, 1e-12 where left out.
    method
        ``"truncation"`` is exact at infinite frequency, ``"residualisation"`` (singular perturbation) at zero
        frequency. ``"hankel"`` (Glover) is nearest in the Hankel norm, with a direct term that halves the bound.
        ``"stochastic"`` keeps the error small relative to the gain of the stable part, wherever that is small.
        ``"coprime"`` works for models of any stability.
    input_weight, output_weight
        Stable models W_i (as many outputs as G has inputs) and W_o (as many inputs as G has outputs): one or both
        (Enns), the error is that of ``W_o (G - G_r) W_i``. Large where the error shall be small.
    floor
        beta of ``"stochastic"``, in output units per input unit: below this gain errors count absolutely. Needed where
        the gain vanishes somewhere: without full row rank of D, with more outputs than inputs, with zeros on the axis.

    Returns
    -------
    ReducedModel or Reduction
        With its certified error and the frequencies (``left_out``) next to modes on the stability boundary for which
        nothing is certified; its states are balanced, those kept apart come last. Of an
        uncertain model the sizes of its blocks before and after, with the evidence that it is the same set.

    Raises
    ------
    InputError
        Neither or both of order and tolerance, an order that does not exist, weights that do not fit, a gain
        that vanishes at infinite frequency for ``"stochastic"`` without a floor.
    NoTrustworthyNumber
        Gramians lost their digits; the reduced model is not stable (two weights give no guarantee), or not
        well posed; the gain vanishes at some frequency.

    Notes
    -----
    Where no lower order keeps ``tolerance``, the model comes back with all its (minimal) states.

    References
    ----------
    Moore 1981; Glover 1984 (bound, Hankel norm); Liu, Anderson 1989 (residualisation); Green 1988 (stochastic); Enns
    1984 (weights); Meyer 1990 (coprime factors); Zhou, Doyle, Glover, *Robust and Optimal
    Control* (1996), chapters 7 and 8. Uncertain models: D'Andrea, Khatri 1997.

    Examples
    --------
    >>> G = StateSpaceModel([[-1.0, 0.0], [0.0, -50.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    >>> found = reduce_model(G, tolerance=0.05, method="residualisation")
    >>> found.order, bool(abs(found.model.dc_gain()[0, 0] - G.dc_gain()[0, 0]) < 1e-12)
    (1, True)
    >>> nearest = reduce_model(G, 1, method="hankel")
    >>> bool(abs(nearest.hankel_error / nearest.hankel[1] - 1) < 1e-9)
    True

    A parameter that appears twice, and cancels:

    >>> from robustlab.uncertainty.parametric import parametric
    >>> gain = parametric([], [], [], [["k"]], {"k": (1.0, 0.1)})
    >>> print(reduce_model(gain @ gain.inverse()))
    k 1 -> 0; invariance 0.0e+00, difference 0.0e+00 (converged)
    """
    if isinstance(model, UncertainModel):
        more = {"order": order, "input_weight": input_weight, "output_weight": output_weight}
        more |= {"method": None if method == "truncation" else method, "floor": floor or None}
        if given := next((name for name, value in more.items() if value is not None), None):
            hint = "the nominal model (.nominal) takes it"
            raise InputError(f"reduce_model: {given}", "given with an uncertain model", "tolerance alone", hint)
        return reduction(model, 1e-12 if tolerance is None else tolerance)
    full = as_model(model, "reduce_model")
    weights = _weights(full, input_weight, output_weight)
    _check_request(full, order, tolerance, method, weights != (None, None), floor)
    refuse_extremes(full, "reduce_model")
    candidate, n_least, n_most, limits = (
        _coprime(full) if method == "coprime" else _balanced(full, method, weights, floor)
    )
    if order is not None:
        if order < n_least:
            text = f"{n_least} modes are not stable and are kept apart"
            raise InputError("reduce_model", f"order {order}: {text}", f"at least {n_least}", "method='coprime'")
        return candidate(min(order, n_most))
    assert tolerance is not None
    for n in range(n_least, n_most):
        if limits[n - n_least] > tolerance * (1 + 1e-6):  # no model of this order is as close
            continue
        try:
            found = candidate(n)
        except NoTrustworthyNumber:  # this order is not stable (two weights) or not well posed
            continue
        if found.error.upper <= tolerance and found.status.trustworthy:
            return found
    return candidate(n_most)


def _check_request(
    full: StateSpaceModel, order: int | None, tolerance: float | None, method: str, weighted: bool, floor: float
) -> None:
    if (order is None) == (tolerance is None):
        raise InputError("reduce_model", f"order={order}, tolerance={tolerance}", "one of the two")
    if order is not None and (
        isinstance(order, bool) or not isinstance(order, (int, np.integer)) or not 0 <= order <= full.n_states
    ):
        raise InputError("reduce_model", f"order {order!r}", f"a whole number from 0 to {full.n_states}")
    if tolerance is not None and not 0 < tolerance < np.inf:
        raise InputError("reduce_model", f"tolerance {tolerance}", "a positive number")
    if method not in METHODS:
        raise InputError("reduce_model", f"method {method!r}", f"one of {', '.join(METHODS)}")
    if weighted and method not in ("truncation", "residualisation"):
        raise InputError("reduce_model", f"weights with method {method!r}", "truncation or residualisation")
    number("reduce_model: floor", floor, "a number that is not negative", at_least=0)
    if floor and method != "stochastic":
        raise InputError("reduce_model", f"floor with method {method!r}", "stochastic")


def _weights(full: StateSpaceModel, into: Any, out: Any) -> Weights:
    found: list[StateSpaceModel | None] = []
    for name, weight, fits, size in (
        ("input_weight", into, "n_outputs", full.n_inputs),
        ("output_weight", out, "n_inputs", full.n_outputs),
    ):
        if weight is None:
            found.append(None)
            continue
        w = as_model(weight, f"reduce_model: {name}")
        if (w.n_outputs, w.n_inputs) == (1, 1) and size > 1:  # a scalar weight is meant for every channel
            w = append(*[w.renamed([f"{name} {i}"], [f"{name} {i} out"]) for i in range(size)])
        if getattr(w, fits) != size:
            raise InputError(f"reduce_model: {name}", f"{getattr(w, fits)} {fits[2:]}", f"{size}")
        if w.n_states and not w.is_stable():
            raise InputError(f"reduce_model: {name}", "the weight is not stable", "a stable weight")
        found.append(StateSpaceModel(w.A, w.B, w.C, w.D, w.dt))
    return found[0], found[1]


# Makes the candidate of an order; least and largest order; for each of them what no model of that order is nearer than.
Candidates = tuple[Callable[[int], ReducedModel], int, int, Array]


@dataclass(frozen=True, eq=False)
class _Way:
    """One way to reduce the stable part of a model: Hankel values, the largest order, and the part of an order.

    ``measured`` is the certified size of a difference and ``bound`` what is promised for it; ``per_gain`` bounds how
    much the former is for a gain of 1.
    """

    values: Array
    most: int
    reduced: Callable[[int], StateSpaceModel]
    measured: Callable[[StateSpaceModel, float], HinfNorm] = hinf_norm
    bound: Callable[[int], float] = lambda _: np.nan
    per_gain: Callable[[], float] = lambda: 1.0


def _balanced(full: StateSpaceModel, method: str, weights: Weights, floor: float) -> Candidates:
    split = split_stable(full)
    stable, apart, relative = split.stable, split.apart.n_states, method == "stochastic"
    lost = SplitError(split.rounding(), split.apart.poles(), stable.poles(), stable.dt)
    name = method if weights == (None, None) else f"weighted {method}"
    way = _way(stable, method, weights, floor)
    removed = () if split.least is None else tuple(mode.meaning for mode in split.least.hidden)

    def candidate(order: int) -> ReducedModel:
        small = way.reduced(order - apart)
        if not small.is_stable():
            hint = "another order" if weights == (None, None) else "another order, or one weight instead of two"
            raise NoTrustworthyNumber(
                "reduce_model", f"the model of order {small.n_states + apart} is not stable", hint=hint
            )
        difference, promised = parallel(stable, small, -1), way.bound(small.n_states)
        error = _measured(way, difference, promised)
        whole = hinf_norm(difference) if relative else None
        left_out: tuple[tuple[float, float], ...] = ()
        if not lost.nothing:
            per_gain, size = way.per_gain(), 1.0 if relative else float(way.values.max(initial=0.0))
            wanted = SPLIT_SHARE * max(error.upper, OVERLOOKED * size) / max(per_gain, TINY)
            axis = lost.bound(wanted)
            error = widened(error, per_gain * axis.upper if axis.upper else 0.0, axis.reason)
            whole = None if whole is None else widened(whole, axis.upper, axis.reason)
            left_out = axis.left_out
        found = _result(full, split.joined(small), name, way, error, promised, apart)
        found = replace(found, difference=whole, left_out=left_out, weights=weights, removed=removed)
        return _with_hankel_norm(found, hankel_norm(difference)) if method == "hankel" else found

    limits = np.zeros(way.most + 1) if np.isnan(way.bound(0)) else np.append(way.values, 0.0)
    return candidate, apart, apart + way.most, limits


def _way(stable: StateSpaceModel, method: str, weights: Weights, floor: float) -> _Way:
    dt = stable.dt
    if method == "stochastic":
        spectrum = Spectrum.of(_in_continuous_time(stable), floor)
        balancing = spectrum.balancing

        def measured(difference: StateSpaceModel, rtol: float) -> HinfNorm:
            found = spectrum.relative(_in_continuous_time(difference), rtol)
            return replace(found, frequency=2 / dt * float(np.arctan(found.frequency * dt / 2))) if dt else found

        return _Way(
            balancing.values, len(balancing.left),
            lambda order: _back(balancing.reduced(spectrum.model, order, "truncation"), dt), measured,
            lambda order: relative_bound(balancing.values, order), spectrum.per_gain,
        )  # fmt: skip
    if method == "hankel":
        continuous = _in_continuous_time(stable)
        balancing = Balancing.of(*gramian_factors(continuous))
        return _Way(
            balancing.values, len(balancing.left),
            lambda order: _back(nearest_in_hankel_norm(continuous, balancing, order), dt),
            bound=lambda order: hankel_bound(balancing.values, order),
        )  # fmt: skip
    projection: Projection = "residualisation" if method == "residualisation" else "truncation"
    balancing = Balancing.of(*weighted_factors(stable, *weights))
    way = _Way(balancing.values, len(balancing.left), lambda order: balancing.reduced(stable, order, projection))
    if weights == (None, None):
        return replace(way, bound=lambda order: error_bound(balancing.values, order))
    return replace(
        way,
        measured=lambda difference, rtol: hinf_norm(_weighted(difference, *weights), rtol),
        per_gain=lambda: float(np.prod([hinf_norm(w, 1e-2).upper for w in weights if w is not None])),
    )


def _measured(way: _Way, difference: StateSpaceModel, promised: float) -> HinfNorm:
    """The size of a difference; more closely where what is promised may be attained, so that it need not be raised."""
    found = way.measured(difference, RTOL)
    if not promised < found.upper <= promised * (1 + 2 * RTOL):  # wider where rounding leaves no more digits
        return found
    closer = way.measured(difference, CLOSE_RTOL)
    return closer if closer.status.trustworthy and closer.upper < found.upper else found


def _result(
    full: StateSpaceModel, small: StateSpaceModel, name: str, way: _Way, error: HinfNorm, bound: float, apart: int
) -> ReducedModel:
    named = StateSpaceModel(
        small.A, small.B, small.C, small.D, full.dt, full.inputs, full.outputs, where="reduced model"
    )
    largest, reason = float(way.values.max(initial=0.0)), error.reason
    if not reason and not np.isnan(bound) and error.lower > bound + BOUND_ROUNDING * largest + 1e-12 * error.lower:
        reason = f"the error {error.lower:.6g} exceeds what theory promises, {bound:.6g}: digits were lost"
    # Theory knows no rounding. That of the reduced model is a share of the whole gain, which may be more than what is
    # left out.
    bound = bound if np.isnan(bound) else max(bound, error.upper)
    status = Status.CERTIFIED if not reason and error.status is Status.CERTIFIED else Status.INACCURATE
    values = np.array(way.values)
    values.setflags(write=False)
    return ReducedModel(named, name, error, bound, values, apart, full, status, reason)


def _in_continuous_time(model: StateSpaceModel) -> StateSpaceModel:
    return bilinear_to_continuous(model) if model.is_discrete else model


def _back(model: StateSpaceModel, dt: float) -> StateSpaceModel:
    return bilinear_to_discrete(model, dt) if dt else model


def _with_hankel_norm(found: ReducedModel, size: float) -> ReducedModel:
    """With the Hankel norm of the difference, which theory says is the first value left out."""
    left = found.hankel[found.order - found.n_apart :]
    wanted, largest = float(left.max(initial=0.0)), float(found.hankel.max(initial=0.0))
    status, reason = found.status, found.reason
    if status is Status.CERTIFIED and abs(size - wanted) > 1e-6 * wanted + BOUND_ROUNDING * largest:
        reason = f"the Hankel norm of the error is {size:.6g}, not {wanted:.6g}: digits were lost"
        status = Status.INACCURATE
    return replace(found, hankel_error=size, status=status, reason=reason)


def weighted_factors(
    model: StateSpaceModel, into: StateSpaceModel | None, out: StateSpaceModel | None
) -> tuple[Array, Array]:
    r"""Factors of the blocks that belong to the model in the Gramians of ``G W_i`` and ``W_o G`` (Enns)."""
    n = model.n_states
    reach, see = gramian_factors(model)
    if into is not None:  # states of the series connection: weight first, then model
        reach = block_factor(gramian_factors(series(into, model))[0][into.n_states :])
    if out is not None:
        see = block_factor(gramian_factors(series(model, out))[1][:n])
    return reach, see


def _weighted(model: StateSpaceModel, into: StateSpaceModel | None, out: StateSpaceModel | None) -> StateSpaceModel:
    if into is not None:
        model = series(into, model)
    return model if out is None else series(model, out)


def _coprime(full: StateSpaceModel) -> Candidates:
    reduction = CoprimeReduction(full)
    values = reduction.balancing.values
    way = _Way(values, len(reduction.balancing.left), reduction.reduced)

    def candidate(order: int) -> ReducedModel:
        promised = error_bound(values, order)
        error = _measured(way, parallel(reduction.factors, reduction.reduced_factors(order), -1), promised)
        found = replace(
            _result(full, way.reduced(order), "coprime", way, error, promised, 0), removed=reduction.removed
        )
        if reduction.lost is None:
            return found
        reason = f"what was removed before is not exactly hidden: {', '.join(reduction.removed)}"
        return replace(found, status=Status.INACCURATE, reason=found.reason or reason)

    return candidate, 0, way.most, np.append(values, 0.0)
