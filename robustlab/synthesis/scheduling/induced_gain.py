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
# Shares above the smallest level at which P is proved, the first that holds.
LEVELS = (1.5e-5, 5e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 9.0, 99.0)
INEQUALITIES = 4000  # most inequalities of one problem
SIGNED = 3  # most deviating entries for which all signs are used: exact, but 2^n inequalities
NOTHING = np.zeros((0, 0))  # P where nothing was proved

Index = tuple[int, ...]
Lyapunov = Literal["constant", "varying"]


@dataclass(frozen=True, eq=False)
class LPVGain(PeakGain, Traced):
    """A bracket of the induced L2 gain over all trajectories of the parameters, and what proves it.

    ``lower`` is the largest H-infinity norm of the frozen models at the points, attained as parameters may be constant;
    ``upper`` the proved bound, infinite where none was found. CERTIFIED: proved in ball arithmetic from P and model.
    CONVERGED: likewise, but the distance of the family from its interpolation was only sampled. INFEASIBLE: the frozen
    model at ``at`` is not stable, or by the solver no such Lyapunov function exists, which does not prove instability.
    INCONCLUSIVE: nothing was proved, or a pole is indistinguishable from the stability boundary.
    """

    frequency: float  # in rad/s, at which `lower` is attained, or that of the unstable pole
    at: dict[str, float]  # the parameters there
    # Lyapunov matrices at the points, shape (n_1, ..., n_k, n_x, n_x) with 1 along parameters on which they do not
    # depend; empty where nothing was proved
    P: Array
    lyapunov: str  # "constant": proved for any rate; "varying": for those within the bounds of the rates
    model: LPVModel
    reason: str  # method of the proof, or reason of its failure

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
        frozen = f"{number(self.lower, digits=6)} (frozen, attained)"
        return self.unstable if np.isinf(self.lower) else f"{frozen} .. {upper}"

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
    solve, count, unit = _lmis(model, varies, lower, guess, budget)
    optimum, _, text = solve(None)
    if optimum is not None:
        say(f"LMIs: {count} inequalities, optimum {optimum:.6g}")
        start = max(optimum, lower, SMALLEST / unit)
        for backoff in GAIN_BACKOFFS:
            _, P, text = solve(start * (1 + backoff))
            if P is None or not np.isfinite(P).all():
                continue
            levels = (start * (1 + share) for share in LEVELS)
            upper = next((level for level in levels if holds(gain_claim(model, P, level))), None)
            if upper is not None:
                status = Status.CONVERGED if model.known == SAMPLED else Status.CERTIFIED
                return result(status, f"LMIs; {count} inequalities, proved in ball arithmetic", upper, P)
        text = f"an optimum of {optimum:.6g} could not be proved ({text})"
    status = Status.INFEASIBLE if "says infeasible" in text else Status.INCONCLUSIVE
    return result(Status.TIMEOUT if budget.struck else status, f"no bound was proved: {text}")


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


def _lmis(
    model: LPVModel, varies: list[bool], size: float, guess: Array | None, budget: Budget
) -> tuple[Callable[[float | None], tuple[float | None, Any, str]], int, float]:
    """Return the solver of the LMIs over whole cells, the number of inequalities, and the unit of the outputs.

    The solver minimises the level (None), or maximises the margin of P at a level, and returns both and the reason of a
    failure. It works in states in which a guess of P is the identity.
    """
    import cvxpy as cp

    n = model.n_states
    middle = model.matrices[tuple(points // 2 for points in model.grid)]
    units, rate = balancing_units(model.model_of(middle))
    z = 2.0 ** -round(float(np.log2(size))) if size > 0 else 1.0  # of the outputs, so that the gain is about one
    T = np.diag(units / np.sqrt(rate))
    if guess is not None and np.linalg.eigvalsh(guess)[0] > 0:
        T = np.linalg.inv(np.linalg.cholesky(guess * z * rate)).T
    # States x = T x', time in units of 1 / rate.
    back = np.linalg.inv(T)
    left, right = np.eye(len(middle)) * z, np.eye(middle.shape[1])
    left[:n, :n], right[:n, :n] = back / rate, T
    inequalities = _coefficients(model, varies)
    # P at the grid along the parameters on which it depends.
    shape = tuple(points if v else 1 for points, v in zip(model.grid, varies, strict=True))
    P = {w: cp.Variable((n, n), symmetric=True) for w in np.ndindex(*shape)}
    ones = dict.fromkeys(P, np.eye(n))

    def solve(level: float | None) -> tuple[float | None, Any, str]:
        gamma, margin, size = (cp.Variable(nonneg=True) for _ in range(3))
        bound = gamma if level is None else level * z
        conditions = [margin <= 1, *(X >> 0 for X in P.values())]
        if level is not None or any(rest.any() for *_, rest in inequalities):
            conditions += [size * np.eye(n) - X >> 0 for X in P.values()]
        for pairs, slopes, shift, rest in inequalities:
            models = [(left @ (model.matrices[v] + shift) @ right, w) for v, w in pairs]
            out = np.mean([m[n:] for m, _ in models], axis=0)

            # L_c for P at its vertices.
            def lhs(P: Any, level: Any, models: Any = models, slopes: Any = slopes, out: Array = out) -> Any:
                top: Any = sum(P[w] @ m[:n] / len(models) for m, w in models)
                drift = top[:, :n] + top[:, :n].T + sum(f / rate * (P[a] - P[b]) for f, a, b in slopes)
                return bounded_real(cp.hstack([drift, top[:, n:]]), out[:, :n], out[:, n:], level)

            # The terms of the deviation, for a P of at most this size.
            rest = np.abs(left) @ rest @ np.abs(right)
            parts = rest[:n, :n], rest[:n, n:], rest[n:, :n], rest[n:, n:]
            a, b, o, d = (float(np.linalg.norm(part, 2)) for part in parts)
            # The margin of the inequality with equally scaled rows, as in the check.
            unit = np.diag(equal_rows(lhs(ones, 1.0).value))
            scaled = unit @ (lhs(P, bound) + ((2 * a + b) * size + o + d) * np.eye(len(unit))) @ unit
            conditions.append(-scaled - (0.0 if level is None else margin) * np.eye(len(unit)) >> 0)
        failed = least(gamma if level is None else 1e-6 * size - margin, conditions, budget)
        if failed:
            return None, None, failed
        found = np.array([X.value for X in P.values()]).reshape(*shape, n, n)
        found = back.T @ found @ back / (z * rate)
        level = float(np.asarray(gamma.value)) / z if level is None else level
        return level, 0.5 * (found + np.swapaxes(found, -1, -2)), ""

    return solve, len(inequalities), z


def _coefficients(model: LPVModel, varies: list[bool]) -> list[tuple[Any, Any, Array, Array]]:
    """Return every L_c, those shared by neighbouring cells once: pairs of vertices of the model and of P whose mean it
    is, differences of P with factors that give its derivative, and the deviation: with signs, and as a bound.
    """
    found: dict[Any, tuple[Any, Any, Any, Any]] = {}
    for cell in model.cells():
        rest = model.deviation[cell]
        places = np.flatnonzero(rest) if np.count_nonzero(rest) <= SIGNED else np.zeros(0, int)
        corners = np.array(list(product((1.0, -1.0), repeat=len(places)))) * rest.ravel()[places]
        shifts = np.zeros((len(corners), *rest.shape))
        shifts.reshape(len(corners), -1)[:, places] = corners
        rest = 0.0 * rest if len(places) else rest
        ends = [(1.0, -1.0) if v and p.rate else (0.0,) for v, p in zip(varies, model.parameters, strict=True)]
        for c in product(*((0, 1, 2) if v else (0, 2) for v in varies)):
            halves = list(product(*(((0, 1), (1, 0)) if x == 1 else ((x // 2, x // 2),) for x in c)))
            own = [tuple(i + a for i, (a, _) in zip(cell, bits, strict=True)) for bits in halves]
            of_P = [tuple((i + b) * v for i, (_, b), v in zip(cell, bits, varies, strict=True)) for bits in halves]
            pairs = tuple(zip(own, of_P, strict=True))
            for signs in product(*ends):
                slopes: list[tuple[float, Index, Index]] = []
                for k, (sign, i, p) in enumerate(zip(signs, cell, model.parameters, strict=True)):
                    factor = sign * p.rate / (p.points[i + 1] - p.points[i]) / len(halves) if sign else 0.0
                    slopes += [(factor, (*w[:k], i + 1, *w[k + 1 :]), (*w[:k], i, *w[k + 1 :])) for w in of_P if sign]
                for shift in shifts:
                    found[pairs, tuple(slopes), shift.tobytes(), rest.tobytes()] = pairs, slopes, shift, rest
    return list(found.values())
