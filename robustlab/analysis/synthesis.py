"""H-infinity synthesis for any type of plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, overload

from robustlab.errors import InputError, error_context
from robustlab.synthesis.hinf.hinf_synthesis import hinf as rational
from robustlab.synthesis.problem.design import HinfSynthesis
from robustlab.synthesis.scheduling.parameter_varying import LPVModel
from robustlab.synthesis.scheduling.scheduled_synthesis import LPVSynthesis, scheduled_hinf


@overload
def hinf(  # pyright: ignore[reportOverlappingOverload]
    P: LPVModel,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> LPVSynthesis: ...
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

    Two Riccati equations (Glover, Doyle; general D11, D22) on a regularised plant in two scalings. Nothing is assumed
    about the ranks of D12 and D21 or about zeros on the axis; every controller is verified on P as given, and gamma is
    the verified norm of the loop rebuilt from the returned K.
    A discrete P is mapped by the bilinear rule and verified in discrete time.

    The controller ``u = K(rho) y`` of a scheduled plant (`LPVModel`) is scheduled by the same measured parameters and
    does not need their rates; gamma bounds the induced gain over all their trajectories, by a quadratic Lyapunov
    function:

    .. math:: \min_{K(\cdot)} \; \sup_{\rho(\cdot)} \sup_{w \ne 0} \|z\|_2 / \|w\|_2

    Parameters
    ----------
    P
        Generalised plant: `GeneralizedPlant`, StateSpaceModel, UncertainModel (with its perturbation channels as w and
        z), `LPVModel`, or python-control object; inputs [w; u], outputs [z; y], the ``n_con`` controls and ``n_meas``
        measurements last. An LPV model has no direct term from u to y; where its B2, C2, D12 or D21 depend on the
        parameters the loop bends between the points, and a finer grid (`LPVModel.refined`) reduces the loss.
    n_meas, n_con
        Numbers of measurements and controls; omitted for a `GeneralizedPlant`.
    gamma_rel
        Largest ratio of gamma of the returned controller to the smallest gamma found (>= 1); within it the controller
        with the slowest poles is returned. 1 gives the smallest gamma, whose controller often is too fast.
    time_limit, effort
        s, after which the controller verified by then is returned with status TIMEOUT, which depends on the machine;
        multiple of the usual work, counted, not timed.
    progress
        Called with one short line after every stage.

    Returns
    -------
    HinfSynthesis or LPVSynthesis
        Always with a stabilising, verified K: ``K``, ``gamma``, ``closed_loop``, ``status`` and ``reason`` of `Design`,
        and of an LPV model ``gain``, the result of `peak_gain`.

    Raises
    ------
    InputError, NoTrustworthyNumber
        Numbers of channels that P does not have, ``gamma_rel`` below 1, an option that P's type does not have. A mode
        that no controller can stabilise (named), or no controller could be verified; the LMIs of an LPV model have no
        solution.

    References
    ----------
    Glover, Doyle 1988; Doyle, Glover, Khargonekar, Francis 1989; Zhou, Doyle, Glover 1996, chapters 16 and 17;
    Gahinet, Apkarian 1994. Scheduled: Apkarian, Gahinet, Becker 1995; Wu, Yang, Packard, Becker 1996.

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
            expected = "a plant without measured parameters, or none"
            raise InputError("synth hinf: gamma_rel", "given with an LPVModel", expected)
        return scheduled_hinf(P, n_meas, n_con, effort, time_limit, progress)
    return rational(P, n_meas, n_con, gamma_rel=gamma_rel, time_limit=time_limit, effort=effort, progress=progress)
