"""Read a recipe: TOML to a checked `Recipe`, all faults reported at once by their dotted keys; find its files.

A recipe is untrusted data: nothing in it is evaluated, and its size is limited.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pydantic import ValidationError

import robustlab as rl
from robustlab.errors import InputError, RobustlabError, UsageError, did_you_mean, rewritten, unknown_name
from robustlab.files.file_types import parse_document
from robustlab.operations.declaration import STEPS, in_toml
from robustlab.operations.parameter_types import Names, Table, Thing
from robustlab.recipe.builtin_recipes import shipped_folder, shipped_recipes
from robustlab.recipe.schema import Recipe, Requirement, recipe_model
from robustlab.recipe.steps.step import KINDS, Ahead, Inferred, Step, look_ahead
from robustlab.units import same_unit

MAX_BYTES = 1 << 20
MAX_FAULTS_SHOWN = 50

_REFUSED = {
    **dict.fromkeys((".yaml", ".yml"), "YAML reads 1e-3 as a text and 'no' as false, and its tags can run code"),
    **dict.fromkeys((".pkl", ".pickle"), "a pickle runs code when it is read"),
    ".py": "a program is not a recipe",
    ".json": "JSON has no comments, and a recipe explains itself",
}


@dataclass(frozen=True)
class LoadedRecipe:
    """A recipe with its file."""

    recipe: Recipe  # the checked recipe, with `--set` applied
    path: Path  # its file
    text: str  # the file's text as read
    overrides: dict[str, str]  # dotted key -> text of the value, as given with `--set`


def load_recipe(path: str | Path, overrides: Sequence[str] = ()) -> LoadedRecipe:
    file = Path(path)
    if file.suffix.lower() in _REFUSED:
        raise InputError(str(path), f"a {file.suffix} file: {_REFUSED[file.suffix.lower()]}", "a .toml recipe")
    if file.is_dir():
        raise InputError(str(path), "is a folder", "a .toml recipe")
    if not file.is_file():
        siblings = [p.name for p in file.parent.glob("*.toml")] if file.parent.is_dir() else []
        raise InputError(str(path), "no such file", None, did_you_mean(file.name, siblings))
    if file.stat().st_size > MAX_BYTES:
        raise InputError(str(path), f"{file.stat().st_size} bytes", f"at most {MAX_BYTES} bytes (1 MiB)")
    raw = file.read_bytes()
    given = split_overrides(overrides)
    data = parse_document("toml", raw, str(path))
    return LoadedRecipe(_checked(data, str(path), given), file.resolve(), raw.decode(), given)


def parse_recipe(text: str, where: str = "recipe", overrides: dict[str, str] | None = None) -> Recipe:
    """Return the checked recipe of a TOML text; see `load_recipe`."""
    return _checked(parse_document("toml", text.encode("utf-8", "surrogatepass"), where), where, overrides)


def _checked(data: dict[str, Any], where: str, overrides: dict[str, str] | None) -> Recipe:
    for key, value in (overrides or {}).items():
        _override(data, key, value)
    more = 0
    try:
        recipe = recipe_model().model_validate(data)
    except ValidationError as error:
        # Only the faults shown are worded: each may compare names.
        errors = error.errors(include_url=False)
        faults = list(dict.fromkeys(_fault(e, data) for e in errors[:MAX_FAULTS_SHOWN]))
        more = max(len(errors) - MAX_FAULTS_SHOWN, 0)
    else:
        faults = _reference_faults(recipe)
        if not faults:
            return recipe
        faults, more = faults[:MAX_FAULTS_SHOWN], max(len(faults) - MAX_FAULTS_SHOWN, 0)
    if len(faults) == 1:
        key, _, found = faults[0].partition(": ")
        raise InputError(f"{where}: {key}", found)
    shown = [*faults, f"and {more} more"] if more else faults
    raise InputError(where, f"{len(faults) + more} faults", None, None, tuple(f"  {fault}" for fault in shown))


def _fault(error: Any, data: dict[str, Any]) -> str:
    loc = [str(part) for part in error["loc"]]
    is_step = len(loc) >= 3 and loc[0] == "step" and loc[2] in KINDS
    if is_step:
        del loc[2]  # the tag of the union, which the user did not write
    if loc and loc[-1] == "[key]":
        loc.pop()
    key = ".".join(loc) or "recipe"
    match error["type"]:
        case "extra_forbidden":
            known = _known_keys(error["loc"])
            of = f"a step that does {error['loc'][2]} takes" if is_step else "there are"
            listed = f"; {of} {', '.join(known)}" if known else ""
            return f"{key}: unknown key{_suggestion(loc[-1], known)}{listed}"
        case "missing":
            return f"{key}: missing"
        case "union_tag_not_found":
            return f"{key}.do: missing, expected one of {', '.join(KINDS)}"
        case "union_tag_invalid":
            given = str(data["step"][error["loc"][1]]["do"])
            return (
                f"{key}.do: no such kind of step {given!r}{_suggestion(given, list(KINDS))}; one of {', '.join(KINDS)}"
            )
        case "string_pattern_mismatch":
            return f"{key}: {error['input']!r} has characters that are not allowed here"
    text = str(error["msg"])
    found = repr(error["input"])
    return f"{key}: {text[:1].lower()}{text[1:]}, found {found if len(found) <= 60 else f'{found[:57]}...'}"


def _suggestion(name: str, known: list[str]) -> str:
    hint = did_you_mean(name, known)
    return f" ({hint})" if hint else ""


def _known_keys(loc: tuple[Any, ...]) -> list[str]:
    if loc[0] == "step" and len(loc) == 4:
        return [name for name in KINDS[loc[2]].model_fields if name != "do"]
    if loc[0] == "require":
        return list(Requirement.model_fields)
    return [field.alias or name for name, field in Recipe.model_fields.items()] if len(loc) == 1 else []


# --- references between steps ----------------------------------------------------------------------------------------


def _reference_faults(recipe: Recipe) -> list[str]:
    faults: list[str] = []
    earlier: dict[str, Step] = {}
    for name, step in recipe.step.items():
        for field, target, wanted in references(step):
            key = f"step.{name}.{field}"
            if target in earlier:
                gives = earlier[target].gives
                if gives not in wanted:
                    expected = " or ".join(w for w in wanted if w != "any")
                    faults.append(f"{key}: step {target!r} gives {gives}, expected a step that gives {expected}")
            elif target in recipe.step:
                faults.append(f"{key}: step {target!r} comes later; steps run in the order written")
            else:
                near = _suggestion(target, list(earlier)) if len(faults) < MAX_FAULTS_SHOWN else ""
                faults.append(f"{key}: no step {target!r} before this one{near}")
        earlier[name] = step
    for i, requirement in enumerate(recipe.require):
        target = requirement.that.split(".")[0]
        if target not in recipe.step:
            near = _suggestion(target, list(recipe.step)) if len(faults) < MAX_FAULTS_SHOWN else ""
            faults.append(f"require.{i}.that: no step {target!r}{near}")
        elif "." not in requirement.that:
            faults.append(
                f"require.{i}.that: {target!r} names a step, expected one of its numbers, such as {target}.status"
            )
    return faults


def references(step: Step) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return each reference of a step: its key, the step it names, and what that step must give."""
    found: list[tuple[str, str, tuple[str, ...]]] = []
    for name, mark in marked(step, Thing):
        target = getattr(step, name)
        if isinstance(target, list):
            found += [(f"{name}.{i}", item, mark.gives) for i, item in enumerate(target)]
        elif isinstance(target, str):  # some keys take a number instead
            found.append((name, target, mark.gives))
    return found


def marked(step: Step, kind: Any) -> list[tuple[str, Any]]:
    """Return the fields of a step that have a mark of this kind, each with its first one."""
    found: list[tuple[str, Any]] = []
    for name, field in type(step).model_fields.items():
        # An optional field keeps its mark inside the union, a list of references inside the list.
        marks = [m for m in (*field.metadata, *_metadata(field.annotation)) if isinstance(m, kind)]
        found += [(name, mark) for mark in marks[:1]]
    return found


def _metadata(annotation: Any) -> Iterator[Any]:
    yield from getattr(annotation, "__metadata__", ())
    for inner in getattr(annotation, "__args__", ()):
        yield from _metadata(inner)


# --- overrides -------------------------------------------------------------------------------------------------------


def split_overrides(items: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"--set {item}", "no key and value", "--set key=value", "for example --set seed=7")
        found[key.strip()] = value.strip()
    return found


def _override(data: dict[str, Any], key: str, text: str) -> None:
    """Put a value into the recipe's data; text that is no TOML value is taken as plain text."""
    where = f"--set {key}"
    parts = key.split(".")
    steps = data.get("step")
    steps = steps if isinstance(steps, dict) else {}
    top = [field.alias or name for name, field in Recipe.model_fields.items()]
    if parts[0] in steps and parts[0] not in top:
        parts.insert(0, "step")
    if parts[0] not in top:
        known = [*top, *steps]
        raise UsageError(
            where, f"no step and no key {parts[0]!r}", f"one of {', '.join(known)}", did_you_mean(parts[0], known)
        )
    if parts[0] == "step" and (len(parts) < 3 or parts[1] not in steps):
        hint = did_you_mean(parts[1], list(steps)) if len(parts) > 1 else None
        raise UsageError(where, "names no key of a step", f"step.NAME.KEY with a step of {', '.join(steps)}", hint)
    try:
        value = tomllib.loads(f"x = {text}")["x"] if "\n" not in text else text
    except (ValueError, RecursionError):
        value = text
    target: Any = data
    *outer, last = parts
    try:
        for part in outer:
            target = target[int(part)] if isinstance(target, list) else target.setdefault(part, {})
        target[int(last) if isinstance(target, list) else last] = value
    except (AttributeError, IndexError, TypeError, ValueError):
        raise UsageError(where, f"{last!r} is inside a value", "a key that holds a value") from None


def find_file(loaded: LoadedRecipe, name: str, step: Step) -> Path | None:
    """Return the file that a step reads, None where it reads none.

    A path is searched in the recipe's folder, the folder above it, and the working directory; one given with ``--set``
    in the working directory first. Models and Python files of plants must be in the recipe's folder or the folder above
    it, unless given with ``--set``.
    """
    key, given = step.reads
    if given is None:
        return None
    typed = any(k.removeprefix("step.") == f"{name}.{key}" for k in loaded.overrides)
    path = _find(f"{loaded.path.name}: step.{name}.{key}", given, loaded.path.parent, typed, getattr(step, "about", ""))
    folder = loaded.path.parent
    roots = [folder, folder.parent] if folder.parent.parent != folder.parent else [folder]  # never the whole disk
    if step.gives == "record" or typed or any(path.is_relative_to(root) for root in roots):
        return path
    raise InputError(
        loaded.path.name,
        f'step.{name}.{key} = "{given}" leaves the recipe folder',
        f"a file in {' or '.join(map(str, roots))}",
        f"to read it all the same, type --set {name}.{key}={given}",
    )


def _find(where: str, given: str, folder: Path, typed: bool, about: str) -> Path:
    if "\0" in given:
        raise InputError(where, "a path with a NUL character", "a path")
    near, here = [folder, folder.parent], [Path.cwd()]
    places = here + near if typed else near + here
    candidates = list(dict.fromkeys((place / given).resolve() for place in places))  # one of an absolute path
    try:
        for path in candidates:
            if path.is_file():
                return path
            if path.exists():
                raise InputError(where, f"{path} is not a regular file", "a file")
    except OSError as error:  # a name too long, a folder that may not be read
        raise InputError(where, f"{given}: {error.strerror}", "a file") from None
    siblings = sorted({p.name for c in candidates if c.parent.is_dir() for p in c.parent.iterdir()})
    step = where.rpartition("step.")[2]
    near_name = did_you_mean(Path(given).name, siblings)
    hint = f"{near_name + ' or ' if near_name else ''}point to a copy with --set {step}=FILE"
    looked = ", ".join(str(path.parent) for path in candidates)
    raise InputError(where, f"{given}: no such file (looked in {looked})", None, hint, tuple(about.splitlines()))


def recipe_path(given: str) -> Path:
    path = Path(given)
    if path.is_file() or path.suffix or len(path.parts) > 1:
        return path  # `load_recipe` checks it
    if given in shipped_recipes():
        return shipped_folder() / f"{given}.toml"
    names = shipped_recipes()
    files = sorted(file.name for file in Path().glob("*.toml"))
    hint = did_you_mean(given, [*names, *files]) or "robustlab run --list, or robustlab recipe new NAME for your own"
    raise InputError(
        given, "neither a file nor a recipe that comes with robustlab", f"a path, or one of {', '.join(names)}", hint
    )


# --- checks before the first step: files, signals, units and required results ----------------------------------------
# What needs a computation is not checked (`robustlab.recipe.steps.step.Step.infer`).

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
    if not error.hint:
        return None
    if word in STEPS:
        return STEPS[word].hint(error.hint, of_command=False)
    return rewritten(error.hint, lambda name, value: f"{name} = {in_toml(value)}")


def _wrong_kinds(step: Step, ahead: Ahead) -> list[InputError]:
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
