"""``robustlab uncertain``: build, show and sample uncertain models.

Sources of ``robustlab uncertain build`` beside two models: a set of models, a discovery's updated plant.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import typer

from robustlab.cli.console import (
    EffortOption,
    JsonOption,
    OutOption,
    SeedOption,
    TimeLimitOption,
    assignments,
    emit,
    ends,
    note,
    progress,
    shares,
    table,
)
from robustlab.errors import InputError, RobustlabError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robustlab.dynamics.extended.effect_blocks import EffectBlocks
    from robustlab.mu_analysis.margins.cover import Cover
    from robustlab.provenance import Provenance
    from robustlab.statespace import Signal
    from robustlab.uncertainty.blocks import ParameterRange
    from robustlab.uncertainty.elementwise import EndpointResidual
    from robustlab.uncertainty.lft import UncertainModel
    from robustlab.worst_case_analysis import Responses

__all__ = [
    "cover_of",
    "from_discovery",
]


app = typer.Typer(help="Build, show and sample uncertain models.", no_args_is_help=True)

UncertainArgument = Annotated[str, typer.Argument(help="HDF5 file with an uncertain model.", metavar="FILE")]
InputOption = Annotated[
    list[str] | None,
    typer.Option("--input", help="Constant input, u=42 or u=42V; may be repeated. A unit step where left out."),
]
EndOption = Annotated[float | None, typer.Option("--t-end", help="End time in s; from the nominal poles if left out.")]
PointsOption = Annotated[int, typer.Option("--points", help="Number of times, where --t-end is given.")]

SHOWN_BLOCKS = 40


@app.command()
def build(
    nominal: Annotated[
        str | None,
        typer.Argument(
            help="Nominal model; or one file with groups nominal and perturbed, or with a plant.", metavar="[NOMINAL]"
        ),
    ] = None,
    perturbed: Annotated[
        str | None, typer.Argument(help="Maximally perturbed model of the same signals.", metavar="[PERTURBED]")
    ] = None,
    structure: Annotated[
        str, typer.Option("--structure", help="elements, columns, rows, matrices or single.")
    ] = "elements",
    noise: Annotated[
        float | None,
        typer.Option("--noise", help="Relative differences up to this are noise; none where left out."),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option("--plant", help="Instead of models: a plant with uncertain parameters, or its file."),
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option("--tolerance", help="Relative tolerance of a plant's parameter, Km=0.05 or Km=5%; repeatable."),
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", help="Ends of a parameter of the plant around its value, NAME=LOW:HIGH; repeatable."),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option("--outputs", help="Outputs of the plant to keep: a,b; states they do not show are dropped."),
    ] = None,
    expressions: Annotated[
        str | None,
        typer.Option("--expressions", help="Instead of models: a TOML file with A, B, C, D in named parameters."),
    ] = None,
    cover: Annotated[
        list[str] | None,
        typer.Option("--cover", help="Instead: a file of a set of models that is to be covered; at least two times."),
    ] = None,
    form: Annotated[
        str,
        typer.Option(
            "--form",
            help="Of the cover: elements, pca, ellipsoid, additive, input-multiplicative, output-multiplicative, or"
            " inverse- and one of these three (inverse-additive, ...).",
        ),
    ] = "elements",
    order: Annotated[int, typer.Option("--order", help="Largest order of the cover's weight.")] = 4,
    directions: Annotated[
        int | None, typer.Option("--directions", help="Number of directions of the forms pca and ellipsoid.")
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option("--controller", help="File of a controller u = K y: the cover's worst gain is that of its loop."),
    ] = None,
    effort: EffortOption = 1.0,
    time_limit: TimeLimitOption = None,
    discovery: Annotated[
        str | None,
        typer.Option("--discovery", help="Instead: folder of data discover --out, or its updated plant."),
    ] = None,
    amplitude: Annotated[
        list[str] | None,
        typer.Option("--amplitude", help="With --discovery: amplitude of a speed or signal, NAME=VALUE; repeatable."),
    ] = None,
    dry: Annotated[
        str | None, typer.Option("--dry", help="With --discovery: dry friction as load (any speed), gain, or both.")
    ] = None,
    pade: Annotated[int, typer.Option("--pade", help="With --discovery: order of the Pade part of delays.")] = 2,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Uncertain model from two models, a set of models, a plant's ranges, a discovery, or matrices of expressions.

    Example: robustlab uncertain build nominal.h5 perturbed.h5 --structure elements --out uncertain.h5
    """
    from robustlab.storage import save

    if sum(source is not None for source in (plant, nominal, expressions, cover, discovery)) != 1:
        raise UsageError(
            "uncertain build",
            "no models, or both files and a plant or another source",
            "NOMINAL [PERTURBED], or --plant NAME, --expressions FILE, --cover FILE --cover FILE, or --discovery DIR",
        )
    if cover is not None:
        _build_cover(cover, out, as_json, form=form, order=order, directions=directions, tolerance=noise,
                     controller=controller, time_limit=time_limit, effort=effort)  # fmt: skip
        return
    if discovery is not None:
        kept = outputs.split(",") if outputs else None
        _build_discovery(discovery, kept, assignments("--amplitude", amplitude), dry, pade, out, as_json)
        return
    if nominal is not None and perturbed is None and _holds_plant(nominal):
        plant = nominal
    if expressions is not None:
        if outputs or tolerance or ranges:
            raise UsageError("uncertain build", "options of a plant with --expressions", "them with --plant only")
        model, residual, origin = _from_expressions(expressions)
    elif plant is not None:
        kept = outputs.split(",") if outputs else None
        model, residual, origin = _from_plant(plant, shares("--tolerance", tolerance), kept, ranges or [])
    else:
        assert nominal is not None
        if outputs or ranges:
            option = "--outputs" if outputs else "--range"
            raise UsageError("uncertain build", f"{option} without --plant", f"{option} with --plant NAME only")
        model, residual, origin = _from_models(nominal, perturbed, structure, noise)
    if not model.blocks:
        note("no uncertainty: mu = 0")
    if out is not None:
        save(out, model, origin)
    lines = [f"{out}: {model!r}" if out else repr(model), *_block_lines(model)]
    if residual is not None:
        lines.append(f"at Delta = I off the perturbed model by {residual.largest:.2g} of each matrix's largest entry")
    result = {
        "file": out,
        "structure": structure if nominal and not plant else "parameters",
        "delta_shape": model.delta_shape,
    }
    emit("uncertain build", {**result, "blocks": _blocks(model), "residual": residual}, "\n".join(lines), as_json)


def _build_cover(files: list[str], out: str | None, as_json: bool, **options: Any) -> None:
    from robustlab.result import Status
    from robustlab.storage import save

    found, origin = cover_of(files, options.pop("form"), **options)
    if out is not None:
        save(out, found.model, origin)
    lines = [*([f"{out}:"] if out else []), found.summary(), *_block_lines(found.model)]
    evidence = {key: value for key, value in vars(found).items() if key not in ("model", "deltas")}
    deltas = [{k: v for k, v in d.items() if isinstance(v, float)} for d in found.deltas]
    result = {"file": out, "delta_shape": found.model.delta_shape, "blocks": _blocks(found.model)}
    emit("uncertain build", {**result, **evidence, "deltas": deltas}, "\n".join(lines), as_json)
    judged = found.conservatism
    unproved = judged is not None and not (judged.status.trustworthy or judged.status is Status.FAILED)
    if not found.status.trustworthy or unproved:
        raise typer.Exit(4)


def _build_discovery(
    path: str,
    outputs: list[str] | None,
    amplitude: dict[str, float],
    dry: str | None,
    pade: int,
    out: str | None,
    as_json: bool,
) -> None:
    from robustlab.storage import save

    found, origin = from_discovery(path, outputs, amplitude, dry, pade)
    if out is not None:
        save(out, found.model, origin)
    lines = [f"{out}: {found.model!r}" if out else repr(found.model), *_block_lines(found.model), *found.rest()]
    result = {"file": out, "delta_shape": found.model.delta_shape, "blocks": _blocks(found.model)}
    told = {"noise": found.noise, "left_out": found.left_out}
    emit("uncertain build", {**result, **told}, "\n".join(lines), as_json)


@app.command()
def show(file: UncertainArgument, as_json: JsonOption = False) -> None:
    """Print the blocks, signals and nominal stability of an uncertain model.

    Example: robustlab uncertain show uncertain.h5
    """
    model = load_uncertain(file)
    nominal = model.nominal
    abscissa = nominal.spectral_abscissa()
    lines = [
        f"{file}: {model!r}",
        f"inputs: {', '.join(_named(model.inputs))}",
        f"outputs: {', '.join(_named(model.outputs))}",
        f"nominal spectral abscissa: {abscissa:.6g} ({'stable' if abscissa < 0 else 'not asymptotically stable'})",
        *_block_lines(model),
    ]
    result = {
        "file": file,
        "blocks": _blocks(model),
        "delta_shape": model.delta_shape,
        "nominal": nominal,
        "nominal_spectral_abscissa": abscissa,
    }
    emit("uncertain show", result, "\n".join(lines), as_json)


@app.command()
def sample(
    file: UncertainArgument,
    n: Annotated[int, typer.Option("-n", "--samples", help="Number of random samples.")] = 20,
    seed: SeedOption = 0,
    vertices: Annotated[str, typer.Option("--vertices", help="Vertices to add: a number, or all.")] = "0",
    inputs: InputOption = None,
    t_end: EndOption = None,
    points: PointsOption = 401,
    figure: Annotated[
        str | None, typer.Option("--figure", help="Folder for the envelope as SVG and PNG.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Time responses of random members and vertices: nominal, envelope, and the sample farthest from nominal.

    Example: robustlab uncertain sample uncertain.h5 -n 20 --seed 1 --vertices all --input u=42 --t-end 0.1
    """
    from robustlab.worst_case_analysis import sample as draw
    from robustlab.worst_case_analysis.ensemble import default_clock

    model = load_uncertain(file)
    clock = default_clock(model.nominal, "uncertain sample") if t_end is None else times(model.dt, t_end, points)
    members = draw(model, n, seed, _vertex_count(vertices))
    responses = members.respond(clock, assignments("--input", inputs, unit_of(model.inputs)) or None)
    if responses.unstable:
        note(f"{len(responses.unstable)} of {len(members)} samples are unstable: {_listed(responses.unstable)}")
    result: dict[str, Any] = {"file": file, "seed": seed, "vertices": members.vertices, **responses.to_json()}
    if figure is not None:
        from robustlab.report.figures import save_figure

        result["figures"] = [str(path) for path in save_figure(_envelope(responses), figure, "envelope")]
    emit("uncertain sample", result, _summary(responses, members.vertices), as_json)
    if not responses.status.trustworthy:
        raise typer.Exit(4)


# --- reading ---------------------------------------------------------------------------------------------------------


def load_uncertain(file: str) -> UncertainModel:
    """The uncertain model in a file, or an error that says what the file holds instead."""
    from robustlab.storage import load
    from robustlab.uncertainty.lft import UncertainModel

    model = load(file)
    if not isinstance(model, UncertainModel):
        raise InputError(
            file, f"holds a {type(model).__name__}", "an uncertain model", "make one with: robustlab uncertain build"
        )
    return model


def unit_of(signals: Iterable[Signal]) -> dict[str, str]:
    """Name -> unit."""
    return {s.name: s.unit for s in signals}


def times(dt: float, t_end: float, points: int) -> Any:
    """Times from 0 to ``t_end``: ``points`` of them, or every sample of a discrete model."""
    import numpy as np

    if not 0 < t_end < float("inf") or points < 2:
        raise UsageError("times", f"--t-end {t_end:g} with --points {points}", "a positive time and at least 2 points")
    return np.arange(round(t_end / dt) + 1) * dt if dt else np.linspace(0.0, t_end, points)


def _from_models(
    nominal: str, perturbed: str | None, structure: str, noise: float | None
) -> tuple[UncertainModel, EndpointResidual, Provenance]:
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.statespace import as_model
    from robustlab.storage import load, load_pair
    from robustlab.uncertainty.elementwise import elementwise, endpoint_residual

    if perturbed is None:
        first, second = load_pair(nominal)
    else:
        first, second = as_model(load(nominal), nominal), as_model(load(perturbed), perturbed)
    model = elementwise(first, second, structure, noise)
    files = {path: file_sha256(path) for path in (nominal, perturbed) if path is not None}
    note_text = f"structure {structure}" + (f", noise {noise:g}" if noise else "")
    return model, endpoint_residual(model, second), Provenance.now("uncertain build", files, note=note_text)


def _from_plant(
    name: str, tolerances: dict[str, float], outputs: list[str] | None, range_texts: list[str]
) -> tuple[UncertainModel, None, Provenance]:
    from robustlab.dynamics import plant
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage.plants import is_plant_file, load_plant

    from_file = is_plant_file(name)
    made = load_plant(name) if from_file else plant(name)
    if not hasattr(made, "uncertain"):
        raise InputError(name, f"{made.name} is not linear", "a linear plant, with or without effects")
    nominal = made.values
    ranges = ends("--range", range_texts, {p.name: p.unit for p in made.parameters.values()})
    unknown = [key for key in tolerances if key not in nominal]
    if unknown:
        raise UsageError(f"--tolerance {unknown[0]}", f"no such parameter of {name}", f"one of {', '.join(nominal)}")
    made = made.with_parameters(**{key: (nominal[key], value) for key, value in tolerances.items()})
    if ranges and hasattr(made, "effects"):
        raise UsageError("--range", f"{made.name} carries effects", "--tolerance NAME=VALUE")
    model = made.uncertain(outputs, ranges=ranges) if ranges else made.uncertain(outputs)
    for item in made.left_out() if hasattr(made, "left_out") else ():
        note(f"not in it: {item.effect.effect.title} at {item.effect.site}: {item.reason}")
    said = ", ".join(
        [f"{key} +-{100 * value:g} %" for key, value in tolerances.items()]
        + [f"{key} {low:g} .. {high:g}" for key, (low, high) in ranges.items()]
    )
    inputs = {name: file_sha256(name)} if from_file else None
    return model, None, Provenance.now("uncertain build", inputs, note=f"{name} {said}".strip())


def _from_expressions(file: str) -> tuple[UncertainModel, None, Provenance]:
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage.expression_files import load_parametric

    model = load_parametric(file)
    return model, None, Provenance.now("uncertain build", {file: file_sha256(file)}, note="expressions")


def _holds_plant(path: str) -> bool:
    """True for a file with a plant; what else is wrong with a file is said by whoever reads it as a model."""
    from robustlab.storage import read

    try:
        return read(path).kind == "plant"
    except RobustlabError:
        return False


def _vertex_count(text: str) -> Any:
    if text == "all":
        return "all"
    try:
        return int(text)
    except ValueError:
        raise UsageError("--vertices", text, "a whole number, or all") from None


# --- printing --------------------------------------------------------------------------------------------------------


def _named(signals: Any) -> list[str]:
    return [f"{s.name} [{s.unit}]" if s.unit else s.name for s in signals]


def _listed(indices: tuple[int, ...]) -> str:
    return ", ".join(map(str, indices[:10])) + (", ..." if len(indices) > 10 else "")


def _blocks(model: UncertainModel) -> Any:
    return model.to_json()["blocks"]


def _block_lines(model: UncertainModel) -> list[str]:
    """The blocks as a table, the first SHOWN_BLOCKS of them."""
    rows = []
    for block in model.blocks[:SHOWN_BLOCKS]:
        parameter = block.parameter
        stands_for = (
            f"{parameter.low:.6g} .. {parameter.high:.6g} {parameter.unit}{_around(parameter)}".rstrip()
            if parameter
            else "-"
        )
        rows.append((block.name, type(block).__name__, f"{block.rows} x {block.cols}", stands_for))
    if not rows:
        return []
    lines = table(rows, ("block", "kind", "size", "stands for")).splitlines()
    hidden = len(model.blocks) - len(rows)
    told = [f"{b.name}: {b.origin}" for b in model.blocks[:SHOWN_BLOCKS] if b.origin]
    return [*lines, *([f"... and {hidden} more blocks"] if hidden else []), *told]


def _around(parameter: ParameterRange) -> str:
    """The nominal value, where it is not the middle of the range."""
    return "" if parameter.below is None else f" around {parameter.nominal:.6g}"


def _summary(responses: Responses, vertices: int) -> str:
    rows = [
        (
            _named([signal])[0],
            f"{responses.nominal[-1, k]:.6g}",
            f"{responses.lower[-1, k]:.6g}",
            f"{responses.upper[-1, k]:.6g}",
            f"{responses.peak_deviation[k]:.6g}",
            str(responses.worst[k]),
        )
        for k, signal in enumerate(responses.outputs)
    ]
    header = ("output", "nominal end", "lowest end", "highest end", "peak deviation", "worst sample")
    count = len(responses.deltas)
    head = f"{count - vertices} random samples, {vertices} vertices, {responses.t[-1]:g} s ({responses.label})"
    return f"{head}\n{table(rows, header)}\nstatus: {responses.status}"


def _envelope(responses: Responses) -> Any:
    """Figure with one panel per output: envelope, samples, worst sample, nominal."""
    from robustlab.report.figures import COLOURS, axis_label, new_figure

    figure, axes = new_figure(rows=len(responses.outputs), height=2.4, sharex=True)
    t = responses.t
    for k, (axis, signal) in enumerate(zip(axes, responses.outputs, strict=True)):
        lower, upper = responses.lower[:, k], responses.upper[:, k]
        axis.fill_between(t, lower, upper, color=COLOURS["band"], alpha=0.3, linewidth=0, label="envelope")
        axis.plot(t, responses.y[:100, :, k].T, color=COLOURS["sample"], linewidth=0.6, alpha=0.7)
        axis.plot(t, responses.y[responses.worst[k], :, k], color=COLOURS["worst"], label="farthest sample")
        axis.plot(t, responses.nominal[:, k], color=COLOURS["nominal"], label="nominal")
        axis.set_ylabel(axis_label(signal.name, signal.unit))
    axes[0].legend()
    axes[-1].set_xlabel("t [s]")
    return figure


def cover_of(
    files: list[str],
    form: str,
    *,
    order: int,
    directions: int | None,
    tolerance: float | None,
    controller: str | None,
    time_limit: float | None,
    effort: float,
) -> tuple[Cover, Provenance]:
    """The cover of the models in the files, its worst gain in the loop of a controller where one is given."""
    from robustlab.mu_analysis.margins.cover import cover
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.statespace import as_model
    from robustlab.storage import load

    models = [as_model(load(path), path) for path in files]
    k = None if controller is None else as_model(load(controller), controller)
    loop = None if k is None else lambda g: g.feedback(k, 1)  # u = K y, positive feedback
    options: dict[str, Any] = {} if tolerance is None else {"tolerance": tolerance}
    with progress("cover") as advance:
        found = cover(
            models, form, directions=directions, order=order, loop=loop, time_limit=time_limit, effort=effort,
            progress=lambda text: advance(0, text), **options,
        )  # fmt: skip
    used = {path: file_sha256(path) for path in [*files, *([controller] if controller else [])]}
    return found, Provenance.now("uncertain build", used, note=f"{form} cover of {len(models)} models")


def from_discovery(
    path: str, outputs: list[str] | None, amplitude: dict[str, float], dry: str | None, pade: int
) -> tuple[EffectBlocks, Provenance]:
    """The blocks of an updated plant: a plant file, or the folder that ``data discover --out`` wrote."""
    from robustlab.cli.data import PLANT_FILE
    from robustlab.dynamics.extended.force_blocks import Dry
    from robustlab.identification.naming.remaining_uncertainty import uncertain_from
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage.plants import is_plant_file, load_plant

    file = str(Path(path) / PLANT_FILE) if Path(path).is_dir() else path
    if not is_plant_file(file):
        raise InputError(file, "no plant in it", f"{PLANT_FILE}, or the folder of: robustlab data discover --out DIR")
    if dry not in (None, *get_args(Dry)):
        raise UsageError("uncertain build", f"--dry {dry}", f"one of {', '.join(get_args(Dry))}")
    given = cast("Dry | None", dry)
    try:
        found = uncertain_from(load_plant(file), outputs, amplitude=amplitude, dry=given, pade=pade)
    except InputError as error:
        if "amplitude" in (error.expected or "") and error.hint:
            raise UsageError("uncertain build", error.found, "--amplitude NAME=VALUE for it", error.hint) from None
        raise
    for name, reason in found.left_out.items():
        note(f"not in it: {name}: {reason}")
    return found, Provenance.now("uncertain build", {file: file_sha256(file)}, note="discovery")
