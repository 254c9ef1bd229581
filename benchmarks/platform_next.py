"""The proposed path, done: ``python benchmarks/platform_next.py sensor-delay 1 --out out/platform_next``.

A case of `platform_cases` without motors is named; where the answer is open, the path that `Discovery.next_experiment`
proposes is written as CSV, the hidden machine (Pinocchio, events; not robustlab) follows it under the case's own
controller, which the proposal does not know, and the machine is named again from both records. ``--window 0.12`` gives
the second naming windows of its own: shaken, a leg that is late leaves the plant as given so quickly that naming cuts
its windows to 80 ms.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hidden.sensors import coloured
from platform_cases import (
    DT,
    GEAR,
    LEGS,
    NOISE,
    PlatformCase,
    _controller,
    _record,
    generator,
    make_case,
    names,
    nominal_plant,
)
from platform_discover import said_of, verdict_of
from platform_machine import Array, Run, simulate

import robustlab as rl

BEFORE = round(0.5 / DT)  # samples in which the controller takes hold of the machine at rest


def done(case: PlatformCase, poses: Array, angles: Array) -> rl.Record:
    """The record of the hidden machine that follows references of its nuts, (n, 6), from the first pose on."""
    assert case.machine is not None
    target = np.concatenate([np.repeat(angles[:1], BEFORE, axis=0), angles])
    counts, spread, _, load = NOISE[case.noise]
    lsb, n = 2 * np.pi / (counts * GEAR), len(target)
    shake = spread * generator(case.seed, "encoder", case.name, "next").normal(size=(n, LEGS))
    draw = generator(case.seed, "push", case.name, "next")
    push = GEAR * load * np.column_stack([coloured(n, DT, draw) for _ in range(LEGS)])
    law = _controller(case.machine, target, generator(case.seed, "controller", case.name))
    of = simulate(case.machine, poses[0], n, DT, law, seen=lambda k, y: lsb * np.round((y + shake[k]) / lsb), push=push)
    t = np.asarray(np.arange(len(angles)) * DT, dtype=np.float64)
    run = Run(t, *(value[BEFORE:] for key, value in vars(of).items() if key != "t"))
    return _record(run, case.noise, case.motors, generator(case.seed, "current", case.name, "next"), "proposed")


def told(case: PlatformCase, found: Any) -> dict[str, Any]:
    """The answer as a line."""
    named = [(e.name, e.site) for e in found.effects]
    sets = [said_of(tuple(e.partition("@")[::2]) for e in p.effects) for p in found.collection]
    return {
        **verdict_of(case, found.verdict, found.complete, said_of(named), sets), "verdict": found.verdict,
        "complete": found.complete, "named": named,
        "values": [{v.name: (v.value, v.lower, v.upper) for v in e.parameters} for e in found.effects],
        "posterior": [(p.effects, p.probability) for p in found.posterior[:6]],
    }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    """Name, propose, do, name again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=names(motors=False), metavar="CLASS")
    parser.add_argument("seed", type=int)
    parser.add_argument("--out", type=Path, default=Path("out/platform_next"))
    parser.add_argument("--exclude", nargs="+", default=["pendulum-gravity"], metavar="EFFECT")
    parser.add_argument("--window", type=float, help="s, of the second naming; as it cuts them itself where left out")
    asked = parser.parse_args(argv)
    case = make_case(asked.name, asked.seed, motors=False)
    plant, exclude = nominal_plant(motors=False), tuple(asked.exclude)
    began = time.process_time()
    first = rl.discover(plant, [case.record], held_out=[case.held_out], exclude=exclude)
    lines: dict[str, Any] = {"truth": case.truth(), "first": told(case, first), "cpu_s": time.process_time() - began}
    proposed = first.next_experiment
    if proposed is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        proposed.save(asked.out / f"{asked.name}_{asked.seed}.csv")
        columns = np.column_stack(list(proposed.inputs.values()))
        poses, angles = (np.asarray(part, dtype=np.float64) for part in (columns[:, LEGS:], columns[:, :LEGS]))
        record, began = done(case, poses, angles), time.process_time()
        options = {} if asked.window is None else {"window": asked.window}
        both = rl.discover(plant, [case.record, record], held_out=[case.held_out], exclude=exclude, **options)
        lines |= {
            "path": proposed.name, "d": proposed.separation, "now": proposed.now, "of": proposed.hypotheses,
            "menu": [(t.name, t.separation) for t in proposed.menu], "second": told(case, both),
            "second_cpu_s": time.process_time() - began,
        }  # fmt: skip
    print(json.dumps(lines, indent=1))


if __name__ == "__main__":
    main()
