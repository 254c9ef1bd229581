r"""Stability of a model with exact delays: proved by counting its roots or by a set that holds it, refuted by a root.

Stable: no root of the characteristic equation lies right of the axis (`root_count`), and none that Newton's method
finds. Where the roots cannot be counted: the set of `DelayedModel.uncertain` of some order is robustly stable on the
whole axis, with a margin above 1.
Unstable: the characteristic equation has a root in the open right half plane,

.. math:: F(s) v = 0, \qquad F(s) = \begin{bmatrix} sI - A & -B_1 \\ -C_1 & \mathrm{diag}(e^{s \tau_i}) - D_{11}
   \end{bmatrix},

found by Newton's method from the unstable poles of a rational model. That there is one is proved by Kantorovich's
theorem for :math:`G(v, s) = (F(s) v, c^* v - 1)`: with the Jacobian J at the point found, :math:`\eta = \|J^{-1} G\|`
and L a Lipschitz bound of J near it,

.. math:: h = \|J^{-1}\| L \eta \le \tfrac12 \quad \Rightarrow \quad \text{a root lies within } r = (1 - \sqrt{1 - 2h})
   / (\|J^{-1}\| L) .

References
----------
Kantorovich 1948; Michiels, Niculescu, *Stability, Control, and Computation for Time-Delay Systems* (2014), chapters 1
and 2; Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), theorem 11.8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab import checks
from robustlab.arrays import ComplexArray
from robustlab.delays.model import DelayedModel, as_delayed
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.mu_analysis.axis.margin import Margin, StabilityMargin
from robustlab.mu_analysis.axis.stability import robust_stability
from robustlab.mu_analysis.margins.root_count import RootCount, count_roots
from robustlab.norms.hinfinity import unstable_norm
from robustlab.result import Status
from robustlab.shown import Facts, number
from robustlab.statespace import StateSpaceModel

__all__ = ["DelayStability", "delay_stability"]

# Orders of the approximations that are tried one after the other.
ORDERS = (1, 2, 3, 4, 6, 8, 12, 16)
NEWTON_STEPS = 40
# Of the approximation whose poles lead to roots, where these are counted.
LOOKED_FOR = 6
# A start whose iteration runs beyond exp of this is given up.
FARTHEST = 500.0
# Rounding of an evaluation of F, in units of the sizes that enter it.
ROUNDING = 1e-15


@dataclass(frozen=True, eq=False)
class DelayStability(StabilityMargin):
    """Whether a model with exact delays is stable, and what shows it.

    Attributes
    ----------
    lower, upper
        Nothing is uncertain: both inf where the model is stable, both 0 where it is not, 0 and inf where neither could
        be shown.
    status
        CERTIFIED: stability is proved on the whole frequency axis, or a root in the right half plane is proved to be
        there; both in floating point. INCONCLUSIVE: neither, up to the highest order.
    order
        Order of Padé's approximations with which it was shown, or the last one that was tried; 0 where the roots were
        counted.
    margin
        Robust stability of the set of that order; ``margin.lower`` above 1 is the proof. None where the roots were
        counted, and where the set's nominal model was not stable.
    root
        A root of the characteristic equation in 1/s: in the right half plane where that is shown, else the rightmost
        that was found. None where none was.
    radius
        An exact root lies within this distance of ``root``, in 1/s; 0 for a pole of a part without delays in its loops,
        which is judged as a pole of a rational model.
    count
        How many roots lie right of the axis, with the cells that show it; None where they could not be counted.
    system
        The model, for `robustlab.verify`.
    """

    order: int
    margin: Margin | None
    root: complex | None
    radius: float
    count: RootCount | None = None
    system: DelayedModel | None = None

    @classmethod
    def of(cls, stable: bool | None, status: Status, *evidence: Any) -> DelayStability:
        """The verdict with its evidence: the fields from ``order`` on."""
        lower, upper = {True: (np.inf, np.inf), False: (0.0, 0.0), None: (0.0, np.inf)}[stable]
        return cls(lower, upper, None, status, {}, (), *evidence)

    @property
    def stable(self) -> bool | None:
        """True, False, or None where neither could be shown."""
        return True if self.lower > 0 else False if self.upper == 0 else None

    def headline(self) -> str:
        return {True: "proved stable", False: "proved unstable", None: "not proved stable"}[self.stable]

    def facts(self) -> Facts:
        verdict = {True: "yes: proved on the whole axis", False: "no: proved by a root", None: "undecided"}[self.stable]
        proved = f"{number(self.margin.lower)} (proved), with Padé of order {self.order}" if self.margin else ""
        counted = ""
        if self.count is not None:
            counted = f"{self.count.roots}, by the argument principle: {self.count.cells} cells of the axis"
        return [
            ("stable", verdict),
            ("roots right of the axis", counted),
            ("margin of the set", proved),
            ("root", number(self.root, "1/s")),
            ("exact root within", number(self.radius, "1/s") if self.root is not None and self.radius else ""),
        ]

    def to_json(self) -> dict[str, object]:
        kept = {name: x for name, x in vars(self).items() if name != "system"}
        return {"type": "DelayStability", "stable": self.stable, **kept}


@told_as("delay_stability")
def delay_stability(model: DelayedModel, highest_order: int = 16, effort: float = 1.0) -> DelayStability:
    """Of a model with exact delays: `robustlab.robust_stability`.

    Roots right of the axis are counted; a root that is found there has to agree. Where the count does not come to an
    end (a root on the axis, echoes that do not die away), orders 1, 2, 3, 4, 6, 8, 12, 16 of Padé's approximations are
    tried until one decides: its set is robustly stable, or one of its unstable poles leads to an unstable root of the
    model with its delays.
    """
    g = as_delayed(model, "delay_stability")
    if isinstance(highest_order, bool) or not isinstance(highest_order, int) or not 1 <= highest_order <= ORDERS[-1]:
        raise InputError("delay_stability: highest_order", f"{highest_order!r}", f"a number from 1 to {ORDERS[-1]}")
    checks.number("delay_stability: effort", effort, "a positive finite number", above=0)
    found = DelayStability.of(None, Status.INCONCLUSIVE, 0, None, None, np.inf)
    if (pole := _undelayed_pole(g)) is not None:
        return DelayStability.of(False, Status.CERTIFIED, 0, None, pole, 0.0, None, g)
    count = count_roots(g, effort) if len(g.delays) else None
    if count is not None and not count.roots:
        root, radius = _rightmost(g, g.pade(LOOKED_FOR))
        if root is None or root.real <= radius:
            return DelayStability.of(True, Status.CERTIFIED, 0, None, root, radius, count, g)
        text = f"no root right of the axis is counted, and {root:.6g} is one: digits were lost"
        raise NoTrustworthyNumber("delay_stability", text)
    for order in (n for n in ORDERS if n <= highest_order) if len(g.delays) else (0,):
        found = _tried(g, order, effort, count)
        if found.stable is not None:
            break
    return replace(found, system=g)


def _undelayed_pole(g: DelayedModel) -> complex | None:
    """Return a pole on or right of the axis of a part of the model whose loops hold no delay; None if there is none.

    Such a part is a strongly connected component of the graph of states and delays; its eigenvalues are poles of the
    model whatever the delays are.
    """
    from scipy.sparse.csgraph import connected_components

    h, n, k = g.H, g.H.n_states, len(g.delays)
    whole = np.block([[h.A, h.B[:, :k]], [h.C[:k], h.D[:k, :k]]])
    labels = connected_components(whole != 0, connection="strong")[1]
    for label in set(labels[:n]) - set(labels[n:]):
        part = np.flatnonzero(labels[:n] == label)
        A = h.A[part][:, part]
        norm = unstable_norm(StateSpaceModel(A, np.zeros((len(A), 1)), np.zeros((1, len(A))), [[0.0]]))
        if norm is not None and norm.status is Status.CERTIFIED:
            poles = np.linalg.eigvals(A)
            return complex(poles[poles.real.argmax()])
    return None


def _tried(g: DelayedModel, order: int, effort: float, count: RootCount | None) -> DelayStability:
    """What one order of approximation shows; where roots are counted on the right, only one of them is looked for."""
    rational = g.pade(order)
    root, radius = _rightmost(g, rational)
    if root is not None and root.real > radius:
        return DelayStability.of(False, Status.CERTIFIED, order, None, root, radius, count)
    margin = None
    if rational.is_stable() and count is None:
        try:
            margin = robust_stability(g.uncertain(order), expected=1.0, effort=effort)
        except NoTrustworthyNumber:  # a root on the axis, which rounding moves
            return DelayStability.of(None, Status.INCONCLUSIVE, order, None, root, radius, count)
        if margin.status is Status.CERTIFIED and margin.lower > 1.0:
            return DelayStability.of(True, Status.CERTIFIED, order, margin, root, radius)
    return DelayStability.of(None, Status.INCONCLUSIVE, order, margin, root, radius, count)


def _rightmost(g: DelayedModel, rational: StateSpaceModel) -> tuple[complex | None, float]:
    """The rightmost root that Newton's method finds from the rightmost poles of a rational model, and its radius."""
    poles = rational.poles()
    starts = [p for p in poles[np.argsort(-poles.real)] if p.imag >= 0][: max(6, int((poles.real > 0).sum()))]
    roots = [found for p in starts if (found := _newton(g, complex(p))) is not None]
    return max(roots, key=lambda found: found[0].real) if roots else (None, np.inf)


def _newton(g: DelayedModel, s: complex) -> tuple[complex, float] | None:
    """A root near s, and how near an exact one is proved to lie; None where none is."""
    n = g.H.n_states
    size = n + len(g.delays)
    if not size:
        return None
    v = np.linalg.svd(_characteristic(g, s))[2][-1].conj()
    normal = v.conj()
    for _ in range(NEWTON_STEPS):
        jacobian = np.zeros((size + 1, size + 1), dtype=complex)
        jacobian[:size, :size] = _characteristic(g, s)
        jacobian[:size, size] = np.concatenate([np.ones(n), g.delays * np.exp(s * g.delays)]) * v
        jacobian[size, :size] = normal
        rest = np.append(jacobian[:size, :size] @ v, normal @ v - 1.0)
        try:
            change = np.linalg.solve(jacobian, -rest)
        except np.linalg.LinAlgError:
            return None
        if np.linalg.norm(change) <= 1e-13 * (abs(s) + 1.0 / g.delays.max(initial=1e-300)):
            radius = _kantorovich(g, s, v, jacobian, float(np.linalg.norm(change)))
            return None if radius is None else (s, radius)
        v, s = v + change[:size], s + complex(change[size])
        if not np.isfinite(s) or (s * g.delays).real.max(initial=0.0) > FARTHEST:
            return None
    return None


def _kantorovich(g: DelayedModel, s: complex, v: ComplexArray, jacobian: ComplexArray, step: float) -> float | None:
    """Radius about (v, s) in which an exact root lies; None where the theorem does not give one."""
    n = g.H.n_states
    smallest = float(np.linalg.svd(jacobian, compute_uv=False)[-1])
    if not smallest > 0.0:  # a double root, or none
        return None
    inverse = 1.0 / smallest
    entries = float(np.linalg.norm(np.block([[g.H.A, g.H.B[:, : len(g.delays)]]]))) + abs(s) * n
    entries += float(np.linalg.norm(np.hstack([g.H.C[: len(g.delays)], g.H.D[: len(g.delays), : len(g.delays)]])))
    entries += float(np.linalg.norm(np.exp((s * g.delays).real)))
    eta = step + inverse * ROUNDING * (len(v) + 1) * entries * float(np.linalg.norm(v))
    near = 4.0 * eta  # the neighbourhood in which the Jacobian's slope is bounded
    size = float(np.linalg.norm(v)) + near
    with np.errstate(over="ignore"):  # a neighbourhood that wide proves nothing: h below is then no small number
        growth = np.exp((s.real + near) * g.delays)
    first, second = max(1.0, (g.delays * growth).max(initial=0.0)), (g.delays**2 * growth).max(initial=0.0)
    slope = 2.0 * first + second * size
    h = inverse * slope * eta
    if not h <= 0.5:
        return None
    radius = 2.0 * eta / (1.0 + np.sqrt(1.0 - 2.0 * h))  # the same as above, without cancellation
    return float(radius) if radius <= near else None


def _characteristic(g: DelayedModel, s: complex) -> ComplexArray:
    """F(s), a square matrix of the states and the delays."""
    k, n = len(g.delays), g.H.n_states
    made = np.zeros((n + k, n + k), dtype=np.complex128)
    made[:n, :n], made[:n, n:] = s * np.eye(n) - g.H.A, -g.H.B[:, :k]
    made[n:, :n], made[n:, n:] = -g.H.C[:k], np.diag(np.exp(s * g.delays)) - g.H.D[:k, :k]
    return made
