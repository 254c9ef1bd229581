"""Gain scheduling: proved bounds of the induced L2 gain of an LPV model, and scheduled H-infinity controllers.

`lpv_gain`: a solver computes P at the points of the grid (Wu, Yang, Packard, Becker 1996), and ball arithmetic proves
it; `robustlab.verification.parameters` has the theorem. `scheduled_hinf`: projection LMIs with shared R and S give a
controller for each point (Apkarian, Gahinet, Becker 1995); the loop rebuilt from it is proved by `lpv_gain`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.checks import whole
from robustlab.conic import bounded_real, equal_rows, least
from robustlab.display import Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.matrices import balancing_factors
from robustlab.norms import PeakGain, balancing_units, hinf_norm
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import Signal
from robustlab.synthesis.hinf.two_riccati import TwoRiccatiProblem
from robustlab.synthesis.problem.design import Design
from robustlab.synthesis.problem.generalized_plant import PlantMatrices, Realisation, Scaling, dual, paths_first
from robustlab.synthesis.scheduling.parameter_varying import EXACT, KNOWN, PROVED, SAMPLED, LPVController, LPVModel
from robustlab.synthesis.structures.controller_structures import unpacked
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
    derived: ClassVar[tuple[str, ...]] = ("scope",)
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
        upper = f"{number(self.upper, digits=6)} (proved)" if np.isfinite(self.upper) else "no bound proved"
        frozen = f"{number(self.lower, digits=6)} (frozen, attained)"
        return self.unstable if np.isinf(self.lower) else f"{frozen} .. {upper}"

    def place(self) -> str:
        """Return the parameters and the frequency at which ``lower`` is attained."""
        values = ", ".join(f"{name} = {number(value)}" for name, value in self.at.items())
        return f"{values}, {number(self.frequency, 'rad/s')}" if np.isfinite(self.lower) else ""

    def evidence(self) -> Facts:
        return [("holds", self.scope), ("Lyapunov function", self.lyapunov), ("how", self.reason)]


@error_context("lpv_gain")
def lpv_gain(
    model: LPVModel, lyapunov: Lyapunov | None = None, effort: float = 1.0, time_limit: float | None = None
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
        return gain_from(model, lyapunov, budget, lambda _: None)


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
    """Return the solver of the LMIs over whole cells, the number of inequalities, and the unit of the outputs."""
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


BALANCINGS = 8  # rounds in which states are balanced by the last R and S
SYNTHESIS_BACKOFFS = (0.005, 0.02, 0.1, 0.3)  # larger: better conditioned controllers, worse gamma
# Couplings t of [R tI; tI S] >= 0; another one depends on the back-off. Larger: better conditioned, sooner infeasible.
# With 1.05 alone no loop of the spinning disks is proved.
COUPLINGS = (1.5, 1.05)
LARGEST = 1e5  # bound of the eigenvalues of R and S in the solver: without it many optima are not attained
NULL = 1e-10  # relative tolerance of singular values of a null space
# Sizes of channels added to the frozen plant whose Riccati equations give the first states, and the largest increase
# of its smallest gamma that they may cause. The largest size gives others, taken where the optimum is by that factor
# smaller: with it alone the disks end at 1.20 instead of 1.15, without it the missile at 1.9 instead of 0.16.
ADDED = tuple(10.0 ** (-0.5 * k) for k in range(17))
COST = 30.0
CLEAR = 0.8


@dataclass(frozen=True, eq=False, kw_only=True)
class LPVSynthesis(Design):
    """A scheduled controller whose loop was rebuilt from plant and controller, with the proved bound ``gamma``."""

    quantities: ClassVar[Mapping[str, Any]] = dict.fromkeys(("gamma", "lmi_gamma"), float)
    saved = ("status", "gamma", "lmi_gamma", "reason", "K", "gain")

    K: LPVModel  # the controllers at the points of the grid, interpolated between them
    plant: LPVModel
    closed_loop: LPVModel  # from w to z
    gain: LPVGain  # the result of `peak_gain` of the loop
    lmi_gamma: float  # optimum of the LMIs at the grid points: a lower bound for this method

    @property
    def controller(self) -> LPVController:
        """K with its verified gain, as stored."""
        return LPVController(self.K, self.gamma, self.status, "lpv-hinf")

    def claims(self) -> list[Claim]:
        """Return the claim that plant and controller, as stored, form a loop with that gain."""
        plant, K, n = self.plant, self.K, self.plant.n_states
        z, w = len(plant.outputs) - len(K.inputs), len(plant.inputs) - len(K.outputs)
        M, E = (X.reshape(-1, *X.shape[-2:]) for X in (plant.matrices, plant.deviation))
        moving = (M[0] != M).any(axis=0) | E.any(axis=0)
        if not self.gain.claims() or moving[n + z :].any() or moving[:, n + w :].any():
            return []
        sizes = {"n_K": K.n_states, "n_meas": len(K.inputs), "n_con": len(K.outputs)}
        numbers = {**model_numbers(plant), **{name: np.array(size) for name, size in sizes.items()}, "K": K.matrices}
        # The proof was for a rounded loop.
        return [Claim("lpv-gain", {**numbers, "P": self.gain.P, "gamma": np.array(self.gamma * (1 + 1e-6))})]

    def _gamma_text(self) -> str:
        return f"{number(self.gamma, digits=6)} (induced L2 gain, proved)"

    def facts(self) -> Facts:
        return [
            ("gamma", self._gamma_text()),
            ("holds", self.gain.scope),
            ("optimum of the LMIs", number(self.lmi_gamma, digits=6)),
            ("frozen loops", f"{number(self.gain.lower, digits=6)} at most at the points"),
            ("controller", "; ".join(p.words for p in self.K.parameters) + f"; {self.K.n_states} states"),
            ("how", self.reason),
        ]


def scheduled_hinf(
    plant: LPVModel, n_meas: int | None, n_con: int | None, effort: float, time_limit: float | None,
    progress: Callable[[str], None] | None,
) -> LPVSynthesis:  # fmt: skip
    """Compute `hinf` of an LPV model."""
    if n_meas is None or n_con is None:
        raise InputError("hinf", "n_meas or n_con is missing", "the numbers of measurements and of controls")
    matrices = _plant_matrices(plant, n_meas, n_con)
    budget = search_budget("hinf", WORK, effort, time_limit)
    with one_thread():
        return _designed(plant, matrices, budget, progress or (lambda _: None))


@dataclass(frozen=True, eq=False)
class _Conditioned:
    """The scaled plants of the grid points in states ``x_scaled = turn x'``, with the LMIs' optimum gamma."""

    plants: list[PlantMatrices]
    scaling: Scaling
    turn: Array
    gamma: float

    def in_given_states(self, X: Array, units: Array) -> Array:
        """Return the closed loop's Lyapunov matrix for the plant's states and the controller's in given units."""
        n, s = len(self.turn), self.scaling
        back = np.diag(np.append(np.ones(n), units))
        back[:n, :n] = np.linalg.inv(self.turn) / s.states
        return back.T @ X @ back * (s.w / (s.z * s.rate))


def _designed(
    plant: LPVModel, matrices: list[PlantMatrices], budget: Budget, say: Callable[[str], None]
) -> LPVSynthesis:
    """Return the best verified design slightly above the LMIs' optimum."""
    hint = "other weights, smaller ranges or rates, or a finer grid (LPVModel.refined)"
    problem, text = _conditioned(matrices, budget, say)
    if problem is None:
        raise NoTrustworthyNumber("hinf", text, None, hint)
    optimum, best = problem.gamma / problem.scaling.gain, None
    say(f"LMIs with optimum {optimum:.6g}")
    for backoff in SYNTHESIS_BACKOFFS:
        level = problem.gamma * (1 + backoff) + 1e-9
        for coupling in (*COUPLINGS, 1 + 0.2 * backoff):
            _, outer, _ = _projection(problem.plants, level, coupling, budget)
            X = None if outer is None else _shared(*outer)
            made = None if X is None else _controller(plant, problem, X, level * (1 + 0.5 * backoff), budget)
            if made is None or X is None:
                continue
            # The loop is rebuilt from plant and controller, and its gain proved independently of the LMIs.
            K, units = made
            loop, how = closed_loop(plant, K), f"{backoff:.1%} above the LMIs' optimum"
            gain = gain_from(loop, None, budget, say, problem.in_given_states(X, units))
            if not np.isfinite(gain.upper):
                say(f"{how}: {gain.reason}")
            elif best is None or gain.upper < best.gamma:
                best = LPVSynthesis(
                    K=K, plant=plant, gamma=gain.upper, gain=gain, closed_loop=loop, lmi_gamma=optimum,
                    status=gain.status, reason=f"{how}; loop rebuilt from plant and controller",
                )  # fmt: skip
            break
        # A larger back-off is needed only where rounding or the loop between the points increases the gain.
        if best is not None and best.gamma <= optimum * (1 + backoff + NEAR):
            break
    if best is None:
        raise NoTrustworthyNumber("hinf", f"optimum {optimum:.6g}, no loop of it could be proved", None, hint)
    return best


def _conditioned(
    matrices: list[PlantMatrices], budget: Budget, say: Callable[[str], None]
) -> tuple[_Conditioned | None, str]:
    """Return the plants in states in which R and S are equal and diagonal, or None and the reason."""
    middle = matrices[len(matrices) // 2]
    scaling = paths_first(middle)
    turns, size = _frozen_states(scaling.apply(middle), budget)
    if not turns:
        return None, "the frozen plant in the middle has no controller"
    unit = 2.0 ** -round(float(np.log2(size)))  # with it gamma is about one
    scaling, found, text = replace(scaling, z=scaling.z * unit), None, ""
    for turn in turns:
        made, text = _balanced(matrices, scaling, turn / np.sqrt(unit), budget, say)
        if made is not None and (found is None or made.gamma < CLEAR * found.gamma):
            found = made
    return found, text


def _balanced(
    matrices: list[PlantMatrices], scaling: Scaling, turn: Array, budget: Budget, say: Callable[[str], None]
) -> tuple[_Conditioned | None, str]:
    """Balance the states by R and S in turn with the LMIs; return the best, or None and the solver's reason."""
    found, last, text = None, np.inf, ""
    for _ in range(BALANCINGS):
        plants = [_turned(scaling.apply(p), turn) for p in matrices]
        gamma, outer, text = _projection(plants, None, 1.0, budget)
        if gamma is None or outer is None:
            break
        say(f"states balanced by R and S: optimum {gamma / scaling.gain:.6g}")
        if found is None or gamma < found.gamma:
            found = _Conditioned(plants, scaling, turn, gamma)
        if abs(gamma / last - 1) < 0.5 * NEAR:
            break
        last = gamma
        # R and S are moderate above the optimum; if the solver finds none there, those at the optimum are used.
        _, relaxed, _ = _projection(plants, 1.05 * gamma + 1e-9, 1.5, budget)
        turn = turn @ _balancing(*(outer if relaxed is None else relaxed))
    return found, text


def _frozen_states(p: PlantMatrices, budget: Budget) -> tuple[list[Array], float]:
    """Return states in which ``X^-1`` and ``Y^-1`` of a frozen plant are equal and diagonal, and its least gamma."""
    found: list[tuple[float, TwoRiccatiProblem]] = []
    for size in ADDED:
        try:
            problem = TwoRiccatiProblem(p.with_channels(size, size, size, size), budget)
        except NoTrustworthyNumber:
            break
        gamma = problem.smallest_gamma(found[-1][0] if found else 1.0, 1e-2)
        if gamma is None:
            break
        found.append((gamma, problem))
        if len(found) > 2 and gamma > 0.9 * found[-3][0]:
            break
    smallest = min((gamma for gamma, _ in found), default=0.0)
    chosen = [item for item in found if item[0] <= COST * smallest][:1] + found[:1]
    pairs = [problem.solve(1.1 * gamma) for gamma, problem in chosen]
    return [_balancing(np.linalg.inv(pair.X), np.linalg.inv(pair.Y)) for pair in pairs if pair is not None], smallest


def _turned(p: PlantMatrices, T: Array) -> PlantMatrices:
    """Return the plant in states ``x = T x'``."""
    back = np.linalg.inv(T)
    return replace(p, A=back @ p.A @ T, B1=back @ p.B1, B2=back @ p.B2, C1=p.C1 @ T, C2=p.C2 @ T)


def _balancing(R: Array, S: Array) -> Array:
    """Return T with ``T^-1 R T^-T = T^T S T`` diagonal."""
    values, vectors = np.linalg.eigh(R)
    root = vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    squares, turn = np.linalg.eigh(root.T @ S @ root)
    return root @ turn / np.maximum(squares, 1e-14 * squares[-1]) ** 0.25


def _projection(
    plants: Sequence[PlantMatrices], level: float | None, coupling: float, budget: Budget
) -> tuple[float | None, tuple[Array, Array] | None, str]:
    """Minimise gamma (``level`` None), or the trace of R and S at a level, with ``[R t I; t I S] >= 0``."""
    import cvxpy as cp

    n = plants[0].sizes[0]
    R, S, gamma = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()
    conditions = [cp.bmat([[R, coupling * np.eye(n)], [coupling * np.eye(n), S]]) >> 0]
    conditions += [LARGEST * np.eye(n) - X >> 0 for X in (R, S)]
    bound = gamma if level is None else level
    conditions += [_outer(q, X, bound) for p in plants for q, X in ((dual(p), R), (p, S))]
    failed = least(gamma if level is None else cp.trace(R) + cp.trace(S), conditions, budget)
    if failed:
        return None, None, failed
    outer = np.asarray(R.value), np.asarray(S.value)
    return level if level is not None else float(np.asarray(gamma.value)), outer, ""


def _outer(p: PlantMatrices, S: Any, gamma: Any) -> Any:
    """Return the second inequality of a plant in an orthonormal basis of its null space, with equally scaled rows."""
    import cvxpy as cp
    from scipy.linalg import block_diag, null_space

    _, m, _, q, _ = p.sizes
    N = np.asarray(block_diag(null_space(np.hstack([p.C2, p.D21]), NULL), np.eye(q)))
    a, b, c, d = (np.abs(x) for x in (p.A, p.B1, p.C1, p.D11))
    sizes = np.block([[a + a.T, b, c.T], [b.T, np.eye(m), d.T], [c, d, np.eye(q)]])
    size = np.diag(np.abs(N).T @ sizes @ np.abs(N))
    N = N / np.sqrt(np.where(size > 0, size, 1.0))
    return -(N.T @ bounded_real(cp.hstack([p.A.T @ S + S @ p.A, S @ p.B1]), p.C1, p.D11, gamma) @ N) >> 0


def _shared(R: Array, S: Array) -> Array | None:
    """Return the closed loop's Lyapunov matrix of R and S with balanced ``M N^T = I - R S``; None where singular."""
    U, s, Vt = np.linalg.svd(np.eye(len(R)) - R @ S)
    M, N = U * np.sqrt(s), Vt.T * np.sqrt(s)
    zero, eye = np.zeros_like(R), np.eye(len(R))
    try:
        X = np.linalg.solve(np.block([[R, eye], [M.T, zero]]).T, np.block([[eye, S], [zero, N.T]]).T)
    except np.linalg.LinAlgError:
        return None
    return 0.5 * (X + X.T)


def _controller(
    plant: LPVModel, problem: _Conditioned, X: Array, level: float, budget: Budget
) -> tuple[LPVModel, Array] | None:
    """Return the controllers of the grid points for a given X in the plant's units, and the units of their states."""
    made: list[Array] = []
    for p in problem.plants:
        K = _reconstructed(p, X, level, budget)
        if K is None:
            return None
        A, B, C, D = problem.scaling.controller_to_plant(K)
        made.append(np.block([[A, B], [C, D]]))
    n, whole = len(X) // 2, np.array(made)
    # Balance the states' rows and columns of all points together, with inputs and outputs as one more row and column.
    size = np.abs(whole).sum(axis=0)
    into, out = size[:n, n:].sum(axis=1, keepdims=True), size[n:, :n].sum(axis=0, keepdims=True)
    factors = balancing_factors(np.block([[size[:n, :n], into], [out, np.zeros((1, 1))]]))
    units = factors[:n] / factors[n]
    whole[:, :n] /= units[:, None]
    whole[:, :, :n] *= units
    n_meas, n_con = (len(side) for side in (problem.plants[0].C2, problem.plants[0].B2.T))
    taken = [s if isinstance(s, Taken) else Taken(*s) for s in plant.outputs[-n_meas:]]
    states = [Signal(f"k{i + 1}") for i in range(n)]
    stacked = whole.reshape(*plant.grid, *whole.shape[1:])
    return LPVModel.of(plant.parameters, stacked, n, taken, plant.inputs[-n_con:], states), units


def _reconstructed(p: PlantMatrices, X: Array, gamma: float, budget: Budget) -> Realisation | None:
    """Return the full-order controller for a given X that maximises the margin of the bounded real LMI."""
    import cvxpy as cp

    n, m, n_u, q, n_y = p.sizes
    values, vectors = np.linalg.eigh(X)
    if values[0] <= 1e-12 * values[-1]:
        return None
    T, T_inv = vectors / np.sqrt(values), (vectors * np.sqrt(values)).T  # in these coordinates X is the identity
    # The closed loop's [A B; C D] is open_loop + left K right.
    zero, eye = np.zeros, np.eye(n)
    left = np.block([[zero((n, n)), p.B2], [eye, zero((n, n_u))], [zero((q, n)), p.D12]])
    right = np.block([[zero((n, n)), eye, zero((n, m))], [p.C2, zero((n_y, n)), p.D21]])
    open_loop = np.block([[p.A, zero((n, n)), p.B1], [zero((n, 2 * n + m))], [p.C1, zero((q, n)), p.D11]])
    for one in (left, open_loop):
        one[: 2 * n] = T_inv @ one[: 2 * n]
    for one in (right, open_loop):
        one[:, : 2 * n] = one[:, : 2 * n] @ T
    K, margin = cp.Variable((n + n_u, n + n_y)), cp.Variable()

    def whole(loop: Any) -> Any:
        top = loop[: 2 * n]
        drift = top[:, : 2 * n] + top[:, : 2 * n].T
        return bounded_real(cp.hstack([drift, top[:, 2 * n :]]), loop[2 * n :, : 2 * n], loop[2 * n :, 2 * n :], gamma)

    unit = np.diag(equal_rows(whole(open_loop).value))
    inside = -(unit @ whole(open_loop + left @ K @ right) @ unit) - margin * np.eye(len(unit)) >> 0
    if least(-margin, [inside], budget):
        return None
    return Realisation(*unpacked(np.asarray(K.value), n))


def _plant_matrices(plant: LPVModel, n_meas: int, n_con: int) -> list[PlantMatrices]:
    """Return the generalised plants at the points of the grid."""
    if not plant.n_states:
        raise InputError("hinf", "a plant without states", "one with states")
    n, n_z, n_w = plant.n_states, len(plant.outputs) - n_meas, len(plant.inputs) - n_con
    for word, count, left in (("n_meas", n_meas, n_z), ("n_con", n_con, n_w)):
        if whole(f"hinf: {word}", count, 1) and left < 1:
            found = f"{word} = {count!r} of a plant with {len(plant.inputs)} inputs and {len(plant.outputs)} outputs"
            raise InputError("hinf", found, "at least one w and z in addition")
    m = plant.matrices.reshape(-1, *plant.matrices.shape[-2:])
    if m[:, n + n_z :, n + n_w :].any() or plant.deviation[..., n + n_z :, n + n_w :].any():
        hint = "put a fast lag between controls and measurements"
        raise InputError("hinf", "a direct term from the controls to the measurements (D22)", "D22 = 0", hint)
    return [PlantMatrices.of(Realisation.of(plant.model_of(one)), n_w, n_z) for one in m]


def closed_loop(plant: LPVModel, law: LPVModel) -> LPVModel:
    """Return the loop from w to z of ``u = K(rho) y`` on a common grid, with a proved error between the points."""
    # M = P + U K V with multi-linear P, U, K, V: where U or V vary, interpolation errs by at most a quarter of the sum
    # over the parameters of |dU| |dK| |V| + |dU| |K| |dV| + |U| |dK| |dV|, with the largest changes over the cell.
    n_meas, n_con = len(law.inputs), len(law.outputs)
    n_z, n_w = len(plant.outputs) - n_meas, len(plant.inputs) - n_con
    n, n_k = plant.n_states, law.n_states

    # Rows and columns of the plant among those of the loop, with states (x, x_k).
    into = np.insert(np.eye(n + n_z), [n] * n_k, 0.0, axis=0)
    out = np.insert(np.eye(n + n_w), [n] * n_k, 0.0, axis=1)

    def parts(m: Array) -> tuple[Array, Array, Array]:
        """Return P, U and V of stacked plants, or of bounds of their entries."""
        lead, B, C = m.shape[:-2], into @ m[..., : n + n_z, n + n_w :], m[..., n + n_z :, : n + n_w] @ out
        U = np.concatenate([np.zeros((*lead, len(into), n_k)), B], axis=-1)
        V = np.concatenate([np.zeros((*lead, n_k, out.shape[1])), C], axis=-2)
        return into @ m[..., : n + n_z, : n + n_w] @ out, U, V

    P, U, V = parts(plant.matrices)
    U[..., n : n + n_k, :n_k] = V[..., :n_k, n : n + n_k] = np.eye(n_k)
    states = [*plant.states, *(Signal(f"k{i + 1}") for i in range(n_k))]
    # The plant's own deviation and the products' curvature.
    e_P, e_U, e_V = parts(plant.deviation)
    deviation = np.zeros((*plant.deviation.shape[:-2], *P.shape[-2:]))
    for cell in plant.cells():
        (u, d_u), (k, d_k), (v, d_v) = (_largest(m, cell) for m in (U, law.matrices, V))
        bend = sum(0.25 * (du @ dk @ v + du @ k @ dv + u @ dk @ dv) for du, dk, dv in zip(d_u, d_k, d_v, strict=True))
        eu, ev = e_U[cell], e_V[cell]
        deviation[cell] = e_P[cell] + bend + eu @ k @ (v + ev) + u @ k @ ev
    known = plant.known
    if deviation.any():
        deviation *= 1 + 1e-12
        known = max(known, PROVED, key=KNOWN.index)
    return LPVModel.of(
        plant.parameters, P + U @ law.matrices @ V, n + n_k, plant.inputs[:n_w], plant.outputs[:n_z], states,
        deviation, known if deviation.any() else EXACT,
    )  # fmt: skip


def _largest(m: Array, cell: tuple[int, ...]) -> tuple[Array, list[Array]]:
    """Return the largest absolute entries over the vertices of a cell, and of the changes along each parameter."""
    k = len(cell)
    corner = m[tuple(slice(i, i + 2) for i in cell)]
    changes = [np.abs(np.diff(corner, axis=axis)).reshape(-1, *m.shape[-2:]).max(axis=0) for axis in range(k)]
    return np.max([np.abs(corner[at]) for at in product((0, 1), repeat=k)], axis=0), changes
