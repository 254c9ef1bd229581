"""Test the checker `robustlab.verification.checker.check` with mutants of true claims; judge every decision.

    python benchmarks/verify_attack.py --mutants 100000 --seed 1 [--minutes M] [--workers N] [--keep FOLDER] [KIND ...]

`verify_claims` makes true claims of every kind (models of 0 to 4 states, some 8) with the library's own
evidence, `verify_mutants` changes them, `verify_judge` judges what was proved or refuted in rationals and balls,
independently of the checker. Undecided claims need no judge. Errors are:

false         proved despite a known counterexample; or refuted although true in rationals
unjustified   proved without sufficient evidence: a gap, a wrong structure, a form that is not definite
unconfirmed   a Delta was proved to exist, or to refute, and Newton's method in balls did not find it
crash         an exception out of `check`

A piece of work is a chunk of about a thousand mutants; chunk c of a seed needs no other one. Results go to
benchmarks/results/verify_attack.txt. Claims about delays, multipliers and schedules are not in it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pickle
import sys
import time
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from harness import heading, options
from verify_claims import MAKERS
from verify_judge import judge
from verify_mutants import mutant

import robustlab as rl
from robustlab.verification import Claim, Outcome, check

RESULTS = Path(__file__).parent / "results" / "verify_attack.txt"
EFFORT = 400  # units of work that a check may take
EACH = 40  # mutants of a claim
# Claims of each kind in a chunk: those whose proofs have more parts more often.
PLAN = {
    "stable": 1, "norm": 3, "bounded-real": 2, "loop-norm": 3, "difference-norm": 2, "gramian": 2, "mu-upper": 4,
    "mu-upper-boxes": 3, "mu-lower": 3, "mu-axis": 4, "mu-boxes": 4, "worst-gain": 4, "worst-gain-boxes": 3,
    "unstable-member": 3, "set": 2,
}  # fmt: skip
COLUMNS = ("mutants", "proved", "refuted", "not proved", "false accepted", "unjustified", "false refuted",
           "unconfirmed", "crash", "judge failed")  # fmt: skip
WRONG = COLUMNS[4:9]
Row = tuple[str, str, str, float]  # kind, answer, what is wrong, seconds


def answers(seed: int, chunk: int, keep: Path | None = None, kinds: Sequence[str] = tuple(PLAN)) -> Iterator[Row]:
    """Yield all claims of a chunk, the true ones first, each with its answer and the judge's result."""
    rng, pool = np.random.default_rng([seed, chunk]), {}
    plan = [kind for kind, count in PLAN.items() for _ in range(count) if kind in kinds]
    for kind in rng.permutation(plan).tolist():
        try:
            case = MAKERS[kind](rng)
        except (rl.RobustlabError, ValueError, ArithmeticError, np.linalg.LinAlgError):
            case = None
        if case is None:
            continue
        other = pool.get(kind, case.numbers)
        pool[kind] = case.numbers
        for i in range(EACH + 1):
            change, new, numbers = (
                ("unchanged", kind, case.numbers) if i == 0 else mutant(rng, kind, case.numbers, other)
            )
            start = time.perf_counter()
            answer, wrong, text = checked(new, numbers, case.hints)
            if wrong:
                print(f"seed {seed}, chunk {chunk}: {new}, {change}: {answer}, {wrong}: {text}", flush=True)
                if keep is not None:
                    name = keep / f"{wrong.replace(' ', '-')}-{new}-{seed}-{chunk}-{i}-{kind}.pickle"
                    name.write_bytes(pickle.dumps((new, numbers, case.hints, change, text)))
            yield new, answer, wrong, time.perf_counter() - start


def checked(kind: str, numbers: dict[str, Any], hints: tuple[Any, ...]) -> tuple[str, str, str]:
    """Return the checker's answer, its error as a column of `COLUMNS` or "", and the judge's text."""
    try:
        found = check(Claim(kind, numbers), effort=EFFORT)
    except Exception:  # noqa: BLE001  an exception of `check` is an error
        return "crash", "crash", traceback.format_exc()
    if found.outcome is Outcome.NOT_PROVED:
        return "not proved", "", ""
    proved = found.outcome is Outcome.PROVED
    answer = "proved" if proved else "refuted"
    try:
        text = judge(kind, numbers, proved, hints)
    except Exception:  # noqa: BLE001  counted as a failed judge
        return answer, "judge failed", traceback.format_exc()
    if not text:
        return answer, "", ""
    word = text.partition(":")[0]
    return answer, (("false accepted" if proved else "false refuted") if word == "false" else word), text


def chunk_of(task: tuple[int, int, Path | None, Sequence[str]]) -> list[Row]:
    warnings.simplefilter("ignore")
    return list(answers(*task))


def campaign(given: Any) -> tuple[dict[str, Counter[str]], float]:
    """Return counts by kind, and the time in s."""
    start, done, reported = time.perf_counter(), 0, 0
    counts: dict[str, Counter[str]] = defaultdict(Counter, {kind: Counter() for kind in PLAN})
    tasks = (
        (given.seed, c, Path(given.keep) if given.keep else None, given.names or tuple(PLAN))
        for c in range(given.first, sys.maxsize)
    )
    with get_context("spawn").Pool(given.workers) if given.workers > 1 else nullcontext() as pool:
        for rows in pool.imap(chunk_of, tasks) if pool else map(chunk_of, tasks):
            for kind, answer, wrong, _ in rows:
                counts[kind].update({"mutants", answer, wrong} - {""})
            done += len(rows)
            spent = time.perf_counter() - start
            if done // 10000 > reported:
                reported = done // 10000
                print(f"{done} mutants, {done / spent:.0f} a second", flush=True)
            if done >= given.mutants or (given.minutes and spent > 60 * given.minutes):
                break
    return counts, time.perf_counter() - start


def table(counts: dict[str, Counter[str]]) -> list[str]:
    lines = [f"{'':17s}" + "".join(f"{word:>15s}" for word in COLUMNS)]
    total: Counter[str] = Counter()
    for kind, count in counts.items():
        total.update(count)
        lines.append(f"{kind:17s}" + "".join(f"{count[word]:15d}" for word in COLUMNS))
    return [*lines, f"{'all':17s}" + "".join(f"{total[word]:15d}" for word in COLUMNS)]


def main() -> int:
    """Run, print and write; 1 where something wrong was found in a checker without planted faults."""
    given = options(__doc__, list(PLAN), mutants=100_000, seed=1, first=0, minutes=0.0, workers=1, keep="")
    counts, seconds = campaign(given)
    done = sum(c["mutants"] for c in counts.values())
    lines = [heading("numpy", "python-flint"),
             f"# {done} claims in {seconds / 60:.1f} min, {done / seconds:.0f} a second", *table(counts)]  # fmt: skip
    print("\n".join(lines))
    if not given.names:
        RESULTS.write_text("\n".join(lines) + "\n")
    return int(any(count[word] for count in counts.values() for word in WRONG))


if __name__ == "__main__":
    sys.exit(main())
