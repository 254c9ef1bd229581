"""Compare two runs: requirements, steps and numbers that changed or got worse."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from robustlab.report.html import found_in_words

BETTER, WORSE, SAME, CHANGED, FRESH, GONE = "better", "WORSE", "same", "changed", "new", "gone"


def compare_runs(first: Mapping[str, Any], second: Mapping[str, Any], tolerance: float = 0.01) -> dict[str, Any]:
    """Return the differences of two ``result.json``; numbers within the relative ``tolerance`` are equal.

    A requirement got worse if it was met and is not or is no longer stated, or if its number moved towards or beyond
    its limit; a step, if its number is no longer trustworthy. ``numbers`` are sorted by the size of the change.
    """
    old, new = ({_key(q, run): q for q in run["requirements"]} for run in (first, second))
    requirements = [_requirement(a, b, tolerance) for a, b in _paired(old, new).values()]
    old, new = ({s["name"]: s for s in run["steps"]} for run in (first, second))
    steps = [_step(name, a, b) for name, (a, b) in _paired(old, new).items()]
    old, new = (dict(_leaves("", {s["name"]: s["numbers"] for s in run["steps"]})) for run in (first, second))
    numbers = [
        _row(path, a, b, FRESH if a is None else GONE if b is None else CHANGED)
        for path, (a, b) in _paired(old, new).items()
        if _change(a, b) > tolerance
    ]
    numbers.sort(key=lambda c: -_change(c["first"], c["second"]))
    settings = [
        _row(key, a, b, CHANGED) for key, (a, b) in _paired(_settings(first), _settings(second)).items() if a != b
    ]
    return {
        "requirements": requirements, "steps": steps, "numbers": numbers, "settings": settings,
        "equal_numbers": len({**old, **new}) - len(numbers),
        "worse": sum(c["verdict"] == WORSE for c in (*requirements, *steps)),
    }  # fmt: skip


def _row(what: str, first: Any, second: Any, verdict: str, condition: str = "", why: str = "") -> dict[str, Any]:
    return {"what": what, "first": first, "second": second, "verdict": verdict, "condition": condition, "why": why}


def _key(requirement: Mapping[str, Any], run: Mapping[str, Any]) -> str:
    """Return the number that a requirement names, with the condition if it is named twice."""
    count = [q["that"] for q in run["requirements"]].count(requirement["that"])
    return requirement["that"] if count == 1 else f"{requirement['that']} {requirement['condition']}"


def _requirement(a: Mapping[str, Any] | None, b: Mapping[str, Any] | None, tolerance: float) -> dict[str, Any]:
    of = b or a or {}
    first, second = (None if q is None else found_in_words(q) for q in (a, b))
    if a is None or b is None:
        gone = (WORSE, "was met and is no longer stated") if of["met"] else (GONE, "no longer stated")
        verdict, why = gone if b is None else (FRESH, "met" if of["met"] else "not met")
    elif a["met"] != b["met"]:
        verdict, why = (BETTER, "now met") if b["met"] else (WORSE, "was met, is not")
    else:
        verdict, why = SAME, "met" if b["met"] else "not met"
        towards = _towards_limit(a, b) if a["condition"] == b["condition"] else 0.0
        if towards and _change(a["value"], b["value"]) > tolerance:
            words = ("with less room", "with more room") if b["met"] else ("and further off", "but nearer")
            verdict, why = WORSE if towards > 0 else BETTER, f"{why}, {words[towards < 0]}"
    return _row(of["text"] or of["that"], first, second, verdict, of["condition"], why)


def _towards_limit(a: Mapping[str, Any], b: Mapping[str, Any]) -> float:
    """Return how far a number moved towards or beyond its limit; 0 inside a range."""
    x, y = _real(a["value"]), _real(b["value"])
    low, high = (_real(end) for end in b.get("limits") or (None, None))
    if x is None or y is None or (low is None and high is None):
        return 0.0
    if low is not None and high is not None:
        return max(low - y, y - high, 0.0) - max(low - x, x - high, 0.0)
    return x - y if low is not None else y - x


def _step(name: str, a: Mapping[str, Any] | None, b: Mapping[str, Any] | None) -> dict[str, Any]:
    was, now = (None if s is None else s["status"] for s in (a, b))
    if a is None or b is None:
        return _row(name, was, now, FRESH if a is None else GONE)
    change = b["trustworthy"] - a["trustworthy"]
    return _row(name, was, now, (SAME if was == now else CHANGED, BETTER, WORSE)[change])


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield path and value of every number, text and boolean but times."""
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else None
    if items is None:
        yield path, value
        return
    for key, item in items:
        if key != "seconds":
            yield from _leaves(f"{path}.{key}".lstrip("."), item)


def _settings(run: Mapping[str, Any]) -> dict[str, str]:
    recipe, made = run["recipe"], run["provenance"]
    found = {"recipe": recipe["name"], "recipe text (SHA-256)": recipe["sha256"][:12], "seed": str(run["seed"])}
    found |= {f"--set {key}": str(value) for key, value in recipe["overrides"].items()}
    found |= {f"input {name} (SHA-256)": str(digest)[:12] for name, digest in made["inputs"].items()}
    return found | {f"version of {name}": str(version) for name, version in made["versions"].items()}


def _paired(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the entries of both in the order of the second; those of the first alone come last."""
    return {key: (first.get(key), second.get(key)) for key in {**second, **first}}


def _real(value: Any) -> float | None:
    """Return a number, also the infinities that plain results hold as texts, or None."""
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if known or value in ("inf", "-inf", "nan") else None


def _change(a: Any, b: Any) -> float:
    """Return the relative size of a change; infinite for different values that are not finite numbers."""
    x, y = _real(a), _real(b)
    if a == b or x is None or y is None or not (math.isfinite(x) and math.isfinite(y)):
        return 0.0 if a == b else math.inf
    return abs(x - y) / max(abs(x), abs(y))
