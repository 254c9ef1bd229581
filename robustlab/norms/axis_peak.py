"""L-infinity norm: the peak gain over the frequency axis, of models that may be unstable."""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.errors import InputError, told_as
from robustlab.exact_stability import exactly_on_boundary
from robustlab.magnitude import moderated
from robustlab.norms.hinfinity import (
    FAR,
    HinfNorm,
    bracketed_norm,
    eigenvalue_blur,
    norm_as_given,
    pole_text,
)
from robustlab.norms.level_set import TUNING, NormTuning
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model

__all__ = ["linf_norm"]


@told_as("linf_norm")
def linf_norm(model: Any, rtol: float = 1e-6, *, tuning: NormTuning = TUNING) -> HinfNorm:
    r"""L-infinity norm as a bracket: the peak gain over the frequency axis of a model that may be unstable.

    .. math:: \|G\|_{L_\infty} = \sup_\omega \sigma_{max}(G(j\omega)) \qquad (G(e^{j\omega dt}) \text{ for } dt > 0)

    The bracket of `robustlab.hinf_norm`, whose level test needs no pole on the axis but no stability either. For a
    stable model both norms are the same; an unstable one has no H-infinity norm, and this one bounds no signals.

    Parameters
    ----------
    model
        Model with any numbers of states, inputs and outputs, including zero; or a python-control object.
    rtol
        Relative width of the bracket.
    tuning
        How hard it is looked for.

    Returns
    -------
    HinfNorm
        Infinite for a model with a pole on the stability boundary, reachable or not. Whether a pole lies there is
        decided in exact arithmetic up to 12 states; beyond them a pole that rounding cannot tell from the boundary
        makes the norm infinite with status INACCURATE.

    Raises
    ------
    InputError
        No model, or an ``rtol`` that is not between 1e-12 and 1.
    NoTrustworthyNumber
        The norm is larger than the largest floating-point number.

    References
    ----------
    Boyd, Balakrishnan 1990; Bruinsma, Steinbuch 1990.

    Examples
    --------
    >>> runaway = StateSpaceModel([[2.0]], [[1.0]], [[6.0]], [[0.0]])
    >>> norm = linf_norm(runaway)
    >>> norm.value, norm.frequency, norm.status.value
    (3.0, 0.0, 'certified')
    """
    given = as_model(model, "linf_norm")
    if not 1e-12 <= rtol < 1:
        raise InputError("linf_norm", f"rtol is {rtol}", "between 1e-12 and 1")
    ordinary = moderated(given, "linf_norm")
    return norm_as_given(bracketed_norm(ordinary, rtol, tuning, _on_the_boundary), ordinary)


def _on_the_boundary(m: StateSpaceModel, rate: int) -> HinfNorm | None:
    """The infinite norm of a model with a pole on the stability boundary, or None; poles are told times ``2^rate``."""
    poles = m.poles()
    distance = np.abs(np.abs(poles) - 1 if m.is_discrete else poles.real)
    nearest, blur = int(distance.argmin()), eigenvalue_blur(m)
    # Eigenvalues of Jordan blocks are known to far fewer digits; well away there is no doubt.
    if distance[nearest] > FAR * blur:
        return None
    there = exactly_on_boundary(m.A, m.is_discrete)
    if not there and distance[nearest] > blur:
        return None
    pole = complex(poles[nearest])
    if not m.is_discrete:
        pole = complex(np.ldexp(pole.real, rate), np.ldexp(pole.imag, rate))
    if there:
        text = f"pole {pole_text(pole)} is on the stability boundary"
        return HinfNorm(np.inf, np.nan, np.inf, np.inf, Status.CERTIFIED, text)
    text = f"pole {pole_text(pole)} cannot be told from the stability boundary"
    return HinfNorm(np.inf, np.nan, 0.0, np.inf, Status.INACCURATE, text)
