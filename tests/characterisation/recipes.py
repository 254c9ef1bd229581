"""Exit code, requirements and numbers of recipes, from their ``result.json``."""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .cases import ROOT, Case, kept
from .commands import robustlab

RTOL = 1e-6
RTOLS = {"gamma": 1e-3, "frequency": 1e-2}
# Recipe -> the least tolerance of its numbers (designs 1e-3, namings 2e-2), and whether it needs the shared data.
RECIPES = {
    "motor-models": (0.0, False),
    "platform-models": (0.0, False),
    "first-light": (1e-3, False),
    "coupled-drives": (2e-2, True),
    "flagship-platform": (1e-3, False),
    "emps-discover": (2e-2, True),
    "robust-machine": (2e-3, False),
    "flagship-emps": (2e-2, True),
    "flagship": (2e-2, False),
}
FAST = ("motor-models", "platform-models")


def cases() -> Iterator[Case]:
    """One a recipe."""
    for name, (rtol, shared) in RECIPES.items():
        yield Case(name, lambda name=name: run(name), name not in FAST, shared, rtol)


def run(name: str) -> dict[str, Any]:
    """Return exit code and results of a run of the recipe."""
    with tempfile.TemporaryDirectory() as folder:
        ((code, _),) = robustlab([["run", str(ROOT / "recipes" / f"{name}.toml"), "--out", folder]], folder)
        return {"code": str(code)} | result(Path(folder))


def result(folder: Path) -> dict[str, Any]:
    """Return verdicts of the requirements, and status and numbers of the steps except summaries (``story``)."""
    data = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    steps = {
        s["name"]: {"status": s["status"], "numbers": kept(s["numbers"])} for s in data["steps"] if s["do"] != "story"
    }
    required = {f"{q['that']} {q['condition']}".replace(".", "_"): {"met": q["met"]} for q in data["requirements"]}
    return {"requirements": required, "steps": steps}
