"""``robustlab plant`` and ``model``: list, show and start plants; build, show, check, compare and convert models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.completion import PLANTS, plant_or_file
from robustlab.cli.console import emit, named, note, result_alone
from robustlab.cli.generated import AS_JSON, READ, JsonOption, taking
from robustlab.display import text_table as table
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError
from robustlab.operations.parameter_types import Ends, Number, Table, made_of, plant_settings, read_plant, runs_code

PLANT, MODEL = typer.Typer(), typer.Typer()


@PLANT.command("list")
def list_plants(as_json: JsonOption = False) -> None:
    """List the plants that come with robustlab, with their inputs and outputs.

    Example: robustlab plant list
    """
    made = {name: rl.plant(name) for name in PLANTS}
    rows = [(name, _few(p.inputs), _few(p.outputs), PLANTS[name]) for name, p in made.items()]
    plants = [
        {"name": name, "what": PLANTS[name], **{side: [list(s) for s in getattr(p, side)] for side in SIDES[:2]}}
        for name, p in made.items()
    ]
    emit("plant list", {"plants": plants}, table(rows, ("plant", "inputs", "outputs", "")), as_json)


@PLANT.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the machine, or folder/name; the file is NAME.py.")],
    as_json: JsonOption = False,
) -> None:
    """Write a small commented plant to start from, NAME.py in the working directory or in the folder before NAME.

    An existing file is never overwritten.

    Example: robustlab plant new mymachine && robustlab plant show mymachine.py:axis
    """
    from robustlab.dynamics.plant_file import PLANT as FIRST
    from robustlab.dynamics.plant_file import write_template

    path = write_template(name)
    text = f"{path}\nlook at it with: robustlab plant show {path}:{FIRST}"
    emit("plant new", {"file": str(path), "plant": f"{path}:{FIRST}"}, text, as_json)


@PLANT.command()
def show(
    plant: Annotated[
        str,
        typer.Argument(
            help="file.py:name or machine.fmu (the file is run), file.py for the names in it, an HDF5 file, or a"
            " plant's name.",
            metavar="PLANT",
            autocompletion=plant_or_file,
        ),
    ],
    settings: Annotated[list[str] | None, typer.Option("--set", help="Parameter: NAME=VALUE.")] = None,
    at: Annotated[
        list[str] | None, typer.Option(help="Operating point: input, output or state, NAME=VALUE; repeatable.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Print a plant's signals, joints, parameters, operating point, and the poles of its linear model there.

    Exit code 4: no operating point was found; all else is printed.

    Example: robustlab plant show servo-axis
    """
    from robustlab.dynamics.plant_file import plant_reference, plants_in_file

    if plant_reference(plant) == (plant, ""):
        result_alone()
        names = plants_in_file(plant)
        text = "\n".join(f"{plant}:{name}" for name in names) or f"{plant}: no plant in it"
        emit("plant show", {"file": plant, "plants": list(names)}, text, as_json)
        return
    if runs_code(plant):
        result_alone()
    made = read_plant(plant, plant_settings(settings))
    given = Table(Number()).read("--at", at) or {}
    trim, model, problem = _equilibrium(made, given)
    point = None
    if trim is not None:
        sides = {"x": (made.states, trim.x), "u": (made.inputs, trim.u), "y": (made.outputs, trim.y)}
        values = {k: {s.name: float(v) for s, v in zip(*side, strict=True)} for k, side in sides.items()}
        point = {"residual": trim.residual, **values}
    result: dict[str, Any] = {
        "plant": plant, "name": made.name, "made_of": made_of(plant, made),
        **{kind: [{"name": s.name, "unit": s.unit} for s in getattr(made, kind)] for kind in SIDES},
        "joints": _joints(made),
        "parameters": [{**p.to_json(), "sign": p.sign, "role": p.role} for p in made.parameters.values()],
        "operating_point": point, "poles": None if model is None else model.poles(),
        "stable": None if model is None else model.is_stable(),
    }  # fmt: skip
    joints = [(j["name"], j["unit"], j["position"] or "-") for j in result["joints"]]
    lines = [
        f"plant {made.name}",
        *(f"  made of {file}, SHA-256 {sha}" for file, sha in result["made_of"].items()),
        *signal_lines(made),
        "",
        *(table(joints, ("joint", "acts there", "position")).splitlines() if joints else ["no joints"]),
        *("", *parameter_lines(made), "", *_equilibrium_lines(made, trim, model, problem)),
    ]
    emit("plant show", result, "\n".join(lines), as_json)
    if problem is not None:
        note(f"no operating point: {problem}")
        raise typer.Exit(problem.exit_code)


SIDES = ("inputs", "outputs", "states")
FEW = 36  # characters of a plant's signals in a list
ROUNDING = 1e-9  # poles below this, relative to the largest, count as zero


def _equilibrium(plant: Any, at: Mapping[str, float]) -> tuple[Any, Any, Any]:
    from robustlab.dynamics import LinearPlant

    if isinstance(plant, LinearPlant):
        if at:
            raise UsageError("--at", f"{plant.name} is linear", "no --at: its poles are the same everywhere")
        return None, rl.linearise(plant), None
    try:
        trim = rl.trim(plant, **at)
        return trim, rl.linearise(plant, at=trim), None
    except NoTrustworthyNumber as error:
        return None, None, error
    except InputError as error:
        if at:  # a name that the user gave
            raise
        return None, None, error


def _equilibrium_lines(plant: Any, trim: Any, model: Any, problem: Any) -> list[str]:
    if model is None:
        return [f"operating point: none found ({problem.line})"]
    lines = ["operating point: zero"]
    if trim is not None:
        sides = (*zip(plant.states, trim.x, strict=True), *zip(plant.inputs, trim.u, strict=True))
        rows = [(s.name, f"{value:.6g}", s.unit) for s, value in sides]
        lines = ["operating point", *table(rows, ("signal", "value", "unit")).splitlines()]
    poles = sorted(model.poles(), key=lambda p: (-p.real, p.imag))
    zero = max(map(abs, poles), default=0.0) * ROUNDING
    rows = [
        (f"{p.real:.6g}" + (f"{p.imag:+.6g}j" if p.imag else ""), f"{abs(p):.6g}",
         f"{-p.real / abs(p):.3g}" if abs(p) > zero else "integrator")
        for p in poles
    ]  # fmt: skip
    if rows:
        lines += ["", *table(rows, ("pole [1/s]", "frequency [rad/s]", "damping")).splitlines()]
    return [*lines, "NOT stable" if any(p.real > zero for p in poles) else "no pole in the right half plane"]


def _few(signals: Any) -> str:
    text = ", ".join(named(signals))
    return text if len(text) <= FEW else f"{text[: FEW - 4].rstrip(' ,')} ..."


def _joints(plant: Any) -> list[dict[str, str]]:
    """Return the places where forces and voltages can act, to which effects can be attached."""
    import numpy as np

    from robustlab.dynamics import LinearPlant, NonlinearPlant
    from robustlab.dynamics.ports.port_model import port_model

    base = getattr(plant, "plant", plant)  # without its effects
    if isinstance(base, LinearPlant):
        ports = port_model(base).ports.values()
        at = [None if p.position is None else int(np.argmax(p.position)) for p in ports]
        return [
            {"name": p.name, "kind": p.kind, "unit": p.unit, "position": "" if k is None else base.states[k].name}
            for p, k in zip(ports, at, strict=True)
        ]
    return [dict(vars(place)) for place in base.port_places] if isinstance(base, NonlinearPlant) else []


def signal_lines(thing: Any) -> list[str]:
    return [f"  {side}: {', '.join(named(getattr(thing, side))) or 'none'}" for side in SIDES]


def parameter_lines(plant: Any) -> list[str]:
    rows = [
        (p.name, f"{p.value:.6g} {p.unit}".strip(), f"+-{p.tolerance_text}" if p.tolerance else "exact", p.role or "-",
         p.meaning or "-", p.source or "-")
        for p in plant.parameters.values()
    ]  # fmt: skip
    header = ("parameter", "value", "tolerance", "role", "meaning", "source")
    lines = table(rows, header).splitlines() if rows else []
    for e in getattr(plant, "effects", ()):
        lines.append(f"effect {e.effect.title} at {e.site}: {e.effect.equation}")
        for name, v in e.to_json()["parameters"].items():
            spread = "" if v["std"] is None else f" +- {v['std']:.3g} (one sd)"
            lines.append(f"  {name} = {v['value']:.6g}{spread} {v['unit']}".rstrip())
        lines += [f"  from {e.source}"] if e.source else []
    return lines


# --- models -----------------------------------------------------------------------------------------------------------

SHOWN_STATES = 12


def _read(file: str, reading: Mapping[str, Any]) -> Any:
    from robustlab.storage import read

    loaded = read(file, **reading)
    for text in loaded.warnings:
        note(f"warning: {file}: {text}")
    return loaded


@MODEL.command("show")
@taking(*READ["model"], AS_JSON)
def show_file(
    file: Annotated[str, typer.Argument(help="HDF5 or MATLAB file.", metavar="FILE")], as_json: bool, **reading: Any
) -> None:
    """Print the content of a file.

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


@MODEL.command()
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
    limits = Table(Ends(), metavar="NAME=LOW:HIGH").read("--saturation", saturation)
    if limits is not None or anti_windup is not None or target.lower().endswith(".c"):
        rl.export_controller(
            target, loaded.object, prefix=prefix, saturation=limits, anti_windup=anti_windup, provenance=origin
        )
    else:
        rl.save(target, loaded.object, origin)
    emit("model convert", {"from": source, "to": target, "kind": loaded.kind}, f"{target}: {loaded.object!r}", as_json)


def _describe(name: str, thing: Any) -> list[str]:
    from robustlab.dynamics.plant_base import Plant

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
