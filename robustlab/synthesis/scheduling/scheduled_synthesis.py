"""`hinf` of an LPV model: controllers scheduled by measured parameters, their loops verified by `lpv_gain`.

Projection LMIs with shared R and S give a controller for each grid point, interpolated between them (Apkarian, Gahinet,
Becker 1995). The result is proved for the loop rebuilt from plant and controller, independently of the LMIs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import Budget, one_thread, search_budget
from robustlab.checks import whole
from robustlab.conic import bounded_real, equal_rows, least
from robustlab.display import Facts, number
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis.matrices import balancing_factors
from robustlab.signals import Taken
from robustlab.statespace import Signal
from robustlab.synthesis.hinf.two_riccati import TwoRiccatiProblem
from robustlab.synthesis.problem.design import Design
from robustlab.synthesis.problem.partition import PlantMatrices, Realisation, dual
from robustlab.synthesis.problem.scaling import Scaling, paths_first
from robustlab.synthesis.scheduling.induced_gain import NEAR, WORK, LPVGain, gain_from, model_numbers
from robustlab.synthesis.scheduling.parameter_varying import EXACT, KNOWN, PROVED, LPVController, LPVModel
from robustlab.verification.claim import Claim

BALANCINGS = 8  # rounds in which states are balanced by the last R and S
SYNTHESIS_BACKOFFS = (0.005, 0.02, 0.1, 0.3)  # larger: better conditioned controllers, worse gamma
# Couplings t of [R tI; tI S] >= 0; another one depends on the back-off. Larger: better conditioned, sooner infeasible.
# With 1.05 alone no loop of the spinning disks is proved.
COUPLINGS = (1.5, 1.05)
LARGEST = 1e5  # bound of the eigenvalues of R and S in the solver: without it many optima are not attained
NULL = 1e-10  # relative tolerance of singular values of a null space
# Sizes of channels added to the frozen plant whose Riccati equations give the first states, and the largest increase
# of its smallest gamma that they may cause. With the one size 0.01 neither the disks nor the missile are proved.
ADDED = tuple(10.0 ** (-0.5 * k) for k in range(17))
COST = 30.0


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
    plant: LPVModel,
    n_meas: int | None,
    n_con: int | None,
    effort: float,
    time_limit: float | None,
    progress: Callable[[str], None] | None,
) -> LPVSynthesis:
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
    turn, size = _frozen_states(scaling.apply(middle), budget)
    if turn is None:
        return None, "the frozen plant in the middle has no controller"
    unit = 2.0 ** -round(float(np.log2(size)))  # with it gamma is about one
    scaling, turn = replace(scaling, z=scaling.z * unit), turn / np.sqrt(unit)
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


def _frozen_states(p: PlantMatrices, budget: Budget) -> tuple[Array | None, float]:
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
    pair = next((problem.solve(1.1 * gamma) for gamma, problem in found if gamma <= COST * smallest), None)
    return None if pair is None else _balancing(np.linalg.inv(pair.X), np.linalg.inv(pair.Y)), smallest


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
    found = np.asarray(K.value)
    return Realisation(found[:n, :n], found[:n, n:], found[n:, :n], found[n:, n:])


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
    rows = slice(None, n), slice(n, n + n_z), slice(n + n_z, None)
    cols = slice(None, n), slice(n, n + n_w), slice(n + n_w, None)
    order = ((0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (1, 1), (1, 2), (2, 1))
    return [PlantMatrices(*(np.array(one[rows[i], cols[j]]) for i, j in order)) for one in m]


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
