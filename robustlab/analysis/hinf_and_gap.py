"""H-infinity design of any type of plant, and the gap metric, which two such designs prove."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from robustlab.display import Facts, bracket
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.problem.design import HinfSynthesis, design_budget
from robustlab.synthesis.problem.generalized_plant import as_generalized_plant, require_performance
from robustlab.synthesis.scheduling.parameter_varying import LPVModel
from robustlab.synthesis.scheduling.scheduled_synthesis import LPVSynthesis, scheduled_hinf
from robustlab.uncertainty.gap_metric import NOTHING, CoprimeFactors, NuGap, continuous_models, coprime_factors, nu_gap

CLOSE = 1e-3  # relative distance of the bounds of a gap that counts as converged


@overload
def hinf(P: LPVModel, n_meas: int | None = None, n_con: int | None = None, **options: Any) -> LPVSynthesis: ...
@overload
def hinf(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma_rel: float = 1.05,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis: ...
@error_context("synth hinf")
def hinf(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma_rel: float = 1.05,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> HinfSynthesis | LPVSynthesis:
    r"""H-infinity controller ``u = K y`` with positive feedback into the lower LFT of P.

    .. math:: \min_K \|F_l(P, K)\|_\infty, \qquad F_l(P, K) = P_{11} + P_{12} K (I - P_{22} K)^{-1} P_{21}

    Two Riccati equations (Glover, Doyle 1988; Zhou, Doyle, Glover 1996, chapters 16 and 17) on a regularised plant in
    two scalings, for any ranks of D12 and D21 and any zeros. Every controller is verified on P as given, a discrete one
    in discrete time; gamma is the verified norm of the loop rebuilt from the returned K.

    The controller ``u = K(rho) y`` of an `LPVModel` is scheduled by the same measured parameters, without their rates;
    gamma bounds the induced gain :math:`\|z\|_2 / \|w\|_2` over all their trajectories, by a quadratic Lyapunov
    function (Apkarian, Gahinet, Becker 1995; Wu, Yang, Packard, Becker 1996).

    Parameters
    ----------
    P
        Generalised plant: `GeneralizedPlant`, StateSpaceModel, UncertainModel (with its perturbation channels as w and
        z), `LPVModel`, or python-control object; inputs [w; u], outputs [z; y], the ``n_con`` controls and ``n_meas``
        measurements last. An LPV model has no direct term from u to y; where its B2, C2, D12 or D21 vary, a finer grid
        (`LPVModel.refined`) reduces the loss between the points.
    n_meas, n_con
        Numbers of measurements and controls; omitted for a `GeneralizedPlant`.
    gamma_rel
        Largest ratio of gamma to the smallest gamma found (>= 1); within it the controller with the slowest poles is
        returned. 1 gives the smallest gamma, whose controller often is too fast.
    time_limit, effort, progress
        s, after which the controller verified by then is returned with status TIMEOUT, which depends on the machine;
        multiple of the usual work, counted, not timed; called with one short line after every stage.

    Returns
    -------
    HinfSynthesis or LPVSynthesis
        Always with a stabilising, verified K: ``K``, ``gamma``, ``closed_loop``, ``status`` and ``reason`` of `Design`,
        and of an LPV model ``gain``, the result of `peak_gain`.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Channels or an option that P does not have, ``gamma_rel`` below 1. A mode that no controller can stabilise
        (named), no controller could be verified, or the LMIs of an LPV model have no solution.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> design = hinf(P, n_meas=1, n_con=1, gamma_rel=1.0)
    >>> design.status.value, round(design.gamma, 3)
    ('certified', 0.732)
    """
    if isinstance(P, LPVModel):
        if gamma_rel != 1.05:
            raise InputError("synth hinf: gamma_rel", "given with an LPVModel", "a plant without parameters, or none")
        return scheduled_hinf(P, n_meas, n_con, effort, time_limit, progress)
    plant = as_generalized_plant(P, n_meas, n_con, "synth hinf")
    require_performance(plant, "synth hinf")
    budget = design_budget("synth hinf", effort, time_limit)
    return synthesize(plant, "hinf", gamma_rel, budget, progress=progress)


@dataclass(frozen=True, eq=False)
class GapMetric(Bracket):
    """The gap between two models; ``upper`` is the proved norm of the worse of two designs.

    CONVERGED where the bounds agree to a thousandth, else INCONCLUSIVE.
    """

    directed: tuple[float, float]  # upper bounds of both directed gaps, equal below 1
    nu: NuGap  # never exceeds the gap

    @property
    def value(self) -> float:
        return self.upper

    def facts(self) -> Facts:
        return [("gap", bracket(self.lower, self.upper, ("not below", "proved"))), ("nu-gap", f"{self.nu.value:.6g}")]


@error_context("gap")
def gap(P1: Any, P2: Any) -> GapMetric:
    r"""Gap metric between two models of equal size, with bounds of the gap and the nu-gap.

    With normalised right coprime factors :math:`G_i = [N_i; M_i]` the directed gap is a model-matching problem,

    .. math:: \vec\delta(P_1, P_2) = \inf_{Q \in H_\infty} \| G_1 - G_2 Q \|_\infty, \qquad
       \delta = \max(\vec\delta(P_1, P_2), \vec\delta(P_2, P_1)),

    which `hinf` solves and proves, since Q is the controller of a stable plant (Georgiou, "On the computation of the
    gap metric", Systems & Control Letters 11, 1988).

    Parameters
    ----------
    P1, P2
        As for `nu_gap`.

    Returns
    -------
    GapMetric

    Raises
    ------
    InputError, NoTrustworthyNumber
        As for `nu_gap`.

    Examples
    --------
    >>> import robustlab as rl
    >>> one, two = rl.tf([1.0], [1.0, -0.001]), rl.tf([1.0], [1.0, 0.001])
    >>> round(rl.gap(one, two).value, 4)
    0.002
    """
    nu = nu_gap(P1, P2)
    if nu.lower >= 1.0 or nu.upper <= NOTHING:  # no gap is larger than 1; models that are the same have none
        return GapMetric(nu.lower, nu.upper, nu.frequency, nu.status, (nu.upper, nu.upper), nu)
    models = continuous_models(as_model(P1, "gap: first model"), as_model(P2, "gap: second model"))
    one, two = (coprime_factors(model) for model in models)
    there, back = _directed(one, two), _directed(two, one)
    lower, upper = max(nu.lower, there[0], back[0]), max(there[1], back[1])
    status = Status.CONVERGED if upper <= lower * (1 + CLOSE) and nu.status.trustworthy else Status.INCONCLUSIVE
    return GapMetric(min(lower, upper), upper, nu.frequency, status, (there[1], back[1]), nu)


def _directed(one: CoprimeFactors, two: CoprimeFactors) -> tuple[float, float]:
    """Bounds of ``inf ||G1 - G2 Q||``, where Q = 0 reaches 1: that of a design for [G1, G2; I, 0]."""
    from scipy.linalg import block_diag

    g1, g2 = one.right, two.right
    n, m = g1.n_states + g2.n_states, g1.n_inputs
    A, B = (np.asarray(block_diag(*pair)) for pair in ((g1.A, g2.A), (g1.B, g2.B)))
    C = np.vstack([np.hstack([g1.C, g2.C]), np.zeros((m, n))])
    D = np.block([[g1.D, g2.D], [np.eye(m), np.zeros((m, m))]])
    plant = StateSpaceModel(A.reshape(n, n), B.reshape(n, 2 * m), C, D)
    try:
        found = hinf(plant, m, m, gamma_rel=1.0)
    except NoTrustworthyNumber:
        return 0.0, 1.0
    least = found.lower_bound.value if found.lower_bound.proved else 0.0
    return least, min(found.gamma, 1.0) if found.status is Status.CERTIFIED else 1.0
