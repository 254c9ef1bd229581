"""Exit code, requirements and numbers of the recipes that stay, from their ``result.json``."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .cases import ROOT, Case, kept
from .commands import robustlab

RTOL = 1e-6
# Of fits, designs by search, and what a design is judged by afterwards.
RTOLS = {"gamma": 1e-3, "frequency": 1e-2}
# Recipe -> the tolerance of its numbers where it is made of fits and searches, and whether it needs the shared data.
RECIPES = {"motor-models": False, "platform-models": False, "first-light": False, "coupled-drives": True,
           "flagship-platform": False, "emps-discover": True, "robust-machine": False, "flagship-emps": True,
           "flagship": False}  # fmt: skip
FAST = ("motor-models", "platform-models")


def cases() -> Iterator[Case]:
    """One a recipe."""
    for name, shared in RECIPES.items():
        yield Case(name, lambda name=name: result(name), name not in FAST, shared)


def result(name: str) -> dict[str, Any]:
    """What a run of the recipe left."""
    with tempfile.TemporaryDirectory() as folder:
        ((code, _),) = robustlab([["run", str(ROOT / "recipes" / f"{name}.toml"), "--out", folder]], folder)
        data = json.loads(Path(folder, "result.json").read_text(encoding="utf-8"))
    steps = {s["name"]: {"status": s["status"], "numbers": kept(s["numbers"])} for s in data["steps"]}
    required = {q["text"].replace(".", "_"): {"met": q["met"]} for q in data["requirements"]}
    return {"code": str(code), "requirements": required, "steps": steps}
