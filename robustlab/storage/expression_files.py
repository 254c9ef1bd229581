"""Parametric models in a text file: matrices of expressions, ranges of parameters, names of signals (TOML).

::

    A = [[0, 1], ["-k/m", "-c/m"]]
    B = [[0], ["1/m"]]
    C = [[1, 0]]
    D = [[0]]
    inputs = [["F", "N"]]                # optional, as outputs, states and dt: a name, or a name and its unit
    [parameters]
    m = [3.0, 0.4]                       # nominal value, relative tolerance
    k = [2.0, 1.4, 3.0]                  # nominal, low, high
    c = {nominal = 1.0, low = 0.8, high = 1.5, unit = "N s/m"}
    g = 9.81                             # exact
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robustlab.errors import InputError, did_you_mean
from robustlab.files.document import parse_document
from robustlab.uncertainty.blocks import ParameterRange
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.parametric import parametric

MAX_BYTES = 1 << 20
MATRICES = ("A", "B", "C", "D")
KEYS = (*MATRICES, "parameters", "dt", "inputs", "outputs", "states")
RANGE = ("nominal", "low", "high", "unit")


def load_parametric(path: str | Path) -> UncertainModel:
    """The uncertain model that a file of expressions describes; see `robustlab.uncertainty.parametric.parametric`."""
    data = _read(Path(path))
    unknown = [key for key in data if key not in KEYS]
    if unknown:
        hint = did_you_mean(unknown[0], KEYS)
        raise InputError(str(path), f"key {unknown[0]!r}", f"some of {', '.join(KEYS)}", hint)
    missing = [key for key in (*MATRICES, "parameters") if key not in data]
    if missing:
        raise InputError(str(path), f"no {missing[0]}", "A, B, C, D and a table [parameters]")
    if not isinstance(data["parameters"], dict):
        raise InputError(str(path), "parameters is no table", "a table [parameters]")
    try:
        ranges = {name: _range(name, given) for name, given in data["parameters"].items()}
        options = {key: data[key] for key in ("dt", "inputs", "outputs", "states") if key in data}
        for key in ("inputs", "outputs", "states"):
            if key in options:
                options[key] = _signals(key, options[key])
        return parametric(data["A"], data["B"], data["C"], data["D"], ranges, **options)
    except InputError as error:
        found = f"{error.where}: {error.found}"
        raise type(error)(str(path), found, error.expected, error.hint, error.more) from None


def _read(file: Path) -> dict[str, Any]:
    where = str(file)
    if not file.is_file():
        raise InputError(where, "no such file", "a .toml file with matrices of expressions")
    if file.stat().st_size > MAX_BYTES:
        raise InputError(where, f"{file.stat().st_size} bytes", f"at most {MAX_BYTES}")
    raw = file.read_bytes()
    return parse_document("toml", raw, where)


def _range(name: str, given: Any) -> Any:
    if not isinstance(given, dict):
        return given
    where = f"parameter {name!r}"
    unknown = [key for key in given if key not in RANGE]
    if unknown or "low" not in given or "high" not in given:
        found = f"key {unknown[0]!r}" if unknown else f"keys {', '.join(given) or 'none'}"
        hint = did_you_mean(unknown[0], RANGE) if unknown else None
        raise InputError(where, found, "low and high, and where wanted nominal and unit", hint)
    numbers = [given[key] for key in ("low", "high", "nominal") if key in given]
    if any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in numbers):
        raise InputError(where, f"{given!r}", "numbers for low, high and nominal")
    unit = given.get("unit", "")
    if not isinstance(unit, str):
        raise InputError(where, f"unit {unit!r}", "a text")
    nominal = float(given["nominal"]) if "nominal" in given else None
    return ParameterRange.between(float(given["low"]), float(given["high"]), nominal, unit)


def _signals(key: str, given: Any) -> list[Any]:
    wrong = f"{given!r}"[:80]
    if not isinstance(given, list):
        raise InputError(key, wrong, "a list of names, or of [name, unit]")
    for item in given:
        pair = isinstance(item, list) and len(item) == 2 and all(isinstance(part, str) for part in item)
        if not isinstance(item, str) and not pair:
            raise InputError(key, wrong, "a list of names, or of [name, unit]")
    return [item if isinstance(item, str) else tuple(item) for item in given]
