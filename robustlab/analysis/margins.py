r"""Margins of any kind of loop: classical and disk margins, and the stability margin of a set.

References
----------
Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020); Skogestad,
Postlethwaite, *Multivariable Feedback Control*, section 2.4; Zhou, Doyle, Glover 1996, chapter 11.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from numpy.typing import ArrayLike

from robustlab.analysis.kinds import DELAYED, FREQUENCIES, MODEL, NATURES, SET, ask, kind_of
from robustlab.errors import InputError, error_context
from robustlab.mu_analysis.axis.margin import StabilityMargin
from robustlab.mu_analysis.margins.classical import ClassicalMargins
from robustlab.mu_analysis.margins.disk_margin import DiskMargins, Place
from robustlab.uncertainty.lft import UncertainModel

OWN = "mu_analysis.margins."
OF_SET = ("mu_analysis.axis.robustness.robust_stability", "omega tolerance accuracy seed effort time_limit")
STABILITY = {
    MODEL: OF_SET,
    SET: OF_SET,
    DELAYED: (f"{OWN}delay_margins.delay_stability", "effort"),
    FREQUENCIES: (f"{OWN}at_frequencies.robust_stability_at", "frequency seed"),
    NATURES: ("iqc.analysis.iqc_stability", "natures=nature order pole effort time_limit"),
}
DISK = {
    MODEL: (f"{OWN}disk_margin.disk_margin", "at skew sign seed effort time_limit"),
    DELAYED: (f"{OWN}delay_margins.delay_disk_margins", "at skew sign seed effort"),
    FREQUENCIES: (f"{OWN}at_frequencies.disk_margin_at", "frequency at skew sign seed"),
}  # fmt: skip
CLASSICAL = {
    MODEL: (f"{OWN}classical.classical_margins", "at sign"),
    DELAYED: (f"{OWN}delay_margins.delay_classical_margins", "at sign"),
}
HINTS = {
    DELAYED: ".uncertain(order) makes a set of it", FREQUENCIES: "leave the frequencies out for the whole axis"
}  # fmt: skip


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

    Of an uncertain model ``lower`` is proved on the whole axis, in floating point with a slack of 5e-6 in mu; ``upper``
    is attained by the member ``delta``, which has a pole on the stability boundary. A range that is wider on one side
    grows in proportion on both. With exact delays: whether the system is stable, by a set that holds it.

    Parameters
    ----------
    system
        An UncertainModel, with ``natures`` also a model, a DelayedModel, or UncertainFrequencyData.
    natures
        As in `peak_gain`: blocks that vary or are nonlinear. Empty: the same proof of constant blocks.
    frequency
        Frequencies in rad/s of the margins, without any claim between them; a stable nominal system is assumed.
    omega
        Of an uncertain model: frequencies in rad/s for ``mu_lower`` and ``mu_upper``, the curves of a figure.
    tolerance, accuracy
        Of an uncertain model: relative gap that branch and bound aims at (0.01; inf: none), and relative distance to
        the best margin that D, G can prove (3e-5).
    order, pole
        With natures as in `peak_gain`.
    seed, effort, time_limit
        Seed of the searches; their work as a multiple of the usual; s, after which the result depends on the machine.

    Returns
    -------
    StabilityMargin
        Both bounds with status and evidence: a `Margin`, an `IqcStability` with natures, a `MarginAt` at frequencies, a
        `DelayStability` with delays.

    Raises
    ------
    InputError, NoTrustworthyNumber
        No uncertainty at frequencies, no such block, an option that this kind of system does not have. The nominal
        model is unstable; a pole is at a given frequency.

    References
    ----------
    Doyle 1982; Sideris 1992; Newlin, Young 1997; Megretski, Rantzer 1997; Michiels, Niculescu 2014.

    Examples
    --------
    >>> import robustlab as rl
    >>> M = rl.StateSpaceModel([[-1.0]], [[-0.5]], [[1.0]], [[0.0]])
    >>> pole = rl.UncertainModel(M, [rl.RealScalar("pole")])  # s + 1 + 0.5 delta
    >>> found = rl.robust_stability(pole)
    >>> found.stable, round(found.upper, 6), round(rl.robust_stability(pole, frequency=[1.0]).lower, 6)
    (True, 2.0, inf)
    """
    given = dict(locals())
    for name in ("system", "seed", "effort"):
        del given[name]
    kind = kind_of(system, natures=natures, frequency=frequency)
    return ask("robust_stability", STABILITY, kind, (system,), given, HINTS, seed=seed, effort=effort)


@error_context("disk_margin")
def disk_margin(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    frequency: ArrayLike | None = None,
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    seed: int = 0,
    effort: float = 1.0,
    time_limit: float | None = None,
) -> DiskMargins:
    r"""Disk margins of the loop ``y = P u``, ``u = sign K y``, one loop at a time and all loops at once.

    .. math:: \alpha = 1 / \sup_\omega \mu\left( S(j\omega) + \tfrac{\sigma - 1}{2} I \right), \qquad S = (I + L)^{-1}

    Each loop is multiplied by a complex factor of the disk

    .. math:: f = \frac{1 + \frac{1 - \sigma}{2} \delta}{1 - \frac{1 + \sigma}{2} \delta}, \qquad |\delta| < \alpha .

    Parameters
    ----------
    plant, K
        Plant (p outputs, m inputs) and controller (m outputs, p inputs, or signals with names that the plant has), or
        the open loop L alone: models, either with exact delays, or UncertainFrequencyData without blocks.
    at
        Where the factors act: on the plant's outputs, its inputs, or both at once.
    frequency
        Frequencies in rad/s of the margins, without any claim between them. Data have their own.
    skew
        sigma: 0 balanced, positive if the gain is more likely to rise, negative if it is more likely to fall.
    sign
        -1 for negative feedback, 1 for positive; by default as stated by the controller, else negative.
    seed, effort, time_limit
        As in `robust_stability`.

    Returns
    -------
    DiskMargins
        ``lower`` proved and ``upper`` attained, of all loops at once; ``channels`` by the name of the plant's signal.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Sizes, names or sample times that do not fit; a sign that contradicts the controller; an option that this kind
        of loop does not have. The nominal loop is unstable, or not proved stable; a pole is at a given frequency.

    References
    ----------
    Seiler, Packard, Gahinet 2020, equations 9-17.

    Examples
    --------
    >>> import robustlab as rl
    >>> margin = rl.disk_margin(rl.tf([0.5, -0.5], [1, 1]))
    >>> round(margin.lower, 6), [round(g, 6) for g in margin.gain_margin]
    (0.666667, [0.5, 2.0])
    """
    kind = kind_of(plant, getattr(K, "K", K), frequency=frequency)
    if kind == SET and isinstance(plant, UncertainModel):
        if plant.blocks:
            hint = "robust_stability of the set with a disk block in its loop proves it for all (docs/analysis.md)"
            raise InputError("disk_margin: plant", "an UncertainModel", "one model, such as .nominal", hint)
        plant = plant.nominal
    given = {"frequency": frequency, "time_limit": time_limit}
    common: dict[str, Any] = {"at": at, "skew": skew, "sign": sign, "seed": seed, "effort": effort}
    return ask("disk_margin", DISK, kind, (plant, K), given, HINTS, **common)


@error_context("classical_margins")
def classical_margins(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    sign: Literal[-1, 1] | None = None,
) -> ClassicalMargins:
    r"""Gain, phase and delay margins of the loop ``y = P u``, ``u = sign K y``, one loop at a time, with all crossings.

    .. math:: |L(j\omega)| = 1, \qquad L(j\omega) < 0

    Each loop is opened alone, with the others closed. Crossings are computed in whole numbers from the matrices as
    given, without a grid; with delays they are found on a grid that is dense for the poles and the delays.

    Parameters
    ----------
    plant, K, sign
        As in `disk_margin`; no data.
    at
        Where the loops are opened: at the plant's outputs, its inputs, or both in turn.

    Returns
    -------
    ClassicalMargins
        One `ClassicalMargin` per channel by the name of the plant's signal. With delays there may be infinitely many
        crossings: they are listed up to the one that bounds the gain margin, factors from 1e-6 to 1000.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Sizes, names or sample times that do not fit, a sign that contradicts the controller, a closed loop that is not
        well posed; an uncertain plant. A loop whose gain is 1 at every frequency; more than 200 states; with delays a
        loop whose stability, or whose falling gain, could not be shown.

    References
    ----------
    Skogestad, Postlethwaite, section 2.4.

    Examples
    --------
    >>> import robustlab as rl
    >>> margin = rl.classical_margins(rl.tf([3], [1, 3, 2, 0]))  # 3 / (s (s + 1) (s + 2))
    >>> round(margin.gain_high, 9), round(margin.channels["y1"].phase_crossings[0].frequency ** 2, 9)
    (2.0, 2.0)
    """
    kind = kind_of(plant, getattr(K, "K", K))
    if kind in (SET, FREQUENCIES):
        found = "an uncertain plant, or data"
        raise InputError("classical_margins", found, "one model", "rl.disk_margin is that of the worst member")
    return ask("classical_margins", CLASSICAL, kind, (plant, K), {}, HINTS, at=at, sign=sign)
