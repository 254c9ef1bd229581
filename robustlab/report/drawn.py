"""A drawing as matplotlib writes it, with what nobody can see left out: the same picture in a fifth of the characters.

A curve of a million samples is drawn as all of its corners with six decimals. On paper a column of `COLUMN` shows no
more of it than its first, last, lowest and highest point there, and no corner that is off by less than `OFF` of a
straight line. Groups that say nothing, unused names and repeated styles go too.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from itertools import count
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array

COLUMN = 0.4  # pt; a page shows a figure of 518 pt on 900 pixels or less, that is 0.7 pixels
OFF = 0.08  # pt
LONG = 40  # corners; a polygon with more is a curve and lies on tenths of a point, others on hundredths

SVG = "{http://www.w3.org/2000/svg}"
HREF = "{http://www.w3.org/1999/xlink}href"
# Verdana has the widths of DejaVu Sans, by which matplotlib places texts; any other font without serifs is narrower.
FONT = "font:9px 'DejaVu Sans',Verdana,sans-serif"
_FAMILY = re.compile(r"font-family:[^;]*;?|(?<![-\w])font-size:9px;?")
_NUMBER = re.compile(r"-?\d*\.?\d+(?:e[-+]?\d+)?")
_PIECE = re.compile(r"([MLCQZz])([^MLCQZz]*)")
_USED = re.compile(r"(?:(?<=url\()|^)#([^)]+)")


def compact(svg: str) -> str:
    """The same picture with fewer characters.

    Parameters
    ----------
    svg
        A drawing written by matplotlib: paths of M, L, C, Q and z in absolute coordinates, styles in ``style``.
    """
    ET.register_namespace("", SVG[1:-1])
    ET.register_namespace("xlink", HREF[1:-5])
    root = ET.fromstring(svg)  # noqa: S314 - matplotlib wrote it a moment ago
    for element in root.iter():
        _shorten(element)
    _unwrap(root)
    _name(root)
    _shared_styles(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _shorten(element: ET.Element) -> None:
    """Numbers, styles and white space of one element."""
    if element.tag != f"{SVG}text" and not (element.text or "").strip():
        element.text = None
    if not (element.tail or "").strip():
        element.tail = None
    style = re.sub(r"\s*([:;])\s*", r"\1", element.get("style", ""))
    if style:
        element.set("style", _FAMILY.sub("", style).strip(";"))
    if not element.get("style"):
        element.attrib.pop("style", None)
    if "d" in element.attrib:
        element.set("d", _path(element.attrib["d"]))
    turned = element.get("transform", "").startswith("rotate(")
    for name in ("x", "y", "width", "height", "transform"):
        if name in element.attrib and (name != "transform" or turned):
            element.set(name, _NUMBER.sub(lambda found: _short(round(100 * float(found[0])), 2), element.attrib[name]))
    if element.get("transform", "").startswith("rotate(0 "):
        del element.attrib["transform"]


def _unwrap(element: ET.Element) -> None:
    """Take groups away that have nothing but a name, and empty ones; markers that lie on one another are drawn once."""
    children: list[ET.Element] = []
    for child in element:
        if child.tag == f"{SVG}metadata":
            continue
        _unwrap(child)
        if child.tag == f"{SVG}g" and not set(child.attrib) - {"id"}:
            children += child
        elif len(child) or child.tag not in (f"{SVG}g", f"{SVG}defs"):
            children.append(child)
    element[:] = _seen(children)


def _seen(children: list[ET.Element]) -> Iterator[ET.Element]:
    """Without the markers that later ones of the same kind cover to a fifth of a point."""
    covered: set[tuple[str, ...]] = set()
    kept: list[ET.Element] = []
    for child in reversed(children):
        if child.tag == f"{SVG}use" and "transform" not in child.attrib:
            place = tuple(str(round(5 * float(child.get(side, "0")))) for side in "xy")
            key = (child.get(HREF, ""), child.get("style", ""), *place)
            if key in covered:
                continue
            covered.add(key)
        kept.append(child)
    return reversed(kept)


def _shared_styles(root: ET.Element) -> None:
    """Styles that come up again are classes."""
    styles = Counter(e.attrib["style"] for e in root.iter() if "style" in e.attrib)
    names = _names()
    classes = {style: next(names) for style, times in styles.items() if times > 2}
    for element in root.iter():
        if element.get("style") in classes:
            element.set("class", classes[element.attrib.pop("style")])
    sheet = root.find(f".//{SVG}style")
    if sheet is not None:
        sheet.text = f"svg{{{FONT}}}{sheet.text}" + "".join(f".{name}{{{s}}}" for s, name in classes.items())


def _name(root: ET.Element) -> None:
    """Short names of what is referred to; no others."""
    names = _names()
    places = [(e, key) for e in root.iter() for key, value in e.attrib.items() if key == HREF or "url(#" in value]
    short = {found[1]: "" for e, key in places for found in _USED.finditer(e.attrib[key])}
    short = {name: next(names) for name in short}
    for element, key in places:
        element.set(key, _USED.sub(lambda found: "#" + short[found[1]], element.attrib[key]))
    for element in root.iter():
        name = element.attrib.pop("id", None)
        if name in short:
            element.set("id", short[name])


def _names() -> Iterator[str]:
    """a, b, ..., z, a1, b1, ..."""
    for k in count():
        yield chr(ord("a") + k % 26) + (str(k // 26) if k > 25 else "")


# --- paths -----------------------------------------------------------------------------------------------------------


def _path(d: str) -> str:
    """A path with relative steps on a grid of tenths or hundredths of a point."""
    pieces = [(kind, np.array(_NUMBER.findall(rest), dtype=float)) for kind, rest in _PIECE.findall(d)]
    if {kind for kind, _ in pieces} & {"C", "Q"}:
        return "".join(kind.upper() + _joined([_short(round(100 * v), 2) for v in numbers]) for kind, numbers in pieces)
    polygons: list[tuple[list[Array], bool]] = []
    for kind, numbers in pieces:
        if kind == "M":
            polygons.append(([numbers], False))
        elif kind == "L":
            polygons[-1][0].append(numbers)
        else:
            polygons[-1] = polygons[-1][0], True
    return "".join(_polygon(np.concatenate(corners).reshape(-1, 2), closed) for corners, closed in polygons)


def _polygon(corners: Array, closed: bool) -> str:
    decimals = 1 if len(corners) > LONG else 2
    steps = np.rint(10**decimals * thinned(corners)).astype(int)
    steps[1:] -= steps[:-1].copy()
    moves = [_short(v, decimals) for v in steps.ravel()]
    line = f"l{_joined(moves[2:])}" if len(moves) > 2 else ""
    return f"M{_joined(moves[:2])}{line}{'z' if closed else ''}"


def _short(value: int, decimals: int) -> str:
    """An integer of tenths or hundredths as a decimal number, as short as it can be."""
    sign, digits = "-" if value < 0 else "", str(abs(value)).rjust(decimals + 1, "0")
    whole, part = digits[:-decimals], digits[-decimals:].rstrip("0")
    return sign + (whole if not part else f"{'' if whole == '0' else whole}.{part}")


def _joined(numbers: list[str]) -> str:
    """Numbers of a path; a sign is a separator."""
    return "".join(text if k == 0 or text[0] == "-" else f" {text}" for k, text in enumerate(numbers))


def thinned(corners: Array) -> Array:
    """The corners (n, 2) of a polygon without those that make no difference to the eye.

    Of every stretch that runs one way from left to right, or back, each column keeps its first, last, lowest and
    highest corner; what then lies within `OFF` of the line through its neighbours goes (Ramer 1972; Douglas and Peucker
    1973).
    """
    if len(corners) <= LONG:
        return corners
    heading = np.sign(np.diff(corners[:, 0]))
    known = np.flatnonzero(heading)
    if len(known):  # upright pieces go on as the piece before them
        at = np.maximum.accumulate(np.where(heading != 0, np.arange(len(heading)), known[0]))
        heading = heading[at]
    turns = np.flatnonzero(np.diff(heading)) + 1
    column = np.floor(corners[:, 0] / COLUMN)
    new = np.concatenate([[True], np.diff(column) != 0])
    new[turns] = True
    starts = np.flatnonzero(new)
    ends = np.append(starts[1:], len(corners))
    kept = np.zeros(len(corners), dtype=bool)
    kept[starts] = kept[ends - 1] = True
    for first, last in zip(starts, ends, strict=True):
        if last - first > 2:
            heights = corners[first:last, 1]
            kept[[first + heights.argmin(), first + heights.argmax()]] = True
    left = corners[kept]
    return left[corners_of(*left.T)]


def corners_of(x: Array, y: Array) -> NDArray[np.intp]:
    """Which points of a line are corners: the others lie within `OFF` of the line through these."""
    points = np.column_stack([x, y])
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    open_ = [(0, len(points) - 1)]
    while open_:
        first, last = open_.pop()
        if last - first < 2:
            continue
        along, inner = points[last] - points[first], points[first + 1 : last] - points[first]
        length = float(np.hypot(*along))
        # The distance from the piece, not from the line that it lies on: a curve may turn back.
        share = np.clip(inner @ along / length**2, 0, 1) if length else np.zeros(len(inner))
        off = np.hypot(*(inner - share[:, None] * along).T)
        furthest = int(off.argmax())
        if off[furthest] > OFF:
            kept[first + 1 + furthest] = True
            open_ += [(first, first + 1 + furthest), (first + 1 + furthest, last)]
    return np.flatnonzero(kept)
