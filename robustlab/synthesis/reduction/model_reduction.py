"""Reduction of models: balanced truncation, residualisation, coprime factors, frequency weights; errors certified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, overload

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.checks import number
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import default_grid, frequency_response, response_within
from robustlab.linear_analysis.magnitude import Moderated, moderated, scaled_down
from robustlab.linear_analysis.modal_response import ModalResponse, largest_gain
from robustlab.norms import (
    HinfNorm,
    bilinear_to_continuous,
    bilinear_to_discrete,
    checked_band,
    hinf_norm,
    linf_norm,
    norm_as_given,
)
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, append, as_model, parallel, series
from robustlab.synthesis.reduction.balancing import Balancing, Projection, block_factor, gramian_factors, split_stable
from robustlab.synthesis.reduction.band_gramians import band_gramian_factors
from robustlab.synthesis.reduction.coprime_reduction import CoprimeReduction
from robustlab.synthesis.reduction.hankel_norm import error_bound, hankel_bound, hankel_norm, nearest_in_hankel_norm
from robustlab.synthesis.reduction.reduced_model import ReducedModel
from robustlab.synthesis.reduction.relative_error import Spectrum, relative_bound, relative_gap
from robustlab.synthesis.reduction.split_error import SplitError, merged, widened
from robustlab.uncertainty.algebra import Reduction, reduction
from robustlab.uncertainty.lft import UncertainModel

Weights = tuple[StateSpaceModel | None, StateSpaceModel | None]  # W_i and W_o
Band = tuple[float, float]
Method = Literal["truncation", "residualisation", "hankel", "stochastic", "coprime"]
METHODS = get_args(Method)

# A certified error may exceed what theory promises by this share of the largest Hankel value: rounding of the model.
BOUND_ROUNDING = 1e-10
# Share of the responses by which the two models may seem to differ.
OVERLOOKED = 1e-9
TINY = float(np.finfo(float).tiny)
# Relative widths of the bracket of an error, and of one that may be what is promised.
RTOL, CLOSE_RTOL = 1e-6, 1e-9
# Share of the error that splitting parts off may add to it, before frequencies next to a mode on the boundary are left
# out.
SPLIT_SHARE = 1e-3


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
    ordinary = moderated(as_model(model, where), where)
    split = split_stable(ordinary.model)
    values = Balancing.of(*gramian_factors(split.stable, split.form)).values
    return np.array([ordinary.value(value, where) for value in values])


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
    band: tuple[float, float] | None = None,
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
    band: tuple[float, float] | None = None,
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
    band
        ``(low, high)`` in rad/s: Gramians over this band alone (Gawronski, Juang), and the error is the peak inside it,
        proved for all its frequencies. For truncation and residualisation, without weights.
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
        Neither or both of order and tolerance, an order that does not exist, weights or a band that do not fit, a gain
        that vanishes at infinite frequency for ``"stochastic"`` without a floor.
    NoTrustworthyNumber
        Gramians lost their digits; the reduced model is not stable (two weights or a band give no guarantee), or not
        well posed; the gain vanishes at some frequency.

    Notes
    -----
    Where no lower order keeps ``tolerance``, the model comes back with all its (minimal) states.

    References
    ----------
    Moore 1981; Glover 1984 (bound, Hankel norm); Liu, Anderson 1989 (residualisation); Green 1988 (stochastic); Enns
    1984 (weights); Gawronski, Juang 1990 (band); Meyer 1990 (coprime factors); Zhou, Doyle, Glover, *Robust and Optimal
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
        more = {"order": order, "input_weight": input_weight, "output_weight": output_weight, "band": band}
        more |= {"method": None if method == "truncation" else method, "floor": floor or None}
        if given := next((name for name, value in more.items() if value is not None), None):
            hint = "the nominal model (.nominal) takes it"
            raise InputError(f"reduce_model: {given}", "given with an uncertain model", "tolerance alone", hint)
        return reduction(model, 1e-12 if tolerance is None else tolerance)
    full = as_model(model, "reduce_model")
    weights = _weights(full, input_weight, output_weight)
    part = None if band is None else checked_band(band, full.dt, "reduce_model")
    _check_request(full, order, tolerance, method)
    _check_extras(method, weights != (None, None), part, floor)
    if method == "coprime":
        candidate, n_least, n_most, limits = _coprime_reduction(full)
    else:
        candidate, n_least, n_most, limits = _balanced_reduction(full, method, weights, part, floor)
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
        except NoTrustworthyNumber:  # this order is not stable (two weights, a band) or not well posed
            continue
        if found.error.upper <= tolerance and found.status.trustworthy:
            return found
    return candidate(n_most)


def _check_request(full: StateSpaceModel, order: int | None, tolerance: float | None, method: str) -> None:
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


def _check_extras(method: str, weighted: bool, band: Band | None, floor: float) -> None:
    balanced = "truncation or residualisation"
    for name, given in (("weights", weighted), ("a band", band is not None)):
        if given and method not in ("truncation", "residualisation"):
            raise InputError("reduce_model", f"{name} with method {method!r}", balanced)
    if weighted and band is not None:
        raise InputError("reduce_model", "weights and a band", "one of them")
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
    """One way to reduce the stable part of a model, continuous or discrete.

    ``values`` are its Hankel values in the units of the model as given, ``most`` the largest order. ``reduced`` gives
    the part of an order, ``measured`` the certified size of a difference, ``bound`` what is promised for it, and
    ``seen`` turns differences of responses at frequencies, as given, into what ``measured`` is the largest norm of,
    where that is not the difference; ``looked_at`` are frequencies to look at besides those of the model. ``per_gain``
    bounds how much ``measured`` is for a largest gain of 1 over the ``band``; the model of ordinary entries has both.
    """

    values: Array
    most: int
    reduced: Callable[[int], StateSpaceModel]
    measured: Callable[[StateSpaceModel, float], HinfNorm]
    bound: Callable[[int], float] = lambda _: np.nan
    seen: Callable[[Array, ComplexArray], ComplexArray] | None = None
    looked_at: tuple[float, ...] = ()
    per_gain: Callable[[], float] = lambda: 1.0
    band: Band | None = None
    relative: bool = False


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Proved sizes of a difference, `ReducedModel.error` and `.difference`, and the frequencies they do not hold at.

    ``parts`` may know the eigenvectors of a model that is looked at; errors are bounded from that model itself.
    """

    error: HinfNorm
    difference: HinfNorm | None = None
    left_out: tuple[Band, ...] = ()
    parts: tuple[StateSpaceModel, ...] = ()


def _balanced_reduction(
    full: StateSpaceModel, method: str, weights: Weights, band: Band | None, floor: float
) -> Candidates:
    weighted = weights != (None, None)  # a weight has the units of the model
    unchanged = Moderated(full, 0, 0, np.zeros(full.n_states, dtype=int))
    ordinary = unchanged if weighted else moderated(full, "reduce_model")
    split = split_stable(ordinary.model)
    stable, name = split.stable, method
    lost = SplitError(split.rounding(), split.apart.poles(), stable.poles(), stable.dt)
    if method == "stochastic":
        way = _stochastic_way(stable, ordinary, floor)
    elif method == "hankel":
        way = _hankel_way(stable, ordinary)
    else:
        projection: Projection = "residualisation" if method == "residualisation" else "truncation"
        if band is not None:
            name, way = f"band {method}", _band_way(stable, ordinary, band, projection)
        elif weighted:
            name, way = f"weighted {method}", _weighted_way(stable, weights, projection)
        else:
            way = _plain_way(stable, Balancing.of(*gramian_factors(stable, split.form)), ordinary, projection)
    apart = split.apart.n_states
    hidden = () if split.least is None else split.least.hidden
    removed = tuple(mode.meaning for mode in hidden)

    def candidate(order: int) -> ReducedModel:
        small = way.reduced(order - apart)
        if small.n_states and not small._with_modes().is_stable():
            raise NoTrustworthyNumber(
                "reduce_model",
                f"the model of order {small.n_states + apart} is not stable",
                hint="another order, or one weight instead of two" if name.startswith("weighted") else "another order",
            )
        difference = _difference(stable, small)
        promised = way.bound(small.n_states)
        evidence = replace(_evidence(way, ordinary, lost, difference, promised), parts=(stable, small))
        model = ordinary.as_given(split.joined(small), "reduce_model")
        found = replace(
            _checked(full, model, name, way, evidence, promised, apart), band=band, weights=weights, removed=removed
        )
        if method == "hankel":
            return _with_hankel_norm(found, ordinary.value(hankel_norm(difference), "reduce_model"))
        return found

    limits = np.zeros(way.most + 1) if np.isnan(way.bound(0)) else np.append(way.values, 0.0)
    return candidate, apart, apart + way.most, limits


def _difference(stable: StateSpaceModel, small: StateSpaceModel) -> StateSpaceModel:
    """The first less the second, with the poles and modes of both."""
    both, n = parallel(stable, small, -1), stable.n_states
    if not (n and small.n_states):
        return both
    parts = [vars(m._with_modes())["_eigen"] for m in (stable, small)]
    modes = np.zeros(both.A.shape, np.result_type(*(vectors for _, vectors in parts)))
    modes[:n, :n], modes[n:, n:] = (vectors for _, vectors in parts)
    return both._with_matrices(both.A, both.B, both.C, both.D, np.concatenate([poles for poles, _ in parts]), modes)


def _measured(way: _Way, difference: StateSpaceModel, promised: float) -> HinfNorm:
    """The size of a difference; more closely where what is promised may be attained, so that it need not be raised."""
    found = way.measured(difference, RTOL)
    if not promised < found.upper <= promised * (1 + 2 * RTOL):  # wider where rounding leaves no more digits
        return found
    closer = way.measured(difference, CLOSE_RTOL)
    return closer if closer.status.trustworthy and closer.upper < found.upper else found


def _evidence(
    way: _Way, ordinary: Moderated, lost: SplitError, difference: StateSpaceModel, promised: float
) -> _Evidence:
    """The sizes of a difference of stable parts, and what splitting these off may add to them."""
    error = _measured(way, difference, promised)
    whole = None if way.band is None and not way.relative else norm_as_given(hinf_norm(difference), ordinary)
    if lost.nothing:
        return _Evidence(error, whole)
    per_gain, size = (way.per_gain(), 1.0) if way.relative else (way.per_gain(), float(way.values.max(initial=0.0)))
    wanted = SPLIT_SHARE * max(error.upper, OVERLOOKED * size)
    wanted = wanted / max(per_gain, TINY) if np.isfinite(wanted) else np.inf  # nothing is large beside no bound
    wanted = wanted if way.relative else float(np.ldexp(wanted, ordinary.gain))
    axis = lost.bound(wanted)
    part = axis if way.band is None else lost.bound(wanted, way.band)
    added = per_gain * part.upper if part.upper else 0.0
    left_out = merged(axis.left_out + part.left_out)
    return _Evidence(
        widened(error, added if way.relative else ordinary.value(added, "reduce_model"), part.reason),
        None if whole is None else widened(whole, ordinary.value(axis.upper, "reduce_model"), axis.reason),
        tuple((ordinary.frequency(low), ordinary.frequency(high)) for low, high in left_out),
    )


def _plain_way(stable: StateSpaceModel, balancing: Balancing, ordinary: Moderated, projection: Projection) -> _Way:
    values = _values_as_given(balancing, ordinary)
    return _Way(
        values,
        len(balancing.left),
        lambda order: balancing.reduced(stable, order, projection),
        lambda difference, rtol: norm_as_given(hinf_norm(difference, rtol), ordinary),
        lambda order: error_bound(values, order),
    )


def _weighted_way(stable: StateSpaceModel, weights: Weights, projection: Projection) -> _Way:
    balancing = Balancing.of(*weighted_factors(stable, *weights))
    into, out = weights

    def seen(omega: Array, gap: ComplexArray) -> ComplexArray:
        gap = gap if into is None else gap @ frequency_response(into, omega)
        return gap if out is None else frequency_response(out, omega) @ gap

    return _Way(
        balancing.values,
        len(balancing.left),
        lambda order: balancing.reduced(stable, order, projection),
        lambda difference, rtol: hinf_norm(_weighted(difference, *weights), rtol),
        seen=seen,
        per_gain=lambda: float(np.prod([hinf_norm(w, 1e-2).upper for w in weights if w is not None])),
    )


def _band_way(stable: StateSpaceModel, ordinary: Moderated, band: Band, projection: Projection) -> _Way:
    low, high = (float(np.ldexp(omega, -ordinary.rate)) for omega in band)
    balancing = Balancing.of(*band_gramian_factors(stable, low, high))
    return _Way(
        _values_as_given(balancing, ordinary),
        len(balancing.left),
        lambda order: balancing.reduced(stable, order, projection),
        lambda difference, rtol: norm_as_given(linf_norm(difference, rtol=rtol, band=(low, high)), ordinary),
        seen=lambda omega, gap: gap[(omega >= band[0]) & (omega <= band[1])],
        looked_at=tuple(np.linspace(*band, 22)[1:-1]) if np.isfinite(band[1]) else (),
        band=(low, high),
    )


def _hankel_way(stable: StateSpaceModel, ordinary: Moderated) -> _Way:
    continuous = _in_continuous_time(stable)
    balancing = Balancing.of(*gramian_factors(continuous))
    values = _values_as_given(balancing, ordinary)
    return _Way(
        values,
        len(balancing.left),
        lambda order: _back(nearest_in_hankel_norm(continuous, balancing, order), stable.dt),
        lambda difference, rtol: norm_as_given(hinf_norm(difference, rtol), ordinary),
        lambda order: hankel_bound(values, order),
    )


def _stochastic_way(stable: StateSpaceModel, ordinary: Moderated, floor: float) -> _Way:
    spectrum = Spectrum.of(_in_continuous_time(stable), scaled_down(floor, -ordinary.gain, "reduce_model"))
    balancing, dt, given = spectrum.balancing, stable.dt, ordinary.as_given(stable, "reduce_model")

    def measured(difference: StateSpaceModel, rtol: float) -> HinfNorm:
        found = spectrum.relative(_in_continuous_time(difference), rtol)
        at = 2 / dt * float(np.arctan(found.frequency * dt / 2)) if dt else found.frequency
        return replace(found, frequency=ordinary.frequency(at))

    return _Way(
        balancing.values,
        len(balancing.left),
        lambda order: _back(balancing.reduced(spectrum.model, order, "truncation"), dt),
        measured,
        lambda order: relative_bound(balancing.values, order),
        lambda omega, gap: relative_gap(frequency_response(given, omega), gap, floor),
        per_gain=spectrum.per_gain,
        relative=True,
    )


def _values_as_given(balancing: Balancing, ordinary: Moderated) -> Array:
    return np.array([ordinary.value(value, "reduce_model") for value in balancing.values])


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


def _checked(
    full: StateSpaceModel, model: StateSpaceModel, method: str, way: _Way, evidence: _Evidence, bound: float, apart: int
) -> ReducedModel:
    """The result; the models as given and as returned are compared at frequencies of the full one."""
    named = StateSpaceModel(
        model.A, model.B, model.C, model.D, full.dt, full.inputs, full.outputs, where="reduced model"
    )
    values = np.array(way.values)
    values.setflags(write=False)
    largest, error = float(values.max(initial=0.0)), evidence.error
    reason, proved = error.reason, error.upper
    if not reason and not np.isnan(bound) and error.lower > bound + BOUND_ROUNDING * largest + 1e-12 * error.lower:
        reason = f"the error {error.lower:.6g} exceeds what theory promises, {bound:.6g}: digits were lost"
    if not reason and method != "coprime":
        seen, size = _seen_difference(full, named, way, evidence)
        size = 1.0 if method == "stochastic" else size
        if seen > error.upper * (1 + 1e-6) + OVERLOOKED * size:
            reason = f"the models differ by {seen:.6g} somewhere, more than the certified {error.upper:.6g}"
            proved = max(proved, seen)
    # Theory knows no rounding. That of the reduced model is a share of the whole gain, which may be more than what is
    # left out.
    bound = bound if np.isnan(bound) else max(bound, proved)
    status = Status.CERTIFIED if not reason and error.status is Status.CERTIFIED else Status.INACCURATE
    return ReducedModel(
        named, method, error, bound, values, apart, full, status, reason, evidence.difference, evidence.left_out
    )


def _seen_difference(
    full: StateSpaceModel, model: StateSpaceModel, way: _Way, evidence: _Evidence
) -> tuple[float, float]:
    """Largest difference of the two responses, as it is measured, on a grid away from poles, less the bounds of their
    errors where they come from the modes; and the size of the responses.
    """
    if not full.n_inputs or not full.n_outputs or not full.n_states:
        return 0.0, 0.0
    omega = np.append(default_grid(full, 40) * 1.0123, way.looked_at)
    if full.is_discrete:
        omega = omega[omega < np.pi / full.dt]
    for low, high in evidence.left_out:
        omega = omega[(omega <= low) | (omega >= high)]
    share = OVERLOOKED if way.seen is None else 0.0  # what weighs a difference would weigh the bounds of its errors
    (first, error), (second, other) = (_response(m, omega, share, evidence.parts) for m in (full, model))
    # No square overflows in this unit.
    unit = float(max(np.abs(first).max(initial=0.0), np.abs(second).max(initial=0.0))) or 1.0
    size = unit * float(largest_gain(first / unit).max(initial=0.0))
    if way.seen is None:
        gap = unit * largest_gain((first - second) / unit) - error - other
    else:
        gap = np.linalg.norm(way.seen(omega, first - second), 2, axis=(1, 2))
    return float(gap.max(initial=0.0)), size


def _response(
    model: StateSpaceModel, omega: Array, share: float, parts: tuple[StateSpaceModel, ...]
) -> tuple[ComplexArray, Array]:
    known = next((vars(m).get("_eigen") for m in parts if np.array_equal(m.A, model.A)), None)
    modes = ModalResponse.of(model.A, model.B, model.C, model.D, known) if model.n_states and share else None
    return response_within(model, modes, omega, share)


def _coprime_reduction(full: StateSpaceModel) -> Candidates:
    reduction = CoprimeReduction(full)
    balancing, factors = reduction.balancing, reduction.factors
    way = _Way(balancing.values, len(balancing.left), reduction.reduced, hinf_norm)

    def candidate(order: int) -> ReducedModel:
        promised = error_bound(way.values, order)
        error = _measured(way, parallel(factors, reduction.reduced_factors(order), -1), promised)
        found = _checked(full, way.reduced(order), "coprime", way, _Evidence(error), promised, 0)
        if reduction.lost is None:
            return replace(found, removed=reduction.removed)
        reason = f"what was removed before is not exactly hidden: {', '.join(reduction.removed)}"
        return replace(found, removed=reduction.removed, status=Status.INACCURATE, reason=found.reason or reason)

    return candidate, 0, way.most, np.append(way.values, 0.0)
