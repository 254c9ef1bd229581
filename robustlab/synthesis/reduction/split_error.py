r"""What splitting or reducing a model costs: a bound of the difference, for the frequencies where it holds.

The difference is a model of its own, without cancellation (`SplitModel.rounding`, `lost_at_least_order`), whose peak is
proved as any other.
At a mode on the stability boundary no such peak is finite, unless nothing at all was rounded: an interval around it is
left out, as narrow as the bound that is wanted allows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import NoTrustworthyNumber
from robustlab.linear_analysis.frequency import frequency_response
from robustlab.norms import HinfNorm, linf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

__all__ = ["SplitBound", "SplitError", "merged", "widened"]

Band = tuple[float, float]
# A pole counts as one on the boundary up to this share of its frequency (one at zero: of the slowest stable one).
NEAR = 1e-6
# Half widths of what is left out, as shares of the same; two of them are a factor of ten.
WIDTHS = np.logspace(-2, -13, 23)
# Relative width of the bracket of the norm, the larger end of which is told.
RTOL = 0.01


@dataclass(frozen=True)
class SplitBound:
    """``sigma_max`` of what was lost at all frequencies but those in ``left_out``, in rad/s; ``reason`` if unproved."""

    upper: float = 0.0
    left_out: tuple[Band, ...] = ()
    reason: str = ""


class SplitError:
    """The difference of two models; ``nothing`` is true where it is None: they are the same.

    ``apart``, ``stable``: the poles of the model that are not stable, and the others.
    """

    def __init__(self, difference: StateSpaceModel | None, apart: AnyArray, stable: AnyArray, dt: float) -> None:
        self._model = difference
        self.nothing = self._model is None or not self._model.D.size
        if self.nothing:
            return
        self._proved: dict[Band, tuple[float, str]] = {}
        apart, stable = _as_rates(apart, dt), _as_rates(stable, dt)
        slow = float(np.abs(stable).min(initial=np.inf))
        if not len(stable):
            slow = 1 / dt if dt else float(np.abs(apart).max(initial=0.0)) or 1.0
        at = np.abs(np.imag(apart))
        centre = np.where(at > 1e-3 * slow, at, 0.0)
        scale = np.where(centre > 0, centre, slow)
        near = np.abs(np.real(apart)) <= NEAR * scale
        self._centres, self._scales = centre[near], scale[near]
        beside = self._scales[:, None] * WIDTHS
        both = np.stack([self._centres[:, None] - beside, self._centres[:, None] + beside])
        self._sizes = self._gains(np.abs(both)).max(axis=0)
        others = self._gains(np.abs(apart[~near])).max(initial=0.0)
        self._elsewhere = max(float(others), float(self._sizes[:, :1].max(initial=0.0)))

    def bound(self, wanted: float) -> SplitBound:
        """A bound over the axis; more is left out only as long as that takes it to what is wanted."""
        m = self._model
        if m is None or self.nothing:
            return SplitBound()
        low, high = 0.0, np.pi / m.dt if m.dt else np.inf
        small = self._sizes <= max(wanted, 2 * self._elsewhere)
        width = np.logical_and.accumulate(small, axis=1).sum(axis=1) - 1
        while True:
            half = self._scales * WIDTHS[np.maximum(width, 0)]
            around = np.clip([self._centres - half, self._centres + half], low, high)
            left_out = merged((float(a), float(b)) for a, b in around.T)
            ends = [low, *(end for interval in left_out for end in interval), high]
            found = [self._norm(m, piece) for piece in zip(ends[::2], ends[1::2], strict=True) if piece[0] < piece[1]]
            reason = next((reason for _, reason in found if reason), "")
            width = width - 2  # ten times as wide, where rounding leaves open what is so near to a pole
            if not reason or not (width >= 0).any():
                return SplitBound(max((upper for upper, _ in found), default=0.0), left_out, reason)

    def _norm(self, model: StateSpaceModel, piece: Band) -> tuple[float, str]:
        """Upper bound in a band, and why it is none."""
        if piece not in self._proved:
            try:
                found = linf_norm(model, RTOL, band=piece)
            except NoTrustworthyNumber as error:
                self._proved[piece] = np.inf, error.found
            else:
                self._proved[piece] = found.upper, "" if found.status is Status.CERTIFIED else found.reason
        return self._proved[piece]

    def _gains(self, omega: AnyArray) -> AnyArray:
        """``sigma_max``, in the shape of omega; infinite where a frequency cannot be told from a pole."""
        try:
            response = frequency_response(self._model, omega.ravel())
        except NoTrustworthyNumber:
            return np.full(omega.shape, np.inf)
        return np.linalg.norm(response, 2, axis=(1, 2)).reshape(omega.shape)


def _as_rates(poles: AnyArray, dt: float) -> AnyArray:
    """Poles in rad/s; of a discrete model those that are not zero, as logarithms."""
    return np.log(poles[np.abs(poles) > 1e-12].astype(complex)) / dt if dt else poles


def widened(norm: HinfNorm, by: float, reason: str) -> HinfNorm:
    """The bracket of a norm to which so much may be added; not certified where there is a reason against it."""
    lower, status = max(norm.lower - by, 0.0), Status.INACCURATE if reason else norm.status
    return HinfNorm(lower, norm.upper + by, norm.frequency, status, norm.reason or reason)


def merged(intervals: Iterable[Band]) -> tuple[Band, ...]:
    """The intervals in order, those that overlap as one, those without width left out."""
    found: list[Band] = []
    for low, high in sorted(intervals):
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], high)
        elif low < high:
            found.append((low, high))
    return tuple(found)
