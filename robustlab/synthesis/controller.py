"""A controller as it is stored and exchanged: the model, its sign convention, and what was verified about it."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel

__all__ = ["Controller"]


@dataclass(frozen=True, eq=False)
class Controller(Traced):
    """A controller ``u = K y`` with positive feedback (as in the literature on lower LFTs).

    Attributes
    ----------
    K
        The controller; its inputs are the measurements, its outputs the control signals.
    gamma
        Closed-loop H-infinity norm that was verified for the generalised plant it was designed on; None where none was.
    status
        How much ``gamma`` can be trusted.
    method
        What made it, for example ``"mixsyn"``.
    """

    K: StateSpaceModel
    gamma: float | None = None
    status: Status = Status.INCONCLUSIVE
    method: str = ""

    def to_model(self) -> StateSpaceModel:
        """K, so that a controller can be given where a model is asked for."""
        return self.K

    def to_json(self) -> dict[str, object]:
        """K and what was verified, as plain types."""
        return {"K": self.K, "gamma": self.gamma, "status": self.status, "method": self.method}
