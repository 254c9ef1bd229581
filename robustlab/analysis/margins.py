r"""Disk margins and classical margins of a loop of any type of models.

Each loop is multiplied by a complex factor of the disk

.. math:: f = \frac{1 + \frac{1 - \sigma}{2} \delta}{1 - \frac{1 + \sigma}{2} \delta}, \qquad |\delta| < \alpha .

References
----------
Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020); Skogestad,
Postlethwaite, *Multivariable Feedback Control*, section 2.4.
"""

from __future__ import annotations

from typing import Any, Literal

from numpy.typing import ArrayLike

from robustlab.analysis.kinds import options_of
from robustlab.delays.model import DelayedModel
from robustlab.errors import InputError, error_context
from robustlab.mu_analysis.margins.classical import ClassicalMargins
from robustlab.mu_analysis.margins.disk_margin import DiskMargins, Place
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel


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

    For a rational loop, one with exact delays, frequency-response data, or given frequencies.

    Parameters
    ----------
    plant
        Plant P (p outputs, m inputs), or the whole open loop L, square, if K is omitted: a model, a
        DelayedModel, or UncertainFrequencyData without blocks.
    K
        Controller (m outputs, p inputs), or one whose signals have names that the plant has too. It may be delayed.
    at
        Where the factors act: on the plant's outputs, its inputs, or both at once.
    frequency
        Frequencies in rad/s of the margins, without any claim between them. Data have their own.
    skew
        sigma: 0 balanced, positive if the gain is more likely to rise, negative if it is more likely to fall.
    sign
        -1 for negative feedback, 1 for positive feedback. By default as stated by the controller, as for every designed
        one, else negative.
    seed, effort
        Seed of the searches, and their work as a multiple of the usual, counted, not timed.
    time_limit
        Time limit in s of all searches over the axis. If it is reached, the result depends on the machine.

    Returns
    -------
    DiskMargins
        ``lower`` proved and ``upper`` attained, of all loops at once; ``channels`` by the name of the plant's signal.
        `DiskMarginsAt` has more evidence.

    Raises
    ------
    InputError
        Sizes, names or sample times that do not fit; a skew that is not finite; a sign that contradicts the controller;
        an option that this type of loop does not have.
    NoTrustworthyNumber
        The nominal loop is unstable, or not proved stable; a pole is at a given frequency.

    References
    ----------
    Seiler, Packard, Gahinet (2020), equations 9-17.

    Examples
    --------
    >>> import robustlab as rl
    >>> margin = rl.disk_margin(rl.tf([0.5, -0.5], [1, 1]))
    >>> round(margin.lower, 6), [round(g, 6) for g in margin.gain_margin]
    (0.666667, [0.5, 2.0])
    >>> late = rl.disk_margin(rl.tf([2], [1, 1]) @ rl.delay(0.5))
    >>> str(late.status), round(late.upper, 3)
    ('certified', 0.573)
    >>> rl.disk_margin(rl.tf([1], [1, 0]), frequency=[1.0]).lower.__round__(6)
    2.0
    """
    given = {"time_limit": time_limit}
    loop: dict[str, Any] = {"at": at, "skew": skew, "sign": sign, "seed": seed}
    kinds = plant, getattr(K, "K", K)
    if frequency is not None or isinstance(plant, UncertainFrequencyData):
        from robustlab.mu_analysis.margins.at_frequencies import disk_margin_at

        options_of(
            "disk_margin", "a loop at given frequencies", given, {}, "leave the frequencies out for the whole axis"
        )
        return disk_margin_at(plant, K, frequency, **loop)
    if any(isinstance(part, DelayedModel) for part in kinds):
        from robustlab.mu_analysis.margins.delay_margins import delay_disk_margins

        options_of("disk_margin", "a loop with exact delays", given, {}, ".uncertain(order) makes a set of it")
        return delay_disk_margins(plant, K, effort=effort, **loop)
    if isinstance(plant, UncertainModel) and not plant.blocks:
        plant = plant.nominal
    if isinstance(plant, UncertainModel):
        hint = "robust_stability of the set with a disk block in its loop proves it for every member (docs/analysis.md)"
        raise InputError("disk_margin: plant", "an UncertainModel", "one model, such as .nominal", hint)
    from robustlab.mu_analysis.margins.disk_margin import disk_margin as of_model

    chosen = options_of("disk_margin", "a model without delays", given, {"time_limit": "time_limit"})
    return of_model(plant, K, effort=effort, **loop, **chosen)


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
    plant
        Plant P (p outputs, m inputs), or the whole open loop L, square, if K is omitted: a model or a DelayedModel.
    K
        Controller (m outputs, p inputs), or one whose signals have names that the plant has too. It may be delayed.
    at
        Where the loops are opened: at the plant's outputs, its inputs, or both in turn.
    sign
        -1 for negative feedback, 1 for positive feedback; by default as in `disk_margin`.

    Returns
    -------
    ClassicalMargins
        One `ClassicalMargin` per channel by the name of the plant's signal. With delays there may be infinitely many
        crossings: they are listed up to the one that bounds the gain margin, factors from 1e-6 to 1000.

    Raises
    ------
    InputError
        Sizes, names or sample times that do not fit, a sign that contradicts the controller, a closed loop that is not
        well posed; an uncertain plant; a discrete one with delays.
    NoTrustworthyNumber
        A loop whose gain is 1 at every frequency: it has no crossings; take `disk_margin`. More than 200 states. With
        delays: it could not be shown whether the closed loop is stable, or that its gain falls.

    References
    ----------
    Skogestad, Postlethwaite, section 2.4.

    Examples
    --------
    >>> import robustlab as rl
    >>> margin = rl.classical_margins(rl.tf([3], [1, 3, 2, 0]))  # 3 / (s (s + 1) (s + 2))
    >>> round(margin.gain_high, 9), round(margin.channels["y1"].phase_crossings[0].frequency ** 2, 9)
    (2.0, 2.0)
    >>> late = rl.classical_margins(rl.tf([1], [1, 0]) @ rl.delay(0.5))  # e^(-s/2) / s
    >>> [round(x, 6) for x in (late.gain_high, late.phase, late.delay)]
    [3.141593, 1.070796, 1.070796]
    """
    kinds = plant, getattr(K, "K", K)
    if any(isinstance(part, (UncertainModel, UncertainFrequencyData)) for part in kinds):
        found = "an uncertain plant, or data"
        raise InputError("classical_margins", found, "one model", "rl.disk_margin is that of the worst member")
    if any(isinstance(part, DelayedModel) for part in kinds):
        from robustlab.mu_analysis.margins.delay_margins import delay_classical_margins

        return delay_classical_margins(plant, K, at=at, sign=sign)
    from robustlab.mu_analysis.margins.classical import classical_margins as of_model

    return of_model(plant, K, at=at, sign=sign)
