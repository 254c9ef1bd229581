"""Check a recipe before its first step runs: files, signals, units, and required results.

Values that need a computation are not checked here (`robustlab.recipe.steps.contract.Step.infer`).
"""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

import robustlab as rl
from robustlab.errors import InputError, RobustlabError, UsageError, rewritten, unknown_name
from robustlab.operations.declaration import STEPS, in_toml
from robustlab.operations.kinds import Names, Table
from robustlab.recipe.load import MAX_FAULTS_SHOWN, LoadedRecipe, find_file, marked, references
from robustlab.recipe.schema import Requirement
from robustlab.recipe.steps.contract import Ahead, Inferred, Step, look_ahead
from robustlab.units import same_unit

# Objects that a loaded file may hold, and those that a step may require.
HELD = (rl.StateSpaceModel, rl.UncertainModel, rl.Controller, rl.Record)
WANTED: dict[str, type] = {"uncertain": rl.UncertainModel, "record": rl.Record}


def look_through(loaded: LoadedRecipe) -> Ahead:
    """Infer what each step will give before anything runs; raise all faults found."""
    recipe = loaded.recipe
    sources: dict[str, Path] = {}
    ahead = Ahead(sources)
    faults: list[RobustlabError] = []
    for name, step in recipe.step.items():
        ahead.step, ahead.steps[name] = name, Inferred()
        try:
            path = find_file(loaded, name, step)
        except RobustlabError as error:
            faults.append(error)
            continue
        if path is not None:
            sources[name] = path
        wrong: list[RobustlabError] = [*_wrong_kinds(step, ahead), *_wrong_names(step, ahead)]
        if not any(fault.where.startswith((".inputs", ".outputs")) for fault in wrong):  # else it gave wrong names
            try:
                ahead.steps[name] = step.infer(ahead)
            except RobustlabError as error:
                wrong = wrong or [error]
        faults += [at_step(fault, loaded, name) for fault in wrong]
    for i, requirement in enumerate(recipe.require):
        name = requirement.that.split(".")[0]
        leaves = ahead[name].leaves if ahead[name].leaves is not ... else recipe.step[name].leaves
        if leaves is ...:
            continue
        proved = {"verified": bool} if name in recipe.step and (recipe.verify or recipe.step[name].verify) else {}
        try:
            _check_unit(requirement, look_ahead(requirement.that, {"status": str, **proved, **leaves}))
        except InputError as fault:
            key = f"{loaded.path.name}: require.{i}.{fault.where}"
            faults.append(InputError(key, fault.found, fault.expected, fault.hint))
    if len(faults) == 1:
        raise faults[0]
    if faults:
        lines: list[str] = []
        for fault in faults[:MAX_FAULTS_SHOWN]:
            hint = f" ({fault.hint})" if fault.hint else ""
            lines.append(f"  {fault.line.removeprefix(f'{loaded.path.name}: ')}{hint}")
            lines += [f"    {line.strip()}" for line in fault.more]
        if len(faults) > MAX_FAULTS_SHOWN:
            lines.append(f"  and {len(faults) - MAX_FAULTS_SHOWN} more")
        raise InputError(loaded.path.name, f"{len(faults)} faults", None, None, tuple(lines))
    return ahead


def at_step(error: RobustlabError, loaded: LoadedRecipe, name: str) -> RobustlabError:
    """Return the error with the step's name before it; a wrong use in a recipe is a wrong input."""
    kind = InputError if isinstance(error, UsageError) else type(error)
    colon = "" if error.where.startswith(".") else ": "  # a key of the step
    where = f"{loaded.path.name}: step.{name}{colon}{error.where}"
    return kind(
        where, error.found, error.expected, step_hint(error, getattr(loaded.recipe.step[name], "do", "")), error.more
    )


def step_hint(error: RobustlabError, word: str) -> str | None:
    """Return the hint of an error as a step of a recipe writes its arguments."""
    if not error.hint:
        return None
    if word in STEPS:
        return STEPS[word].hint(error.hint, of_command=False)
    return rewritten(error.hint, lambda name, value: f"{name} = {in_toml(value)}")


# --- steps -----------------------------------------------------------------------------------------------------------


def _wrong_kinds(step: Step, ahead: Ahead) -> list[InputError]:
    """Return a fault for each reference to a file whose object the step does not take."""
    found: list[InputError] = []
    for key, target, wanted in references(step):
        held = ahead[target].value
        kind = WANTED.get(wanted[0]) if set(wanted[1:]) <= {"any"} else None
        if kind is not None and isinstance(held, HELD) and not isinstance(held, kind):
            words = f"{'an' if kind is rl.UncertainModel else 'a'} {kind.__name__}"
            found.append(InputError(f".{key}", f"step {target!r} gives a {type(held).__name__}", words))
    return found


def _wrong_names(step: Step, ahead: Ahead) -> list[InputError]:
    """Return a fault for each name that is no signal or parameter of the step referred to."""
    found: list[InputError] = []
    for key, mark in marked(step, (Names, Table)):
        target, given = getattr(step, mark.of), getattr(step, key)
        known = _known(ahead[target], mark.side) if isinstance(target, str) else None
        if known is None or not given:
            continue
        named = {"": given} if isinstance(given, str) else dict(enumerate(given))
        for i, name in named.items():
            if name in known or ("*" in name and any(fnmatchcase(k, name) for k in known)):
                continue
            part = f".{name}" if isinstance(given, Mapping) else f".{i}".rstrip(".")
            found.append(unknown_name(f".{key}{part}", f"{name!r}: {target} has no such {mark.side[:-1]}", name, known))
    return found


def _known(inferred: Inferred, side: str) -> list[str] | None:
    if side == "parameters":
        parameters = getattr(inferred.value, "parameters", None)
        return None if parameters is None else list(parameters)
    sides = (inferred.outputs, inferred.inputs) if side == "signals" else (getattr(inferred, side),)
    return None if None in sides else [name for known in sides for name in known or ()]


def _check_unit(r: Requirement, unit: object) -> None:
    if r.unit and isinstance(unit, str) and unit and not same_unit(r.unit, unit):
        meant = "no unit: it is a pure number" if unit == "1" else f"{unit}, that of {r.that}"
        raise InputError("unit", r.unit, f"{meant} (a label converts nothing)")
