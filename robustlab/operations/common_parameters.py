"""Parameters that many operations share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from robustlab.operations.parameter_types import (
    ByNumber,
    Feedback,
    Machine,
    Names,
    Number,
    Numbers,
    RecordFile,
    Thing,
    Whole,
)

Model = Annotated[Any, Thing(("plant", "model", "uncertain", "any"), model=True), "HDF5 or MATLAB file."]
System = Annotated[Any, Thing(("plant", "model", "uncertain", "any")), "HDF5 or MATLAB file."]
Uncertain = Annotated[Any, Thing(("uncertain", "any")), "HDF5 file with an uncertain model, or with frequency data."]
Design = Annotated[Any, Thing(("problem", "plant", "model", "uncertain", "any")), "HDF5 or MATLAB file."]
Plant = Annotated[Any, Machine(), "Model file, name of a plant, or file.py:name."]
UncertainPlant = Annotated[Any, Machine(("uncertain", "any")), "Uncertain model: a file, or a plant with tolerances."]
Moved = Annotated[Any, Thing(("plant", "any")), "A discover step, or a plant with effects."]
Measured = Annotated[Any, RecordFile(), "Record: HDF5, MATLAB, CSV or TXT file."]
Controller = Annotated[Any, Thing(("controller", "any"), option="--controller,-k"), "File with the controller."]
Sign = Annotated[
    Any,
    Feedback(option="--feedback"),
    "negative (u = -K y; -1 in a recipe) or positive (1); default: the sign stored with the controller.",
]
Effort = Annotated[float, Number(above=0, most=10_000), "Work allowed for the search, as a multiple of the usual."]
TimeLimit = Annotated[
    float | None, Number(above=0, most=86400), "Time limit in s. If it is reached, the result depends on the machine."
]
Seed = Annotated[int, Whole(0, 2**63 - 1), "Seed of the random numbers; same seed, same answer."]
Frequency = Annotated[list[float] | None, Numbers("rad/s"), "At these frequencies only, rad/s: 1,10; or 2Hz."]
Inputs = Annotated[list[str] | None, Names("inputs"), "Inputs to keep; all if left out."]
Outputs = Annotated[list[str] | None, Names("outputs"), "Outputs to keep; all if left out."]
Channel = Annotated[Any, ByNumber()]


# Parameters of public functions that every operation passes on.
COMMON: dict[str, Any] = {"effort": Effort, "time_limit": TimeLimit, "seed": Seed, "progress": ()}


@dataclass(frozen=True)
class Search:
    """The work allowed for a search or a proof, and its time limit."""

    effort: Effort = 1.0
    time_limit: TimeLimit = None


@dataclass(frozen=True)
class Signals:
    """The inputs and outputs of a system that are used."""

    inputs: Inputs = None
    outputs: Outputs = None

    def of(self, system: Any) -> Any:
        if self.inputs is None and self.outputs is None:
            return system
        if hasattr(system, "select"):
            return system.select(self.inputs, self.outputs)
        sides = (self.outputs, system.outputs), (self.inputs, system.inputs)
        return system[tuple(given or [s.name for s in known] for given, known in sides)]


@dataclass(frozen=True)
class Loop:
    """A controller around the system."""

    controller: Controller | None = None
    sign: Sign = None

    def around(self, system: Any, where: str) -> tuple[Any, str]:
        """Return the closed loop and its description, or the system without a controller."""
        from robustlab.errors import NoTrustworthyNumber, UsageError
        from robustlab.feedback import feedback_loop
        from robustlab.linear_analysis.structural import with_hidden
        from robustlab.statespace import StateSpaceModel

        if self.controller is None:
            if self.sign is not None:
                raise UsageError("--feedback", "without --controller", "a controller to close the loop with")
            return system, ""
        around, sign, words = feedback_loop(system, self.controller, self.sign, where, None)
        loop = system.feedback(around, sign)
        nominal = getattr(loop, "nominal", None)
        if isinstance(nominal, StateSpaceModel) and not nominal.is_stable():
            poles = nominal.poles()
            worst = poles[(abs(poles) if nominal.is_discrete else poles.real).argmax()]
            found = with_hidden(f"the nominal loop {words} is unstable (pole {worst:.4g})", nominal)
            hint = "was this controller designed for this plant? sign=-1 or sign=1 closes it otherwise"
            raise NoTrustworthyNumber(where, found, "a stable loop", hint)
        return loop, words
