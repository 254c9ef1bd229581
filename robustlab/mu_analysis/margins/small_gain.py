"""Small-gain test: robust stability against one full block, by the H-infinity norm of what the block sees.

Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), theorem 9.1. (Březina 2010, section 4.2.4, mixes the loops at
the input and at the output of the plant in the input forms.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from robustlab.closing import closing
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.linear_analysis.structural import with_hidden
from robustlab.mu_analysis.constants import SINGULAR
from robustlab.mu_analysis.matrix.certificate import singularity
from robustlab.norms import HinfNorm, hinf_norm
from robustlab.result import Bracket, Status
from robustlab.shown import Facts, bracket, number
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import realise_delta

NORM_WIDTH = 1e-9  # relative width of the bracket of the small-gain test's norm

__all__ = ["SmallGain", "peak_response", "replayed_pole", "signed", "small_gain"]


@dataclass(frozen=True, eq=False)
class SmallGain(Bracket):
    """Whether a loop is stable for every stable Delta of norm one, and by which factor.

    Attributes
    ----------
    robustly_stable
        True where ``norm.upper < 1``, False where ``norm.lower >= 1``, None where the bracket holds 1.
    lower, upper
        ``lower <= margin <= upper``: stable for every Delta of norm below ``lower = 1 / norm.upper``; ``upper`` is the
        norm of ``delta``. Both are inf where Delta has no effect.
    frequency
        Frequency of the peak in rad/s; ``inf`` where the direct term is largest. None without effect.
    delta
        The least Delta that puts a pole on the stability boundary there: of rank one, shape (rows, cols), by the name
        of the block. Empty without effect.
    pole
        The pole of the loop with ``delta`` realised as a stable system that lies next to the stability boundary at that
        frequency; None where the loop is then ill-posed (``frequency`` inf, or no states) or without effect.
    norm
        H-infinity norm of M, with its own evidence.
    M
        What Delta sees: the closed-loop model from w to z.
    status
        CERTIFIED, or INACCURATE where the norm is, or where ``pole`` is not where it was foretold.
    loop
        The law that closes the loop, and who says so; empty where it was closed already.
    system, K
        The set, and the controller u = K y of its last outputs and inputs (None where there is none), for
        `robustlab.verify`.
    """

    robustly_stable: bool | None
    delta: Mapping[str, NDArray[np.complex128]]
    pole: complex | None
    norm: HinfNorm
    M: StateSpaceModel
    loop: str = ""
    system: UncertainModel | None = None
    K: StateSpaceModel | None = None

    quantities: ClassVar[Mapping[str, Any]] = {
        "lower": "1", "upper": "1", "frequency": "rad/s", "robustly_stable": bool,
    }  # fmt: skip

    def headline(self) -> str:
        words = {True: "stable for every stable Delta of norm one", False: "not robustly stable", None: "undecided"}
        return words[self.robustly_stable]

    def facts(self) -> Facts:
        answer = {True: "yes, for every stable Delta of norm one", False: "no", None: "undecided"}[self.robustly_stable]
        return [
            ("loop", self.loop),
            ("robustly stable", answer),
            ("margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("norm of the loop", bracket(self.norm.lower, self.norm.upper, ("attained", "proved"))),
            ("at", number(self.frequency, "rad/s")),
        ]

    def to_json(self) -> dict[str, Any]:
        names = [name for name in vars(self) if name not in ("system", "K")]
        return {"type": "SmallGain", **{name: getattr(self, name) for name in names}}


@told_as("small_gain")
def small_gain(uncertain: UncertainModel, K: Any = None, *, sign: Literal[-1, 1] | None = None) -> SmallGain:
    r"""Small-gain test of an uncertain model with one full block, closed by a controller.

    Parameters
    ----------
    uncertain
        What `robustlab.uncertainty.unstructured.unstructured` makes, or any other set with one full block.
    K
        Controller ``u = sign K y`` from all outputs to all inputs; left out where the loop is closed already.
    sign
        -1 for negative feedback, 1 for positive feedback; left out: as in `disk_margin`.

    Returns
    -------
    SmallGain
        The verdict, bounds of the margin, and the Delta (rows, cols) that destabilises first.

    Raises
    ------
    InputError
        Several blocks, or a real one (use `robust_stability`); a K whose size does not fit.
    NoTrustworthyNumber
        The nominal loop is unstable.

    Examples
    --------
    >>> from robustlab.uncertainty.unstructured import unstructured
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> test = small_gain(unstructured(lag, 0.5, "input-multiplicative"), StateSpaceModel([], [], [], [[3.0]]))
    >>> test.robustly_stable, round(test.upper, 6)
    (True, 2.666667)
    """
    if not isinstance(uncertain, UncertainModel):
        raise InputError("small_gain", type(uncertain).__name__, "an UncertainModel")
    blocks = uncertain.blocks
    if len(blocks) != 1 or blocks[0].is_scalar or not blocks[0].is_ball:
        raise InputError("small_gain", f"{uncertain!r}", "one full block", "use robust_stability")
    system, law, said = uncertain, None, ""
    if K is not None:
        found = closing(uncertain, K, sign, "small_gain")
        system, law, said = found.plant, signed(as_model(found.K), found.sign), found.said
    closed = system if law is None else system.close(law)
    M = closed.delta_channels
    norm = hinf_norm(M, rtol=NORM_WIDTH)
    if not np.isfinite(norm.upper):
        raise NoTrustworthyNumber(
            "small_gain",
            with_hidden(f"nominal closed loop {'unstable' if norm.lower else 'not surely stable'} ({norm.reason})", M),
            "a stable nominal loop",
            "check the sign of the feedback: sign=-1 or sign=1",
        )
    if norm.lower == 0:
        lower, holds = _inverse(norm.upper), norm.upper < 1
        return SmallGain(lower, float("inf"), None, norm.status, holds, {}, None, norm, M, said, system, law)
    frequency, response = peak_response(M, norm)
    u, sigma, vh = np.linalg.svd(response)
    # (I - M Delta) u1 = 0
    delta = np.outer(vh[0].conj(), u[:, 0].conj()) / sigma[0]
    name = blocks[0].name
    delta.setflags(write=False)
    pole, on_axis = replayed_pole(closed, {name: delta}, frequency)
    found = singularity(response, delta) <= SINGULAR and on_axis
    status = norm.status if found else Status.INACCURATE
    stable = True if norm.upper < 1 else False if norm.lower >= 1 else None
    upper = 1 / float(sigma[0])
    return SmallGain(
        _inverse(norm.upper), upper, frequency, status, stable, {name: delta}, pole, norm, M, said, system, law
    )


def peak_response(M: StateSpaceModel, norm: HinfNorm) -> tuple[float, NDArray[np.complex128]]:
    """Frequency of the peak, and M there; an end of the axis, where M is real, if the peak is as high there."""
    end = np.pi / M.dt if M.is_discrete else np.inf
    for omega in (0.0, end):
        response = frequency_response(M, [omega])[0]
        if np.linalg.norm(response, 2) >= norm.lower * (1 - NORM_WIDTH):
            return omega, response
    return norm.frequency, frequency_response(M, [norm.frequency])[0]


def replayed_pole(closed: UncertainModel, delta: Mapping[str, Any], frequency: float) -> tuple[complex | None, bool]:
    """The pole next to the stability boundary at ``frequency`` of the loop with Delta realised as stable systems."""
    if not np.isfinite(frequency) or not closed.M.n_states:
        return None, True
    made = realise_delta(closed.blocks, delta, frequency, closed.dt)
    try:
        poles = closed.evaluate(made).poles()
    except NoTrustworthyNumber:  # singular in the direct term as well
        return None, True
    at = np.exp(1j * frequency * closed.dt) if closed.dt else 1j * frequency
    pole = complex(poles[np.abs(poles - at).argmin()])
    fastest = max(np.abs(poles).max(), np.abs(closed.M.poles()).max())
    return pole, bool(abs(pole - at) <= 1e-6 * abs(at) + 1e-9 * fastest)


def signed(K: StateSpaceModel, sign: int) -> StateSpaceModel:
    """``sign K``: positive feedback ``u = K y`` is what an LFT closes."""
    if sign not in (-1, 1):
        raise InputError("sign", f"{sign!r}", "-1 (negative feedback) or 1 (positive feedback)")
    return StateSpaceModel(K.A, K.B, sign * K.C, sign * K.D, K.dt)


def _inverse(value: float) -> float:
    return 1 / value if value else float("inf")
