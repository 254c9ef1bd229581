"""Naming a missing effect, judged on blind cases: ``python benchmarks/discover.py --store FILE.jsonl``.

Every case (machine with something hidden in it, `hidden.make_case`) is one line of the store; cases that are there are
not run again, and one that was refused, failed, crashed or ran out of time is a line, too, and counts as wrong. The
order is seed by seed, shuffled within a seed: a run that is cut short (``--minutes``, Ctrl-C) is a fair sample. Then
the figures of `discover_figures` are printed. ``--peer`` runs PySINDy on the same cases; ``--report`` runs nothing.

Seeds: 1-99 for tuning, 9001-9099 for checking; 77001-77099 (``--last``) are run once, at the very end.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import queue
import random
import subprocess
import threading
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from discover_distance import distance
from discover_figures import report
from discover_truth import interval
from hidden import FAMILIES, LAWS, Family, make_case

__all__ = ["CONDITIONS", "Condition", "Setup", "Task", "main", "run_case", "tasks", "true_error"]

Kind = Literal["single", "none", "outside", "pairs", "poor"]
Line = dict[str, Any]

DEFAULT_SEEDS = "1-2"  # whoever reports figures names seeds that were never used
LAST = range(77001, 77100)  # seeds that must be unknown to whoever tunes
LIMIT = 900.0  # s of wall time for one case
SETS = 12  # of the posterior that a line keeps


class Setup(NamedTuple):
    """How a machine is measured: noise level, excitation (or "closed-loop"), and what lies between the samples."""

    noise: str
    excitation: str
    hold: str = "held"

    def __str__(self) -> str:
        return " ".join(self)


@dataclass(frozen=True)
class Condition:
    """Classes of every family, measured in one way or several; ``poor`` carries the proposed experiment out, too.

    ``usual`` conditions are run where none are asked for; ``families`` narrows a condition. ``laws``: the classes that
    have other formulas (`hidden.LAWS`), after each of them; a class is then "end-stop~hertz".
    """

    kind: Kind
    setups: tuple[Setup, ...]
    usual: bool = True
    families: tuple[str, ...] = tuple(FAMILIES)
    laws: bool = False

    def classes(self, family: Family) -> tuple[tuple[str, ...], ...]:
        """Sets of effects to hide."""
        if self.laws:
            return tuple((f"{name}~{law}",) for name in family.classes for law in LAWS.get(name, ()))
        if self.kind == "pairs":
            return family.pairs
        names = {"none": ("none",), "outside": family.outside}.get(self.kind, family.classes)
        return tuple((name,) for name in names)


class Task(NamedTuple):
    """One case for one of the two ("robustlab", "pysindy")."""

    who: str
    condition: str
    family: str
    setup: Setup
    effects: tuple[str, ...]
    seed: int

    @property
    def key(self) -> str:
        return " | ".join(
            (self.who, self.condition, self.family, str(self.setup), "+".join(self.effects), str(self.seed))
        )


RICH = Setup("mid", "rich")
LEVELS = ("low", "mid", "high")
IN_A_LOOP = ("motor", "motor-current", "axis", "actuator", "two-mass")
CONDITIONS = {
    "single": Condition("single", (RICH,)),
    "single-continuous": Condition("single", (Setup("mid", "rich", "continuous"),)),
    "none": Condition(
        "none",
        (
            *(Setup(n, e) for n in LEVELS for e in ("rich", "multisine", "square", "oneway", "steps")),
            *(Setup("mid", e, "continuous") for e in ("rich", "multisine", "square")),
        ),
    ),
    "none-closed-loop": Condition("none", tuple(Setup(n, "closed-loop") for n in LEVELS), families=IN_A_LOOP),
    "outside": Condition("outside", (RICH,)),
    "pairs": Condition("pairs", (RICH,)),
    "laws": Condition("single", (RICH,), laws=True),
    "square": Condition("poor", (Setup("mid", "square"),)),
    "oneway": Condition("poor", (Setup("mid", "oneway"),)),
    "single-low": Condition("single", (Setup("low", "rich"),), usual=False),
    "single-high": Condition("single", (Setup("high", "rich"),), usual=False),
    "closed-loop": Condition("single", (Setup("mid", "closed-loop"),), usual=False, families=IN_A_LOOP),
}
USUAL = tuple(name for name, condition in CONDITIONS.items() if condition.usual)


def tasks(
    names: Sequence[str],
    seeds: Sequence[int],
    classes: Sequence[str] | None = None,
    families: Sequence[str] = tuple(FAMILIES),
    peer: bool = False,
) -> Iterator[Task]:
    """All cases asked for, seed by seed; the order within a seed is a permutation that belongs to the seed."""
    for seed in seeds:
        of_seed = [
            Task("robustlab", name, family, setup, effects, seed)
            for name, condition in CONDITIONS.items()
            for family in condition.families
            for effects in condition.classes(FAMILIES[family])
            for setup in condition.setups
        ]
        random.Random(seed).shuffle(of_seed)
        for task in of_seed:
            if task.condition not in names or task.family not in families:
                continue
            if classes and "+".join(task.effects) not in classes:
                continue
            yield task
            if peer and task.family == "motor":
                yield task._replace(who="pysindy")


# --- one case --------------------------------------------------------------------------------------------------------


def run_case(task: Task) -> Line:
    """Run one case; whatever goes wrong is in the line."""
    line = _head(task)
    from robustlab.errors import RobustlabError

    try:
        line |= _peer(task) if task.who == "pysindy" else _named(task)
    except RobustlabError as error:
        line |= {"status": "refused", "error": str(error)}
    except Exception:  # noqa: BLE001 - a lost case would make the figures better than they are
        line |= {"status": "failed", "error": traceback.format_exc(limit=-4)}
    return line


def _head(task: Task) -> Line:
    """What is known of a case without running it."""
    return {
        "key": task.key, "who": task.who, "condition": task.condition, "kind": CONDITIONS[task.condition].kind,
        "family": task.family, **task.setup._asdict(), "truth": [e for e, _ in _hidden(task)],
        "laws": [law for _, law in _hidden(task) if law], "seed": task.seed,
    }  # fmt: skip


def _hidden(task: Task) -> list[tuple[str, str]]:
    """The hidden effects, and the formula of each; empty for the usual one."""
    names = [e.partition("~") for e in task.effects if e != "none"]
    return [(name, law) for name, _, law in names]


def _case(task: Task) -> Any:
    noise, excitation, hold = task.setup
    family, closed = FAMILIES[task.family], excitation == "closed-loop"
    return make_case(
        [e for e, _ in _hidden(task)] or "none",
        task.seed,
        laws={e: law for e, law in _hidden(task) if law},
        plant=family.plant,
        current=family.current,
        noise=noise,
        excitation="rich" if closed else excitation,
        hold=hold,
        closed_loop=closed,
    )


def _peer(task: Task) -> Line:
    from sindy_peer import peer_names

    case = _case(task)
    began = time.process_time()
    names = peer_names(case)
    return {"status": "ok", "by_window": names, "cpu_s": time.process_time() - began}


def _named(task: Task) -> Line:
    case = _case(task)
    found, line = _discovered(case, [case.record])
    line |= {
        "status": "ok",
        "intervals": [x for e in found.effects if (x := interval(e, case))],
    }
    try:
        line["true_error"] = true_error(case, found)
        told = [(e.name, e.site, {v.name: v.value for v in e.parameters}) for e in found.effects]
        line["distance"] = distance(case, case.effects, told) if case.effects else float("inf")
    except Exception:  # noqa: BLE001 - the yardstick failed, not the naming
        line |= {"true_error_failed": traceback.format_exc(limit=-4)}
    if CONDITIONS[task.condition].kind == "poor" and found.next_experiment is not None:
        line |= _after_experiment(case, found.next_experiment)
    return line


def _discovered(case: Any, records: list[Any]) -> tuple[Any, Line]:
    from robustlab.identification.naming.discovery import discover

    wall, cpu = time.perf_counter(), time.process_time()
    found = discover(case.plant, records[0] if len(records) == 1 else records, case.held_out)
    spent = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return found, spent | {
        "verdict": found.verdict, "names": list(found.names), "answer": list(found.answer), "complete": found.complete,
        "posterior": _posterior(found), "confidence": {e.name: e.confidence for e in found.effects},
        "kinds": [[k.kind, k.place, k.probability, k.members[0].name if k.settled else ""] for k in found.kinds],
        "quantities": {k.kind: {v.name: [v.value, v.lower, v.upper] for v in k.values} for k in found.kinds},
        "also": [e.name for e in found.also_detectable],
        "gap_before": found.gap_before, "gap_refitted": found.gap_refitted, "gap_after": found.gap_after,
    }  # fmt: skip


def _posterior(found: Any) -> list[tuple[list[str], float, str]]:
    """Names, probability and unnamed force of the most probable sets; the named set alone where there are none."""
    sets = [(sorted(p.names), p.probability, getattr(p, "unnamed", "")) for p in getattr(found, "posterior", ())]
    if not sets and found.effects:
        sets = [(sorted(found.names), min(e.confidence for e in found.effects), "")]
    return sets[:SETS]


def _after_experiment(case: Any, proposal: Any) -> Line:
    """What is named from the record and the proposed experiment together; an experiment that fails is no success."""
    rig = {case.rig.setup.output, case.rig.setup.second, *(["i"] if case.rig.setup.electrical else [])}
    said: Line = {"name": proposal.name, "foreign": sorted({*proposal.sensors} - rig),
                  "duration": float(proposal.t[-1] - proposal.t[0]),
                  "sensors": list(proposal.sensors), "separation": float(proposal.separation)}  # fmt: skip
    try:
        u = np.asarray(proposal.inputs[case.rig.setup.input], dtype=np.float64)
        dt = float(np.median(np.diff(proposal.t)))
        if not np.isclose(dt, case.rig.dt):  # each sample is held until the next
            u = u[np.minimum((np.arange(round(len(u) * dt / case.rig.dt)) * case.rig.dt / dt).astype(int), len(u) - 1)]
        extra = case.experiment(u, current="i" in proposal.sensors)
        after = _discovered(case, [case.record, extra])[1]
    except Exception:  # noqa: BLE001 - as above
        return {"experiment": said, "after_error": traceback.format_exc(limit=-4)}
    return {"experiment": said, "after": after}


def true_error(case: Any, found: Any) -> float:
    """Held-out error of the true machine in percent of the range, with window starts as free as the named model's.

    What measurement and truth differ by is taken as a record without input and fitted by the windows' starts alone.
    """
    from robustlab import Record
    from robustlab.dynamics.ports.port_model import linear_plant_of, port_model
    from robustlab.identification.hypotheses.candidates import nuisance_parameters, stated_tolerances
    from robustlab.identification.hypotheses.effect_fit import Fit, Hypothesis, Problem, simulated_outputs
    from robustlab.identification.hypotheses.noise import first_noise, restarted
    from robustlab.identification.hypotheses.prepared_record import prepare

    measured, plant = case.held_out, linear_plant_of(case.plant, "bench")
    missed = {name: measured[name] - clean for name, clean in case.held_out_clean.items()}
    silent = {name: np.zeros(measured.n) for name in measured.inputs}
    difference = Record(measured.t, silent, missed, measured.units, "measured less true")
    ports, length = port_model(plant), round(found.window / case.rig.dt)
    free = prepare(plant, ports, measured, length).x0_std
    prepared = replace(prepare(plant, ports, difference, length), x0_std=free)
    problem = Problem(plant, [prepared], nuisance_parameters(plant, stated_tolerances(plant, None)))
    noise, size = first_noise(problem), len(problem.nuisances)
    bare = Fit(Hypothesis(()), np.zeros(size), (), 0.0, np.zeros(0), np.eye(size), noise, 0)
    rest = prepared.measured - simulated_outputs(problem, restarted(problem, bare))[0]
    outputs = [plant.outputs[k].name for k in prepared.columns]
    shares = [np.sqrt(np.mean(rest[:, :, j] ** 2)) / found.gaps[name].range for j, name in enumerate(outputs)]
    return float(100.0 * np.sqrt(np.mean(np.square(shares))))


# --- many cases ------------------------------------------------------------------------------------------------------


def _serve(pipe: Any) -> None:
    """A worker: compiled code is loaded on a case of its own first, so that the times are those of the naming."""
    from robustlab.budget import one_thread

    with one_thread():
        run_case(Task("robustlab", "single", "motor", Setup("low", "rich"), ("none",), 0))
        while (task := pipe.recv()) is not None:
            pipe.send(run_case(task))


class _Worker:
    """A process of its own: where it dies or hangs, the case is said to have, and the next one gets a new process."""

    def __init__(self, limit: float) -> None:
        self.limit, self.process, self.pipe = limit, None, None

    def run(self, task: Task) -> Line:
        if self.process is None or not self.process.is_alive():
            context = multiprocessing.get_context("spawn")
            self.pipe, theirs = context.Pipe()
            self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
            self.process.start()
            theirs.close()
        try:
            self.pipe.send(task)
            if self.pipe.poll(self.limit):
                return self.pipe.recv()
            status = "timed out"
        except (EOFError, OSError):
            status = "crashed"
        self.close()
        return _head(task) | {"status": status, "error": f"{status} (limit {self.limit:g} s)"}

    def close(self) -> None:
        if self.process is not None:
            self.process.terminate()
            self.process.join(5)
        self.process = None


def run_all(
    wanted: Iterable[Task], store: Path | None, workers: int, limit: float, minutes: float = float("inf")
) -> list[Line]:
    """Run what the store lacks, beginning no case after ``minutes``; returns the lines that are there of the wanted."""
    done = {line["key"]: line for line in stored(store)}
    wanted = list(wanted)
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for task in wanted:
        if task.key not in done:
            waiting.put(task)
    total, lock, revision, began = waiting.qsize(), threading.Lock(), _revision(), time.time()
    count = 0

    def serve() -> None:
        nonlocal count
        worker = _Worker(limit)
        while time.time() - began < 60 * minutes:
            try:
                task = waiting.get_nowait()
            except queue.Empty:
                break
            line = worker.run(task) | {"revision": revision, "at": time.strftime("%Y-%m-%d %H:%M:%S")}
            with lock:
                done[task.key], count = line, count + 1
                if store:
                    with store.open("a", encoding="utf-8") as stream:
                        stream.write(json.dumps(line) + "\n")
                what = line.get("answer", line.get("by_window", {}).get("31*", line["status"]))
                print(f"# {count}/{total} {time.time() - began:6.0f} s  {task.key}: {what}", flush=True)
        worker.close()

    threads = [threading.Thread(target=serve) for _ in range(min(workers, max(total, 1)))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [done[task.key] for task in wanted if task.key in done]


def stored(path: Path | None) -> list[Line]:
    """Lines of the store; a last line that was cut short is run again."""
    lines: list[Line] = []
    if path is None or not path.exists():
        return lines
    text = path.read_text(encoding="utf-8")
    for number, row in enumerate(text.splitlines(), 1):
        try:
            lines.append(json.loads(row))
        except json.JSONDecodeError:
            print(f"# {path.name} line {number} was cut short; its case is run again")
    if text and not text.endswith("\n"):
        with path.open("a", encoding="utf-8") as stream:
            stream.write("\n")
    return list({line["key"]: line for line in lines}.values())


def _revision() -> str:
    """Commit of the code, with a + where tracked files differ from it."""
    here = Path(__file__).parent
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True, check=True
        )
        changed = subprocess.run(
            ["git", "status", "--porcelain", "-uno"], cwd=here, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return commit.stdout.strip() + ("+" if changed.stdout.strip() else "")


def _seeds(text: str) -> list[int]:
    """ "1-3,7" -> [1, 2, 3, 7]."""
    ranges = [part.split("-") for part in text.split(",")]
    return [seed for ends in ranges for seed in range(int(ends[0]), int(ends[-1]) + 1)]


def main(argv: Sequence[str] | None = None) -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--condition", nargs="+", choices=CONDITIONS, default=list(USUAL), metavar="NAME",
                        help=f"of {', '.join(CONDITIONS)} (all up to {USUAL[-1]}; --report: all)")  # fmt: skip
    parser.add_argument("--family", nargs="+", choices=FAMILIES, default=list(FAMILIES), metavar="NAME",
                        help=f"of {', '.join(FAMILIES)} (all)")  # fmt: skip
    parser.add_argument("--seeds", type=_seeds, help=f"like 1-3,7 ({DEFAULT_SEEDS}; --report: all)")
    parser.add_argument("--classes", nargs="+", help="only these; a pair as a+b")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no case after this time")
    parser.add_argument("--workers", type=int, default=2, help="cases at the same time, one thread each")
    parser.add_argument("--limit", type=float, default=LIMIT, help="wall time in s after which a case is given up")
    parser.add_argument("--store", type=Path, help="file of one JSON line a case; what it holds is not run again")
    parser.add_argument("--peer", action="store_true", help="PySINDy on the same cases (pip install robustlab[bench])")
    parser.add_argument("--last", action="store_true", help="the last seeds, after which nothing is tuned any more")
    parser.add_argument("--report", action="store_true", help="run nothing: print the figures of what --store holds")
    asked = parser.parse_args(argv)
    if asked.report:
        if asked.condition == list(USUAL):
            asked.condition = list(CONDITIONS)
        if asked.store is None or not asked.store.exists():
            parser.error("--report needs a --store that exists")
        print(report([line for line in stored(asked.store) if _asked_for(line, asked)]))
        return
    seeds = asked.seeds or _seeds(DEFAULT_SEEDS)
    if set(seeds) & set(LAST) and not asked.last:
        parser.error(f"seeds {LAST[0]}-{LAST[-1]} are run once, at the very end: --last")
    wanted = list(tasks(asked.condition, seeds, asked.classes, asked.family, asked.peer))
    if asked.classes and (strange := set(asked.classes) - {"+".join(t.effects) for t in wanted}):
        parser.error(f"no class {', '.join(sorted(strange))} in these conditions")
    print(report(run_all(wanted, asked.store, asked.workers, asked.limit, asked.minutes)))


def _asked_for(line: Line, asked: argparse.Namespace) -> bool:
    return (
        line["condition"] in asked.condition
        and line["family"] in asked.family
        and (not asked.seeds or line["seed"] in asked.seeds)
        and (not asked.classes or ("+".join(line["truth"]) or "none") in asked.classes)
    )


if __name__ == "__main__":
    main()
