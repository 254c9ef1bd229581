"""H2 (LQG) synthesis in continuous and discrete time: two Riccati equations on a scaled and regularised plant."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import NOT_REPEATABLE, Budget, dense, one_thread
from robustlab.checks import number
from robustlab.display import Facts
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.linear_analysis.matrices import care, dare, refuse_extremes, refuse_overflow
from robustlab.norms import H2Norm, h2_by_channels
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.certify import (
    CANCELLED,
    Certificate,
    certified,
    named_controller,
    surely_stable,
    with_direct_term,
)
from robustlab.synthesis.problem.design import Synthesis, design_budget, final_status
from robustlab.synthesis.problem.gamma_lower_bound import require_stabilisable
from robustlab.synthesis.problem.generalized_plant import (
    GeneralizedPlant,
    PlantMatrices,
    Realisation,
    Scaling,
    as_generalized_plant,
    equilibrated,
    paths_first,
    require_performance,
)

# Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum, K faster.
LADDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
# Singular values of D12 or D21, scaled, above which that side is not regularised. Smaller: digits are lost.
REGULAR = 1e-6
# The regularised optimum falls with the regularisation; two steps that gain less than this end the ladder.
SETTLED = 1e-4
PROOFS = 3  # controllers, best first, that are given to the checker. More: fewer unconfirmed results, slower
# Largest residual of a Riccati solution: those of singular plants lose digits; the rebuilt loop decides.
RESIDUAL = 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class H2Synthesis(Synthesis):
    """An H2 design; ``gamma`` is the H2 norm of ``closed_loop``, the larger of the values from both Gramians."""

    quantities = dict.fromkeys(("regularisation", "smallest_norm"), float)
    saved = ("norm", "regularisation", "smallest_norm")

    norm: H2Norm  # of the rebuilt loop
    regularisation: float  # size of the added penalties and noises in the scaled plant; 0: none, and K is optimal
    smallest_norm: float  # verified, of the search; K may belong to a larger regularisation within the allowed ratio

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (H2 norm, verified by both Gramians)"

    def facts(self) -> Facts:
        rows = super().facts()
        if not self.regularisation:
            return rows
        return [*rows[:2], ("regularisation", f"{self.regularisation:.0e} in scaled units"), *rows[2:]]


@error_context("synth h2")
def h2(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma_rel: float = 1.0005,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> H2Synthesis:
    r"""Design the H2-optimal (LQG) controller ``u = K y`` with positive feedback into the lower LFT of P.

    .. math:: \min_K \|F_l(P, K)\|_2

    The H2 norm is the root-mean-square of z for white noise w of unit intensity. K has the order of P; it is unique
    where D12 has full column rank, D21 full row rank, and there are no zeros on the stability boundary. Elsewhere small
    penalties on u and x and small noises on y and x are added, ever smaller until the verified norm stops falling. The
    K of a discrete P may have a direct term. Doyle, Glover, Khargonekar, Francis 1989; Zhou, Doyle, Glover 1996,
    chapter 14; Chen, Francis, *Optimal Sampled-Data Control Systems* (1995), section 6.5.

    Parameters
    ----------
    P
        As for `robustlab.hinf`. Continuous: the direct term from w to z must vanish in closed loop; where
        ``D11 + D12 D_K D21 = 0`` has a solution D_K, K contains it, and else there is no finite H2 norm.
    gamma_rel
        Largest ratio of the norm to the smallest norm found (>= 1) where penalties or noises had to be added; within it
        the largest ones are taken, because K grows faster without end as they go to zero.
    n_meas, n_con, time_limit, effort, progress
        As for `robustlab.hinf`.

    Returns
    -------
    H2Synthesis
        Always with a stabilising K whose H2 norm was verified on the loop rebuilt from it; ``regularisation`` is the
        size of the penalties and noises.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Channels that P does not have, ``gamma_rel`` below 1. A mode that no controller can stabilise, a direct term
        that no controller can cancel, or no controller could be verified.

    Examples
    --------
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> design = h2(P, n_meas=1, n_con=1)
    >>> design.status.value, round(design.gamma, 6)
    ('converged', 0.696621)
    """
    plant = as_generalized_plant(P, n_meas, n_con, "synth h2")
    require_performance(plant, "synth h2")
    return synthesize_h2(plant, gamma_rel, design_budget("synth h2", effort, time_limit), progress)


class _Trial(NamedTuple):
    """A controller of one regularisation, with its loop on the plant as given."""

    K: StateSpaceModel
    loop: StateSpaceModel
    norm: H2Norm
    limit: str
    eps: float


@one_thread()
def synthesize_h2(
    plant: GeneralizedPlant, gamma_rel: float, budget: Budget, progress: Callable[[str], None] | None = None
) -> H2Synthesis:
    """Search a controller for `h2`."""
    where, dt, matrices = "synth h2", plant.model.dt, plant.matrices()
    number(f"{where}: gamma_rel", gamma_rel, at_least=1, at_most=1e6)
    refuse_extremes(plant.model, where)
    gain = _cancelling_gain(matrices, dt, where)  # the search is for K less this direct term
    shifted, trials = _with_gain(matrices, gain), list[_Trial]()
    refuse_overflow(where, shifted.A, shifted.B1, shifted.C1, shifted.D11)
    first, moving = paths_first(shifted), None if dt else shifted
    if dt:
        with suppress(NoTrustworthyNumber):  # a pole at z = -1: the rebuilt loop decides
            moving = plant.continuous().matrices()
    if moving is not None:
        units = paths_first(moving) if dt else first
        require_stabilisable(units.apply(moving), plant.model.state_names, where, units.rate)
    for other in (False, True):
        scaling = equilibrated(shifted) if other else first
        scaling = scaling.in_steps() if dt else scaling
        if _ladder(plant, shifted, gain, scaling, trials, budget, progress or (lambda _: None)) or budget.over:
            break
    by_norm = sorted(trials, key=lambda t: t.norm.value)
    if not by_norm:
        ended = f" ({NOT_REPEATABLE})" if budget.struck else ""
        found = f"no controller could be verified{ended}: none was found, or none left the rebuilt loop stable"
        hint = "look at the plant's scaling and at poles and zeros on the stability boundary"
        raise NoTrustworthyNumber(where, found, hint=hint)
    best = by_norm[0]
    allowed = [t for t in trials if t.norm.value <= gamma_rel * best.norm.value] if best.eps else [best]
    chosen = max(allowed, key=lambda t: t.eps)
    proofs: list[tuple[_Trial, Certificate]] = []
    for trial in (chosen, *(t for t in by_norm if t is not chosen))[:PROOFS]:
        proofs.append((trial, certified(plant, trial.K, trial.norm)))
        if not proofs[-1][1].doubt:
            break
    chosen, (gamma, doubt) = proofs[0] if proofs[-1][1].doubt else proofs[-1]
    parts = [doubt or "loop rebuilt from K is stable; both Gramians give its norm, proved in ball arithmetic"]
    if chosen.eps:
        parts.append(f"kept finite by penalties and noises of {chosen.eps:.0e} in scaled units")
        parts.append(f"the smallest norm found with smaller ones is {best.norm.value:.6g}")
    else:
        parts.append("the plant is regular: this is the optimum")
    status, reason = final_status(Status.INACCURATE if doubt else chosen.norm.status, parts, budget, "a smaller norm")
    return H2Synthesis(
        K=chosen.K, gamma=gamma, closed_loop=chosen.loop, status=status, reason=reason, limit=chosen.limit,
        plant=plant, method="h2", norm=chosen.norm, regularisation=chosen.eps, smallest_norm=best.norm.value,
    )  # fmt: skip


def _ladder(
    plant: GeneralizedPlant, shifted: PlantMatrices, gain: AnyArray, scaling: Scaling, trials: list[_Trial],
    budget: Budget, report: Callable[[str], None],
) -> bool:  # fmt: skip
    """Try no regularisation (if the plant allows it), then ever smaller ones.

    Return whether the regular problem was solved, or smaller regularisations gained less than SETTLED.
    """
    scaled, dt = scaling.apply(shifted), plant.model.dt
    sizes = scaled.direct_sizes
    best, idle = np.inf, 0
    for eps in LADDER if min(sizes) <= REGULAR and not dt else (0.0, *LADDER):
        if budget.over:
            return False
        # two equations, and norms of the loop
        budget.spend(dense(len(scaled.A), 8) + dense(2 * len(scaled.A), 3))
        u, y = (0.0 if size > max(REGULAR, eps) else eps for size in sizes)
        regularised = scaled.with_channels(u, y, eps / 10, eps / 10) if eps else scaled
        trial = _trial(plant, gain, scaling, regularised, eps)
        text = "no verified loop" if trial is None else f"H2 norm {trial.norm.value:.6g}"
        report(f"regularisation {eps:.0e}: {text}")
        if trial is None or not trial.norm.status.trustworthy:
            idle += bool(trials)
        else:
            trials.append(trial)
            if not eps:
                return True
            idle = idle + 1 if trial.norm.value > best * (1 - SETTLED) else 0
            best = min(best, trial.norm.value)
        if idle == 2:
            return best < np.inf
    return False


def _trial(
    plant: GeneralizedPlant, gain: AnyArray, scaling: Scaling, regularised: PlantMatrices, eps: float
) -> _Trial | None:
    """Return K of this regularisation in its loop; None if that is unstable or its norm not finite."""
    dt = plant.model.dt
    try:
        A, B, C, D = scaling.controller_to_plant(_controller(regularised, dt))
        K = with_direct_term(StateSpaceModel(A, B, C, D + gain, dt), plant.D22)
        K = named_controller(K, plant.measurements, plant.controls, dt)
        loop = plant.close(K)
    except (NoTrustworthyNumber, InputError):  # not well posed, or entries overflow
        return None
    if not surely_stable(loop):
        return None
    if not dt:
        D11 = plant.model.D[: plant.n_z, : plant.n_w]
        allowed = CANCELLED * max(np.abs(D11).max(initial=0.0), np.abs(K.D).max(initial=0.0))
        if np.abs(loop.D).max(initial=0.0) > allowed:  # more than rounding of the cancellation
            return None
        loop = loop._in_states(loop.A, loop.B, loop.C, np.zeros_like(loop.D))
    norm, _, out, into = h2_by_channels(loop)
    if not np.isfinite(norm.value):
        return None
    return _Trial(K, loop, norm, _largest_channels(loop, out, into), eps)


def _controller(p: PlantMatrices, dt: float) -> Realisation:
    """Return the optimal controller of a regular plant with D22 = 0 (and, in continuous time, D11 = 0)."""
    solve = dare if dt else care
    control = solve(p.A, p.B2, p.C1.T @ p.C1, p.D12.T @ p.D12, p.C1.T @ p.D12, tolerance=RESIDUAL)
    filtering = solve(p.A.T, p.C2.T, p.B1 @ p.B1.T, p.D21 @ p.D21.T, p.B1 @ p.D21.T, tolerance=RESIDUAL)
    F, L = control.gain, filtering.gain.T
    if not dt:  # Doyle, Glover, Khargonekar, Francis 1989, theorem 1
        return Realisation(p.A + p.B2 @ F + L @ p.C2, -L, F, np.zeros((F.shape[0], L.shape[1])))
    X, Y = control.X, filtering.X
    try:
        now = -np.linalg.solve(p.D12.T @ p.D12 + p.B2.T @ X @ p.B2, p.B2.T @ X @ p.B1 + p.D12.T @ p.D11)
        # The measurement of this sample corrects the state and contains w itself.
        seen = p.D21 @ p.D21.T + p.C2 @ Y @ p.C2.T
        direct = np.linalg.solve(seen, (F @ Y @ p.C2.T + now @ p.D21.T).T).T
    except np.linalg.LinAlgError:
        raise NoTrustworthyNumber("h2", "a weight of the Riccati equations is singular") from None
    into = p.B2 @ direct - L
    return Realisation(p.A + p.B2 @ F - into @ p.C2, into, F - direct @ p.C2, direct)


def _cancelling_gain(p: PlantMatrices, dt: float, where: str) -> AnyArray:
    """Return D_K of smallest norm with ``D11 + D12 D_K D21 = 0``; zero in discrete time."""
    _, _, n_u, _, n_y = p.sizes
    if dt or not p.D11.any():
        return np.zeros((n_u, n_y))
    gain = -np.linalg.pinv(p.D12, rcond=1e-10) @ p.D11 @ np.linalg.pinv(p.D21, rcond=1e-10)
    left = p.D11 + p.D12 @ gain @ p.D21
    share = float(np.abs(left).max() / np.abs(p.D11).max())
    if share > CANCELLED:
        found = f"the H2 norm is infinite for every controller: {share:.1%} of the direct term from w to z stays"
        hint = "take w's direct way to z out of the plant, or pass w through a fast low-pass filter first"
        raise NoTrustworthyNumber(where, found, "D11 = 0, or D11 + D12 D_K D21 = 0 for some D_K", hint)
    return gain


def _with_gain(p: PlantMatrices, gain: AnyArray) -> PlantMatrices:
    """Return the plant with ``u = gain y + v``, v its new control, and D11 cancelled."""
    if not gain.any():
        return p
    A, B1, C1 = p.A + p.B2 @ gain @ p.C2, p.B1 + p.B2 @ gain @ p.D21, p.C1 + p.D12 @ gain @ p.C2
    return replace(p, A=A, B1=B1, C1=C1, D11=np.zeros_like(p.D11))


def _largest_channels(loop: StateSpaceModel, out: AnyArray, into: AnyArray) -> str:
    """Return the output and the input with the largest share of the H2 norm, in words."""
    total = out.sum()
    if not total > 0:
        return ""
    i, j = int(out.argmax()), int(into.argmax())
    share = f"{loop.output_names[i]} ({out[i] / total:.0%} of the variance)"
    return f"{share}; {loop.input_names[j]} makes {into[j] / into.sum():.0%} of it"
