"""Run a recipe: run its steps in the order written, judge its requirements, write everything to one folder.

``result.json`` has everything, ``report.html`` the same for reading, ``junit.xml`` the requirements for a CI system;
``figures/`` has SVG (and PNG with --png), ``evidence/`` results that can be verified again.
A report of an unfinished run is written at the start and replaced at the end, however the run ends.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import robustlab as rl
from robustlab.errors import (
    EXIT_BUG,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_REQUIREMENT_NOT_MET,
    EnvironmentFault,
    InputError,
    NoTrustworthyNumber,
    RobustlabError,
)
from robustlab.files.atomic import atomic_write
from robustlab.files.file_types import parse_document, require_file
from robustlab.provenance import Provenance, file_sha256
from robustlab.recipe.load import LoadedRecipe, at_step, look_through, references, step_hint
from robustlab.recipe.schema import Judgement, Recipe, judge
from robustlab.recipe.steps.step import Fact, Outcome, Step, Workspace
from robustlab.report.html import ending_of, junit_xml, render
from robustlab.result import Status, least_trusted, plain
from robustlab.verification.files import claims_in_file

DONE, NOT_RUN = "done", "not run"
FINISHED, RUNNING = "finished", "running"
REPORT_FILES = ("report.html", "junit.xml", "result.json")

NUMBER = (int, float)
# Keys of result.json that the report reads, with their types.
RESULT_PARTS = {
    "requirements": [{"text": str, "that": str, "condition": str, "met": bool, "why_not": str}],
    "steps": [
        {
            **dict.fromkeys(("name", "do", "title", "status", "summary", "error", "text"), str),
            "trustworthy": bool,
            "numbers": dict,
            "facts": [{"label": str, "value": str, "source": str}],
            "notes": [str],
            "figures": [{"stem": str, "caption": str}],
        }
    ],
    "ending": {"how": str, "message": str},
    "recipe": {**dict.fromkeys(("name", "title", "description", "text", "sha256"), str), "overrides": dict},
    "seed": int,
    "seconds": NUMBER,
    "provenance": {"created": str, "inputs": dict, "versions": dict},
    "files": [str],
}


@dataclass(frozen=True)
class RunResult:
    """A finished run."""

    data: Mapping[str, Any]  # content of ``result.json``
    folder: Path  # where everything was written

    @property
    def exit_code(self) -> int:
        """0 all requirements met, 1 one is not, 4 a step ended without a trustworthy number."""
        return int(self.data["exit_code"])


@dataclass
class Ending:
    """How a run ended, or that it has not."""

    how: str  # finished, running, interrupted, bad input, environment, internal error
    message: str = ""  # what ended it
    exit_code: int | None = None  # None where the requirements and the steps decide it


def run_recipe(
    loaded: LoadedRecipe,
    out: str | Path,
    report: Callable[[str, str], None] = lambda _name, _kind: None,
    png: bool = False,
    figures: Literal["required", "all"] = "required",
) -> RunResult:
    """Run a recipe and write its results into ``out``, however it ends; files of an earlier run there are removed.

    The figures of the steps that requirements name are drawn; those of all steps where none is stated, or on request.
    """
    started = time.monotonic()
    target = Path(out).resolve()
    if target.exists() and not target.is_dir():
        raise EnvironmentFault(str(out), "is a file", "a folder to write results into")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise EnvironmentFault(str(out), f"cannot be made ({reason})", "a folder to write results into") from error
    named = frozenset(r.that.partition(".")[0] for r in loaded.recipe.require)
    drawn = named if named and figures == "required" else None
    work = Workspace(target, loaded.recipe.seed, png=png, drawn=drawn)
    steps: list[dict[str, Any]] = []
    stale = _files_of_previous_run(target)
    begun = f"begun {Provenance.now('robustlab run').created}"
    _write_result(_result(loaded, work, steps, 0.0, Ending(RUNNING, begun)), target)
    for name in stale.difference(REPORT_FILES):
        (target / name).unlink(missing_ok=True)
    ending = Ending(FINISHED)
    try:
        work.ahead = look_through(loaded)
        work.inputs = {f"{name}: {path.name}": file_sha256(path) for name, path in work.ahead.sources.items()}
        for entry in _run_steps(loaded, work, report):
            steps.append(entry)
    except BaseException as error:
        ending = _ending_of(error)
        raise
    finally:
        data = _result(loaded, work, steps, time.monotonic() - started, ending)
        _write_result(data, target)
    return RunResult(data, target)


def _ending_of(error: BaseException) -> Ending:
    from robustlab.dynamics.plant_file import fault_of_user_code

    if isinstance(error, KeyboardInterrupt):
        return Ending("interrupted", "the run was interrupted", EXIT_INTERRUPTED)
    known = error if isinstance(error, RobustlabError) else None
    if known is None and isinstance(error, Exception) and not isinstance(error, MemoryError):
        known = fault_of_user_code(error)
    if known is not None:
        how = "environment" if isinstance(known, EnvironmentFault) else "bad input"
        return Ending(how, str(known), known.exit_code)
    words = f"{type(error).__name__}: {error}"
    if isinstance(error, (OSError, MemoryError)):
        return Ending("environment", words, EnvironmentFault.exit_code)
    return Ending("internal error", words, EXIT_BUG)


def _write_result(data: Mapping[str, Any], folder: Path) -> None:
    _write(folder / "result.json", json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False))
    write_report(data, folder)


def write_report(data: Mapping[str, Any], folder: Path) -> None:
    """Write ``report.html`` and ``junit.xml`` from the content of ``result.json``."""
    page, xml = render(data, folder), junit_xml(data)
    _write(folder / "report.html", page)
    _write(folder / "junit.xml", xml)


def _write(path: Path, text: str) -> None:
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


# --- steps -----------------------------------------------------------------------------------------------------------


def _run_steps(loaded: LoadedRecipe, work: Workspace, report: Callable[[str, str], None]) -> Iterator[dict[str, Any]]:
    """Run each step and yield its entry, also that of a step which ends the run."""
    for name, step in loaded.recipe.step.items():
        report(name, step.kind)
        missing = [target for _, target, _ in references(step) if target not in work.values]
        if missing:
            yield _entry(name, step, error=f"it needs step {missing[0]!r}, which gave nothing")
            continue
        work.step = name
        begun = time.monotonic()
        entry: dict[str, Any] = {}
        try:
            outcome = step.run(work)
            if step.verify or loaded.recipe.verify:
                outcome = verified(outcome, work.kept.get(name, []), step.verify)
        except NoTrustworthyNumber as error:
            error.hint = step_hint(error, getattr(step, "do", ""))
            entry = _entry(name, step, status=str(Status.FAILED), error=str(error))
        except BaseException as error:
            ending = _ending_of(error)
            seconds = round(time.monotonic() - begun, 3)
            yield _entry(name, step, status=ending.how, error=ending.message, seconds=seconds)
            if isinstance(error, RobustlabError):
                raise at_step(error, loaded, name) from error
            raise
        else:
            work.values[name] = outcome.value
            status = str(outcome.status) if outcome.status else DONE
            figures = [{"stem": stem, "caption": caption} for stem, caption in work.figures.get(name, [])]
            entry = _entry(
                name, step, status=status, trustworthy=outcome.status is None or outcome.status.trustworthy,
                summary=outcome.summary, numbers={**plain(outcome.numbers), "status": status},
                facts=[vars(fact) for fact in outcome.facts], notes=list(outcome.notes), text=outcome.text,
                figures=figures,
            )  # fmt: skip
        yield {**entry, "seconds": round(time.monotonic() - begun, 3)}


def _entry(name: str, step: Step, **more: Any) -> dict[str, Any]:
    empty: dict[str, Any] = {
        "status": NOT_RUN, "trustworthy": False, "summary": "", "error": "", "numbers": {}, "facts": [], "notes": [],
        "text": "", "figures": [], "seconds": 0.0,
    }  # fmt: skip
    return {"name": name, "do": step.kind, "title": step.title, **empty, **more}


# --- result ----------------------------------------------------------------------------------------------------------


def _result(
    loaded: LoadedRecipe, work: Workspace, steps: list[dict[str, Any]], seconds: float, ending: Ending
) -> dict[str, Any]:
    recipe = loaded.recipe
    over = "the run has not finished" if ending.how == RUNNING else "the run ended before it"
    rest = list(recipe.step.items())[len(steps) :]
    steps = [*steps, *(_entry(name, step, error=over) for name, step in rest)]
    numbers = {s["name"]: s["numbers"] for s in steps if not s["error"]}
    missing = {s["name"]: f"step {s['name']!r} gave no number ({s['status']})" for s in steps if s["error"]}
    judgements = [_with_free_run(judge(r, numbers, missing), recipe, numbers) for r in recipe.require]
    if ending.exit_code is not None or ending.how == RUNNING:
        code = ending.exit_code
    elif any(j.misstated for j in judgements):
        code = InputError.exit_code
    elif not all(s["trustworthy"] for s in steps):
        code = NoTrustworthyNumber.exit_code
    else:
        code = EXIT_OK if all(j.met for j in judgements) else EXIT_REQUIREMENT_NOT_MET
    return {
        "schema": "robustlab.result/1",
        "command": "run",
        "exit_code": code,
        "ending": {"how": ending.how, "message": ending.message},
        "requirements": [j.to_json() for j in judgements],
        "steps": steps,
        "recipe": {
            **{name: getattr(recipe, name) for name in ("name", "title", "description")},
            "file": loaded.path.name,
            "sha256": hashlib.sha256(loaded.text.encode()).hexdigest(),
            "overrides": loaded.overrides,
            "text": loaded.text,
        },
        "seed": recipe.seed,
        "seconds": round(seconds, 3),
        "provenance": Provenance.now("robustlab run", work.inputs, recipe.seed).to_json(),
        "files": sorted({*work.files, *REPORT_FILES}),
    }


def _with_free_run(judged: Judgement, recipe: Recipe, numbers: Mapping[str, Any]) -> Judgement:
    """Add the number in free run to one that holds in windows, where the recipe does not require it."""
    that = judged.requirement.that
    name = that.split(".")[0]
    path = recipe.step[name].in_free_run(that)
    if path is None or judged.why_not:
        return judged
    required = (f"{path.rpartition('.')[0]}.", f"{name}.free_run.")
    others = [r.that for r in recipe.require if recipe.step[r.that.split(".")[0]].in_free_run(r.that) is None]
    if any(other.startswith(required) for other in others):
        return judged
    free = judge(judged.requirement.model_copy(update={"that": path}), numbers, {})
    return replace(judged, free_run={"value": free.value, "met": free.met})


def _files_of_previous_run(target: Path) -> set[str]:
    try:
        listed = read_result(target)["files"]
        return {name for name in map(str, listed) if (target / name).resolve().is_relative_to(target)}
    except (InputError, OSError, ValueError):
        return set()  # no earlier run of robustlab


def read_result(folder: str | Path) -> dict[str, Any]:
    path = Path(folder) / "result.json"
    where = str(path)
    require_file(path)
    data = parse_document("json", path.read_bytes(), where)
    if not isinstance(data, dict) or data.get("schema") != "robustlab.result/1" or data.get("command") != "run":
        raise InputError(where, "not the result of a run", "the result.json that robustlab run wrote")
    _check_parts({"ending": ending_of(data), **data}, RESULT_PARTS, "", where)
    return data


def _check_parts(data: Any, parts: Any, at: str, where: str) -> None:
    """Check ``data`` against a pattern: types, tables of patterns, or a list with the pattern of every entry."""
    kind: Any = type(parts) if isinstance(parts, (dict, list)) else parts
    if not isinstance(data, kind) or (kind is NUMBER and isinstance(data, bool)):
        raise InputError(where, f"{at or 'result'} is missing or has another form", "the JSON that robustlab run wrote")
    for key, part in parts.items() if isinstance(parts, dict) else ():
        _check_parts(data.get(key), part, f"{at}.{key}".lstrip("."), where)
    for i, item in enumerate(data if isinstance(parts, list) else ()):
        _check_parts(item, parts[0], f"{at}.{i}", where)


LONGEST_SLUG = 40  # characters; longer settings are named by their hash


def default_folder(loaded: LoadedRecipe) -> Path:
    """Return ``out/NAME``; changed settings are added, as ``first-light-seed-7``, or their hash."""
    name, changes = loaded.recipe.name, sorted(loaded.overrides.items())
    if not changes:
        return Path("out", name)
    slug = "-".join(re.sub(r"[^A-Za-z0-9.]+", "-", f"{key}-{value}").strip("-.") for key, value in changes)
    mark = hashlib.sha256(repr(changes).encode()).hexdigest()[:8]
    return Path("out", f"{name}-{slug if 0 < len(slug) <= LONGEST_SLUG else mark}")


def verified(outcome: Outcome, files: Sequence[Path], required: bool) -> Outcome:
    """Add the verification of its claims to an outcome; its status is no better than theirs."""
    own = [] if outcome.status is None else [outcome.status]
    found = [rl.verify(path) for path in files if claims_in_file(path)]
    if not found:
        if not required:
            return outcome
        note = "Nothing of this step can be verified: its result has no claims."
        return replace(outcome, status=least_trusted([*own, Status.INCONCLUSIVE]), notes=(*outcome.notes, note))
    facts = [
        Fact("Proved independently" if one.proved else "Refuted" if one.refuted else "Not proved independently", text,
             "verify")
        for one in found
        for text in (one.headline(), *(f"{label}: {text}" for label, text in one.facts() if text and label != "proved"))
    ]  # fmt: skip
    numbers = {**outcome.numbers, "verified": all(one.proved for one in found)}
    status = least_trusted([*own, *(one.status for one in found)])
    return replace(outcome, facts=(*outcome.facts, *facts), numbers=numbers, status=status)
