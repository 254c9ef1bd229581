"""Test every certificate on difficult random cases, judged in balls of 200 digits by independent code.

Families (`attack_cases`) for hinf, mixsyn, h2, ncf, robust_stability (margin), worst_case_gain (gain), mu, hinf_norm
and h2_norm (norm). The judge (`attack_verdicts`, `exact_loops`, `exact_delta`) imports nothing from robustlab.

False certificates are: an unstable loop of K and P; a loop whose norm (Hamiltonian in balls: all frequencies) or whose
gain at any frequency (P and K evaluated separately) exceeds gamma by 1e-3; an H2 norm off by 1e-3; a bracket of a norm
off by 1e-6; D, G that do not prove their bound; a Delta that is not singular to within 1e-8; a singular or unstable
Delta inside a proved ball; a gain above the proved one, or a lower bound that is not attained (1e-5). Crashes and hangs
(more CPU time than LIMIT) are listed separately.

Run a campaign in parts, which can be interrupted and restarted (cases in the file are skipped); function names select
cases::

    nice -n 10 python benchmarks/attack.py --seed 1 --first 0 --count 1000 --out attack-1.jsonl
    nice -n 10 python benchmarks/attack.py --seed 2 --first 0 --count 1000 --out attack-2.jsonl
    python benchmarks/attack.py --summary attack-1.jsonl attack-2.jsonl > benchmarks/results/attack.txt

One case with its full result: ``python benchmarks/attack.py --seed 1 --case 17``; its plant, in Python with
benchmarks/ on the path: ``attack_cases.make_case(1, 17).data``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import re
import resource
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from attack_cases import FAMILIES, FUNCTIONS, Case, make_case
from attack_verdicts import judge
from exact_delta import Part, assembled, count
from exact_loops import Model
from harness import append, heading, in_child, json_lines, limit_cpu, options, timed

# Limits of CPU time in s: of a call, after which it counts as hung, and of its judge.
LIMIT, JUDGE_LIMIT = 120, 300
Record = dict[str, Any]


def _rl_model(m: Model | None) -> Any:
    import robustlab as rl

    return None if m is None else rl.StateSpaceModel(*m[:4], dt=m.dt)


def _plain(m: Any) -> Model:
    return Model(np.array(m.A), np.array(m.B), np.array(m.C), np.array(m.D), m.dt)


def _blocks(parts: Iterable[Part]) -> list[Any]:
    import robustlab as rl

    made: list[Any] = []
    for k, p in enumerate(parts):
        if p.kind == "real":
            scale = None if p.below == 1 else rl.ParameterRange(0.0, 1.0, below=p.below)
            made.append(rl.RealScalar(f"d{k}", p.rows, scale))
        else:
            made.append(
                rl.FullBlock(f"d{k}", p.rows, p.cols) if p.kind == "full" else rl.ComplexScalar(f"d{k}", p.rows)
            )
    return made


def _delta(parts: tuple[Part, ...], values: Any) -> np.ndarray:
    """Delta from one value per block name."""
    delta = assembled(parts, np.zeros((1, count(parts))), 1.0)[0]
    row = col = 0
    for k, p in enumerate(parts):
        value = np.asarray(values.get(f"d{k}", 0.0), dtype=complex)
        if p.kind == "real" and np.real(value) < 0:
            value = value * p.below
        block = value if value.ndim == 2 else value * np.eye(p.rows, p.cols)
        delta[row : row + p.rows, col : col + p.cols] = block
        row, col = row + p.rows, col + p.cols
    return delta


def call(case: Case) -> Any:
    """Call the function on its case with default settings."""
    import robustlab as rl
    from robustlab.norms import h2_norm

    data = case.data
    if case.function in ("hinf", "h2"):
        return getattr(rl, case.function)(_rl_model(data["P"]), data["n_meas"], data["n_con"])
    if case.function == "mixsyn":
        return rl.mixsyn(*(_rl_model(data[k]) for k in ("G", "W1", "W2", "W3")))
    if case.function == "ncf":
        return rl.ncf(*(_rl_model(data[k]) for k in ("G", "W1", "W2")))
    if case.function == "mu":
        return rl.mu(data["matrix"], _blocks(data["parts"]))
    if case.function == "norm":
        G = _rl_model(data["G"])
        return rl.peak_gain(G), h2_norm(G)
    uncertain = rl.UncertainModel(_rl_model(data["M"]), _blocks(data["parts"]))
    return rl.robust_stability(uncertain) if case.function == "margin" else rl.peak_gain(uncertain)


def claim_of(case: Case, result: Any) -> dict[str, Any]:
    if case.function == "norm":
        norm, h2 = result
        claim = {key: getattr(norm, key) for key in ("lower", "upper", "frequency")}
        more = {"trusted": norm.status.trustworthy, "h2": h2.value, "h2_trusted": h2.status.trustworthy}
        return claim | more | {"status": f"{norm.status}, {h2.status}"}
    claim = {"status": str(result.status), "trusted": result.status.trustworthy}
    if case.function in ("hinf", "mixsyn", "h2", "ncf"):
        claim |= {"gamma": result.gamma, "K": _plain(result.K)}
        bound = getattr(result, "lower_bound", None)
        claim["lower_bound"] = bound.value if bound is not None and bound.proved else 0.0
        if case.function == "ncf":
            claim["K_shaped"] = _plain(result.K_shaped)
        return claim
    claim |= {"lower": result.lower, "upper": result.upper}
    if case.function == "mu":
        return claim | {key: np.array(getattr(result, key)) for key in ("delta", "D", "D_z", "G")}
    claim |= {"delta": _delta(case.data["parts"], result.delta), "frequency": result.frequency}
    pieces = [p for p in result.proof if hasattr(p, "members")]  # else regions of branch and bound
    claim["pieces"] = [(p.members, p.low, p.high, p.beta, p.bound.Dw, p.bound.Dz, p.bound.G) for p in pieces]
    return claim


def run_case(case: Case, between: Any = None) -> Record:
    """Call and judge one case; ``between`` is called between the two."""
    record: Record = {"seed": case.seed, "index": case.index, "function": case.function, "family": case.family}
    model = case.model
    record["size"] = len(case.data["matrix"]) if model is None else len(model.A)
    record["discrete"] = model is not None and model.dt > 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        (claim, words), record["cpu"] = timed(_claim_or_reason, case)
        if claim is None:
            return record | words
        if between is not None:
            between(record)
        rng = np.random.default_rng(np.random.SeedSequence(case.seed, spawn_key=(case.index, 1)))
        with np.errstate(all="ignore"):
            findings, record["judge_cpu"] = timed(judge, case, claim, rng)
    record |= {"status": claim["status"], "findings": findings}
    record["figures"] = {k: claim[k] for k in ("gamma", "lower", "upper", "h2") if k in claim}
    false = any(f.startswith("FALSE") for f in findings)
    record["outcome"] = "false" if false else "held" if claim["trusted"] else "not certified"
    return record


def _claim_or_reason(case: Case) -> tuple[dict[str, Any] | None, Record]:
    """Return the claim, or None and the reason."""
    from robustlab.errors import RobustlabError

    try:
        return claim_of(case, call(case)), {}
    except RobustlabError as error:
        return None, {"outcome": "refused", "message": str(error).splitlines()[0], "kind": type(error).__name__}
    except Exception as error:  # noqa: BLE001 - stored as a crash; the campaign continues
        frames = traceback.extract_tb(error.__traceback__)
        inside = [f for f in frames if "robustlab/" in f.filename] or frames
        at = f"{Path(inside[-1].filename).name}:{inside[-1].lineno}"
        return None, {"outcome": "crash", "message": f"{type(error).__name__} {error} ({at})"}


def in_this_process(seed: int, index: int, limit: int) -> Record:
    """Run one case with limits of CPU time; print the record once before the judge starts."""

    def judging(record: Record) -> None:
        print(json.dumps(record | {"outcome": "judge failed", "message": "ended"}, default=float), flush=True)
        limit_cpu(JUDGE_LIMIT)

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    limit_cpu(limit)
    try:
        return run_case(make_case(seed, index), judging)
    except Exception as error:  # noqa: BLE001 - an error of the judge is not an error of the function
        return {"outcome": "judge failed", "message": "".join(traceback.format_exception(error)[-4:])}


def attack(seed: int, first: int, number: int, out: Path, only: tuple[str, ...] = (), limit: int = LIMIT) -> None:
    """Run cases first .. first + number - 1 of a seed that are not in the file yet; append a line for each.

    Each has its own process: the kernel ends a call that exceeds its limit of CPU time.
    """
    known = {(r["seed"], r["index"]) for r in read([out])}
    for index in range(first, first + number):
        function = FUNCTIONS[index % len(FUNCTIONS)]
        if (seed, index) in known or (only and function not in only):
            continue
        command = [__file__, "--seed", str(seed), "--case", str(index), "--limit", str(limit)]
        record = in_child(command, "", limit, wall=20 * (limit + JUDGE_LIMIT))  # asleep: no CPU time, no answer
        if "refused" in record:
            record = {"outcome": "hang" if record["refused"] == "no return" else "crash", "message": record["refused"]}
        family = FAMILIES[index // len(FUNCTIONS) % len(FAMILIES)]
        record = {"seed": seed, "index": index, "function": function, "family": family} | record
        append(out, record)
        if record["outcome"] not in ("held", "refused", "not certified"):
            print(line_of(record), flush=True)


def read(files: Iterable[Path]) -> list[Record]:
    """Return the records of all files; of a repeated case the last one."""
    return list({(r["seed"], r["index"]): r for r in json_lines(files)}.values())


def line_of(record: Record) -> str:
    """Return one line about a case, and a line for each finding."""
    head = "seed {seed} case {index}: {function}, {family}: {outcome}".format(**record)
    lines = [head + (f": {record['message']}" if record.get("message") else "")]
    return "\n".join([*lines, *(f"    {f}" for f in record.get("findings", []))])


OUTCOMES = ("held", "not certified", "refused", "false", "crash", "hang", "judge failed")


def summary(records: list[Record]) -> str:
    """Return the table of a campaign, all false, crashed or hung cases, and the refusals by kind."""
    rows = [f"{'':28s}{'cases':>7s}" + "".join(f"{o:>15s}" for o in OUTCOMES) + f"{'CPU s':>9s}"]

    def row(name: str, chosen: list[Record]) -> str:
        number = Counter(r["outcome"] for r in chosen)
        cpu = sum(r.get("cpu", 0.0) for r in chosen) / max(len(chosen), 1)
        return f"{name:28s}{len(chosen):7d}" + "".join(f"{number[o]:15d}" for o in OUTCOMES) + f"{cpu:9.2f}"

    for key, names in (("function", FUNCTIONS), ("family", FAMILIES)):
        rows += [row(name, [r for r in records if r[key] == name]) for name in names] + [""]
    rows += [row("all", records), "", "CPU s: mean of the calls, the judge on top.", ""]
    seeds = sorted({r["seed"] for r in records})
    discrete = sum(bool(r.get("discrete")) for r in records)
    rows.append(f"seeds {', '.join(map(str, seeds))}; {discrete} discrete")
    titles = {"False certificates": "false", "Crashes": "crash", "Hangs": "hang"}
    for title, outcome in {**titles, "Cases without a judgement": "judge failed"}.items():
        listed = [line_of(r) for r in records if r["outcome"] == outcome]
        rows += ["", f"{title}: {len(listed)}", *listed]
    kinds = Counter(f"{r['function']}: {_kind(r['message'])}" for r in records if r["outcome"] == "refused")
    rows += ["", "Refusals by kind:", *(f"{number:6d}  {kind}" for kind, number in kinds.most_common())]
    notes = Counter(f"{r['function']}: {_kind(f)}" for r in records for f in r.get("findings", []) if f[:4] == "note")
    rows += ["", "Notes:", *(f"{number:6d}  {note}" for note, number in notes.most_common())]
    return "\n".join(rows)


def _kind(text: str) -> str:
    """Return a message without its numbers and names of states."""
    text = re.sub(r"(?<![A-Za-z])[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?j?|\binf\b|\bnan\b", "#", text)
    return re.sub(r"(#[^a-zA-Z(]*){2,}", "# ", text)[:150]


def main() -> int:
    """Run the command line; exit code 1 if a certificate is false."""
    given = options(__doc__, "*", seed=1, first=0, count=80, out="attack.jsonl", case=-1, limit=LIMIT, summary=False)
    if given.summary:
        records = read([Path(name) for name in given.names])
        print(heading("robustlab", "numpy", "scipy", "slycot", "python-flint") + "\n\n" + summary(records))
        return int(any(r["outcome"] == "false" for r in records))
    if given.case >= 0:
        record = in_this_process(given.seed, given.case, given.limit)
        print(json.dumps(record, default=float))
        return int(record["outcome"] == "false")
    attack(given.seed, given.first, given.count, Path(given.out), tuple(given.names), given.limit)
    return 0


if __name__ == "__main__":
    sys.exit(main())
