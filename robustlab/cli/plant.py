"""``robustlab plant``: list plants, show one, start one of your own; and how all commands read a plant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, named, note, result_alone
from robustlab.cli.offers import PLANTS, plant_or_file
from robustlab.cli.options import JsonOption
from robustlab.doors import reading
from robustlab.doors.kinds import Machine, Number, Table
from robustlab.doors.reading import made_of, plant_settings
from robustlab.errors import InputError, NoTrustworthyNumber, UsageError
from robustlab.shown import text_table as table

app = typer.Typer(
    help="List plants, show one; start one of your own in a file.", no_args_is_help=True, add_completion=False
)


# --- what other commands read ----------------------------------------------------------------------------------------


def read_plant(name: str, parameters: Mapping[str, Any]) -> Any:
    """The same as `robustlab.doors.reading.read_plant`; what a user's code prints goes to stderr."""
    if reading.runs_code(name):
        result_alone()
    return reading.read_plant(name, parameters)


def plant_or_model(name: str, settings: list[str]) -> Any:
    """The same, or the model in a file."""
    if reading.runs_code(name):
        result_alone()
    found = reading.named_plant(name, settings)
    return rl.load(name) if found is None else found


def machine(kind: Machine, name: str, settings: list[str] | None) -> Any:
    """What a command names beside a record: a plant or a model; the set of a plant where an uncertain one is wanted."""
    from robustlab.dynamics.plant_contract import Plant
    from robustlab.provenance import code_of

    found = plant_or_model(name, settings or [])
    if kind.gives[0] != "uncertain":
        return kind.as_wanted(found, name)
    if isinstance(found, Plant):
        uncertain = getattr(found, "uncertain", None)
        if uncertain is None:
            raise InputError(name, f"{found.name} is not linear", "a linear plant, with or without effects")
        if not any(p.tolerance for p in found.parameters.values()):
            raise InputError(name, "no parameter has a tolerance", "a plant whose parameters may vary")
        made = uncertain()
        if code_of(found):
            made.traced(found.provenance)
        return made
    return kind.as_wanted(found, name)


# --- commands --------------------------------------------------------------------------------------------------------


@app.command("list")
def list_plants(as_json: JsonOption = False) -> None:
    """List the plants that come with robustlab, with their inputs and outputs.

    Example: robustlab plant list
    """
    made = {name: rl.plant(name) for name in PLANTS}
    rows = [
        (name, ", ".join(named(p.inputs)), ", ".join(named(p.outputs)), PLANTS[name])
        for name, p in made.items()
    ]  # fmt: skip
    plants = [
        {"name": name, "what": PLANTS[name], **{side: [list(s) for s in getattr(p, side)] for side in SIDES[:2]}}
        for name, p in made.items()
    ]
    rows = [(name, _few(ins), _few(outs), what) for name, ins, outs, what in rows]
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
    made = read_plant(plant, plant_settings(settings))
    rest = _Rest(made, Table(Number()).read("--at", at) or {})
    sides = {kind: [{"name": s.name, "unit": s.unit} for s in getattr(made, kind)] for kind in SIDES}
    parameters = [{**p.to_json(), "sign": p.sign, "role": p.role} for p in made.parameters.values()]
    result = {
        "plant": plant, "name": made.name, "made_of": made_of(plant, made), **sides, "joints": _joints(made),
        "parameters": parameters, **rest.to_json(),
    }  # fmt: skip
    emit("plant show", result, "\n".join(_text(plant, made, rest)), as_json)
    if rest.problem is not None:
        note(f"no operating point: {rest.problem}")
        raise typer.Exit(rest.problem.exit_code)


# --- printing --------------------------------------------------------------------------------------------------------

SIDES = ("inputs", "outputs", "states")
FEW = 36  # characters of a plant's signals in a list
ROUNDING = 1e-9  # a pole of this share of the largest is at zero


class _Rest:
    """Where a plant stays, and its poles there; or why there is no such point."""

    def __init__(self, plant: Any, at: Mapping[str, float]) -> None:
        from robustlab.dynamics import LinearPlant

        self.plant, self.trim, self.model, self.problem = plant, None, None, None
        if isinstance(plant, LinearPlant):
            if at:
                raise UsageError("--at", f"{plant.name} is linear", "no --at: its poles are the same everywhere")
            self.model = rl.linearise(plant)
            return
        try:
            self.trim = rl.trim(plant, **at)
            self.model = rl.linearise(plant, at=self.trim)
        except NoTrustworthyNumber as error:
            self.problem = error
        except InputError as error:
            if at:  # a name that the user gave
                raise
            self.problem = error

    def to_json(self) -> dict[str, Any]:
        """The operating point by the names of its signals, None at zero; the poles."""
        point = self.trim and {
            "residual": self.trim.residual,
            **{
                key: {s.name: float(value) for s, value in zip(getattr(self.plant, side), values, strict=True)}
                for key, side, values in self._vectors()
            },
        }
        poles = None if self.model is None else self.model.poles()
        stable = None if self.model is None else self.model.is_stable()
        return {"operating_point": point, "poles": poles, "stable": stable}

    def lines(self) -> list[str]:
        """The same for reading."""
        if self.model is None:
            return [f"operating point: none found ({self.problem.line if self.problem else ''})"]
        lines = ["operating point: rest at zero"]
        if self.trim is not None:
            rows = [
                (s.name, f"{value:.6g}", s.unit)
                for _, side, values in self._vectors()[:2]
                for s, value in zip(getattr(self.plant, side), values, strict=True)
            ]
            lines = ["operating point", *table(rows, ("signal", "value", "unit")).splitlines()]
        poles = sorted(self.model.poles(), key=lambda p: (-p.real, p.imag))
        still = max(map(abs, poles), default=0.0) * ROUNDING
        rows = [
            (
                f"{p.real:.6g}" + (f"{p.imag:+.6g}j" if p.imag else ""),
                f"{abs(p):.6g}",
                f"{-p.real / abs(p):.3g}" if abs(p) > still else "moves freely",
            )
            for p in poles
        ]
        if rows:
            lines += ["", *table(rows, ("pole [1/s]", "frequency [rad/s]", "damping")).splitlines()]
        return [*lines, "NOT stable" if any(p.real > still for p in poles) else "no pole in the right half plane"]

    def _vectors(self) -> list[tuple[str, str, Any]]:
        assert self.trim is not None
        return [("x", "states", self.trim.x), ("u", "inputs", self.trim.u), ("y", "outputs", self.trim.y)]


def _few(text: str) -> str:
    return text if len(text) <= FEW else f"{text[: FEW - 4].rstrip(' ,')} ..."


def _joints(plant: Any) -> list[dict[str, str]]:
    """Where forces and voltages can act: what an effect may be attached to."""
    import numpy as np

    from robustlab.dynamics import LinearPlant, NonlinearPlant
    from robustlab.dynamics.ports.port_model import port_model

    base = getattr(plant, "plant", plant)  # beneath its effects
    if isinstance(base, LinearPlant):
        ports = port_model(base).ports.values()
        at = [None if p.position is None else int(np.argmax(p.position)) for p in ports]
        return [
            {"name": p.name, "kind": p.kind, "unit": p.unit, "position": "" if k is None else base.states[k].name}
            for p, k in zip(ports, at, strict=True)
        ]
    return [dict(vars(place)) for place in base.port_places] if isinstance(base, NonlinearPlant) else []


def _text(given: str, plant: Any, rest: _Rest) -> list[str]:
    lines = [
        f"plant {plant.name}",
        *(f"  made of {file}, SHA-256 {sha}" for file, sha in made_of(given, plant).items()),
    ]
    lines += [f"  {side}: {', '.join(named(getattr(plant, side))) or 'none'}" for side in SIDES]
    joints = [(j["name"], j["unit"], j["position"] or "-") for j in _joints(plant)]
    lines += ["", *table(joints, ("joint", "acts there", "position")).splitlines()] if joints else ["", "no joints"]
    rows = [
        (p.name, f"{p.value:.6g} {p.unit}".strip(), f"+-{p.tolerance_text}" if p.tolerance else "exact", p.role or "-",
         p.meaning or "-", p.source or "-")
        for p in plant.parameters.values()
    ]  # fmt: skip
    header = ("parameter", "value", "tolerance", "role", "meaning", "source")
    lines += ["", *table(rows, header).splitlines()] if rows else []
    for e in getattr(plant, "effects", ()):
        lines.append(f"effect {e.effect.title} at {e.site}")
    return [*lines, "", *rest.lines()]
