"""Every command before and after a change of the house: exit codes, and all numbers of ``--json``.

python benchmarks/commands.py run OUT.json          # with the robustlab that is on the path
python benchmarks/commands.py compare OLD.json NEW.json

Numbers are compared key by key to 1e-9 (1e-6 where a search's path depends on the last bits); keys that only one side
has are listed. Commands that write a controller or a model are followed by others that read it, so files count, too.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent.parent
RTOL = 1e-9
# Keys that are of the moment, not of the answer.
MOMENT = ("seconds", "created", "elapsed", "file", "path", "sha256", "evaluations_per", "version", "command", "schema")

COMMANDS = """
model build dc-motor --set R=2.1 --out motor.h5
model build two-mass --out twomass.h5
model build mass-spring-damper --out msd.h5
model build stewart-platform --pose 0,0,0.13,0.02,0,0 --out platform.h5
model show motor.h5
model show {models}/motor_nominal.h5
model check motor.h5
model check msd.h5
model diff {models}/motor_nominal.h5 {models}/motor_perturbed.h5
model convert motor.h5 motor.mat
model convert motor.mat again.h5
model margins {models}/cascaded_tanks.h5
model margins {models}/cascaded_tanks.h5 --classical
model margins {models}/cascaded_tanks.h5 --frequency 0.01,0.1
model margins {models}/cascaded_tanks.h5 --at input --skew 0.5
model check late.h5
model show late.h5
model reduce platform.h5 --order 8 --out small.h5
model reduce msd.h5 --order 1
synth mixsyn {models}/motor_nominal.h5 --outputs omega --w1 bandwidth=150,error=0.001 --w2 limit=0.4 --out mixed.h5
synth ncf {models}/motor_nominal.h5 --outputs omega --w1 0.5 --out ncf.h5
synth hinf {models}/motor_nominal.h5 --measurements 1 --controls 1
synth discretise plant1.h5 mixed1.h5 --dt 0.001
model margins {models}/motor_nominal.h5 -k mixed.h5
model margins {models}/motor_nominal.h5 -k ncf.h5 --classical
model margins late.h5 -k mixed.h5
model margins late.h5 -k mixed.h5 --classical
model convert mixed.h5 mixed.json
uncertain build {models}/motor_nominal.h5 {models}/motor_perturbed.h5 --structure elements --out set.h5
uncertain build {models}/motor_nominal.h5 {models}/motor_perturbed.h5 --structure columns --out columns.h5
uncertain build --plant dc-motor --tolerance Km=0.05 --range Kf=4e-5:7e-5 --outputs omega --out motors.h5
uncertain build --plant dc-motor --tolerance R=0.1 --tolerance Kf=0.35 --outputs omega --out speed.h5
uncertain build --plant stewart-platform --tolerance platform_mass=0.1 --pose 0,0,0.13,0.02,0,0 --out platforms.h5
uncertain build --expressions {models}/springs.toml --out springs.h5
uncertain build --cover {models}/motor_nominal.h5 --cover {models}/motor_perturbed.h5 --form pca --out cover.h5
uncertain show set.h5
uncertain show motors.h5
uncertain sample motors.h5 -n 20 --seed 1 --vertices all --input-value u=42 --t-end 0.1
mu set.h5
mu motors.h5 --intervals
mu motors.h5 --gain
mu motors.h5 --performance
mu motors.h5 --level 12
mu motors.h5 --frequency 1,10
mu motors.h5 --gain --frequency 1,10
mu speed.h5 -k mixed.h5
mu speed.h5 -k mixed.h5 --gain
mu springs.h5
model margins motors.h5 -k mixed.h5
worst-case motors.h5 --metric peak-deviation --outputs omega --input-value u=42 --t-end 0.1
worst-case motors.h5 --metric settling-time --outputs omega --input-value u=42 --t-end 0.1
worst-case motors.h5 --metric hinf
worst-case motors.h5 --limit 20 --probability 0.05 --outputs omega --input-value u=42 --t-end 0.1
worst-case motors.h5 --limit 9000 -n 100 --outputs omega --input-value u=42 --t-end 0.1
campaign run motors.h5 --input-value u=42 --t-end 0.1 -n 200 --workers 1 --store motors.sqlite
campaign show motors.sqlite --limit 34
campaign replay motors.sqlite 17
plant list
plant show dc-motor
plant show servo-axis
data check {recipes}/data/motor_record.csv --inputs u --outputs phi,i
data convert {recipes}/data/motor_record.csv record.h5 --inputs u --outputs phi,i
data compare dc-motor {recipes}/data/motor_record.csv --inputs u --outputs phi,i
data validate speed.h5 {recipes}/data/motor_record.csv --inputs u --outputs phi --noise phi=1e-3
mu motor.h5
mu nothing.h5
model margins motor.h5 --at nowhere
uncertain build
synth hinf motor.h5
worst-case set.h5 --metric nothing
"""


def run(out: Path) -> None:
    """Run every command in an empty folder; its exit code and its JSON go into a file."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        places = {"models": HERE / "models", "recipes": HERE / "recipes"}
        for line in COMMANDS.strip().splitlines():
            words = [word.format(**places) for word in shlex.split(line)]
            call = [sys.executable, "-m", "robustlab.cli.main", *words, *([] if words[0] == "plot" else ["--json"])]
            done = subprocess.run(call, cwd=folder, capture_output=True, text=True, env=dict(os.environ), check=False)
            try:
                answer = json.loads(done.stdout) if done.stdout else {}
            except json.JSONDecodeError:
                answer = {"text": done.stdout}
            found[line] = {"rc": done.returncode, "answer": answer, "error": done.stderr[-400:]}
            print(done.returncode, line, flush=True)
    out.write_text(json.dumps(found))


# Keys below which an answer stood before its result's own JSON took the place.
AT = ("model.", "set.", "stability.")


def flat(answer: Mapping[str, Any]) -> dict[str, Any]:
    """Every leaf by its path, without what stood above the result."""
    found: dict[str, Any] = {}
    for path, value in leaves(answer):
        prefix = next((at for at in AT if path.startswith(at)), "")
        found.setdefault(path.removeprefix(prefix), value)
    return found


def leaves(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted path and value of every leaf."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key not in MOMENT:
                yield from leaves(item, f"{at}.{key}".lstrip("."))
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from leaves(item, f"{at}.{k}")
    else:
        yield at, value


def differs(a: Any, b: Any) -> bool:
    """Whether two leaves are not the same."""
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return abs(a - b) > RTOL * max(abs(a), abs(b)) + 1e-300
    return bool(a != b)


def compare(old: Path, new: Path) -> int:
    """Print what differs; how many commands do."""
    before, after = json.loads(old.read_text()), json.loads(new.read_text())
    wrong = 0
    for line, was in before.items():
        now = after.get(line, {"rc": None, "answer": {}, "error": "not run"})
        a, b = flat(was["answer"]), flat(now["answer"])
        changed = [f"{k}: {a[k]} -> {b[k]}" for k in a if k in b and differs(a[k], b[k]) and not isinstance(a[k], str)]
        words = [f"{k}: {a[k]!r} -> {b[k]!r}" for k in a if k in b and isinstance(a[k], str) and a[k] != b[k]]
        gone = sorted({k for k in a if k not in b})
        if was["rc"] != now["rc"] or changed or gone:
            wrong += 1
            print(f"{line}\n  exit code {was['rc']} -> {now['rc']}" if was["rc"] != now["rc"] else line)
            if was["rc"] != now["rc"]:
                print(f"  {now['error']}")
            for text in [*changed[:8], *words[:3]]:
                print(f"  {text[:160]}")
            if gone:
                print(f"  gone: {', '.join(gone[:8])}{f' and {len(gone) - 8} more' if len(gone) > 8 else ''}")
    print(f"{len(before) - wrong} of {len(before)} commands answer the same")
    return wrong


if __name__ == "__main__":
    if sys.argv[1] == "run":
        run(Path(sys.argv[2]))
    else:
        sys.exit(1 if compare(Path(sys.argv[2]), Path(sys.argv[3])) else 0)
