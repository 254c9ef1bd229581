"""``robustlab uncertain``: build, show and sample uncertain models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import FIGURE, emit, note, require_trust, save_figures
from robustlab.cli.generated import add_commands
from robustlab.cli.members import ResponseOptions, UncertainArgument, load_uncertain, named
from robustlab.cli.options import JsonOption, SeedOption, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import UsageError
from robustlab.shown import text_table as table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robustlab.worst_case_analysis import Responses

app = typer.Typer(help="Build, show and sample uncertain models.", no_args_is_help=True, add_completion=False)
add_commands(app, "uncertain", "sets")


@app.command()
def show(file: UncertainArgument, as_json: JsonOption = False) -> None:
    """Print the blocks, signals and nominal stability of an uncertain model.

    Example: robustlab uncertain show uncertain.h5
    """
    model = load_uncertain(file)
    poles = next(text for label, text in [*model.nominal.facts(), ("poles", "none")] if label == "poles")
    result = {
        "file": file,
        **model.to_json(),
        "nominal": model.nominal,
        "nominal_spectral_abscissa": model.nominal.spectral_abscissa(),
    }
    emit("uncertain show", result, f"{file}: nominal poles {poles}\n{model.report()}", as_json)


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
        result["figures"] = save_figures(_envelopes(responses), figure)
    emit("uncertain sample", result, _summary(responses, members.vertices), as_json)
    require_trust(responses.status)


def _vertex_count(text: str) -> Any:
    if text == "all":
        return "all"
    try:
        return int(text)
    except ValueError:
        raise UsageError("--vertices", text, "a whole number, or all") from None


def _listed(indices: tuple[int, ...]) -> str:
    return ", ".join(map(str, indices[:10])) + (", ..." if len(indices) > 10 else "")


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


def _envelopes(responses: Responses) -> dict[str, Figure]:
    """A figure for each output: envelope, samples, nominal."""
    from robustlab.report.robustness_figures import response_figure

    sides = zip(responses.lower.T, responses.upper.T, strict=True)
    return {
        f"envelope-{signal.name}" if len(responses.outputs) > 1 else "envelope": response_figure(
            responses.t, responses.y[:, :, k], responses.nominal[:, k], ends, output=(signal.name, signal.unit)
        )
        for k, (signal, ends) in enumerate(zip(responses.outputs, sides, strict=True))
    }
