"""Reduction of models with certified errors: by five methods, or to the least order with the same gain.

Van Dooren, "The generalized eigenstructure problem in linear system theory", IEEE TAC 26 (1981), for the latter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, Literal, NamedTuple, get_args, overload

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.checks import choice, number, whole
from robustlab.display import Displayable, Facts
from robustlab.display import number as in_words
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.matrices import refuse_extremes
from robustlab.linear_analysis.structural import least_order
from robustlab.norms import HinfNorm, hinf_norm, linf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model, parallel, series
from robustlab.synthesis.problem.generalized_plant import side_by_side
from robustlab.synthesis.reduction.balancing import Way, Weights, lost_at_least_order, way_of
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.reduction import Reduction, reduction

Method = Literal["truncation", "residualisation", "hankel", "stochastic", "coprime"]
Bands = tuple[tuple[float, float], ...]

METHODS = get_args(Method)
LABELS = {"weighted": "weighted error", "coprime": "error of the coprime factors"}
RTOL = 1e-6  # relative width of the bracket of an error
# A certified error may exceed the a-priori bound by this share of the largest Hankel value: rounding of the model.
BOUND_ROUNDING = 1e-10
# Share of the error that splitting off modes may add, before frequencies next to a mode on the boundary are left out;
# for this the error counts as at least the second share of the largest Hankel value.
SPLIT_SHARE, OVERLOOKED = 1e-3, 1e-9
# A pole counts as one on the boundary up to this share of its frequency (one at zero: of the slowest stable one).
NEAR = 1e-6
WIDTHS = 10.0 ** np.arange(-12, -1)  # half widths of the bands left out, as shares of the same


class Evidence(NamedTuple):
    """The error of a reduced model with its proof; see the properties of `ReducedModel`."""

    error: HinfNorm
    left_out: Bands = ()
    reason: str = ""


@dataclass(frozen=True, eq=False)
class ReducedModel(Displayable):
    """A model of lower order with its certified error, which is computed when it is first read."""

    quantities: ClassVar[Mapping[str, Any]] = {
        "order": "1", "error": float, "states": "1", "bound": float, "n_apart": "1", "hankel": [float], "stable": bool,
    }  # fmt: skip

    model: StateSpaceModel  # with the inputs and outputs of the one given
    method: str  # one of METHODS, with "weighted " before it where there are weights, or "minimal"
    hankel: Array  # Hankel values of the reduced part (or of the coprime factors, or of the phase), in decreasing order
    n_apart: int  # number of states kept apart, because their modes are not stable
    full: StateSpaceModel  # the model as given
    promised: float  # a-priori bound of the error, without rounding; NaN where there is none
    judge: Callable[[], Evidence]
    weights: Weights = (None, None)
    removed: tuple[str, ...] = ()  # hidden modes that were removed: all of them by "minimal", else those not stable

    @cached_property
    def evidence(self) -> Evidence:
        return self.judge()

    @property
    def error(self) -> HinfNorm:
        """Largest gain of the difference of the two models, as given and as returned, but at ``left_out``.

        Times the weights if any; for ``"coprime"`` of the normalised right coprime factors ``[N; M]``.
        """
        return self.evidence.error

    @property
    def left_out(self) -> Bands:
        """Intervals (low, high) in rad/s around modes on the stability boundary, for which ``error`` says nothing.

        Rounding moves such a mode, or its share of the response, and no bound of the difference is finite there.
        """
        return self.evidence.left_out

    @property
    def reason(self) -> str:
        """Why the status is INACCURATE; else empty."""
        return self.evidence.reason

    @property
    def bound(self) -> float:
        """``promised``, or ``error.upper`` where that is larger, as the model returned is rounded."""
        return self.promised if np.isnan(self.promised) else max(self.promised, self.error.upper)

    @property
    def status(self) -> Status:
        """CERTIFIED where ``error`` is proved, and within what theory promises; INACCURATE where digits were lost."""
        sure = not self.reason and self.error.status is Status.CERTIFIED
        return Status.CERTIFIED if sure else Status.INACCURATE

    @property
    def order(self) -> int:
        return self.model.n_states

    def to_model(self) -> StateSpaceModel:
        return self.model

    def headline(self) -> str:
        kept = f"{self.order} of {self.full.n_states} states by {self.method}"
        return f"{kept}, with an error of at most {in_words(self.error.upper)}"

    def numbers(self) -> dict[str, Any]:
        return {
            "order": self.order, "error": self.error.upper, "states": self.full.n_states,
            "bound": None if np.isnan(self.bound) else self.bound, "n_apart": self.n_apart,
            "hankel": self.hankel, "stable": self.model.is_stable(),
        }  # fmt: skip

    def facts(self) -> Facts:
        at = "" if np.isnan(self.error.frequency) else f" at {self.error.frequency:.4g} rad/s"
        bound = f"; promised: at most {self.bound:.6g}" if np.isfinite(self.bound) else ""
        label = LABELS.get(self.method.partition(" ")[0], "error")
        around = ", ".join(
            f"{0.5 * (low + high):.6g} +- {0.5 * (high - low):.2g}" if low else f"0 to {high:.2g}"
            for low, high in self.left_out
        )
        return [
            ("order", f"{self.order} of {self.full.n_states} states"),
            ("method", self.method),
            (label, f"{self.error.upper:.6g}{at} (verified upper bound{bound})"),
            ("not proved at", around and f"{around} rad/s (modes on the stability boundary, kept apart)"),
            ("status", self.status.value),
            ("Hankel values", ", ".join(f"{value:.4g}" for value in self.hankel[:12]) or "none"),
            ("kept apart", f"{self.n_apart} states of modes that are not stable" if self.n_apart else ""),
            *(("removed", mode) for mode in self.removed),
            ("why", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        names = "model method error bound hankel n_apart status reason left_out removed order"
        data = {name: getattr(self, name) for name in names.split()}
        return {"type": "ReducedModel", **data, "full_order": self.full.n_states}


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

    No model of order r is nearer than :math:`\sigma_{r+1}`. Modes that are not stable are split off and kept, and the
    rounding of this is part of the error; uncontrollable or unobservable ones of them are removed (`minimal`). The
    error is computed when it is first read. Moore 1981; Glover 1984 (bound, Hankel norm); Liu, Anderson 1989
    (residualisation); Green 1988 (stochastic); Enns 1984 (weights); Meyer 1990 (coprime factors); Zhou, Doyle, Glover
    1996, chapters 7 and 8.

    Of an uncertain model the repetitions of its blocks are reduced, exactly: uncontrollable and unobservable ones are
    removed, of all blocks jointly, until none is left (D'Andrea, Khatri 1997).

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object with n states; continuous or discrete, stable or not. Or an
        UncertainModel, with ``tolerance`` alone.
    order, tolerance
        Number of states of the result, those kept apart included; fewer where the rest is not minimal. Or the lowest
        order whose certified error is at most the tolerance (all minimal states where none is), in output units per
        input unit. Of an uncertain model: singular values below ``tolerance`` times the largest count as zero (1e-12).
    method
        ``"truncation"`` is exact at infinite frequency, ``"residualisation"`` (singular perturbation) at zero
        frequency. ``"hankel"`` is nearest in the Hankel norm, with a direct term that halves the bound.
        ``"stochastic"`` keeps the error small where the gain of the stable part is small. ``"coprime"`` reduces modes
        of any stability, through the normalised right coprime factors :math:`G = N M^{-1}`; the error is then the
        H-infinity norm of ``[N - N_r; M - M_r]`` (a bound of the gap).
    input_weight, output_weight
        Stable models W_i (as many outputs as G has inputs) and W_o (as many inputs as G has outputs), one or both: the
        error is that of ``W_o (G - G_r) W_i``. Large where the error shall be small.
    floor
        beta of ``"stochastic"``, in output units per input unit: below this gain errors count absolutely. Required
        where the gain vanishes: without full row rank of D, with more outputs than inputs, with zeros on the axis.

    Returns
    -------
    ReducedModel or Reduction
        With its certified error and the frequencies (``left_out``) next to modes on the stability boundary for which
        nothing is certified; its states are balanced, those kept apart come last. Of an uncertain model the sizes of
        its blocks before and after, with the evidence that it is the same set.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Neither or both of order and tolerance, an order that does not exist, weights that do not fit, a gain that
        vanishes at infinite frequency for ``"stochastic"`` without a floor. Gramians lost their digits; the reduced
        model is not stable (two weights give no guarantee), or not well posed; the gain vanishes at some frequency.

    Examples
    --------
    >>> G = StateSpaceModel([[-1.0, 0.0], [0.0, -50.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    >>> found = reduce_model(G, tolerance=0.05, method="residualisation")
    >>> found.order, bool(abs(found.model.dc_gain()[0, 0] - G.dc_gain()[0, 0]) < 1e-12)
    (1, True)
    """
    if isinstance(model, UncertainModel):
        more = {"order": order, "method": None if method == "truncation" else method, "floor": floor or None}
        more |= {"input_weight": input_weight, "output_weight": output_weight}
        if given := next((name for name, value in more.items() if value is not None), None):
            hint = "the nominal model (.nominal) takes it"
            raise InputError(f"reduce_model: {given}", "given with an uncertain model", "tolerance alone", hint)
        return reduction(model, 1e-12 if tolerance is None else tolerance)
    full = as_model(model, "reduce_model")
    weights = _weight(full, "input_weight", input_weight), _weight(full, "output_weight", output_weight)
    if (order is None) == (tolerance is None):
        raise InputError("reduce_model", f"order={order}, tolerance={tolerance}", "one of the two")
    if order is not None:
        whole("reduce_model: order", order, 0, full.n_states)
    if tolerance is not None:
        number("reduce_model: tolerance", tolerance, above=0)
    choice("reduce_model: method", method, METHODS)
    if weights != (None, None) and method not in ("truncation", "residualisation"):
        raise InputError("reduce_model", f"weights with method {method!r}", "truncation or residualisation")
    number("reduce_model: floor", floor, "a number that is not negative", at_least=0)
    if floor and method != "stochastic":
        raise InputError("reduce_model", f"floor with method {method!r}", "stochastic")
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


def _weight(full: StateSpaceModel, name: str, given: Any) -> StateSpaceModel | None:
    """Return a weight on the inputs or outputs of a model, without signal names."""
    if given is None:
        return None
    where, into = f"reduce_model: {name}", name == "input_weight"
    w, size = as_model(given, where), full.n_inputs if into else full.n_outputs
    w = side_by_side(*[w] * (size if (w.n_outputs, w.n_inputs) == (1, 1) else 1))  # a scalar one is for every channel
    if (has := w.n_outputs if into else w.n_inputs) != size:
        raise InputError(where, f"{has} {'outputs' if into else 'inputs'}", f"{size}")
    if w.n_states and not w.is_stable():
        raise InputError(where, "the weight is not stable", "a stable weight")
    return w


def _reduced(full: StateSpaceModel, way: Way, order: int) -> ReducedModel:
    """Return the model whose reduced part has this order."""
    split, small, weighted = way.split, way.reduced(order), way.weights != (None, None)
    if not small.is_stable():
        hint = "another order, or one weight instead of two" if weighted else "another order"
        n = small.n_states + split.apart.n_states
        raise NoTrustworthyNumber("reduce_model", f"the model of order {n} is not stable", hint=hint)
    made = way.whole(small)
    model = StateSpaceModel(made.A, made.B, made.C, made.D, full.dt, full.inputs, full.outputs, where="reduced model")
    return ReducedModel(
        model, f"weighted {way.method}" if weighted else way.method, way.balancing.values, split.apart.n_states, full,
        way.bound(small.n_states), partial(_judged, way, small), way.weights, tuple(m.meaning for m in split.hidden),
    )  # fmt: skip


def _judged(way: Way, small: StateSpaceModel) -> Evidence:
    """Return the error of a reduced part, that of splitting off the other modes included."""
    split, promised = way.split, way.bound(small.n_states)
    largest = float(way.balancing.values.max(initial=0.0))
    difference, (into, out), left_out, reason = parallel(way.part, small, -1), way.weights, (), ""
    difference = difference if into is None else series(into, difference)
    error = hinf_norm(difference if out is None else series(difference, out), RTOL)
    if way.method == "coprime" and split.lost is not None:
        reason = "the modes that were removed before are not exactly hidden"
    elif split.lost is not None:
        per_gain = float(np.prod([hinf_norm(w, 1e-2).upper for w in (into, out) if w is not None]))
        wanted = SPLIT_SHARE * max(error.upper, OVERLOOKED * largest) / per_gain if per_gain else np.inf
        upper, left_out, doubt = _lost_gain(split.lost, split.apart.poles(), split.stable.poles(), wanted)
        by, status = per_gain * upper if upper else 0.0, Status.INACCURATE if doubt else error.status
        ends = max(error.lower - by, 0.0), error.upper + by
        error = HinfNorm(*ends, error.frequency, status, error.reason or doubt)
    if error.lower > promised + BOUND_ROUNDING * largest + 1e-12 * error.lower:
        reason = f"the error {error.lower:.6g} exceeds what theory promises, {promised:.6g}: digits were lost"
    return Evidence(error, left_out, error.reason or reason)


@error_context("minimal")
def minimal(model: Any, *, tolerance: float | None = None) -> ReducedModel:
    """Remove the modes that no input moves or no output shows, unstable and integrating ones too.

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

    Examples
    --------
    >>> from robustlab.conversion import ss
    >>> G = ss([[0, 0, 0], [0, -1, 0], [0, 1, 0]], [[1], [1], [0]], [[1, 0, 0], [0, 0, 1]], [[0], [0]])
    >>> found = minimal(G)  # two integrators, one behind a lag; the input moves their difference by the lag alone
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
    judge = partial(Evidence, error, left_out, doubt or ("" if found.clear else unclear))
    removed = tuple(mode.meaning for mode in found.hidden)
    return ReducedModel(found.model, "minimal", np.zeros(0), 0, full, np.nan, judge, removed=removed)


# --- error of splitting or removing modes -----------------------------------------------------------------------------


def _lost_gain(
    lost: StateSpaceModel, apart: AnyArray, stable: AnyArray, wanted: float = 0.0
) -> tuple[float, Bands, str]:
    """Return a bound of the gain of ``lost``, the bands in rad/s that are left out, and why it is not proved.

    At a mode on the stability boundary that gain is infinite: an interval around it is left out, the narrowest at whose
    ends it is ``wanted``, or twice that of the widest. ``apart``, ``stable``: the poles of the model that are not
    stable, and the others.
    """
    if not lost.D.size:
        return 0.0, (), ""
    dt, low, high = lost.dt, 0.0, np.pi / lost.dt if lost.dt else np.inf
    if dt:  # in rad/s
        apart, stable = (np.log(poles[np.abs(poles) > 1e-12].astype(complex)) / dt for poles in (apart, stable))
    slow = np.abs(stable).min() if len(stable) else 1 / dt if dt else np.abs(apart).max(initial=0.0) or 1.0
    centre = np.where(np.abs(np.imag(apart)) > 1e-3 * slow, np.abs(np.imag(apart)), 0.0)
    scale = np.where(centre > 0, centre, slow)
    near = np.abs(np.real(apart)) <= NEAR * scale
    first = 0
    with suppress(NoTrustworthyNumber):  # a frequency that is indistinguishable from a pole
        ends = np.abs(centre[near] + np.multiply.outer(np.append(-WIDTHS, WIDTHS), scale[near]))
        gains = np.linalg.norm(frequency_response(lost, ends.ravel()), 2, axis=(1, 2))
        gains = gains.reshape(2, len(WIDTHS), -1).max(axis=(0, 2), initial=0.0)
        first = int(np.argmax(gains <= max(wanted, 2 * gains[-1])))
    upper, left_out, doubt = np.inf, (), ""
    for half in np.multiply.outer(WIDTHS[first:], scale[near]):
        left_out = _merged(np.clip([centre[near] - half, centre[near] + half], low, high).T.tolist())
        ends = [low, *(end for interval in left_out for end in interval), high]
        found = [linf_norm(lost, 0.01, band=(a, b)) for a, b in zip(ends[::2], ends[1::2], strict=True) if a < b]
        upper = max((norm.upper for norm in found), default=0.0)
        doubt = next((norm.reason or "not proved" for norm in found if norm.status is not Status.CERTIFIED), "")
        if not doubt or not near.any():
            break
    return upper, left_out, doubt


def _merged(intervals: list[list[float]]) -> Bands:
    """Return the intervals in order, with overlapping ones merged and empty ones left out."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(intervals):
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], high)
        elif low < high:
            found.append((low, high))
    return tuple(found)
