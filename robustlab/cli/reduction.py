"""Commands that make models and controllers smaller, or digital: ``model reduce | discretise``, ``synth ...``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import EffortOption, JsonOption, OutOption, TimeLimitOption, emit, note, table
from robustlab.errors import UsageError

if TYPE_CHECKING:
    from robustlab.synthesis.problem.partition import GeneralizedPlant

__all__ = ["discretise_controller", "discretise_model", "reduce_controller", "reduce_model"]

ModelArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", metavar="FILE", show_default=False)]
PlantArgument = Annotated[
    str, typer.Argument(help="Generalised plant: HDF5 or .mat file.", metavar="PLANT", show_default=False)
]
ControllerArgument = Annotated[
    str, typer.Argument(help="Its controller: HDF5 or .mat file.", metavar="CONTROLLER", show_default=False)
]
MeasurementsOption = Annotated[
    str | None, typer.Option("--measurements", help="Measured outputs by name, a,b; the last outputs where left out.")
]
ControlsOption = Annotated[
    str | None, typer.Option("--controls", help="Control inputs by name, a,b; the last inputs where left out.")
]
DtOption = Annotated[float, typer.Option("--dt", help="Sample time in s.", show_default=False)]
PrewarpOption = Annotated[
    float | None, typer.Option("--prewarp", help="tustin-prewarp: frequency in rad/s where it is exact.")
]


def reduce_model(
    file: ModelArgument,
    order: Annotated[int | None, typer.Option("--order", help="States of the result.")] = None,
    tolerance: Annotated[
        float | None, typer.Option("--tolerance", help="In place of --order: largest error, H-infinity norm.")
    ] = None,
    method: Annotated[str, typer.Option("--method", help="truncation, residualisation or coprime.")] = "truncation",
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """A model of lower order, with its certified H-infinity error beside what theory promises.

    Modes that are not stable are kept, or reduced too with --method coprime.
    Exit code 4: the error cannot be vouched for.

    Example: robustlab model reduce plant.h5 --tolerance 0.01 --out small.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.reduction.model_reduction import reduce_model as reduce

    method_given: Any = method
    found = reduce(as_model(load(file), file), order, tolerance=tolerance, method=method_given)
    rows = [*found.summary(), *_written("model reduce", out, found.model, {"model": file})]
    emit("model reduce", found.to_json(), table(rows), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)


def discretise_model(
    file: ModelArgument,
    dt: DtOption,
    method: Annotated[
        str, typer.Option("--method", help="tustin, tustin-prewarp, zoh, foh, impulse or matched.")
    ] = "tustin",
    prewarp: PrewarpOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """A discrete model of a continuous one, by formula.

    What a loop loses by it is what "synth discretise" computes.

    Example: robustlab model discretise motor.h5 --dt 0.001 --method zoh --out motor-1ms.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.sampled.discretisation import discretise, merged_modes

    model = as_model(load(file), file)
    method_given: Any = method
    found = discretise(model, dt, method_given, prewarp=prewarp)
    merged = merged_modes(model, dt)
    for pair in merged:
        note(f"warning: {file}: {pair}")
    rows = [("method", method), ("model", repr(found)), *_written("model discretise", out, found, {"model": file})]
    emit("model discretise", {"method": method, "model": found, "pathological": merged}, table(rows), as_json)


def reduce_controller(
    plant: PlantArgument,
    controller: ControllerArgument,
    loss: Annotated[float, typer.Option("--loss", help="Largest loss allowed, as a share.")] = 0.01,
    order: Annotated[int | None, typer.Option("--order", help="States of the result, whatever it loses.")] = None,
    measure: Annotated[
        str, typer.Option("--measure", help="hinf, h2, or mu (robust performance of an uncertain plant).")
    ] = "hinf",
    measurements: MeasurementsOption = None,
    controls: ControlsOption = None,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Controller of the lowest order whose closed loop, rebuilt and proved anew, loses no more than --loss.

    Exit code 4: no controller of the order wanted could be vouched for.

    Example: robustlab synth reduce plant.h5 controller.h5 --loss 0.02 --out small.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.reduction.controller_reduction import reduce_controller as reduce

    K = as_model(load(controller), controller)
    measure_given: Any = measure
    found = reduce(
        _plant(plant, K, measurements, controls), K, loss=loss, order=order, measure=measure_given,
        effort=effort, time_limit=time_limit, progress=_progress(),
    )  # fmt: skip
    files = {"plant": plant, "controller": controller}
    rows = [*found.summary(), *_written("synth reduce", out, found.controller, files)]
    emit("synth reduce", found.to_json(), table(rows), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)


def discretise_controller(
    plant: PlantArgument,
    controller: ControllerArgument,
    dt: DtOption,
    method: Annotated[
        str,
        typer.Option("--method", help="auto, direct, tustin, tustin-prewarp, zoh, foh, impulse or matched."),
    ] = "auto",
    loss: Annotated[float, typer.Option("--loss", help="Loss from which on auto tries a direct design.")] = 0.1,
    delay: Annotated[float, typer.Option("--delay", help="Computational delay in s.")] = 0.0,
    antialiasing: Annotated[
        float | None, typer.Option("--antialiasing", help="Corner of a filter before the sampler in rad/s.")
    ] = None,
    prewarp: PrewarpOption = None,
    measurements: MeasurementsOption = None,
    controls: ControlsOption = None,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Digital controller, with the proved norm of the sampled loop, between samples too, and what it loses.

    Of an uncertain plant the norm is that of the nominal loop, and mu of robust performance is proved for the sampled
    loop as well.

    Exit code 1: it loses more than --loss. Exit code 4: no method left the sampled loop stable.

    Example: robustlab synth discretise plant.h5 controller.h5 --dt 0.01 --out digital.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.synthesis.sampled.sampled_controller import discretise_controller as digital

    K = as_model(load(controller), controller)
    method_given: Any = method
    given = _plant(plant, K, measurements, controls)
    found = digital(
        _nominal(given), dt, K, method=method_given, loss=loss, delay=delay,
        antialiasing=antialiasing, prewarp=prewarp, effort=effort, time_limit=time_limit, progress=_progress(),
    )  # fmt: skip
    robust = None
    if given.blocks:
        from robustlab.synthesis.sampled.sampled_robustness import sampled_robustness

        robust = sampled_robustness(
            given, found.K, delay=delay, antialiasing=antialiasing, effort=effort, time_limit=time_limit,
            progress=_progress(),
        )  # fmt: skip
    files = {"plant": plant, "controller": controller}
    proved = [(f"sampled: {label}", text) for label, text in robust.summary()] if robust else []
    rows = [*found.summary(), *proved, *_written("synth discretise", out, found.controller, files)]
    data = found.to_json() | ({"robustness": robust.to_json()} if robust else {})
    emit("synth discretise", data, table(rows), as_json)
    if not (found.status.trustworthy and (robust is None or robust.status.trustworthy)):
        raise typer.Exit(4)
    if found.loss > loss:
        raise typer.Exit(1)


def _plant(file: str, K: Any, measurements: str | None, controls: str | None) -> GeneralizedPlant:
    """The generalised plant of the file: by names, or with as many channels at the end as the controller has."""
    from robustlab.storage import load
    from robustlab.synthesis.problem.partition import as_generalized_plant, generalized_plant

    if (measurements is None) != (controls is None):
        raise UsageError("--measurements, --controls", "one of them", "both, or none")
    loaded = load(file)
    if measurements is None or controls is None:
        return as_generalized_plant(loaded, K.n_inputs, K.n_outputs, file)
    names = [[part.strip() for part in text.split(",") if part.strip()] for text in (measurements, controls)]
    return generalized_plant(loaded, *names)


def _nominal(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant at Delta = 0."""
    from robustlab.synthesis.problem.partition import GeneralizedPlant
    from robustlab.uncertainty.lft import UncertainModel

    return GeneralizedPlant(UncertainModel(plant.model, plant.blocks).nominal, plant.n_meas, plant.n_con)


def _progress() -> Any:
    """Lines on stderr, on a terminal only."""
    return note if sys.stderr.isatty() else None


def _written(command: str, out: str | None, thing: Any, files: Mapping[str, str]) -> list[tuple[str, str]]:
    if out is None:
        return []
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage import save

    save(out, thing, Provenance.now(command, {path: file_sha256(path) for path in files.values()}))
    return [("written", out)]
