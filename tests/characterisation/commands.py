"""Exit code and numbers of ``--json`` of every command that stays; those of a chapter share a folder.

The chapters are in ``data/commands.txt``.
"""

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import robustlab as rl

from .cases import DATA, ROOT, Case, kept
from .robust_designs import oscillator

RTOL = 1e-6
RTOLS = {"gamma": 1e-3, "frequency": 1e-2, "level": 1e-3, "loss": 5e-3, "separation": 2e-2}
# What takes more than some seconds.
SLOW = {"sets", "designs", "records", "searches", "naming"}
# All commands of a chapter in one child: what a command imports is imported once.
CHILD = """
import contextlib, io, json, sys
from importlib.metadata import entry_points
main = next(iter(entry_points(group="console_scripts", name="robustlab"))).load()
answers = []
for words in json.loads(sys.argv[1]):
    sys.argv, out = ["robustlab", *words], io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
            main()
        code = 0
    except SystemExit as end:
        code = end.code or 0
    answers.append([code, out.getvalue()])
print(json.dumps(answers))
"""


def cases() -> Iterator[Case]:
    """One a chapter."""
    for chapter in (DATA / "commands.txt").read_text(encoding="utf-8").strip().split("\n\n"):
        title, *lines = chapter.splitlines()
        name = title.removeprefix("# ")
        yield Case(name, lambda lines=lines: answers(lines), name in SLOW)


def answers(lines: list[str]) -> dict[str, Any]:
    """Command -> exit code and numbers."""
    places = {"models": ROOT / "models", "recipes": ROOT / "recipes"}
    with tempfile.TemporaryDirectory() as folder:
        rl.save(Path(folder, "problem.h5"), oscillator())
        done = robustlab([[word.format(**places) for word in shlex.split(line)] for line in lines], folder)
    found = {}
    for line, (code, text) in zip(lines, done, strict=True):
        try:
            numbers = kept(json.loads(text)) if text else {}
        except json.JSONDecodeError:
            numbers = {}
        found[line.replace(".", "_")] = {"code": str(code), "numbers": numbers}
    return found


def robustlab(commands: list[list[str]], folder: str) -> list[tuple[int, str]]:
    """Exit code and stdout of each command, in a folder, as JSON where the command has it."""
    call = [sys.executable, "-c", CHILD, json.dumps([[*words, "--json"] for words in commands])]
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=True, env=environment)
    return json.loads(done.stdout.splitlines()[-1])
