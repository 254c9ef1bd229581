"""Exit code and numbers of ``--json`` of every command that stays; commands of a chapter share a folder."""

from __future__ import annotations

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

from .cases import ROOT, Case, kept
from .robust_designs import oscillator

RTOL = 1e-6
RTOLS = {"gamma": 1e-3, "frequency": 1e-2, "level": 1e-3, "loss": 5e-3, "separation": 2e-2}
# What takes more than some seconds.
SLOW = {"sets", "designs", "records", "searches", "naming"}
CHAPTERS = {
    "models": """
model build dc-motor --set R=2.1 --out motor.h5
model build two-mass --out twomass.h5
model build stewart-platform --pose 0,0,0.13,0.02,0,0 --out platform.h5
model show motor.h5
model check motor.h5
model check {models}/motor_nominal.h5
model diff {models}/motor_nominal.h5 {models}/motor_perturbed.h5
model convert motor.h5 motor.mat
model convert motor.mat again.h5
model show again.h5
model reduce platform.h5 --order 8 --out small.h5
model reduce twomass.h5 --order 2
model margins {models}/cascaded_tanks.h5
model margins {models}/cascaded_tanks.h5 --classical
model margins {models}/cascaded_tanks.h5 --at input --skew 0.5
plant list
plant show dc-motor
plant show servo-axis
plant new mine
""",
    "sets": """
uncertain build {models}/motor_nominal.h5 {models}/motor_perturbed.h5 --structure elements --out set.h5
uncertain build {models}/motor_nominal.h5 {models}/motor_perturbed.h5 --structure columns --out columns.h5
uncertain build --plant dc-motor --tolerance Km=0.05 --range Kf=4e-5:7e-5 --outputs omega --out motors.h5
uncertain build --plant stewart-platform --tolerance platform_mass=0.1 --pose 0,0,0.13,0.02,0,0 --out platforms.h5
uncertain build --expressions {models}/springs.toml --out springs.h5
uncertain build --cover {models}/motor_nominal.h5 --cover {models}/motor_perturbed.h5 --form pca --out cover.h5
uncertain show set.h5
uncertain show motors.h5
uncertain sample motors.h5 -n 20 --seed 1 --vertices all --input-value u=42 --t-end 0.1
mu set.h5
mu motors.h5
mu motors.h5 --gain
mu motors.h5 --performance
mu motors.h5 --level 12
mu motors.h5 --frequency 1,10
mu springs.h5
worst-case motors.h5 --metric peak-deviation --outputs omega --input-value u=42 --t-end 0.1
worst-case motors.h5 --metric settling-time --outputs omega --input-value u=42 --t-end 0.1
worst-case motors.h5 --metric hinf
worst-case motors.h5 --limit 20 --probability 0.05 --outputs omega --input-value u=42 --t-end 0.1
campaign run motors.h5 --input-value u=42 --t-end 0.1 -n 200 --workers 1 --store motors.sqlite
campaign show motors.sqlite --limit 34
campaign replay motors.sqlite 17
campaign resume motors.sqlite
""",
    "designs": """
synth mixsyn {models}/motor_nominal.h5 --outputs omega --w1 bandwidth=150,error=0.001 --w2 limit=0.4 --out mixed.h5
synth ncf {models}/motor_nominal.h5 --outputs omega --w1 0.5 --out ncf.h5
synth hinf problem.h5 --measurements 1 --controls 1 --out hinf.h5
synth h2 problem.h5 --measurements 1 --controls 1
synth reduce problem.h5 hinf.h5 --measurements 1 --controls 1 --order 1
synth discretise problem.h5 hinf.h5 --measurements 1 --controls 1 --dt 0.1 --out digital.h5
model convert digital.h5 speed.c --prefix speed
uncertain build --plant dc-motor --tolerance R=0.1 --tolerance Kf=0.35 --outputs omega --out speed.h5
model margins {models}/motor_nominal.h5 -k mixed.h5
model margins {models}/motor_nominal.h5 -k ncf.h5 --classical
mu speed.h5 -k mixed.h5
mu speed.h5 -k mixed.h5 --gain
model convert mixed.h5 mixed.mat
verify mixed.h5
""",
    "searches": """
synth dk problem.h5 --blocks "1,0;2,2" --measurements 1 --controls 1 --effort 0.02 --no-direct
synth fixed problem.h5 --structure order:1 --measurements 1 --controls 1 --starts 1
""",
    "records": """
data check {recipes}/data/motor_record.csv --inputs u --outputs phi,i
data convert {recipes}/data/motor_record.csv record.h5 --inputs u --outputs phi,i
data compare dc-motor record.h5
uncertain build --plant dc-motor --tolerance R=0.1 --tolerance Kf=0.35 --outputs phi --out angle.h5
data validate angle.h5 {recipes}/data/jig_slow.csv --inputs u --outputs phi --noise phi=1e-3
recipe new mine
recipe check mine.toml
recipe check {recipes}/first-light.toml
recipe check {recipes}/flagship.toml
recipe check {recipes}/robust-machine.toml
""",
    "naming": """
data discover dc-motor {recipes}/data/motor_record.csv --inputs u --outputs phi,i
""",
    "runs": """
run {recipes}/motor-models.toml --out one
run {recipes}/motor-models.toml --out two --set nominal_motor.parameters.R=2.0
report write one
report compare one one
report compare one two
""",
    "refusals": """
mu {models}/motor_nominal.h5
mu nothing.h5
model margins {models}/motor_nominal.h5 --at nowhere
uncertain build
synth hinf {models}/motor_nominal.h5
worst-case {models}/motor_nominal.h5 --metric nothing
data compare dc-motor nothing.csv
data check {models}/motor_nominal.h5
recipe check nothing
run nothing
plant show nothing
verify {models}/motor_nominal.h5
nothing
""",
}
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
    for chapter in CHAPTERS:
        yield Case(chapter, lambda chapter=chapter: answers(CHAPTERS[chapter]), chapter in SLOW)


def answers(chapter: str) -> dict[str, Any]:
    """Command -> exit code and numbers."""
    lines = chapter.strip().splitlines()
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
