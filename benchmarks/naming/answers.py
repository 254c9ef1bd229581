"""The file format of a program's answers.

::

    {"schema": "robustlab.naming.answers/1", "program": "mine 1.0",
     "answers": {"0001": {"verdict": "named", "complete": true, "seconds": 3.2, "named": [
         {"kind": "dry-friction", "at": "omega", "effect": "coulomb-friction", "probability": 0.99}],
       "possible": ["dry-friction", "load"]}}}

``verdict``: "named" (these kinds, certain), "open" (among ``possible``, not all certain), "unknown" (something is
missing that the catalogue does not contain), "nothing". ``kind`` is one of `robustlab.dynamics.KINDS`; ``effect``,
``at`` (a joint's velocity, an input, an output) and ``probability`` may be left out. ``possible``: every kind that may
be there. ``complete``: false if something remains that is not named. ``seconds``: of CPU.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robustlab.dynamics import KINDS

SCHEMA = "robustlab.naming.answers/1"
VERDICTS = ("named", "open", "unknown", "nothing")


def write_answers(path: Path, program: str, answers: Mapping[str, Any]) -> None:
    """Write the answers of a program, case by case."""
    data = {"schema": SCHEMA, "program": program, "answers": dict(sorted(answers.items()))}
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def read_answers(path: Path) -> tuple[str, dict[str, Any]]:
    """Return the program and its answers, checked.

    Raises ValueError: an invalid answer, with its case and the fault.
    """
    data = json.loads(path.read_text(encoding="utf-8"))
    if data.get("schema") != SCHEMA or not isinstance(data.get("answers"), dict):
        raise ValueError(f"{path}: schema {data.get('schema')!r}, expected {SCHEMA!r} with answers")
    for case, answer in data["answers"].items():
        if answer.get("verdict") not in VERDICTS:
            raise ValueError(
                f"{path}: case {case}: verdict {answer.get('verdict')!r}, expected one of {', '.join(VERDICTS)}"
            )
        named, possible = answer.setdefault("named", []), answer.setdefault("possible", [])
        for kind in [*(one.get("kind") for one in named), *possible]:
            if kind not in KINDS:
                raise ValueError(f"{path}: case {case}: kind {kind!r}, expected one of {', '.join(KINDS)}")
        if (answer["verdict"] == "named") != bool(named):
            raise ValueError(f"{path}: case {case}: verdict {answer['verdict']!r} with {len(named)} names")
    return str(data.get("program", path.stem)), data["answers"]
