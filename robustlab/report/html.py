"""The report of a run: an HTML page, its requirements as JUnit tests for a CI system, the comparison of two runs.

All texts are untrusted: Jinja2 escapes them, control and bidirectional-override characters are shown as escapes,
figures are images in ``data:`` addresses, and no script may run.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

from markupsafe import Markup

from robustlab.errors import InputError, plain_text
from robustlab.result import Status

if TYPE_CHECKING:
    from jinja2 import Template

MAX_FIGURES = 6_000_000  # characters of all figures in the page
LEADING = 4  # figures below the requirements
MAX_NUMBERS = 20_000  # characters of a step's number list in the page; result.json has all of them

_MEANING = {
    Status.CERTIFIED: "proved again from its evidence, independently of the solver",
    Status.CONVERGED: "the method converged and its value was confirmed; a better one may exist",
    Status.INACCURATE: "there is a value, but digits were lost",
    Status.INFEASIBLE: "shown to have no solution",
    Status.INCONCLUSIVE: "neither a value nor an impossibility could be shown",
    Status.TIMEOUT: "the time limit ended the search",
    Status.FAILED: "the method broke down; there is no value",
}

_MARKS = {"good": "✓", "warn": "!", "bad": "✗"}
_DIGITS = 8  # at most, of a number with a limit
_NOT_PLAIN = re.compile(rb"[^ -~]|[%#&'\\]")


class Verdict(NamedTuple):
    """The verdict at the top of the page."""

    tone: str
    mark: str
    headline: str
    detail: str


def verdict(result: Mapping[str, Any]) -> Verdict:
    """Return the verdict in the result, or that of a run by its trustworthiness and requirements."""
    if "verdict" in result:
        return Verdict(**result["verdict"])
    if ending_of(result)["how"] != "finished":
        return _unfinished(result)
    requirements = result["requirements"]
    unmet = [q for q in requirements if not q["met"]]
    doubtful = ", ".join(s["name"] for s in result["steps"] if not s["trustworthy"])
    count = f"{len(requirements) - len(unmet)} of {len(requirements)} requirements met"
    trusted = "every step ended with a trustworthy number."
    if doubtful:
        detail = f"These steps ended without one: {doubtful}. {count}."
        return Verdict("bad", "✗", "No trustworthy number", detail)
    if unmet:
        open_ones = sum(bool(q["why_not"]) for q in unmet)
        failed = len(unmet) - open_ones
        words = [f"{failed} requirement{' is' if failed == 1 else 's are'} not met"] if failed else []
        words += [f"{open_ones} requirement{'s' * (open_ones > 1)} cannot be judged"] if open_ones else []
        return Verdict("bad", "✗", ", ".join(words), f"{count}; {trusted}")
    if not requirements:
        return Verdict("warn", "–", "Done; no requirement was stated", trusted.capitalize())
    headline = "The requirement is met" if len(requirements) == 1 else f"All {len(requirements)} requirements are met"
    remains = ", ".join(s["name"] for s in result["steps"] if tone(s) == "warn")
    if remains:
        return Verdict("warn", "!", f"{headline}; something remains", f"What these steps found is not all: {remains}.")
    if windows := in_windows_only(requirements):
        return Verdict("warn", "!", f"{headline}; in free run the model is further off", " ".join(windows))
    return Verdict("good", "✓", headline, trusted.capitalize())


def ending_of(result: Mapping[str, Any]) -> Mapping[str, str]:
    """Return how a run ended; earlier versions wrote results of finished runs only."""
    return result.get("ending", {"how": "finished", "message": ""})


def _unfinished(result: Mapping[str, Any]) -> Verdict:
    how, message = (ending_of(result)[key] for key in ("how", "message"))
    if how == "running":
        detail = f"Run {message}. If it is not running any more, it was ended from outside and gave no result."
        return Verdict("bad", "✗", "This run has not finished", detail)
    where = [s["name"] for s in result["steps"] if s["status"] == how]
    at = f" in step {where[0]}" if where else " before the first step" if how == "bad input" else ""
    return Verdict("bad", "✗", f"This run did not finish: {how}{at}", message)


def in_windows_only(requirements: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each requirement that is met in windows but not in free run."""
    return [
        f"In windows alone: {q['text'] or q['that']}. In free run it is "
        f"{_with_unit(q, q['free_run']['value'])}, which no requirement limits."
        for q in requirements
        if q["met"] and q.get("free_run") and not q["free_run"]["met"]
    ]


def tone(step: Mapping[str, Any]) -> str:
    """Return the tone of a step: ``bad`` without a trustworthy number, ``warn`` if its result is incomplete."""
    if not step["trustworthy"]:
        return "bad"
    return "warn" if step["numbers"].get("complete") is False else "good"


def render(result: Mapping[str, Any], folder: str | Path) -> str:
    """Return the page for the content of ``result.json``."""
    from jinja2 import UndefinedError

    try:
        readable = _readable(result)
        pictures = _pictures(Path(folder), readable)
        return _template().render(
            r=readable,
            verdict=verdict(readable),
            found=found_in_words,
            became=verdict_of,
            heading=heading,
            paragraphs=lambda text: [" ".join(part.split()) for part in text.split("\n\n") if part.strip()],
            status_meaning=_status_meaning,
            tone=tone,
            leading=leading_figures(readable),
            MARKS=_MARKS,
            image=pictures.get,
        )
    except (UndefinedError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{folder}/result.json", f"a part is missing or has another form ({error})", "the result of a run"
        ) from None


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("robustlab.report", "")
    options: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True}
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, **options)
    environment.filters["pretty"] = _pretty
    return environment.get_template("page.html.j2")


def _readable(value: Any) -> Any:
    """Return the value with all texts free of control characters but line breaks."""
    if isinstance(value, str):
        return "\n".join(plain_text(line) for line in value.split("\n"))
    if isinstance(value, Mapping):
        return {_readable(str(key)): _readable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_readable(item) for item in value]
    return value


def in_words(value: Any, limits: Sequence[float | None] | None = None) -> str:
    """Return a value as text.

    A number with limits has four digits, or as many as give its distance to the nearest limit with two.
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    if not isinstance(value, float):
        return str(value)
    if limits is None or not math.isfinite(value):
        return f"{value:.6g}"
    nearest = min(abs(value - end) for end in limits if end is not None)
    digits = 4
    while digits < _DIGITS and abs(float(f"{value:.{digits}g}") - value) > 0.05 * nearest:
        digits += 1
    return f"{value:.{digits}g}" if abs(value) >= 10.0**6 or abs(value) < 10.0**digits else f"{value:.0f}"


def leading_figures(result: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Return stem -> heading and figure of the first figures of the steps that requirements name."""
    steps = {step["name"]: step for step in result["steps"]}
    named = (steps.get(q["that"].partition(".")[0]) for q in result["requirements"])
    found = {s["figures"][0]["stem"]: (heading(s), s["figures"][0]) for s in named if s is not None and s["figures"]}
    return dict(list(found.items())[:LEADING])


def heading(step: Mapping[str, Any]) -> str:
    name = step["name"].replace("_", " ").replace("-", " ")
    return step["title"] or name[:1].upper() + name[1:]


def found_in_words(requirement: Mapping[str, Any]) -> str:
    """Return the value of a requirement with its unit, also in free run, or the reason of a missing one."""
    if requirement["why_not"]:
        return str(requirement["why_not"])
    free = requirement.get("free_run")
    free_run = f" (in free run {_with_unit(requirement, free['value'])})" if free else ""
    return f"{_with_unit(requirement, requirement['value'])}{free_run}"


def _with_unit(requirement: Mapping[str, Any], value: Any) -> str:
    shown = in_words(value, requirement.get("limits"))
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return f"{shown} {requirement.get('unit', '')}".rstrip() if is_number else shown


def verdict_of(requirement: Mapping[str, Any]) -> str:
    if requirement["met"]:
        return "met"
    return "cannot be judged" if requirement["why_not"] else "not met"


def _status_meaning(step: Mapping[str, Any]) -> str:
    status = step["status"]
    if status in set(Status):
        more = "; but something remains that it does not explain" if tone(step) == "warn" else ""
        return _MEANING[Status(status)] + more
    if status == "not run":
        return "it was left out"
    return "it ended the run" if step["error"] else "the step ended; there is no proof or convergence to report"


def _pretty(numbers: Any) -> str:
    text = json.dumps(numbers, indent=2, ensure_ascii=False)
    return text if len(text) <= MAX_NUMBERS else f"{text[:MAX_NUMBERS]}\n... (the rest is in result.json)"


def _pictures(folder: Path, result: Mapping[str, Any]) -> dict[str, Markup]:
    """Return the figures of a run by stem as ``data:`` addresses for an attribute, up to `MAX_FIGURES`."""
    room, found = MAX_FIGURES, {}
    for stem in dict.fromkeys(f["stem"] for step in result["steps"] for f in step["figures"]):
        path = folder / "figures" / f"{stem}.svg"
        if Path(stem).name != stem or not path.is_file():
            raise InputError(str(path), "no such figure", "the figures of the run in the folder of its result.json")
        svg = path.read_bytes().decode("utf-8", errors="replace").encode()
        text = _NOT_PLAIN.sub(lambda character: b"%%%02X" % ord(character[0]), svg).decode("ascii")
        address = Markup(f"data:image/svg+xml,{text}")  # noqa: S704 - nothing in it can end the attribute
        if len(address) <= room:
            found[stem] = address
            room -= len(address)
    return found


def junit_xml(result: Mapping[str, Any]) -> str:
    """Return JUnit XML with a test case per requirement, and one per step without a trustworthy number.

    A requirement that is not met is a failure; one that cannot be judged is an error, as is a run that did not finish.
    """
    name, ending = plain_text(str(result["recipe"]["name"])), ending_of(result)
    cases: list[tuple[str, str, str, Any]] = []  # class, name, kind of the fault or "", and its message
    for q in result["requirements"]:
        kind = "" if q["met"] else "error" if q["why_not"] else "failure"
        reason = q["why_not"] or f"{q['that']} is {q['value']}, required: {q['condition']}"
        cases.append(("requirements", q["text"] or q["that"], kind, reason))
    for s in result["steps"]:
        if not s["trustworthy"]:
            cases.append(("steps", s["name"], "error", s["error"] or f"status {s['status']}"))
    if ending["how"] != "finished":
        cases.append(("run", "the run finishes", "error", f"{ending['how']}: {ending['message']}"))
    kinds = [kind for _, _, kind, _ in cases]
    counts = {"tests": len(cases), "failures": kinds.count("failure"), "errors": kinds.count("error")}
    attributes = {"name": name, **{key: str(n) for key, n in counts.items()}, "time": f"{float(result['seconds']):.3f}"}
    suites = ET.Element("testsuites", attributes)
    suite = ET.SubElement(suites, "testsuite", attributes)
    for group, title, kind, reason in cases:
        about = {"classname": f"{name}.{group}", "name": plain_text(str(title))}
        case = ET.SubElement(suite, "testcase", about)
        if kind:
            ET.SubElement(case, kind, {"message": plain_text(str(reason))})
    ET.indent(suites)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(suites, encoding="unicode") + "\n"


# --- comparison of two runs -------------------------------------------------------------------------------------------

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
