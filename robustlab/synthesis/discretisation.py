r"""From continuous to discrete time and back: by formula, and of a controller judged in its sampled loop.

Franklin, Powell, Workman (1998), chapter 6; of the logarithm Higham, *Functions of Matrices* (2008), theorem 1.31.

====================  ==================================================================================================
``tustin``            :math:`s = (2/T) (z - 1)/(z + 1)`: keeps stability and the H-infinity norm, bends frequencies
``tustin-prewarp``    :math:`s = (\omega_0 / \tan(\omega_0 T / 2)) (z - 1)/(z + 1)`: exact at :math:`\omega_0`
``zoh``               exact at the samples for an input held over the sample time (a D/A converter)
``foh``               exact at the samples for an input that is linear from sample to sample
====================  ==================================================================================================
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, ClassVar, Literal, cast, get_args, overload

import numpy as np

from robustlab.budget import dense, one_thread
from robustlab.checks import choice, number
from robustlab.display import AllFields, Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.norms import HinfNorm, bilinear_to_continuous, bilinear_to_discrete, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.hinf.loop_shaping import with_default_performance
from robustlab.synthesis.problem.design import Synthesis, design_budget, final_status, limiting_channels, relative_loss
from robustlab.synthesis.problem.generalized_plant import as_generalized_plant
from robustlab.synthesis.sampled_norm import SampledDataNorm, check_sampling, lift, sampled_loop_norm, with_antialiasing

Method = Literal["tustin", "tustin-prewarp", "zoh", "foh"]
SampledMethod = Literal["auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh"]
Hold = Literal["zoh", "tustin"]
METHODS = get_args(Method)

MERGED = 1e-6  # sampled modes closer than this, relative to their modulus, count as one
CLOSE = 1e-10  # accuracy to which the exponential of a logarithm must reproduce the matrix
EPS = float(np.finfo(float).eps)
DESIGN_INTERVALS = 4  # of a period, for disturbance and performance in the direct design
DESIGN_GAMMA_REL = 1.02  # allowed ratio of its gamma to the smallest: larger: slower poles
MOST_DESIGN = 48  # lifted channels of the direct design at most

WHERE = "discretise"


@error_context(WHERE)
def by_formula(model: Any, dt: float, method: str, prewarp: float | None = None) -> StateSpaceModel:
    """Discretise a model without a plant; see `robustlab.discretise`."""
    m = as_model(getattr(model, "K", model), "discretise")
    if m.is_discrete:
        raise InputError(WHERE, f"the model has dt = {m.dt:g} s", "a continuous model (dt = 0)")
    number(f"{WHERE}: dt", dt, "a positive sample time in s", above=0)
    choice(f"{WHERE}: method", method, METHODS)
    if (prewarp is None) == (method == "tustin-prewarp"):
        found = f"method {method!r} with prewarp={prewarp}"
        raise InputError(WHERE, found, "prewarp with 'tustin-prewarp' alone")
    if prewarp is not None and not 0 < prewarp < np.pi / dt:
        expected = f"between 0 and the Nyquist frequency {np.pi / dt:g}"
        raise InputError(WHERE, f"prewarp is {prewarp:g} rad/s", expected)
    if method in ("tustin", "tustin-prewarp"):
        bent = bilinear_to_discrete(m, 2 * float(np.tan(prewarp * dt / 2)) / prewarp if prewarp else dt)
        A, B, C, D = bent.A, bent.B, bent.C, bent.D
    else:  # by one matrix exponential; the state of `foh` is x_k less its part from u_k
        from scipy.signal import cont2discrete

        with np.errstate(over="ignore", invalid="ignore"):
            A, B, C, D, _ = cast("Any", cont2discrete((m.A, m.B, m.C, m.D), dt, method=method))
        if not (np.isfinite(A).all() and np.isfinite(B).all()):
            fastest = m.spectral_abscissa()
            found = f"e^(A dt) overflows: a pole at {fastest:.6g} 1/s grows too much in dt = {dt:g} s"
            if fastest < 0:
                rate = float(np.abs(m.poles()).max())
                found = f"e^(A dt) overflows on its way: rates up to {rate:.3g} 1/s in dt = {dt:g} s"
            raise NoTrustworthyNumber(f"discretise ({method})", found)
    at = m.operating_point if method == "zoh" else None
    return StateSpaceModel(A, B, C, D, dt, m.inputs, m.outputs, m.states, at, where=f"discretise ({method})")


# --- back to continuous time, and to another sample time --------------------------------------------------------------


@error_context("d2c")
def d2c(model: Any, method: Hold = "zoh") -> StateSpaceModel:
    r"""Compute a continuous model of a discrete one.

    .. math:: \begin{bmatrix} A & B \\ 0 & 0 \end{bmatrix}
              = \frac{1}{T} \log \begin{bmatrix} A_d & B_d \\ 0 & I \end{bmatrix}

    Parameters
    ----------
    model
        Discrete StateSpaceModel with sample time T in s, controller or python-control object.
    method
        ``"zoh"``: the model whose samples under a held input these are, with its modes below the Nyquist frequency.
        ``"tustin"``: the inverse of Tustin's rule.

    Returns
    -------
    StateSpaceModel
        With the signals of the model; with ``"zoh"`` also its states and its operating point.

    Raises
    ------
    InputError, NoTrustworthyNumber
        A continuous model, an unknown method. ``"zoh"``: a pole on the closed negative real axis, or a logarithm that
        does not reproduce the model to 1e-10. ``"tustin"``: a pole at z = -1.
    """
    m = as_model(getattr(model, "K", model), "d2c")
    if not m.is_discrete:
        raise InputError("d2c", "the model is continuous (dt = 0)", "a discrete one", "rl.discretise makes one")
    if choice("d2c: method", method, get_args(Hold)) == "tustin":
        return replace(bilinear_to_continuous(m), inputs=m.inputs, outputs=m.outputs, states=m.states)
    from scipy.linalg import expm, logm

    poles, n = m.poles(), m.n_states
    real = poles[np.abs(poles.imag) <= 1e-12 * np.abs(poles)].real
    sizes = np.linalg.svd(m.A, compute_uv=False)
    singular = n and sizes[-1] <= n * EPS * sizes[0]
    if singular or (real <= 0).any():
        pole = 0.0 if singular else real.min()
        found = f"a pole at z = {pole:.6g}: no continuous model of this order has such samples"
        hint = "method='tustin' maps this pole"
        raise NoTrustworthyNumber("d2c (zoh)", found, "poles off the closed negative real axis", hint)
    held = np.block([[m.A, m.B], [np.zeros((m.n_inputs, n)), np.eye(m.n_inputs)]])
    with warnings.catch_warnings():  # scipy's own estimate; the exponential below decides
        warnings.simplefilter("ignore", RuntimeWarning)
        rate: Any = logm(held)
    size = np.abs(held).max(initial=1.0)
    off = np.abs(expm(rate.real) - held).max(initial=0.0) / size if np.isfinite(rate).all() else np.inf
    if not off <= CLOSE:
        raise NoTrustworthyNumber("d2c (zoh)", f"the exponential of log A gives A back to {off:.1e} of its size only")
    rate = rate.real / m.dt
    return replace(m, A=rate[:n, :n], B=rate[:n, n:], dt=0.0)


def merged_modes(model: StateSpaceModel, dt: float) -> tuple[str, ...]:
    """Describe the pairs of different modes that are one mode at the samples: pathological sampling."""
    found = list[str]()
    for one, two in combinations(model.poles().astype(complex).tolist(), 2):
        multiple = round((one - two).imag * dt / (2 * np.pi))
        if multiple and abs((one - two) * dt - 2j * np.pi * multiple) <= MERGED:
            names = " and ".join(f"{pole.real:.6g}{pole.imag:+.6g}j" for pole in (one, two))
            found.append(
                f"pathological sampling: modes {names} rad/s differ by {abs(multiple)} sampling frequencies; "
                + ("they cannot be controlled one by one" if one.real < 0 else "no digital controller moves both")
            )
    return tuple(found)


# --- controllers in their sampled loops -------------------------------------------------------------------------------


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
        if np.isfinite(self.upper):
            return f"loss {100 * self.loss:+.3g} %"
        return "not stable" if self.order >= 0 else "none"


@dataclass(frozen=True, eq=False, kw_only=True)
class SampledController(Synthesis):
    """A digital controller; ``gamma`` is the proved H-infinity norm of the sampled-data loop, between samples too."""

    quantities: ClassVar[Mapping[str, Any]] = {
        "dt": "s", "delay": "s", "antialiasing": "rad/s", "loss": float, "allowed_loss": float,
    }  # fmt: skip
    saved = (
        "dt", "chosen", "loss", "allowed_loss", "delay", "antialiasing", "continuous_norm", "norm",
        "trials", "pathological", "original",
    )  # fmt: skip

    # plant: the continuous one as given; closed_loop: discrete, over whole sample periods (lifted), from w to z on the
    # intervals of a period.
    original: StateSpaceModel  # the continuous controller
    continuous_norm: HinfNorm  # of the continuous loop with it
    norm: SampledDataNorm  # bracket of the sampled-data norm
    allowed_loss: float  # up to which no direct design is tried
    trials: tuple[SampledTrial, ...]  # all methods tried
    delay: float  # in s
    antialiasing: float | None  # corner of the filter before the sampler in rad/s; None: no filter
    pathological: tuple[str, ...]  # pairs of plant modes with one sampled mode, in words
    chosen: str  # the method of K

    @property
    def dt(self) -> float:
        """Sample time in s."""
        return self.K.dt

    @property
    def loss(self) -> float:
        """``gamma / norm of the continuous loop - 1``; negative where the sampled loop has the smaller norm."""
        return relative_loss(self.gamma, self.continuous_norm.upper)

    @property
    def met(self) -> bool:
        return self.loss <= self.allowed_loss

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (sampled loop, between samples too; at least {self.norm.lower:.6g})"

    def facts(self) -> Facts:
        rows = [("sampled-data norm" if label == "gamma" else label, text) for label, text in super().facts()]
        text = f"{100 * self.loss:.3g} % of the continuous loop's {self.continuous_norm.upper:.6g}"
        corner = None if self.antialiasing is None else f"first-order filter at {self.antialiasing:.4g} rad/s"
        head = [
            ("method", f"{self.chosen}, dt = {self.K.dt:g} s" + (f", delay {self.delay:g} s" if self.delay else "")),
            ("loss", f"{text} (allowed: {100 * self.allowed_loss:g} %)"),
            ("before the sampler", corner or ""),
            ("taken as constant between samples", "" if corner else ", ".join(self.norm.held)),
        ]
        tried = [f"{t.method}: {t.text.removeprefix('loss ')}" for t in self.trials]
        notes = [("note", merged) for merged in self.pathological]
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
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> StateSpaceModel | SampledController:
    r"""Compute a discrete model with sample time ``dt`` of a continuous one, with the same signals.

    .. math:: \dot x = A x + B u \quad\to\quad x_{k+1} = A_d x_k + B_d u_k

    The states of ``zoh`` and their operating point are those of the model; the other methods have states of their own
    and no operating point. A controller with its plant, a design or a controller with ``plant=``, is evaluated in its
    loop, between the samples too:

    .. math:: \text{loss} = \frac{\|F_l(P, H K_d S)\|}{\|F_l(P, K)\|_\infty} - 1

    with sampler S and zero-order hold H; the norm is that of `sampled_data_norm`. The sampled loop's stability is that
    of an exact discrete model of the plant. Where the formulas lose more than ``loss``, a controller is designed for
    the sampled plant itself: H-infinity synthesis on the lifted plant.

    Parameters
    ----------
    model, dt
        Continuous StateSpaceModel with n states, controller, design or python-control object; sample time in s.
    method
        See the table of `robustlab.synthesis.discretisation`, ``"tustin"`` where left out. Of a controller with its
        plant also ``"direct"``, and ``"auto"`` where left out: the best of the formulas, or the direct design where
        they lose more than ``loss``.
    plant
        Generalised plant of the controller (see `hinf`), or the design whose plant it is; that of a design where left
        out. Of a bare plant, whose every input is a control and every output a measurement, the four-block loop is
        evaluated, as by `reduce_controller`. The options below require it.
    prewarp
        Frequency in rad/s at which ``"tustin-prewarp"`` is exact, below pi / dt; with a plant, the frequency of the
        continuous loop's peak where left out.
    loss, delay, antialiasing
        Largest loss allowed, as a share; computational delay in s, between sample and change of the control; corner
        frequency in rad/s of a filter before the sampler (see `sampled_data_norm`).
    time_limit, effort, progress
        As for `robustlab.hinf`.

    Returns
    -------
    StateSpaceModel or SampledController
        Discrete, with n states and the signals of the model. Of a controller with its plant the one of smallest proved
        norm among those tried, with the loss of each.

    Raises
    ------
    InputError, NoTrustworthyNumber
        A discrete model, a sample time that is not positive, an unknown method, a prewarp frequency beyond the Nyquist
        frequency; a delay in a loop or between dynamic parts; options of a loop without a plant. A pole that the
        bilinear map sends to infinity; a continuous loop that is not stable; no stable sampled loop by any method.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> discretise(lag, 0.1, "zoh").A.round(6)
    array([[0.904837]])
    """
    found: Any = plant if plant is not None else model if isinstance(model, Synthesis) else None
    if found is None:
        loop = {"loss": loss != 0.1, "delay": delay != 0, "antialiasing": antialiasing is not None}
        loop["method"] = method in ("auto", "direct")
        if given := next((name for name, is_given in loop.items() if is_given), None):
            raise InputError(f"{WHERE}: {given}", "no plant to evaluate the loop", "plant= as well")
        return by_formula(model, dt, "tustin" if method is None else method, prewarp)
    full = as_model(getattr(model, "K", model), WHERE)
    given = found.plant if isinstance(found, Synthesis) else found
    p = as_generalized_plant(given, full.n_inputs, full.n_outputs, f"{WHERE}: plant")
    full = check_sampling(p, full, dt, delay, WHERE)
    if full.is_discrete:
        raise InputError(WHERE, f"the controller has dt = {full.dt:g} s already", "a continuous controller")
    p = with_default_performance(p, WHERE)
    choice(f"{WHERE}: method", method or "auto", ("auto", "direct", *METHODS))
    number(f"{WHERE}: loss", loss, at_least=0)
    budget = design_budget(WHERE, effort, time_limit)
    with one_thread():
        continuous = hinf_norm(p.close(full))
        if not np.isfinite(continuous.upper):
            raise NoTrustworthyNumber(WHERE, f"the continuous loop is not stable ({continuous.reason})")
        judged = with_antialiasing(p, antialiasing, WHERE)
        merged = merged_modes(judged.model, dt)
        corner = continuous.frequency if prewarp is None else prewarp
        warped = ["tustin-prewarp"] * bool(0 < continuous.frequency < 0.9 * np.pi / dt)
        names = ["tustin", *warped, "zoh", "foh", "direct"] if method in (None, "auto") else [str(method)]
        trials, best = list[SampledTrial](), None
        for name in names:
            enough = best is not None and relative_loss(best[2].upper, continuous.upper) <= loss
            if budget.over or (name == "direct" and enough):
                break
            try:
                if name == "direct":
                    most = MOST_DESIGN // max(judged.n_w, judged.n_z, 1)
                    lifted = lift(judged, float(dt), int(np.clip(most, 1, DESIGN_INTERVALS)), delay)
                    k = synthesize(lifted.generalized_plant(), "hinf", DESIGN_GAMMA_REL, budget).K
                    made = StateSpaceModel(k.A, k.B, k.C, k.D, dt, full.inputs, full.outputs)
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
                order, lower, upper, status = -1, np.inf, np.inf, Status.FAILED
                reason = "; ".join([error.line, *(merged if name == "direct" else ())])
            lost = relative_loss(upper, continuous.upper)
            trials.append(SampledTrial(name, order, lower, upper, lost, status, reason))
            if progress is not None:
                progress(f"{name}: {reason if order < 0 else f'sampled-data norm {upper:.6g}, {trials[-1].text}'}")
    if best is None:
        ended = f" ({budget.remark})" if budget.remark else ""
        outcomes = [f"{trial.method}: {trial.reason or 'not stable'}" for trial in trials]
        raise NoTrustworthyNumber(
            WHERE, f"no digital controller with dt = {dt:g} s left the sampled loop stable{ended}",
            hint="a shorter sample time", more=(*merged, *outcomes),
        )  # fmt: skip
    name, made, norm = best
    how = norm.reason or f"norm proved on {norm.n_intervals} intervals a period"
    reason = f"{name}: sampled loop rebuilt, {how}"
    if relative_loss(norm.upper, continuous.upper) > loss:
        reason += f"; no method tried keeps the loss to {100 * loss:g} %"
    status, reason = final_status(norm.status, [reason], budget, "one that loses less")
    return SampledController(
        K=made, gamma=norm.upper, closed_loop=norm.loop, status=status, reason=reason,
        limit=limiting_channels(norm.loop, norm.frequency), plant=p, method=f"sampled {name}", original=full,
        continuous_norm=continuous, norm=norm, allowed_loss=loss, trials=tuple(trials), delay=delay,
        antialiasing=antialiasing, pathological=merged, chosen=name,
    )  # fmt: skip
