r"""A discrete controller as plain C99: one struct of state, an init and a step function, nothing allocated.

.. math:: y_k = C x_k + D u_k, \qquad x_{k+1} = A x_k + B u_k

Every number is written as a hexadecimal floating constant, which is the number itself, with its decimal form beside it
in a comment. Sums are written out from left to right, zeros left out; with a compiler that keeps to C99's order
of additions (no ``-ffast-math``) the step reproduces the model's recursion to rounding.

Names of signals are shown in comments and in string constants, never used as code: what a file may hold as a name must
not become code.

Controllers for other programs: C99 source, JSON, MATLAB; robustlab's own format is `robustlab.storage.save`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.plant_contract import Plant
from robustlab.errors import InputError, UsageError
from robustlab.files.atomic import atomic_write
from robustlab.provenance import Provenance
from robustlab.statespace import Signal, StateSpaceModel, as_model
from robustlab.storage.controller_json import controller_to_json
from robustlab.storage.interchange import save
from robustlab.synthesis.problem.design import Controller
from robustlab.uncertainty.lft import UncertainModel

__all__ = [
    "c_source",
    "saturation_limits",
    "EXPORTS",
    "export_controller",
]


PREFIX = re.compile(r"[a-z][a-z0-9_]{0,30}")
RESERVED = (
    "auto break case char const continue default do double else enum extern float for goto if inline int long",
    "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while",
    "main",
)
# Rows of one statement are broken after so many terms.
TERMS = 4


def saturation_limits(model: StateSpaceModel, saturation: Any, where: str) -> tuple[tuple[float, float], ...] | None:
    """``(low, high)`` for each output, from a pair for all or a mapping by name with all outputs; None for none.

    Raises
    ------
    InputError
        Unknown or missing outputs, limits that are no two numbers with ``low < high``.
    """
    if saturation is None:
        return None
    names = model.output_names
    if isinstance(saturation, dict):
        unknown = [name for name in saturation if name not in names]
        missing = [name for name in names if name not in saturation]
        if unknown or missing:
            found = f"no output {unknown[0]!r}" if unknown else f"no limits of {missing[0]!r}"
            raise InputError(f"{where}: saturation", found, f"limits of {', '.join(names)}")
        pairs = [saturation[name] for name in names]
    else:
        pairs = [saturation] * len(names)
    found_limits = []
    for name, pair in zip(names, pairs, strict=True):
        try:
            low, high = (float(v) for v in pair)
        except (TypeError, ValueError):
            raise InputError(f"{where}: saturation of {name}", f"{pair!r}", "two numbers (low, high)") from None
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError(f"{where}: saturation of {name}", f"{low:g} .. {high:g}", "finite low < high")
        found_limits.append((low, high))
    return tuple(found_limits)


def c_source(
    model: StateSpaceModel,
    prefix: str = "controller",
    limits: Sequence[tuple[float, float]] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """The C99 source of a discrete model.

    Parameters
    ----------
    model
        Discrete model with n states, m inputs and p outputs; at least one input and one output.
    prefix
        Of every name in the file: a lower-case letter, then letters, digits, underscores (31 at most).
    limits
        ``(low, high)`` of each output; the outputs are held between them, the states go on as if they were not.
    notes
        Lines for the comment at the top.

    Raises
    ------
    InputError
        A continuous model, one in deviations from an operating point, one without inputs or outputs, a prefix that is
        no identifier.

    Examples
    --------
    >>> lag = StateSpaceModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.01)
    >>> "x0 = 0x1.0000000000000p-1 * s->x[0]" in c_source(lag)
    True
    """
    if not model.is_discrete:
        raise InputError(
            "C export", "a continuous controller (dt = 0)", "a discrete one", "discretise it with its sample time first"
        )
    if model.operating_point is not None:
        hint = "take u and y of that point off in the program around it, and export the model without the point"
        raise InputError("C export", "a model in deviations from an operating point", "one without", hint)
    if not model.n_inputs or not model.n_outputs:
        raise InputError("C export", f"{model.n_inputs} inputs and {model.n_outputs} outputs", "at least one of each")
    if not PREFIX.fullmatch(prefix) or any(prefix in words.split() for words in RESERVED):
        raise InputError(
            "C export: prefix", f"{prefix!r}", "a lower-case letter, then lower-case letters, digits or underscores"
        )
    return "\n".join(
        [
            *_header(model, limits, notes),
            *_declarations(model, prefix),
            *_init(model, prefix),
            *_step(model, prefix, limits),
            "",
        ]
    )


def _header(model: StateSpaceModel, limits: Sequence[tuple[float, float]] | None, notes: Sequence[str]) -> list[str]:
    lines = [
        f"/* Discrete-time controller, sample time {model.dt!r} s: call the step function once per sample.",
        " *   y[k] = C x[k] + D u[k],  x[k+1] = A x[k] + B u[k];  u = measurements, y = control signals.",
        " * The feedback is positive: the sign of the loop is in the controller.",
        *(f" * {_comment(note)}" for note in notes),
        " *",
        *(f" * u[{i}]: {_named(s)}" for i, s in enumerate(model.inputs)),
    ]
    for i, s in enumerate(model.outputs):
        held = "" if limits is None else f", held in [{limits[i][0]!r}, {limits[i][1]!r}]"
        lines.append(f" * y[{i}]: {_named(s)}{held}")
    return [*lines, *(f" * x[{i}]: {_named(s)}" for i, s in enumerate(model.states)), " */"]


def _declarations(model: StateSpaceModel, prefix: str) -> list[str]:
    big = prefix.upper()
    n = max(model.n_states, 1)  # C has no arrays of length zero
    return [
        f"#define {big}_STATES {model.n_states}",
        f"#define {big}_INPUTS {model.n_inputs}",
        f"#define {big}_OUTPUTS {model.n_outputs}",
        "",
        f"/* Sample time in s; {model.dt!r}. */",
        f"extern const double {prefix}_sample_time;",
        f"const double {prefix}_sample_time = {_number(model.dt)};",
        "",
        f"typedef struct {{ double x[{n}]; }} {prefix}_state;",
        "",
        f"void {prefix}_init({prefix}_state *s);",
        f"void {prefix}_step({prefix}_state *s, const double u[{model.n_inputs}], double y[{model.n_outputs}]);",
        "",
    ]


def _init(model: StateSpaceModel, prefix: str) -> list[str]:
    n = max(model.n_states, 1)
    return [
        "/* All states to zero. */",
        f"void {prefix}_init({prefix}_state *s)",
        "{",
        f"    for (int i = 0; i < {n}; ++i) {{",
        "        s->x[i] = 0.0;",
        "    }",
        "}",
        "",
    ]


def _step(model: StateSpaceModel, prefix: str, limits: Sequence[tuple[float, float]] | None) -> list[str]:
    lines = [
        "/* One sample: outputs, then the states of the next sample. u and y may be one array. */",
        f"void {prefix}_step({prefix}_state *s, const double u[{model.n_inputs}], double y[{model.n_outputs}])",
        "{",
    ]
    for i in range(model.n_outputs):
        lines += _sum(f"const double y{i}", model.C[i], model.D[i])
    for i in range(model.n_states):
        lines += _sum(f"const double x{i}", model.A[i], model.B[i])
    lines += [f"    s->x[{i}] = x{i};" for i in range(model.n_states)]
    unused = not model.n_states, not (model.B.any() or model.D.any())
    lines += [f"    (void){name};" for name, is_unused in zip("su", unused, strict=True) if is_unused]
    for i in range(model.n_outputs):
        if limits is None:
            lines.append(f"    y[{i}] = y{i};")
        else:
            low, high = (_number(v) for v in limits[i])
            lines.append(f"    y[{i}] = y{i} < {low} ? {low} : (y{i} > {high} ? {high} : y{i});")
    return [*lines, "}"]


def _sum(name: str, from_x: Array, from_u: Array) -> list[str]:
    """``name = a s->x[0] + b u[0] + ...;`` over several lines, with the decimal numbers beside them."""
    terms = [(v, f"s->x[{j}]") for j, v in enumerate(from_x.tolist()) if v != 0]
    terms += [(v, f"u[{j}]") for j, v in enumerate(from_u.tolist()) if v != 0]
    if not terms:
        return [f"    {name} = 0.0;"]
    lines = []
    for first in range(0, len(terms), TERMS):
        part = terms[first : first + TERMS]
        start = f"    {name} = " if first == 0 else "        + "
        end = ";" if first + TERMS >= len(terms) else ""
        decimals = ", ".join(repr(v) for v, _ in part)
        lines.append(start + " + ".join(f"{_number(v)} * {at}" for v, at in part) + f"{end} /* {decimals} */")
    return lines


def _number(value: float) -> str:
    """The hexadecimal constant of a number, in parentheses where it is negative."""
    text = float(value).hex()
    if text in ("0x0.0p+0", "-0x0.0p+0"):
        return "0.0"
    return f"({text})" if text.startswith("-") else text


def _named(signal: Signal) -> str:
    return _comment(f"{signal.name} [{signal.unit}]" if signal.unit else signal.name)


def _comment(text: str) -> str:
    """Text that cannot end a comment, continue a line or hide in it: printable ASCII, the rest as numbers."""
    plain = "".join(c if " " <= c <= "~" else f"<U+{ord(c):04X}>" for c in text)
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("\\", "<U+005C>").replace("??", "? ?")


EXPORTS = (".c", ".json", ".mat", ".h5", ".hdf5")


def export_controller(
    path: str | Path,
    controller: Any,
    *,
    prefix: str = "controller",
    saturation: Any = None,
    provenance: Provenance | None = None,
) -> Path:
    r"""Write a controller ``u = K y`` for another program; the extension of the file says which.

    ``.c``
        C99 without allocation: a struct of state, ``<prefix>_init`` and ``<prefix>_step``. The sample time, the names
        and units of all signals stand in the comment at the top, every number is exact (hexadecimal).
    ``.json``
        Matrices, sample time, signals with units, what was verified, provenance; numbers as their shortest exact
        decimals. `robustlab.load` reads it back.
    ``.mat``, ``.h5``
        As `robustlab.save` writes them.

    Parameters
    ----------
    path
        File to write; replaced once the new one is complete.
    controller
        Controller, a synthesis result, or a model with n states; discrete for ``.c``.
    prefix
        Of the C names.
    saturation
        ``(low, high)`` of all control signals, or a mapping by name; the C step holds its outputs between them.
    provenance
        Where it comes from; time and versions of now where left out.

    Raises
    ------
    UsageError
        Another extension, or a saturation in a format that has no place for it.
    InputError
        A continuous controller for ``.c``, limits or a prefix that are none.
    EnvironmentFault
        Disk full, no permission; the previous file is kept.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in EXPORTS:
        raise UsageError(str(path), f"extension {suffix or 'missing'!r}", ", ".join(EXPORTS))
    given = getattr(controller, "controller", controller)
    if isinstance(given, (UncertainModel, Plant)):
        raise InputError(str(path), f"a {type(given).__name__}", "a controller or a model")
    held = given if isinstance(given, Controller) else Controller(as_model(given, "export_controller"))
    if saturation is not None and suffix not in (".c", ".json"):
        raise UsageError(str(path), f"a saturation in a {suffix} file", "a .c or .json file")
    limits = saturation_limits(held.K, saturation, "export_controller")
    origin = provenance or Provenance.now("export_controller")
    if suffix == ".c":
        text = c_source(held.K, prefix, limits, _notes(held, origin))
        return atomic_write(path, lambda temporary: temporary.write_text(text, encoding="ascii"))
    if suffix == ".json":
        text = json.dumps(controller_to_json(held, limits, origin), indent=1, allow_nan=False, ensure_ascii=True)
        return atomic_write(path, lambda temporary: temporary.write_text(text + "\n", encoding="ascii"))
    return save(path, held, origin)


def _notes(controller: Controller, origin: Provenance) -> list[str]:
    gamma = "none" if controller.gamma is None else f"{controller.gamma:.6g}"
    notes = [f"Designed by {controller.method or 'an unknown method'}, verified norm {gamma} ({controller.status})."]
    version = origin.versions.get("robustlab", "")
    notes.append(f"Written by robustlab {version} on {origin.created}, {origin.created_by} {origin.note}".rstrip())
    return [*notes, *(f"From {name}, sha256 {digest}" for name, digest in origin.inputs.items())]
