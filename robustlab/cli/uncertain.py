"""``robustlab uncertain``: build, show and sample uncertain models."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

import robustlab as rl
from robustlab.cli.console import FIGURE, emit, note, require_trust, save_figures, table
from robustlab.cli.margins import ControllerOptions
from robustlab.cli.members import SHOWN_BLOCKS, ResponseOptions, UncertainArgument, load_uncertain, named
from robustlab.cli.offers import COVERS, one_of, plant_or_file
from robustlab.cli.options import (
    EffortOptions,
    JsonOption,
    OutputOptions,
    SeedOption,
    assignments,
    ends,
    grouped,
    load_model,
    plant_settings,
    shares,
    six_numbers,
)
from robustlab.cli.plant import made_of, read_plant
from robustlab.cli.progress import ProgressOptions
from robustlab.cli.timing import cover_delays, neglected_weight
from robustlab.errors import InputError, RobustlabError, UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robustlab.dynamics.extended.effect_blocks import EffectBlocks
    from robustlab.mu_analysis.margins.cover import Cover
    from robustlab.provenance import Provenance
    from robustlab.uncertainty.elementwise import EndpointResidual
    from robustlab.worst_case_analysis import Responses

app = typer.Typer(help="Build, show and sample uncertain models.", no_args_is_help=True, add_completion=False)


# --- what an uncertain model is made of ------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoModels:
    """A nominal model, and the same as far perturbed as it may go."""

    nominal: Annotated[
        str | None,
        typer.Argument(
            help="Nominal model; or one file with groups nominal and perturbed, or with a plant.", metavar="[NOMINAL]"
        ),
    ] = None
    perturbed: Annotated[
        str | None, typer.Argument(help="Maximally perturbed model of the same signals.", metavar="[PERTURBED]")
    ] = None
    structure: Annotated[
        str,
        typer.Option(
            help="elements, columns, rows, matrices or single.",
            autocompletion=one_of("elements", "columns", "rows", "matrices", "single"),
        ),
    ] = "elements"
    rtol: Annotated[
        float | None, typer.Option(help="Relative differences up to this are noise; none where left out.")
    ] = None

    def build(self) -> tuple[rl.UncertainModel, EndpointResidual, Provenance]:
        """The set between the two, and what it misses of the perturbed one."""
        from robustlab.provenance import Provenance, file_sha256
        from robustlab.storage import load_pair
        from robustlab.uncertainty.elementwise import endpoint_residual

        assert self.nominal is not None
        if self.perturbed is None:
            first, second = load_pair(self.nominal)
        else:
            first, second = (load_model(path) for path in (self.nominal, self.perturbed))
        model = rl.elementwise(first, second, self.structure, self.rtol)
        files = {path: file_sha256(path) for path in (self.nominal, self.perturbed) if path is not None}
        said = f"structure {self.structure}" + (f", noise {self.rtol:g}" if self.rtol else "")
        return model, endpoint_residual(model, second), Provenance.now("uncertain build", files, note=said)


@dataclass(frozen=True)
class PlantRanges:
    """A plant, and how far its parameters may be off."""

    plant: Annotated[
        str | None,
        typer.Option(
            help="Instead of models: an uncertain plant: its name, file.py:name, or HDF5 file.",
            autocompletion=plant_or_file,
        ),
    ] = None
    tolerance: Annotated[
        list[str] | None, typer.Option(help="Relative tolerance of a plant's parameter, Km=0.05 or Km=5%; repeatable.")
    ] = None
    ranges: Annotated[
        list[str] | None,
        typer.Option("--range", help="Ends of a parameter of the plant around its value, NAME=LOW:HIGH; repeatable."),
    ] = None
    outputs: Annotated[
        str | None, typer.Option(help="Outputs of the plant to keep: a,b; states they do not show are dropped.")
    ] = None

    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="Value or choice of the plant, NAME=VALUE, such as motors=true; repeatable."),
    ] = None
    pose: Annotated[
        str | None, typer.Option(help="Of a platform: tx,ty,tz,ax,ay,az in m and rad; home if left out.")
    ] = None
    at: Annotated[
        list[str] | None,
        typer.Option(help="Rest of a nonlinear plant: input, output or state, NAME=VALUE; repeatable."),
    ] = None
    hold: Annotated[
        str | None, typer.Option(help="States and inputs a,b of a nonlinear plant that stay while parameters change.")
    ] = None

    def build(self, name: str, outputs: list[str] | None) -> tuple[rl.UncertainModel, Provenance]:
        """The set of a plant of that name, or in that file."""
        from robustlab.provenance import Provenance

        tolerances = shares("--tolerance", self.tolerance)
        made = read_plant(name, plant_settings(self.settings))
        files = made_of(name, made)
        nominal = made.values
        ranges = ends("--range", self.ranges, {p.name: p.unit for p in made.parameters.values()})
        unknown = [key for key in tolerances if key not in nominal]
        if unknown:
            raise UsageError(
                f"--tolerance {unknown[0]}", f"no such parameter of {name}", f"one of {', '.join(nominal)}"
            )
        made = made.with_parameters(**{key: (nominal[key], value) for key, value in tolerances.items()})
        if ranges and hasattr(made, "effects"):
            raise UsageError("--range", f"{made.name} carries effects", "--tolerance NAME=VALUE")
        options: dict[str, Any] = {"ranges": ranges} if ranges else {}
        model = made.uncertain(outputs, **options, **self._rest(made))
        for item in made.left_out() if hasattr(made, "left_out") else ():
            note(f"not in it: {item.effect.effect.title} at {item.effect.site}: {item.reason}")
        without = {*tolerances, *ranges} - {b.name for b in model.blocks}
        if without and not hasattr(made, "effects"):
            note(f"without effect on the linear model: {', '.join(sorted(without))}")
        said = ", ".join(
            [*(self.settings or []), *([f"pose {self.pose}"] if self.pose else []), *(self.at or [])]
            + [f"{key} +-{100 * value:g} %" for key, value in tolerances.items()]
            + [f"{key} {low:g} .. {high:g}" for key, (low, high) in ranges.items()]
        )
        return model, Provenance.now("uncertain build", files, note=f"{name} {said}".strip())

    def _rest(self, plant: Any) -> dict[str, Any]:
        """Where a nonlinear plant is looked at, and what is held there."""
        from robustlab.dynamics.plant_contract import NonlinearPlant, SteppedPlant

        given = {"--pose": self.pose, "--at": self.at, "--hold": self.hold}
        used = [option for option, value in given.items() if value]
        if used and (not isinstance(plant, NonlinearPlant) or isinstance(plant, SteppedPlant)):
            raise UsageError(used[0], f"{plant.name} has one linear model", "it for a nonlinear plant only")
        if self.pose is not None and self.at:
            raise UsageError("uncertain build", "--pose and --at", "one of them")
        rest: dict[str, Any] = {}
        if self.pose is not None:
            rest["at"] = six_numbers(self.pose)
        elif self.at:
            rest["at"] = assignments("--at", self.at)
        return {**rest, "hold": self.hold.split(",")} if self.hold else rest


@dataclass(frozen=True)
class CoverOptions:
    """A set of models that is to be covered."""

    cover: Annotated[
        list[str] | None,
        typer.Option(help="Instead: a file of a set of models that is to be covered; at least two times."),
    ] = None
    form: Annotated[
        str,
        typer.Option(
            help="Of the cover: elements, pca, ellipsoid, additive, input-multiplicative, output-multiplicative, or"
            " inverse- and one of these three (inverse-additive, ...).",
            autocompletion=one_of(*COVERS),
        ),
    ] = "elements"
    weight_order: Annotated[int, typer.Option(help="Largest order of the cover's weight.")] = 4
    directions: Annotated[int | None, typer.Option(help="Number of directions of the forms pca and ellipsoid.")] = None
    controller: Annotated[
        str | None,
        typer.Option(
            "--controller",
            "-k",
            help="File of a controller, closed as it says: the cover's worst gain is that of its loop.",
        ),
    ] = None
    feedback: Annotated[
        str | None,
        typer.Option(
            help="With it: negative (u = -K y) or positive, where its file does not say it.",
            autocompletion=one_of("negative", "positive"),
        ),
    ] = None

    def build(
        self, tolerance: float | None, effort: EffortOptions, report: Callable[[str], None]
    ) -> tuple[Cover, Provenance]:
        """The cover, with its worst gain in the loop of a controller where one is given."""
        from robustlab.provenance import Provenance, file_sha256

        files = self.cover or []
        models = [load_model(path) for path in files]
        loop: Any = None
        if self.feedback is not None and self.controller is None:
            raise UsageError("--feedback", "without --controller", "a controller to close the loop with")
        if self.controller is not None:
            from robustlab.closing import fed_back

            given = ControllerOptions(self.controller, self.feedback)
            k, asked, remark = given.read("uncertain build")
            around, sign, said = fed_back(models[0], k, asked, "uncertain build", None)
            note("\n".join(filter(None, (remark, f"loop: {given.said(said)}"))))
            loop = lambda g: g.feedback(around, sign)  # noqa: E731
        options: dict[str, Any] = {} if tolerance is None else {"tolerance": tolerance}
        found = rl.cover(
            models, self.form, directions=self.directions, order=self.weight_order, loop=loop, progress=report,
            **options, **vars(effort),
        )  # fmt: skip
        used = {path: file_sha256(path) for path in [*files, *([self.controller] if self.controller else [])]}
        return found, Provenance.now("uncertain build", used, note=f"{self.form} cover of {len(models)} models")


@dataclass(frozen=True)
class DiscoveryOptions:
    """What a discovery found and left unexplained."""

    discovery: Annotated[
        str | None, typer.Option(help="Instead: folder of data discover --out, or its updated plant.")
    ] = None
    amplitude: Annotated[
        list[str] | None, typer.Option(help="With --discovery: amplitude of a speed or signal, NAME=VALUE; repeatable.")
    ] = None
    dry: Annotated[
        str | None,
        typer.Option(
            help="With --discovery: dry friction as load (any speed), gain, or both.",
            autocompletion=one_of("load", "gain", "both"),
        ),
    ] = None
    pade: Annotated[int, typer.Option(help="With --discovery: order of the Pade part of delays.")] = 2

    def build(self, outputs: list[str] | None) -> tuple[EffectBlocks, Provenance]:
        """The blocks of an updated plant: of a plant file, or of the folder that ``data discover --out`` wrote."""
        from robustlab.cli.data import PLANT_FILE
        from robustlab.dynamics.extended.force_blocks import Dry
        from robustlab.provenance import Provenance, file_sha256
        from robustlab.storage.interchange import is_plant_file, load_plant

        amplitude = assignments("--amplitude", self.amplitude)
        assert self.discovery is not None
        path = Path(self.discovery)
        file = str(path / PLANT_FILE) if path.is_dir() else self.discovery
        if not is_plant_file(file):
            expected = f"{PLANT_FILE}, or the folder of: robustlab data discover --out DIR"
            raise InputError(file, "no plant in it", expected)
        if self.dry not in (None, *get_args(Dry)):
            raise UsageError("uncertain build", f"--dry {self.dry}", f"one of {', '.join(get_args(Dry))}")
        dry: Any = self.dry
        try:
            found = rl.uncertain_from(load_plant(file), outputs, amplitude=amplitude, dry=dry, pade=self.pade)
        except InputError as error:
            if "amplitude" in (error.expected or "") and error.hint:
                raise UsageError("uncertain build", error.found, "--amplitude NAME=VALUE for it", error.hint) from None
            raise
        for name, reason in found.left_out.items():
            note(f"not in it: {name}: {reason}")
        return found, Provenance.now("uncertain build", {file: file_sha256(file)}, note="discovery")


# --- commands --------------------------------------------------------------------------------------------------------


@app.command()
@grouped
def build(
    *,
    models: TwoModels,
    ranges: PlantRanges,
    expressions: Annotated[
        str | None, typer.Option(help="Instead of models: a TOML file with A, B, C, D in named parameters.")
    ] = None,
    covered: CoverOptions,
    effort: EffortOptions,
    found: DiscoveryOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Uncertain model from two models, a set of models, a plant's ranges, a discovery, or matrices of expressions.

    Example: robustlab uncertain build nominal.h5 perturbed.h5 --structure elements --out uncertain.h5
    """
    sources = (ranges.plant, models.nominal, expressions, covered.cover, found.discovery)
    if sum(source is not None for source in sources) != 1:
        raise UsageError(
            "uncertain build",
            "no models, or both files and a plant or another source",
            "NOMINAL [PERTURBED], or --plant NAME, --expressions FILE, --cover FILE --cover FILE, or --discovery DIR",
        )
    plant, outputs = ranges.plant, ranges.outputs.split(",") if ranges.outputs else None
    if covered.cover is not None:
        with progress.shown("uncertain build") as report:
            made = covered.build(models.rtol, effort, report)
        _tell_cover(*made, output)
        return
    if found.discovery is not None:
        _tell_discovery(*found.build(outputs), output)
        return
    if models.nominal is not None and models.perturbed is None and _holds_plant(models.nominal):
        plant = models.nominal
    residual = None
    if expressions is not None:
        if outputs or ranges.tolerance or ranges.ranges:
            raise UsageError("uncertain build", "options of a plant with --expressions", "them with --plant only")
        model, origin = _from_expressions(expressions)
    elif plant is not None:
        with progress.shown("uncertain build"):
            model, origin = ranges.build(plant, outputs)
    else:
        if outputs or ranges.ranges:
            option = "--outputs" if outputs else "--range"
            raise UsageError("uncertain build", f"{option} without --plant", f"{option} with --plant NAME only")
        with progress.shown("uncertain build"):
            model, residual, origin = models.build()
    if not model.blocks:
        note("no uncertainty: mu = 0")
    more = []
    if residual is not None:
        more.append(f"at Delta = I off the perturbed model by {residual.largest:.2g} of each matrix's largest entry")
    structure = "parameters" if plant or not models.nominal else models.structure
    _tell(model, origin, output, {"structure": structure}, {"residual": residual}, more)


def _tell(
    model: rl.UncertainModel,
    origin: Provenance,
    output: OutputOptions,
    before: dict[str, Any],
    after: dict[str, Any],
    more: list[str],
) -> None:
    """Write the model where a file was named, and print it; ``before`` and ``after`` stand in the JSON object."""
    if output.out is not None:
        rl.save(output.out, model, origin)
    lines = [f"{output.out}: {model!r}" if output.out else repr(model), *_block_lines(model), *more]
    sizes = {"delta_shape": model.delta_shape, "blocks": _blocks(model), "sampled": model.sampled}
    emit("uncertain build", {"file": output.out, **before, **sizes, **after}, "\n".join(lines), output.as_json)


def _tell_discovery(found: EffectBlocks, origin: Provenance, output: OutputOptions) -> None:
    told = {"noise": found.noise, "left_out": found.left_out}
    _tell(found.model, origin, output, {}, told, list(found.rest()))


def _tell_cover(found: Cover, origin: Provenance, output: OutputOptions) -> None:
    if output.out is not None:
        rl.save(output.out, found.model, origin)
    lines = [*([f"{output.out}:"] if output.out else []), found.summary(), *_block_lines(found.model)]
    evidence = {key: value for key, value in vars(found).items() if key not in ("model", "deltas")}
    deltas = [{k: v for k, v in d.items() if isinstance(v, float)} for d in found.deltas]
    result = {"file": output.out, "delta_shape": found.model.delta_shape, "blocks": _blocks(found.model)}
    emit("uncertain build", {**result, **evidence, "deltas": deltas}, "\n".join(lines), output.as_json)
    require_trust(found.status)
    judged = found.conservatism
    if judged is not None and judged.status is not rl.Status.FAILED:
        require_trust(judged.status)


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
        f"inputs: {', '.join(named(model.inputs))}",
        f"outputs: {', '.join(named(model.outputs))}",
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
@grouped
def sample(
    *,
    file: UncertainArgument,
    n: Annotated[int, typer.Option("-n", "--samples", help="Number of random samples.")] = 20,
    seed: SeedOption = 0,
    vertices: Annotated[str, typer.Option(help="Vertices to add: a number, or all.")] = "0",
    response: ResponseOptions,
    figure: Annotated[str | None, typer.Option(help=f"The envelope. {FIGURE}")] = None,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Time responses of random members and vertices: nominal, envelope, and the sample farthest from nominal.

    Example: robustlab uncertain sample uncertain.h5 -n 20 --seed 1 --vertices all --input-value u=42 --t-end 0.1
    """
    from robustlab.dynamics.simulation import default_clock

    model = load_uncertain(file)
    clock = response.times(model)
    if clock is None:
        clock = default_clock(model.nominal, "uncertain sample")
    with progress.shown("uncertain sample"):
        members = rl.sample(model, n, seed, _vertex_count(vertices))
        responses = members.respond(clock, response.driven(model))
    if responses.unstable:
        note(f"{len(responses.unstable)} of {len(members)} samples are unstable: {_listed(responses.unstable)}")
    result: dict[str, Any] = {"file": file, "seed": seed, "vertices": members.vertices, **responses.to_json()}
    if figure is not None:
        result["figures"] = save_figures({"envelope": _envelope(responses)}, figure)
    emit("uncertain sample", result, _summary(responses, members.vertices), as_json)
    require_trust(responses.status)


app.command("delays")(cover_delays)
app.command("neglected")(neglected_weight)


# --- reading ---------------------------------------------------------------------------------------------------------


def _from_expressions(file: str) -> tuple[rl.UncertainModel, Provenance]:
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.storage.expression_files import load_parametric

    model = load_parametric(file)
    return model, Provenance.now("uncertain build", {file: file_sha256(file)}, note="expressions")


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


def _listed(indices: tuple[int, ...]) -> str:
    return ", ".join(map(str, indices[:10])) + (", ..." if len(indices) > 10 else "")


def _blocks(model: rl.UncertainModel) -> Any:
    return model.to_json()["blocks"]


def _block_lines(model: rl.UncertainModel) -> list[str]:
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
    same: dict[str, list[str]] = {}
    for block in model.blocks[:SHOWN_BLOCKS]:
        if block.origin:
            same.setdefault(block.origin, []).append(block.name)
    told = [f"{', '.join(names)}: {origin}" for origin, names in same.items()]
    return [*lines, *([f"... and {hidden} more blocks"] if hidden else []), *told]


def _around(parameter: rl.ParameterRange) -> str:
    """The nominal value, where it is not the middle of the range."""
    return "" if parameter.below is None else f" around {parameter.nominal:.6g}"


def _summary(responses: Responses, vertices: int) -> str:
    rows = [
        (
            named([signal])[0],
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


def _envelope(responses: Responses) -> Figure:
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
