"""Reduction of models: balanced truncation, residualisation, coprime factors, frequency weights; errors certified."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array, ComplexArray
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.frequency import default_grid, frequency_response, response_within
from robustlab.magnitude import Moderated, moderated
from robustlab.modal_response import ModalResponse
from robustlab.norms import HinfNorm, bilinear_to_discrete, hinf_norm, norm_as_given
from robustlab.result import Status
from robustlab.shown import Facts, Shown
from robustlab.statespace import StateSpaceModel, append, as_model, series
from robustlab.synthesis.reduction.balancing import Balancing, Projection, block_factor, gramian_factors, split_stable
from robustlab.uncertainty.distances.coprime import continuous_models, coprime_factors

__all__ = [
    "CoprimeReduction",
    "ReducedModel",
    "balanced_truncation",
    "error_bound",
    "hankel_singular_values",
    "reduce_model",
    "weighted_factors",
]

Weights = tuple[StateSpaceModel | None, StateSpaceModel | None]  # W_i and W_o
Method = Literal["truncation", "residualisation", "coprime"]
METHODS = ("truncation", "residualisation", "coprime")

# A certified error may exceed its a-priori bound by this share of the largest Hankel value: rounding of the values.
BOUND_ROUNDING = 1e-10
# Share of the responses by which the two models may seem to differ.
OVERLOOKED = 1e-9


@dataclass(frozen=True, eq=False)
class ReducedModel(Shown):
    r"""A model of lower order with its certified error.

    Attributes
    ----------
    model
        The reduced model, with the inputs and outputs of the one given.
    method
        ``"truncation"``, ``"residualisation"``, ``"coprime"``, or the first two with ``"weighted "`` before them.
    error
        H-infinity norm of the difference: of the models (of their stable parts, for the others are equal); times the
        weights where there are any; for ``"coprime"`` of the normalised right coprime factors ``[N; M]``.
    bound
        What theory promises for ``error`` before anything is computed: twice the sum of the Hankel values left out,
        each counted once where it is repeated. NaN with weights: there is no such promise.
    hankel
        Hankel singular values of what was reduced (of the coprime factors for ``"coprime"``), in decreasing order.
    n_apart
        Number of states kept apart, because their modes are not stable.
    full
        The model as given.
    status
        CERTIFIED where ``error`` is proved and the two models agree with it wherever they were compared; INACCURATE
        where digits were lost.
    reason
        Why it is inaccurate; else empty.
    """

    model: StateSpaceModel
    method: str
    error: HinfNorm
    bound: float
    hankel: Array
    n_apart: int
    full: StateSpaceModel
    status: Status
    reason: str = ""

    @property
    def order(self) -> int:
        """Number of states of the reduced model."""
        return self.model.n_states

    def to_model(self) -> StateSpaceModel:
        """The reduced model."""
        return self.model

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        what = "error of the coprime factors" if self.method == "coprime" else "error"
        what = f"weighted {what}" if self.method.startswith("weighted") else what
        bound = "" if np.isnan(self.bound) else f"; promised: at most {self.bound:.6g}"
        rows = [
            ("order", f"{self.order} of {self.full.n_states} states"),
            ("method", self.method),
            (what, f"{self.error.upper:.6g} at {self.error.frequency:.4g} rad/s (verified upper bound{bound})"),
            ("status", self.status.value),
            ("Hankel values", ", ".join(f"{value:.4g}" for value in self.hankel[:12]) or "none"),
        ]
        if self.n_apart:
            rows.append(("kept apart", f"{self.n_apart} states of modes that are not stable"))
        return [*rows, ("why", self.reason)] if self.reason else rows

    def to_json(self) -> dict[str, Any]:
        """All but the model as given."""
        return {
            "type": "ReducedModel",
            **{name: getattr(self, name) for name in self.__dataclass_fields__ if name != "full"},
            "order": self.order,
            "full_order": self.full.n_states,
        }


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
    values = Balancing.of(*gramian_factors(split_stable(ordinary.model).stable)).values
    return np.array([ordinary.value(value, where) for value in values])


@told_as("balanced_truncation")
def balanced_truncation(model: Any, order: int | None = None, *, tolerance: float | None = None) -> ReducedModel:
    r"""Balanced truncation: `reduce_model` with ``method="truncation"``.

    .. math:: \sigma_{r+1} \le \|G - G_r\|_\infty \le 2 \sum_{i > r} \sigma_i

    Parameters
    ----------
    model, order, tolerance
        As in `reduce_model`.

    Returns
    -------
    ReducedModel
        With its certified error beside the bound above.

    Raises
    ------
    InputError, NoTrustworthyNumber
        As `reduce_model`.

    Examples
    --------
    >>> G = StateSpaceModel([[-1.0, 0.0], [0.0, -50.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    >>> found = balanced_truncation(G, 1)
    >>> found.order, found.status.value, found.error.lower <= found.bound * (1 + 1e-9)
    (1, 'certified', True)
    """
    return reduce_model(model, order, tolerance=tolerance)


@told_as("reduce_model")
def reduce_model(
    model: Any,
    order: int | None = None,
    *,
    tolerance: float | None = None,
    method: Method = "truncation",
    input_weight: Any = None,
    output_weight: Any = None,
) -> ReducedModel:
    r"""A model of lower order, with its error certified and, where there is one, the a-priori bound beside it.

    .. math:: \|W_o (G - G_r) W_i\|_\infty, \qquad \text{without weights} \quad \|G - G_r\|_\infty \le
       2 \sum_{i > r} \sigma_i

    Modes that are not stable are split off and kept; ``method="coprime"`` reduces them too, through the normalised
    right coprime factors ``G = N M^{-1}``, whose error is then the H-infinity norm of ``[N - N_r; M - M_r]`` (a bound
    of the gap between the two models).

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object with n states; continuous or discrete, stable or not.
    order
        Number of states of the result, those kept apart included. Fewer come out where the rest is not minimal.
    tolerance
        In place of ``order``: the lowest order whose certified error is at most this (absolute, in output units per
        input unit) is taken.
    method
        ``"truncation"`` is exact at infinite frequency, ``"residualisation"`` (singular perturbation) at zero
        frequency, ``"coprime"`` works for models of any stability.
    input_weight, output_weight
        Stable models W_i (as many outputs as G has inputs) and W_o (as many inputs as G has outputs): one or both
        (Enns). Large where the error shall be small.

    Returns
    -------
    ReducedModel
        With its certified error; its states are balanced, those kept apart come last.

    Raises
    ------
    InputError
        Neither or both of order and tolerance, an order that does not exist, weights that do not fit.
    NoTrustworthyNumber
        Gramians lost their digits; the reduced model is not stable (two weights give no guarantee), or not well posed.

    Notes
    -----
    Where no lower order keeps ``tolerance``, the model comes back with all its (minimal) states.

    References
    ----------
    Moore 1981; Glover 1984 (bound); Liu, Anderson 1989 (residualisation); Enns 1984 (weights); Meyer 1990 (coprime
    factors); Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), chapter 7 and section 8.4.

    Examples
    --------
    >>> G = StateSpaceModel([[-1.0, 0.0], [0.0, -50.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    >>> found = reduce_model(G, tolerance=0.05, method="residualisation")
    >>> found.order, bool(abs(found.model.dc_gain()[0, 0] - G.dc_gain()[0, 0]) < 1e-12)
    (1, True)
    """
    full = as_model(model, "reduce_model")
    _check_request(full, order, tolerance, method)
    weights = _weights(full, input_weight, output_weight)
    if method == "coprime":
        if weights != (None, None):
            raise InputError("reduce_model", "weights with method 'coprime'", "truncation or residualisation")
        candidate, n_least, n_most = _coprime_reduction(full)
    else:
        candidate, n_least, n_most = _balanced_reduction(full, method, weights)
    if order is not None:
        if order < n_least:
            text = f"{n_least} modes are not stable and are kept apart"
            raise InputError("reduce_model", f"order {order}: {text}", f"at least {n_least}", "method='coprime'")
        return candidate(min(order, n_most))
    assert tolerance is not None
    for n in range(n_least, n_most):
        try:
            found = candidate(n)
        except NoTrustworthyNumber:  # this order is not stable (two weights) or not well posed
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


Candidates = tuple[Callable[[int], ReducedModel], int, int]


def _balanced_reduction(full: StateSpaceModel, method: Projection, weights: Weights) -> Candidates:
    """What makes the candidate of a given order, and the least and largest order there are."""
    weighted = weights != (None, None)
    unchanged = Moderated(full, 0, 0, np.zeros(full.n_states, dtype=int))  # a weight has the units of the model
    ordinary = unchanged if weighted else moderated(full, "reduce_model")
    split = split_stable(ordinary.model)
    stable = StateSpaceModel(split.stable.A, split.stable.B, split.stable.C, split.stable.D, ordinary.model.dt)
    balancing = Balancing.of(*(weighted_factors(stable, *weights) if weighted else gramian_factors(stable)))
    apart = split.apart.n_states
    values = np.array([ordinary.value(value, "reduce_model") for value in balancing.values])

    def candidate(order: int) -> ReducedModel:
        small = balancing.reduced(stable, order - apart, method)
        if small.n_states and not small.is_stable():
            raise NoTrustworthyNumber(
                "reduce_model",
                f"the model of order {small.n_states + apart} is not stable",
                hint="another order, or one weight instead of two" if weighted else "another order",
            )
        bound = np.nan if weighted else error_bound(values, small.n_states)
        error = norm_as_given(hinf_norm(_weighted(_difference(stable, small), *weights)), ordinary)
        name = f"weighted {method}" if weighted else method
        model = ordinary.as_given(split.joined(small), "reduce_model")
        return _checked(full, model, name, error, bound, values, apart, weights)

    return candidate, apart, apart + len(balancing.left)


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


def error_bound(values: Array, order: int) -> float:
    """Twice the sum of the Hankel values after the first ``order``, each counted once where it is repeated.

    Values that agree to 1e-10 count as repeated only where the cut does not separate them from kept ones.
    """
    tail = values[order:]
    if not len(tail):
        return 0.0
    new = np.append(True, tail[1:] < tail[:-1] * (1 - 1e-10))
    distinct = tail[new]
    if order and tail[0] >= values[order - 1] * (1 - 1e-10):  # a repeated value was cut in two: count all of them
        distinct = tail
    return 2 * float(distinct.sum())


def _difference(one: StateSpaceModel, two: StateSpaceModel) -> StateSpaceModel:
    n, m = one.n_states, two.n_states
    a = np.block([[one.A, np.zeros((n, m))], [np.zeros((m, n)), two.A]])
    return StateSpaceModel(a, np.vstack([one.B, two.B]), np.hstack([one.C, -two.C]), one.D - two.D, one.dt)


def _weighted(model: StateSpaceModel, into: StateSpaceModel | None, out: StateSpaceModel | None) -> StateSpaceModel:
    if into is not None:
        model = series(into, model)
    return model if out is None else series(model, out)


def _checked(
    full: StateSpaceModel,
    model: StateSpaceModel,
    method: str,
    error: HinfNorm,
    bound: float,
    values: Array,
    apart: int,
    weights: Weights,
) -> ReducedModel:
    """The result; the models as given and as returned are compared at frequencies of the full one."""
    named = StateSpaceModel(
        model.A, model.B, model.C, model.D, full.dt, full.inputs, full.outputs, where="reduced model"
    )
    largest = float(values.max(initial=0.0))
    reason = error.reason
    if not reason and not np.isnan(bound) and error.lower > bound + BOUND_ROUNDING * largest + 1e-12 * error.lower:
        reason = f"the error {error.lower:.6g} exceeds what theory promises, {bound:.6g}: Hankel values lost digits"
    if not reason and method != "coprime":
        seen, size = _seen_difference(full, named, weights)
        if seen > error.upper * (1 + 1e-6) + OVERLOOKED * size:
            reason = f"the models differ by {seen:.6g} somewhere, more than the certified {error.upper:.6g}"
    status = Status.CERTIFIED if not reason and error.status is Status.CERTIFIED else Status.INACCURATE
    values = np.array(values)
    values.setflags(write=False)
    return ReducedModel(named, method, error, bound, values, apart, full, status, reason)


def _seen_difference(full: StateSpaceModel, model: StateSpaceModel, weights: Weights) -> tuple[float, float]:
    """Largest weighted difference of the two responses on a grid away from poles, less the bounds of their errors where
    they come from the modes, and the size of the responses.
    """
    if not full.n_inputs or not full.n_outputs or not full.n_states:
        return 0.0, 0.0
    omega = default_grid(full, 40) * 1.0123
    if full.is_discrete:
        omega = omega[omega < np.pi / full.dt]
    share = OVERLOOKED if weights == (None, None) else 0.0
    (first, error), (second, other) = (_response(m, omega, share) for m in (full, model))
    gap = first - second
    if weights[0] is not None:
        gap = gap @ frequency_response(weights[0], omega)
    if weights[1] is not None:
        gap = frequency_response(weights[1], omega) @ gap
    seen, size = (np.linalg.norm(stack, 2, axis=(1, 2)) for stack in (gap, first))
    return float((seen - error - other).max(initial=0.0)), float(size.max(initial=0.0))


def _response(model: StateSpaceModel, omega: Array, share: float) -> tuple[ComplexArray, Array]:
    modes = ModalResponse.of(model.A, model.B, model.C, model.D) if model.n_states and share else None
    return response_within(model, modes, omega, share)


class CoprimeReduction:
    """Balanced truncation of the normalised right coprime factors of a model, continuous or discrete."""

    def __init__(self, full: StateSpaceModel) -> None:
        self.full = full
        self._mapped = continuous_models(full)
        self.factors = coprime_factors(self._mapped.models[0]).right
        self.balancing = Balancing.of(*gramian_factors(self.factors))

    def reduced_factors(self, order: int) -> StateSpaceModel:
        """``[N_r; M_r]`` in continuous time."""
        return self.balancing.reduced(self.factors, order, "truncation")

    def reduced(self, order: int) -> StateSpaceModel:
        """``N_r M_r^{-1}``.

        Raises
        ------
        NoTrustworthyNumber
            M_r has no inverse.
        """
        small, p = self.reduced_factors(order), self.full.n_outputs
        n, m = (small.C[:p], small.D[:p]), (small.C[p:], small.D[p:])
        if small.n_inputs and np.linalg.cond(m[1]) > 1e12:
            raise NoTrustworthyNumber("reduce_model", "the factor M of the reduced model has no inverse")
        back = np.linalg.inv(m[1])
        gain, into = back @ m[0], small.B @ back
        model = StateSpaceModel(small.A - into @ m[0], into, n[0] - n[1] @ gain, n[1] @ back)
        if self.full.dt:
            model = bilinear_to_discrete(model, self.full.dt)
            if self._mapped.mirrored:
                model = StateSpaceModel(-model.A, -model.B, model.C, model.D, self.full.dt)
        return model


def _coprime_reduction(full: StateSpaceModel) -> Candidates:
    reduction = CoprimeReduction(full)
    values = reduction.balancing.values

    def candidate(order: int) -> ReducedModel:
        error = hinf_norm(_difference(reduction.factors, reduction.reduced_factors(order)))
        bound = error_bound(values, order)
        return _checked(full, reduction.reduced(order), "coprime", error, bound, values, 0, (None, None))

    return candidate, 0, len(reduction.balancing.left)
