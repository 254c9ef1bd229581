"""`lpv_gain`: a proved bound of the induced L2 gain of an LPV model, for all trajectories of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, did_you_mean, told_as
from robustlab.norms import PeakGain, hinf_norm
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.shown import Facts, number
from robustlab.synthesis.scheduling.inequalities import equal_rows, least, value_of
from robustlab.synthesis.scheduling.lyapunov_inequality import Inequality
from robustlab.synthesis.scheduling.parameter_varying import EXACT, SAMPLED, LPVModel
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

# Work at effort 1, in the units of `robustlab.budget`.
WORK = 4e8
# Rounds in which states are balanced by what the LMIs gave in the last.
BALANCINGS = 8
# A loop this close (relative) to the LMIs' optimum ends the search over back-offs.
NEAR = 0.02
# Back-offs from the optimum of the LMIs at which the largest margin is looked for. Smaller: tighter bounds, more
# of which rounding leaves unproved.
GAIN_BACKOFFS = (1e-4, 1e-3, 1e-2, 0.1)
# Smallest scaled gain that is told from zero.
SMALLEST = 1e-5
# Bisections for the smallest gamma that a Lyapunov matrix still proves.
GAIN_BISECTIONS = 5
# Inequalities of one problem, at most: beyond it they outlast any patience.
INEQUALITIES = 4000

Lyapunov = Literal["constant", "varying"]


@dataclass(frozen=True, eq=False)
class LPVGain(PeakGain, Traced):
    r"""A bracket of the induced L2 gain over all trajectories of the parameters, and what proves it.

    Attributes
    ----------
    lower
        Largest H-infinity norm of a frozen model that was looked at; attained, because a parameter may stand still.
        Infinite where a frozen model is not stable.
    upper
        Proved bound of the gain; infinite where none was found.
    at
        Values of the parameters at ``lower``.
    frequency
        Frequency in rad/s at which that frozen model attains it; of its pole where it is not stable.
    P
        Lyapunov matrix, or those at the points of the grid, shape (n_1, ..., n_k, n_x, n_x) with 1 along a parameter
        with which it does not vary; empty where nothing was proved.
    lyapunov
        ``"constant"``: proved for trajectories of any rate; ``"varying"``: for those within the bounds of the rates.
    model
        The model that it is about, so that it can be checked again.
    status
        CERTIFIED: proved in ball arithmetic from P and the model. CONVERGED: proved likewise, but how far the
        family is from its interpolation was only sampled. INFEASIBLE: no such Lyapunov function,
        because the frozen model at ``at`` is not stable (``lower`` is infinite), or as the solver says, which proves no
        instability. INCONCLUSIVE: nothing was proved, or a pole cannot be told from the stability boundary.
    reason
        How it was found, and what it holds for.
    """

    frequency: float
    at: dict[str, float]
    P: Array
    lyapunov: str
    model: LPVModel
    reason: str

    unsaved: ClassVar[tuple[str, ...]] = ("model",)
    unstable: ClassVar[str] = "infinite: a frozen model is not stable"

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
        """Whether ``P`` still proves ``upper`` for ``model``, in ball arithmetic."""
        return bool(self.P.size) and holds(gain_claim(self.model, self.P, self.upper))

    def claims(self) -> list[Claim]:
        """That the gain is at most ``upper``; nothing where the model between the points was only sampled."""
        proved = self.status is Status.CERTIFIED and self.P.size and np.isfinite(self.upper)
        return [gain_claim(self.model, self.P, self.upper)] if proved else []

    def bounds(self) -> str:
        """The bracket, with what each side rests on."""
        if np.isinf(self.lower):
            return self.unstable
        upper = f"{number(self.upper, digits=6)} (proved)" if np.isfinite(self.upper) else "no bound proved"
        return f"{number(self.lower, digits=6)} (frozen, attained) .. {upper}"

    def place(self) -> str:
        """Which frozen model attains ``lower``, and where."""
        values = ", ".join(f"{name} = {number(value)}" for name, value in self.at.items())
        return f"{values}, {number(self.frequency, 'rad/s')}" if np.isfinite(self.lower) else ""

    def evidence(self) -> Facts:
        """What it holds for, and how it was proved."""
        return [("holds", self.scope), ("Lyapunov function", self.lyapunov), ("how", self.reason)]

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "scope": self.scope}


@told_as("lpv_gain")
def lpv_gain(
    model: Any,
    lyapunov: Lyapunov | None = None,
    *,
    effort: float = 1.0,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> LPVGain:
    r"""`robustlab.peak_gain` of an LPV model, by a Lyapunov function :math:`x^T P(\rho) x`."""
    if not isinstance(model, LPVModel):
        raise InputError("lpv_gain", f"a {type(model).__name__}", "an LPVModel", "rl.lpv_model makes one")
    if not model.inputs or not model.outputs:
        found = f"a model with {len(model.inputs)} inputs and {len(model.outputs)} outputs"
        raise InputError("lpv_gain", found, "at least one of each")
    if not model.n_states:
        hint = "without states it is the largest singular value of D at the points"
        raise InputError("lpv_gain", "a model without states", "one with states", hint)
    kinds = ("constant", "varying")
    if lyapunov is not None and lyapunov not in kinds:
        raise InputError(
            "lpv_gain: lyapunov", f"{lyapunov!r}", "'constant' or 'varying'", did_you_mean(lyapunov, kinds)
        )
    budget = search_budget("lpv_gain", WORK, effort, time_limit)
    with one_thread():
        return gain_from(model, lyapunov, budget, progress or (lambda _: None))


def gain_from(
    model: LPVModel, lyapunov: Lyapunov | None, budget: Budget, say: Callable[[str], None], guess: Array | None = None
) -> LPVGain:
    """`lpv_gain` on a budget; ``guess`` is a constant P to try first, and in whose states the LMIs are posed."""
    bounded = any(np.isfinite(p.rate) for p in model.parameters)
    varying = bounded if lyapunov is None else lyapunov == "varying" and bounded
    lower, at, frequency, doubt = _frozen(model)
    word = "varying" if varying else "constant"

    def told(upper: float, P: Array, status: Status, reason: str) -> LPVGain:
        return LPVGain(lower, upper, frequency, status, at, P, word, model, reason)

    nothing = np.zeros((0, 0))
    if doubt:
        return told(np.inf, nothing, Status.INCONCLUSIVE if np.isfinite(lower) else Status.INFEASIBLE, doubt)
    posed = Inequality(model, varying, lower)
    if posed.count() > INEQUALITIES:
        found = f"{posed.count()} inequalities"
        raise InputError("lpv_gain", found, f"at most {INEQUALITIES}", "fewer points, or lyapunov='constant'")
    say(f"{len(posed.coefficients)} inequalities of size {sum(model.matrices.shape[-2:]) - posed.n}")
    best, how = None, "by the Lyapunov matrix of the synthesis"
    basis = np.eye(posed.n)
    if guess is not None:
        scaled = posed.scaled(0.5 * (guess + guess.T))
        basis = _basis(scaled, basis)
        P = np.array(np.broadcast_to(scaled, (*posed.shape, *scaled.shape)))
        level = _smallest(posed, P, max(lower * posed.gain, SMALLEST))
        best = None if level is None else (level, P)
    # Only where that is far from the frozen norms is the solver worth its time.
    if best is None or best[0] > (1 + NEAR) * lower * posed.gain:
        solved, text = _solved(posed, basis, lower, budget, say)
        if solved is not None and (best is None or solved[0] < best[0]):
            best, how = solved, text
        elif best is None:
            status = Status.INFEASIBLE if "says infeasible" in text else Status.INCONCLUSIVE
            return told(np.inf, nothing, Status.TIMEOUT if budget.struck else status, f"no bound was proved: {text}")
    gamma, P = best
    status = Status.CONVERGED if model.known == SAMPLED else Status.CERTIFIED
    made = told(gamma / posed.gain, posed.as_given(P), status, how)
    made.P.setflags(write=False)
    return made


def _frozen(model: LPVModel) -> tuple[float, dict[str, float], float, str]:
    """Largest attained norm of the models at the points, where, at which frequency; and the member without a norm."""
    lower, at, frequency, doubt = 0.0, {}, float("nan"), ""
    for values, one in model.nodes():
        norm = hinf_norm(one)
        if not np.isfinite(norm.upper):
            place = ", ".join(f"{name} = {number(value)}" for name, value in values.items())
            doubt = f"the frozen model at {place}: {norm.reason}"
            if np.isinf(norm.lower):
                poles = one.poles()
                return np.inf, values, abs(float(poles[np.argmax(poles.real)].imag)), f"{doubt}, and no bound exists"
        if norm.lower >= lower:
            lower, at, frequency = norm.lower, values, norm.frequency
    return lower, at, frequency, doubt


def _basis(P: Array, before: Array) -> Array:
    """T with ``T^T P T = I``; the one before where P is not positive definite."""
    try:
        return np.linalg.inv(np.linalg.cholesky(P)).T
    except np.linalg.LinAlgError:
        return before


def _smallest(posed: Inequality, P: Array, low: float) -> float | None:
    """The smallest level that P proves, from just above ``low`` on; None where not even a hundred times it is."""
    given = posed.as_given(P)

    def proves(level: float) -> bool:
        return holds(gain_claim(posed.given, given, level / posed.gain))

    if not (np.isfinite(given).all() and np.array_equal(given, np.swapaxes(given, -1, -2))):
        return None
    high = next((low * f for f in (1.0001, 1.001, 1.01, 1.1, 2.0, 10.0, 100.0) if proves(low * f)), None)
    if high is None:
        return None
    for _ in range(GAIN_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if proves(middle) else (middle, high)
    return high


def gain_claim(model: LPVModel, P: Array, gamma: float) -> Claim:
    """That the gain of the model, what it deviates included, is at most ``gamma``."""
    return Claim("lpv-gain", {**model_numbers(model), "P": P, "gamma": np.array(gamma)})


def model_numbers(model: LPVModel) -> dict[str, Any]:
    """Grid, matrices at its points, rates, and the deviation between them where there is any."""
    numbers = {f"points{i}": np.array(p.points) for i, p in enumerate(model.parameters)}
    numbers |= {"M": model.matrices, "n": np.array(model.n_states)}
    numbers["rate"] = np.array([p.rate for p in model.parameters])
    return {**numbers, "deviation": model.deviation} if model.deviation.any() else numbers


def holds(claim: Claim) -> bool:
    """Whether ball arithmetic proves it."""
    return check(claim).outcome is Outcome.PROVED


def _solved(
    posed: Inequality, basis: Array, lower: float, budget: Budget, say: Callable[[str], None]
) -> tuple[tuple[float, Array] | None, str]:
    """Smallest proved level and its P by the LMIs, or None and why."""
    best, last, text = None, np.inf, ""
    for _ in range(BALANCINGS):
        turned = posed.turned(basis)
        gamma, _, text = _posed(turned, None, budget)
        if gamma is None:
            break
        say(f"LMIs: optimum {gamma / posed.gain:.6g}")
        start, found = max(gamma, lower * posed.gain, SMALLEST), None
        for backoff in GAIN_BACKOFFS:
            level = start * (1 + backoff)
            _, found, text = _posed(turned, level, budget)
            if found is None:
                continue
            back = np.linalg.inv(basis)
            P = back.T @ found @ back
            P = 0.5 * (P + np.swapaxes(P, -1, -2))
            smallest = _smallest(posed, P, start)
            if smallest is not None:
                if best is None or smallest < best[0]:
                    best = smallest, P
                break
        if gamma > last * (1 - 0.5 * NEAR) or posed.n == 1 or start <= lower * posed.gain * (1 + NEAR):
            break
        if found is None:
            break
        last, basis = gamma, basis @ _basis(found[tuple(size // 2 for size in posed.shape)], np.eye(posed.n))
    if best is None:
        return None, text if last == np.inf else f"an optimum of {last / posed.gain:.6g} could not be proved ({text})"
    return best, f"LMIs; {len(posed.coefficients)} inequalities, proved in ball arithmetic"


def _posed(posed: Inequality, level: float | None, budget: Budget) -> tuple[float | None, Array | None, str]:
    """Smallest level (None), or P of the largest margin at a level, from the solver; unchecked."""
    import cvxpy as cp

    n, vertices = posed.n, list(np.ndindex(*posed.shape))
    P = {w: cp.Variable((n, n), symmetric=True) for w in vertices}
    # A bound of P's size, with which the model's deviation counts.
    gamma, margin, size = (cp.Variable(nonneg=True) for _ in range(3))
    robust = any(c.deviation.any() for c in posed.coefficients)
    conditions = [margin <= 1, *(X >> 0 for X in P.values())]
    if robust or level is not None:
        conditions += [size * np.eye(n) - X >> 0 for X in P.values()]
    for c in posed.coefficients:
        a, b, o, d = _norms(c.deviation, n)
        slack = (2 * a + b) * size + o + d if robust else 0.0
        # The margin is that of the inequality in rows of one size, as it counts in the check.
        unit = equal_rows(posed.sizes(c))
        held, eye = posed.matrix(c, P, gamma if level is None else level), np.eye(len(unit))
        scaled = np.diag(unit) @ (held + slack * eye) @ np.diag(unit)
        conditions.append(-scaled - (0.0 if level is None else margin) * eye >> 0)
    failed = least(gamma if level is None else 1e-6 * size - margin, conditions, budget)
    if failed:
        return None, None, failed
    found = np.array([value_of(P[w]) for w in vertices]).reshape(*posed.shape, n, n)
    return float(value_of(gamma)) if level is None else level, found, ""


def _norms(deviation: Array, n: int) -> tuple[float, float, float, float]:
    """2-norms of the bounds for A, B, C and D."""
    parts = deviation[:n, :n], deviation[:n, n:], deviation[n:, :n], deviation[n:, n:]
    a, b, c, d = (float(np.linalg.norm(part, 2)) if part.size else 0.0 for part in parts)
    return a, b, c, d
