"""`lpv_gain`: a proved bound of the induced L2 gain of an LPV model, for all trajectories of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, did_you_mean, told_as
from robustlab.norms import hinf_norm
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.synthesis.hinf.lmi_synthesis import solve_conic
from robustlab.synthesis.scheduling.lpv_model import EXACT, SAMPLED, LPVModel
from robustlab.synthesis.scheduling.lyapunov_inequality import Inequality
from robustlab.synthesis.scheduling.tuning import TUNING, SchedulingTuning

__all__ = ["LPVGain", "gain_from", "lpv_gain"]

Lyapunov = Literal["constant", "varying"]


@dataclass(frozen=True, eq=False)
class LPVGain(Shown, Traced):
    r"""A bracket of the induced L2 gain over all trajectories of the parameters, and what proves it.

    Attributes
    ----------
    lower
        Largest H-infinity norm of a frozen model that was looked at; attained, because a parameter may stand still.
    upper
        Proved bound of the gain; infinite where none was found.
    at
        Values of the parameters at ``lower``.
    frequency
        Frequency in rad/s at which that frozen model attains it.
    P
        Lyapunov matrix, or those at the points of the grid, shape (n_1, ..., n_k, n_x, n_x) with 1 along a parameter
        with which it does not vary; empty where nothing was proved.
    lyapunov
        ``"constant"``: proved for trajectories of any rate; ``"varying"``: for those within the bounds of the rates.
    model
        The model that it is about, so that it can be checked again.
    status
        CERTIFIED: every inequality was checked from P and the model outside of the solver. CONVERGED: checked likewise,
        but how far the family is from its interpolation was only sampled. INFEASIBLE: no such Lyapunov function, as the
        solver says, which proves no instability.
    reason
        How it was found, and what it holds for.
    """

    lower: float
    upper: float
    at: dict[str, float]
    frequency: float
    P: Array
    lyapunov: str
    model: LPVModel
    status: Status
    reason: str

    @property
    def scope(self) -> str:
        """What the bound holds for."""
        if not self.P.size:
            return ""
        known = {
            EXACT: "certified between the grid points: the model is multi-linear there",
            SAMPLED: "certified between the grid points for what samples saw of the family there",
        }.get(self.model.known, "certified between the grid points: the deviation there is proved and allowed for")
        names = [f"|d{p.name}/dt| <= {number(p.rate)}" for p in self.model.parameters if np.isfinite(p.rate)]
        free = self.lyapunov == "constant" or not names
        return f"{known}; {'any rate of change' if free else ', '.join(names)}"

    def recheck(self) -> bool:
        """Whether ``P`` still proves ``upper`` for ``model``; no solver is asked."""
        if not self.P.size:
            return False
        posed = Inequality(self.model, self.lyapunov == "varying")
        return posed.proves(posed.scaled(self.P), self.upper * posed.gain)

    def facts(self) -> Facts:
        """The bracket, where it is attained, what it holds for."""
        place = ", ".join(f"{name} = {number(value)}" for name, value in self.at.items())
        return [
            ("gain", f"{number(self.lower, digits=6)} (frozen, attained) .. {number(self.upper, digits=6)} (proved)"),
            ("attained at", f"{place}, {number(self.frequency, 'rad/s')}" if place else ""),
            ("holds", self.scope),
            ("Lyapunov function", self.lyapunov),
            ("how", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        """All but the model."""
        return {name: value for name, value in vars(self).items() if name not in ("model", "provenance")} | {
            "scope": self.scope
        }


@told_as("lpv_gain")
def lpv_gain(
    model: Any,
    lyapunov: Lyapunov | None = None,
    *,
    effort: float = 1.0,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> LPVGain:
    r"""Bound of the induced L2 gain of an LPV model over all admissible trajectories of its parameters.

    .. math:: \sup_{\rho(\cdot)} \sup_{w \ne 0} \frac{\|z\|_2}{\|w\|_2} \le \gamma

    by a Lyapunov function :math:`x^T P(\rho) x` and the inequality of
    `robustlab.synthesis.scheduling.lyapunov_inequality`, imposed on the Bernstein coefficients of every cell: it holds
    between the grid points because it is a convex combination of them there. A family that is not multi-linear is
    allowed for by the model's ``deviation``.

    Parameters
    ----------
    model
        `LPVModel`, from w to z.
    lyapunov
        ``"constant"``: one P, for parameters of any rate. ``"varying"``: P multi-linear on the model's grid along the
        parameters whose rates are bounded; `LPVModel.refined` gives it more freedom. Where left out: varying where a
        rate is bounded.
    effort
        Multiple of the usual work.
    time_limit
        Guard in s; where it strikes the answer is not repeatable.
    progress
        Called with one short line after every stage.

    Returns
    -------
    LPVGain
        ``upper`` is infinite where nothing could be proved: ``status`` and ``reason`` say why.

    Raises
    ------
    InputError
        Not an LPV model, an unknown ``lyapunov``, more inequalities than can be solved.

    References
    ----------
    Becker, Packard 1994; Wu, Yang, Packard, Becker 1996; Apkarian, Tuan 2000 (relaxations by coefficients); Rump 2006
    (definiteness with rounding errors).

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> slow, fast = (StateSpaceModel([[-a]], [[a]], [[1.0]], [[0.0]]) for a in (1.0, 4.0))
    >>> found = lpv_gain(LPVModel({"a": [1.0, 4.0]}, [slow, fast]))
    >>> found.status.value, round(found.lower, 3), round(found.upper, 3)
    ('certified', 1.0, 1.25)
    """
    if not isinstance(model, LPVModel):
        raise InputError("lpv_gain", f"a {type(model).__name__}", "an LPVModel", "rl.lpv_model makes one")
    kinds = ("constant", "varying")
    if lyapunov is not None and lyapunov not in kinds:
        raise InputError("lpv_gain: lyapunov", f"{lyapunov!r}", "'constant' or 'varying'", did_you_mean(lyapunov, kinds))
    budget = search_budget("lpv_gain", TUNING.work, effort, time_limit)
    with one_thread():
        return gain_from(model, lyapunov, budget, progress or (lambda _: None))


def gain_from(
    model: LPVModel,
    lyapunov: Lyapunov | None,
    budget: Budget,
    say: Callable[[str], None],
    guesses: Sequence[Array] = (),
    tuning: SchedulingTuning = TUNING,
) -> LPVGain:
    """`lpv_gain` on a budget; ``guesses`` are constant Lyapunov matrices to try before a solver is asked."""
    bounded = any(np.isfinite(p.rate) for p in model.parameters)
    varying = bounded if lyapunov is None else lyapunov == "varying" and bounded
    lower, at, frequency, unstable = _frozen(model)
    word = "varying" if varying else "constant"

    def told(upper: float, P: Array, status: Status, reason: str) -> LPVGain:
        return LPVGain(lower, upper, at, frequency, P, word, model, status, reason)

    nothing = np.zeros((0, 0))
    if unstable:
        return told(np.inf, nothing, Status.CERTIFIED, "a frozen model is not stable: the gain is infinite")
    posed = Inequality(model, varying)
    if posed.count() > tuning.inequalities:
        found = f"{posed.count()} inequalities"
        raise InputError("lpv_gain", found, f"at most {tuning.inequalities}", "fewer points, or lyapunov='constant'")
    if not model.n_states:
        posed = Inequality(model, False)
    say(f"{len(posed.coefficients)} inequalities of size {posed.n + sum(posed.blocks(posed.coefficients[0], _one(posed))[3].shape)}")
    best, how = _from_guesses(posed, guesses, lower, tuning), "by the Lyapunov matrix of the synthesis"
    # A guess is what the LMIs start from; only where it is far from the frozen norms is the solver worth its time.
    if best is None or best[0] > (1 + tuning.near) * lower * posed.gain:
        solved, text = _solved(posed, lower, budget, say, tuning)
        if solved is not None and (best is None or solved[0] < best[0]):
            best, how = solved, text
        elif best is None:
            status = Status.INFEASIBLE if "infeasible" in text else Status.INCONCLUSIVE
            return told(np.inf, nothing, Status.TIMEOUT if budget.struck else status, f"no bound was proved: {text}")
    gamma, P = best
    status = Status.CONVERGED if model.known == SAMPLED else Status.CERTIFIED
    made = told(gamma / posed.gain, posed.as_given(P), status, how)
    made.P.setflags(write=False)
    return made


def _one(posed: Inequality) -> Array:
    return np.broadcast_to(np.eye(posed.n), (*posed.shape, posed.n, posed.n))


def _frozen(model: LPVModel) -> tuple[float, dict[str, float], float, bool]:
    """Largest attained norm of the models at the points, where, at which frequency, and whether one is unstable."""
    lower, at, frequency = 0.0, {}, float("nan")
    for values, one in model.nodes():
        norm = hinf_norm(one)
        if not np.isfinite(norm.upper):
            return np.inf, values, norm.frequency, True
        if norm.lower >= lower:
            lower, at, frequency = norm.lower, values, norm.frequency
    return lower, at, frequency, False


def _from_guesses(
    posed: Inequality, guesses: Sequence[Array], lower: float, tuning: SchedulingTuning
) -> tuple[float, Array] | None:
    """The smallest level (scaled) that a guessed P proves, by bisection; None where none does."""
    found = None
    for guess in guesses:
        P = np.array(np.broadcast_to(posed.scaled(0.5 * (guess + guess.T)), (*posed.shape, posed.n, posed.n)))
        level = _smallest(posed, P, max(lower, 1e-12) * posed.gain, tuning)
        if level is not None and (found is None or level < found[0]):
            found = level, P
    return found


def _smallest(posed: Inequality, P: Array, low: float, tuning: SchedulingTuning) -> float | None:
    """The smallest level that P proves, from just above ``low`` on; None where not even a hundred times it is."""
    high = next((low * f for f in (1.0001, 1.001, 1.01, 1.1, 2.0, 10.0, 100.0) if posed.proves(P, low * f)), None)
    if high is None:
        return None
    for _ in range(tuning.gain_bisections):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if posed.proves(P, middle) else (middle, high)
    return high


def _solved(
    posed: Inequality, lower: float, budget: Budget, say: Callable[[str], None], tuning: SchedulingTuning
) -> tuple[tuple[float, Array] | None, str]:
    """Smallest proved level and its P by the LMIs, or None and why."""
    gamma, _, text = _posed(posed, None, budget)
    if gamma is None:
        return None, text
    say(f"LMIs: optimum {gamma / posed.gain:.6g}")
    start = max(gamma, lower * posed.gain)
    for backoff in tuning.gain_backoffs:
        level = start * (1 + backoff)
        _, P, text = _posed(posed, level, budget)
        if P is not None and posed.proves(P, level * (1 + 1e-9)):
            smallest = _smallest(posed, P, start, tuning)
            say(f"proved at {level / posed.gain:.6g}")
            told = f"LMIs with optimum {gamma / posed.gain:.6g}; {len(posed.coefficients)} inequalities checked outside"
            return (smallest or level * (1 + 1e-9), P), f"{told} of the solver"
    return None, f"the LMIs' optimum {gamma / posed.gain:.6g} could not be proved outside of the solver ({text})"


def _posed(posed: Inequality, level: float | None, budget: Budget) -> tuple[float | None, Array | None, str]:
    """Smallest level (None), or P of the largest margin at a level, from the solver; unchecked."""
    import cvxpy as cp

    n = posed.n
    P = {w: cp.Variable((n, n), symmetric=True) for w in np.ndindex(*posed.shape)}
    gamma: Any = cp.Variable() if level is None else level
    margin, size = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    constraints: list[Any] = [p >> 0 for p in P.values()] + [margin <= 1]
    if any(c.deviation.any() for c in posed.coefficients) or level is not None:
        constraints += [size * np.eye(n) - p >> 0 for p in P.values()]
    for c in posed.coefficients:
        top, into, out, direct = posed.blocks(c, P)
        n_w, n_z = into.shape[1], len(out)
        L = cp.bmat([[top, into, out.T], [into.T, -gamma * np.eye(n_w), direct.T], [out, direct, -gamma * np.eye(n_z)]])
        parts = (c.deviation[:n, :n], c.deviation[:n, n:], c.deviation[n:, :n], c.deviation[n:, n:])
        a, b, o, d = (float(np.linalg.norm(part, 2)) if part.size else 0.0 for part in parts)
        slack = size * (2 * a + b) + (o + d) if a + b + o + d > 0 else 0.0
        shift = np.diag(np.append(np.ones(n), np.zeros(n_w + n_z)))
        constraints.append(0.5 * (L + L.T) + margin * shift + slack * np.eye(n + n_w + n_z) << 0)
    goal = cp.Minimize(gamma) if level is None else cp.Maximize(margin - 1e-6 * size)
    unknowns = len(P) * n * (n + 1) / 2
    work = 2000 + 2e-4 * unknowns**2 * len(posed.coefficients) * n
    outcome = solve_conic(cp.Problem(goal, constraints), budget, work)
    values = [p.value for p in P.values()]
    if not outcome.usable or any(v is None for v in values):
        return None, None, outcome.text
    stack = np.array([0.5 * (v + v.T) for v in values]).reshape(*posed.shape, n, n)
    return (float(gamma.value) if level is None else level), stack, outcome.text
