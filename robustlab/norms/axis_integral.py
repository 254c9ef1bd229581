r"""Integrals over the frequency axis, and the H2 norm as one: a voice that solves no Lyapunov equation.

.. math:: \|G\|_2^2 = \frac{1}{\pi} \int_0^\infty \|G(j\omega)\|_F^2 \, d\omega, \qquad
    \|G\|_2^2 = \frac{1}{\pi} \int_0^\pi \|G(e^{j\theta})\|_F^2 \, d\theta \quad (dt > 0)

The second comes from the model's modes in closed form, by residues, where the bound of its error allows it
(`modal_response`). Elsewhere panels shrink towards the frequency of every pole down to the width of its peak; each is
halved until the rules of Gauss (7 points) and Kronrod (15 points, the same 7 among them) no longer differ, and
responses come from the modes or from A.

References
----------
Piessens, de Doncker-Kapenga, Ueberhuber, Kahaner, *QUADPACK* (1983).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.frequency import response_within
from robustlab.linear_analysis.modal_response import ModalResponse
from robustlab.shown import Tuning
from robustlab.statespace import StateSpaceModel

__all__ = ["AxisIntegral", "AxisTuning", "axis_integral", "mean_square_gain", "panel_ends"]

# Nodes of Kronrod's rule of 15 points on [-1, 1] that are not negative, the outermost first, their weights, and those
# of Gauss's rule of 7 points at every second one of them.
_NODES = (
    0.991455371120812639206854697526329, 0.949107912342758524526189684047851, 0.864864423359769072789712788640926,
    0.741531185599394439863864773280788, 0.586087235467691130294144691693013, 0.405845151377397166906606412076961,
    0.207784955007898467600689403773245, 0.0,
)  # fmt: skip
_KRONROD = (
    0.022935322010529224963732008058970, 0.063092092629978553290700663189204, 0.104790010322250183839876322541518,
    0.140653259715525918745189590510238, 0.169004726639267902826583426598550, 0.190350578064785409913256402421014,
    0.204432940075298892414161999234649, 0.209482141084727828012999174891714,
)  # fmt: skip
_GAUSS = (
    0.0, 0.129484966168869693270611432679082, 0.0, 0.279705391489276667901467771423780,
    0.0, 0.381830050505118944950369775488975, 0.0, 0.417959183673469387755102040816327,
)  # fmt: skip
NODES = np.array([*(-x for x in _NODES), *_NODES[-2::-1]])
KRONROD, GAUSS = (np.array([*half, *half[-2::-1]]) for half in (_KRONROD, _GAUSS))
# Numbers of a stack of matrices in extended precision that is kept in memory.
CHUNK = 500_000


@dataclass(frozen=True)
class AxisTuning(Tuning):
    """How finely the axis is cut."""

    # Next to a pole at a distance r from the axis, panels end at r, r times this, r times its square ...
    growth: float = 8.0
    # Panels next to a pole end where another pole is nearer by this factor: that one's panels are as fine there.
    nearer: float = 1.5
    # A panel is done where its two rules differ by less than this share of the whole: Kronrod's, which is taken, is
    # then good to about the power 24/14 of it.
    rtol: float = 1e-7
    # Frequencies at most, and halvings of a panel: what has not settled by then is rounding.
    points: int = 100_000
    halvings: int = 40
    # Share of a response by which its modes may be off; beyond it the response is solved for with A.
    modes: float = 1e-8


TUNING = AxisTuning()


class AxisIntegral(NamedTuple):
    """Integrals of some functions of frequency over the positive axis.

    Attributes
    ----------
    values
        One for each function.
    open
        By how much the two rules differ, all panels together, for the first function.
    settled
        Whether that is next to nothing in every panel.
    points
        How many frequencies were looked at.
    """

    values: AnyArray
    open: float
    settled: bool
    points: int


def axis_integral(
    functions: Callable[[AnyArray], AnyArray], poles: AnyArray, dt: float, tuning: AxisTuning = TUNING
) -> AxisIntegral:
    r"""Integrals of functions with the resonances of ``poles`` over :math:`0 .. \infty` or :math:`0 .. \pi / dt`."""
    ends = panel_ends(poles, dt, tuning)
    last = np.inf if dt else ends[-2]

    def panels(low: AnyArray, high: AnyArray) -> tuple[AnyArray, AnyArray]:
        half = 0.5 * (high - low)
        at = (0.5 * (high + low)[:, None] + half[:, None] * NODES).ravel()
        # W + t W stands for the frequency W / (1 - t) beyond the last W.
        share = np.where(at > last, 2 - at / last, 1.0)
        omega = np.where(at > last, last / share, at)
        values = (functions(omega) / share[:, None] ** 2).reshape(len(low), len(NODES), -1)
        return half[:, None] * (KRONROD @ values), half * (GAUSS @ values[:, :, 0:1])[:, 0]

    low, high = ends[:-1], ends[1:]
    done, open_, points, halvings = np.zeros(1), 0.0, 0, 0
    while True:
        value, coarse = panels(low, high)
        points, halvings = points + len(low) * len(NODES), halvings + 1
        change = np.abs(value[:, 0] - coarse)
        moved = ~(change <= tuning.rtol * (done[0] + value[:, 0].sum()))
        over = points + 2 * moved.sum() * len(NODES) > tuning.points or halvings > tuning.halvings
        if not moved.any() or over or not np.isfinite(value).all():
            return AxisIntegral(done + value.sum(0), open_ + float(change.sum()), not moved.any(), points)
        done, open_ = done + value[~moved].sum(0), open_ + float(change[~moved].sum())
        low, high = low[moved], high[moved]
        middle = 0.5 * (low + high)
        low, high = np.stack([low, middle], axis=1).ravel(), np.stack([middle, high], axis=1).ravel()


def panel_ends(poles: AnyArray, dt: float, tuning: AxisTuning = TUNING) -> AnyArray:
    """Ends of the first panels in rad/s: from 0 to the Nyquist frequency, or to W and then one more step for the rest.

    Poles are those of the s-plane, also for ``dt > 0``.
    """
    nyquist = np.pi / dt if dt else 0.0
    poles = np.unique(np.real(poles) + 1j * np.abs(np.imag(poles)))
    last = nyquist or 4.0 * float(np.abs(poles).max())
    at, width = np.imag(poles), np.maximum(np.abs(np.real(poles)), np.maximum(np.spacing(np.abs(poles)), 1e-25 * last))
    steps = np.ceil(np.log(max(last / width.min(initial=last), 1.0)) / np.log(tuning.growth)) + 1
    away = np.append(0.0, tuning.growth ** np.arange(steps)) * width[:, None]
    own = np.hypot(away, width[:, None])
    ends, own = np.concatenate([at[:, None] + away, at[:, None] - away]), np.concatenate([own, own])
    inside = (ends > 0) & (ends < last)
    ends, own = ends[inside], own[inside]
    nearest = np.abs(1j * ends[:, None] - poles).min(axis=1, initial=np.inf)  # the conjugate ones are further away
    ends = np.unique(np.concatenate([[0.0, last], ends[own <= tuning.nearer * nearest]]))
    return ends if nyquist else np.append(ends, 2 * last)


def mean_square_gain(m: StateSpaceModel, tuning: AxisTuning = TUNING, *, careful: bool = False) -> tuple[float, bool]:
    """The square of the H2 norm of a stable model, strictly proper where it is continuous, and whether it settled."""
    if not m.n_states or not m.n_inputs or not m.n_outputs:
        return float((m.D**2).sum()), True
    modes = None if careful else ModalResponse.of_model(m)
    if modes is not None:
        square, error = modes.mean_square(m.is_discrete)
        if error <= tuning.rtol * square:
            return square, True
    poles: AnyArray = m.poles() if modes is None else modes.poles
    if m.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / m.dt

    def density(omega: AnyArray) -> AnyArray:
        found = _refined_response(m, omega) if careful else response_within(m, modes, omega, tuning.modes)[0]
        square = (np.abs(found) ** 2).sum(axis=(1, 2))
        if not np.isfinite(square).all():
            raise NoTrustworthyNumber("h2_norm", "the frequency response overflows")
        return square[:, None]

    found = axis_integral(density, poles, m.dt, tuning)
    return float(found.values[0]) * (m.dt or 1.0) / np.pi, found.settled


def _refined_response(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    """The frequency response after one step of iterative refinement."""
    found = np.empty((len(omega), *m.D.shape), dtype=complex)
    s = np.exp(1j * omega * m.dt) if m.is_discrete else 1j * omega
    step = max(1, CHUNK // m.n_states**2)
    for first in range(0, len(s), step):
        matrix = s[first : first + step, None, None] * np.eye(m.n_states) - m.A
        try:
            x = np.linalg.solve(matrix, m.B[None].astype(complex)).astype(np.clongdouble)
            left = (m.B - matrix.astype(np.clongdouble) @ x).astype(complex)
            found[first : first + step] = m.C @ (x + np.linalg.solve(matrix, left)) + m.D
        except np.linalg.LinAlgError:
            raise NoTrustworthyNumber("h2_norm", "a frequency hits a pole exactly") from None
    return found
