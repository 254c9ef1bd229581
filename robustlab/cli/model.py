"""``robustlab model``: build, show, check, compare and convert models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note
from robustlab.cli.generated import AS_JSON, READ, add_commands, taking
from robustlab.cli.plant import parameter_lines, signal_lines
from robustlab.errors import UsageError
from robustlab.operations.kinds import Ends, Table

app = typer.Typer(help="Build, show, check, compare and convert models.", no_args_is_help=True, add_completion=False)

SHOWN_STATES = 12


def _read(file: str, reading: Mapping[str, Any]) -> Any:
    from robustlab.storage import read

    loaded = read(file, **reading)
    for text in loaded.warnings:
        note(f"warning: {file}: {text}")
    return loaded


@app.command()
@taking(*READ["model"], AS_JSON)
def show(
    file: Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="FILE")], as_json: bool, **reading: Any
) -> None:
    """Print what a file holds.

    Example: robustlab model show motor.h5
    """
    loaded = _read(file, reading)
    pair = loaded.kind == "pair"
    named = dict(zip(("nominal", "perturbed"), loaded.object, strict=True)) if pair else {"": loaded.object}
    parts = [line for name, thing in named.items() for line in _describe(f"{name}: " if name else "", thing)]
    origin = loaded.provenance
    if origin is not None and (origin.created_by or origin.created):
        parts.append(
            f"made by {origin.created_by or 'unknown'} on {origin.created or 'an unknown day'} {origin.note}".rstrip()
        )
    kind = f"{loaded.kind}, {'' if loaded.verified else 'not '}verified by a content hash"
    content = named if pair else loaded.object
    result = {name: getattr(loaded, name) for name in ("kind", "verified", "warnings", "provenance")}
    text = "\n".join([f"{file}: {kind}", *parts])
    emit("model show", {"file": file, **result, "content": content}, text, as_json)


@app.command()
@taking(*READ["model"], AS_JSON)
def convert(
    source: Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="IN")],
    target: Annotated[
        str,
        typer.Argument(
            help="File to write: .h5 (format 1), .mat (MATLAB version 5), or .c (a discrete controller as C99).",
            metavar="OUT",
        ),
    ],
    prefix: Annotated[str, typer.Option(metavar="NAME", help="Of the names in a .c file.")] = "controller",
    saturation: Annotated[
        list[str] | None, typer.Option(metavar="NAME=LOW:HIGH", help="Limits of a control signal in .c; repeatable.")
    ] = None,
    anti_windup: Annotated[
        float | None,
        typer.Option(
            help="With --saturation in .c: time in s in which the states recover; inf: none.  [default: 10 samples]"
        ),
    ] = None,
    as_json: bool = False,
    **reading: Any,
) -> None:
    """Write a model in another format: HDF5, MATLAB version 5, JSON; a discrete controller as C99.

    Example: robustlab model convert plant.mat plant.h5
    """
    from robustlab.provenance import Provenance, file_sha256

    loaded = _read(source, reading)
    if loaded.kind == "pair":
        raise UsageError(source, "two models, /nominal and /perturbed", "one", "--group nominal, or --group perturbed")
    origin = Provenance.now("model convert", inputs={source: file_sha256(source)})
    limits = Table(Ends(), words="NAME=LOW:HIGH").read("--saturation", saturation)
    if limits is not None or anti_windup is not None or target.lower().endswith(".c"):
        rl.export_controller(
            target, loaded.object, prefix=prefix, saturation=limits, anti_windup=anti_windup, provenance=origin
        )
    else:
        rl.save(target, loaded.object, origin)
    emit("model convert", {"from": source, "to": target, "kind": loaded.kind}, f"{target}: {loaded.object!r}", as_json)


add_commands(app, "model", "designs", "models", "robustness")


# --- printing --------------------------------------------------------------------------------------------------------


def _describe(name: str, thing: Any) -> list[str]:
    from robustlab.dynamics.plant_contract import Plant

    if isinstance(thing, rl.DelayedModel):
        lengths = ", ".join(f"{t:.6g}" for t in thing.delays.tolist())
        return [repr(thing), f"  delays: {lengths} s", *_describe("between them: ", thing.H)]
    if isinstance(thing, rl.StateSpaceModel):
        large = max(thing.n_states, thing.n_inputs, thing.n_outputs) > SHOWN_STATES
        matrices = (
            [f"  matrices larger than {SHOWN_STATES}: --json prints them"] if large else str(thing).splitlines()[1:]
        )
        return [f"{name}{thing!r}", *signal_lines(thing), *matrices]
    if isinstance(thing, Plant):
        return [f"plant {thing.name}", *parameter_lines(thing), *signal_lines(thing)]
    if isinstance(thing, rl.Controller):
        gamma = "none" if thing.gamma is None else f"{thing.gamma:.6g}"
        return [f"method {thing.method or 'unknown'}, gamma {gamma} ({thing.status})", *_describe(name, thing.K)]
    if isinstance(thing, rl.UncertainModel):
        return [thing.report(), *_describe("nominal: ", thing.nominal)]
    return [repr(thing)]
