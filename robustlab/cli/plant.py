"""``robustlab plant``: list plants, show one, start one of your own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.completion import PLANTS, plant_or_file
from robustlab.cli.console import emit, named, note, result_alone
from robustlab.cli.generated import JsonOption
from robustlab.display import text_table as table
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError
from robustlab.operations import reading
from robustlab.operations.kinds import Number, Table
from robustlab.operations.reading import made_of, plant_settings

app = typer.Typer(
    help="List plants, show one; start one of your own in a file.", no_args_is_help=True, add_completion=False
)


# --- commands --------------------------------------------------------------------------------------------------------


@app.command("list")
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


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the machine, or folder/name; the file is NAME.py.")],
    as_json: JsonOption = False,
) -> None:
    """Write a small commented plant to start from, NAME.py in the working directory or in the folder before NAME.

    A file that is there is never written over.

    Example: robustlab plant new mymachine && robustlab plant show mymachine.py:axis
    """
    from robustlab.dynamics.plant_file import PLANT, write_template

    path = write_template(name)
    text = f"{path}\nlook at it with: robustlab plant show {path}:{PLANT}"
    emit("plant new", {"file": str(path), "plant": f"{path}:{PLANT}"}, text, as_json)


@app.command()
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
    if reading.runs_code(plant):
        result_alone()
    made = reading.read_plant(plant, plant_settings(settings))
    given = Table(Number()).read("--at", at) or {}
    trim, model, problem = _equilibrium(made, given)
    point = None
    if trim is not None:
        sides = {"x": (made.states, trim.x), "u": (made.inputs, trim.u), "y": (made.outputs, trim.y)}
        values = {k: {s.name: float(v) for s, v in zip(*side, strict=True)} for k, side in sides.items()}
        point = {"residual": trim.residual, **values}
    result = {
        "plant": plant, "name": made.name, "made_of": made_of(plant, made),
        **{kind: [{"name": s.name, "unit": s.unit} for s in getattr(made, kind)] for kind in SIDES},
        "joints": _joints(made),
        "parameters": [{**p.to_json(), "sign": p.sign, "role": p.role} for p in made.parameters.values()],
        "operating_point": point, "poles": None if model is None else model.poles(),
        "stable": None if model is None else model.is_stable(),
    }  # fmt: skip
    emit("plant show", result, "\n".join(_text(plant, made, trim, model, problem)), as_json)
    if problem is not None:
        note(f"no operating point: {problem}")
        raise typer.Exit(problem.exit_code)


# --- printing --------------------------------------------------------------------------------------------------------

SIDES = ("inputs", "outputs", "states")
FEW = 36  # characters of a plant's signals in a list
ROUNDING = 1e-9  # poles below this, relative to the largest, count as zero


def _equilibrium(plant: Any, at: Mapping[str, float]) -> tuple[Any, Any, Any]:
    """Return the equilibrium (None at zero), the linear model there, and the error if there is no such point."""
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
    lines = ["operating point: rest at zero"]
    if trim is not None:
        sides = (*zip(plant.states, trim.x, strict=True), *zip(plant.inputs, trim.u, strict=True))
        rows = [(s.name, f"{value:.6g}", s.unit) for s, value in sides]
        lines = ["operating point", *table(rows, ("signal", "value", "unit")).splitlines()]
    poles = sorted(model.poles(), key=lambda p: (-p.real, p.imag))
    zero = max(map(abs, poles), default=0.0) * ROUNDING
    rows = [
        (f"{p.real:.6g}" + (f"{p.imag:+.6g}j" if p.imag else ""), f"{abs(p):.6g}",
         f"{-p.real / abs(p):.3g}" if abs(p) > zero else "moves freely")
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


def _text(given: str, plant: Any, trim: Any, model: Any, problem: Any) -> list[str]:
    lines = [
        f"plant {plant.name}",
        *(f"  made of {file}, SHA-256 {sha}" for file, sha in made_of(given, plant).items()),
        *signal_lines(plant),
    ]
    joints = [(j["name"], j["unit"], j["position"] or "-") for j in _joints(plant)]
    lines += ["", *table(joints, ("joint", "acts there", "position")).splitlines()] if joints else ["", "no joints"]
    return [*lines, "", *parameter_lines(plant), "", *_equilibrium_lines(plant, trim, model, problem)]


def signal_lines(thing: Any) -> list[str]:
    """Return a line each for inputs, outputs and states of a plant or model."""
    return [f"  {side}: {', '.join(named(getattr(thing, side))) or 'none'}" for side in SIDES]


def parameter_lines(plant: Any) -> list[str]:
    """Return the table of a plant's parameters, and its effects with theirs."""
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
