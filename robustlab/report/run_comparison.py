"""Two runs side by side: requirements, steps and numbers, what changed, and what got worse."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from robustlab.report.html import found_in_words

BETTER, WORSE, SAME, CHANGED, FRESH, GONE = "better", "WORSE", "same", "changed", "new", "gone"
CLOCKED = ("seconds",)  # last part of a number that differs between any two runs


@dataclass(frozen=True)
class Change:
    """One thing of both runs."""

    what: str  # text of a requirement, name of a step, or dotted path of a number
    # first, second: what each run found; None where it has no such thing
    first: Any
    second: Any
    verdict: str  # `better`, `WORSE`, `same`, `changed`, `new` or `gone`
    condition: str = ""  # what is required; empty for others
    why: str = ""  # the verdict in words, where a word is not enough


@dataclass(frozen=True)
class RunComparison:
    """What differs between two runs."""

    # requirements, steps: all of both runs, in the order of the second; a requirement that only the first states
    # comes last
    requirements: Sequence[Change]
    steps: Sequence[Change]
    # Those that differ by more than the tolerance, the largest change first; and those that only one run has.
    numbers: Sequence[Change]
    equal: int  # how many numbers do not differ
    settings: Sequence[Change]  # what was run: recipe, settings, seed, inputs and versions, where they differ

    @property
    def worse(self) -> list[Change]:
        """Requirements and steps that got worse."""
        return [c for c in (*self.requirements, *self.steps) if c.verdict == WORSE]

    def to_json(self) -> dict[str, Any]:
        """Plain types."""
        parts = {k: [asdict(c) for c in getattr(self, k)] for k in ("requirements", "steps", "numbers", "settings")}
        return {**parts, "equal_numbers": self.equal, "worse": len(self.worse)}


def compare_runs(first: Mapping[str, Any], second: Mapping[str, Any], tolerance: float = 0.01) -> RunComparison:
    """Compare the contents of two ``result.json``.

    A requirement got worse where it was met and is not, where its number moved towards or beyond its limit by more than
    ``tolerance`` times the larger of both numbers, or where a requirement that was met is no longer stated. A step got
    worse where its number can no longer be vouched for.

    ``first``, ``second``: content of ``result.json``, see `robustlab.recipe.run`.
    ``tolerance``: relative change below which two numbers count as the same.
    """
    old, new = (dict(_numbers(run)) for run in (first, second))
    changes = [_number(path, old.get(path), new.get(path), tolerance) for path in {**new, **old}]
    changed = sorted((c for c in changes if c.verdict != SAME), key=lambda c: -_size(c))
    return RunComparison(
        _requirements(first, second, tolerance),
        _steps(first, second),
        changed,
        len(changes) - len(changed),
        [
            Change(key, a, b, CHANGED)
            for key, (a, b) in _paired(_settings(first), _settings(second)).items()
            if a != b
        ],
    )  # fmt: skip


# --- requirements ----------------------------------------------------------------------------------------------------


def _requirements(first: Mapping[str, Any], second: Mapping[str, Any], tolerance: float) -> list[Change]:
    old, new = ({_key(q, run): q for q in run["requirements"]} for run in (first, second))
    return [_requirement(a, b, tolerance) for a, b in _paired(old, new).values()]


def _key(requirement: Mapping[str, Any], run: Mapping[str, Any]) -> str:
    """What is asked of which number; where that is asked twice, the condition too."""
    asked = [q["that"] for q in run["requirements"]].count(requirement["that"])
    return requirement["that"] if asked == 1 else f"{requirement['that']} {requirement['condition']}"


def _requirement(a: Mapping[str, Any] | None, b: Mapping[str, Any] | None, tolerance: float) -> Change:
    what = (b or a or {})["text"] or (b or a or {})["that"]
    if b is None:
        assert a is not None
        verdict, why = (WORSE, "was met and is no longer stated") if a["met"] else (GONE, "no longer stated")
        return Change(what, found_in_words(a), None, verdict, a["condition"], why)
    if a is None:
        return Change(what, None, found_in_words(b), FRESH, b["condition"], "met" if b["met"] else "not met")
    condition = b["condition"] if a["condition"] == b["condition"] else f"{a['condition']} -> {b['condition']}"
    verdict, why = SAME, "met" if b["met"] else "not met"
    if a["met"] != b["met"]:
        verdict, why = (BETTER, "now met") if b["met"] else (WORSE, "was met, is not")
    elif a["condition"] == b["condition"]:
        verdict, why = _moved(a, b, tolerance, why)
    return Change(what, found_in_words(a), found_in_words(b), verdict, condition, why)


def _moved(a: Mapping[str, Any], b: Mapping[str, Any], tolerance: float, why: str) -> tuple[str, str]:
    """Whether the number of a requirement that is met by both, or by none, came nearer to its limit or left it."""
    x, y = _real(a["value"]), _real(b["value"])
    if x is None or y is None or x == y or not _differ(x, y, tolerance):
        return SAME, why
    low, high = (_real(end) for end in b.get("limits") or (None, None))
    if low is not None and high is not None:  # inside a range no place is better than another
        out = [max(low - v, v - high, 0.0) for v in (x, y)]
        step = out[1] - out[0]
    elif low is None and high is None:
        return CHANGED, why
    else:
        step = x - y if low is not None else y - x
    if step == 0:
        return CHANGED, why
    if b["met"]:
        return (WORSE, "met, with less room") if step > 0 else (BETTER, "met, with more room")
    return (WORSE, "not met, and further off") if step > 0 else (BETTER, "not met, but nearer")


# --- steps, numbers, settings ----------------------------------------------------------------------------------------


def _steps(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Change]:
    old, new = ({s["name"]: s for s in run["steps"]} for run in (first, second))
    found: list[Change] = []
    for name, (a, b) in _paired(old, new).items():
        was, now = (None if s is None else s["status"] for s in (a, b))
        if a is None or b is None:
            verdict = FRESH if a is None else GONE
        elif a["trustworthy"] != b["trustworthy"]:
            verdict = BETTER if b["trustworthy"] else WORSE
        else:
            verdict = SAME if was == now else CHANGED
        found.append(Change(name, was, now, verdict))
    return found


def _numbers(run: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for step in run["steps"]:
        yield from _leaves(step["name"], step["numbers"])


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Path and value of every single number, text, and yes or no in tables and lists."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key not in CLOCKED:
                yield from _leaves(f"{path}.{key}", item)
    elif isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            yield from _leaves(f"{path}.{i}", item)
    else:
        yield path, value


def _number(path: str, a: Any, b: Any, tolerance: float) -> Change:
    if a is None or b is None:
        return Change(path, a, b, SAME if a is b else FRESH if a is None else GONE)
    x, y = _real(a), _real(b)
    differs = a != b if x is None or y is None else _differ(x, y, tolerance)
    return Change(path, a, b, CHANGED if differs else SAME)


def _settings(run: Mapping[str, Any]) -> dict[str, str]:
    recipe, made = run["recipe"], run["provenance"]
    found = {"recipe": recipe["name"], "recipe text (SHA-256)": recipe["sha256"][:12], "seed": str(run["seed"])}
    found |= {f"--set {key}": str(value) for key, value in recipe["overrides"].items()}
    found |= {f"input {name} (SHA-256)": str(digest)[:12] for name, digest in made["inputs"].items()}
    return found | {f"version of {name}": str(version) for name, version in made["versions"].items()}


def _paired(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Entries of both, in the order of the second; what only the first has comes last."""
    return {key: (first.get(key), second.get(key)) for key in {**second, **first}}


def _real(value: Any) -> float | None:
    """A number, among them the infinities that plain results keep as texts; None for all else."""
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, (int, float)) or value in ("inf", "-inf", "nan"):
        return float(value)
    return None


def _differ(x: float, y: float, tolerance: float) -> bool:
    if math.isfinite(x) and math.isfinite(y):
        return abs(x - y) > tolerance * max(abs(x), abs(y))
    return x != y and not (math.isnan(x) and math.isnan(y))


def _size(change: Change) -> float:
    """Relative size of a change, for the order; what is no number comes first."""
    x, y = _real(change.first), _real(change.second)
    if x is None or y is None or not (math.isfinite(x) and math.isfinite(y)):
        return math.inf
    return abs(x - y) / max(abs(x), abs(y))
