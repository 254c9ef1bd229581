"""Operations on measured records: checks, comparison with a model, missing effects, validation of a set."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import robustlab as rl
from robustlab.errors import NoTrustworthyNumber
from robustlab.operations.common_parameters import Measured, Moved, Plant, UncertainPlant
from robustlab.operations.declaration import InLoop, operation, public
from robustlab.operations.parameter_types import Machine, Names, Number, RecordFile, Share, Table, Whole

TOLERANCE = "Relative tolerance of a parameter, replaces the plant's own: Km=0.05 or Km=5%."
Records = Annotated[Any, RecordFile(named=True), "Records that the set must explain."]
Exclude = Annotated[list[str] | None, Names(repeated=True), "Id of an effect to leave out of the search."]


SUITED, VALIDATED = "identification.data_checks.suitability.", "identification.validation."


public(
    f"{SUITED}check_record", "data check", "check-record", result=f"{SUITED}RecordCheck",
    kinds={
        "record": (RecordFile(remarks=False), "HDF5, MATLAB, CSV or TXT file."),
        "plant": (
            Machine(option="--model", key="model"),
            "A model: check also whether the record suits the identification of its missing effects.",
        ),
    },
    text="""Example: robustlab data check run3.csv --inputs u --outputs q
Example: robustlab data check run3.csv --model servo-axis
Example: robustlab data check run.csv --inputs u=command --outputs q=position""",
)  # fmt: skip


public(
    "identification.comparison.comparison.compare", "data compare", "compare",
    result="identification.comparison.comparison.Comparison",
    kinds={
        "plant": (Machine(("plant", "model", "uncertain", "any")), "Model file, plant, or file.py:name."),
        "record": Measured, "window": Number(above=0),
    },
    text="""Example: robustlab data compare servo-axis emps.h5 --group train --outputs q --window 0.48
Example: robustlab data compare mymachine.py:axis run3.csv --outputs q""",
)  # fmt: skip
public(
    "identification.missing_effects.discovery.discover", "data discover", "discover", gives="plant", made="model",
    result="identification.missing_effects.discovery_result.Discovery", progress="parts",
    kinds={
        "plant": Plant, "records": (RecordFile(many=True), "Records of one machine; FILE#GROUP takes that group."),
        "held_out": (RecordFile(many=True), "Record that no fit uses, for the model error."),
        "tolerances": (Table(Share(above=0), "parameters", option="--tolerance"), TOLERANCE),
        "window": Number(above=0), "exclude": Exclude,
    },
    text="""Exit code 0: the verdict is "named" or "no missing effect"; 4: it is "ambiguous" or "unknown", or more than
half of the error remains unexplained, or the records are too poor for any verdict; 3: a record is wrong; 130: Ctrl-C
ended the search, and the result contains what was found until then.

Example: robustlab data discover servo-axis emps.h5#train --held-out emps.h5#test --outputs q --out out/emps""",
)  # fmt: skip
public(
    "identification.monitoring.watch", "data watch", "watch", result="identification.monitoring.Watch",
    progress="lines",
    kinds={
        "model": Plant, "records": (RecordFile(many=True), "The log: one record, or its pieces in their order."),
        "noise": Table(Number(above=0), "outputs"), "every": Number(above=0),
        "false_alarm": Number(above=0, most=0.5), "exclude": Exclude,
    },
    text="""Exit code 0: the model explains the log from beginning to end; 1: an alarm;
3: a record is wrong; 4: the log has too little information for a test.

Example: robustlab data watch axis.h5 monday.csv tuesday.csv --every 60 --inputs u --outputs q --noise q=1e-4""",
)  # fmt: skip


public(
    f"{VALIDATED}model_validation.validate", "data validate", "validate", progress="lines",
    result=f"{VALIDATED}validation_result.Validation",
    kinds={
        "uncertain": UncertainPlant, "record": Measured, "noise": Table(Number(least=0), "outputs"), "window": None,
        "precision": Number(least=1e-4, most=0.2),
    },
    text="""Exit code 0: the bounds of gamma are within the precision, or decide whether the set explains the record;
4: they decide nothing, or no Delta of any size explains the record.

Example: robustlab data validate axis.h5 run3.csv --noise q=2e-5""",
)  # fmt: skip


@operation(
    "", "data-cover", result=f"{VALIDATED}model_validation.DataCover", gives="uncertain", made="model",
    infer=("", "of"), public=f"{VALIDATED}model_validation.data_cover",
    kinds={
        "noise": Table(Number(above=0), "outputs"), "margin": Number(least=1), "least": Number(least=0, below=1),
        "window": (
            Number(above=0), "s; each window with a free initial state. The whole record where left out."
        ),
        "at_rest": "The records start at rest.",
    },
)  # fmt: skip
def data_cover(
    plant: Moved,
    records: Records,
    *,
    held_out: Annotated[Records, "Records on which the set is checked; they do not change it."] = (),
    decimate: Annotated[int, Whole(1, 100), "Keep every n-th sample; inputs are averaged in between."] = 1,
    **options: Any,
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
    found = rl.data_cover(plant, sides[0], held_out=sides[1], **options)
    if found.model is None:
        text = f"no unmodelled dynamics of {plant.name} explains {', '.join(records)}"
        raise NoTrustworthyNumber("data-cover", text, "a larger noise bound, or a plant that is nearer")
    return found


@operation(
    "", "with-loads", result="record.Record", gives="record", infer=("", "record"),
    numbers={"largest": {"*": "1"}, "bound": {"*": float}},
)  # fmt: skip
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


public(
    "identification.data_checks.resampling.join_clocks", "", "join", result="record.Record", gives="record",
    infer=_joined,
    kinds={
        "first": (RecordFile(key="first"), "Record of the first logger."), "second": Measured,
        "dt": (Number(above=0), "s; the coarser of the two where left out."),
    },
)  # fmt: skip
public(
    "identification.comparison.envelope.cover", "", "cover",
    result="identification.comparison.envelope.EnvelopeCoverage",
    kinds={
        "uncertain": UncertainPlant, "n": (Whole(), "Random members."),
        "vertices": (Whole(), "Further members at vertices of the set."), "rate": Number(above=0),
        "allowance": Table(Number(least=0), "outputs", "record"),
    },
)  # fmt: skip
