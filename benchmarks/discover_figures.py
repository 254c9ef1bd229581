"""The figures of the naming bench from its lines, each beside what it is to reach.

What counts. A case that was refused, failed, crashed or ran out of time is a wrong answer everywhere. *Named* is the
verdict "named"; it is right where its names are exactly the hidden ones: no fewer, no more, no exact twin alone; where
it leaves the form of a kind open, the hidden effect has to be of that kind. The
*best set* is the first of the posterior ("none" where it is empty), nothing under the verdict "unknown". Top-1 takes a
best set for the hidden one that no record of the family can tell from it (`hidden.told`), and calibration does
not: two twins have to share their probability. The *answer* is all names of the collection, "none" where nothing may be
missing. Everywhere an uneven Coulomb friction and an even one with a constant load are one and the same.
"""

from __future__ import annotations

import platform
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from importlib import metadata
from typing import Any

import numpy as np
from hidden import ANYWHERE, FAMILIES, told

from robustlab.dynamics.effects.kinds import KIND_OF, upwards

__all__ = ["answer", "best_set", "is_right", "report", "wilson"]

Line = dict[str, Any]
Row = tuple[str, str, str, str]  # figure, value, counts, against its bar
Test = Callable[[Line], bool]

VERSIONS = ("robustlab", "numpy", "scipy", "numba", "pysindy")
RICH = ("single", "single-continuous")
ENOUGH = 20  # cases of a decile of the calibration; half of it for an effect's intervals


def report(lines: Sequence[Line]) -> str:
    """All figures of the lines as text."""
    ours = [line for line in lines if line["who"] == "robustlab"]
    peers = [line for line in lines if line["who"] == "pysindy"]
    parts = [_heading(lines)]
    if ours:
        parts += [_table("== bars", _bars(ours)), _table("== calibration of the best set", _calibration(ours))]
        parts += [_table("== 95 % intervals that hold the truth", _intervals(ours)), _by_family(ours)]
        parts.append(_failures(ours))
    if peers:
        parts.append(_peer(peers, ours))
    lost = [line for line in lines if line["status"] != "ok" or "after_error" in line or "true_error_failed" in line]
    if lost:
        rows = (f"  {line['key']}: {line['status']}: {_last(line)}" for line in lost)
        parts.append("\n".join(["refused, failed, crashed, timed out:", *rows]))
    return "\n\n".join(parts)


def _heading(lines: Sequence[Line]) -> str:
    import os

    versions = ", ".join(f"{name} {v}" for name in VERSIONS if (v := _version(name)))
    revisions = sorted({line.get("revision", "unknown") for line in lines})
    seeds = sorted({line["seed"] for line in lines})
    counts = Counter(line["condition"] for line in lines)
    return (
        f"# date {time.strftime('%Y-%m-%d')}, {os.cpu_count()} cores, {platform.machine()} {platform.system()}, "
        f"Python {platform.python_version()}, {versions}\n"
        f"# revision {', '.join(revisions)}; {len(lines)} cases; seeds {', '.join(map(str, seeds))}\n"
        f"# {', '.join(f'{name} {n}' for name, n in counts.items())}\n"
        "# [95 % interval of Wilson]; what was refused, failed or crashed counts as wrong"
    )


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _last(line: Line) -> str:
    text = (line.get("error") or line.get("after_error") or line.get("true_error_failed") or "").strip()
    return text.splitlines()[-1] if text else ""


# --- what a line answers ---------------------------------------------------------------------------------------------


def answer(line: Line) -> frozenset[str]:
    """All names that may be true, "none" among them; empty for a case that was lost."""
    if line["status"] != "ok":
        return frozenset()
    empty = line["verdict"] == "no missing effect" or any(not names for names, *_ in _collection(line))
    return frozenset([*line["answer"], *(["none"] if empty else [])])


def _collection(line: Line) -> list[tuple[list[str], float, str]]:
    """The smallest sets of the posterior with 95 % of the probability."""
    total, found = 0.0, []
    for entry in line["posterior"]:
        if total >= 0.95:
            break
        found.append(entry)
        total += entry[1]
    return found


def best_set(line: Line) -> frozenset[str] | None:
    """Names of the most probable set; None where there is no answer or the verdict is "unknown"."""
    if line["status"] != "ok" or line["verdict"] == "unknown":
        return None
    if line["verdict"] == "no missing effect":
        return frozenset()
    return frozenset(line["posterior"][0][0] if line["posterior"] else line["names"])


def _named(line: Line) -> bool:
    return line["status"] == "ok" and line["verdict"] == "named"


def _same(names: Iterable[str], line: Line) -> bool:
    return told(ANYWHERE, names) == told(ANYWHERE, line["truth"])


def is_right(line: Line) -> bool:
    """Named, and exactly what is hidden, at the level that was told."""
    return _named(line) and (_same(line["names"], line) or _kinds_right(line))


def _kinds_right(line: Line) -> bool:
    """A hidden effect for each kind that was told, the very one where its form was told too, and none left over.

    After another formula than the catalogue's any member of its kind is right.
    """
    twins, left = FAMILIES[line["family"]].twins, list(line["truth"])
    for kind, _, _, member in line.get("kinds", ()):
        own = [
            name for name in left
            if name in KIND_OF
            and kind in [k.id for k in upwards(KIND_OF[name])]
            and (not member or line.get("laws") or told(twins, [name]) == told(twins, [member]))
        ]  # fmt: skip
        if not own:
            return False
        left.remove(own[0])
    return bool(line["truth"]) and not left


def _sure_and_wrong(line: Line) -> bool:
    """A wrong name without a doubt; "nothing is missing" where something is, is none, but has a row of its own."""
    return _named(line) and not is_right(line)


def _top(line: Line) -> bool:
    names, family = best_set(line), FAMILIES[line["family"]]
    return names is not None and told(family.twins, names) == told(family.twins, line["truth"])


def _truth_in_answer(line: Line) -> bool:
    truth = told(ANYWHERE, line["truth"]) or {"none"}
    return truth <= told(ANYWHERE, answer(line)) and line["status"] == "ok"


def _gives_a_name(line: Line) -> bool:
    """Lost cases count, as nobody knows what they would have said."""
    return line["status"] != "ok" or (bool(line["names"]) and line["verdict"] != "no missing effect")


def _flagged(line: Line) -> bool:
    return line["status"] == "ok" and (line["verdict"] == "unknown" or not line["complete"])


def _settled(line: Line) -> bool:
    """Named rightly, or nothing left but what no record can tell apart."""
    twins = FAMILIES[line["family"]].twins
    return is_right(line) or (
        line["status"] == "ok"
        and line["verdict"] == "ambiguous"
        and told(twins, answer(line)) == told(twins, line["truth"])
    )


def _left_open(line: Line) -> bool:
    return line["status"] == "ok" and not _named(line) and not _settled(line)


def _at_last(line: Line) -> Line:
    """The answer with the proposed experiment; an experiment that fails is no success."""
    if "after" in line:
        return {**line, "posterior": [], **line["after"]}
    return {**line, "status": "failed"} if "after_error" in line else line


# --- figures ---------------------------------------------------------------------------------------------------------


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share, after Wilson (1927)."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / n
    centre, spread = p + z**2 / (2 * n), z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return float((centre - spread) / (1 + z**2 / n)), float((centre + spread) / (1 + z**2 / n))


def _verdict(good: bool | None) -> str:
    return "no case" if good is None else "pass" if good else "MISS"


def _share(name: str, hits: Iterable[bool], at_least: float | None = None, at_most: float | None = None) -> Row:
    found = list(hits)
    k, n = sum(found), len(found)
    low, high = wilson(k, n)
    counts = f"{k}/{n} [{low:.3f}, {high:.3f}]" if n else "0/0"
    value, bars = k / n if n else float("nan"), []
    if at_least is not None:
        bars.append((f">= {at_least:g}", value >= at_least))
    if at_most is not None:
        bars.append((f"<= {at_most:g}", value <= at_most))
    judged = _verdict(all(good for _, good in bars) if n else None) if bars else ""
    return name, f"{value:.3f}" if n else "-", counts, "  ".join([*(text for text, _ in bars), judged])


def _number(name: str, values: Iterable[float], at: float, at_most: float | None = None) -> Row:
    found = [v for v in values if np.isfinite(v)]
    value = float(np.percentile(found, at)) if found else float("nan")
    judged = "" if at_most is None else f"<= {at_most:g}  {_verdict(value <= at_most if found else None)}"
    return name, f"{value:.3g}" if found else "-", f"n {len(found)}", judged


def _table(head: str, rows: Iterable[Row]) -> str:
    return "\n".join(
        [head, *(f"  {what:66} {value:>6}  {counts:28} {bar}".rstrip() for what, value, counts, bar in rows)]
    )


def _of(lines: Sequence[Line], *kinds: str) -> list[Line]:
    return [line for line in lines if line["kind"] in kinds]


def _bars(lines: Sequence[Line]) -> list[Row]:
    rich = [x for x in lines if x["condition"] in RICH]
    poor = _of(lines, "poor")
    # Whom the record did not tell, and of them who got an experiment.
    left_open = [x for x in poor if _left_open(x)]
    one = [x for x in _of(lines, "single", "none", "pairs") if _named(x) and len(x["names"]) == 1]
    there = [x for x in rich if x["status"] == "ok"]
    families = [f for f in FAMILIES if any(x["family"] == f for x in rich)]
    return [
        _share("top-1, single effect, rich, mid noise", map(_top, rich), 0.93),
        *(_share(f"  {f}", (_top(x) for x in rich if x["family"] == f), 0.85) for f in families),
        _share("one name given -> right", map(is_right, one), 0.98),
        _share("nothing missing -> a name", map(_gives_a_name, _of(lines, "none")), None, 0.02),
        _share("outside the catalogue -> unknown or incomplete", map(_flagged, _of(lines, "outside")), 0.95),
        _share("pairs: both and no third", map(_top, _of(lines, "pairs")), 0.85),
        _share("poor excitation: a sure wrong name", map(_sure_and_wrong, poor), None, 0.02),
        _share("poor excitation: truth in the answer", map(_truth_in_answer, poor), 0.95),
        _share(
            "poor excitation: left open, named after the proposed experiment",
            ("after" in x and _settled(_at_last(x)) for x in left_open), 0.9,
        ),
        _share("  of these a sure wrong name after it", (_sure_and_wrong(_at_last(x)) for x in left_open)),
        _share(
            "  proposals that ask for a sensor the rig has not",
            (bool(x["experiment"]["foreign"]) for x in poor if "experiment" in x),
        ),
        _share("95 % intervals hold the truth", map(_holds, _values(lines)), 0.90, 0.99),
        _number("held-out error / that of the true machine's model, median", _ratios(rich), 50, 1.1),
        _number("CPU s, one effect, median", (x["cpu_s"] for x in there), 50, 8),
        _number("CPU s, one effect, at 95 %", (x["cpu_s"] for x in there), 95, 30),
    ]  # fmt: skip


def _ratios(lines: Iterable[Line]) -> list[float]:
    return [x["gap_after"] / x["true_error"] for x in lines if x.get("gap_after") is not None and x.get("true_error")]


def _calibration(lines: Sequence[Line]) -> list[Row]:
    """By tenth of the stated probability: what was stated on average and how often it was so."""
    stated = [
        (x["posterior"][0][1], _same(x["posterior"][0][0], x) and not x["posterior"][0][2])
        for x in lines
        if x["status"] == "ok" and x["posterior"] and x["kind"] != "outside"
    ]
    rows = []
    for tenth in range(10):
        of_it = [(p, hit) for p, hit in stated if min(int(10 * p), 9) == tenth]
        if not of_it:
            continue
        mean = float(np.mean([p for p, _ in of_it]))
        name, value, counts, _ = _share(
            f"stated {tenth / 10:.1f} to {(tenth + 1) / 10:.1f}, on average {mean:.3f}: right in", (h for _, h in of_it)
        )
        off = abs(float(value) - mean)
        rows.append((name, value, counts, f"within 0.05  {_verdict(off <= 0.05 if len(of_it) >= ENOUGH else None)}"))
    return rows


def _values(lines: Iterable[Line]) -> list[Line]:
    """Intervals of the effects named, of cases where the named set is the hidden one."""
    return [v for x in lines if x["status"] == "ok" and set(x["names"]) == set(x["truth"]) for v in x["intervals"]]


def _holds(value: Line) -> bool:
    return value["lower"] <= value["truth"] <= value["upper"]


def _intervals(lines: Sequence[Line]) -> list[Row]:
    values = _values(lines)
    rows = []
    for effect in sorted({v["effect"] for v in values}):
        own = [v for v in values if v["effect"] == effect]
        bar = (0.90, 0.99) if len(own) >= ENOUGH // 2 else (None, None)
        rows.append(_share(f"{effect}: {own[0]['parameter']}", map(_holds, own), *bar))
    return rows


def _by_family(lines: Sequence[Line]) -> str:
    """Every condition, one line a family."""
    parts = []
    for condition in dict.fromkeys(x["condition"] for x in lines):
        of_it = [x for x in lines if x["condition"] == condition]
        kind = of_it[0]["kind"]
        tests = TESTS[kind]
        head = "".join(f"{name:>20}" for name in tests)
        parts.append(f"== {condition} ({kind})\n  {'':16}{'n':>5}{head}{'held-out ratio':>16}{'CPU s':>8}")
        for family in (*(f for f in FAMILIES if any(x["family"] == f for x in of_it)), "all"):
            own = [x for x in of_it if family in (x["family"], "all")]
            cells = "".join(f"{np.mean([test(x) for x in own]):20.3f}" for test in tests.values())
            ratios, cpu = _ratios(own), [x["cpu_s"] for x in own if x["status"] == "ok"]
            ratio = f"{np.median(ratios):16.3g}" if ratios else f"{'-':>16}"
            parts.append(f"  {family:16}{len(own):5d}{cells}{ratio}{np.median(cpu) if cpu else np.nan:8.1f}")
    return "\n".join(parts)


def _nothing_said(line: Line) -> bool:
    return line["status"] == "ok" and line["verdict"] == "no missing effect" and line["complete"]


TESTS: dict[str, dict[str, Test]] = {
    "single": {"top-1": _top, "truth in answer": _truth_in_answer, "named, right": is_right,
               "sure and wrong": _sure_and_wrong, "none missing": _nothing_said},
    "none": {"a name": _gives_a_name, "none missing": _nothing_said},
    "outside": {"flagged": _flagged, "sure and wrong": _sure_and_wrong, "none missing": _nothing_said},
    "pairs": {"top-1": _top, "truth in answer": _truth_in_answer, "named, right": is_right,
              "sure and wrong": _sure_and_wrong},
    "poor": {"top-1": _top, "truth in answer": _truth_in_answer, "named, right": is_right,
             "sure and wrong": _sure_and_wrong, "none missing": _nothing_said,
             "settled at last": lambda x: _settled(_at_last(x))},
}  # fmt: skip


def _failures(lines: Sequence[Line]) -> str:
    """A line for each case that counts against a bar."""
    wrong: dict[str, Test] = {
        "single": lambda x: not _top(x) or _sure_and_wrong(x),
        "none": _gives_a_name,
        "outside": lambda x: not _flagged(x),
        "pairs": lambda x: not _top(x),
        "poor": lambda x: (
            _sure_and_wrong(x) or not _truth_in_answer(x) or (_left_open(x) and not _settled(_at_last(x)))
        ),
    }
    rows = [f"  {x['key'].split(' | ', 1)[1]}: {_said(x)}" for x in lines if wrong[x["kind"]](x)]
    return "\n".join([f"== failing cases: {len(rows)} of {len(lines)}", *rows])


def _said(line: Line) -> str:
    if line["status"] != "ok":
        return line["status"]
    sets = ", ".join(f"{'+'.join(names) or 'none'} {p:.2f}" for names, p, _ in line["posterior"][:3])
    said = f"{line['verdict']}{'' if line['complete'] else ' (incomplete)'}; {sets or 'none'}"
    after = line.get("after")
    return (
        f"{said}; after {line['experiment']['name']}: {after['verdict']} {'+'.join(after['names'])}" if after else said
    )


# --- the peer --------------------------------------------------------------------------------------------------------


def _peer(peers: Sequence[Line], ours: Sequence[Line]) -> str:
    """PySINDy on the same cases, with the smoothing window that is best for it in hindsight, condition by condition."""
    heads = ("n", "window", "first name", "robustlab", "true chosen", "mean terms", "CPU s")
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
        ours_right = np.mean([_top(x) for x in own]) if own else np.nan
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
