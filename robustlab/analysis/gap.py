"""The gap metric between two models: two H-infinity designs, each verified, and the nu-gap below them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.display import Facts, bracket
from robustlab.errors import NoTrustworthyNumber, error_context
from robustlab.result import Bracket, Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.hinf.hinf_synthesis import hinf
from robustlab.uncertainty.distances import NOTHING, CoprimeFactors, NuGap, continuous_models, coprime_factors, nu_gap

CLOSE = 1e-3  # relative distance of the bounds that counts as converged


@dataclass(frozen=True, eq=False)
class GapMetric(Bracket):
    """The gap between two models.

    Attributes
    ----------
    lower, upper
        ``lower <= gap <= upper``; ``upper`` is the proved norm of the worse of two designs.
    directed, nu
        Upper bounds of both directed gaps, equal below 1; the nu-gap, which never exceeds the gap.
    status
        CONVERGED where the bounds agree to a thousandth, else INCONCLUSIVE.
    """

    directed: tuple[float, float]
    nu: NuGap

    @property
    def value(self) -> float:
        """The gap; equal to ``upper``."""
        return self.upper

    def facts(self) -> Facts:
        return [("gap", bracket(self.lower, self.upper, ("not below", "proved"))), ("nu-gap", f"{self.nu.value:.6g}")]


@error_context("gap")
def gap(P1: Any, P2: Any) -> GapMetric:
    r"""Gap metric between two models of equal size.

    With normalised right coprime factors :math:`G_i = [N_i; M_i]` the directed gap is a model-matching problem,

    .. math:: \vec\delta(P_1, P_2) = \inf_{Q \in H_\infty} \| G_1 - G_2 Q \|_\infty, \qquad
       \delta = \max(\vec\delta(P_1, P_2), \vec\delta(P_2, P_1)),

    which `hinf` solves and proves, since Q is the controller of a stable plant.

    Parameters
    ----------
    P1, P2
        As for `nu_gap`.

    Returns
    -------
    GapMetric
        Bounds of the gap, and the nu-gap.

    Raises
    ------
    InputError, NoTrustworthyNumber
        As for `nu_gap`.

    References
    ----------
    Georgiou, "On the computation of the gap metric", Systems & Control Letters 11 (1988).

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
