r"""The level-set search for the peak of a stable continuous model: where it is, and that nothing is higher.

Gains along the axis come from the model's modes wherever the bound of their errors allows it (`modal_response`); what
is reported, and what that bound leaves open, is solved for with A.

References
----------
Boyd, Balakrishnan 1990; Bruinsma, Steinbuch 1990.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.frequency import solved_response
from robustlab.linear_analysis.matrix_equations import balanced_eigenvalues, lapack
from robustlab.linear_analysis.modal_response import ModalResponse, largest_gain
from robustlab.norms.panels import panel_ends
from robustlab.shown import Tuning
from robustlab.statespace import StateSpaceModel

__all__ = [
    "TUNING", "Band", "NormTuning", "balancing_units", "crossings", "largest_gains", "level_bracket", "search_grid",
    "well_scaled",
]  # fmt: skip

Band = tuple[float, float]

EPS = float(np.finfo(float).eps)
# A frequency, in the time unit of a model that is well scaled, at which only its direct term is left.
BEYOND = 1e200
# Frequencies at which rounding is looked at besides the peak; where no modes tell, they are picked by this many EPS.
LOOKED_AT, ROUGHLY = 3, 1e4
# Frequencies at which the states are solved for where the bound by the modes is too coarse, those where it is largest.
REACHES = 40
# How much wider the intervals of a proof get away from a pole.
COVER = 3.0


@dataclass(frozen=True)
class NormTuning(Tuning):
    """How hard the H-infinity norm is looked for; what is proved does not depend on it."""

    # Levels before the bracket is given up as INACCURATE: most models need two or three.
    levels: int = 60
    # First grid, per decade between the poles: more find the highest peak at once, fewer leave it to the level test.
    points_per_decade: int = 20
    # Peaks that a zoom looks at, its steps and the points of each on either side of where the top is guessed to be.
    zoom_peaks: int = 6
    zoom_steps: int = 6
    zoom_points: int = 9
    # A peak is left where the fall from its top to the points beside it, times the first, is below the second.
    zoom_rise: float = 4.0
    zoom_flat: float = 1e-9
    # Frequencies at which a model without any gain is looked at, besides those of its poles.
    nothing_points: int = 200
    # The share of rtol that a quick gain may be off by.
    quick: float = 0.1
    # A level is proved interval by interval, and not by the eigenvalues of the Hamiltonian, from so many states on, for
    # these take longer then, and where terms so many times as large cancel, for these have been missed then.
    cover_states: int = 36
    cancelling: float = 1e4
    # Intervals per state before it is left to the eigenvalues after all.
    cover_intervals: int = 40


TUNING = NormTuning()


def well_scaled(m: StateSpaceModel) -> tuple[StateSpaceModel, float]:
    """The same transfer function in the time unit 1/rate, with states balanced against inputs and outputs (Osborne)."""
    t, rate = balancing_units(m)
    a, b, c = m.A / rate, m.B / np.sqrt(rate), m.C / np.sqrt(rate)
    return m._in_states(t, a / t[:, None] * t, b / t[:, None], c * t, rate=rate), rate


def balancing_units(m: StateSpaceModel) -> tuple[Array, float]:
    """``t`` (n,) and ``rate`` of `well_scaled`, powers of two: its states are ``sqrt(rate) x / t``."""
    size = np.sort(np.abs(m.poles()))
    size = size[size > 1e-12 * size[-1]]
    rate = float(2.0 ** np.round(np.log2(size[len(size) // 2]))) if size.size else 1.0  # nothing but integrators
    a, b, c = m.A / rate, m.B / np.sqrt(rate), m.C / np.sqrt(rate)
    level = np.linalg.norm(b) / np.linalg.norm(c) if b.any() and c.any() else 1.0
    n = m.n_states
    bordered = np.zeros((n + 1, n + 1), order="F")  # B and C, which weigh the same, as the row and column of one state
    bordered[:n, :n], bordered[:n, n], bordered[n, :n] = a, _lengths(b, 1), level * _lengths(c, 0)
    scale = lapack().dgebal(bordered, scale=1, overwrite_a=1)[3]
    return scale[:n] / scale[n], rate


def _lengths(matrix: AnyArray, axis: int) -> AnyArray:
    return np.sqrt((matrix**2).sum(axis))


def largest_gains(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    """``sigma_max`` at each frequency, shape (n_omega,)."""
    response = _finite_response(m, omega)
    if min(m.n_inputs, m.n_outputs) == 1:
        return np.sqrt((np.abs(response) ** 2).sum(axis=(1, 2)))
    return np.linalg.svd(response, compute_uv=False)[:, 0]


def _finite_response(m: StateSpaceModel, omega: AnyArray) -> AnyArray:
    response = solved_response(m, omega)
    if not np.isfinite(response).all():
        raise NoTrustworthyNumber("hinf_norm", "the frequency response overflows")
    return response


def search_grid(m: StateSpaceModel, points: int, band: Band | None = None) -> AnyArray:
    """Zero, infinity, the poles' frequencies and resonances, and a logarithmic grid around them; those of a band."""
    if band is not None:
        return _within(search_grid(m, points), band)
    poles = m.poles()
    if m.is_discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / m.dt
    size = np.abs(poles)
    size = size[size > 0]
    low, high = (size.min() / 10, size.max() * 10) if len(size) else (1e-1, 1e1)
    resonance = np.sqrt(np.maximum(poles.imag**2 - poles.real**2, 0.0))
    grid = np.exp(np.linspace(np.log(low), np.log(high), points))
    omega = np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag), resonance, grid])
    if m.is_discrete:
        return np.unique(np.append(omega[omega < np.pi / m.dt], np.pi / m.dt))
    return np.append(np.unique(omega), np.inf)


class _Gains:
    """``sigma_max`` of a stable continuous model along the axis: from its modes where their errors do not matter."""

    def __init__(self, m: StateSpaceModel, share: float) -> None:
        self.model, self.share = m, share
        self.modes = ModalResponse.of_model(m)
        # Bound of |(jw I - A)^-1 B| at all frequencies searched so far; these, the gain with what rounding may add, and
        # that bound at each.
        self.reach = 0.0
        self._tops: list[tuple[AnyArray, AnyArray, AnyArray]] = []
        self._solved: dict[float, float] = {}

    def doubtful(self, level: float) -> AnyArray:
        """Finite frequencies searched so far at which rounding may take the gain above a level, a few of the worst."""
        omega, top, _ = (np.concatenate(x) for x in zip(*self._tops, strict=True))
        worst = np.argsort(-top)[:LOOKED_AT]
        return omega[worst[(top[worst] > level) & np.isfinite(omega[worst])]]

    def searched(self, omega: AnyArray) -> AnyArray:
        """Off by no more than ``share`` of the largest, or below 0.9 of it and from above: enough to look for peaks."""
        if self.modes is None:
            m, n = self.model, self.model.n_states
            outputs = np.vstack([m.C, np.eye(n)]), np.vstack([m.D, np.zeros((n, m.n_inputs))])
            found = _finite_response(StateSpaceModel(m.A, m.B, *outputs), omega)
            gain, reach = largest_gain(found[:, : m.n_outputs]), np.linalg.norm(found[:, m.n_outputs :], axis=(1, 2))
            self.reach = max(self.reach, float(reach.max()))
            self._tops.append((omega, gain + ROUGHLY * EPS * float(np.linalg.norm(m.C)) * reach, reach))
            return gain
        gain, error, reach = self.modes.gains(1j * np.minimum(omega, BEYOND))
        self.reach = max(self.reach, float(reach.max()))
        self._tops.append((omega, gain + error, reach))
        highest = float((gain - error).max())
        far = error > self.share * highest
        if far.any():
            gain = np.where(far, gain + error, gain)
            doubtful = far & ~(gain <= 0.9 * highest)
            if doubtful.any():
                gain[doubtful] = largest_gains(self.model, omega[doubtful])
        return gain

    def proved(self, omega: AnyArray, level: float) -> AnyArray:
        """Not above the level where the bound of their error shows it; solved for with A everywhere else."""
        if self.modes is None:
            return largest_gains(self.model, omega)
        gain, error, _ = self.modes.gains(1j * omega)
        doubtful = ~(gain + error <= level)
        if doubtful.any():
            gain[doubtful] = largest_gains(self.model, omega[doubtful])
        return gain

    def highest(self, omega: AnyArray, sigma: AnyArray) -> tuple[float, float]:
        """The largest of these, solved for with A, and its frequency."""
        at = float(omega[np.argmax(sigma)])
        if at not in self._solved:
            self._solved[at] = float(largest_gains(self.model, np.array([at]))[0])
        return self._solved[at], at

    def above(self, level: float, band: Band | None, tuning: NormTuning) -> AnyArray | None:
        """Frequencies whose gain exceeds a level, none where that is proved of all; None where it is not known."""
        terms = self.reach * float(np.linalg.norm(self.model.C))
        if self.modes is None or (self.model.n_states < tuning.cover_states and terms <= tuning.cancelling * level):
            return None
        low, high = band or (0.0, np.inf)
        ends = panel_ends(self.modes.poles, 0.0, COVER)[:-1]
        ends = np.concatenate([[low], ends[(ends > low) & (ends < high)], [high]])
        return self.modes.above(level, ends, tuning.cover_intervals * self.model.n_states)

    def rounding(self, lower: float) -> float:
        """What rounding in C (jw I - A)^-1 B alone can produce: a norm below it cannot be told from zero."""
        m = self.model
        out, direct = (4 * EPS * float(np.linalg.norm(part)) for part in (m.C, m.D))
        # The modes' bound is coarse, and may still be nothing beside the norm.
        if self.modes is None or out * self.reach <= self.share * lower:
            return out * self.reach + direct
        omega, _, reach = (np.concatenate(x) for x in zip(*self._tops, strict=True))
        states = StateSpaceModel(m.A, m.B, np.eye(m.n_states), np.zeros((m.n_states, m.n_inputs)))
        out, direct = (4 * EPS * float(np.linalg.norm(part, 2)) for part in (m.C, m.D))
        return out * float(largest_gains(states, omega[np.argsort(-reach)[:REACHES]]).max()) + direct


def level_bracket(
    m: StateSpaceModel, rtol: float, tuning: NormTuning, band: Band | None = None
) -> tuple[float, float, float, bool, AnyArray]:
    """``(lower, frequency, upper, trusted)`` for a continuous model that is well scaled; over a band, or the axis.

    Last frequencies at which rounding may be more than the bracket allows for, none where it was counted in the proof.
    """
    size = np.abs(m.poles())
    decades = 2 + np.log10(size.max() / max(size.min(), 1e-15 * size.max())) if size.any() else 2
    gains, omega = _Gains(m, tuning.quick * rtol), search_grid(m, int(tuning.points_per_decade * decades))
    if band is not None:
        omega = _within(omega, band)
    sigma = gains.searched(omega)
    floor = gains.rounding(float(sigma.max()))
    if floor == 0:
        return 0.0, 0.0, 0.0, True, np.zeros(0)
    omega, sigma = _zoomed(gains, omega, sigma, tuning)
    lower, at = gains.highest(omega, sigma)
    trusted, upper = True, np.inf
    for _ in range(tuning.levels):
        upper = lower * (1 + rtol) + floor
        above = gains.above(upper, band, tuning)
        if above is not None and not len(above):
            return lower, at, upper, trusted, np.zeros(0)
        new_omega = crossings(m, upper, band) if above is None else above
        new_sigma = gains.proved(new_omega, upper)
        omega, sigma = np.concatenate([omega, new_omega]), np.concatenate([sigma, new_sigma])
        peak = int(np.argmax(new_sigma))
        if above is None and new_sigma[peak] > upper:
            lower, at = float(new_sigma[peak]), float(new_omega[peak])
            continue
        omega, sigma = _zoomed(gains, omega, sigma, tuning)
        zoomed, zoomed_at = gains.highest(omega, sigma)
        if zoomed <= upper:
            if zoomed > lower:
                lower, at = zoomed, zoomed_at
            return lower, at, upper, trusted and above is None, gains.doubtful(upper)
        lower, at = zoomed, zoomed_at
        # Where the level was "proved", yet a frequency exceeds it, rounding moved an eigenvalue: go on, but say so.
        trusted = trusted and above is not None
    return lower, at, upper, False, gains.doubtful(upper)


def crossings(m: StateSpaceModel, level: float, band: Band | None = None) -> AnyArray:
    """Imaginary parts of all eigenvalues of the Hamiltonian at this level, and points between and beyond them.

    Of a band, those inside, its ends, and points between them: nothing crosses the level between two of these.
    """
    n, root = m.n_states, np.sqrt(level)
    b, c, d = m.B / root, m.C / root, m.D / level
    hamiltonian = np.empty((2 * n, 2 * n))
    if d.any():
        r, s = np.eye(m.n_inputs) - d.T @ d, np.eye(m.n_outputs) - d @ d.T
        solved = np.linalg.solve(r, np.hstack([d.T @ c, b.T]))
        a, into, out = m.A + b @ solved[:, :n], b @ solved[:, n:], c.T @ np.linalg.solve(s, c)
    else:
        a, into, out = m.A, b @ b.T, c.T @ c
    hamiltonian[:n, :n], hamiltonian[:n, n:], hamiltonian[n:, :n], hamiltonian[n:, n:] = a, into, -out, -a.T
    eigenvalues = balanced_eigenvalues(hamiltonian)
    if eigenvalues is None:
        raise NoTrustworthyNumber("hinf_norm", "the Hamiltonian overflows")
    crossing = np.unique(np.append(np.abs(np.imag(eigenvalues)), 0.0))
    if band is not None:
        crossing = _within(crossing, band)
        if np.isfinite(band[1]):
            return np.concatenate([crossing, 0.5 * (crossing[:-1] + crossing[1:])])
        crossing = crossing[:-1]
    between = 0.5 * (crossing[:-1] + crossing[1:])
    beyond = [2 * crossing[-1], 10 * crossing[-1]]
    return np.concatenate([crossing, between, beyond])


def _within(omega: AnyArray, band: Band) -> AnyArray:
    """The frequencies inside a band, and its ends, in order."""
    return np.unique(np.append(omega[(omega > band[0]) & (omega < band[1])], band))


def _zoomed(gains: _Gains, omega: AnyArray, sigma: AnyArray, tuning: NormTuning) -> tuple[AnyArray, AnyArray]:
    """The points known so far in order, and those that a search around their highest local maxima adds."""
    for step in range(tuning.zoom_steps + 1):
        order = np.argsort(omega, kind="stable")
        omega, sigma = omega[order], sigma[order]
        new = np.append(True, omega[1:] > omega[:-1])
        omega, sigma = omega[new], sigma[new]
        best, falls = sigma.max(), sigma[1:] <= sigma[:-1]
        top = (sigma >= 0.9 * best) & (omega < np.inf)
        top[:-1] &= falls
        top[1:] &= ~falls | (sigma[1:] == sigma[:-1])
        peaks = np.flatnonzero(top)
        before, after = np.maximum(peaks - 1, 0), np.minimum(peaks + 1, len(omega) - 1)
        # Between the points next to the top of a smooth peak nothing rises by more than it fell towards them.
        rise = sigma[peaks] - np.minimum(sigma[before], sigma[after])
        open_ = np.flatnonzero(sigma[peaks] + tuning.zoom_rise * rise > best * (1 + tuning.zoom_flat))
        if not len(open_) or step == tuning.zoom_steps:
            break
        open_ = open_[np.argsort(-sigma[peaks[open_]])][: tuning.zoom_peaks]
        points = _around(omega, sigma, before[open_], peaks[open_], after[open_], tuning.zoom_points)
        omega, sigma = np.concatenate([omega, points]), np.concatenate([sigma, gains.searched(points)])
    return omega, sigma


def _around(
    omega: AnyArray, sigma: AnyArray, before: AnyArray, peaks: AnyArray, after: AnyArray, count: int
) -> AnyArray:
    """Frequencies between the neighbours of each peak, closer and closer towards where its top is likely to be.

    Next to a single pole ``1 / sigma^2`` is a parabola in the frequency; its lowest point is guessed from three values.
    """
    low, at, high = omega[[before, peaks, after]]
    high = np.where(high < np.inf, high, 10 * at + 1)
    with np.errstate(all="ignore"):
        f, g, h = sigma[[before, peaks, after]] ** -2.0
        left, right = (g - f) / (at - low), (h - g) / (high - at)
        top = 0.5 * (low + at) - 0.5 * left * (high - low) / (right - left)
    top = np.where((top > low) & (top < high), top, at)
    share = 3.0 ** -np.arange(1, count + 1)
    beside = top[:, None] + np.stack([low - top, high - top])[:, :, None] * share
    return np.append(beside, top)
