"""Smallest uncertainty of a chosen form that covers a set of models, and its conservatism.

That is the ratio of the worst gains of the cover and of the models, both in the same loop; 1 at least.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import NOT_REPEATABLE, USED_UP, one_thread
from robustlab.display import Displayable, Facts, Part, number
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, error_context, is_function
from robustlab.mu_analysis.axis.robustness import worst_case_gain
from robustlab.norms import hinf_norm
from robustlab.result import Status, Typed
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty import covers
from robustlab.uncertainty.elementwise import misses
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.unstructured import FORMS

EXACT = 1e-12  # relative rounding error of a member of an exact cover

COVER_FORMS = (*covers.PARAMETRIC_FORMS, *FORMS)
Loop = Callable[[UncertainModel], UncertainModel]


@dataclass(frozen=True)
class Conservatism(Typed, Displayable):
    """Ratio of the worst gain of a cover to that of its models."""

    ratio: float  # cover_upper / set_gain: proved not to be more
    least: float  # cover_lower / set_gain: attained by a member
    set_gain: float  # largest H-infinity norm of the models
    set_model: int  # the model that has it, counted from 1
    cover_lower: float  # bounds of the worst gain of the cover
    cover_upper: float
    status: Status  # of the worst gain; FAILED where there is none
    reason: str = ""  # why there is none, or for an early end of its proof


@dataclass(frozen=True, eq=False)
class Cover(Displayable):
    """An uncertain model that holds every model of a set.

    CERTIFIED: each model's delta was evaluated, or is proved to be a stable one of gain at most one over all
    frequencies. CONVERGED: the deltas are stable, and were found to be at most one on a grid of frequencies.
    INACCURATE: a model is missed by more than the tolerance, or the weight is further above the bound than requested.
    """

    model: UncertainModel
    form: str
    status: Status
    # For each model the value of every block by name: numbers, or a system for an unstructured block where it could be
    # written as one; empty where it was judged by frequency response.
    deltas: tuple[dict[str, Any], ...]
    sizes: tuple[float, ...]  # of each model its largest delta: at most 1
    misses: tuple[float, ...]  # largest difference of the member at its delta, against its matrix's largest entry
    nominal: int | None  # number of the nominal model, counted from 1; 0: the middle; None: the given one
    radius: float  # unstructured forms: largest error relative to the models' size
    spread: tuple[float, ...]  # form pca: extent of the cloud along its directions, including the omitted ones
    fit: covers.Overbound | None  # weight and bound of an unstructured form
    conservatism: Conservatism | None
    reason: str = ""  # why the status is no better
    models: tuple[StateSpaceModel, ...] = ()  # for `robustlab.verify`

    quantities: ClassVar[Mapping[str, Any]] = {
        **UncertainModel.quantities, **dict.fromkeys(("count", "members", "size", "missed", "radius"), "1"),
        **dict.fromkeys(("order", "excess", "conservatism", "conservatism_at_least"), "1"),
        "set_gain": float,
    }  # fmt: skip

    @property
    def statuses(self) -> tuple[Status, ...]:
        """Status of the cover, and that of the proof of the worst gain if there is one."""
        c = self.conservatism
        return (self.status, *([c.status] if c is not None and c.status is not Status.FAILED else []))

    @property
    def notes(self) -> tuple[str, ...]:
        """Why the status, or the conservatism, is no better."""
        c = self.conservatism
        what = "" if c is None else "No conservatism" if math.isnan(c.ratio) else "Conservatism"
        reason = f"{what}: {c.reason}." if c is not None and c.reason else ""
        return tuple(text for text in (self.reason, reason) if text)

    def numbers(self) -> dict[str, Any]:
        c = self.conservatism
        found = {
            **self.model.numbers(), "count": len(self.model.blocks), "members": len(self.sizes),
            "size": max(self.sizes), "missed": max(self.misses), "radius": self.radius,
        }  # fmt: skip
        if self.fit is not None:
            found |= {"order": self.fit.order, "excess": self.fit.excess}
        if c is not None and not c.reason:
            found |= {"conservatism": c.ratio, "conservatism_at_least": c.least, "set_gain": c.set_gain}
        return found

    def _words(self) -> str:
        starts: dict[int | None, str] = {0: "the middle of the models", None: "the model that was given"}
        start = starts.get(self.nominal, f"model {self.nominal}")
        return f"{self.form} cover of {len(self.sizes)} models around {start}"

    def headline(self) -> str:
        return f"{self._words()}: {len(self.model.blocks)} blocks"

    def facts(self) -> Facts:
        c, fit = self.conservatism, self.fit
        gain = "" if c is None else f"none, {c.reason}" if c.status is Status.FAILED else (
            f"{number(c.cover_lower, '', 6)} .. {number(c.cover_upper, '', 6)}, of the set {number(c.set_gain, '', 6)}"
            f" (model {c.set_model}): ratio at most {number(c.ratio)} ({c.status}), attained {number(c.least)}"
        )  # fmt: skip
        return [
            ("form", self._words()),
            ("set", repr(self.model)),
            ("weight", "" if fit is None else f"order {fit.order}, at most {100 * fit.excess:.3g} % above the bound"),
            ("largest error, of the models' size", "" if fit is None else f"{100 * self.radius:.3g} %"),
            ("largest delta that a model needs", number(max(self.sizes, default=math.nan), "", 6)),
            ("largest miss", number(max(self.misses, default=math.nan), "", 2) if fit is None else ""),
            ("worst gain", gain),
            *(("reason", text) for text in self.notes),
        ]

    def details(self) -> list[Part]:
        return self.model.details()

    def to_json(self) -> dict[str, Any]:
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "models"}
        return {"type": "Cover", **self.model.to_json(), **own}


@error_context("cover")
@one_thread()
def cover(
    models: Iterable[Any],
    form: str = "elements",
    *,
    nominal: Any = None,
    tolerance: float = 1e-9,
    directions: int | None = None,
    order: int = 4,
    excess: float = 0.1,
    loop: Loop | None = None,
    gain: bool = True,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
    effort: float = 1.0,
) -> Cover:
    """The smallest uncertain model of a form that holds every one of a set of models.

    Parameters
    ----------
    models
        At least two models with the same signals: operating points, units, seeds, or fits to several records.
    form
        ``elements``
            interval hull of the entries of A, B, C, D
        ``pca``
            few real parameters along the axes of the cloud of the matrices
        ``additive``, ``input-multiplicative``, ``output-multiplicative``, and ``inverse-`` with one of these
            one full block with a stable minimum-phase weight, see `robustlab.uncertainty.unstructured`; the models
            may have different states

        The first two need models with the same states.
    nominal
        Nominal model for all forms but ``pca``; by default the middle of the hull, or for a full block the candidate of
        least radius.
    tolerance, directions
        Largest relative error of an entry, for which ``pca`` keeps the directions that it needs; or their number.
    order, excess
        Largest order of the weight; how far above the bound a weight of lower order may be.
    loop
        Function applied to a model before its gain is computed, for example ``lambda g: g.feedback(K)``.
    gain
        False: no conservatism.
    time_limit, effort
        Time in s (None: no limit) and work of the proof of the worst gain, as in `robustlab.peak_gain`.
    progress
        Called with one short line before each step.

    Returns
    -------
    Cover
        The uncertain model, each model's delta in it, the excess of a weight over the bound, and the conservatism.

    Raises
    ------
    InputError
        Fewer than two models, models that do not fit together, a form or an option that does not apply.
    NoTrustworthyNumber
        An unstructured form whose errors are not stable for any nominal model.

    Examples
    --------
    >>> lags = [StateSpaceModel([[-p]], [[p]], [[1.0]], [[0.0]]) for p in (1.0, 1.5, 2.0)]
    >>> found = cover(lags, "pca")
    >>> found.status.value, [(b.name, b.repeats) for b in found.model.blocks], round(found.conservatism.ratio, 2)
    ('certified', [('direction1', 1)], 1.0)
    """
    if form not in COVER_FORMS:
        raise InputError("cover", f"form {form!r}", f"one of {', '.join(COVER_FORMS)}", did_you_mean(form, COVER_FORMS))
    parametric = form in covers.PARAMETRIC_FORMS
    found = covers.model_set(models, parametric, "cover")
    start = None
    if nominal is not None:
        start = as_model(nominal, "cover: nominal")
        covers.model_set([found[0], start], parametric, "cover: nominal")
    report = progress or (lambda _: None)
    report(f"cover: {form} around {len(found)} models")
    if parametric:
        made = _parametric(found, form, start, tolerance, directions)
    else:
        if directions is not None:
            raise InputError("cover: directions", f"{directions} with form {form}", "form pca")
        made = _unstructured(found, form, start, order, excess)
    if not gain:
        return made
    report("cover: worst gain of the cover")
    return replace(made, conservatism=_conservatism(made.model, found, loop, time_limit=time_limit, effort=effort))


def _parametric(
    models: tuple[StateSpaceModel, ...], form: Any, nominal: StateSpaceModel | None, tolerance: float, directions: Any
) -> Cover:
    model, deltas, spread = covers.parametric_cover(models, form, nominal, tolerance, directions)
    off = tuple(misses(model.evaluate(d), m) for d, m in zip(deltas, models, strict=True))
    sizes = tuple(max((abs(v) for v in d.values()), default=0.0) for d in deltas)
    met = max(sizes) <= 1.0 and max(off) <= max(2.0 * tolerance, EXACT)
    reason = "" if met else f"model {int(np.argmax(off)) + 1} is missed by {max(off):.2g}"
    status, number = Status.CERTIFIED if met else Status.INACCURATE, 0 if nominal is None else None
    return Cover(model, form, status, deltas, sizes, off, number, 0.0, spread, None, None, reason, models)


def _unstructured(
    models: tuple[StateSpaceModel, ...], form: Any, nominal: StateSpaceModel | None, order: int, excess: float
) -> Cover:
    model, number, fit, sizes, deltas, radius = covers.unstructured_cover(models, form, nominal, order, excess)
    status, reason = Status.CERTIFIED, ""
    if not deltas:
        status = Status.CONVERGED
        reason = f"deltas evaluated at {len(fit.omega)} frequencies, not proved between them"
    if max(sizes) > 1.0 + 1e-9 or not fit.status.trustworthy:
        status = Status.INACCURATE
        reason = f"the weight is {100 * fit.excess:.3g} % above the bound: a higher order comes nearer"
    named = tuple({model.blocks[0].name: d} for d in deltas)
    none = (0.0,) * len(models)
    return Cover(model, form, status, named, sizes, none, number, radius, (), fit, None, reason, models)


def _conservatism(
    uncertain: UncertainModel, models: Sequence[StateSpaceModel], loop: Loop | None, **options: Any
) -> Conservatism:
    """Compare the worst gain of a cover with the largest one of its models."""
    if loop is not None and not is_function(loop):
        raise InputError("cover: loop", f"{loop!r}", "a function of a model")

    def around(g: UncertainModel) -> UncertainModel:
        found = g if loop is None else loop(g)
        if not isinstance(found, UncertainModel):
            raise InputError("cover: loop", f"it makes a {type(found).__name__} of a model", "an uncertain model")
        return found

    norms = [hinf_norm(around(UncertainModel(model, [])).nominal) for model in models]
    gains = [norm.lower if np.isfinite(norm.upper) else np.inf for norm in norms]
    largest, number = float(max(gains)), int(np.argmax(gains)) + 1
    ratios, bounds, status, reason = (np.nan, np.nan), (np.nan, np.nan), Status.FAILED, ""
    if np.isinf(largest):
        hint = "" if loop else "; close a loop around the models first"
        reason = f"model {number} has no finite gain ({norms[number - 1].reason}){hint}"
    elif largest == 0:
        reason = "all models have no gain"
    else:
        try:
            worst = worst_case_gain(around(uncertain), tolerance=0.01, **options)
        except NoTrustworthyNumber as error:
            reason = str(error.found)
        else:
            reason = "; ".join(text for text in worst.notes if text in (NOT_REPEATABLE, USED_UP))
            bounds, status = (worst.lower, worst.upper), worst.status
            ratios = worst.upper / largest, worst.lower / largest
    return Conservatism(*ratios, largest, number, *bounds, status, reason)
