"""Compare results with the recorded ones: ``python tests/characterisation [SUBJECT ...] [OPTIONS]``.

Without options the fast cases run, and a table is printed: subject, cases, equal, different, CPU s. ``--all`` includes
the slow ones. ``--record`` stores the results of the cases that run. ``--noise``, best with
OPENBLAS_CORETYPE=Nehalem and another number of threads, stores the change of a number by rounding if it exceeds its
tolerance; three times this change is the new tolerance.
"""

import argparse
import os
import sys
import warnings
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
TESTS = Path(__file__).resolve().parents[1]
sys.path[:1] = [str(TESTS), str(TESTS.parent / "benchmarks")]

from characterisation import cases as c  # noqa: E402


def moved_by(old: Any, new: Any) -> float:
    """Return the relative distance of two numbers; of two brackets that of their upper ends."""
    old, new = (x[1] if isinstance(x, tuple) else float(x) for x in (old, new))
    return float(f"{abs(old - new) / max(abs(old), abs(new)):.2g}")


def main() -> int:
    """Return 1 if a case differs, else 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("subjects", nargs="*", default=c.SUBJECTS)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--case", action="append", default=[])
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--record", action="store_true")
    what.add_argument("--noise", action="store_true")
    args = parser.parse_args()
    rows = [f"{'subject':16s}{'cases':>7s}{'equal':>7s}{'different':>11s}{'CPU s':>8s}"]
    changes: list[str] = []
    for subject in args.subjects:
        equal, spent, count = 0, 0.0, 0
        for name, case in c.cases_of(subject).items():
            if (case.slow and not args.all) or (args.case and not any(word in name for word in args.case)):
                continue
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    found, cpu = c.answer(case)
                except Exception as error:  # noqa: BLE001  a failure counts as a difference
                    found, cpu = {"": f"{type(error).__name__}: {error}"}, 0.0
            spent, count = spent + cpu, count + 1
            entry = c.entry_of(case, found, cpu) if args.record else c.stored(subject).get(name, {"answer": {"": 0}})
            wrong = c.differences(subject, entry, found)
            if args.noise and (
                moved := {k: moved_by(*pair) for k, pair in wrong.items() if not isinstance(pair[1], str)}
            ):
                entry["noise"] = entry.get("noise", {}) | moved
            if args.record or args.noise:  # read again: another process may record other cases
                c.store(subject, c.stored(subject) | {name: entry})
            equal += not wrong
            changes += [f"{subject}: {name}: {k}: {old} -> {new}"[:300] for k, (old, new) in list(wrong.items())[:6]]
            print(f"{subject}: {name}: {cpu} s", file=sys.stderr, flush=True)
        rows.append(f"{subject:16s}{count:7d}{equal:7d}{count - equal:11d}{spent:8.1f}")
    print("\n".join([*rows, *changes]))
    return int(any(changes))


if __name__ == "__main__":
    sys.exit(main())
