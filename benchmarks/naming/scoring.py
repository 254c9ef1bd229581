"""Score the answers of a program as a table of shares and counts.

An answer is *right* if its effect classes are an accepted set, where each class is that of the hidden effect or a wider
one below the root (a force against the motion, for dry friction). It is *sure and wrong* if its verdict is "named" and
it is not right, except for an incomplete answer all of whose names are hidden effects. An *open* answer is fair if the
possible effects contain the truth. Outside the catalogue an answer is right if it is "unknown" or incomplete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from robustlab.dynamics import upwards

Answer = Mapping[str, Any]
RESOLVABLE = 3.0  # standard deviations of the noise; the records cannot distinguish two sets below this distance
ROOTS = ("force",)  # too general: any force
MISSING: Answer = {"verdict": "open", "named": [], "possible": [], "complete": False, "missing": True}


def _covers(named: str, kind: str) -> bool:
    return named not in ROOTS and named in [k.id for k in upwards(kind)]


def _within(named: Sequence[str], kinds: Sequence[str]) -> bool:
    """Return whether each named class matches a different one of a set."""
    left = list(kinds)
    for kind in named:
        own = next((k for k in left if _covers(kind, k)), None)
        if own is None:
            return False
        left.remove(own)
    return True


def is_right(answer: Answer, truth: Mapping[str, Any]) -> bool:
    """Return whether the named classes match the hidden effects."""
    if truth["condition"] == "outside":
        return answer["verdict"] == "unknown" or (answer["verdict"] != "nothing" and not answer.get("complete", True))
    if truth["condition"] == "nothing":
        return answer["verdict"] == "nothing"
    named = [one["kind"] for one in answer["named"]]
    return answer["verdict"] == "named" and any(
        len(named) == len(kinds) and _within(named, kinds) for kinds in truth["kinds"]
    )


def _wrong(answer: Answer, truth: Mapping[str, Any]) -> bool:
    """Return whether the verdict is "named" and wrong; an incomplete answer with only hidden effects is neither."""
    if answer["verdict"] != "named" or is_right(answer, truth):
        return False
    named = [one["kind"] for one in answer["named"]]
    return answer.get("complete", True) or not any(_within(named, kinds) for kinds in truth["kinds"])


def _possible(answer: Answer, truth: Mapping[str, Any]) -> bool:
    """Return whether the answer is right, or open with the whole truth among the possible effects."""
    if is_right(answer, truth):
        return True
    there = [*answer["possible"], *(one["kind"] for one in answer["named"])]
    return answer["verdict"] == "open" and any(
        all(any(_covers(t, k) for t in there) for k in kinds) for kinds in truth["kinds"]
    )


Row = tuple[str, str]


def score(truth: Mapping[str, Any], answers: Mapping[str, Answer], resolvable: Mapping[str, float]) -> list[Row]:
    """Return rows (label, value) of one program over all cases; a case without an answer counts as not right.

    ``resolvable``: case -> refit distance of truth and answer, for wrong answers; not distinguishable below 3.
    """
    cases = [(key, answers.get(key, MISSING), t) for key, t in truth.items()]

    def share(test: Callable[[Answer, Any], bool], *conditions: str, only: Callable[[str], bool] | None = None) -> str:
        hits = [test(a, t) for key, a, t in cases if t["condition"] in conditions and (only is None or only(key))]
        return f"{sum(hits)}/{len(hits)}" if hits else "-"

    def distinguishable(key: str) -> bool:
        return not resolvable.get(key, np.inf) < RESOLVABLE

    rows = [
        ("singles: right", share(is_right, "single")),
        ("singles that the records distinguish: right", share(is_right, "single", only=distinguishable)),
        ("singles: right, or open with the truth in the answer", share(_possible, "single")),
        ("singles: sure and wrong", share(_wrong, "single")),
        ("pairs: both, and no third", share(is_right, "pair")),
        ("pairs: sure and wrong", share(_wrong, "pair")),
        ("nothing missing: reported", share(is_right, "nothing")),
        (
            "nothing missing: an effect named",
            share(lambda a, _: bool(a["named"]) or a["verdict"] == "unknown", "nothing"),
        ),
        ("outside the catalogue: unknown or incomplete", share(is_right, "outside")),
        ("poor excitation: right", share(is_right, "poor")),
        ("poor excitation: right, or open with the truth in it", share(_possible, "poor")),
        ("poor excitation: sure and wrong", share(_wrong, "poor")),
    ]
    for family in sorted({t["family"] for t in truth.values()}):
        own = [is_right(a, t) for _, a, t in cases if t["condition"] == "single" and t["family"] == family]
        rows.append((f"singles of {family}: right", f"{sum(own)}/{len(own)}"))
    return [*rows, *_calibration(cases), *_seconds(a for _, a, _ in cases)]


def _calibration(cases: Iterable[tuple[str, Answer, Any]]) -> list[Row]:
    """Return rows of classes stated with a probability: the mean statement, and how many the machine has."""
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


def _seconds(answers: Iterable[Answer]) -> list[Row]:
    spent = [a["seconds"] for a in answers if "seconds" in a]
    if not spent:
        return []
    return [("CPU s a case: median, at 95 %", f"{np.median(spent):.3g}, {np.percentile(spent, 95):.3g}")]


def table(truth: Mapping[str, Any], programs: Mapping[str, tuple[Mapping[str, Answer], Mapping[str, float]]]) -> str:
    columns = {name: dict(score(truth, answers, apart)) for name, (answers, apart) in programs.items()}
    labels = list(dict.fromkeys(label for rows in columns.values() for label in rows))
    width = max((len(label) for label in labels), default=0)
    lines = [" " * width + "".join(f"{name:>16}" for name in columns)]
    lines += [f"{k:{width}}" + "".join(f"{rows.get(k, '-'):>16}" for rows in columns.values()) for k in labels]
    return "\n".join(lines)
