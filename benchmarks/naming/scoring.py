"""What the answers of a program are worth, as a table: each share with its counts.

An answer is *right* where its kinds are a set that is right, each kind the hidden effect's own or a wider one
below the root (a force against the motion, for dry friction); *sure and wrong* where it is named and not right, unless
it says that something remains and all that it names is hidden. *Open*
is fair where the truth is among what is possible. Without a name in the catalogue ("outside") an answer is right where
it is "unknown", or says that something remains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from robustlab.dynamics import upwards

Said = Mapping[str, Any]
RESOLVABLE = 3.0  # standard deviations of the noise below which no test on the records tells two sets apart
ROOTS = ("force",)  # says that something pushes, and no more
MISSING: Said = {"verdict": "open", "named": [], "possible": [], "complete": False, "missing": True}


def _covers(told: str, kind: str) -> bool:
    return told not in ROOTS and told in [k.id for k in upwards(kind)]


def _within(told: Sequence[str], kinds: Sequence[str]) -> bool:
    """Whether the kinds told are some of a set, one for one."""
    left = list(kinds)
    for kind in told:
        own = next((k for k in left if _covers(kind, k)), None)
        if own is None:
            return False
        left.remove(own)
    return True


def is_right(said: Said, truth: Mapping[str, Any]) -> bool:
    """Whether the answer is what is hidden, at the level that was told."""
    if truth["condition"] == "outside":
        return said["verdict"] == "unknown" or (said["verdict"] != "nothing" and not said.get("complete", True))
    if truth["condition"] == "nothing":
        return said["verdict"] == "nothing"
    told = [one["kind"] for one in said["named"]]
    return said["verdict"] == "named" and any(
        len(told) == len(kinds) and _within(told, kinds) for kinds in truth["kinds"]
    )


def _wrong(said: Said, truth: Mapping[str, Any]) -> bool:
    """Named and not right; names that are all hidden, and the word that something remains, are neither."""
    if said["verdict"] != "named" or is_right(said, truth):
        return False
    told = [one["kind"] for one in said["named"]]
    return said.get("complete", True) or not any(_within(told, kinds) for kinds in truth["kinds"])


def _possible(said: Said, truth: Mapping[str, Any]) -> bool:
    """Right, or open with the whole truth among what is possible."""
    if is_right(said, truth):
        return True
    there = [*said["possible"], *(one["kind"] for one in said["named"])]
    return said["verdict"] == "open" and any(
        all(any(_covers(t, k) for t in there) for k in kinds) for kinds in truth["kinds"]
    )


Row = tuple[str, str]


def score(truth: Mapping[str, Any], answers: Mapping[str, Said], resolvable: Mapping[str, float]) -> list[Row]:
    """Rows (what, value) of one program over the cases that the truth has; a case without an answer is no right one.

    ``resolvable``: case -> refit distance of truth and answer, of those wrong; below 3 nobody can be asked for it.
    """
    cases = [(key, answers.get(key, MISSING), t) for key, t in truth.items()]

    def share(test: Callable[[Said, Any], bool], *conditions: str, only: Callable[[str], bool] | None = None) -> str:
        hits = [test(a, t) for key, a, t in cases if t["condition"] in conditions and (only is None or only(key))]
        return f"{sum(hits)}/{len(hits)}" if hits else "-"

    def told(key: str) -> bool:
        return not resolvable.get(key, np.inf) < RESOLVABLE

    rows = [
        ("singles: right", share(is_right, "single")),
        ("singles that the records can tell: right", share(is_right, "single", only=told)),
        ("singles: right, or open with the truth in the answer", share(_possible, "single")),
        ("singles: sure and wrong", share(_wrong, "single")),
        ("pairs: both, and no third", share(is_right, "pair")),
        ("pairs: sure and wrong", share(_wrong, "pair")),
        ("nothing missing: said so", share(is_right, "nothing")),
        (
            "nothing missing: a name all the same",
            share(lambda a, _: bool(a["named"]) or a["verdict"] == "unknown", "nothing"),
        ),
        ("outside the catalogue: unknown, or something remains", share(is_right, "outside")),
        ("poor excitation: right", share(is_right, "poor")),
        ("poor excitation: right, or open with the truth in it", share(_possible, "poor")),
        ("poor excitation: sure and wrong", share(_wrong, "poor")),
    ]
    for family in sorted({t["family"] for t in truth.values()}):
        own = [is_right(a, t) for _, a, t in cases if t["condition"] == "single" and t["family"] == family]
        rows.append((f"singles of {family}: right", f"{sum(own)}/{len(own)}"))
    return [*rows, *_calibration(cases), *_seconds(a for _, a, _ in cases)]


def _calibration(cases: Iterable[tuple[str, Said, Any]]) -> list[Row]:
    """Kinds stated with a probability: what was stated on average, and how many are in the machine."""
    stated = [
        (one["probability"], any(_covers(one["kind"], k) for kinds in t["kinds"] for k in kinds))
        for _, a, t in cases if t["condition"] != "outside"
        for one in [*a["named"], *a.get("considered", [])] if one.get("probability") is not None
    ]  # fmt: skip
    rows = []
    for low, high in ((0.05, 0.35), (0.35, 0.65), (0.65, 0.95), (0.95, 1.01)):
        own = [(p, hit) for p, hit in stated if low <= p < high]
        if own:
            value = f"{np.mean([p for p, _ in own]):.2f}: {sum(h for _, h in own)}/{len(own)}"
            rows.append((f"kinds stated at {low:g} to {min(high, 1.0):g}, on average: in the machine", value))
    return rows


def _seconds(answers: Iterable[Said]) -> list[Row]:
    spent = [a["seconds"] for a in answers if "seconds" in a]
    if not spent:
        return []
    return [("CPU s a case: median, at 95 %", f"{np.median(spent):.3g}, {np.percentile(spent, 95):.3g}")]


def table(truth: Mapping[str, Any], programs: Mapping[str, tuple[Mapping[str, Said], Mapping[str, float]]]) -> str:
    columns = {name: dict(score(truth, answers, apart)) for name, (answers, apart) in programs.items()}
    labels = list(dict.fromkeys(label for rows in columns.values() for label in rows))
    width = max((len(label) for label in labels), default=0)
    lines = [" " * width + "".join(f"{name:>16}" for name in columns)]
    lines += [f"{k:{width}}" + "".join(f"{rows.get(k, '-'):>16}" for rows in columns.values()) for k in labels]
    return "\n".join(lines)
