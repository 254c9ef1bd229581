"""Read parametric models from TOML: matrices of expressions, ranges of parameters, names of signals.

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
from robustlab.files.signature import parse_document
from robustlab.uncertainty.blocks import ParameterRange
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.parametric import parametric

MAX_BYTES = 1 << 20
MATRICES = ("A", "B", "C", "D")
SIGNALS = ("inputs", "outputs", "states")
KEYS = (*MATRICES, "parameters", "dt", *SIGNALS)
RANGE = ("nominal", "low", "high", "unit")


def load_parametric(path: str | Path) -> UncertainModel:
    """Return the uncertain model of a file of expressions; see `robustlab.uncertainty.parametric.parametric`."""
    where = str(path)
    if not Path(path).is_file():
        raise InputError(where, "no such file", "a .toml file with matrices of expressions")
    raw = Path(path).read_bytes()
    if len(raw) > MAX_BYTES:
        raise InputError(where, f"{len(raw)} bytes", f"at most {MAX_BYTES}")
    data = parse_document("toml", raw, where)
    unknown = [key for key in data if key not in KEYS]
    if unknown:
        hint = did_you_mean(unknown[0], KEYS)
        raise InputError(where, f"key {unknown[0]!r}", f"some of {', '.join(KEYS)}", hint)
    missing = [key for key in (*MATRICES, "parameters") if key not in data]
    if missing:
        raise InputError(where, f"no {missing[0]}", "A, B, C, D and a table [parameters]")
    if not isinstance(data["parameters"], dict):
        raise InputError(where, "parameters is no table", "a table [parameters]")
    try:
        ranges = {name: _range(name, given) for name, given in data["parameters"].items()}
        options = {key: data[key] for key in ("dt", *SIGNALS) if key in data}
        for key in SIGNALS:
            _check_names(key, options.get(key, []))
        return parametric(data["A"], data["B"], data["C"], data["D"], ranges, **options)
    except InputError as error:
        found = f"{error.where}: {error.found}"
        raise type(error)(where, found, error.expected, error.hint, error.more) from None


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


def _check_names(key: str, given: Any) -> None:
    pairs = [item if isinstance(item, list) else [item] for item in given] if isinstance(given, list) else [[given, 0]]
    if not all(len(pair) <= 2 and all(isinstance(part, str) for part in pair) for pair in pairs):
        raise InputError(key, f"{given!r}"[:80], "a list of names, or of [name, unit]")
