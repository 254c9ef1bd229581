r"""`hinf` of an LPV model: H-infinity controllers scheduled by measured parameters, their loops verified by `lpv_gain`.

At the points of the grid the projection LMIs are solved with shared R and S, or with one of them varying at bounded
rates (`robustlab.synthesis.hinf.lmi_synthesis`); at each point a controller is reconstructed for the closed loop's
Lyapunov matrix X, and between the points the controllers are interpolated. With shared R and S, and with B2, C2, D12,
D21 that do not depend on the parameters, X proves the interpolated loop in every cell (Apkarian, Gahinet, Becker 1995).

Where R varies, S and N are constant and :math:`M(\rho) = (I - R S) N^{-T}`; where S varies, R and M are, and
:math:`N(\rho) = (I - S R) M^{-T}`. Either way the terms with :math:`\dot\rho` drop out of the controller (Apkarian,
Adams 1998). Whatever the LMIs say, a controller is returned with what `lpv_gain` proves of the loop that is rebuilt
from plant and controller.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.norms import hinf_norm
from robustlab.shown import Facts, number
from robustlab.signals import Taken
from robustlab.statespace import Signal, lower_lft
from robustlab.synthesis.hinf.lmi_synthesis import Outer, Slopes, projection, reconstructed, shared
from robustlab.synthesis.hinf.two_riccati import TwoRiccatiProblem
from robustlab.synthesis.problem.design import Design
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation
from robustlab.synthesis.problem.scaling import Scaling, equilibrated, paths_first
from robustlab.synthesis.scheduling.constants import BALANCINGS, NEAR, WORK
from robustlab.synthesis.scheduling.induced_gain import LPVGain, Lyapunov, gain_from
from robustlab.synthesis.scheduling.lpv_loop import closed_loop, plant_matrices
from robustlab.synthesis.scheduling.parameter_varying import EXACT, LPVModel
from robustlab.synthesis.scheduling.scheduled_controller import LPVController

# Back-offs of a synthesis. Larger: better conditioned controllers, worse gamma.
SYNTHESIS_BACKOFFS = (0.005, 0.02, 0.1, 0.3)
# Couplings t of [R tI; tI S] >= 0 beside one that follows the back-off. Larger: better conditioned, sooner
# infeasible.
COUPLINGS = (1.5, 1.05)
# Channels added to the frozen plant whose Riccati equations give the first states: sizes in turn, from large to
# small, and how many times its gamma they may cost at the first start, and at the second.
ADDED = tuple(10.0 ** (-0.5 * k) for k in range(17))
COSTS = (30.0, 3.0)
# Points at which frozen loops are looked at beside the grid, and the seed of their places.
FROZEN_POINTS = 20

__all__ = ["LPVSynthesis", "scheduled_hinf"]

Varying = Literal["", "R", "S"]
# Rounds over the states of a controller, at most, until their units stand.
SWEEPS = 30


@dataclass(frozen=True, eq=False, kw_only=True)
class LPVSynthesis(Design):
    """A scheduled controller whose loop was rebuilt from plant and controller and verified.

    Attributes
    ----------
    K
        The controllers at the points of the grid, interpolated between them.
    gamma
        Proved bound of the loop's induced gain.
    plant
        The generalised plant.
    closed_loop
        The loop rebuilt from plant and controller, from w to z.
    gain
        What `lpv_gain` says of it; ``gain.upper`` is ``gamma``.
    lmi_gamma
        Optimum of the LMIs at the grid points: what no controller of this method gets below.
    frozen
        Largest norm of frozen loops at random places between the points, each from plant and controller evaluated
        there: sampled. NaN where none was looked at.
    status
        That of ``gain``.
    reason
        How it was found.
    """

    quantities: ClassVar[Mapping[str, Any]] = dict.fromkeys(("gamma", "lmi_gamma", "frozen"), float)

    K: LPVModel
    plant: LPVModel
    closed_loop: LPVModel
    gain: LPVGain
    lmi_gamma: float
    frozen: float

    @property
    def controller(self) -> LPVController:
        """K with what was verified about it, as it is stored."""
        return LPVController(self.K, self.gamma, self.status, "lpv-hinf")

    def _gamma_text(self) -> str:
        return f"{number(self.gamma, digits=6)} (induced L2 gain, proved)"

    def facts(self) -> Facts:
        return [
            ("gamma", self._gamma_text()),
            ("holds", self.gain.scope),
            ("optimum of the LMIs", number(self.lmi_gamma, digits=6)),
            ("frozen loops", f"{number(max(self.frozen, self.gain.lower), digits=6)} at most of those looked at"),
            ("controller", "; ".join(p.words for p in self.K.parameters) + f"; {self.K.n_states} states"),
            ("how", self.reason),
        ]

    def to_json(self) -> dict[str, Any]:
        return {
            "status": self.status, "gamma": self.gamma, "lmi_gamma": self.lmi_gamma, "frozen": self.frozen,
            "reason": self.reason, "K": self.K.to_json(), "gain": self.gain.to_json(),
        }  # fmt: skip


def scheduled_hinf(
    plant: LPVModel,
    n_meas: int | None,
    n_con: int | None,
    lyapunov: Lyapunov | None,
    effort: float,
    time_limit: float | None,
    progress: Callable[[str], None] | None,
) -> LPVSynthesis:
    """`hinf` of an LPV model; see there."""
    kinds = ("constant", "varying")
    if lyapunov is not None and lyapunov not in kinds:
        raise InputError("hinf: lyapunov", f"{lyapunov!r}", "'constant' or 'varying'", did_you_mean(lyapunov, kinds))
    if n_meas is None or n_con is None:
        raise InputError("hinf", "n_meas or n_con is missing", "the numbers of measurements and of controls")
    matrices = plant_matrices(plant, n_meas, n_con, "hinf")
    if not plant.n_states:
        raise InputError("hinf", "a plant without states", "one with states")
    budget = search_budget("hinf", WORK, effort, time_limit)
    with one_thread():
        return _Task(plant, matrices, lyapunov, budget, progress or (lambda _: None)).result()


@dataclass(frozen=True, eq=False)
class _Conditioned:
    """The plants of the grid points scaled, and in states ``x_scaled = turn x'``; gamma is the LMIs' optimum there."""

    plants: list[PlantMatrices]
    scaling: Scaling
    turn: Array
    gamma: float

    @property
    def optimum(self) -> float:
        """Of the plant as given."""
        return self.gamma / self.scaling.gain

    def in_given_states(self, X: Array, units: Array) -> Array:
        """The closed loop's Lyapunov matrix for the plant's own states, and the controller's in units of their own."""
        n, s = len(self.turn), self.scaling
        back = np.diag(np.append(np.ones(n), units))
        back[:n, :n] = np.linalg.inv(self.turn) / s.states
        return back.T @ X @ back * (s.w / (s.z * s.rate))


@dataclass(frozen=True, eq=False)
class _Task:
    """One design: what is asked for, and what it may cost."""

    plant: LPVModel
    matrices: list[PlantMatrices]
    lyapunov: Lyapunov | None
    budget: Budget
    say: Callable[[str], None]
    known: list[tuple[_Conditioned | None, str]] = field(default_factory=list)

    def result(self) -> LPVSynthesis:
        bounded = any(np.isfinite(p.rate) for p in self.plant.parameters)
        asked = self.lyapunov or ("constant" if not bounded else None)
        tried: list[Varying] = []
        if asked != "varying" or not bounded:
            tried.append("")
        if asked != "constant" and bounded:
            tried.extend(("S", "R"))
        best: LPVSynthesis | None = None
        notes = []
        for varying in tried:
            found, note = self._designed(varying)
            notes.append(note)
            self.say(note)
            if found is not None and (best is None or found.gamma < best.gamma):
                best = found
        if best is None:
            hint = "other weights, smaller ranges or rates, or a finer grid (LPVModel.refined)"
            raise NoTrustworthyNumber("hinf", "; ".join(notes), None, hint)
        return best

    def _designed(self, varying: Varying) -> tuple[LPVSynthesis | None, str]:
        """The best verified loop of one kind of Lyapunov matrices, and how it went."""
        words = {"": "R and S shared", "R": "R varies, S shared", "S": "S varies, R shared"}[varying]
        problem, outcome = self._conditioned()
        if problem is None:
            return None, f"R and S shared: {outcome}"
        scaling, gamma = problem.scaling, problem.gamma
        slopes = self._slopes(scaling.rate) if varying else ()
        if varying:
            gamma, _, solver = projection(problem.plants, None, 1.0, self.budget, varying=varying, slopes=slopes)
            if gamma is None:
                return None, f"{words}: {solver.text}"
        optimum = gamma / scaling.gain
        self.say(f"{words}: LMIs with optimum {optimum:.6g}")
        best: LPVSynthesis | None = None
        for backoff in SYNTHESIS_BACKOFFS:
            level = gamma * (1 + backoff) + 1e-9
            # Of the largest margin, or small: neither is always the better one.
            for widest in (True, False):
                for coupling in (*COUPLINGS, 1 + 0.2 * backoff):
                    _, outer, _ = projection(
                        problem.plants, level, coupling, self.budget, varying=varying, slopes=slopes, widest=widest
                    )
                    lyapunov = None if outer is None else _closed_lyapunov(outer, slopes, varying)
                    made = (
                        None if lyapunov is None else self._controller(problem, lyapunov, level * (1 + 0.5 * backoff))
                    )
                    if made is None or lyapunov is None:
                        continue
                    K, units = made
                    guess = problem.in_given_states(lyapunov[len(lyapunov) // 2][0], units)
                    how = f"{words}, {backoff:.1%} above the LMIs' optimum"
                    found = self._verified(K, guess, varying, optimum, how)
                    if found is not None and (best is None or found.gamma < best.gamma):
                        best = found
                    break
                # A larger back-off is for those that rounding, or the loop between the points, spoils.
                if best is not None and best.gamma <= optimum * (1 + backoff + NEAR):
                    return best, f"{words}: optimum {optimum:.6g}"
        return best, f"{words}: optimum {optimum:.6g}" + (", no loop of it could be proved" if best is None else "")

    def _conditioned(self) -> tuple[_Conditioned | None, str]:
        """The plants in states in which R and S of the last optimum are equal and diagonal, until it stands.

        Without it the optimum that a solver in double precision finds may be many times too large, or there is none: R
        and S of a stiff or singular problem range over ten decades. The first states are those of the Riccati equations
        of one frozen plant.
        """
        if self.known:
            return self.known[0]
        middle = self.matrices[len(self.matrices) // 2]
        found: _Conditioned | None = None
        text = "the frozen plant in the middle has no controller"
        for scaling in (paths_first(middle), equilibrated(middle)):
            for turn, size in self._frozen_states(scaling.apply(middle)):
                unit = 2.0 ** -round(float(np.log2(size)))  # with it gamma is about one
                start = replace(scaling, z=scaling.z * unit)
                made, stands, text = self._balanced(start, turn / np.sqrt(unit))
                if made is not None and (found is None or made.optimum < found.optimum):
                    found = made
                if stands and found is made:
                    self.known.append((found, text))
                    return found, text
        self.known.append((found, text))
        return found, text

    def _frozen_states(self, p: PlantMatrices) -> list[tuple[Array, float]]:
        """States in which ``X^-1`` and ``Y^-1`` of a frozen plant are equal and diagonal, and its smallest gamma.

        Of the plant with small channels added, as X and Y of its own may be singular, and at a gamma some times its
        own: nearer to it the states that w does not move or z does not show are measured too differently.
        """
        found: list[tuple[float, TwoRiccatiProblem]] = []
        for size in ADDED:
            try:
                problem = TwoRiccatiProblem(p.with_channels(size, size, size, size), True, self.budget)
            except NoTrustworthyNumber:
                break
            gamma = problem.smallest_gamma(found[-1][0] if found else 1.0, 1e-2, ())
            if gamma is None:
                break
            found.append((gamma, problem))
            if len(found) > 2 and gamma > 0.9 * found[-3][0]:
                break
        least, states = min((gamma for gamma, _ in found), default=0.0), []
        for cost in COSTS:
            pair = next((q.solve(1.1 * gamma) for gamma, q in found if gamma <= cost * least), None)
            if pair is not None:
                states.append((_balancing(np.linalg.inv(pair.X), np.linalg.inv(pair.Y)), least))
        return states

    def _balanced(self, scaling: Scaling, turn: Array) -> tuple[_Conditioned | None, bool, str]:
        """The best of the rounds from one start, whether its optimum stands, and what the solver said."""
        found, waited = None, 0
        for _ in range(BALANCINGS):
            plants = [_turned(scaling.apply(p), turn) for p in self.matrices]
            gamma, outer, outcome = projection(plants, None, 1.0, self.budget)
            if gamma is None or outer is None:
                return found, False, outcome.text
            self.say(f"states balanced by R and S: optimum {gamma / scaling.gain:.6g}")
            best = np.inf if found is None else found.gamma
            if gamma < best:
                found = _Conditioned(plants, scaling, turn, gamma)
            # The first rounds may go up: R and S of a bad start say little.
            waited = 0 if gamma < best * (1 - 0.5 * NEAR) else waited + 1
            if waited == 2 or abs(gamma / best - 1) < 0.5 * NEAR:
                return found, abs(gamma / best - 1) < NEAR, outcome.text
            # Above the optimum R and S are moderate; where the solver has none there, those at the optimum serve.
            _, softer, _ = projection(plants, 1.05 * gamma + 1e-9, 1.5, self.budget)
            outer = outer if softer is None else softer
            turn = turn @ _balancing(outer.R[0], outer.S[0])
        return found, True, "the optimum still falls"

    def _slopes(self, rate: float) -> Slopes:
        """For each point the derivatives along the motions that leave it into the cells beside it, at rates' ends."""
        grid, parameters = self.plant.grid, self.plant.parameters
        strides = [int(np.prod(grid[i + 1 :])) for i in range(len(grid))]
        found = []
        for k, at in enumerate(np.ndindex(grid)):
            ways: list[list[dict[int, float]]] = []
            for i, p in enumerate(parameters):
                if not np.isfinite(p.rate):
                    raise InputError(
                        "hinf", f"{p.name} may change at any rate", "a bound of its rate for lyapunov='varying'"
                    )
                sides = [s for s in (-1, 1) if 0 <= at[i] + s < grid[i]]
                own = []
                for side in sides:
                    part = p.rate / rate / (p.points[at[i] + side] - p.points[at[i]])
                    own += [{k + side * strides[i]: s * part, k: -s * part} for s in (1.0, -1.0)]
                ways.append(own if p.rate > 0 else [{}])
            found.append([_added(way) for way in product(*ways)])
        return found

    def _controller(
        self, problem: _Conditioned, lyapunov: list[tuple[Array, list[Array]]], level: float
    ) -> tuple[LPVModel, Array] | None:
        """The controllers of the grid points in the units of the plant, and the units of their states; None where one
        has none.
        """
        made: list[Realisation] = []
        for p, (X, motions) in zip(problem.plants, lyapunov, strict=True):
            K = reconstructed(p, X, level, self.budget, motions=motions)
            if K is None:
                return None
            made.append(problem.scaling.controller_to_plant(K))
        n_z, n_w = (len(side) for side in (self.matrices[0].C1, self.matrices[0].B1.T))
        whole = np.array([np.block([[K.A, K.B], [K.C, K.D]]) for K in made])
        n = len(made[0].A)
        units = _state_units(whole, n)
        whole[:, :n] /= units[:, None]
        whole[:, :, :n] *= units
        K = LPVModel.of(
            self.plant.parameters, whole.reshape(*self.plant.grid, *whole.shape[1:]), n,
            [s if isinstance(s, Taken) else Taken(*s) for s in self.plant.outputs[n_z:]], self.plant.inputs[n_w:],
            [Signal(f"k{i + 1}") for i in range(n)],
        )  # fmt: skip
        return K, units

    def _verified(self, K: LPVModel, guess: Array, varying: str, optimum: float, how: str) -> LPVSynthesis | None:
        """The loop rebuilt from plant and controller, with its proved gain; None where there is none."""
        loop = closed_loop(self.plant, K, "hinf")
        gain = gain_from(loop, "varying" if varying else "constant", self.budget, self.say, guess)
        if not np.isfinite(gain.upper):
            self.say(f"{how}: {gain.reason}")
            return None
        frozen = self._frozen(K)
        if not frozen <= gain.upper * (1 + 1e-6) and self.plant.known == EXACT:
            raise NoTrustworthyNumber("hinf", f"a frozen loop has norm {frozen:.6g} above the proved {gain.upper:.6g}")
        return LPVSynthesis(
            K=K, plant=self.plant, gamma=gain.upper, gain=gain, closed_loop=loop, lmi_gamma=optimum, frozen=frozen,
            status=gain.status, reason=f"{how}; loop rebuilt from plant and controller",
        )  # fmt: skip

    def _frozen(self, K: LPVModel) -> float:
        """Largest attained norm of frozen loops at random places, plant and controller evaluated there on their own."""
        rng = np.random.default_rng(0)
        low, high = (np.array([p.points[end] for p in K.parameters]) for end in (0, -1))
        places = low + (high - low) * rng.uniform(size=(FROZEN_POINTS, len(low)))
        return max(hinf_norm(lower_lft(self.plant.at(at), K.at(at))).lower for at in places)


def _added(ways: Sequence[dict[int, float]]) -> dict[int, float]:
    total: dict[int, float] = {}
    for way in ways:
        for at, part in way.items():
            total[at] = total.get(at, 0.0) + part
    return total


def _state_units(K: Array, n: int) -> Array:
    """Units of the n states in which their rows and columns are alike in size, all points (k, n + n_u, n + n_y) as one.

    Those that come with X and the scaled plant may be out of all proportion. The same units at all points leave what is
    interpolated between them as it is, and powers of two leave every digit.

    References
    ----------
    Osborne, "On pre-conditioning of matrices" (1960).
    """
    size, units = np.abs(K).sum(axis=0), np.ones(n)
    size[range(n), range(n)] = 0.0
    for _ in range(SWEEPS):
        before = units.copy()
        for i in range(n):
            row, column = size[i].sum(), size[:, i].sum()
            if row > 0 and column > 0:
                unit = 2.0 ** np.round(0.5 * np.log2(row / column))
                size[i] /= unit
                size[:, i] *= unit
                units[i] *= unit
        if np.array_equal(units, before):
            break
    return units


def _turned(p: PlantMatrices, T: Array) -> PlantMatrices:
    """The plant in states ``x = T x'``."""
    back = np.linalg.inv(T)
    return replace(p, A=back @ p.A @ T, B1=back @ p.B1, B2=back @ p.B2, C1=p.C1 @ T, C2=p.C2 @ T)


def _balancing(R: Array, S: Array) -> Array:
    """T with ``T^-1 R T^-T = T^T S T`` diagonal: states in which both are equal."""
    values, vectors = np.linalg.eigh(R)
    root = vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    squares, turn = np.linalg.eigh(root.T @ S @ root)
    return root @ turn / np.maximum(squares, 1e-14 * squares[-1]) ** 0.25


def _closed_lyapunov(outer: Outer, slopes: Slopes, varying: Varying) -> list[tuple[Array, list[Array]]] | None:
    r"""X of the closed loop at each point, and its derivatives along the motions there; None where one is singular.

    With :math:`X \Pi_1 = \Pi_2`, :math:`\Pi_1 = [R\ I; M^T\ 0]`, :math:`\Pi_2 = [I\ S; 0\ N^T]`.
    """
    if not varying:
        X = shared(outer.R[0], outer.S[0])
        return None if X is None else [(X, [])] * len(outer.R)
    n = len(outer.R[0])
    k = len(outer.R) // 2
    U, s, Vt = np.linalg.svd(np.eye(n) - outer.R[k] @ outer.S[k])
    fixed = U * np.sqrt(s) if varying == "S" else Vt.T * np.sqrt(s)  # M, or N
    if not s[-1] > 1e-10 * s[0]:
        return None
    zero, eye, found = np.zeros((n, n)), np.eye(n), []
    for R, S, ways in zip(outer.R, outer.S, slopes, strict=True):
        other = np.linalg.solve(fixed, eye - (R @ S if varying == "S" else S @ R))  # N^T, or M^T
        M_T, N_T = (fixed.T, other) if varying == "S" else (other, fixed.T)
        first, second = np.block([[R, eye], [M_T, zero]]), np.block([[eye, S], [zero, N_T]])
        if not np.linalg.cond(first) < 1e14:
            return None
        back = np.linalg.inv(first)
        X, motions = second @ back, []
        for way in ways:
            moving = sum((part * (outer.S if varying == "S" else outer.R)[i] for i, part in way.items()), start=zero)
            if varying == "S":
                change = np.block([[zero, moving], [zero, -np.linalg.solve(fixed, R @ moving)]]) @ back
            else:
                change = -X @ np.block([[moving, zero], [-np.linalg.solve(fixed, S @ moving), zero]]) @ back
            motions.append(0.5 * (change + change.T))
        found.append((0.5 * (X + X.T), motions))
    return found
