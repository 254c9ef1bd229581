"""Reduction of models with certified errors: by five methods, or to the least order with the same gain."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, get_args, overload

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.checks import choice, number, whole
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.matrices import refuse_extremes
from robustlab.linear_analysis.structural import least_order
from robustlab.norms import HinfNorm, hinf_norm, linf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, append, as_model, parallel
from robustlab.synthesis.reduction.balancing import lost_at_least_order
from robustlab.synthesis.reduction.reduced_model import Evidence, ReducedModel
from robustlab.synthesis.reduction.ways import Way, Weights, way_of
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.reduction import Reduction, reduction

Method = Literal["truncation", "residualisation", "hankel", "stochastic", "coprime"]
Band = tuple[float, float]

METHODS = get_args(Method)
# A certified error may exceed the a-priori bound by this share of the largest Hankel value: rounding of the model.
BOUND_ROUNDING = 1e-10
# Share of the error that splitting off modes may add, before frequencies next to a mode on the boundary are left out;
# for this the error counts as at least the second share of the largest Hankel value.
SPLIT_SHARE, OVERLOOKED = 1e-3, 1e-9
# A pole counts as one on the boundary up to this share of its frequency (one at zero: of the slowest stable one).
NEAR = 1e-6
# Half widths of the bands left out, as shares of the same, the widest first.
WIDTHS = np.logspace(-2, -13, 23)
TINY = float(np.finfo(float).tiny)


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
@error_context("reduce_model")
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
    r"""Reduce a model; its error is certified, with the a-priori bound where there is one.

    .. math:: \|G - G_r\|_\infty \le 2 \sum_{i > r} \sigma_i \quad \text{(truncation, residualisation)}, \qquad
       \|G - G_r\|_H = \sigma_{r+1}, \; \|G - G_r\|_\infty \le \sum_{i > r} \sigma_i \quad \text{(hankel)}

    .. math:: \sup_\omega \sigma_{max}( (G G^* + \beta^2 I)^{-1/2} (G - G_r) ) \le
       \prod_{i > r} \frac{1 + \mu_i}{1 - \mu_i} - 1 \quad \text{(stochastic)}

    No model of order r is nearer than :math:`\sigma_{r+1}`. Modes that are not stable are split off and kept, and the
    rounding of this is part of the error; uncontrollable or unobservable ones of them are removed (`minimal`). The
    error is computed when it is first read.
    ``method="coprime"`` reduces them too, through the normalised right coprime factors ``G = N M^{-1}``, whose error is
    then the H-infinity norm of ``[N - N_r; M - M_r]`` (a bound of the gap between the two models).

    Of an uncertain model the repetitions of its blocks are reduced, exactly: uncontrollable and unobservable ones are
    removed, of all blocks jointly, until none is left (`UncertainModel.reduce` returns the set alone).

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object with n states; continuous or discrete, stable or not. Or an
        UncertainModel, with ``tolerance`` alone.
    order
        Number of states of the result, those kept apart included; fewer where the rest is not minimal.
    tolerance
        In place of ``order``: the lowest order whose certified error is at most this; in output units per
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
        beta of ``"stochastic"``, in output units per input unit: below this gain errors count absolutely. Required
        where the gain vanishes: without full row rank of D, with more outputs than inputs, with zeros on the axis.

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
    Where no lower order keeps ``tolerance``, the model is returned with all its (minimal) states.

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
    >>> bool(abs(nearest.error.upper / nearest.hankel[1] - 1) < 1e-5)
    True

    A parameter that appears twice, and cancels:

    >>> from robustlab.uncertainty.parametric import parametric
    >>> gain = parametric([], [], [], [["k"]], {"k": (1.0, 0.1)})
    >>> reduce_model(gain @ gain.inverse()).before, reduce_model(gain @ gain.inverse()).after
    ({'k': 1}, {})
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
    way = way_of(full, method, weights, floor)
    apart, values, most = way.split.apart.n_states, way.balancing.values, len(way.balancing.left)
    if order is not None:
        if order < apart:
            text = f"{apart} modes are not stable and are kept apart"
            raise InputError("reduce_model", f"order {order}: {text}", f"at least {apart}", "method='coprime'")
        return _reduced(full, way, min(order - apart, most))
    assert tolerance is not None
    for n in range(most):
        # With an a-priori bound, no model of this order is nearer than its first value left out.
        if not np.isnan(way.bound(0)) and values[n] > tolerance * (1 + 1e-6):
            continue
        try:
            found = _reduced(full, way, n)
        except NoTrustworthyNumber:  # this order is not stable (two weights) or not well posed
            continue
        if found.error.upper <= tolerance and found.status.trustworthy:
            return found
    return _reduced(full, way, most)


def _check_request(
    full: StateSpaceModel, order: int | None, tolerance: float | None, method: str, weighted: bool, floor: float
) -> None:
    if (order is None) == (tolerance is None):
        raise InputError("reduce_model", f"order={order}, tolerance={tolerance}", "one of the two")
    if order is not None:
        whole("reduce_model: order", order, 0, full.n_states)
    if tolerance is not None:
        number("reduce_model: tolerance", tolerance, above=0)
    choice("reduce_model: method", method, METHODS)
    if weighted and method not in ("truncation", "residualisation"):
        raise InputError("reduce_model", f"weights with method {method!r}", "truncation or residualisation")
    number("reduce_model: floor", floor, "a number that is not negative", at_least=0)
    if floor and method != "stochastic":
        raise InputError("reduce_model", f"floor with method {method!r}", "stochastic")


def _weights(full: StateSpaceModel, into: Any, out: Any) -> Weights:
    found: list[StateSpaceModel | None] = []
    for name, given, size in (("input_weight", into, full.n_inputs), ("output_weight", out, full.n_outputs)):
        if given is None:
            found.append(None)
            continue
        where, side = f"reduce_model: {name}", "outputs" if name == "input_weight" else "inputs"
        w = as_model(given, where)
        if (w.n_outputs, w.n_inputs) == (1, 1) and size > 1:  # a scalar weight is meant for every channel
            w = append(*[w.renamed([f"{name} {i}"], [f"{name} {i} out"]) for i in range(size)])
        if (has := len(getattr(w, side))) != size:
            raise InputError(where, f"{has} {side}", f"{size}")
        if w.n_states and not w.is_stable():
            raise InputError(where, "the weight is not stable", "a stable weight")
        found.append(StateSpaceModel(w.A, w.B, w.C, w.D, w.dt))
    return found[0], found[1]


def _reduced(full: StateSpaceModel, way: Way, order: int) -> ReducedModel:
    """Return the model whose reduced part has this order."""
    split, small, weighted = way.split, way.reduced(order), way.weights != (None, None)
    if not small.is_stable():
        hint = "another order, or one weight instead of two" if weighted else "another order"
        n = small.n_states + split.apart.n_states
        raise NoTrustworthyNumber("reduce_model", f"the model of order {n} is not stable", hint=hint)
    model = way.whole(small)
    model = StateSpaceModel(
        model.A, model.B, model.C, model.D, full.dt, full.inputs, full.outputs, where="reduced model"
    )
    return ReducedModel(
        model, f"weighted {way.method}" if weighted else way.method, way.balancing.values, split.apart.n_states, full,
        way.bound(small.n_states), partial(_judged, way, small), way.weights,
        tuple(mode.meaning for mode in split.hidden),
    )  # fmt: skip


def _judged(way: Way, small: StateSpaceModel) -> Evidence:
    """Return the error of a reduced part, that of splitting off the other modes included."""
    split, relative, promised = way.split, way.spectrum is not None, way.bound(small.n_states)
    largest = float(way.balancing.values.max(initial=0.0))
    difference = parallel(way.part, small, -1)
    error, left_out, reason = way.measured(difference), (), ""
    whole = hinf_norm(difference) if relative else None
    if way.method == "coprime" and split.lost is not None:
        reason = "the modes that were removed before are not exactly hidden"
    elif split.lost is not None:
        per_gain = way.per_gain()
        wanted = SPLIT_SHARE * max(error.upper, OVERLOOKED * (1.0 if relative else largest)) / max(per_gain, TINY)
        upper, left_out, doubt = _lost_gain(split.lost, split.apart.poles(), split.stable.poles(), wanted)
        error = _widened(error, per_gain * upper if upper else 0.0, doubt)
        whole = None if whole is None else _widened(whole, upper, doubt)
    if error.lower > promised + BOUND_ROUNDING * largest + 1e-12 * error.lower:
        reason = f"the error {error.lower:.6g} exceeds what theory promises, {promised:.6g}: digits were lost"
    return Evidence(error, left_out, error.reason or reason, whole)


def _widened(norm: HinfNorm, by: float, reason: str) -> HinfNorm:
    """Widen the bracket of a norm; not certified if there is a reason against it."""
    status = Status.INACCURATE if reason else norm.status
    return HinfNorm(max(norm.lower - by, 0.0), norm.upper + by, norm.frequency, status, norm.reason or reason)


@error_context("minimal")
def minimal(model: Any, *, tolerance: float | None = None) -> ReducedModel:
    r"""Remove the modes that no input moves or no output shows, unstable and integrating ones too.

    The controllable subspace is built by orthogonal steps, ``range(B), A range(B), ...``, in states and signals scaled
    independently of units, then the observable one of the result. The states kept are a subset of those given, or
    sums of them with short factors where these are exact, so that integer data are reduced without rounding.

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object; continuous or discrete, stable or not.
    tolerance
        Singular values of the scaled steps up to this count as zero. Where left out, those below 1e-14 do, and those
        below 1e-10 where the eigenvalues confirm it.

    Returns
    -------
    ReducedModel
        Of method ``"minimal"``, with the certified largest gain of the difference of both models (zero where
        everything cancels exactly), and the modes that were removed. INACCURATE where the order depends on rounding.

    Raises
    ------
    InputError
        No linear model, a tolerance that is not between 0 and 1.

    References
    ----------
    Van Dooren, "The generalized eigenstructure problem in linear system theory", IEEE TAC 26 (1981).

    Examples
    --------
    Two copies of an integrator, one behind a lag; the input moves their difference by the lag alone:

    >>> from robustlab.realisations import ss
    >>> G = ss([[0, 0, 0], [0, -1, 0], [0, 1, 0]], [[1], [1], [0]], [[1, 0, 0], [0, 0, 1]], [[0], [0]])
    >>> found = minimal(G)
    >>> found.order, found.error.upper, found.removed
    (2, 0.0, ('unstable mode 0 rad/s in x1, x2, x3: no input moves it',))
    """
    full = as_model(model, "minimal")
    if tolerance is not None:
        number("minimal: tolerance", tolerance, "a number between 0 and 1", above=0, below=1)
    found = least_order(full, tolerance)
    poles, lost = full.poles(), lost_at_least_order(found)
    stable = (1 - np.abs(poles) if full.is_discrete else -poles.real) > NEAR * np.abs(poles).max(initial=0.0)
    upper, left_out, doubt = (0.0, (), "") if lost is None else _lost_gain(lost, poles[~stable], poles[stable])
    unclear = f"the order depends on rounding: a singular value of {found.dropped:.1e} counted as zero; tolerance="
    error = HinfNorm(0.0, upper, np.nan, Status.INACCURATE if doubt else Status.CERTIFIED, doubt)
    evidence = Evidence(error, left_out, doubt or ("" if found.clear else unclear))
    removed = tuple(mode.meaning for mode in found.hidden)
    return ReducedModel(
        found.model, "minimal", np.zeros(0), 0, full, np.nan, partial(Evidence, *evidence), removed=removed
    )


# --- error of splitting or removing modes -----------------------------------------------------------------------------


def _lost_gain(
    lost: StateSpaceModel, apart: AnyArray, stable: AnyArray, wanted: float = 0.0
) -> tuple[float, tuple[Band, ...], str]:
    """Return a bound of the gain of ``lost``, the bands in rad/s that are left out, and why it is not proved.

    At a mode on the stability boundary that gain is infinite: an interval around it is left out, as narrow as the bound
    ``wanted`` allows. ``apart``, ``stable``: the poles of the model that are not stable, and the others.
    """
    if not lost.D.size:
        return 0.0, (), ""
    dt, low, high = lost.dt, 0.0, np.pi / lost.dt if lost.dt else np.inf
    if dt:  # in rad/s
        apart, stable = (np.log(poles[np.abs(poles) > 1e-12].astype(complex)) / dt for poles in (apart, stable))
    slow = np.abs(stable).min() if len(stable) else 1 / dt if dt else np.abs(apart).max(initial=0.0) or 1.0
    at = np.abs(np.imag(apart))
    centre = np.where(at > 1e-3 * slow, at, 0.0)
    scale = np.where(centre > 0, centre, slow)
    near = np.abs(np.real(apart)) <= NEAR * scale
    centre, scale = centre[near], scale[near]
    offset = scale[:, None] * WIDTHS
    sizes = _gains(lost, np.abs(np.stack([centre[:, None] - offset, centre[:, None] + offset]))).max(axis=0)
    elsewhere = max(_gains(lost, np.abs(apart[~near])).max(initial=0.0), sizes[:, :1].max(initial=0.0))
    small = np.logical_and.accumulate(sizes <= max(wanted, 2 * elsewhere), axis=1).sum(axis=1) - 1
    while True:
        half = scale * WIDTHS[np.maximum(small, 0)]
        left_out = _merged(np.clip([centre - half, centre + half], low, high).T.tolist())
        ends = [low, *(end for interval in left_out for end in interval), high]
        found = [linf_norm(lost, 0.01, band=(a, b)) for a, b in zip(ends[::2], ends[1::2], strict=True) if a < b]
        doubt = next((norm.reason or "not proved" for norm in found if norm.status is not Status.CERTIFIED), "")
        small = small - 2  # ten times as wide, as rounding decides so near to a pole
        if not doubt or not (small >= 0).any():
            return max((norm.upper for norm in found), default=0.0), left_out, doubt


def _gains(model: StateSpaceModel, omega: AnyArray) -> AnyArray:
    """Return ``sigma_max`` in the shape of omega; infinite where a frequency is indistinguishable from a pole."""
    try:
        response = frequency_response(model, omega.ravel())
    except NoTrustworthyNumber:
        return np.full(omega.shape, np.inf)
    return np.linalg.norm(response, 2, axis=(1, 2)).reshape(omega.shape)


def _merged(intervals: list[list[float]]) -> tuple[Band, ...]:
    """Return the intervals in order, with overlapping ones merged and empty ones left out."""
    found: list[Band] = []
    for low, high in sorted(intervals):
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], high)
        elif low < high:
            found.append((low, high))
    return tuple(found)
