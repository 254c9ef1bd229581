"""The figures of the naming bench from its lines, each beside what it is to reach.

What counts. A case that was refused, failed, crashed or ran out of time is a wrong answer everywhere. The *first name*
is the first of the named effects, "none" under the verdict "no missing effect", "unknown" under the verdict "unknown"
(also where something was named besides). The *answer set* is the named effects and their rivals, "none" and its
rivals under "no missing effect". *Exactly one name* is an answer set of one under a verdict other than "unknown";
"none" is such a name, too. Names are compared by id: nothing that behaves alike counts as alike.
"""

from __future__ import annotations

import platform
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from importlib import metadata
from typing import Any

import numpy as np

__all__ = ["answer", "first_name", "report", "wilson"]

Line = dict[str, Any]
Row = tuple[str, str, str, str]  # figure, value, counts, against its bar

# A refit of a linear model's own parameters can stand for these; all others count as structural.
LINEAR = ("inertia", "viscous-friction", "torque-constant", "resistance", "input-gain", "sensor-gain")
VERSIONS = ("robustlab", "numpy", "scipy", "numba", "pysindy")
RIG_SENSORS = ("phi", "i")


def report(lines: Sequence[Line]) -> str:
    """All figures of the lines as text."""
    ours = [line for line in lines if line["who"] == "robustlab"]
    peers = [line for line in lines if line["who"] == "pysindy"]
    parts = [_heading(lines)]
    for condition in dict.fromkeys(line["condition"] for line in ours):
        parts.append(_condition(condition, [line for line in ours if line["condition"] == condition]))
    if peers:
        parts.append(_peer(peers, ours))
    lost = [line for line in lines if line["status"] != "ok" or "after_error" in line]
    if lost:
        rows = (f"  {line['key']}: {line['status']}: {_last(line)}" for line in lost)
        parts.append("\n".join(["refused, failed, crashed, timed out:", *rows]))
    return "\n\n".join(parts)


def _heading(lines: Sequence[Line]) -> str:
    import os

    versions = ", ".join(f"{name} {v}" for name in VERSIONS if (v := _version(name)))
    revisions = sorted({line.get("revision", "unknown") for line in lines})
    seeds = sorted({line["seed"] for line in lines})
    return (
        f"# date {time.strftime('%Y-%m-%d')}, {os.cpu_count()} cores, {platform.machine()} {platform.system()}, "
        f"Python {platform.python_version()}, {versions}\n"
        f"# revision {', '.join(revisions)}; {len(lines)} cases; seeds {', '.join(map(str, seeds))}\n"
        "# [95 % interval of Wilson]; what was refused, failed or crashed counts as wrong"
    )


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _last(line: Line) -> str:
    text = (line.get("error") or line.get("after_error") or "").strip()
    return text.splitlines()[-1] if text else ""


# --- what a line answers ---------------------------------------------------------------------------------------------


def truth(line: Line) -> str:
    """Name of the hidden effect (the first of several), or "none"."""
    return line["truth"][0] if line["truth"] else "none"


def first_name(line: Line) -> str:
    """The first name of an answer; its status where there is none."""
    if line.get("status", "ok") != "ok":
        return f"({line['status']})"
    if line["verdict"] == "no missing effect":
        return "none"
    return line["names"][0] if line["names"] and line["verdict"] != "unknown" else "unknown"


def answer(line: Line) -> tuple[str, ...]:
    """The answer set; empty for a case that was lost or is unknown without any name."""
    if line.get("status", "ok") != "ok":
        return ()
    return ("none", *line["answer"]) if line["verdict"] == "no missing effect" else tuple(line["answer"])


def _one_name(line: Line) -> bool:
    return len(answer(line)) == 1 and line["verdict"] != "unknown"


def _final(line: Line) -> Line:
    """The answer with the next experiment, where there is one."""
    if "after" in line:
        return line["after"]
    return {"status": "failed"} if "after_error" in line else line


# --- rows ------------------------------------------------------------------------------------------------------------


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share, after Wilson (1927)."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / n
    centre, spread = p + z**2 / (2 * n), z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return float((centre - spread) / (1 + z**2 / n)), float((centre + spread) / (1 + z**2 / n))


def _judged(value: float, bar: tuple[str, float] | None) -> str:
    if bar is None:
        return ""
    good = value >= bar[1] if bar[0] == ">=" else value <= bar[1]
    return f"{bar[0]} {bar[1]:g}  {'no case' if np.isnan(value) else 'pass' if good else 'MISS'}"


def _share(name: str, hits: Iterable[bool], bar: tuple[str, float] | None = None) -> Row:
    found = list(hits)
    k, n = sum(found), len(found)
    value = k / n if n else np.nan
    low, high = wilson(k, n)
    if n == 0:
        return name, "-", "0/0", _judged(value, bar)
    return name, f"{value:.3f}", f"{k}/{n} [{low:.2f}, {high:.2f}]", _judged(value, bar)


def _number(name: str, values: Iterable[float], bar: tuple[str, float] | None = None, at: float = 50.0) -> Row:
    found = [v for v in values if np.isfinite(v)]
    value = float(np.percentile(found, at)) if found else np.nan
    return name, f"{value:.3g}" if found else "-", f"n {len(found)}", _judged(value, bar)


def _condition(name: str, lines: Sequence[Line]) -> str:
    """One block: the counts, the figures, the confusion matrix."""
    kind = lines[0]["kind"]
    rows: list[Row] = {"single": _single, "poor": _poor, "none": _none, "outside": _outside, "pairs": _pairs}[kind](
        lines
    )
    rows += _errors(lines, kind) + _times(lines)
    lost = Counter(line["status"] for line in lines if line["status"] != "ok")
    seeds = len({line["seed"] for line in lines})
    classes = len({tuple(line["truth"]) for line in lines})
    setups = list(dict.fromkeys((line["noise"], line["excitation"], line["current"]) for line in lines))
    noise, excitation, current = setups[0]
    how = f"{noise} noise, {excitation}, {'encoder + current' if current else 'encoder only'}"
    if len(setups) > 1:
        how = f"{len(setups)} ways to measure (a seed is one machine in all of them)"
    said = "".join(f", {k} {status}" for status, k in lost.items())
    head = f"== {name}: {kind}; {how}; {classes} classes, {seeds} seeds, n = {len(lines)}{said}"
    table = [f"  {what:62} {value:>6}  {counts:26} {bar}".rstrip() for what, value, counts, bar in rows]
    return "\n".join([head, *table, "", _confusion(lines)])


def _single(lines: Sequence[Line]) -> list[Row]:
    first = lines[0]
    main = (first["noise"], first["excitation"], first["current"]) == ("mid", "rich", False)

    def bar(sign: str, value: float) -> tuple[str, float] | None:
        return (sign, value) if main else None

    return [
        _share("top-1", (first_name(x) == truth(x) for x in lines), bar(">=", 0.93)),
        _share("true name in the answer set", (truth(x) in answer(x) for x in lines), bar(">=", 0.98)),
        _mean_size(lines, bar("<=", 1.4)),
        *_one(lines),
        _share("nothing missing, but an effect named", (bool(x.get("names")) for x in lines if not x["truth"])),
        _share(
            "verdict unknown although it is in the catalogue",
            (x.get("verdict") == "unknown" for x in lines if x["truth"]),
        ),
    ]


def _mean_size(lines: Sequence[Line], bar: tuple[str, float] | None) -> Row:
    sizes = [max(len(answer(x)), 1) for x in lines if x["status"] == "ok"]
    value = float(np.mean(sizes)) if sizes else np.nan
    return (
        "mean size of the answer set (unknown counts as 1)",
        f"{value:.2f}",
        f"largest {max(sizes, default=0)}",
        _judged(value, bar),
    )


def _one(lines: Sequence[Line]) -> list[Row]:
    sure = [x for x in lines if _one_name(x)]
    named = [x for x in sure if x["names"]]
    return [
        _share("exactly one name given (none is one, too)", (_one_name(x) for x in lines)),
        _share("  of these right", (answer(x) == (truth(x),) for x in sure), (">=", 0.98)),
        _share("  of those that name an effect, right", (answer(x) == (truth(x),) for x in named)),
    ]


def _none(lines: Sequence[Line]) -> list[Row]:
    return [
        _share("named as an effect", (bool(x.get("names")) for x in lines), ("<=", 0.02)),
        _share("verdict no missing effect", (first_name(x) == "none" for x in lines)),
        _share("verdict unknown", (x.get("verdict") == "unknown" for x in lines)),
    ]


def _outside(lines: Sequence[Line]) -> list[Row]:
    flagged = [x["status"] == "ok" and (x["verdict"] == "unknown" or not x["complete"]) for x in lines]
    return [
        _share("unknown, or flagged incomplete", flagged, (">=", 0.95)),
        _share("  verdict unknown", (x.get("verdict") == "unknown" for x in lines)),
        _share(
            "  an effect named as if it were all",
            (not f and bool(x.get("names")) for f, x in zip(flagged, lines, strict=True)),
        ),
        _share("  no missing effect", (first_name(x) == "none" for x in lines)),
    ]


def _pairs(lines: Sequence[Line]) -> list[Row]:
    named = [set(x.get("names", ())) for x in lines]
    both = [set(x["truth"]) <= names for x, names in zip(lines, named, strict=True)]
    third = [bool(names - set(x["truth"])) for x, names in zip(lines, named, strict=True)]
    return [
        _share("both named and no third", (b and not t for b, t in zip(both, third, strict=True)), (">=", 0.8)),
        _share("  both named", both),
        _share("  something named that is not there", third),
        _share("  both in the answer set", (set(x["truth"]) <= set(answer(x)) for x in lines)),
        _share("  first name one of the two", (first_name(x) in x["truth"] for x in lines)),
    ]


def _poor(lines: Sequence[Line]) -> list[Row]:
    # Open: the record alone did not settle on one name, be it for rivals or for a verdict "unknown".
    unsettled = [x for x in lines if x["status"] == "ok" and not _one_name(x)]
    tried = [x for x in lines if "experiment" in x]
    foreign = [x for x in tried if not set(x["experiment"]["sensors"]) <= set(RIG_SENSORS)]

    def alone(x: Line) -> bool:
        final = _final(x)
        return first_name(final) == truth(x) and len(final["names"]) <= 1

    return [
        _share("true name in the answer set", (truth(x) in answer(x) for x in lines), (">=", 0.97)),
        _share("top-1", (first_name(x) == truth(x) for x in lines)),
        _mean_size(lines, None),
        *_one(lines),
        _share("left open by the record", (x in unsettled for x in lines)),
        _share("  of these an experiment was proposed", ("experiment" in x for x in unsettled)),
        _share(
            "  of these named after it (the truth, nothing else)",
            ("after" in x and alone(x) for x in unsettled),
            (">=", 0.9),
        ),
        _share(
            "  of these the answer set is the truth alone",
            ("after" in x and answer(x["after"]) == (truth(x),) for x in unsettled),
        ),
        _share("all cases, at the end: the truth named, nothing else", (alone(x) for x in lines)),
        _share("proposals that ask for a sensor the rig has not", (x in foreign for x in tried)),
    ]


def _errors(lines: Sequence[Line], kind: str) -> list[Row]:
    """Held-out errors: of the updated model over that of the true machine; of the linear refit over the updated one."""
    there = [x for x in lines if x["status"] == "ok"]
    own = kind in ("single", "pairs", "poor")
    hidden = [x for x in there if x["truth"]] if own else there
    structural = [x for x in hidden if own and not set(x["truth"]) <= set(LINEAR)]
    shrunk = (">=", 10.0) if lines[0]["noise"] == "mid" and kind in ("single", "pairs") else None
    ratio = ("<=", 1.1) if own else None
    return [
        _number("held-out error, updated / true machine, median", _ratios(hidden, "gap_after", "true_error"), ratio),
        _number("  90 % of the cases below", _ratios(hidden, "gap_after", "true_error"), at=90.0),
        _number(
            "held-out error, refitted linear / updated, median, structural",
            _ratios(structural, "gap_refitted", "gap_after"),
            shrunk,
        ),
        _number(
            "  refitted linear / true machine: what could be reached", _ratios(structural, "gap_refitted", "true_error")
        ),
    ]


def _ratios(lines: Iterable[Line], over: str, under: str) -> list[float]:
    return [x[over] / x[under] for x in lines if x[over] is not None and x[under]]


def _times(lines: Sequence[Line]) -> list[Row]:
    there = [x for x in lines if x["status"] == "ok"]
    return [
        _number("CPU s a case, median", (x["cpu_s"] for x in there), ("<=", 10.0)),
        _number("  90 % of the cases below", (x["cpu_s"] for x in there), ("<=", 10.0), at=90.0),
        _number("  wall s a case, median (of a machine with other work)", (x["wall_s"] for x in there)),
    ]


def _confusion(lines: Sequence[Line]) -> str:
    """True name by row, first name by column; the columns carry the numbers of the rows."""
    label: Callable[[Line], str] = lambda x: "+".join(x["truth"]) or "none"  # noqa: E731
    rows = list(dict.fromkeys(label(x) for x in lines))
    named = Counter((label(x), first_name(x)) for x in lines)
    columns = [*rows, *dict.fromkeys(n for _, n in named if n not in rows)]
    shown = [c for c in columns if any(named[r, c] for r in rows)]
    numbers = {name: k for k, name in enumerate(columns, 1)}
    out = ["  true (row) x first name (column)" + " " * 17 + "".join(f"{numbers[c]:4d}" for c in shown)]
    for r in rows:
        cells = "".join(f"{named[r, c] or '.':>4}" for c in shown)
        out.append(f"  {numbers[r]:3d} {r:44.44}{cells}")
    extra = [f"{numbers[c]} {c}" for c in columns if c not in rows]
    return "\n".join([*out, *([f"  further columns: {', '.join(extra)}"] if extra else [])])


# --- the peer --------------------------------------------------------------------------------------------------------


def _peer(peers: Sequence[Line], ours: Sequence[Line]) -> str:
    """PySINDy on the same cases, with the smoothing window that is best for it in hindsight, condition by condition."""
    heads = ("n", "window", "top-1", "robustlab", "true chosen", "mean terms", "CPU s")
    out = [
        "== peer: PySINDy STLSQ on the torque residual, same cases; smoothing window best in hindsight",
        "  (* wrong parameters ranked behind all other terms); names that look alike count as right",
        f"  {'':18}" + "".join(f"{head:>12}" for head in heads),
    ]
    for condition in dict.fromkeys(line["condition"] for line in peers):
        lines = [line for line in peers if line["condition"] == condition]
        kind = lines[0]["kind"]
        if kind == "outside":
            out.append(f"  {condition:18}{len(lines):>12}  names a term or none, never unknown")
            continue
        windows = list(next((x["by_window"] for x in lines if x["status"] == "ok"), {}))
        if not windows:
            out.append(f"  {condition:18}{len(lines):>12}  none ran: {_last(lines[0])}")
            continue
        hits = {w: [bool(_meant(_peer_first(x, w)) & set(x["truth"] or ["none"])) for x in lines] for w in windows}
        best = max(windows, key=lambda w: sum(hits[w]))
        chosen = [x["by_window"][best] if x["status"] == "ok" else [] for x in lines]
        there = [
            set(x["truth"]) <= _meant(*names) if x["truth"] else not names
            for x, names in zip(lines, chosen, strict=True)
        ]
        same = {line["key"].split(" | ", 1)[1] for line in lines}
        own = [x for x in ours if x["key"].split(" | ", 1)[1] in same]
        ours_right = np.mean([first_name(x) in (x["truth"] or ["none"]) for x in own]) if own else np.nan
        cpu = np.median([x["cpu_s"] for x in lines if x["status"] == "ok"])
        shares = (np.mean(hits[best]), ours_right, np.mean(there))
        cells = [
            len(lines),
            best,
            *(f"{v:.3f}" for v in shares),
            f"{np.mean([len(c) for c in chosen]):.1f}",
            f"{cpu:.2f}",
        ]
        out.append(f"  {condition:18}" + "".join(f"{cell:>12}" for cell in cells))
    return "\n".join(out)


def _meant(*names: str) -> set[str]:
    """The ids of names like "resistance or inertia"."""
    return {part for name in names for part in name.split(" or ")}


def _peer_first(line: Line, window: str) -> str:
    if line["status"] != "ok":
        return f"({line['status']})"
    names = line["by_window"][window]
    return names[0] if names else "none"
