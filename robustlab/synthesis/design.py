"""A finished controller design with the evidence to check it again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robustlab.frequency import frequency_response
from robustlab.norms import HinfNorm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.controller import Controller
from robustlab.synthesis.partition import GeneralizedPlant

__all__ = ["Synthesis", "limiting_channels"]


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A controller that was verified in the loop rebuilt from it; there is no Synthesis without one.

    Attributes
    ----------
    K
        The controller, ``u = K y`` with positive feedback into the plant's lower LFT.
    gamma
        Verified upper bound of the H-infinity norm of ``closed_loop``.
    closed_loop
        The lower LFT of plant and K, from w to z.
    status
        CERTIFIED where the rebuilt loop is stable and its norm was proved to be at most ``gamma``; INACCURATE where
        the norm lost digits. It vouches for ``gamma`` of this K, not for its optimality.
    peak_frequency
        Frequency in rad/s at which the closed loop attains its norm.
    reason
        One sentence on how the result came about.
    limit
        Which channels make the peak.
    smallest_gamma
        Smallest verified gamma of the search; K may be a softer controller within the allowed ratio of it.
    scalings_disagree
        Relative difference between the best gammas of the two scalings that were tried; NaN where one gave none.
    norm
        The bracket of the closed loop's norm.
    plant
        The generalised plant, so that the result can be checked again.
    method
        What made it.
    weights
        Weights of a mixed-sensitivity problem, by name.
    """

    K: StateSpaceModel
    gamma: float
    closed_loop: StateSpaceModel
    status: Status
    peak_frequency: float
    reason: str
    limit: str
    smallest_gamma: float
    scalings_disagree: float
    norm: HinfNorm
    plant: GeneralizedPlant
    method: str
    weights: Mapping[str, StateSpaceModel] = field(default_factory=dict)

    @property
    def controller(self) -> Controller:
        """K with what was verified about it, as it is stored."""
        return Controller(self.K, self.gamma, self.status, self.method)

    @property
    def fastest_controller_pole(self) -> float:
        """Largest modulus of K's poles: in rad/s, or, for a discrete K, of the pole itself."""
        return float(np.abs(self.K.poles()).max(initial=0.0))

    @property
    def closed_loop_abscissa(self) -> float:
        """Spectral abscissa of the closed loop; negative means stable (see `StateSpaceModel.spectral_abscissa`)."""
        return self.closed_loop.spectral_abscissa()

    def to_json(self) -> dict[str, Any]:
        """Everything but the plant and the weights, with arrays."""
        return {
            "method": self.method,
            "status": self.status,
            "gamma": self.gamma,
            "smallest_gamma": self.smallest_gamma,
            "peak_frequency": self.peak_frequency,
            "order": self.K.n_states,
            "fastest_controller_pole": self.fastest_controller_pole,
            "closed_loop_abscissa": self.closed_loop_abscissa,
            "limit": self.limit,
            "reason": self.reason,
            "scalings_disagree": self.scalings_disagree,
            "norm": self.norm.to_json(),
            "K": self.K.to_json(),
            "closed_loop": self.closed_loop.to_json(),
        }


def limiting_channels(loop: StateSpaceModel, omega: float) -> str:
    """The output and the input with the largest share in the singular vectors of the peak."""
    if (not np.isfinite(omega) and loop.is_discrete) or not loop.n_inputs or not loop.n_outputs:
        return ""
    left, _, right = np.linalg.svd(frequency_response(loop, [omega])[0])
    out, into = np.abs(left[:, 0]) ** 2, np.abs(right[0]) ** 2
    i, j = int(out.argmax()), int(into.argmax())
    names = loop.output_names[i], loop.input_names[j]
    return f"{names[0]} ({out[i]:.0%} of the peak) driven by {names[1]} ({into[j]:.0%})"
