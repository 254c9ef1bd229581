"""``robustlab model``: build, show, check, compare and convert models."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note, require_trust, table
from robustlab.cli.generated import add_commands
from robustlab.cli.margins import margins
from robustlab.cli.members import named
from robustlab.cli.offers import NORMS, REDUCTIONS, one_of, plant_or_file
from robustlab.cli.options import (
    BandOption,
    JsonOption,
    OutputOptions,
    assignments,
    band_of,
    ends,
    grouped,
    load_model,
    names,
    plant_settings,
    six_numbers,
)
from robustlab.cli.plant import made_of, read_plant
from robustlab.cli.plots import frequency_response, plot_model
from robustlab.cli.progress import ProgressOptions
from robustlab.cli.timing import d2c, d2d, delay_model, discretise, stability_lines
from robustlab.errors import NoTrustworthyNumber, UsageError, did_you_mean

if TYPE_CHECKING:
    from robustlab.storage import Loaded

app = typer.Typer(help="Build, show, check, compare and convert models.", no_args_is_help=True, add_completion=False)

ModelArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", metavar="FILE")]
FileArgument = Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="FILE")]
GroupOption = Annotated[str | None, typer.Option("--group", help="Group of the file that holds the model.")]
TransposeOption = Annotated[
    bool, typer.Option("--transpose", help="The file was written column by column: swap A, B, C, D.")
]
SHOWN_STATES = 12


@dataclass(frozen=True)
class ReadOptions:
    """How a file is to be read."""

    group: GroupOption = None
    transpose: TransposeOption = False
    no_verify: Annotated[bool, typer.Option("--no-verify", help="Load although the content hash does not match.")] = (
        False
    )

    def read(self, file: str) -> Loaded:
        """What the file holds; what is odd about it as notes."""
        from robustlab.storage import read

        loaded = read(file, **vars(self))
        for text in loaded.warnings:
            note(f"warning: {file}: {text}")
        return loaded


@app.command()
def build(
    plant: Annotated[
        str,
        typer.Argument(
            help="Name of the plant (dc-motor), file.py:name, or an HDF5 file with one.",
            metavar="PLANT",
            autocompletion=plant_or_file,
        ),
    ],
    out: Annotated[str, typer.Option("--out", "-o", help="HDF5 or MATLAB file to write.")],
    settings: Annotated[list[str] | None, typer.Option("--set", help="Parameter: NAME=VALUE.")] = None,
    pose: Annotated[
        str | None, typer.Option(help="Pose of a platform: tx,ty,tz,ax,ay,az in m and rad; home if left out.")
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(help="Rest of a nonlinear plant: input, output or state, NAME=VALUE; repeatable."),
    ] = None,
    amplitude: Annotated[
        list[str] | None, typer.Option(help="Amplitude of the speed or signal at an effect's place, NAME=VALUE.")
    ] = None,
    pade: Annotated[int, typer.Option(help="Order of the Pade approximation of delays; 0: left out.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Linearise a plant from physics and write its state-space model.

    Example: robustlab model build dc-motor --set R=2.2 --out motor.h5
    """
    from robustlab import dynamics
    from robustlab.dynamics.plant_contract import SteppedPlant
    from robustlab.provenance import Provenance

    parameters = plant_settings(settings)
    made = read_plant(plant, parameters)
    if pose is not None and at:
        raise UsageError("model build", "--pose and --at", "one of them")
    if at and not isinstance(made, dynamics.NonlinearPlant):
        raise UsageError("--at", f"{made.name} is linear", "no --at: its model is the same everywhere")
    point: Any = dynamics.trim(made, **assignments("--at", at)) if at else None if pose is None else six_numbers(pose)
    sectors = assignments("--amplitude", amplitude)
    model = dynamics.linearise(made, at=point, amplitude=sectors, pade=pade)
    given = ", ".join(f"{name}={value!r}" for name, value in parameters.items())
    where = f" at {pose}" if pose else f" at {', '.join(at)}" if at else ""
    rl.save(out, model, Provenance.now("model build", made_of(plant, made), note=f"{plant} {given}".strip() + where))
    missing = made.left_out(point, sectors, pade) if isinstance(made, SteppedPlant) else ()
    lines = [
        f"{out}: {model!r}",
        *(f"not in it: {m.effect.effect.title} at {m.effect.site}: {m.reason}" for m in missing),
    ]
    result = {"plant": plant, "parameters": parameters, "file": out, "model": model, "left_out": missing}
    emit("model build", result, "\n".join(lines), as_json)


@app.command()
@grouped
def show(*, file: FileArgument, options: ReadOptions, as_json: JsonOption = False) -> None:
    """Print what a file holds.

    Example: robustlab model show motor.h5
    """
    loaded = options.read(file)
    parts = [line for name, thing in _objects(loaded) for line in _describe(name, thing)]
    origin = loaded.provenance
    if origin is not None and (origin.created_by or origin.created):
        parts.append(
            f"made by {origin.created_by or 'unknown'} on {origin.created or 'an unknown day'} {origin.note}".rstrip()
        )
    content = {"nominal": loaded.object[0], "perturbed": loaded.object[1]} if loaded.kind == "pair" else loaded.object
    result = {
        "file": file,
        "kind": loaded.kind,
        "verified": loaded.verified,
        "warnings": loaded.warnings,
        "provenance": origin,
    }
    emit("model show", {**result, "content": content}, "\n".join([f"{file}: {_kind_line(loaded)}", *parts]), as_json)


@app.command()
@grouped
def check(*, file: FileArgument, options: ReadOptions, progress: ProgressOptions, as_json: JsonOption = False) -> None:
    """Check a file and the model in it: poles, stability, controllability, observability.

    Of a model with exact delays: whether it is stable, proved for all frequencies, or refuted by a root.
    Exit code 4: neither could be shown.

    Example: robustlab model check motor.h5
    """
    loaded = options.read(file)
    if isinstance(loaded.object, rl.DelayedModel):
        with progress.shown("model check"):
            told, found = stability_lines(loaded.object)
        head = {"file": file, "kind": loaded.kind, "verified": loaded.verified, "warnings": loaded.warnings}
        text = "\n".join([f"{file}: {_kind_line(loaded)}", *told])
        emit("model check", {**head, "stability": found}, text, as_json)
        require_trust(found.status)
        return
    lines, result, doubtful = [f"{file}: {_kind_line(loaded)}"], {}, False
    with progress.shown("model check"):
        tested = [
            (name, model, [rl.controllability(model), rl.observability(model)]) for name, model in _models(loaded)
        ]
    for name, model, tests in tested:
        doubtful = doubtful or not all(test.status.trustworthy for test in tests)
        lines += [f"{name}{model!r}", f"  {_stability(model)}"]
        lines += [f"  pole {_complex(pole)}" for pole in sorted(model.poles(), key=lambda p: (-p.real, p.imag))]
        lines += [f"  {line}" for test in tests for line in str(test).splitlines()]
        result[name.rstrip(": ") or "model"] = {
            "poles": model.poles(),
            "spectral_abscissa": model.spectral_abscissa(),
            "stable": model.is_stable(),
            "controllability": tests[0],
            "observability": tests[1],
        }
    head = {"file": file, "kind": loaded.kind, "verified": loaded.verified, "warnings": loaded.warnings}
    emit("model check", {**head, **result}, "\n".join(lines), as_json)
    if doubtful:
        raise typer.Exit(NoTrustworthyNumber.exit_code)


@app.command()
def diff(
    first: Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="A")],
    second: Annotated[
        str | None,
        typer.Argument(help="The other file; left out where A holds a nominal and a perturbed model.", metavar="[B]"),
    ] = None,
    rtol: Annotated[float, typer.Option(help="Relative changes up to this are not shown.")] = 0.0,
    transpose: TransposeOption = False,
    as_json: JsonOption = False,
) -> None:
    """Print the entries in which two models differ.

    Example: robustlab model diff nominal.h5 perturbed.h5
    """
    from robustlab.storage import load_pair
    from robustlab.storage.pairs import difference

    if second is None:
        a, b = load_pair(first, transpose=transpose)
    else:
        a, b = (load_model(path, transpose) for path in (first, second))
    changes = difference(a, b, rtol)
    rows = [
        (f"{c.matrix}[{c.row}, {c.column}]", f"{c.first:.9g}", f"{c.second:.9g}", f"{100 * c.relative:+.4g} %")
        for c in changes
    ]
    total = a.A.size + a.B.size + a.C.size + a.D.size
    text = table(rows, ("entry", "first", "second", "change")) + "\n" if rows else ""
    emit("model diff", {"changes": changes, "entries": total}, f"{text}{len(rows)} of {total} entries differ", as_json)


@app.command()
def convert(
    source: Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="IN")],
    target: Annotated[
        str,
        typer.Argument(
            help="File to write: .h5 (format 1), .mat (MATLAB version 5), .json, or .c (a discrete controller as C99).",
            metavar="OUT",
        ),
    ],
    group: GroupOption = None,
    transpose: TransposeOption = False,
    prefix: Annotated[str, typer.Option(help="Of the names in a .c file.")] = "controller",
    saturation: Annotated[
        list[str] | None, typer.Option(help="Limits of a control signal in .c or .json, NAME=LOW:HIGH; repeatable.")
    ] = None,
    anti_windup: Annotated[
        float | None,
        typer.Option(
            help="With --saturation in .c: time in s in which the states recover; inf: none.  [default: 10 samples]"
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a model in another format: HDF5, MATLAB version 5, JSON; a discrete controller as C99.

    Example: robustlab model convert plant.mat plant.h5
    """
    from robustlab.provenance import Provenance, file_sha256

    loaded = ReadOptions(group, transpose).read(source)
    if loaded.kind == "pair":
        raise UsageError(source, "two models, /nominal and /perturbed", "one", "--group nominal, or --group perturbed")
    origin = Provenance.now("model convert", inputs={source: file_sha256(source)})
    limits = ends("--saturation", saturation) or None
    if limits is not None or anti_windup is not None or target.lower().endswith((".c", ".json")):
        rl.export_controller(
            target, loaded.object, prefix=prefix, saturation=limits, anti_windup=anti_windup, provenance=origin
        )
    else:
        rl.save(target, loaded.object, origin)
    emit("model convert", {"from": source, "to": target, "kind": loaded.kind}, f"{target}: {loaded.object!r}", as_json)


@app.command()
@grouped
def norm(
    *,
    file: FileArgument,
    kind: Annotated[str, typer.Option(help="hinf, linf, h2 or passivity.", autocompletion=one_of(*NORMS))] = "hinf",
    band: BandOption = None,
    options: ReadOptions,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """A norm of a model with its evidence: peak gain (hinf; linf of unstable models), white noise (h2), passivity.

    Exit code 4: the number cannot be vouched for.

    Example: robustlab model norm motor.h5 --kind h2
    """
    part = band_of(band)
    peaks = [partial(rl.peak_gain, norm="hinf"), partial(rl.peak_gain, norm="linf", band=part)]
    functions: dict[str, Any] = dict(zip(NORMS, (*peaks, rl.h2_norm, rl.passivity), strict=True))
    if part is not None and kind != "linf":
        raise UsageError("--band", f"--kind {kind}", "--kind linf: the peak gain in the band")
    if kind not in functions:
        raise UsageError(f"--kind {kind}", "no such norm", ", ".join(NORMS), did_you_mean(kind, NORMS))
    loaded = options.read(file)
    with progress.shown("model norm"):
        found = [(name, functions[kind](model)) for name, model in _models(loaded)]
    text = "\n".join(f"{name}{value.summary()}" for name, value in found)
    result = {name.rstrip(": ") or "model": value for name, value in found}
    emit("model norm", {"file": file, "kind": kind, **result}, text, as_json)
    for _, value in found:
        require_trust(value.status)


@app.command()
@grouped
def connect(
    *,
    files: Annotated[list[str], typer.Argument(help="HDF5 or MATLAB files, nominal or uncertain.", metavar="FILE...")],
    inputs: Annotated[str | None, typer.Option(help="Signals from outside.")] = None,
    outputs: Annotated[str | None, typer.Option(help="Signals to show.")] = None,
    sums: Annotated[list[str] | None, typer.Option("--sum", help='Summing junction: "e = r - y"; repeatable.')] = None,
    output: OutputOptions,
) -> None:
    """Wire models by the names of their signals: an output feeds every input of the same name.

    Example: robustlab model connect motor.h5 pi.h5 --sum "e = r - omega" --inputs r --outputs omega --out loop.h5
    """
    from robustlab.uncertainty.named_wiring import connected

    outside, seen = names(inputs or ""), names(outputs or "")
    found = connected([rl.load(file) for file in files], files, outside, seen, sums or [])
    rows = [*found.facts(), *output.keep_made("model connect", found, files)]
    emit("model connect", {"model": found}, table(rows), output.as_json)


app.command()(margins)
add_commands(app, "model", "analysis")
app.command("delay")(delay_model)
app.command("plot")(plot_model)
app.command("response")(frequency_response)


@dataclass(frozen=True)
class ReductionOptions:
    """How a model is made smaller."""

    method: Annotated[
        str,
        typer.Option(
            help="truncation, residualisation, hankel, stochastic (relative error) or coprime.",
            autocompletion=one_of(*REDUCTIONS),
        ),
    ] = "truncation"
    input_weight: Annotated[
        str | None, typer.Option(help="File with a stable model W_i: the error is W_o (G - Gr) W_i.")
    ] = None
    output_weight: Annotated[str | None, typer.Option(help="The same for W_o.")] = None
    band: BandOption = None
    floor: Annotated[float, typer.Option(help="Of stochastic: gain below which errors count absolutely.")] = 0.0

    def arguments(self) -> dict[str, Any]:
        """As `robustlab.reduce_model` takes them."""
        files = {"input_weight": self.input_weight, "output_weight": self.output_weight}
        weights = {name: None if file is None else rl.load(file) for name, file in files.items()}
        return {"method": self.method, "band": band_of(self.band), "floor": self.floor, **weights}


@app.command()
@grouped
def reduce(
    *,
    file: ModelArgument,
    order: Annotated[int | None, typer.Option(help="States of the result.")] = None,
    max_error: Annotated[float | None, typer.Option(help="In place of --order: largest error, as it is told.")] = None,
    how: ReductionOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """A model of lower order, with its certified error beside what theory promises.

    Modes that are not stable are kept, or reduced too with --method coprime.
    Exit code 4: the error cannot be vouched for, or the model of that order is not stable.

    Example: robustlab model reduce plant.h5 --max-error 0.01 --out small.h5
    """
    with progress.shown("model reduce"):
        found = rl.reduce_model(load_model(file), order, tolerance=max_error, **how.arguments())
    files = [f for f in (file, how.input_weight, how.output_weight) if f is not None]
    output.finish_made("model reduce", found, found.model, files)


app.command()(discretise)
app.command()(d2c)
app.command()(d2d)


# --- reading and printing --------------------------------------------------------------------------------------------


def _objects(loaded: Loaded) -> list[tuple[str, Any]]:
    if loaded.kind == "pair":
        return list(zip(("nominal: ", "perturbed: "), loaded.object, strict=True))
    return [("", loaded.object)]


def _models(loaded: Loaded) -> list[tuple[str, rl.StateSpaceModel]]:
    from robustlab.dynamics.plant_contract import Plant
    from robustlab.statespace import as_model

    return [
        (name, rl.linearise(thing) if isinstance(thing, Plant) else as_model(thing, loaded.path))
        for name, thing in _objects(loaded)
    ]


def _kind_line(loaded: Loaded) -> str:
    return f"{loaded.kind}, " + ("content hash verified" if loaded.verified else "not verified by a content hash")


def _stability(model: rl.StateSpaceModel) -> str:
    if not model.n_states:
        return "static gain: no poles"
    value = model.spectral_abscissa()
    if model.is_discrete:
        return f"{'stable' if value < 0 else 'NOT stable'}: largest pole modulus {1 + value:.6g}"
    return f"{'stable' if value < 0 else 'NOT stable'}: spectral abscissa {value:.6g} 1/s"


def _complex(pole: complex) -> str:
    return f"{pole.real:.6g}" + (f"{pole.imag:+.6g}j" if pole.imag else "")


def _describe(name: str, thing: Any) -> list[str]:
    """A few lines about any object that a file can hold."""
    from robustlab.dynamics.plant_contract import Plant

    if isinstance(thing, rl.DelayedModel):
        lengths = ", ".join(f"{t:.6g}" for t in thing.delays.tolist())
        return [repr(thing), f"  delays: {lengths} s", *_describe("between them: ", thing.H)]
    if isinstance(thing, rl.StateSpaceModel):
        return [f"{name}{thing!r}", *_signal_lines(thing), *_matrix_lines(thing)]
    if isinstance(thing, Plant):
        return _plant_lines(thing)
    if isinstance(thing, rl.Controller):
        gamma = "none" if thing.gamma is None else f"{thing.gamma:.6g}"
        return [f"method {thing.method or 'unknown'}, gamma {gamma} ({thing.status})", *_describe(name, thing.K)]
    if isinstance(thing, rl.UncertainModel):
        rows = [(b.name, type(b).__name__, f"{b.rows} x {b.cols}", _range(b)) for b in thing.blocks]
        return [
            f"{thing!r}",
            *table(rows, ("block", "kind", "size", "range")).splitlines(),
            *_describe("nominal: ", thing.nominal),
        ]
    return [repr(thing)]


def _plant_lines(plant: Any) -> list[str]:
    """Parameters, effects with their parameters, and signals."""
    rows = [
        (p.name, f"{p.value:.6g} {p.unit}".strip(), f"+-{p.tolerance_text}" if p.tolerance else "exact", p.source)
        for p in plant.parameters.values()
    ]
    lines = [f"plant {plant.name}", *table(rows, ("parameter", "value", "tolerance", "source")).splitlines()]
    for e in getattr(plant, "effects", ()):
        values = e.to_json()["parameters"]
        lines.append(f"effect {e.effect.title} at {e.site}: {e.effect.equation}")
        for name, v in values.items():
            spread = "" if v["std"] is None else f" +- {v['std']:.3g} (one sd)"
            lines.append(f"  {name} = {v['value']:.6g}{spread} {v['unit']}".rstrip())
        if e.source:
            lines.append(f"  from {e.source}")
    return [*lines, *_signal_lines(plant)]


def _range(block: Any) -> str:
    parameter = block.parameter
    if parameter is None:
        return ""
    if parameter.below is not None:
        return f"{parameter.nominal:.6g} +{parameter.radius:.6g} -{parameter.below:.6g} {parameter.unit}".rstrip()
    return f"{parameter.nominal:.6g} +- {parameter.radius:.6g} {parameter.unit}".rstrip()


def _signal_lines(model: rl.StateSpaceModel | Any) -> list[str]:
    def line(word: str, signals: tuple[rl.Signal, ...]) -> str:
        return f"  {word}: " + ", ".join(named(signals))

    return [line("inputs", model.inputs), line("outputs", model.outputs), line("states", model.states)]


def _matrix_lines(model: rl.StateSpaceModel) -> list[str]:
    if max(model.n_states, model.n_inputs, model.n_outputs) > SHOWN_STATES:
        return [f"  matrices larger than {SHOWN_STATES}: --json prints them"]
    return str(model).splitlines()[1:]
