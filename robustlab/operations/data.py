"""Operations on measured records: checks, comparison with a model, missing effects, validation of a set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any, Literal

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.operations.declaration import InLoop, Named, operation
from robustlab.operations.kinds import Machine, Names, Number, RecordFile, Share, Table, Whole
from robustlab.operations.words import Measured, Moved, Plant, Search, UncertainPlant

Window = Annotated[float | None, Number(above=0), "Length of the windows in s; chosen from the model if left out."]
Tolerances = Annotated[
    dict[str, float] | None,
    Table(Share(above=0), "parameters"),
    Named(option="--tolerance"),
    "Relative tolerance of a parameter, over the one that the plant states: Km=0.05 or Km=5%.",
]
Records = Annotated[Any, RecordFile(named=True), "Records that the set must explain."]
Exclude = Annotated[list[str] | None, Names(repeated=True), "Id of an effect not to be tried."]


SUITED, VALIDATED = "identification.data_checks.suitability.", "identification.validation."


@operation("data check", "check-record", result=f"{SUITED}RecordCheck", calls=f"{SUITED}check_record")
def check_record(
    record: Annotated[Any, RecordFile(remarks=False), "HDF5, MATLAB, CSV or TXT file."],
    plant: Annotated[
        Any,
        Machine(),
        "A model: check also whether the record suits the identification of its missing effects.",
        Named(option="--model", key="model"),
    ] = None,
) -> Any:
    """Read a record and report its content and its irregularities.

    Example: robustlab data check run3.csv --inputs u --outputs q
    Example: robustlab data check run3.csv --model servo-axis
    Example: robustlab data check run.csv --inputs u=command --outputs q=position
    """


@operation("data compare", "compare", result="identification.comparison.comparison.Comparison")
def compare(
    model: Annotated[Any, Machine(("plant", "model", "uncertain", "any")), "Model file, plant, or file.py:name."],
    record: Measured,
    window: Window = None,
) -> Any:
    """Simulate a model with a recorded input and report where it disagrees with the recorded outputs.

    Example: robustlab data compare servo-axis emps.h5 --group train --outputs q --window 0.48
    Example: robustlab data compare mymachine.py:axis run3.csv --outputs q
    """
    return rl.compare(model, record, window=window)


@operation(
    "data discover", "discover", result="identification.missing_effects.discovery_result.Discovery", gives="plant",
    made="model", own=True, progress="parts",
)  # fmt: skip
def discover(
    model: Plant,
    records: Annotated[list[Any], RecordFile(many=True), "Records of one machine; FILE#GROUP takes that group."],
    held_out: Annotated[list[Any] | None, RecordFile(many=True), "Record that no fit uses, for the model error."]
    = None,
    tolerances: Tolerances = None,
    exclude: Exclude = None,
    window: Annotated[float | None, Number(above=0), "Length of the windows in s."] = None,
    progress: Callable[[str], None] | None = None,
) -> Any:  # fmt: skip
    """Identify the effect that a model lacks from measured records, and update the model with it.

    Exit code 0: the verdict is "named" or "no missing effect"; 4: it is "ambiguous" or "unknown", or more than half of
    the error remains unexplained, or the records are too poor for any verdict; 3: a record is wrong; 130: Ctrl-C ended
    the search, and the result has what was known by then.

    Example: robustlab data discover servo-axis emps.h5#train --held-out emps.h5#test --outputs q --out out/emps
    """
    return rl.discover(
        model, records, held_out or None, tolerances=tolerances, window=window, exclude=exclude or (), progress=progress
    )


@operation("data watch", "watch", result="identification.monitoring.Watch", progress="lines",
           calls="identification.monitoring.watch")  # fmt: skip
def watch(
    model: Plant,
    records: Annotated[list[Any], RecordFile(many=True), "The log: one record, or its pieces in their order."],
    noise: Annotated[
        dict[str, float],
        Table(Number(above=0), "outputs"),
        "Standard deviation of an output's noise in one sample, in its unit; of each recorded output.",
    ],
    every: Annotated[float | None, Number(above=0), "Cut each record into pieces of so many seconds."] = None,
    false_alarm: Annotated[
        float, Number(above=0, most=0.5), "Probability of an alarm in the whole log while the model explains it."
    ] = 0.01,
    exclude: Exclude = None,
    progress: Callable[[str], None] | None = None,
) -> Any:
    """Detect when a model stops explaining a log, and identify the change.

    Exit code 0: the model explains the log from beginning to end; 1: an alarm;
    3: a record is wrong; 4: the log has too little information for a test.

    Example: robustlab data watch axis.h5 monday.csv tuesday.csv --every 60 --inputs u --outputs q --noise q=1e-4
    """


@operation("data validate", "validate", result=f"{VALIDATED}validation_result.Validation", progress="lines",
           calls=f"{VALIDATED}model_validation.validate")  # fmt: skip
def validate(
    uncertain: UncertainPlant,
    record: Measured,
    *,
    noise: Annotated[
        dict[str, float],
        Table(Number(least=0), "outputs"),
        "Noise bound of an output, in its unit: largest, or rms in the frequency domain; of each compared output.",
    ],
    domain: Annotated[
        Literal["time", "frequency"], "time, or frequency: whole periods in steady state, line by line."
    ] = "time",
    at_rest: Annotated[bool, "The record starts at rest; otherwise its initial state is free."] = False,
    precision: Annotated[float, Number(least=1e-4, most=0.2), "Relative width of the bounds."] = 0.01,
    search: Search,
    progress: Callable[[str], None] | None = None,
) -> Any:
    """Find the smallest scaling of Delta with which an uncertain model could have produced a record.

    Exit code 0: the bounds of gamma are within the precision, or decide whether the set explains the record; 4: they
    decide nothing, or no Delta of any size explains the record.

    Example: robustlab data validate axis.h5 run3.csv --noise q=2e-5
    """


def _inferred_set(step: Any, ahead: Any) -> Any:
    return replace(ahead[None], outputs=ahead[step.of].outputs, leaves=type(step).leaves)  # loads are before its inputs


@operation("", "data-cover", result=f"{VALIDATED}model_validation.DataCover", gives="uncertain", made="model",
           infer=_inferred_set)  # fmt: skip
def data_cover(
    plant: Moved,
    records: Records,
    *,
    held_out: Annotated[Records, "Records on which the set is checked; they do not change it."] = (),
    noise: Annotated[
        dict[str, float], Table(Number(above=0), "outputs"), "Output that is compared -> largest noise, in its unit."
    ],
    margin: Annotated[float, Number(least=1), "Radius over the smallest that explains the records."] = 1.1,
    least: Annotated[float, Number(least=0, below=1), "Smallest radius of any set."] = 0.02,
    window: Annotated[
        float | None, Number(above=0), "s; each window with a free initial state. The whole record where left out."
    ] = None,
    at_rest: Annotated[bool, "The records start at rest."] = False,
    decimate: Annotated[int, Whole(1, 100), "Keep every n-th sample; inputs are averaged in between."] = 1,
    search: Search,
) -> Any:
    """The set of models around a plant that explains its records: tolerances, and the smallest unmodelled dynamics.

    Effects of the plant become bounded inputs ("load *") that are known along a record.
    """

    def thinned(name: str, r: Any) -> Any:
        # An input is averaged until the next kept sample, over which it is then held.
        n = r.n // decimate * decimate
        inputs = {key: u[:n].reshape(-1, decimate).mean(axis=1) for key, u in r.inputs.items()}
        outputs = {key: y[:n:decimate] for key, y in r.outputs.items()}
        return rl.Record(r.t[:n:decimate], inputs, outputs, r.units, name, r.meaning)

    sides = [[thinned(*item) for item in dict(side or {}).items()] for side in (records, held_out)]
    options: dict[str, Any] = {"margin": margin, "least": least, "window": window, "at_rest": at_rest}
    found = rl.data_cover(plant, sides[0], noise, held_out=sides[1], **options, **vars(search))
    if found.model is None:
        text = f"no unmodelled dynamics of {plant.name} explains {', '.join(records)}"
        raise NoTrustworthyNumber("data-cover", text, "a larger noise bound, or a plant that is nearer")
    return found


def _inferred_loads(step: Any, ahead: Any) -> Any:
    leaves = {**type(step).leaves, "largest": {"*": "1"}, "bound": {"*": float}}
    return replace(ahead[None], outputs=ahead[step.record].outputs, leaves=leaves)


@operation("", "with-loads", result="record.Record", gives="record", infer=_inferred_loads)
def with_loads(
    plant: Moved,
    record: Measured,
    sigmas: Annotated[float, Number(least=0, most=10), "As in the step that made the set."] = 2.0,
) -> Any:
    """A record with the bounded forces of a plant's effects as further inputs, computed by the plant.

    A set that takes such forces as inputs (`uncertain-from` without amplitudes) needs them for `validate` or `cover`.
    """
    from robustlab.dynamics.extended.effect_blocks import effect_loads

    made = effect_loads(plant, sigmas, [record])
    found = made.along(record)
    largest = {load.name: float(abs(found[load.name]).max()) for load in made.loads}
    numbers = {"largest": largest, "bound": {load.name: load.bound for load in made.loads}}
    return InLoop(found, notes=tuple(load.in_words for load in made.loads), numbers=numbers)


def _joined(step: Any, ahead: Any) -> Any:
    first, second = ahead[step.first], ahead[step.second]
    if None in (first.inputs, second.inputs):
        return ahead[None]
    inputs, outputs = first.inputs | second.inputs, first.outputs | second.outputs
    return replace(ahead[None], inputs=inputs, outputs=outputs)


@operation("", "join", result="record.Record", gives="record", infer=_joined,
           calls="identification.data_checks.resampling.join_clocks")  # fmt: skip
def join(
    first: Annotated[Measured, Named(key="first")],
    second: Measured,
    dt: Annotated[float | None, Number(above=0), "s; the coarser of the two where left out."] = None,
) -> Any:
    """One record from two loggers with different sample times; a shift between their clocks is not detected."""


@operation("", "cover", result="identification.comparison.envelope.EnvelopeCoverage",
           calls="identification.comparison.envelope.cover")  # fmt: skip
def cover(
    uncertain: UncertainPlant,
    record: Measured,
    n: Annotated[int, Whole(), Named(option="--samples,-n"), "Random members."] = 20,
    vertices: Annotated[int, Whole(), "Further members at vertices of the set."] = 0,
    rate: Annotated[
        float | None, Number(above=0), "Time in s over which mean rates of the outputs are judged as well."
    ] = None,
    allowance: Annotated[
        dict[str, float] | None,
        Table(Number(least=0), "outputs", "record"),
        "Largest error of the sensor of an output, in its unit.",
    ] = None,
    seed: Annotated[int | None, Whole(0, 2**63 - 1), "Seed of the members; in a recipe its own if left out."] = None,
) -> Any:
    """Check whether the envelope of an uncertain model's members contains a record. Sampled, not proved."""
