"""``robustlab model plot | response`` and ``robustlab data plot``: a model or measurement straight from its file."""

from __future__ import annotations

import cmath
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import FIGURE, emit, figure_place, note, save_drawing
from robustlab.cli.offers import one_of, plant_or_file
from robustlab.cli.options import (
    JsonOption,
    OutputOptions,
    RecordOptions,
    SeedOption,
    TableOptions,
    grouped,
    names,
    numbers,
)
from robustlab.cli.plant import plant_or_model
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import UsageError, did_you_mean
from robustlab.shown import text_table as table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Kind -> function of robustlab.report.model_figures.
KINDS = {"bode": "bode_figure", "step": "step_figure", "sigma": "sigma_figure", "pzmap": "pole_figure"}
CHANNELS = 4  # inputs or outputs in one figure

FigureOption = Annotated[str | None, typer.Option("--figure", "-o", help=f"{FIGURE}  [default: out/FILE-KIND]")]


@grouped
def plot_model(
    *,
    file: Annotated[
        str,
        typer.Argument(
            help="Model file, name of a plant, or file.py:name.", metavar="MODEL", autocompletion=plant_or_file
        ),
    ],
    kind: Annotated[str, typer.Option(help=f"{', '.join(KINDS)}.", autocompletion=one_of(*KINDS))] = "bode",
    inputs: Annotated[str | None, typer.Option(help="Inputs to draw.")] = None,
    outputs: Annotated[str | None, typer.Option(help="Outputs to draw.")] = None,
    n: Annotated[int, typer.Option("-n", "--samples", help="Members of an uncertain model that are drawn.")] = 30,
    seed: SeedOption = 0,
    figure: FigureOption = None,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Draw a model: frequency response, step response, singular values, or poles and zeros.

    Of an uncertain model sampled members and their envelope are drawn too; the true one may be wider.

    Example: robustlab model plot motor.h5 --outputs omega
    Example: robustlab model plot dc-motor --kind step --figure out/motor-step
    """
    if kind not in KINDS:
        raise UsageError(
            f"--kind {kind}", "no such figure", f"one of {', '.join(KINDS)}", did_you_mean(kind, list(KINDS))
        )
    from robustlab.report import model_figures

    with progress.shown("model plot"):
        drawn: Figure = getattr(model_figures, KINDS[kind])(_channels(_model(file), inputs, outputs), n=n, seed=seed)
        files = _write(drawn, figure, file, kind)
    emit("model plot", {"model": file, "kind": kind, "files": files}, "\n".join(files), as_json)


@grouped
def frequency_response(
    *,
    file: Annotated[
        str,
        typer.Argument(
            help="Model file, name of a plant, file.py:name, or a table in a text file.",
            metavar="MODEL",
            autocompletion=plant_or_file,
        ),
    ],
    frequency: Annotated[str | None, typer.Option(help="Of a model: rad/s, 1,10. A table has its own.")] = None,
    options: TableOptions,
    figure: Annotated[str | None, typer.Option(help=FIGURE)] = None,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Frequency response of a model, or a measured one from a table; --out writes frequency data, for mu and margins.

    A table has the frequency first, "f [Hz]" or "omega [rad/s]"; then "y from u real" and "y from u imag", or
    "... magnitude" (or "... magnitude [dB]") and "... phase [deg]"; and "... radius", where the error is known to be
    below it. With one channel alone "real", "imag", "radius" do.

    Example: robustlab model response motor.h5 --frequency 1,10,100
    Example: robustlab model response measured.csv --out data.h5
    """
    from robustlab.files.signature import content_of

    if Path(file).is_file() and content_of(file) == "text":
        given: Any = rl.UncertainFrequencyData.read(
            file, units=options.units, delimiter=options.delimiter, decimal=options.decimal
        )
    else:
        given = _model(file)
    measured = isinstance(given, rl.UncertainFrequencyData)
    if measured != (frequency is None):
        expected = f"none: {file} has its own" if measured else "--frequency 1,10 in rad/s, for a model"
        raise UsageError("model response", f"frequency {frequency}" if measured else "no frequencies", expected)
    with progress.shown("model response"):
        found = given if frequency is None else rl.frequency_data(given, numbers("--frequency", frequency))
    if figure is not None:
        from robustlab.report.result_figures import measured_response_figure

        save_drawing(measured_response_figure(found), figure)
    rows = [
        (f"{w:.6g}", f"{y.name} from {u.name}", f"{abs(g):.6g}", f"{math.degrees(cmath.phase(g)):.4f}")
        for w, matrix in zip(found.omega.tolist(), found.nominal.tolist(), strict=True)
        for y, row in zip(found.outputs, matrix, strict=True)
        for u, g in zip(found.inputs, row, strict=True)
    ]
    made = output.keep_made("model response", found, [file] if Path(file).is_file() else [])
    head = table([*((label, text) for label, text in found.facts() if text), *made])
    text = f"{head}\n\n{table(rows, ('rad/s', 'channel', 'magnitude', 'phase [deg]'))}"
    emit("model response", found.to_json(), text, output.as_json)


@grouped
def plot_record(
    *,
    file: Annotated[str, typer.Argument(help="HDF5, MATLAB, CSV or TXT file.", metavar="FILE")],
    options: RecordOptions,
    figure: FigureOption = None,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Draw the signals of a record over time, inputs first; of many the first eight, --outputs takes others.

    Example: robustlab data plot run3.csv --inputs u --outputs q
    """
    from robustlab.report.result_figures import record_figure

    with progress.shown("data plot"):
        record = options.read(file, options.inputs)
        files = _write(record_figure(record), figure, file, "record")
    emit("data plot", {"record": file, "files": files}, "\n".join(files), as_json)


def _model(name: str) -> Any:
    """A model, linearised at rest where it is a plant."""
    from robustlab.dynamics import Plant

    found = plant_or_model(name, [])
    return rl.linearise(found) if isinstance(found, Plant) else found


def _channels(model: Any, inputs: str | None, outputs: str | None) -> Any:
    """The model between the channels that were asked for; of many the first, with a note."""
    from robustlab.statespace import as_model

    model = model if isinstance(model, (rl.UncertainModel, rl.DelayedModel)) else as_model(model, "model plot")
    chosen = []
    for option, given, side in (("--inputs", inputs, model.inputs), ("--outputs", outputs, model.outputs)):
        known = [s.name for s in side]
        wanted = known[:CHANNELS] if given is None else names(given)
        if given is None and len(known) > CHANNELS:
            note(f"the first {CHANNELS} of {len(known)}: {option} takes others")
        missing = [name for name in wanted if name not in known]
        if missing or len(wanted) > CHANNELS:
            found = f"no {missing[0]!r}" if missing else f"{len(wanted)} channels"
            raise UsageError(option, found, f"at most {CHANNELS} of {', '.join(known)}")
        chosen.append(wanted)
    return model.select(*chosen)


def _write(drawn: Figure, figure: str | None, file: str, kind: str) -> list[str]:
    from robustlab.report.figures import save_figure

    own = f"{Path(file.replace(':', '-')).stem}-{kind}"
    place = (Path("out"), own) if figure is None else figure_place(figure, own)
    return [str(path) for path in save_figure(drawn, *place)]
