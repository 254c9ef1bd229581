"""An open benchmark of naming: ``python benchmarks/naming_benchmark.py make|answer|score`` (docs/discover.md).

``make DIR`` writes the data set (some 300 cases, with the hidden effects in ``truth.json``). ``answer DIR --program
robustlab --out FILE.json`` runs one of three programs (robustlab, stepwise, sindy; the last needs ``pip install
robustlab[bench]``) and continues an interrupted run. ``score DIR FILE.json ...`` prints one table.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import time
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from naming.answers import read_answers, write_answers
from naming.composition import composition
from naming.dataset import make
from naming.regression import PROGRAMS
from naming.regression import answer as regressed
from naming.scoring import is_right, table

SEED = 2026
WINDOWS, MOST_STARTS = 12, 24  # windows of a record; most combinations of places and start values of hidden effects


def robustlab(folder: Path) -> dict[str, Any]:
    """Return the answer of `robustlab data discover` to a case."""
    import robustlab as rl
    from robustlab.budget import one_thread

    plant = rl.load(folder / "model.h5")
    inputs = [s.name for s in plant.inputs]
    record, held_out = (rl.Record.read(folder / "records.h5", name, inputs) for name in ("record", "held_out"))
    with one_thread():
        began = time.process_time()
        found = rl.discover(plant, record, held_out)
        seconds = time.process_time() - began
    verdict = {"no missing effect": "nothing", "ambiguous": "open"}.get(found.verdict, found.verdict)
    kinds = [
        {"kind": k.kind, "at": k.place, "effect": next(iter(k.members)).partition("@")[0] if k.settled else None,
         "probability": k.probability}
        for k in found.kinds
    ]  # fmt: skip
    return {
        "verdict": verdict,
        "named": kinds if verdict == "named" else [],
        "considered": [] if verdict == "named" else kinds,
        "possible": sorted({_kind(name) for name in found.answer}),
        "complete": found.complete,
        "effects": [{"name": e.name, "at": e.site, "values": {v.name: v.value for v in e.parameters}}
                    for e in found.effects],
        "gap": [found.gap_before, found.gap_refitted, found.gap_after],
        "seconds": round(seconds, 2),
    }  # fmt: skip


def _kind(effect: str) -> str:
    from robustlab.dynamics import KIND_OF

    return KIND_OF[effect]


def _answered(job: tuple[Path, str]) -> tuple[str, dict[str, Any]]:
    folder, program = job
    try:
        return folder.name, robustlab(folder) if program == "robustlab" else regressed(folder, program)
    except Exception:  # noqa: BLE001 - a failed case is stored and counts as not right
        return folder.name, {"verdict": "open", "complete": False, "failed": traceback.format_exc(limit=-3)}


def answer(folder: Path, program: str, out: Path, minutes: float, workers: int) -> None:
    """Run a program on all cases without an answer in the file."""
    version = ""
    if program == "robustlab":
        from robustlab.provenance import library_versions

        version = f" {library_versions()['robustlab']}"
    done = read_answers(out)[1] if out.exists() else {}
    jobs = [(path, program) for path in sorted((folder / "cases").iterdir()) if path.name not in done]
    began = time.monotonic()
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=50) as pool:
        for key, result in pool.imap_unordered(_answered, jobs):
            done[key] = result
            write_answers(out, program + version, done)
            print(f"# {len(done)} {time.monotonic() - began:5.0f} s  {key}: {result['verdict']} "
                  f"{[n['kind'] for n in result.get('named', [])]}", flush=True)  # fmt: skip
            if time.monotonic() - began > 60 * minutes:
                pool.terminate()
                break


def apart(folder: Path, truth: dict[str, Any], answers: dict[str, Any], seed: int) -> dict[str, float]:
    """Return case -> refit distance of truth and answer, for singles and pairs with a different answer.

    Answers that contain all hidden effects are left out: there the records do show the truth.
    """
    from naming.composition import drawn

    entries = {e.id: e for e in composition(seed)}
    found = {}
    for key, given in answers.items():
        t = truth.get(key)
        if not t or t["condition"] not in ("single", "pair") or is_right(given, t) or "effects" not in given:
            continue
        if not {*t["effects"]} <= {e["name"] for e in given["effects"]}:
            effects = [(e["name"], e["at"], e["values"]) for e in given["effects"]]
            found[key] = distance(drawn(entries[key]), t["effects"], effects)
    return found


def distance(case: Any, truth: Sequence[str], answer: Sequence[tuple[str, str, Any]]) -> float:
    """Return the refit distance from the hidden effects to those of the answer; NaN if no candidate exists."""
    from robustlab.dynamics import linear_plant_of, port_model
    from robustlab.identification.greybox.candidates import candidates, nuisance_parameters, stated_tolerances
    from robustlab.identification.greybox.effect_fit import FitPlan, Hypothesis, Problem, refit_distance
    from robustlab.identification.greybox.noise import first_noise, whitening
    from robustlab.identification.greybox.prepared_record import prepare

    plant = linear_plant_of(case.plant, "bench")
    ports, length = port_model(plant), case.record.n // WINDOWS
    problem = Problem(
        plant, [prepare(plant, ports, case.record, length)], nuisance_parameters(plant, stated_tolerances(plant, None))
    )
    pool, noise = candidates(plant, ports, problem.records), first_noise(problem)
    own = [[(c, start) for c in pool if c.effect.id == name for start in c.starts] for name in truth]
    fits = [
        problem.fit(Hypothesis(tuple(c for c, _ in chosen)), noise, _point(problem, chosen), plan=FitPlan(12))
        for chosen in itertools.islice(itertools.product(*own), MOST_STARTS)
    ]
    if not fits:
        return float("nan")
    true = min(fits, key=lambda f: f.cost)
    noise = whitening(problem, true)
    true = problem.fit(true.hypothesis, noise, true.z, true.starts, FitPlan(12))
    other = [(c, values) for name, place, values in answer for c in _alike(pool, name, place)]
    rival = problem.fit(Hypothesis(tuple(c for c, _ in other)), noise, _point(problem, other), true.starts, FitPlan(12))
    return refit_distance(problem, true, rival)


def _alike(pool: Iterable[Any], name: str, place: str) -> list[Any]:
    return [c for c in pool if c.effect.id == name and c.site.name == place][:1]


def _point(problem: Any, chosen: Sequence[tuple[Any, Any]]) -> Any:
    """Return standardised parameters: nominal ones at their values, effects at their start values."""
    return np.concatenate([np.zeros(len(problem.nuisances)), *(c.standardised(start) for c, start in chosen)])


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    made = commands.add_parser("make", help="write the data set")
    made.add_argument("folder", type=Path)
    made.add_argument("--seed", type=int, default=SEED)
    made.add_argument("--case", nargs="+", help="only these")
    run = commands.add_parser("answer", help="run a program on the data set")
    run.add_argument("folder", type=Path)
    run.add_argument("--program", choices=("robustlab", *PROGRAMS), default="robustlab")
    run.add_argument("--out", type=Path, required=True)
    run.add_argument("--minutes", type=float, default=float("inf"), help="start no case after this time")
    run.add_argument("--workers", type=int, default=2, help="cases at the same time, one thread each")
    judged = commands.add_parser("score", help="the table of all programs")
    judged.add_argument("folder", type=Path)
    judged.add_argument("answers", type=Path, nargs="+")
    judged.add_argument("--answered", action="store_true", help="only the cases that all programs answered")
    given = parser.parse_args(argv)
    if given.command == "make":
        print(f"{len(make(given.folder, given.seed, set(given.case) if given.case else None))} cases in {given.folder}")
    elif given.command == "answer":
        answer(given.folder, given.program, given.out, given.minutes, given.workers)
    else:
        _score(given.folder, given.answers, given.answered)


def _score(folder: Path, files: Sequence[Path], answered: bool) -> None:
    data = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    truth, read = data["cases"], [read_answers(path) for path in files]
    if answered:
        truth = {key: t for key, t in truth.items() if all(key in answers for _, answers in read)}
    programs = {name: (answers, apart(folder, truth, answers, data["seed"])) for name, answers in read}
    print(f"{len(truth)} cases, seed {data['seed']}")
    print(table(truth, programs))


if __name__ == "__main__":
    main()
