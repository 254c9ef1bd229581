"""``robustlab synth``: controllers from files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli import reduction
from robustlab.cli.console import JsonOption, OutOption, emit, note, table
from robustlab.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from robustlab.statespace import StateSpaceModel
    from robustlab.synthesis.design import Synthesis

app = typer.Typer(help="Design an H-infinity controller and verify it.", no_args_is_help=True)

FileArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", show_default=False)]
GammaRelOption = Annotated[
    float,
    typer.Option("--gamma-rel", help="Allowed ratio to the smallest gamma; within it the slowest controller wins."),
]
TimeLimitOption = Annotated[float, typer.Option("--time-limit", help="Time limit in s.")]


@app.command()
def hinf(
    file: FileArgument,
    n_meas: Annotated[int | None, typer.Option("--n-meas", help="Number of measurements (the last outputs).")] = None,
    n_con: Annotated[int | None, typer.Option("--n-con", help="Number of controls (the last inputs).")] = None,
    measurements: Annotated[str | None, typer.Option("--measurements", help="Measured outputs by name: a,b.")] = None,
    controls: Annotated[str | None, typer.Option("--controls", help="Control inputs by name: a,b.")] = None,
    gamma_rel: GammaRelOption = 1.05,
    time_limit: TimeLimitOption = 60.0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """H-infinity controller u = K y (positive feedback) of a generalised plant, verified in the loop rebuilt from K.

    Give the channels by number (--n-meas, --n-con: they come last in the file) or by name (--measurements, --controls).
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth hinf plant.h5 --n-meas 1 --n-con 1 --out controller.h5
    """
    by_name, by_number = (measurements, controls), (n_meas, n_con)
    if (None in by_name) == (None in by_number) or any(by_name) == any(n is not None for n in by_number):
        raise UsageError(
            "synth hinf", "channels are not given", "either --n-meas and --n-con, or --measurements and --controls"
        )
    from robustlab.storage import load
    from robustlab.synthesis import generalized_plant
    from robustlab.synthesis import hinf as design

    plant = load(file)
    if measurements is not None and controls is not None:
        plant = generalized_plant(plant, _names(measurements), _names(controls))
    _finish("synth hinf", design(plant, n_meas, n_con, gamma_rel=gamma_rel, time_limit=time_limit), file, out, as_json)


@app.command()
def mixsyn(
    file: FileArgument,
    w1: Annotated[
        str | None, typer.Option("--w1", help='On the error: a number, or "bandwidth=10,error=0.01,peak=2".')
    ] = None,
    w2: Annotated[
        str | None, typer.Option("--w2", help='On the control: a number, or "limit=20,bandwidth=1000".')
    ] = None,
    w3: Annotated[
        str | None, typer.Option("--w3", help='On the output: a number, or "bandwidth=100,peak=2,roll_off=0.001".')
    ] = None,
    inputs: Annotated[str | None, typer.Option("--inputs", help="Control inputs of the model to use: a,b.")] = None,
    outputs: Annotated[str | None, typer.Option("--outputs", help="Outputs of the model to control: a,b.")] = None,
    gamma_rel: GammaRelOption = 1.05,
    time_limit: TimeLimitOption = 60.0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Mixed-sensitivity controller u = K (r - y) of a plant, verified in the loop rebuilt from K.

    States that the chosen inputs and outputs do not touch are left out, with a note.
    Exit code 4: no controller could be vouched for.

    Example: robustlab synth mixsyn motor.h5 --outputs omega --w1 bandwidth=100,error=0.01 --w2 limit=2 --out k.h5
    """
    from robustlab.statespace import as_model
    from robustlab.storage import load
    from robustlab.structural import drop_unconnected
    from robustlab.synthesis import complementary_weight, control_weight, performance_weight
    from robustlab.synthesis import mixsyn as design

    weights = (
        _weight("--w1", w1, performance_weight),
        _weight("--w2", w2, control_weight),
        _weight("--w3", w3, complementary_weight),
    )
    if all(weight is None for weight in weights):
        raise UsageError("synth mixsyn", "no weight", "at least one of --w1, --w2, --w3")
    model = as_model(load(file), file)
    if inputs or outputs:
        model = model.select(_names(inputs) if inputs else None, _names(outputs) if outputs else None)
    kept = drop_unconnected(model)
    left_out = [name for name in model.state_names if name not in kept.state_names]
    if left_out:
        note(f"left out, for no chosen input or output touches them: states {', '.join(left_out)}")
    found = design(kept, *weights, gamma_rel=gamma_rel, time_limit=time_limit)
    _finish("synth mixsyn", found, file, out, as_json)


app.command("reduce")(reduction.reduce_controller)
app.command("discretise")(reduction.discretise_controller)


def _names(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _weight(option: str, text: str | None, make: Any) -> StateSpaceModel | float | None:
    """A number, or the weight that ``key=value,...`` specifies."""
    import inspect

    if text is None:
        return None
    if "=" not in text:
        return _number(option, text)
    known = list(inspect.signature(make).parameters)
    specification: dict[str, float] = {}
    for part in _names(text):
        key, _, value = part.partition("=")
        key = key.strip().replace("-", "_")
        if key not in known:
            raise UsageError(option, f"unknown word {key!r}", f"one of {', '.join(known)}", did_you_mean(key, known))
        specification[key] = _number(f"{option}: {key}", value)
    if "order" in specification and specification["order"].is_integer():
        specification["order"] = int(specification["order"])
    required = known[0]
    if required not in specification:
        raise UsageError(option, f"{required} is missing", f"at least {required}=NUMBER")
    return make(**specification)


def _number(where: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(where, f"{text.strip()!r}", "a number") from None


def _finish(command: str, found: Synthesis, file: str, out: str | None, as_json: bool) -> None:
    """Print the design, store the controller, and leave with the exit code of its status."""
    rows = found.summary()
    if out is not None:
        from robustlab.provenance import Provenance, file_sha256
        from robustlab.storage import save

        save(out, found.controller, Provenance.now(command, {file: file_sha256(file)}))
        rows.append(("written", out))
    emit(command, found.to_json(), table(rows), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)
