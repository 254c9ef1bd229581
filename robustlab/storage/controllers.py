"""Controllers in a file, with what they take; as JSON too, bit by bit: numbers as their shortest exact decimals."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, did_you_mean
from robustlab.evidence import claims_of
from robustlab.files.document import parse_document, read_document
from robustlab.files.signature import Limits, size_text
from robustlab.files.tree import Tree
from robustlab.provenance import Provenance
from robustlab.result import Status, plain
from robustlab.signals import TAKES, Taken
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel
from robustlab.storage.matrices import Problems, decode_model, encode_model
from robustlab.storage.results import encode_claims
from robustlab.synthesis.problem.controller import Controller

# How designs called what a controller takes, before its inputs said it themselves.
OLD_NAMES = (
    (re.compile(r"e (.+)|error (.+) measured"), "r - y"),
    (re.compile(r"(.+) reference(?: taken)?|(.+)_ref"), "r"),
    (re.compile(r"(.+) measured"), "y"),
)
# Those whose measurements are named by the plant: "e NAME" is a signal of it.
BY_PLANT = ("hinf", "h2", "h2-hinf", "dk", "fixed")
DESIGNED = re.compile(r"mixsyn|tune|lqg|lqr|lqi|ncf( with a reference model)?|cascade|(reduced|sampled) .+")
SCHEMA, VERSION = "robustlab.controller", 1
RECURSION = "x[k+1] = A x[k] + B v[k], u[k] = C x[k] + D v[k] with the inputs v; dx/dt if dt = 0"
NOT_SAID = "the sign of the feedback is not stated"
NEEDED = ("schema", "dt", "inputs", "outputs", "states", "A", "B", "C", "D")
OPTIONAL = ("convention", "gamma", "status", "method", "saturation", "operating_point", "provenance")


def encode_controller(tree: Tree, controller: Controller) -> None:
    """K as a state-space model; ``gamma``, ``status``, ``method`` as attributes; the claims of its design."""
    encode_model(tree, controller.K)
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma
    claims = claims_of(controller.design)
    own = {f"K_{letter}": getattr(controller.K, letter) for letter in "ABCD"}
    if any(all(np.array_equal(claim.numbers.get(name, np.nan), X) for name, X in own.items()) for claim in claims):
        encode_claims(tree, claims)


def decode_controller(tree: Tree, problems: Problems, transpose: bool = False) -> Controller:
    """Inverse of `encode_controller`. Raises InputError: with all that is missing or does not fit."""
    model = decode_model(tree, problems, transpose)
    gamma = None
    if "gamma" in tree.attrs:
        value = np.asarray(tree.attrs["gamma"])
        if value.dtype.kind in "fi" and value.size == 1:
            gamma = float(value.flat[0])
        else:
            problems.add("attribute gamma is not one real number")
    text = str(np.asarray(tree.attrs.get("status", Status.INCONCLUSIVE.value)))
    if text not in [status.value for status in Status]:
        problems.add(f"attribute status is {text!r}, expected one of {', '.join(s.value for s in Status)}")
    problems.raise_any()
    assert model is not None
    method = str(np.asarray(tree.attrs.get("method", "")))
    return Controller(said_by_names(model, method), gamma, Status(text), method)


def said_by_names(K: StateSpaceModel, method: str) -> StateSpaceModel:
    """A controller of an older file, which does not say what it takes, with what its method and its names say.

    Designs called the error ``e NAME`` or ``error NAME measured``, a reference ``NAME reference (taken)`` or
    ``NAME_ref``, a signal itself ``NAME`` or ``NAME measured``. Of a controller by other hands nothing is known.
    """
    ours = method in BY_PLANT or DESIGNED.fullmatch(method)
    if not ours or any(isinstance(s, Taken) for s in K.inputs):
        return K
    inputs = []
    known = [(pattern, takes) for pattern, takes in OLD_NAMES if takes != "r - y" or method not in BY_PLANT]
    for name, unit in K.inputs:
        met = ((pattern.fullmatch(name), takes) for pattern, takes in known)
        takes, of = next(((t, next(filter(None, m.groups()))) for m, t in met if m), ("y", name))
        inputs.append(Taken(name, unit, takes, of))
    return K.renamed(inputs)


@dataclass(frozen=True)
class LoadedController:
    """A controller from a file, with what its reader should know and where the file says it comes from."""

    controller: Controller
    warnings: tuple[str, ...]
    provenance: Provenance | None


def controller_to_json(
    controller: Controller, saturation: Sequence[tuple[float, float]] | None, origin: Provenance
) -> dict[str, Any]:
    """A controller as plain types (schema ``robustlab.controller/1``).

    ``controller``: controller with n states, at least one input and one output.
    ``saturation``: ``(low, high)`` of each output, or None.
    ``origin``: where it comes from.
    Raises InputError: a controller without inputs or outputs.
    """
    k = controller.K
    if not k.n_inputs * k.n_outputs:
        raise InputError("JSON export", f"{k.n_inputs} inputs and {k.n_outputs} outputs", "at least one of each")
    signals = {
        side: [
            {"name": s.name, "unit": s.unit} | ({"takes": s.takes, "of": s.of} if isinstance(s, Taken) else {})
            for s in held
        ]
        for side, held in (("inputs", k.inputs), ("outputs", k.outputs), ("states", k.states))
    }
    point = k.operating_point
    return {
        "schema": f"{SCHEMA}/{VERSION}",
        "convention": f"{controller.law or NOT_SAID}; {RECURSION}",
        "dt": k.dt,
        **signals,
        **{name: plain(getattr(k, name)) for name in "ABCD"},
        "operating_point": None if point is None else {name: plain(getattr(point, name)) for name in ("x", "u", "y")},
        "gamma": None if controller.gamma is None else plain(controller.gamma),
        "status": controller.status.value,
        "method": controller.method,
        "saturation": None if saturation is None else [list(pair) for pair in saturation],
        "provenance": plain(origin.to_json()),
    }


def read_controller_json(path: str | Path, limits: Limits | None = None, isolate: bool = True) -> LoadedController:
    """The controller in a JSON file, exactly as it was written.

    ``path``: a file with schema ``robustlab.controller/1``.
    ``limits``: its ``document`` is the largest size of the file.
    ``isolate``: False parses the text in this process, with the same checks.
    Raises InputError: not JSON, another schema or version, keys that are missing, unknown or written twice, NaN, wrong
    shapes.
    """
    where, limits = str(path), limits or Limits()
    size = Path(path).stat().st_size
    if size > limits.document:
        raise InputError(where, f"{size_text(size)} of JSON", f"at most {size_text(limits.document)}")
    raw = Path(path).read_bytes()
    data = read_document("json", raw, where, limits) if isolate else parse_document("json", raw, where)
    if not isinstance(data, dict):
        raise InputError(where, f"JSON of a {type(data).__name__}", f"a table with schema {SCHEMA}/{VERSION}")
    _check_schema(data, where)
    _check_keys(data, where)
    sides = {side: _signals(data[side], f"{where}: {side}") for side in ("inputs", "outputs", "states")}
    n, m, p = len(sides["states"]), len(sides["inputs"]), len(sides["outputs"])
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    matrices = {name: _matrix(data[name], shape, f"{where}: {name}") for name, shape in shapes.items()}
    dt = _number(data["dt"], f"{where}: dt")
    point = _point(data.get("operating_point"), {"x": n, "u": m, "y": p}, f"{where}: operating_point")
    K = StateSpaceModel(
        matrices["A"], matrices["B"], matrices["C"], matrices["D"], dt, sides["inputs"], sides["outputs"],
        sides["states"], point, where=where,
    )  # fmt: skip
    method = _method(data, where)
    controller = Controller(said_by_names(K, method), _gamma(data.get("gamma"), where), _status(data, where), method)
    origin = data.get("provenance")
    if origin is not None and not isinstance(origin, dict):
        raise InputError(f"{where}: provenance", f"{origin!r:.60}", "a table")
    warnings = (
        ("the saturation in the file is not part of the controller: give it again to export_controller",)
        if data.get("saturation") is not None
        else ()
    )
    return LoadedController(controller, warnings, None if origin is None else Provenance.from_json(origin))


# --- its keys ---------------------------------------------------------------------------------------------------------


def _check_schema(data: Mapping[str, Any], where: str) -> None:
    text = data.get("schema")
    name, slash, version = text.rpartition("/") if isinstance(text, str) else ("", "", "")
    if name != SCHEMA or not slash:
        found = "no schema" if text is None else f"schema {text!r:.80}"
        raise InputError(where, found, f"{SCHEMA}/{VERSION}, as export_controller writes it")
    if version != str(VERSION):
        hint = "upgrade robustlab" if version.isascii() and version.isdigit() and int(version[:9]) > VERSION else None
        raise InputError(where, f"{SCHEMA} of version {version!r:.40}", f"version {VERSION}", hint)


def _check_keys(data: Mapping[str, Any], where: str) -> None:
    missing = [name for name in NEEDED if name not in data]
    if missing:
        raise InputError(where, f"missing {', '.join(missing)}", f"all of {', '.join(NEEDED)}")
    unknown = [name for name in data if name not in NEEDED + OPTIONAL]
    if unknown:
        hint = did_you_mean(unknown[0], NEEDED + OPTIONAL)
        raise InputError(where, f"unknown key {unknown[0]!r:.80}", f"those of {SCHEMA}/{VERSION}", hint)


# --- its values -------------------------------------------------------------------------------------------------------


def _signals(given: Any, where: str) -> list[Signal]:
    if not isinstance(given, list):
        raise InputError(where, f"a {type(given).__name__}", 'a list of { "name": .., "unit": .. }')
    found: list[Signal] = []
    for i, item in enumerate(given):
        entry = item if isinstance(item, dict) else {}
        name, unit, takes, of = (entry.get(key, "") for key in ("name", "unit", "takes", "of"))
        texts = all(isinstance(text, str) for text in (name, unit, takes, of))
        if "name" not in entry or not texts or set(entry) - {"name", "unit", "takes", "of"}:
            raise InputError(f"{where}[{i}]", f"{item!r:.60}", '{ "name": .., "unit": .. } with texts')
        if takes and takes not in TAKES:
            raise InputError(f"{where}[{i}]: takes", f"{takes!r:.60}", f"one of {', '.join(TAKES)}")
        found.append(Taken(name, unit, takes, of) if takes else Signal(name, unit))
    return found


def _matrix(given: Any, shape: tuple[int, int], where: str) -> Array:
    """Rows of numbers as a matrix of the shape that the signals ask for."""
    rows, columns = shape
    if not isinstance(given, list) or not all(isinstance(row, list) for row in given):
        raise InputError(where, f"{given!r:.60}", "a list of rows of numbers")
    lengths = sorted({len(row) for row in given}) or [columns]
    if len(given) != rows or lengths != [columns]:
        found = (
            f"{len(given)} x {lengths[0]}" if len(lengths) == 1 else f"rows of {lengths[0]} to {lengths[-1]} numbers"
        )
        raise InputError(where, found, f"{rows} x {columns}, by the numbers of states, inputs and outputs")
    flat = [_number(value, f"{where}[{i},{j}]") for i, row in enumerate(given) for j, value in enumerate(row)]
    return np.array(flat, dtype=float).reshape(shape)


def _number(given: Any, where: str) -> float:
    """A finite number; a text or a yes/no is none."""
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        raise InputError(where, f"{given!r:.60}", "a number")
    try:
        value = float(given)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise InputError(where, "a number too large for float64", "a finite number")
    return value


def _gamma(given: Any, where: str) -> float | None:
    if given is None:
        return None
    return math.inf if given == "inf" else _number(given, f"{where}: gamma")


def _status(data: Mapping[str, Any], where: str) -> Status:
    text = data.get("status", Status.INCONCLUSIVE.value)
    known = [status.value for status in Status]
    if text not in known:
        raise InputError(f"{where}: status", f"{text!r:.60}", f"one of {', '.join(known)}")
    return Status(text)


def _method(data: Mapping[str, Any], where: str) -> str:
    text = data.get("method", "")
    if not isinstance(text, str):
        raise InputError(f"{where}: method", f"{text!r:.60}", "a text")
    return text


def _point(given: Any, sizes: Mapping[str, int], where: str) -> OperatingPoint | None:
    if given is None:
        return None
    if not isinstance(given, dict) or set(given) != set(sizes):
        raise InputError(where, f"{given!r:.60}", "a table of x, u and y")
    vectors: dict[str, Any] = {}
    for name, size in sizes.items():
        if not isinstance(given[name], list) or len(given[name]) != size:
            raise InputError(f"{where}: {name}", f"{given[name]!r:.60}", f"a list of {size} numbers")
        vectors[name] = np.array([_number(v, f"{where}: {name}[{i}]") for i, v in enumerate(given[name])], dtype=float)
    return OperatingPoint(**vectors)
