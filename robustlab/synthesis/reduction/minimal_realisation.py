"""Minimal realisation: the model of least order with the same gain, whatever its stability."""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.checks import number
from robustlab.errors import told_as
from robustlab.linear_analysis.structural import least_order
from robustlab.norms import HinfNorm
from robustlab.result import Status
from robustlab.statespace import as_model
from robustlab.synthesis.reduction.balancing import lost_at_least_order
from robustlab.synthesis.reduction.reduced_model import ReducedModel
from robustlab.synthesis.reduction.split_error import NEAR, SplitError

__all__ = ["minimal"]


@told_as("minimal")
def minimal(model: Any, *, tolerance: float | None = None) -> ReducedModel:
    r"""Remove the modes that no input moves or no output shows, unstable and integrating ones too.

    The controllable subspace is built by orthogonal steps, ``range(B), A range(B), ...``, in states and signals scaled
    so that no unit matters, then the observable one of what is left. The states kept are a subset of those given, or
    sums of them with short factors where these are exact, so that integer data are reduced without rounding.

    Parameters
    ----------
    model
        StateSpaceModel, controller or python-control object; continuous or discrete, stable or not.
    tolerance
        Singular values of the scaled steps up to this count as zero. Where left out, those below 1e-14 do, and those
        below 1e-10 where the eigenvalues confirm it.

    Returns
    -------
    ReducedModel
        Of method ``"minimal"``, with the certified largest gain of the difference of both models (zero where
        everything cancels exactly), and the modes that were removed. INACCURATE where the order depends on rounding.

    Raises
    ------
    InputError
        No linear model, a tolerance that is not between 0 and 1.

    References
    ----------
    Van Dooren, "The generalized eigenstructure problem in linear system theory", IEEE TAC 26 (1981).

    Examples
    --------
    Two copies of an integrator, one behind a lag; the input moves their difference by the lag alone:

    >>> from robustlab.realisations import ss
    >>> G = ss([[0, 0, 0], [0, -1, 0], [0, 1, 0]], [[1], [1], [0]], [[1, 0, 0], [0, 0, 1]], [[0], [0]])
    >>> found = minimal(G)
    >>> found.order, found.error.upper, found.removed
    (2, 0.0, ('unstable mode 0 rad/s in x1, x2, x3: no input moves it',))
    """
    full = as_model(model, "minimal")
    if tolerance is not None:
        number("minimal: tolerance", tolerance, "a number between 0 and 1", above=0, below=1)
    found = least_order(full, tolerance)
    poles = full.poles()
    inside = 1 - np.abs(poles) if full.is_discrete else -poles.real
    stable = inside > NEAR * np.abs(poles).max(initial=0.0)
    lost = SplitError(lost_at_least_order(found), poles[~stable], poles[stable], full.dt).bound(0.0)
    unclear = f"the order depends on rounding: a singular value of {found.dropped:.1e} counted as zero; tolerance="
    reason = lost.reason or ("" if found.clear else unclear)
    status = Status.INACCURATE if reason else Status.CERTIFIED
    proved = Status.INACCURATE if lost.reason else Status.CERTIFIED
    return ReducedModel(
        found.model, "minimal", HinfNorm(0.0, lost.upper, np.nan, proved, lost.reason), np.nan, np.zeros(0), 0, full,
        status, reason, left_out=lost.left_out, removed=tuple(mode.meaning for mode in found.hidden),
    )  # fmt: skip
