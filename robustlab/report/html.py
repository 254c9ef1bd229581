"""The report of a run: a self-contained HTML page, and its requirements as JUnit tests for a CI system.

All texts are untrusted: Jinja2 escapes them, control and bidirectional-override characters are shown as escapes,
figures are images in ``data:`` addresses, and no script may run.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
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
    Status.CERTIFIED: "derived again from its evidence, outside the solver",
    Status.CONVERGED: "the method ended as intended and its value was evaluated again",
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
        words = []
        for n, one, more in (
            (sum(not q["why_not"] for q in unmet), "requirement is not met", "requirements are not met"),
            (sum(bool(q["why_not"]) for q in unmet), "requirement cannot be judged", "requirements cannot be judged"),
        ):
            words += [f"{n} {one if n == 1 else more}"] if n else []
        return Verdict("bad", "✗", ", ".join(words), f"{count}; {trusted}")
    if not requirements:
        return Verdict("warn", "–", "Done; no requirement was stated", trusted.capitalize())
    headline = "The requirement is met" if len(requirements) == 1 else f"All {len(requirements)} requirements are met"
    remains = ", ".join(s["name"] for s in result["steps"] if tone(s) == "warn")
    if remains:
        return Verdict("warn", "!", f"{headline}; something remains", f"What these steps found is not all: {remains}.")
    windows = in_windows_only(requirements)
    if windows:
        return Verdict("warn", "!", f"{headline}; in free run the model is further off", " ".join(windows))
    return Verdict("good", "✓", headline, trusted.capitalize())


def ending_of(result: Mapping[str, Any]) -> Mapping[str, str]:
    """Return how a run ended; earlier versions wrote results of finished runs only."""
    return result.get("ending", {"how": "finished", "message": ""})


def _unfinished(result: Mapping[str, Any]) -> Verdict:
    ending = ending_of(result)
    how, message = ending["how"], ending["message"]
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
            paragraphs=_paragraphs,
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
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
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
    """Return the title of a step, by default its name as words."""
    name = step["name"].replace("_", " ").replace("-", " ")
    return step["title"] or name[:1].upper() + name[1:]


def found_in_words(requirement: Mapping[str, Any]) -> str:
    """Return the value of a requirement with its unit, also in free run, or the reason of a missing one."""
    if requirement["why_not"]:
        return str(requirement["why_not"])
    free = requirement.get("free_run")
    beside = f" (in free run {_with_unit(requirement, free['value'])})" if free else ""
    return f"{_with_unit(requirement, requirement['value'])}{beside}"


def _with_unit(requirement: Mapping[str, Any], value: Any) -> str:
    shown = in_words(value, requirement.get("limits"))
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return f"{shown} {requirement.get('unit', '')}".rstrip() if is_number else shown


def verdict_of(requirement: Mapping[str, Any]) -> str:
    """Return the judgement of a requirement as text."""
    if requirement["met"]:
        return "met"
    return "cannot be judged" if requirement["why_not"] else "not met"


def _paragraphs(text: str) -> list[str]:
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _status_meaning(step: Mapping[str, Any]) -> str:
    status = step["status"]
    if status in set(Status):
        more = "; but something remains that it does not explain" if tone(step) == "warn" else ""
        return _MEANING[Status(status)] + more
    if status == "not run":
        return "it was left out"
    return "it ended the run" if step["error"] else "nothing here could fail to converge"


def _pretty(numbers: Any) -> str:
    text = json.dumps(numbers, indent=2, ensure_ascii=False)
    return text if len(text) <= MAX_NUMBERS else f"{text[:MAX_NUMBERS]}\n... (the rest is in result.json)"


def _pictures(folder: Path, result: Mapping[str, Any]) -> dict[str, Markup]:
    """Return the figures of a run by stem as ``data:`` addresses, up to `MAX_FIGURES`."""
    room, found = MAX_FIGURES, {}
    for stem in dict.fromkeys(f["stem"] for step in result["steps"] for f in step["figures"]):
        text = _address(_svg(folder, stem))
        if len(text) <= room:
            found[stem] = text
            room -= len(text)
    return found


def _address(svg: str) -> Markup:
    """Return a picture as an address for an attribute in single quotes, with special characters as %xx."""
    text = _NOT_PLAIN.sub(lambda found: b"%%%02X" % ord(found[0]), svg.encode()).decode("ascii")
    return Markup(f"data:image/svg+xml,{text}")  # noqa: S704 - nothing in it can end the attribute


def _svg(folder: Path, stem: str) -> str:
    path = folder / "figures" / f"{stem}.svg"
    if Path(stem).name != stem or not path.is_file():
        raise InputError(str(path), "no such figure", "the figures of the run in the folder of its result.json")
    return path.read_bytes().decode("utf-8", errors="replace")


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
