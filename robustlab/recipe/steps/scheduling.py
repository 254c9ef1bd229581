"""Steps with measured parameters: an uncertain model as an LPV model, its induced gain, a scheduled controller."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.doors.vocabulary import GUARD, Effort, TimeLimit, ToUncertain
from robustlab.errors import InputError
from robustlab.recipe.steps.contract import Outcome, Step, Workspace, step, told

Counts = dict[str, Annotated[int, Field(ge=2, le=100)]]
Rates = dict[str, Annotated[float, Field(ge=0)]]


class ScheduledStep(Step):
    """What the steps share that take an uncertain model's real parameters as measured ones."""

    of: ToUncertain = Field(description="With real parameters only; a loaded file may hold an LPV model.")
    points: Counts = Field({}, description="Parameter -> how many points its range gets; 2 where left out.")
    rates: Rates = Field({}, description="Parameter -> bound of its rate per second; any rate where left out.")
    lyapunov: Literal["constant", "varying"] | None = Field(None, description="Lyapunov matrix; both where left out.")
    effort: Effort = Field(1.0, description="Multiple of the usual work.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def scheduled(self, work: Workspace) -> rl.LPVModel:
        """The LPV model."""
        given = work.values[self.of]
        if not isinstance(given, rl.LPVModel):
            return rl.lpv_model(work.uncertain(self.of), self.points, self.rates)
        if self.points:
            raise InputError("points", "given", "none: the LPV model has its own")
        return given.with_rates(**self.rates)

    @property
    def options(self) -> dict[str, Any]:
        """For the functions."""
        return self.model_dump(include={"lyapunov", "effort", "time_limit"})


@step
class LpvGainStep(ScheduledStep):
    """Induced L2 gain over all trajectories of measured parameters, proved between the points too."""

    leaves: ClassVar[Any] = {"lower": float, "upper": float}
    do: Literal["lpv-gain"]

    def run(self, work: Workspace) -> Outcome:
        found = rl.peak_gain(self.scheduled(work), **self.options)
        return told(found, None, f"Induced gain of {self.of}.", found.numbers(), work)


@step
class LpvHinfStep(ScheduledStep):
    """H-infinity controller scheduled by measured parameters, its loop verified for all their trajectories."""

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = {"gamma": float, "lmi_gamma": float, "frozen": float}
    do: Literal["lpv-hinf"]
    measurements: Annotated[int, Field(ge=1)] = Field(description="How many of the last outputs are measured.")
    controls: Annotated[int, Field(ge=1)] = Field(description="How many of the last inputs are controls.")

    def run(self, work: Workspace) -> Outcome:
        found = rl.hinf(self.scheduled(work), self.measurements, self.controls, **self.options)
        return told(found, found.controller, f"Scheduled controller for {self.of}.", found.numbers(), work)
