"""The picture of the house, docs/images/house.svg: ``python benchmarks/house.py``.

Floors are the layers of pyproject.toml, from top to bottom: a room imports only from floors below its own. A cell is a
room inside (a folder), the darker first one the room's own files; a floor is as wide as it has lines, but for the
ground floor, whose cells are single files.
"""

from __future__ import annotations

import ast
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "robustlab"
TARGET = ROOT / "docs" / "images" / "house.svg"
WIDTH, LEFT, FLOOR, GAP = 1180, 12, 30, 30
COLOURS = ("#e8eef7", "#f4f7fb")  # a room's own files, its inner rooms
GROUND = "The ground floor: one file each."
RULE = "A room imports only from floors below its own; there are no circles, neither of files nor of rooms."


def floors() -> list[tuple[str, str, list[tuple[str, int]]]]:
    """Name, sentence and cells (name, lines) of each floor, from top to bottom."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    layers = next(c["layers"] for c in settings["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    found, ground = [], []
    for layer in layers:
        folder = PACKAGE / layer
        if not folder.is_dir():
            ground.append((layer, lines(PACKAGE / f"{layer}.py")))
            continue
        inner = sorted(d for d in folder.iterdir() if (d / "__init__.py").exists())
        own = sum(map(lines, folder.glob("*.py")))
        cells = [("", own), *((d.name, sum(map(lines, d.rglob("*.py")))) for d in inner)]
        found.append((layer, sentence(folder / "__init__.py"), cells))
    return [*found, ("", GROUND, ground)]


def lines(file: Path) -> int:
    return len(file.read_text().splitlines())


def sentence(file: Path) -> str:
    """The first sentence of a room's front door."""
    text = ast.get_docstring(ast.parse(file.read_text())) or ""
    return " ".join(text.split("\n\n")[0].split()).replace("`", "")


def picture() -> str:
    """The whole SVG."""
    rows = floors()
    height = len(rows) * (FLOOR + GAP) + 40
    widest = max(sum(n for _, n in cells) for _, _, cells in rows)
    style = 'font-family="sans-serif" font-size="12"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" {style}>',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
    ]
    for i, (name, text, cells) in enumerate(rows):
        y = GAP + i * (FLOOR + GAP)
        total = sum(n for _, n in cells)
        share = total / widest if name else 1.0
        told = f"{escape(text)}  ({total:,} lines)"
        title = f'<tspan font-weight="bold" font-size="14">{escape(name or "robustlab/*.py")}</tspan>'
        parts.append(f'<text x="{LEFT}" y="{y - 6}">{title}<tspan fill="#555" dx="10">{told}</tspan></text>')
        parts += floor_cells(cells, y, share, first_is_own=bool(name))
    parts.append(f'<text x="{LEFT}" y="{height - 8}" fill="#555">{RULE}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def floor_cells(cells: list[tuple[str, int]], y: int, share: float, *, first_is_own: bool) -> list[str]:
    """Rectangles of one floor, left to right."""
    scale = (WIDTH - 2 * LEFT) * share / sum(n for _, n in cells)
    parts, x = [], float(LEFT)
    for k, (name, n) in enumerate(cells):
        w = n * scale
        colour = COLOURS[0] if k == 0 and first_is_own else COLOURS[1]
        parts.append(f'<rect x="{x:.1f}" y="{y}" width="{w:.1f}" height="{FLOOR}" fill="{colour}" stroke="#8aa0c0"/>')
        size = min(12.0, w / max(len(name), 1) / 0.6)
        at = f'x="{x + w / 2:.1f}" y="{y + 19}" font-size="{size:.1f}"'
        parts.append(f'<text {at} text-anchor="middle">{escape(name)}</text>')
        x += w
    return parts


if __name__ == "__main__":
    TARGET.write_text(picture())
    print(TARGET)
