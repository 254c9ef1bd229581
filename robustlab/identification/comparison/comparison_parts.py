"""What a comparison consists of: sizes of the gap, errors of windows, tests of the residual, reach of the free run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robustlab.arrays import Array
from robustlab.identification.comparison.residual_tests import InputCorrelation, Whiteness
from robustlab.result import Evidence


@dataclass(frozen=True)
class OutputGap(Evidence):
    r"""Disagreement at one output, in its unit and in percent.

    Percent is of the measured range :math:`\max y - \min y` of this record. The fit is
    :math:`100 (1 - \|y - \hat y\| / \|y - \bar y\|)` percent: 100 is perfect, 0 as good as the mean, negative worse.
    """

    # name, unit, range: the output and its measured range
    name: str
    unit: str
    range: float
    # peak, rms, peak_percent, rms_percent, fit: free run; NaN where it does not reach the end of the record.
    # ``peak_time`` is when its peak error occurs [s].
    peak: float
    rms: float
    peak_percent: float
    rms_percent: float
    fit: float
    peak_time: float
    # windowed_peak, windowed_rms, windowed_peak_percent, windowed_rms_percent, windowed_fit: the same of the windowed
    # simulation
    windowed_peak: float
    windowed_rms: float
    windowed_peak_percent: float
    windowed_rms_percent: float
    windowed_fit: float

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("range", "peak", "rms", "windowed_peak", "windowed_rms"), "*"),
        **dict.fromkeys(("peak_percent", "rms_percent", "fit"), "%"),
        **dict.fromkeys(("windowed_peak_percent", "windowed_rms_percent", "windowed_fit"), "%"),
        "peak_time": "s",
    }


@dataclass(frozen=True)
class WindowErrors(Evidence):
    """Error of one output window by window; all arrays have shape (n_windows,)."""

    # start, stop: first and last time of each window in s
    start: Array
    stop: Array
    # rms, share: RMS of the free run's error, and its share of the record's squared error (sum 1); NaN where it does
    # not reach the end of the record
    rms: Array
    share: Array
    # windowed_rms, windowed_share: the same of the windowed simulation
    windowed_rms: Array
    windowed_share: Array
    # worst, worst_free: index of the window with the largest windowed RMS, and with the largest free-run RMS (None
    # without)
    worst: int
    worst_free: int | None


@dataclass(frozen=True)
class ResidualTests(Evidence):
    """Tests of one output's recursive residual (see `robustlab.identification.response.windowed_simulation`)."""

    rms: float  # RMS of the residual in the unit of the output
    whiteness: Whiteness  # autocorrelation and Ljung-Box test
    inputs: Mapping[str, InputCorrelation]  # input name -> correlation with the residual


@dataclass(frozen=True)
class FreeRun(Evidence):
    """How far the free run goes.

    Attributes
    ----------
    end
        Time of its last sample in s.
    reason
        Why it ends there; empty where it reaches the end of the record. Where it does not, nothing that rests on it has
        a number: what is told is of the windows only.
    """

    end: float
    reason: str

    @property
    def whole(self) -> bool:
        """Whether it reaches the end of the record."""
        return not self.reason


@dataclass(frozen=True)
class Linearisation(Evidence):
    """Windows that are linear about the recorded motion, against the nonlinear plant from the same starts."""

    windows: Array  # times in s at which the checked windows start
    # output name -> RMS of nonlinear minus linear simulation over these windows, in its unit
    difference: Mapping[str, float]
    # output name -> the same over the RMS of the error in these windows: far below 1, the error is the model's and not
    # of the linearisation
    share: Mapping[str, float]
    # times at which those windows start whose nonlinear simulation does not reach their end; they count nowhere
    broken: Array
