"""Parameters that many doors share, declared once: what they are called, take, and mean."""

from __future__ import annotations

from typing import Annotated, Any

from robustlab.doors.kinds import Feedback, Flag, Machine, Names, Number, Numbers, RecordFile, Thing, Whole

Model = Annotated[Any, Thing(("plant", "model", "uncertain", "any"), model=True), "HDF5 or MATLAB file."]
System = Annotated[Any, Thing(("plant", "model", "uncertain", "any")), "HDF5 or MATLAB file."]
Uncertain = Annotated[Any, Thing(("uncertain", "any")), "HDF5 file with an uncertain model, or with frequency data."]
Design = Annotated[Any, Thing(("problem", "plant", "model", "uncertain", "any")), "HDF5 or MATLAB file."]
Plant = Annotated[Any, Machine(), "Model file, name of a plant, or file.py:name."]
UncertainPlant = Annotated[Any, Machine(("uncertain", "any")), "Uncertain model: a file, or a plant with tolerances."]
Measured = Annotated[Any, RecordFile(), "Record: HDF5, MATLAB, Parquet, MCAP, CSV or TXT file."]
Repeats = Annotated[list[Any] | None, RecordFile(many=True), "Further record with the same input, for the noise floor."]
Controller = Annotated[Any, Thing(("controller", "any")), "File with the controller."]
Sign = Annotated[
    int | None, Feedback(), "negative (u = -K y) or positive; if left out, as the controller says of itself."
]
Effort = Annotated[float, Number(above=0, most=10_000), "Work that the search may take, as a multiple of the usual."]
TimeLimit = Annotated[
    float | None, Number(above=0, most=86400), "Guard in s: where it strikes, the answer is not repeatable."
]
Seed = Annotated[int, Whole(0, 2**63 - 1), "Seed of the random numbers; same seed, same answer."]
Frequency = Annotated[list[float] | None, Numbers("rad/s"), "At these frequencies only, rad/s: 1,10; or 2Hz."]
Band = Annotated[
    tuple[float, float] | None, Numbers("rad/s", 2, "LOW,HIGH"), "Frequencies in rad/s: between these alone."
]
Inputs = Annotated[list[str] | None, Names("inputs"), "Inputs to keep; all if left out."]
Outputs = Annotated[list[str] | None, Names("outputs"), "Outputs to keep; all if left out."]
SampleTime = Annotated[float, Number(above=0), "Sample time in s."]
Yes = Annotated[bool, Flag()]
