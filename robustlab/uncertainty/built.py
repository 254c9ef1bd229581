"""An uncertain model with the evidence of its construction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from robustlab.display import Displayable, Facts, Part
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.elementwise import EndpointResidual
from robustlab.uncertainty.lft import UncertainModel


@dataclass(frozen=True, eq=False)
class BuiltModel(Displayable):
    """An uncertain model with its evidence.

    Attributes
    ----------
    model
        The set.
    structure
        Which entries vary together.
    status
        CERTIFIED: the set is proved to contain its source models. CONVERGED: to a chosen accuracy. None: it is defined
        by its parameters, and there is nothing to prove.
    residual
        Distance of its end from the perturbed model; None where it was not made of two models.
    notes
        Remarks for the reader.
    ends
        The nominal and the perturbed model of its construction, for `robustlab.verify`.
    """

    model: UncertainModel
    structure: str
    status: Status | None
    residual: EndpointResidual | None = None
    notes: tuple[str, ...] = ()
    ends: tuple[StateSpaceModel, StateSpaceModel] | None = None

    quantities: ClassVar[Mapping[str, Any]] = {**UncertainModel.quantities, "endpoint_residual": "1"}

    @property
    def endpoint_residual(self) -> float | None:
        """Return the largest relative difference to the perturbed model at Delta = I."""
        return None if self.residual is None else self.residual.largest

    def numbers(self) -> dict[str, Any]:
        residual = self.endpoint_residual
        return self.model.numbers() | ({} if residual is None else {"endpoint_residual": residual})

    def headline(self) -> str:
        names = ", ".join(b.name for b in self.model.blocks) or "nothing"
        return f"{'sampled' if self.model.sampled else 'exact'} uncertain model ({self.structure}); uncertain: {names}"

    def facts(self) -> Facts:
        off = "" if self.residual is None else f"{self.residual.largest:.2g} of each matrix's largest entry"
        return [
            ("structure", self.structure),
            ("off the perturbed model at Delta = I", off),
            *self.model.facts(),
        ]

    def details(self) -> list[Part]:
        return self.model.details()

    def to_json(self) -> dict[str, object]:
        more = {"structure": self.structure, "residual": self.residual}
        return {**self.model.to_json(), **more, "status": self.status}
