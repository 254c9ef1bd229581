"""Running a recipe: its steps in the order written, its requirements judged, everything written to one folder.

::

    out/NAME/result.json    everything: requirements, steps, numbers, provenance, the recipe itself
    out/NAME/report.html    the same for reading
    out/NAME/junit.xml      the requirements for a CI system
    out/NAME/figures/       each figure as SVG, with --png as PNG, too
    out/NAME/evidence/      results with what is needed to check them again, as HDF5
    out/NAME/*.h5           what save steps wrote

Where nobody says where, each recipe and each choice of settings has a folder of its own.

A report is there from the beginning: first one that says that the run has not finished, which takes the place of an
earlier run's, and in its place the run's own, however that ends. So no old report can be taken for that of this run.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
from robustlab.evidence import Verified
from robustlab.files.atomic import atomic_write
from robustlab.files.document import parse_document
from robustlab.files.signature import require_file
from robustlab.provenance import Provenance, file_sha256
from robustlab.recipe.check import at_step, look_through, step_hint
from robustlab.recipe.load import LoadedRecipe, references
from robustlab.recipe.schema import Judgement, Recipe, judge
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace
from robustlab.report.html import ending_of, junit_xml, render
from robustlab.result import Status, least_trusted, plain
from robustlab.shown import Facts, Shown, listed
from robustlab.verification.reading import claims_in_file

DONE, NOT_RUN = "done", "not run"
FINISHED, RUNNING = "finished", "running"
REPORT_FILES = ("report.html", "junit.xml", "result.json")

NUMBER = (int, float)
# What the report reads in result.json, and the type of each.
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
class RunResult(Shown):
    """A finished run.

    Attributes
    ----------
    data
        Content of ``result.json``.
    folder
        Where everything was written.
    """

    data: Mapping[str, Any]
    folder: Path

    def facts(self) -> Facts:
        """Recipe, requirements, steps with their status."""
        asked, steps = self.data["requirements"], self.data["steps"]
        return [
            ("recipe", str(self.data["recipe"]["name"])),
            ("requirements", f"{sum(bool(q['met']) for q in asked)} of {len(asked)} met"),
            ("steps", listed(f"{s['name']} ({s['status'] or 'no status'})" for s in steps)),
            ("exit code", str(self.exit_code)),
            ("folder", str(self.folder)),
        ]

    @property
    def exit_code(self) -> int:
        """0 all requirements met, 1 one is not, 4 a step ended without a trustworthy number."""
        return int(self.data["exit_code"])


@contextmanager
def _workplace(target: Path, out: str | Path) -> Iterator[Path]:
    """A hidden folder beside ``target``, where the results lie until the run is through; it vanishes with the run."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name}-running-", dir=target.parent))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise EnvironmentFault(str(out), f"cannot be made ({reason})", "a folder to write results into") from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@dataclass
class Ending:
    """How a run ended, or that it has not."""

    how: str  # finished, running, interrupted, bad input, environment, internal error
    message: str = ""  # what ended it
    exit_code: int | None = None  # None where the requirements and the steps tell it


def run_recipe(
    loaded: LoadedRecipe,
    out: str | Path,
    report: Callable[[str, str], None] = lambda _name, _kind: None,
    png: bool = False,
) -> RunResult:
    """Run a recipe and write its results into ``out``.

    From the first moment the report there says that the run has not finished. However it ends, also by an error, by
    Ctrl-C or by a fault of ours, the report is then that of this run: what was done, what failed, what was not run.
    """
    started = time.monotonic()
    target = Path(out).resolve()
    if target.exists() and not target.is_dir():
        raise EnvironmentFault(str(out), "is a file", "a folder to write results into")
    with _workplace(target, out) as folder:
        workspace = Workspace(folder, {}, loaded.recipe.seed, target.with_name(f".{target.name}-unfinished"))
        workspace.png = png
        steps: list[dict[str, Any]] = []
        _announce(loaded, workspace, target)
        ending = Ending(FINISHED)
        try:
            workspace.ahead = look_through(loaded)
            workspace.sources = workspace.ahead.sources
            workspace.inputs = {f"{name}: {path.name}": file_sha256(path) for name, path in workspace.sources.items()}
            for entry in _run_steps(loaded, workspace, report):
                steps.append(entry)
        except BaseException as error:
            ending = _ending_of(error)
            raise
        finally:
            data = _result(loaded, workspace, steps, time.monotonic() - started, ending)
            _write_result(data, folder)
            _publish(folder, target)
    return RunResult(data, target)


def _ending_of(error: BaseException) -> Ending:
    """What ended a run before its end."""
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


def _announce(loaded: LoadedRecipe, workspace: Workspace, target: Path) -> None:
    """Put a report that says that the run has not finished in the place of an earlier one.

    The files of the earlier run are listed as its own: the run that is through removes them.
    """
    began = Provenance.now("robustlab run").created
    data = _result(loaded, workspace, [], 0.0, Ending(RUNNING, f"begun {began}"))
    data["files"] = sorted({*data["files"], *_files_of_previous_run(target)})
    target.mkdir(parents=True, exist_ok=True)
    _write_result(data, target)


def _write_result(data: Mapping[str, Any], folder: Path) -> None:
    _write(folder / "result.json", json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False))
    write_report(data, folder)


def write_report(data: Mapping[str, Any], folder: Path) -> None:
    """Write ``report.html`` and ``junit.xml`` from the content of ``result.json``."""
    page, xml = render(data, folder), junit_xml(data)
    _write(folder / "report.html", page)
    _write(folder / "junit.xml", xml)


# --- steps -----------------------------------------------------------------------------------------------------------


def _run_steps(
    loaded: LoadedRecipe, workspace: Workspace, report: Callable[[str, str], None]
) -> Iterator[dict[str, Any]]:
    """The entry of each step as it is done; also that of one which ends the run."""
    for name, step in loaded.recipe.step.items():
        report(name, step.kind)
        missing = [target for _, target, _ in references(step) if target not in workspace.values]
        if missing:
            yield _entry(name, step, NOT_RUN, f"it needs step {missing[0]!r}, which gave nothing")
            continue
        workspace.step = name
        begun = time.monotonic()
        try:
            outcome = step.run(workspace)
            if step.verify or loaded.recipe.verify:
                outcome = verified(outcome, workspace.kept.get(name, []), step.verify)
        except NoTrustworthyNumber as error:
            error.hint = step_hint(error, getattr(step, "do", ""))
            entry = _entry(name, step, str(Status.FAILED), str(error))
        except BaseException as error:
            ending = _ending_of(error)
            yield {**_entry(name, step, ending.how, ending.message), "seconds": round(time.monotonic() - begun, 3)}
            if isinstance(error, RobustlabError):
                raise at_step(error, loaded, name) from error
            raise
        else:
            workspace.values[name], workspace.numbers[name] = outcome.value, outcome.numbers
            entry = _done(name, step, outcome, workspace.figures.get(name, []))
        yield {**entry, "seconds": round(time.monotonic() - begun, 3)}


def _done(name: str, step: Step, outcome: Outcome, figures: list[tuple[str, str]]) -> dict[str, Any]:
    """The entry of a step that is done."""
    status = outcome.status
    return {
        **_entry(name, step),
        "status": str(status) if status else DONE,
        "trustworthy": status is None or status.trustworthy,
        "summary": outcome.summary,
        "numbers": {**plain(outcome.numbers), "status": str(status) if status else DONE},
        "facts": [vars(fact) for fact in outcome.facts],
        "story": [vars(fact) for fact in outcome.story],
        "notes": list(outcome.notes),
        "text": outcome.text,
        "figures": [{"stem": stem, "caption": caption} for stem, caption in figures],
    }


def _entry(name: str, step: Step, status: str = NOT_RUN, error: str = "") -> dict[str, Any]:
    """The entry of a step that gave nothing."""
    return {
        "name": name,
        "do": step.kind,
        "title": step.title,
        "status": status,
        "trustworthy": False,
        "summary": "",
        "error": error,
        "numbers": {},
        "facts": [],
        "story": [],
        "notes": [],
        "text": "",
        "figures": [],
        "seconds": 0.0,
    }


# --- result ----------------------------------------------------------------------------------------------------------


def _result(
    loaded: LoadedRecipe, workspace: Workspace, steps: list[dict[str, Any]], seconds: float, ending: Ending
) -> dict[str, Any]:
    recipe = loaded.recipe
    over = "the run has not finished" if ending.how == RUNNING else "the run ended before it"
    rest = list(recipe.step.items())[len(steps) :]
    steps = [*steps, *(_entry(name, step, NOT_RUN, over) for name, step in rest)]
    numbers = {s["name"]: s["numbers"] for s in steps if not s["error"]}
    missing = {s["name"]: f"step {s['name']!r} gave no number ({s['status']})" for s in steps if s["error"]}
    judgements = [_with_free_run(judge(asked, numbers, missing), recipe, numbers) for asked in recipe.require]
    if ending.exit_code is not None or ending.how == RUNNING:
        code = ending.exit_code
    elif any(j.misstated for j in judgements):
        code = InputError.exit_code
    elif not all(s["trustworthy"] for s in steps):
        code = NoTrustworthyNumber.exit_code
    else:
        code = EXIT_OK if all(j.met for j in judgements) else EXIT_REQUIREMENT_NOT_MET
    provenance = Provenance.now("robustlab run", workspace.inputs, recipe.seed)
    return {
        "schema": "robustlab.result/1",
        "command": "run",
        "exit_code": code,
        "ending": {"how": ending.how, "message": ending.message},
        "requirements": [j.to_json() for j in judgements],
        "steps": steps,
        "recipe": {
            "name": recipe.name,
            "title": recipe.title,
            "description": recipe.description,
            "file": loaded.path.name,
            "origin": recipe_origin(loaded),
            "sha256": hashlib.sha256(loaded.text.encode()).hexdigest(),
            "overrides": loaded.overrides,
            "text": loaded.text,
        },
        "seed": recipe.seed,
        "seconds": round(seconds, 3),
        "provenance": provenance.to_json(),
        "files": sorted({*workspace.files, *REPORT_FILES}),
    }


def _with_free_run(judged: Judgement, recipe: Recipe, numbers: Mapping[str, Any]) -> Judgement:
    """With the same number in free run beside one that holds in windows, where the recipe does not ask for that."""
    that = judged.requirement.that
    name = that.split(".")[0]
    path = recipe.step[name].in_free_run(that)
    if path is None or judged.why_not:
        return judged
    asked = (f"{path.rpartition('.')[0]}.", f"{name}.free_run.")
    others = [r.that for r in recipe.require if recipe.step[r.that.split(".")[0]].in_free_run(r.that) is None]
    if any(other.startswith(asked) for other in others):
        return judged
    free = judge(judged.requirement.model_copy(update={"that": path}), numbers, {})
    return replace(judged, free_run={"value": free.value, "met": free.met})


def recipe_origin(loaded: LoadedRecipe) -> str:
    """What tells one recipe file from another of the same name: a hash of its place, which names no folder."""
    return _origin(loaded.path)


def _origin(path: Path) -> str:
    return hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]


def _write(path: Path, text: str) -> None:
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _publish(folder: Path, target: Path) -> None:
    """Move the files of a finished run to their place, ``result.json`` last; remove what only the previous run had."""
    fresh = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    fresh.sort(key=lambda path: path.name == "result.json")
    stale = _files_of_previous_run(target)
    for path in fresh:
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).replace(target / path)
    for name in stale - {path.as_posix() for path in fresh}:
        (target / name).unlink(missing_ok=True)


def _files_of_previous_run(target: Path) -> set[str]:
    try:
        listed = read_result(target)["files"]
        return {name for name in map(str, listed) if (target / name).resolve().is_relative_to(target)}
    except (InputError, OSError, ValueError):
        return set()  # no earlier run, or not one of ours: nothing to remove


def read_result(folder: str | Path) -> dict[str, Any]:
    """Content of ``result.json`` of a finished run."""
    path = Path(folder) / "result.json"
    try:
        require_file(path)
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(str(path), f"not readable: {error}", "the JSON that robustlab run wrote") from None
    where = str(path)
    data = parse_document("json", raw, where)
    if not isinstance(data, dict) or data.get("schema") != "robustlab.result/1" or data.get("command") != "run":
        raise InputError(where, "not the result of a run", "the result.json that robustlab run wrote")
    _check_parts({"ending": ending_of(data), **data}, RESULT_PARTS, "", where)
    return data


def _check_parts(data: Any, parts: Any, at: str, where: str) -> None:
    """``data`` against a pattern: types, tables of patterns, or a list with the pattern of every entry."""
    kind: Any = type(parts) if isinstance(parts, (dict, list)) else parts
    fits: bool = isinstance(data, kind)
    if not fits or (kind is NUMBER and str(data) in ("True", "False")):  # a bool is an int to Python
        raise InputError(where, f"{at or 'result'} is missing or has another form", "the JSON that robustlab run wrote")
    for key, part in parts.items() if isinstance(parts, dict) else ():
        _check_parts(data.get(key), part, f"{at}.{key}".lstrip("."), where)
    for i, item in enumerate(data if isinstance(parts, list) else ()):
        _check_parts(item, parts[0], f"{at}.{i}", where)


LONGEST_SLUG = 40  # characters; longer settings are told by their hash


def default_folder(loaded: LoadedRecipe, root: str | Path = "out") -> Path:
    """The folder of this recipe with these settings below ``root``.

    ``NAME`` where it is free or holds an earlier run of the same recipe file with the same settings; else ``NAME`` and
    the settings, as in ``first-light-seed-7``; else ``NAME`` and a hash. So no other recipe's and no other setting's
    report is overwritten, and the same command comes back to the same folder.
    """
    name, root = loaded.recipe.name, Path(root)
    changes = sorted(loaded.overrides.items())
    mark = hashlib.sha256(repr((recipe_origin(loaded), changes)).encode()).hexdigest()[:8]
    slug = "-".join(re.sub(r"[^A-Za-z0-9.]+", "-", f"{key}-{value}").strip("-.") for key, value in changes)
    names = [name]
    if slug and len(slug) <= LONGEST_SLUG:
        names.append(f"{name}-{slug}")
    for candidate in names:
        folder = root / candidate
        earlier = _earlier(folder)
        if not folder.is_symlink() and (earlier is None or _same(earlier, loaded)):
            return folder
    return root / f"{name}-{mark}"


def replaced(folder: Path, loaded: LoadedRecipe) -> str:
    """What a run into ``folder`` replaces, in words; empty where nothing, or the same recipe with the same settings."""
    earlier = _earlier(folder)
    if not earlier:
        return ""
    recipe = earlier["recipe"]
    if _same(earlier, loaded) and recipe["sha256"] == hashlib.sha256(loaded.text.encode()).hexdigest():
        return ""
    settings = ", ".join(f"{key}={value}" for key, value in recipe["overrides"].items()) or "no changed settings"
    what = "an earlier text of the recipe" if _same(earlier, loaded) else f"recipe {recipe['name']} with {settings}"
    return f"{folder} held the report of {what}; this run replaced it"


def _earlier(folder: Path) -> Mapping[str, Any] | None:
    """The result that lies there; None without one; an empty table where it is not readable, and so somebody else's."""
    if not (folder / "result.json").exists():
        return None
    try:
        return read_result(folder)
    except InputError:
        return {}


def _same(earlier: Mapping[str, Any], loaded: LoadedRecipe) -> bool:
    recipe = earlier.get("recipe", {})
    origin = recipe.get("origin", "")
    return recipe.get("overrides") == loaded.overrides and origin in ("", recipe_origin(loaded))


def verified(outcome: Outcome, files: Sequence[Path], asked: bool) -> Outcome:
    """The outcome with what became of its claims; its status is no better than theirs."""
    found = [rl.verify(path) for path in files if claims_in_file(path)]
    if not found:
        if not asked:
            return outcome
        note = "Nothing of this step can be verified: what it found holds no claims."
        return replace(outcome, status=_with(outcome, [rl.Status.INCONCLUSIVE]), notes=(*outcome.notes, note))
    facts = [
        Fact(_label(one), text, "verify")
        for one in found
        for text in (one.headline(), *(f"{label}: {said}" for label, said in one.facts() if said and label != "proved"))
    ]
    numbers = {**outcome.numbers, "verified": all(one.proved for one in found)}
    status = _with(outcome, [one.status for one in found])
    return replace(outcome, facts=(*outcome.facts, *facts), numbers=numbers, status=status)


def _label(one: Verified) -> str:
    return "Proved independently" if one.proved else "Refuted" if one.refuted else "Not proved independently"


def _with(outcome: Outcome, statuses: Sequence[rl.Status]) -> rl.Status:
    """What is proved does not become better trusted than it was."""
    own = [] if outcome.status is None else [outcome.status]
    return least_trusted([*own, *statuses])
