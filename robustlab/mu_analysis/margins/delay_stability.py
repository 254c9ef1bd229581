r"""Stability of a model with exact delays: proved by a set that holds it, or refuted by a root.

Stable: the set of `DelayedModel.uncertain` of some order is robustly stable on the whole axis, with a margin above 1.
Unstable: the characteristic equation has a root in the open right half plane,

.. math:: F(s) v = 0, \qquad F(s) = \begin{bmatrix} sI - A & -B_1 \\ -C_1 & \mathrm{diag}(e^{s \tau_i}) - D_{11}
   \end{bmatrix},

found by Newton's method from the unstable poles of a rational model. Its residual is the smallest change of the
matrices of H for which the root is one exactly: the smallest singular value of F, relative to their norm.

References
----------
Michiels, Niculescu, *Stability, Control, and Computation for Time-Delay Systems* (2014), chapters 1 and 2; Zhou, Doyle,
Glover, *Robust and Optimal Control* (1996), theorem 11.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import ComplexArray
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, told_as
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.stability import robust_stability
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.statespace import StateSpaceModel

__all__ = ["DelayStability", "delay_stability"]

# Orders of the approximations that are tried one after the other.
ORDERS = (1, 2, 3, 4, 6, 8, 12, 16)
NEWTON_STEPS = 30
# A residual below this is rounding; a root has to lie further right than this share of its size.
RESIDUAL, CLEAR = 1e-11, 1e-8


@dataclass(frozen=True, eq=False)
class DelayStability(Shown):
    """Whether a model with exact delays is stable, and what shows it.

    Attributes
    ----------
    stable
        True, False, or None where neither could be shown.
    status
        CERTIFIED: stability is proved on the whole frequency axis. CONVERGED: a root in the right half plane was found
        and its residual evaluated again. INCONCLUSIVE: neither, up to the highest order.
    order
        Order of Padé's approximations with which it was shown, or the last one that was tried.
    margin
        Robust stability of the set of that order; ``margin.lower`` above 1 is the proof. None where its nominal model
        was not stable.
    root
        A root of the characteristic equation in 1/s: in the right half plane where that is shown, else the rightmost
        that was found. None where none was.
    residual
        Relative change of H that makes ``root`` exact.
    """

    stable: bool | None
    status: Status
    order: int
    margin: Margin | None
    root: complex | None
    residual: float

    def facts(self) -> Facts:
        """The verdict and what it rests on."""
        verdict = {True: "yes: proved on the whole axis", False: "no", None: "undecided"}[self.stable]
        proved = f"{number(self.margin.lower)} (proved), with Padé of order {self.order}" if self.margin else ""
        return [
            ("stable", verdict),
            ("margin of the set", proved),
            ("root", number(self.root, "1/s")),
            ("residual of the root", number(self.residual) if self.root is not None else ""),
        ]

    def to_json(self) -> dict[str, object]:
        """All attributes."""
        return {"type": "DelayStability", **vars(self)}


@told_as("delay_stability")
def delay_stability(model: DelayedModel, highest_order: int = 16, effort: float = 1.0) -> DelayStability:
    r"""Whether a model with exact delays, a closed loop for example, is stable.

    Orders 1, 2, 3, 4, 6, 8, 12, 16 of Padé's approximation are tried until one decides: its set is robustly stable, or
    one of its unstable poles leads to an unstable root of the model with its delays. The nearer the loop is to the
    stability boundary, and the more the delays turn within its bandwidth, the higher the order.

    Parameters
    ----------
    model
        A DelayedModel, or a model without delays.
    highest_order
        Up to which order to try, 1 to 16.
    effort
        Work that each proof may take, as a multiple of the usual.

    Returns
    -------
    DelayStability
        The verdict with its evidence: the proved margin of the set, or the root and its residual.

    Raises
    ------
    InputError
        A discrete or an uncertain model, an order out of range.

    Examples
    --------
    >>> from robustlab.delays import delay
    >>> integrator = StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> [delay_stability((integrator @ delay(tau)).feedback()).stable for tau in (1.5, 1.65)]  # the limit is pi / 2
    [True, False]
    """
    g = as_delayed(model, "delay_stability")
    if isinstance(highest_order, bool) or not isinstance(highest_order, int) or not 1 <= highest_order <= ORDERS[-1]:
        raise InputError("delay_stability: highest_order", f"{highest_order!r}", f"a number from 1 to {ORDERS[-1]}")
    found = DelayStability(None, Status.INCONCLUSIVE, 0, None, None, np.inf)
    for order in (n for n in ORDERS if n <= highest_order):
        found = _tried(g, order, effort)
        if found.stable is not None:
            break
    return found


def _tried(g: DelayedModel, order: int, effort: float) -> DelayStability:
    """What one order of approximation shows."""
    rational = g.pade(order)
    root, residual = _rightmost(g, rational)
    if root is not None and residual <= RESIDUAL and root.real > CLEAR * abs(root):
        return DelayStability(False, Status.CONVERGED, order, None, root, residual)
    margin = None
    if rational.is_stable():
        margin = robust_stability(g.uncertain(order), expected=1.0, effort=effort)
        if margin.status is Status.CERTIFIED and margin.lower > 1.0:
            return DelayStability(True, Status.CERTIFIED, order, margin, root, residual)
    return DelayStability(None, Status.INCONCLUSIVE, order, margin, root, residual)


def _rightmost(g: DelayedModel, rational: StateSpaceModel) -> tuple[complex | None, float]:
    """The rightmost root that Newton's method finds from the rightmost poles of a rational model, and its residual."""
    poles = rational.poles()
    starts = [p for p in poles[np.argsort(-poles.real)] if p.imag >= 0][: max(6, int((poles.real > 0).sum()))]
    roots = [found for p in starts if (found := _newton(g, complex(p))) is not None]
    good = [found for found in roots if found[1] <= RESIDUAL]
    return max(good, key=lambda found: found[0].real) if good else (None, np.inf)


def _newton(g: DelayedModel, s: complex) -> tuple[complex, float] | None:
    """A root near s and its residual; None where the iteration goes nowhere."""
    n = g.H.n_states
    size = n + len(g.delays)
    if not size:
        return None
    _, _, right = np.linalg.svd(_characteristic(g, s))
    v = right[-1].conj()
    normal = v.conj()
    for _ in range(NEWTON_STEPS):
        slope = np.concatenate([np.ones(n), g.delays * np.exp(s * g.delays)])
        bordered = np.zeros((size + 1, size + 1), dtype=complex)
        bordered[:size, :size] = _characteristic(g, s)
        bordered[:size, size], bordered[size, :size] = slope * v, normal
        rest = np.append(bordered[:size, :size] @ v, normal @ v - 1.0)
        try:
            change = np.linalg.solve(bordered, -rest)
        except np.linalg.LinAlgError:
            return None
        v, s = v + change[:size], s + complex(change[size])
        if not np.isfinite(s) or (s * g.delays).real.max(initial=0.0) > 500.0:
            return None
        if abs(change[size]) <= 1e-14 * abs(s):
            break
    return s, _residual(g, s)


def _residual(g: DelayedModel, s: complex) -> float:
    n, k = g.H.n_states, len(g.delays)
    H = np.block([[g.H.A, g.H.B[:, :k]], [g.H.C[:k], g.H.D[:k, :k]]])
    smallest = float(np.linalg.svd(_characteristic(g, s), compute_uv=False)[-1])
    return smallest / (float(np.linalg.norm(H, 2)) or 1.0) if n + k else np.inf


def _characteristic(g: DelayedModel, s: complex) -> ComplexArray:
    """F(s), a square matrix of the states and the delays."""
    k, n = len(g.delays), g.H.n_states
    made = np.zeros((n + k, n + k), dtype=np.complex128)
    made[:n, :n], made[:n, n:] = s * np.eye(n) - g.H.A, -g.H.B[:, :k]
    made[n:, :n], made[n:, n:] = -g.H.C[:k], np.diag(np.exp(s * g.delays)) - g.H.D[:k, :k]
    return made
