"""Digital controllers: each formula verified in the sampled loop, and direct design on the lifted plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, overload

import numpy as np

from robustlab.budget import MILLION, Budget, dense, one_thread
from robustlab.checks import choice, number
from robustlab.display import AllFields, Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.feedback import wired
from robustlab.norms import HinfNorm, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.hinf.loop_shaping import with_default_performance
from robustlab.synthesis.problem.certify import given_scalings, plant_with_scalings
from robustlab.synthesis.problem.design import Synthesis, design_budget, final_status, limiting_channels
from robustlab.synthesis.problem.partition import GeneralizedPlant, as_generalized_plant
from robustlab.synthesis.sampled.discretisation import (
    METHODS,
    MergedModes,
    Method,
    SampledMethod,
    by_formula,
    merged_modes,
)
from robustlab.synthesis.sampled.lifting import lift
from robustlab.synthesis.sampled.sampled_norm import (
    SampledDataNorm,
    check_sampling,
    sampled_loop_norm,
    with_antialiasing,
)

CONTROLLER_WORK = 60 * MILLION  # the usual work at effort 1
DESIGN_INTERVALS = 4  # of a period, for disturbance and performance in the direct design
DESIGN_GAMMA_REL = 1.02  # allowed ratio of its gamma to the smallest: larger: slower poles
MOST_DESIGN = 48  # lifted channels of the direct design at most

WHERE = "discretise"


@dataclass(frozen=True)
class SampledTrial(AllFields):
    """One digital controller with the proved norm of its sampled loop."""

    method: str  # its method
    order: int  # its number of states
    # lower, upper: bracket of the sampled-data norm; inf where the loop is not stable
    lower: float
    upper: float
    loss: float  # `upper / norm of the continuous loop - 1`
    status: Status  # status of the bracket
    reason: str = ""  # why there is no finite norm, or no controller; else empty

    @property
    def text(self) -> str:
        """The loss in words."""
        if np.isfinite(self.upper):
            return f"loss {100 * self.loss:+.3g} %"
        return "not stable" if self.order >= 0 else "none"


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledController(Synthesis):
    """A digital controller; ``gamma`` is the proved H-infinity norm of the sampled-data loop, between samples too.

    ``closed_loop`` is the discrete loop over whole sample periods (lifted): from w to z on the intervals of a period.
    ``plant`` is the continuous plant as given.

    Attributes
    ----------
    original
        The continuous controller.
    continuous_norm
        Norm of the continuous loop with it.
    norm
        Bracket of the sampled-data norm.
    allowed_loss
        The loss up to which no direct design is tried.
    trials
        All methods tried.
    delay
        Computational delay in s.
    antialiasing
        Corner of the filter before the sampler in rad/s; None: no filter.
    pathological
        Pairs of plant modes with one sampled mode.
    chosen
        The method of K.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, "dt": "s", "delay": "s", "antialiasing": "rad/s", "loss": float, "allowed_loss": float,
    }  # fmt: skip
    saved = (
        *Synthesis.saved, "dt", "chosen", "loss", "allowed_loss", "delay", "antialiasing", "continuous_norm", "norm",
        "trials", "pathological", "original",
    )  # fmt: skip

    original: StateSpaceModel
    continuous_norm: HinfNorm
    norm: SampledDataNorm
    allowed_loss: float
    trials: tuple[SampledTrial, ...]
    delay: float
    antialiasing: float | None
    pathological: tuple[MergedModes, ...]
    chosen: str

    @property
    def dt(self) -> float:
        """Sample time in s."""
        return self.K.dt

    @property
    def loss(self) -> float:
        """``gamma / norm of the continuous loop - 1``; negative where the sampled loop has the smaller norm."""
        return _loss(self.gamma, self.continuous_norm)

    @property
    def met(self) -> bool:
        """Whether the loss is within the allowed one."""
        return self.loss <= self.allowed_loss

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (sampled loop, between samples too; at least {self.norm.lower:.6g})"

    def facts(self) -> Facts:
        rows = [("sampled-data norm" if label == "gamma" else label, text) for label, text in super().facts()]
        text = f"{100 * self.loss:.3g} % of the continuous loop's {self.continuous_norm.upper:.6g}"
        head = [
            ("method", f"{self.chosen}, dt = {self.K.dt:g} s" + (f", delay {self.delay:g} s" if self.delay else "")),
            ("loss", f"{text} (allowed: {100 * self.allowed_loss:g} %)"),
        ]
        if self.antialiasing is not None:
            head.append(("before the sampler", f"first-order filter at {self.antialiasing:.4g} rad/s"))
        elif self.norm.held:
            head.append(("taken as constant between samples", ", ".join(self.norm.held)))
        tried = [f"{t.method}: {t.text.removeprefix('loss ')}" for t in self.trials]
        notes = [("note", str(merged)) for merged in self.pathological]
        return [*head, *rows, ("loss by method", ", ".join(tried)), *notes]


@overload
def discretise(
    model: Synthesis, dt: float, method: SampledMethod | None = None, *, plant: Any = None, **options: Any
) -> SampledController: ...
@overload
def discretise(
    model: Any, dt: float, method: Method | None = None, *, plant: None = None, prewarp: float | None = None
) -> StateSpaceModel: ...
@overload
def discretise(
    model: Any, dt: float, method: SampledMethod | None = None, *, plant: Any, **options: Any
) -> SampledController: ...
@error_context("discretise")
def discretise(
    model: Any,
    dt: float,
    method: SampledMethod | None = None,
    *,
    plant: Any = None,
    prewarp: float | None = None,
    loss: float = 0.1,
    delay: float = 0.0,
    antialiasing: float | None = None,
    scalings: Any = None,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> StateSpaceModel | SampledController:
    r"""Compute a discrete model with sample time ``dt`` of a continuous one, with the same signals.

    .. math:: \dot x = A x + B u \quad\to\quad x_{k+1} = A_d x_k + B_d u_k

    The states of ``zoh`` and ``impulse`` and their operating point are those of the model; the other methods have
    states of their own and no operating point.

    A controller with its plant, a design or a controller with ``plant=``, is evaluated in its loop, between the samples
    too:

    .. math:: \text{loss} = \frac{\|F_l(P, H K_d S)\|}{\|F_l(P, K)\|_\infty} - 1

    with sampler S and zero-order hold H; the norm is that of `sampled_data_norm`. The sampled loop's stability is that
    of an exact discrete model of the plant. Where the formulas lose more than ``loss``, a controller is designed for
    the sampled plant itself: H-infinity synthesis on the lifted plant.

    Parameters
    ----------
    model
        Continuous StateSpaceModel with n states, controller, design or python-control object.
    dt
        Sample time in s.
    method
        See the table of `robustlab.synthesis.sampled.discretisation`, ``"tustin"`` where left out. ``"matched"`` is for
        one input and one output. Of a controller with its plant also ``"direct"``, and ``"auto"`` where left out: the
        best of the formulas, or the direct design where they lose more than ``loss``.
    plant
        Generalised plant of the controller (see `hinf`), or the design whose plant it is; that of a design where left
        out. Of a bare plant, whose every input is a control and every output a measurement, the four-block loop is
        evaluated, as by `reduce_controller`. The options below require it.
    prewarp
        Frequency in rad/s at which ``"tustin-prewarp"`` is exact, below pi / dt; with a plant, the frequency of the
        continuous loop's peak where left out.
    loss
        Largest loss allowed, as a share.
    delay
        Computational delay in s, between sample and change of the control.
    antialiasing
        Corner frequency in rad/s of a filter before the sampler; see `sampled_data_norm`.
    scalings
        Pair of stable models ``(D_z, D_w^-1)``: the norm of the scaled loop then bounds mu for the linear
        time-invariant perturbations that commute with them, in the sampled loop as well.
    time_limit
        Time in s, checked between methods and by the direct design; none where left out. Where it ends the search the
        status is TIMEOUT.
    effort
        Multiple of the usual work.
    progress
        Called with one line for each method.

    Returns
    -------
    StateSpaceModel or SampledController
        Discrete, with n states (``"matched"``: as many as there are poles), and the signals of the model. Of a
        controller with its plant the one of smallest proved norm among those tried, with the loss of each.

    Raises
    ------
    InputError
        A discrete model (its dt is named), a sample time that is not positive, an unknown method, a prewarp frequency
        beyond the Nyquist frequency, a direct term with ``"impulse"``, several channels with ``"matched"``; a delay in
        a loop or between dynamic parts; options of a loop without a plant.
    NoTrustworthyNumber
        A pole that the bilinear map sends to infinity; poles and zeros that do not reproduce the response; a continuous
        loop that is not stable; no method that leaves the sampled loop stable (pathological sampling is named).

    References
    ----------
    Franklin, Powell, Workman (1998), chapter 6; Chen, Francis, *Optimal Sampled-Data Control Systems* (1995), chapters
    8, 13; Bamieh, Pearson (1992).

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> discretise(lag, 0.1, "zoh").A.round(6)
    array([[0.904837]])

    A design, evaluated between the samples too:

    >>> from robustlab.synthesis.hinf.hinf_synthesis import hinf
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> digital = discretise(hinf(P, 1, 1), 0.05)
    >>> digital.status.value, digital.loss < 0.1, digital.K.dt
    ('certified', True, 0.05)
    """
    found: Any = plant if plant is not None else model if isinstance(model, Synthesis) else None
    if found is None:
        loop = {"loss": loss != 0.1, "delay": delay != 0, "antialiasing": antialiasing is not None}
        loop |= {"scalings": scalings is not None, "method": method in ("auto", "direct")}
        if given := next((name for name, is_given in loop.items() if is_given), None):
            raise InputError(f"discretise: {given}", "no plant to judge the loop with", "plant= beside it")
        return by_formula(model, dt, "tustin" if method is None else method, prewarp)
    full = as_model(getattr(model, "K", model), WHERE)
    p = as_generalized_plant(
        found.plant if isinstance(found, Synthesis) else found, full.n_inputs, full.n_outputs, f"{WHERE}: plant"
    )
    check_sampling(p, full, dt, delay, WHERE)
    if full.is_discrete:
        raise InputError(WHERE, f"the controller has dt = {full.dt:g} s already", "a continuous controller")
    full = wired(full, p.measurements, p.controls, WHERE)
    p = with_default_performance(p, WHERE)
    choice(f"{WHERE}: method", method or "auto", ("auto", "direct", *METHODS))
    number(f"{WHERE}: loss", loss, at_least=0)
    budget = design_budget(WHERE, CONTROLLER_WORK, effort, time_limit)
    judged = p if scalings is None else plant_with_scalings(p, given_scalings(scalings, 0.0, WHERE), WHERE)
    with one_thread():
        continuous = hinf_norm(judged.close(full))
        if not np.isfinite(continuous.upper):
            raise NoTrustworthyNumber(WHERE, f"the continuous loop is not stable ({continuous.reason})")
        judged = with_antialiasing(judged, antialiasing, WHERE)
        merged = merged_modes(judged.model, dt)
        corner = continuous.frequency if prewarp is None else prewarp
        names = [method] if method not in (None, "auto", "direct") else []
        if method in (None, "auto"):
            names = ["tustin", *["tustin-prewarp"] * bool(0 < continuous.frequency < 0.9 * np.pi / dt), "zoh", "foh"]
            names += ["matched"] * ((full.n_inputs, full.n_outputs) == (1, 1))
        trials, best = list[SampledTrial](), None
        for name in [*names, *["direct"] * (method in (None, "auto", "direct"))]:
            enough = best is not None and _loss(best[2].upper, continuous) <= loss
            if budget.over or (name == "direct" and enough):
                break
            try:
                if name == "direct":
                    made = _designed(judged, float(dt), delay, budget)
                    made = StateSpaceModel(made.A, made.B, made.C, made.D, dt, full.inputs, full.outputs)
                else:
                    made = by_formula(full, dt, name, corner if name == "tustin-prewarp" else None)
                budget.spend(dense(judged.model.n_states + made.n_states, 200))  # as measured
                # A norm larger than the best is not refined, unless the best is in doubt.
                sure = best is not None and best[2].status.trustworthy
                least = best[2].upper if best is not None else np.inf
                norm = sampled_loop_norm(judged, made, delay, 1e-2, least if sure else np.inf)
                order, lower, upper, status, reason = made.n_states, norm.lower, norm.upper, norm.status, norm.reason
                if np.isfinite(upper) and (not status.trustworthy, upper) < (not sure, least):
                    best = name, made, norm
            except (InputError, NoTrustworthyNumber) as error:  # InputError: a loop that is not well posed
                named = [str(pair) for pair in merged if not pair.stable and name == "direct"]
                order, lower, upper, status = -1, np.inf, np.inf, Status.FAILED
                reason = "; ".join([error.line, *named])
            trials.append(SampledTrial(name, order, lower, upper, _loss(upper, continuous), status, reason))
            if progress is not None:
                progress(f"{name}: {reason if order < 0 else f'sampled-data norm {upper:.6g}, {trials[-1].text}'}")
    if best is None:
        ended = f" ({budget.remark})" if budget.remark else ""
        outcomes = [f"{trial.method}: {trial.reason or 'not stable'}" for trial in trials]
        raise NoTrustworthyNumber(
            WHERE, f"no digital controller with dt = {dt:g} s left the sampled loop stable{ended}",
            hint="a shorter sample time", more=(*map(str, merged), *outcomes),
        )  # fmt: skip
    name, made, norm = best
    how = norm.reason or f"norm proved on {norm.n_intervals} intervals a period"
    reason = f"{name}: sampled loop rebuilt, {how}"
    if _loss(norm.upper, continuous) > loss:
        reason += f"; no method tried keeps the loss to {100 * loss:g} %"
    status, reason = final_status(norm.status, [reason], budget, "one that loses less")
    return SampledController(
        K=made, gamma=norm.upper, closed_loop=norm.loop, status=status, reason=reason,
        limit=limiting_channels(norm.loop, norm.frequency), plant=p, method=f"sampled {name}", original=full,
        continuous_norm=continuous, norm=norm, allowed_loss=loss, trials=tuple(trials), delay=delay,
        antialiasing=antialiasing, pathological=merged, chosen=name,
    )  # fmt: skip


def _loss(value: float, reference: HinfNorm) -> float:
    return value / reference.upper - 1 if reference.upper > 0 else float(np.inf if value else 0.0)


def _designed(plant: GeneralizedPlant, dt: float, delay: float, budget: Budget) -> StateSpaceModel:
    """Design a controller by H-infinity synthesis on the lifted plant."""
    n_intervals = int(np.clip(MOST_DESIGN // max(plant.n_w, plant.n_z, 1), 1, DESIGN_INTERVALS))
    lifted = lift(plant, dt, n_intervals, delay).generalized_plant()
    return synthesize(lifted, "hinf", DESIGN_GAMMA_REL, budget).K
