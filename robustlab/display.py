"""Display of objects: a short text in a console, a table in a notebook, a full text, and a picture.

`Displayable` is the base of models, results and their parts; console, notebook, recipes and reports display what a
class declares. Its drawings are its row in `robustlab.report.drawings`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from html import escape
from importlib import import_module
from typing import Any, ClassVar, Literal, NamedTuple

from robustlab.errors import is_function, plain_text

Facts = list[tuple[str, str]]  # label, text

LINES = 6  # of a repr, the heading included
WIDTH = 95  # characters of one of its lines
SHOWN_BLOCKS = 40  # rows of the table of a set or of a member
SHOWN = 6  # names or values that a text lists


class Part(NamedTuple):
    """A table of texts under a title, below the facts."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


class AllFields:
    """Base of classes whose JSON is all of their fields."""

    derived: ClassVar[tuple[str, ...]] = ()  # properties that `to_json` adds

    def to_json(self) -> dict[str, Any]:
        return vars(self) | {name: getattr(self, name) for name in self.derived}


class Each(NamedTuple):
    """In `Displayable.quantities`: a table with a number for each input or output."""

    side: Literal["inputs", "outputs"]
    leaf: Any  # "*" in it is the unit of that signal
    more: tuple[str, ...] = ()  # further possible names, as in "*-rate"


class Displayable:
    """Base of displayed objects; a class defines `facts`."""

    # Attributes that requirements refer to -> unit ("1" of a pure number), or a pattern of
    # `robustlab.recipe.steps.step`: float where the unit is not known, bool, {"*": float}, a class for its fields
    # (with the units of its own quantities), `Each` for a table by signals.
    quantities: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        # Otherwise a dataclass would generate a repr with all numbers of all arrays.
        if "__repr__" not in vars(cls):
            cls.__repr__ = cls.__repr__

    def facts(self) -> Facts:
        """Return the main findings as (label, text), the most important first."""
        given = fields(self) if is_dataclass(self) else ()
        found = [(f.name.replace("_", " "), in_words(getattr(self, f.name))) for f in given if f.name != "status"]
        return [fact for fact in found if fact[1]]

    def headline(self) -> str:
        """Return the finding in one sentence without its full stop; empty where the facts contain it."""
        return ""

    def details(self) -> list[Part]:
        """Return tables that are too long for facts."""
        return []

    def numbers(self) -> dict[str, Any]:
        """Return the attributes named in ``quantities`` that are not None."""
        found = {name: getattr(self, name) for name in self.quantities}
        return {name: value for name, value in found.items() if value is not None}

    def report(self) -> str:
        """Return the `summary` and the tables of `details` as plain text."""
        return "\n\n".join(filter(None, (self.summary(), self.tables())))

    def tables(self) -> str:
        """Return the tables of `details` as plain text, each below its title."""
        parts = [(part.title, text_table(part.rows, part.header)) for part in self.details() if part.rows]
        return "\n\n".join(f"{title}\n{text}".lstrip() for title, text in parts)

    def summary(self) -> str:
        """Return a heading and a line for each fact as plain text."""
        facts = _plain_facts(self)
        width = max((len(label) for label, _ in facts), default=0)
        return "\n".join([heading(self), *(f"  {label:<{width}}  {text}".rstrip() for label, text in facts)])

    def __repr__(self) -> str:
        lines = [f"  {label}: {text}" if label else f"  {text}" for label, text in _plain_facts(self)[: LINES - 1]]
        return "\n".join(_clipped(line) for line in [heading(self), *lines])

    def _repr_html_(self) -> str:
        """Return the facts as a table for notebooks; texts are escaped, as they may come from files."""
        left = ' style="text-align: left"'
        facts = _plain_facts(self)
        rows = [f"<tr><th{left}>{escape(label)}</th><td{left}>{escape(text)}</td></tr>" for label, text in facts]
        caption = f"<caption{left}>{escape(heading(self))}</caption>"
        return f"<table>{caption}<tbody>{''.join(rows)}</tbody></table>"

    def plot(self, kind: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw it and return the Axes, or an array of them of several panels; nothing is shown or saved.

        Parameters
        ----------
        kind
            Which drawing, for example ``"bode"``; the first of its class where left out. A wrong name lists them all.
        ax
            Axes to draw into. A drawing of several panels takes its place. A new figure of pyplot where left out.
        **options
            What the drawing takes, for example ``omega=`` or ``output=``; see docs/objects.md.

        Raises
        ------
        InputError
            No such drawing or option, or nothing to draw.
        """
        # By its name: the package of drawings imports the packages of all objects.
        return import_module("robustlab.report.drawings").draw(self, kind, ax, options)


def heading(shown: Any) -> str:
    """Return the name of the class, with the status where there is one."""
    status = getattr(shown, "status", None)
    return type(shown).__name__ + (f" ({status})" if isinstance(status, Enum) else "")


def _plain_facts(shown: Displayable) -> Facts:
    """Return the facts with a text on one line each, without the status, which is in the heading."""
    facts = [(plain_text(label), plain_text(" ".join(text.split()))) for label, text in shown.facts()]
    return [(label, text) for label, text in facts if text and label != "status"]


def _clipped(text: str, width: int = WIDTH) -> str:
    return text if len(text) <= width else f"{text[: width - 3].rstrip()}..."


def number(value: Any, unit: str = "", digits: int = 4) -> str:
    """Return a number with its unit as text; empty for None and NaN."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, complex) and not value.imag:
        value = value.real
    text = str(value) if isinstance(value, int) else f"{value:.{digits}g}"
    return f"{text} {unit}" if unit and unit != "1" else text


def bracket(lower: float, upper: float, words: tuple[str, str], unit: str = "") -> str:
    """Return two bounds with their origins as text, in as many digits as distinguish them, at most six."""
    digits = next((d for d in (4, 5, 6) if number(lower, "", d) != number(upper, "", d)), 6)
    low, high = (number(value, unit, digits) for value in (lower, upper))
    if low == high:
        return f"{low} ({words[0]} and {words[1]})" if low else ""
    return f"{low} ({words[0]}) .. {high} ({words[1]})"


def listed(items: Iterable[Any], most: int = SHOWN) -> str:
    """Return the first few items and the number of others as text."""
    texts = [str(item) for item in items]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more


def short(names: Sequence[str], most: int = SHOWN) -> str:
    """Return names for a line of a repr, long ones shortened."""
    return plain_text(listed((_clipped(name, 24) for name in names), most))


def with_units(signals: Iterable[tuple[str, str]], most: int = SHOWN) -> str:
    """Return names of signals with their units as text."""
    return listed((f"{name} [{unit}]" if unit else name for name, unit in signals), most)


def member(delta: Mapping[str, Any], physical: Mapping[str, tuple[float, str]] | None = None) -> str:
    """Return a member of a set as text: known parameters in their units, else normalised values."""
    known = physical or {}
    return listed(
        f"{name} = {number(*known[name])}" if name in known else f"{name}: delta = {in_words(value)}"
        for name, value in delta.items()
    )


def member_rows(delta: Mapping[str, Any], physical: Mapping[str, tuple[float, str]]) -> Part:
    """Return the table of a member: values of the first `SHOWN_BLOCKS` blocks, and their parameters."""
    rows = []
    for name in list(delta)[:SHOWN_BLOCKS]:
        value, known = delta[name], physical.get(name)
        shape = getattr(value, "shape", ())
        size = f"{shape[0]} x {shape[1]} matrix" if shape else f"{value:.6g}"
        rows.append((name, size, number(*known, 6) if known else "-"))
    hidden = f"{len(delta) - len(rows)} more blocks, all with --json" if len(delta) > len(rows) else ""
    return Part(hidden and f"the first {len(rows)} blocks; {hidden}", ("block", "delta", "stands for"), rows)


def in_words(value: Any) -> str:
    """Return the value of a field as a short text: long sequences are counted, not listed."""
    if value is None or is_function(value):
        return ""
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, (int, float, complex)):
        return number(value) or "nan"
    if isinstance(value, Displayable):
        return heading(value)
    if hasattr(value, "shape") and hasattr(value, "tolist"):  # an array, without importing numpy
        listed_whole = math.prod(value.shape) <= SHOWN and len(value.shape) < 2
        return in_words(value.tolist()) if listed_whole else f"array of {' x '.join(map(str, value.shape))}"
    if isinstance(value, Mapping):
        short = len(value) <= SHOWN and all(isinstance(v, (str, int, float)) for v in value.values())
        return ", ".join(f"{k} = {in_words(v)}" for k, v in value.items()) if short else listed(value)
    if isinstance(value, Sequence):
        short = len(value) <= SHOWN and all(isinstance(v, (str, int, float, complex)) for v in value)
        return ", ".join(map(in_words, value)) if short else f"{len(value)} entries"
    return type(value).__name__


def text_table(rows: Sequence[tuple[str, ...]], header: tuple[str, ...] | None = None) -> str:
    """Return left-aligned columns as plain text, with a rule under the header."""
    lines = [header, *rows] if header else list(rows)
    if not lines:
        return ""
    widths = [max(len(row[i]) for row in lines) for i in range(len(lines[0]))]
    out = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in lines]
    if header:
        out.insert(1, "  ".join("-" * w for w in widths))
    return "\n".join(out)


def matrix_lines(name: str, rows: Sequence[Sequence[complex]], width: int, most: int = 12) -> list[str]:
    """Return the lines of a matrix of ``width`` columns after its name, with six digits; of a large one its size."""
    if not rows or not width or max(len(rows), width) > most:
        return [f"{name}: {len(rows)} x {width}"]
    cells = [tuple(text if text[0] == "-" else f" {text}" for text in (f"{x:.6g}" for x in row)) for row in rows]
    lines = text_table(cells).split("\n")
    return [f"{f'{name}: ' if k == 0 else ' ' * (len(name) + 2)}{line}".rstrip() for k, line in enumerate(lines)]
