"""``robustlab run``, ``recipe``, ``report``, ``verify`` and ``doctor``: recipes, their runs, and the installation."""

from __future__ import annotations

import json
import re
import tempfile
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperGroup

import robustlab as rl
from robustlab.cli.console import emit, note, result_alone, shown
from robustlab.cli.generated import RECIPE_FILE, ChangesOption, JsonOption, ProgressOption, RecipeArgument
from robustlab.display import text_table as table
from robustlab.errors import (
    EXIT_OK,
    EXIT_REQUIREMENT_NOT_MET,
    EnvironmentFault,
    InputError,
    NoTrustworthyNumber,
    RobustlabError,
    UsageError,
    did_you_mean,
)

if TYPE_CHECKING:
    from robustlab.recipe.run import RunResult

WIDTH = 44  # of a step's line, before its time


class _FolderOrCommand(TyperGroup):
    """``robustlab report RUN_DIR`` is short for ``robustlab report write RUN_DIR``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "--help"):
            args = ["write", *args]
        return super().parse_args(ctx, args)


RUN, RECIPE, VERIFY, DOCTOR = (typer.Typer() for _ in range(4))
REPORT = typer.Typer(cls=_FolderOrCommand)


@RUN.command()
def run(
    recipe: Annotated[str | None, RECIPE_FILE] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the recipes that come with robustlab.")] = False,
    changes: ChangesOption = None,
    out: Annotated[
        str | None,
        typer.Option(
            "--out", "-o", help="Folder to write.  [default: out/NAME; another folder for each choice of settings]"
        ),
    ] = None,
    png: Annotated[bool, typer.Option("--png", help="Draw the figures as PNG, too.")] = False,
    figures: Annotated[
        Literal["required", "all"],
        typer.Option("--figures", help="Steps whose figures are drawn: those that requirements name, or all."),
    ] = "required",
    progress: ProgressOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Run a recipe, judge its requirements, and write report.html, result.json, junit.xml and the figures.

    Without --out each recipe and each choice of settings has a folder of its own. The
    report is written however the run ends; until then it shows that the run has not finished.

    Exit code 0: all requirements met; 1: one is not; 3: the recipe requires a missing number; 4: a step ended without
    a trustworthy number.

    Example: robustlab run first-light --set seed=7 --out out/first-light
    """
    if listed or recipe is None:
        from robustlab.recipe.builtin_recipes import shipped_titles

        titles = list(shipped_titles().items())
        if not listed:
            lines, hint = tuple(f"  {line}" for line in table(titles).splitlines()), "robustlab run first-light"
            raise UsageError("robustlab run", "RECIPE is missing", "a recipe file, or one of these", hint, lines)
        emit("run", {"recipes": dict(titles)}, table(titles, ("recipe", "title")), as_json)
        return
    from robustlab.recipe.load import load_recipe, recipe_path
    from robustlab.recipe.run import default_folder, read_result, run_recipe
    from robustlab.report.html import ending_of

    path = recipe_path(recipe)
    loaded = load_recipe(path, changes or [])
    folder = Path(out) if out else default_folder(loaded)
    count = len(loaded.recipe.step)
    begun, since = list[str](), [0.0]
    result_alone()  # the recipe may run a user's code
    with shown(progress, "run", count, lines=True, budgets=False) as display:

        def ended() -> None:
            if begun:
                display.done(f"{begun[-1]:<{WIDTH}} {time.monotonic() - since[0]:6.1f} s")

        def begin(name: str, kind: str) -> None:
            ended()
            since[0] = time.monotonic()
            begun.append(f"[{len(begun) + 1}/{count}] {name} ({kind})")
            display.step(len(begun) - 1, begun[-1])

        try:
            result = run_recipe(loaded, folder, begin, png, figures)
        except BaseException:
            with suppress(InputError):  # no report was written
                if ending_of(read_result(folder))["how"] != "finished":
                    note(f"report of what was run: {folder.resolve() / 'report.html'}")
            raise
        ended()
    emit("run", {**result.data, "folder": str(result.folder)}, _text(result), as_json)
    raise typer.Exit(result.exit_code)


def _text(result: RunResult) -> str:
    from robustlab.report.html import found_in_words, in_windows_only, verdict_of

    data = result.data
    words = [(verdict_of(q), q) for q in data["requirements"]]
    rows = [(v if q["met"] else v.upper(), q["text"], found_in_words(q), q["condition"]) for v, q in words]
    doubtful = [
        f"no trustworthy number: step {s['name']}: {s['error'] or s['status']}"
        for s in data["steps"]
        if not s["trustworthy"]
    ]
    met = sum(q["met"] for q in data["requirements"])
    parts = [
        table(rows, ("", "requirement", "found", "condition")) if rows else "no requirement stated",
        *doubtful,
        *in_windows_only(data["requirements"]),
        f"{met} of {len(rows)} requirements met in {data['seconds']:.1f} s",
        f"report: {result.folder / 'report.html'}",
    ]
    return "\n\n".join(parts)


# --- recipe -----------------------------------------------------------------------------------------------------------


@RECIPE.command()
def check(recipe: RecipeArgument, changes: ChangesOption = None, as_json: JsonOption = False) -> None:
    """Check a recipe and the files it reads without running it: keys, files, signals, units, the results required.

    All errors are listed. Errors that occur only in a run are not found.

    Example: robustlab recipe check first-light
    """
    from robustlab.recipe.load import load_recipe, look_through, recipe_path

    loaded = load_recipe(recipe_path(recipe), changes or [])
    files = {name: str(path) for name, path in look_through(loaded).sources.items()}
    steps = [(name, step.kind, files.get(name, "")) for name, step in loaded.recipe.step.items()]
    count = len(loaded.recipe.require)
    text = f"{table(steps, ('step', 'does', 'reads'))}\n\ncan be run; steps: {len(steps)}, requirements: {count}"
    result = {"recipe": str(loaded.path), "steps": [list(step) for step in steps], "requirements": count}
    emit("recipe check", result, text, as_json)


@RECIPE.command()
def steps(
    kind: Annotated[str | None, typer.Argument(help="A kind of step: its keys. All kinds where left out.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the kinds of steps that a recipe may have, or the keys of one.

    Example: robustlab recipe steps record
    """
    from robustlab.recipe.load import KINDS
    from robustlab.recipe.schema import json_schema

    what = {word: " ".join((made.__doc__ or "").split("\n\n")[0].split()) for word, made in sorted(KINDS.items())}
    if kind is None:
        rows = [(word, KINDS[word].gives, re.split(r"(?<=[a-z)])[.] ", line)[0]) for word, line in what.items()]
        kinds = [{"do": word, "gives": KINDS[word].gives, "what": line} for word, line in what.items()]
        emit("recipe steps", {"steps": kinds}, table(rows, ("do =", "gives", "what it does")), as_json)
        return
    if kind not in KINDS:
        hint = did_you_mean(kind, list(KINDS)) or "robustlab recipe steps lists them"
        raise UsageError(f"recipe steps {kind}", "no such kind of step", f"one of {', '.join(what)}", hint)
    parts = json_schema()["$defs"].values()
    (part,) = [p for p in parts if p["properties"].get("do", {}).get("const") == kind]
    keys = {name: key for name, key in part["properties"].items() if name != "do"}
    rows = [
        (name, "needed" if name in part["required"] else json.dumps(key.get("default")),
         " ".join(key.get("description", "").split()))
        for name, key in keys.items()
    ]  # fmt: skip
    text = f'do = "{kind}": {what[kind]}\n\n{table(rows, ("key", "default", "meaning"))}'
    emit("recipe steps", {"do": kind, "what": what[kind], "keys": keys}, text, as_json)


@RECIPE.command()
def schema() -> None:
    """Print the JSON Schema of recipes, for editors that complete and check TOML.

    Example: robustlab recipe schema > recipe.schema.json
    """
    from robustlab.recipe.schema import json_schema

    print(json.dumps(json_schema(), indent=2))


@RECIPE.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the recipe, or folder/name; the file is NAME.toml.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing NAME.toml.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a small commented recipe to start from, NAME.toml in the working directory or in the folder before NAME.

    Example: robustlab recipe new my-motor && robustlab run my-motor.toml
    """
    from robustlab.recipe.builtin_recipes import write_starter

    path = write_starter(name, force=force)
    emit("recipe new", {"file": str(path)}, f"{path}\nrun it with: robustlab run {path}", as_json)


# --- report -----------------------------------------------------------------------------------------------------------

MOST_NUMBERS = 40  # of changed numbers in the list; --json has all


@REPORT.command()
def write(
    run_dir: Annotated[str, typer.Argument(help="The folder that robustlab run wrote.")], as_json: JsonOption = False
) -> None:
    """Write report.html and junit.xml again from result.json and figures of a finished run; nothing is computed again.

    The word write may be left out.

    Example: robustlab report out/first-light
    """
    from robustlab.recipe.run import read_result, write_report

    folder = Path(run_dir)
    write_report(read_result(folder), folder)
    files = [str(folder / name) for name in ("report.html", "junit.xml")]
    emit("report", {"files": files}, "\n".join(files), as_json)


@REPORT.command()
def compare(
    run1: Annotated[str, typer.Argument(help="The folder of the earlier run.")],
    run2: Annotated[str, typer.Argument(help="The folder of the later run.")],
    rtol: Annotated[float, typer.Option(min=0.0, help="Relative changes up to this count as none.")] = 0.01,
    as_json: JsonOption = False,
) -> None:
    """Requirements and numbers of two runs side by side, what changed, and what got worse.

    A run got worse if a requirement that was met is not met or not stated, if its number moved towards its limit or
    further beyond it, or if a step's number is no longer trustworthy.

    Exit code 0: nothing got worse; 1: something did.

    Example: robustlab report compare out/first-light out/first-light-seed-7
    """
    from robustlab.recipe.run import read_result
    from robustlab.report.html import compare_runs

    found = compare_runs(read_result(run1), read_result(run2), rtol)
    emit("report compare", {"runs": [run1, run2], **found}, _comparison(found, rtol), as_json)
    raise typer.Exit(EXIT_REQUIREMENT_NOT_MET if found["worse"] else EXIT_OK)


def _comparison(found: dict[str, Any], tolerance: float) -> str:
    parts = []
    if found["settings"]:
        parts.append("What was run:\n" + _table(found["settings"], ("", "first", "second")))
    header = ("", "requirement", "first", "second", "condition", "")
    rows = [(c["verdict"], *_cells(c), c["condition"], c["why"]) for c in found["requirements"]]
    parts.append(table(rows, header) if rows else "Neither run states a requirement.")
    if steps := [c for c in found["steps"] if c["verdict"] != "same"]:
        parts.append("Steps that ended otherwise:\n" + _table(steps, ("step", "first", "second")))
    if numbers := found["numbers"][:MOST_NUMBERS]:
        head = f"Numbers that differ by more than {100 * tolerance:g} %, the largest change first:\n"
        parts.append(head + _table(numbers, ("number", "first", "second")))
    left = len(found["numbers"]) - MOST_NUMBERS
    parts.append(f"{found['equal_numbers']} numbers do not differ" + f", {left} more do (--json)" * (left > 0))
    worse = [c["what"] for c in (*found["requirements"], *found["steps"]) if c["verdict"] == "WORSE"]
    parts.append(f"{len(worse)} got worse: {'; '.join(worse)}" if worse else "nothing got worse")
    return "\n\n".join(parts)


def _table(changes: list[dict[str, Any]], header: tuple[str, str, str]) -> str:
    return table([_cells(c) for c in changes], header)


def _cells(change: dict[str, Any]) -> tuple[str, str, str]:
    from robustlab.report.html import in_words

    first, second = ("-" if change[key] is None else in_words(change[key]) for key in ("first", "second"))
    return change["what"], first, second


# --- verify -----------------------------------------------------------------------------------------------------------


@VERIFY.command()
def verify(
    files: Annotated[list[str], typer.Argument(help="HDF5 files of results, or folders of runs.", metavar="FILE")],
    effort: Annotated[float, typer.Option("--effort", help="Work allowed, as a multiple of the usual.")] = 1.0,
    progress: ProgressOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Verify the claims of a result from its file alone: in exact and ball arithmetic, for all frequencies.

    Exit code 0: all claims were proved, and the displayed numbers agree with them. 4: a claim was not proved, or
    the file was changed after its claims were written. 1: a claim was refuted by a counterexample.

    Example: robustlab verify out/first-light
    """
    from robustlab.verification.files import claims_in_file

    chosen = {path: claims_in_file(path) for given in files for path in _files_in(given)}
    holding = {path: claims for path, claims in chosen.items() if claims}
    if not holding:
        hint = "files of earlier versions hold none; docs/proofs.md says which results have them"
        raise InputError(", ".join(files), "no claims", "results that were saved with their evidence", hint)
    found: dict[str, Any] = {}
    with shown(progress, "verify", len(holding), budgets=False) as display:
        for done, path in enumerate(holding):
            display.step(done, str(path))
            found[str(path)] = rl.verify(path, effort=effort)
    rows: list[str] = []
    for name, one in found.items():
        rows += [f"{name}: {one.headline()}", *(f"  {label}: {text}" for label, text in one.facts() if text)]
    rows += [f"{path}: no claims" for path in chosen if path not in holding]
    emit("verify", {"files": {name: one.to_json() for name, one in found.items()}}, "\n".join(rows), as_json)
    if any(one.refuted for one in found.values()):
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)
    if not all(one.proved for one in found.values()):
        raise typer.Exit(NoTrustworthyNumber.exit_code)


def _files_in(given: str) -> list[Path]:
    path = Path(given)
    if not path.is_dir():
        return [path]
    found = sorted([*path.glob("evidence/*.h5")] or [*path.glob("*.h5")])
    if not found:
        raise InputError(given, "a folder without HDF5 files", "a file of a result, or the folder of a run")
    return found


# --- doctor -----------------------------------------------------------------------------------------------------------


@DOCTOR.command()
def doctor(as_json: JsonOption = False) -> None:
    """Try every native library once and print the versions; exit code 5 where something needed is missing.

    Example: robustlab doctor
    """
    from robustlab.provenance import library_versions

    checks = {name: _outcome(check) for name, check in _CHECKS.items()}
    versions = library_versions()
    healthy = all(found.startswith("ok") for found in checks.values())
    verdict = "this installation can work" if healthy else "something needed is missing: see above"
    text = f"{table(list(checks.items()))}\n\n{table(list(versions.items()))}\n\n{verdict}"
    result: dict[str, Any] = {"healthy": healthy, "checks": checks, "versions": versions}
    emit("doctor", result, text, as_json)
    if not healthy:
        raise typer.Exit(EnvironmentFault.exit_code)


def _outcome(check) -> str:  # pyright: ignore[reportMissingParameterType]
    try:
        return f"ok: {check()}"
    except (ImportError, OSError, AssertionError, RobustlabError) as error:
        return f"missing: {type(error).__name__}: {error}"


def _solvers() -> str:
    import numpy as np
    from scipy.linalg import solve_continuous_are

    bounds = rl.mu(np.array([[0.0, 2.0], [2.0, 0.0]], dtype=complex), [rl.ComplexScalar("a"), rl.ComplexScalar("b")])
    assert abs(bounds.upper - 2.0) < 1e-6, f"mu of [[0, 2], [2, 0]] came out as {bounds.upper}, not 2"
    one = np.ones((1, 1))
    x = solve_continuous_are(0 * one, one, one, one)
    assert abs(x[0, 0] - 1.0) < 1e-12, f"x^2 = 1 came out as {x[0, 0]}"
    return "mu of a known matrix and a Riccati equation with a known answer are right"


def _cvxpy() -> str:
    cvxpy: Any = import_module("cvxpy")  # untyped
    x = cvxpy.Variable()
    try:
        found = cvxpy.Problem(cvxpy.Minimize(x), [x >= 1]).solve(solver="CLARABEL")
    except cvxpy.SolverError as error:
        raise EnvironmentFault("cvxpy", str(error), "a problem solved with Clarabel") from None
    assert abs(found - 1.0) < 1e-6, f"min x over x >= 1 came out as {found}"
    return f"cvxpy {cvxpy.__version__} solves with Clarabel"


def _hdf5() -> str:
    model = rl.ss(-1.0, 1.0, 1.0, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        again: Any = rl.load(rl.save(Path(folder) / "check.h5", model))
    assert (again.A == model.A).all(), "a matrix came back changed"
    return "HDF5 is written, and read in a process of its own, with checksums"


_CHECKS = {
    "mu, scipy": _solvers,
    "cvxpy": _cvxpy,
    "h5py": _hdf5,
    "matplotlib": lambda: f"matplotlib {import_module('matplotlib').__version__}",
}
