"""Score effect identification on the Stewart platform, effect AND leg: ``python benchmarks/platform_discover.py``.

Each case of `platform_cases` runs `robustlab.discover` in its own process and writes one line to ``--store``. Stored
cases are not run again. A case that was refused, failed or ran out of time is also stored, and counts as wrong.
``--report`` prints the scores of the stored cases only.

Scores: *right*: exactly the hidden effect, or its effect class, is named at exactly its legs (a time delay of the input
or of the sensor counts as one at its leg). *By name*: the effect itself is named. *In the answer*: a set of the 95 %
collection contains it. *Sure and wrong*: the verdict is "named" and neither is right. A case without a hidden effect
is right if nothing is named. A case outside the catalogue is right if nothing is named or the answer is incomplete.

Seeds: 1-99 for tuning, 9001-9099 for checking; 77001-77099 (``--last``) are run once, at the very end.
"""

from __future__ import annotations

import argparse
import json
import time
import traceback
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import append, in_child, json_lines
from platform_cases import NOISE, OUTSIDE, PlatformCase, cached_case, names, nominal_plant, seeds

from robustlab.dynamics import KIND_OF

Line = dict[str, Any]
Legs = frozenset[tuple[str, int]]  # (effect, leg 1..6; 0: nowhere in particular)

LAST = range(77001, 77100)
LIMIT = 1200.0  # s of wall time a case
CACHE = Path("out/platform_cases")

# Other names accepted for a hidden effect, where the records or the catalogue do not distinguish the two: an encoder
# offset is a bias of its reading, and without motors a motor's torque constant is the gain of its input. The
# platform's mass is an inertia of the machine, and its centre a centre of mass.
ACCEPTED = {
    "encoder-offset": ("sensor-bias",),
    "input-gain": ("input-gain", "torque-constant"),
    "platform-mass": ("inertia",),
    "platform-centre": ("centre-of-mass",),
}
COMMON = ("platform-mass", "platform-centre", "gravity-direction")


def legs_of(effects: Iterable[tuple[str, str]]) -> Legs:
    """Convert (effect, place) pairs to (effect, leg): a place such as ``phidot_3`` or ``u_3`` is leg 3."""
    out = set()
    for name, place in effects:
        tail = place.rpartition("_")[2]
        out.add((name, int(tail) if tail in "123456" and tail else 0))
    return frozenset(out)


def is_truth(named: Legs, case: PlatformCase, of: Mapping[str, str] | None = None) -> bool:
    """Return whether the named effects are exactly the hidden one, or with `KIND_OF` its class, at its legs."""
    if case.name in ("none", *OUTSIDE):
        return of is None and not named
    own = [of[name] if of else name for name in ACCEPTED.get(case.effect, (case.effect,))]
    if not named or any(name not in own for name, _ in named):
        return False
    legs = {leg for _, leg in named}
    return case.effect in COMMON or legs == set(case.legs) or (len(case.legs) == 6 and legs == {0})


def verdict_of(
    case: PlatformCase, verdict: str, complete: bool, named: Legs, open_sets: Sequence[Legs], kinds: Legs
) -> Line:
    """Return right, by_name, in_answer, sure_wrong of an answer."""
    if case.name in OUTSIDE:
        right = verdict == "unknown" or not complete
        return {
            "right": right, "by_name": right, "in_answer": right, "sure_wrong": verdict == "named" and complete,
        }  # fmt: skip
    sure = verdict in ("named", "no missing effect")
    by_name, by_kind = is_truth(named, case), is_truth(kinds, case, KIND_OF)
    right = sure and (by_name or by_kind)
    found = right or any(is_truth(s, case) for s in (named, *open_sets))
    return {
        "right": right, "by_name": sure and by_name, "in_answer": found,
        "sure_wrong": verdict == "named" and not (by_name or by_kind),
    }  # fmt: skip


def run_case(name: str, seed: int, motors: bool, noise: str, cache: Path, exclude: Sequence[str] = ()) -> Line:
    """Run one case in this process; errors are stored in the line."""
    import robustlab as rl

    line: Line = {}
    try:
        case = cached_case(cache, name, seed, motors=motors, noise=noise)
        plant = nominal_plant(motors)
        line = {"truth": case.truth()}
        plant.derivative(*(np.zeros(len(s)) for s in (plant.states, plant.inputs)))  # compiled code is loaded
        wall, cpu = time.perf_counter(), time.process_time()
        found = rl.discover(plant, [case.record], held_out=[case.held_out], exclude=tuple(exclude))
        line |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        named = [(e.name, e.site) for e in found.effects]
        sets = [[tuple(e.partition("@")[::2]) for e in p.effects] for p in found.collection]
        kinds = [(k.kind, k.place) for k in found.kinds]
        open_sets = [legs_of(s) for s in sets]
        line |= verdict_of(case, found.verdict, found.complete, legs_of(named), open_sets, legs_of(kinds))
        line |= {
            "status": "ok", "verdict": found.verdict, "complete": found.complete, "named": named, "kinds": kinds,
            "values": [{v.name: (v.value, v.lower, v.upper) for v in e.parameters} for e in found.effects],
            "posterior": [(p.effects, p.probability) for p in found.posterior[:8]],
            "gap_before": found.gap_before, "gap_refitted": found.gap_refitted, "gap_after": found.gap_after,
        }  # fmt: skip
    except rl.RobustlabError as error:
        line |= {"status": "refused", "error": str(error)}
    except Exception:  # noqa: BLE001 - a lost case would make the figures better than they are
        line |= {"status": "failed", "error": traceback.format_exc(limit=-4)}
    return line


def _in_a_process(name: str, seed: int, args: argparse.Namespace) -> Line:
    """Run one case in its own process, with a time limit."""
    command = [__file__, "--one", name, str(seed), "--noise", args.noise, "--cache", str(args.cache)]
    command += [*(["--torques"] if args.torques else []), *(["--exclude", *args.exclude] if args.exclude else [])]
    line = in_child(command, "", wall=args.limit)
    return line if "refused" not in line else {"status": "lost", "error": line["refused"]}


def report(lines: Iterable[Line]) -> str:
    """Return the table of the classes and the summary figures."""
    by_class: dict[str, list[Line]] = defaultdict(list)
    for line in lines:
        by_class[line["name"]].append(line)
    if not by_class:
        return "no cases"
    heads = (
        f"{'cases':>5s} {'right':>6s} {'by name':>7s} {'answer':>6s} {'sure wrong':>10s} {'lost':>5s} {'CPU s':>11s}"
    )
    rows = [f"{'class':24s} {heads}"]

    def row(title: str, of: list[Line]) -> str:
        cpu = [line["cpu_s"] for line in of if "cpu_s" in line]
        time_text = f"{np.median(cpu):5.0f}/{max(cpu):5.0f}" if cpu else "-"
        count = [sum(bool(line.get(key)) for line in of) for key in ("right", "by_name", "in_answer", "sure_wrong")]
        lost = sum(line["status"] != "ok" for line in of)
        counts = f"{len(of):5d} {count[0]:6d} {count[1]:7d} {count[2]:6d} {count[3]:10d} {lost:5d}"
        return f"{title:24s} {counts} {time_text:>11s}"

    rows += [row(name, by_class[name]) for name in by_class]
    single = [x for name, of in by_class.items() for x in of if name not in ("none", *OUTSIDE) and name[:3] != "2x "]
    pairs = [x for name, of in by_class.items() for x in of if name[:3] == "2x "]
    for title, of in (("one effect", single), ("two legs", pairs), ("nothing", by_class.get("none", []))):
        if of:
            rows.append(row(f"ALL {title}", of))
    silent = by_class.get("none", [])
    if silent:
        wrong = sum(line.get("verdict") in ("named", "ambiguous", "unknown") for line in silent)
        rows.append(f"nothing missing -> a name: {wrong} of {len(silent)} ({100 * wrong / len(silent):.0f} %)")
    before = [x["gap_before"] / x["gap_after"] for x in single if x.get("right") and x.get("gap_after")]
    if before:
        rows.append(f"held-out model error falls by a factor of (median of the right cases): {np.median(before):.1f}")
    return "\n".join(rows)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1-2", help="like 1-3,7")
    parser.add_argument("--only", nargs="+", metavar="CLASS", help="classes (all that the machine can have)")
    parser.add_argument("--torques", action="store_true", help="without motors: torques in, encoders out")
    parser.add_argument("--noise", choices=NOISE, default="mid")
    parser.add_argument("--exclude", nargs="+", default=[], metavar="EFFECT", help="effects that are not to be tried")
    parser.add_argument("--store", type=Path, default=Path("out/platform_discover.jsonl"), help="one JSON line a case")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the records")
    parser.add_argument("--limit", type=float, default=LIMIT, help="wall time in s after which a case is given up")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no case after this time")
    parser.add_argument("--last", action="store_true", help="the last seeds, after which nothing is tuned any more")
    parser.add_argument("--again", action="store_true", help="run what the store has, too")
    parser.add_argument("--report", action="store_true", help="run nothing: print the figures of what --store holds")
    parser.add_argument("--one", nargs=2, metavar=("CLASS", "SEED"), help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    if args.one:
        name, seed = args.one
        print(json.dumps(run_case(name, int(seed), not args.torques, args.noise, args.cache, args.exclude)))
        return
    possible = names(not args.torques)
    if strange := set(args.only or ()) - set(possible):
        parser.error(f"no class {', '.join(sorted(strange))}: {', '.join(possible)}")
    wanted = seeds(args.seeds)
    if set(wanted) & set(LAST) and not args.last:
        parser.error(f"seeds {LAST[0]}-{LAST[-1]} are run once, at the very end: --last")
    kind = f"{'torques' if args.torques else 'motors'} | {args.noise}"
    keys = {f"{n} | {s} | {kind}": (n, s) for s in wanted for n in args.only or possible}
    done, began = {line["key"]: line for line in json_lines([args.store])}, time.time()
    args.store.parent.mkdir(parents=True, exist_ok=True)
    for number, (key, (name, seed)) in enumerate(keys.items(), 1):
        if args.report or (key in done and not args.again) or time.time() - began > 60 * args.minutes:
            continue
        line = {"key": key, "name": name, "seed": seed, **_in_a_process(name, seed, args)}
        if "truth" not in line:
            line["truth"] = cached_case(args.cache, name, seed, motors=not args.torques, noise=args.noise).truth()
        done[key] = line
        append(args.store, line)
        legs = line["truth"]["legs"]
        found = line.get("named", line.get("error", "")[-200:])
        good = "right" if line.get("right") else "SURE WRONG" if line.get("sure_wrong") else "not right"
        text = f"{line.get('verdict', line['status'])} {found} CPU {line.get('cpu_s', 0.0):.0f} s"
        print(
            f"# {number}/{len(keys)} {time.time() - began:5.0f} s  {name} {seed} at {legs}: {good}, {text}", flush=True
        )
    print(report(done[key] for key in keys if key in done))


if __name__ == "__main__":
    main()
