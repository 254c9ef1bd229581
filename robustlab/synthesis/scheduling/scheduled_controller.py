"""LPVController: a controller scheduled by measured parameters, and the gain that was proved of its loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from robustlab.errors import InputError
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.shown import Facts, Shown, number
from robustlab.signals import law
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.scheduling.parameter_varying import LPVModel


@dataclass(frozen=True, eq=False)
class LPVController(Shown, Traced):
    """A controller ``u = K(rho) y`` with positive feedback, scheduled by measured parameters.

    Attributes
    ----------
    K
        The controllers at the points of the grid, interpolated between them.
    gamma
        Induced gain that `lpv_gain` proved of the loop it was designed on; None where none was.
    status
        How much ``gamma`` can be trusted.
    method
        What made it.
    """

    K: LPVModel
    gamma: float | None = None
    status: Status = Status.INCONCLUSIVE
    method: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.K, LPVModel):
            raise InputError("LPVController: K", type(self.K).__name__, "an LPVModel")

    def at(self, rho: Any = None, **values: float) -> StateSpaceModel:
        """The controller at one value of every parameter; see `LPVModel.at`."""
        return self.K.at(rho, **values)

    def facts(self) -> Facts:
        said = [("gamma", number(self.gamma, digits=6)), ("method", self.method), ("loop", law(self.K.inputs))]
        return [*said, *self.K.facts()]

    def to_json(self) -> dict[str, object]:
        return {"K": self.K, "gamma": self.gamma, "status": self.status, "method": self.method}
