"""`lpv_gain`: a proved bound of the induced L2 gain of an LPV model, for all trajectories of its parameters.

A solver computes P at the points of the grid (Wu, Yang, Packard, Becker 1996), and ball arithmetic proves it:
`robustlab.verification.parameters` has the theorem and its Bernstein coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.conic import bounded_real, equal_rows, least
from robustlab.display import Facts, number
from robustlab.errors import InputError, error_context
from robustlab.norms import PeakGain, balancing_units, hinf_norm
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.synthesis.scheduling.parameter_varying import EXACT, SAMPLED, LPVModel
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome

WORK = 4e8  # at effort 1, in the units of `robustlab.budget`
NEAR = 0.02  # relative distance of a loop from the LMIs' optimum that ends the search over back-offs
# Back-offs from the optimum of the LMIs at which the margin is maximised. Smaller: tighter bounds, more failed proofs.
GAIN_BACKOFFS = (1e-4, 1e-3, 1e-2, 0.1)
SMALLEST = 1e-5  # smallest scaled gain that is distinguishable from zero
GAIN_BISECTIONS = 5  # for the smallest gamma that a Lyapunov matrix proves
INEQUALITIES = 4000  # most inequalities of one problem
NOTHING = np.zeros((0, 0))  # P where nothing was proved
SIGNED = 3  # most deviating entries for which all signs are used: exact, but 2^n inequalities

Index = tuple[int, ...]
Lyapunov = Literal["constant", "varying"]


@dataclass(frozen=True, eq=False)
class LPVGain(PeakGain, Traced):
    r"""A bracket of the induced L2 gain over all trajectories of the parameters, and what proves it.

    Attributes
    ----------
    lower, at, frequency
        Largest H-infinity norm of the frozen models at the points, attained as parameters may be constant (infinite
        where one is not stable); where, and at which frequency in rad/s, or that of the unstable pole.
    upper
        Proved bound of the gain; infinite where none was found.
    P
        Lyapunov matrices at the points of the grid, shape (n_1, ..., n_k, n_x, n_x) with 1 along parameters on which
        they do not depend; empty where nothing was proved.
    lyapunov
        ``"constant"``: proved for trajectories of any rate; ``"varying"``: for those within the bounds of the rates.
    model
        The model, for verification.
    status
        CERTIFIED: proved in ball arithmetic from P and the model. CONVERGED: proved likewise, but the distance of the
        family from its interpolation was only sampled. INFEASIBLE: the frozen model at ``at`` is not stable, or by the
        solver no such Lyapunov function exists, which does not prove instability. INCONCLUSIVE: nothing was proved, or
        a pole is indistinguishable from the stability boundary.
    reason
        Method of the proof, or reason of its failure.
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
        """Parameter trajectories and models for which the bound holds."""
        if not self.P.size:
            return ""
        known = {
            EXACT: "certified between the grid points: the model is multi-linear there",
            SAMPLED: "certified between the grid points for the deviation at samples of the family",
        }.get(self.model.known, "certified between the grid points: the deviation there is proved and allowed for")
        names = [f"|d{p.name}/dt| <= {number(p.rate)}" for p in self.model.parameters if np.isfinite(p.rate)]
        free = self.lyapunov == "constant" or not names
        return f"{known}; {'any rate of change' if free else ', '.join(names)}"

    def recheck(self) -> bool:
        """Return whether ``P`` proves ``upper`` for ``model`` in ball arithmetic."""
        return bool(self.P.size) and holds(gain_claim(self.model, self.P, self.upper))

    def claims(self) -> list[Claim]:
        """Return the claim that the gain is at most ``upper``; none where the model was only sampled."""
        proved = self.status is Status.CERTIFIED and self.P.size and np.isfinite(self.upper)
        return [gain_claim(self.model, self.P, self.upper)] if proved else []

    def bounds(self) -> str:
        """Return the bracket with the origin of each side."""
        upper = f"{number(self.upper, digits=6)} (proved)" if np.isfinite(self.upper) else "no bound proved"
        return (
            self.unstable if np.isinf(self.lower) else f"{number(self.lower, digits=6)} (frozen, attained) .. {upper}"
        )

    def place(self) -> str:
        """Return the parameters and the frequency at which ``lower`` is attained."""
        values = ", ".join(f"{name} = {number(value)}" for name, value in self.at.items())
        return f"{values}, {number(self.frequency, 'rad/s')}" if np.isfinite(self.lower) else ""

    def evidence(self) -> Facts:
        """Return the scope and the method of the proof."""
        return [("holds", self.scope), ("Lyapunov function", self.lyapunov), ("how", self.reason)]

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "scope": self.scope}


@error_context("lpv_gain")
def lpv_gain(
    model: LPVModel,
    lyapunov: Lyapunov | None = None,
    *,
    effort: float = 1.0,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> LPVGain:
    r"""`robustlab.peak_gain` of an LPV model, by a Lyapunov function :math:`x^T P(\rho) x`."""
    if not model.inputs or not model.outputs:
        found = f"a model with {len(model.inputs)} inputs and {len(model.outputs)} outputs"
        raise InputError("lpv_gain", found, "at least one of each")
    if not model.n_states:
        hint = "without states it is the largest singular value of D at the points"
        raise InputError("lpv_gain", "a model without states", "one with states", hint)
    if lyapunov not in (None, "constant", "varying"):
        raise InputError("lpv_gain: lyapunov", f"{lyapunov!r}", "'constant' or 'varying'")
    budget = search_budget("lpv_gain", WORK, effort, time_limit)
    with one_thread():
        return gain_from(model, lyapunov, budget, progress or (lambda _: None))


def gain_from(
    model: LPVModel, lyapunov: Lyapunov | None, budget: Budget, say: Callable[[str], None], guess: Array | None = None
) -> LPVGain:
    """Compute `lpv_gain` on a budget; ``guess``: a constant P to scale the states of the LMIs."""
    # Without the guess no loop of the missile in docs/gain-scheduling.md is proved, with poles of 4e4 rad/s.
    varies = [lyapunov != "constant" and bool(np.isfinite(p.rate)) for p in model.parameters]
    lower, at, frequency, doubt = _frozen(model)

    def result(status: Status, reason: str, upper: float = np.inf, P: Array = NOTHING) -> LPVGain:
        P.setflags(write=False)
        return LPVGain(lower, upper, frequency, status, at, P, "varying" if any(varies) else "constant", model, reason)

    if doubt:
        return result(Status.INCONCLUSIVE if np.isfinite(lower) else Status.INFEASIBLE, doubt)
    count = int(np.prod([(size - 1) * (6 if v else 2) for size, v in zip(model.grid, varies, strict=True)]))
    if count > INEQUALITIES:
        expected, hint = f"at most {INEQUALITIES}", "fewer points, or lyapunov='constant'"
        raise InputError("lpv_gain", f"{count} inequalities", expected, hint)
    lmis = _GainLMIs(model, varies, lower, guess)
    start = max(lower, SMALLEST / lmis.z)
    found, text = _by_lmis(lmis, start, budget, say)
    if found is None:
        status = Status.INFEASIBLE if "says infeasible" in text else Status.INCONCLUSIVE
        return result(Status.TIMEOUT if budget.struck else status, f"no bound was proved: {text}")
    return result(Status.CONVERGED if model.known == SAMPLED else Status.CERTIFIED, text, *found)


def _frozen(model: LPVModel) -> tuple[float, dict[str, float], float, str]:
    """Return the largest norm of the models at the points, its place and frequency, and a model without a norm."""
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


def gain_claim(model: LPVModel, P: Array, gamma: float) -> Claim:
    """Return the claim that the gain of the model, deviation included, is at most ``gamma``."""
    return Claim("lpv-gain", {**model_numbers(model), "P": P, "gamma": np.array(gamma)})


def model_numbers(model: LPVModel) -> dict[str, Any]:
    """Return the grid, the matrices at its points, the rates, and any deviation between the points."""
    numbers = {f"points{i}": np.array(p.points) for i, p in enumerate(model.parameters)}
    numbers |= {"M": model.matrices, "n": np.array(model.n_states)}
    numbers["rate"] = np.array([p.rate for p in model.parameters])
    return {**numbers, "deviation": model.deviation} if model.deviation.any() else numbers


def holds(claim: Claim) -> bool:
    """Return whether ball arithmetic proves the claim."""
    return check(claim).outcome is Outcome.PROVED


def _smallest(model: LPVModel, P: Array, low: float) -> tuple[float, Array] | None:
    """Return the smallest level above ``low`` that P proves, and P; None where 100 times ``low`` is not proved."""
    if not np.isfinite(P).all():
        return None

    def proves(level: float) -> bool:
        return holds(gain_claim(model, P, level))

    high = next((low * f for f in (1.0001, 1.001, 1.01, 1.1, 2.0, 10.0, 100.0) if proves(low * f)), None)
    if high is None:
        return None
    for _ in range(GAIN_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if proves(middle) else (middle, high)
    return high, P


def _by_lmis(
    lmis: _GainLMIs, start: float, budget: Budget, say: Callable[[str], None]
) -> tuple[tuple[float, Array] | None, str]:
    """Return the smallest proved level and its P by the LMIs, or None, and the method or the reason of failure."""
    optimum, _, text = lmis.solve(None, budget)
    if optimum is None:
        return None, text
    say(f"LMIs: {len(lmis.inequalities)} inequalities, optimum {optimum:.6g}")
    start = max(optimum, start)
    for backoff in GAIN_BACKOFFS:
        _, P, text = lmis.solve(start * (1 + backoff), budget)
        found = None if P is None else _smallest(lmis.model, P, start)
        if found is not None:
            return found, f"LMIs; {len(lmis.inequalities)} inequalities, proved in ball arithmetic"
    return None, f"an optimum of {optimum:.6g} could not be proved ({text})"


class _GainLMIs:
    """The LMIs over whole cells, scaled and in states in which a guess of P is the identity."""

    def __init__(self, model: LPVModel, varies: list[bool], size: float, guess: Array | None) -> None:
        self.model, self.varies, n = model, varies, model.n_states
        middle = model.matrices[tuple(points // 2 for points in model.grid)]
        units, self.rate = balancing_units(model.model_of(middle))
        # Of the outputs, so that the gain is about one.
        self.z = 2.0 ** -round(float(np.log2(size))) if size > 0 else 1.0
        T = np.diag(units / np.sqrt(self.rate))
        if guess is not None and np.linalg.eigvalsh(guess)[0] > 0:
            T = np.linalg.inv(np.linalg.cholesky(guess * self.z * self.rate)).T
        # States x = T x', time in units of 1 / rate.
        self.back = np.linalg.inv(T)
        self.left, self.right = np.eye(len(middle)) * self.z, np.eye(middle.shape[1])
        self.left[:n, :n], self.right[:n, :n] = self.back / self.rate, T
        self.inequalities = _coefficients(model, varies)

    @property
    def shape(self) -> Index:
        """Shape of the stack of P: the grid along the parameters on which it depends, 1 along the others."""
        return tuple(size if v else 1 for size, v in zip(self.model.grid, self.varies, strict=True))

    def solve(self, level: float | None, budget: Budget) -> tuple[float | None, Array | None, str]:
        """Minimise the level (None), or maximise the margin of P at a level; return both, and the reason of failure."""
        import cvxpy as cp

        n = self.model.n_states
        P = {w: cp.Variable((n, n), symmetric=True) for w in np.ndindex(*self.shape)}
        ones = dict.fromkeys(P, np.eye(n))
        # A bound of P's size for the terms of the deviation.
        gamma, margin, size = (cp.Variable(nonneg=True) for _ in range(3))
        bound = gamma if level is None else level * self.z
        robust = any(rest.any() for *_, rest in self.inequalities)
        conditions = [margin <= 1, *(X >> 0 for X in P.values())]
        if robust or level is not None:
            conditions += [size * np.eye(n) - X >> 0 for X in P.values()]
        for pairs, slopes, shift, rest in self.inequalities:
            models = [(self.left @ (self.model.matrices[v] + shift) @ self.right, w) for v, w in pairs]
            out = np.mean([m[n:] for m, _ in models], axis=0)

            # L_c for P at its vertices.
            def lhs(P: Any, level: Any, models: Any = models, slopes: Any = slopes, out: Array = out) -> Any:
                top: Any = sum(P[w] @ m[:n] / len(models) for m, w in models)
                drift = top[:, :n] + top[:, :n].T + sum(f / self.rate * (P[a] - P[b]) for f, a, b in slopes)
                return bounded_real(cp.hstack([drift, top[:, n:]]), out[:, :n], out[:, n:], level)

            rest = np.abs(self.left) @ rest @ np.abs(self.right)
            parts = rest[:n, :n], rest[:n, n:], rest[n:, :n], rest[n:, n:]
            a, b, o, d = (float(np.linalg.norm(part, 2)) for part in parts)
            slack = (2 * a + b) * size + o + d if robust else 0.0
            # The margin of the inequality with equally scaled rows, as in the check.
            unit = np.diag(equal_rows(lhs(ones, 1.0).value))
            scaled = unit @ (lhs(P, bound) + slack * np.eye(len(unit))) @ unit
            conditions.append(-scaled - (0.0 if level is None else margin) * np.eye(len(unit)) >> 0)
        failed = least(gamma if level is None else 1e-6 * size - margin, conditions, budget)
        if failed:
            return None, None, failed
        found = np.array([X.value for X in P.values()]).reshape(*self.shape, n, n)
        found = self.back.T @ found @ self.back / (self.z * self.rate)
        level = float(np.asarray(gamma.value)) / self.z if level is None else level
        return level, 0.5 * (found + np.swapaxes(found, -1, -2)), ""


def _coefficients(model: LPVModel, varies: list[bool]) -> list[tuple[Any, Any, Array, Array]]:
    """Return every L_c, those shared by neighbouring cells once: pairs of vertices of the model and of P whose mean it
    is, differences of P with factors that give its derivative, and the deviation: with signs, and as a bound.
    """
    found: dict[Any, tuple[Any, Any, Array, Array]] = {}
    for cell in model.cells():
        rest = model.deviation[cell]
        places, shifts = np.argwhere(rest > 0), [np.zeros_like(rest)]
        if 0 < len(places) <= SIGNED:
            shifts = []
            for signs in product((1.0, -1.0), repeat=len(places)):
                shifts.append(np.zeros_like(rest))
                shifts[-1][tuple(places.T)] = signs * rest[tuple(places.T)]
            rest = np.zeros_like(rest)
        ends = [(1.0, -1.0) if v and p.rate else (0.0,) for v, p in zip(varies, model.parameters, strict=True)]
        for c in product(*((0, 1, 2) if v else (0, 2) for v in varies)):
            halves = list(product(*(((0, 1), (1, 0)) if x == 1 else ((x // 2, x // 2),) for x in c)))
            own = [tuple(i + a for i, (a, _) in zip(cell, bits, strict=True)) for bits in halves]
            of_P = [tuple((i + b) * v for i, (_, b), v in zip(cell, bits, varies, strict=True)) for bits in halves]
            for signs in product(*ends):
                slopes = []
                for k, (sign, i, p) in enumerate(zip(signs, cell, model.parameters, strict=True)):
                    factor = sign * p.rate / (p.points[i + 1] - p.points[i]) / len(halves) if sign else 0.0
                    slopes += [(factor, (*w[:k], i + 1, *w[k + 1 :]), (*w[:k], i, *w[k + 1 :])) for w in of_P if sign]
                for shift in shifts:
                    key = tuple(zip(own, of_P, strict=True)), tuple(slopes), shift.tobytes(), rest.tobytes()
                    found[key] = key[0], key[1], shift, rest
    return list(found.values())
