r"""Robust stability of any type of system: how far its set may grow before a member is unstable.

.. math:: k = 1 / \sup_\omega \mu(M_{11}(j \omega))

References
----------
Doyle (1982); Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), chapter 11; Megretski, Rantzer, "System analysis
via integral quadratic constraints", IEEE TAC 42 (1997); Michiels, Niculescu, *Stability, Control, and Computation for
Time-Delay Systems* (2014).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike

from robustlab.analysis.kinds import options_of
from robustlab.delays.model import DelayedModel
from robustlab.errors import InputError, error_context
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData


@error_context("robust_stability")
def robust_stability(
    system: Any,
    *,
    natures: Mapping[Any, Any] | None = None,
    frequency: ArrayLike | None = None,
    omega: ArrayLike | None = None,
    tolerance: float | None = None,
    accuracy: float | None = None,
    order: int | None = None,
    pole: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
    time_limit: float | None = None,
) -> StabilityMargin:
    r"""Robust stability margin: the system is stable for all Delta of norm below ``lower``.

    .. math:: k = 1 / \sup_\omega \mu(M_{11}(j \omega))

    Of an uncertain model: ``lower`` is proved on the whole axis, by constant D, G on intervals that cover it, and box
    by box of the real parameters where these leave a gap; ``upper`` is attained, the model perturbed by ``delta`` has a
    pole on the stability boundary. A discrete model is mapped by ``s = (z - 1) / (z + 1)``. A range that is wider on
    one side grows in proportion on both. The proof is carried out in floating point with a slack of 5e-6 in mu.

    With ``natures``: for blocks that vary or are nonlinear, by integral quadratic constraints. With ``frequency``, and
    of data: at these frequencies; a stable nominal system is then assumed. With exact delays: whether the system is
    stable, by a set that holds it.

    Parameters
    ----------
    system
        An UncertainModel, with ``natures`` also a model, a DelayedModel, or UncertainFrequencyData.
    natures
        Name of a block -> `Varying` or `Nonlinearity`; or (output, input) -> `Nonlinearity`, which drives that input
        with a law of that output. Other blocks are as in the set. Empty: the same proof of constant blocks.
    frequency
        Frequencies in rad/s of the margin, without any claim between them. Data have their own.
    omega
        Of an uncertain model: frequencies in rad/s for ``mu_lower`` and ``mu_upper``, the curves of a figure.
    tolerance
        Of an uncertain model: relative gap that branch and bound aims at, 0.01 by default; inf: none.
    accuracy
        Of an uncertain model: relative distance to the best margin that D, G can prove, 3e-5 by default.
    order
        With natures: highest power of the multipliers' filters ``a / (s + a)``, 0 to 8, 2 by default.
    pole
        With natures: a in rad/s; several, by the poles of the model, are tried by default.
    seed, effort
        Seed of the searches, and their work as a multiple of the usual, counted, not timed.
    time_limit
        Time limit in s of a proof over the axis. If it is reached, the result depends on the machine.

    Returns
    -------
    StabilityMargin
        Both bounds with status and evidence: a `Margin` of an uncertain model, an `IqcStability` with natures, a
        `MarginAt` at frequencies, a `DelayStability` with delays.

    Raises
    ------
    InputError
        No uncertainty at frequencies, no such block, an option that this type of system does not have.
    NoTrustworthyNumber
        The nominal model is unstable; a pole is at a given frequency.

    References
    ----------
    Doyle (1982); Sideris, "Elimination of frequency search from robustness tests" (1992); Ly, Safonov, Chiang (1998);
    Newlin, Young, "Mixed mu problems and branch and bound techniques" (1997); Megretski, Rantzer (1997).

    Examples
    --------
    >>> import robustlab as rl
    >>> M = rl.StateSpaceModel([[-1.0]], [[-0.5]], [[1.0]], [[0.0]])
    >>> pole = rl.UncertainModel(M, [rl.RealScalar("pole")])  # s + 1 + 0.5 delta
    >>> found = rl.robust_stability(pole)
    >>> found.stable, round(found.upper, 6), round(rl.robust_stability(pole, frequency=[1.0]).lower, 6)
    (True, 2.0, inf)
    >>> round(rl.robust_stability(pole, natures={"pole": rl.Varying()}).lower, 2)
    2.0
    >>> integrator = rl.tf([1], [1, 0])
    >>> [rl.robust_stability((integrator @ rl.delay(tau)).feedback()).stable for tau in (1.5, 1.65)]  # until pi / 2
    [True, False]
    """
    own = {"omega": omega, "tolerance": tolerance, "accuracy": accuracy}
    given = {**own, "order": order, "pole": pole, "time_limit": time_limit}
    data = isinstance(system, UncertainFrequencyData)
    if natures is not None:
        from robustlab.iqc.analysis import iqc_stability

        if data or frequency is not None or isinstance(system, DelayedModel):
            found = "frequencies" if data or frequency is not None else "exact delays"
            hint = "cover the delays first: .uncertain(order) makes a set" if found == "exact delays" else None
            raise InputError("robust_stability: natures", f"given beside {found}", "a model over the whole axis", hint)
        names = {name: name for name in ("order", "pole", "time_limit")}
        chosen = options_of("robust_stability", "blocks with natures", given, names)
        return iqc_stability(system, natures, effort=effort, **chosen)
    if data or frequency is not None:
        from robustlab.mu_analysis.margins.at_frequencies import robust_stability_at

        hint = "leave the frequencies out for the whole axis"
        options_of("robust_stability", "a system at given frequencies", given, {}, hint)
        return robust_stability_at(system, frequency, seed=seed)
    if isinstance(system, DelayedModel):
        from robustlab.mu_analysis.margins.delay_margins import delay_stability

        hint = ".uncertain(order) makes a set of it"
        options_of("robust_stability", "a model with exact delays", given, {}, hint)
        return delay_stability(system, effort)
    from robustlab.mu_analysis.axis.robustness import robust_stability as of_set

    names = {name: name for name in (*own, "time_limit")}
    chosen = options_of("robust_stability", "an uncertain model over the whole axis", given, names)
    return of_set(system, seed=seed, effort=effort, **chosen)
