"""Plants in Python files of the user, ``path/to/file.py:name``: a plant, or a function that returns one."""

from __future__ import annotations

import hashlib
import keyword
import os
import re
import sys
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from inspect import Parameter, signature
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np

from robustlab.dynamics.plant_base import Plant
from robustlab.errors import (
    DependencyMissing,
    EnvironmentFault,
    InputError,
    RobustlabError,
    UsageError,
    did_you_mean,
    is_function,
)
from robustlab.files.atomic import atomic_write
from robustlab.files.file_types import require_file
from robustlab.provenance import BY_PLANT_FILE, Provenance, file_sha256

# Global variable of a plant file with its name for messages.
MARK = "__plant_file__"
# Package that plant files import -> extra of robustlab that installs it.
EXTRAS = {"casadi": "casadi", "fmpy": "fmi"}

# Modules that plant files imported from their own folder: two machines may each have a `parameters.py`.
_neighbours: dict[str, types.ModuleType] = {}


def plant_reference(text: str) -> tuple[str, str] | None:
    """Return file and name (possibly empty) of a plant in a Python file; None for any other text."""
    found = re.fullmatch(r"([^\0]+\.py)(?::(.*))?", text, re.DOTALL)
    return (found[1], found[2] or "") if found else None


def unit_reference(text: str) -> bool:
    """Return whether a text names the file of a functional mock-up unit (`robustlab.dynamics.fmu`)."""
    return text.lower().endswith(".fmu")


def plant_from_file(reference: str, parameters: Mapping[str, Any] | None = None, path: Path | None = None) -> Plant:
    """Return the plant ``file.py:name`` with the given parameters."""
    file, name = plant_reference(reference) or ("", "")
    if not file:
        raise InputError(reference, "names no file of Python", "path/to/file.py:name")
    module, hashes = _run(Path(file) if path is None else path, _display_name(file, path))
    label = f"{vars(module)[MARK]}:{name}"
    if name not in vars(module):
        found = f"no plant {name!r} in it" if name else "which plant of it?"
        file, names = vars(module)[MARK], _plants(module)
        choice = f"one of {', '.join(f'{file}:{known}' for known in names)}" if names else "a file that defines a plant"
        raise InputError(file, found, choice, did_you_mean(name, names))
    with _user_code(label):
        made = _made(vars(module)[name], dict(parameters or {}), label)
    _check_shapes(made, label)
    source = made.provenance
    known, note = ({}, "") if source is None else (source.inputs, f"; {source.note}" if source.note else "")
    made.traced(Provenance.now(BY_PLANT_FILE, {**known, **hashes}, note=label + note))
    return made


def plants_in_file(file: str) -> tuple[str, ...]:
    """Return the names in a file of `Plant` objects and of functions without required arguments."""
    return _plants(_run(Path(file), _display_name(file, None))[0])


def fault_of_user_code(error: Exception) -> RobustlabError | None:
    """Return the error to report if an exception passed through the code of a plant file, else None."""
    place = _place(error)
    return None if place is None else _user_error(error, place)


def _place(error: BaseException) -> str | None:
    """Return the innermost line of a plant file or of its modules in a traceback: ``"axis.py, line 12"``, or None."""
    place, folder = None, None
    for frame, line in walk_tb(error.__traceback__):
        file = Path(frame.f_code.co_filename)
        if MARK in frame.f_globals:
            place, folder = f"{frame.f_globals[MARK]}, line {line}", file.parent
        elif file.parent == folder:
            place = f"{file.name}, line {line}"
    return place


def _display_name(file: str, path: Path | None) -> str:
    """Return the file name for messages and provenance, relative to the working directory where possible."""
    given = Path(file)
    if path is not None:  # of a recipe, whose paths are relative to the recipe
        return path.name if given.is_absolute() else given.as_posix()
    there, here = given.resolve(), Path.cwd().resolve()
    return there.relative_to(here).as_posix() if there.is_relative_to(here) else file


def _run(path: Path, label: str) -> tuple[types.ModuleType, dict[str, str]]:
    """Execute a file; return its module, and file -> SHA-256 of all user code that was run for it."""
    try:
        is_empty = path.is_file() and path.stat().st_size == 0
    except (OSError, ValueError):  # a name too long, or with a NUL
        is_empty = False
    if not is_empty:  # an empty file is reported later, by its missing plant
        require_file(path)
    raw, where = path.read_bytes(), path.resolve()
    digest = hashlib.sha256(raw).hexdigest()
    module = types.ModuleType(f"plant_file_{digest[:16]}")
    vars(module).update({"__file__": str(where), MARK: label})
    for name, neighbour in _neighbours.items():
        if sys.modules.get(name) is neighbour:
            del sys.modules[name]
    _neighbours.clear()
    known = {*sys.modules, module.__name__}
    sys.modules[module.__name__] = module  # dataclasses and pickles look up their module by name
    sys.path.append(str(where.parent))
    try:
        with _user_code(label):
            exec(compile(raw, str(where), "exec", dont_inherit=True), vars(module))  # noqa: S102  named by the user
    finally:
        sys.path.remove(str(where.parent))
    hashes = {label: digest}
    for name in sys.modules.keys() - known:
        file, package = Path(getattr(sys.modules[name], "__file__", None) or where.root), name.partition(".")[0]
        if package == "robustlab" or not file.is_relative_to(where.parent):
            continue
        relative = file.relative_to(where.parent)
        if relative.parts[0].removesuffix(".py") == package:  # not a package of an environment in the folder
            _neighbours[name] = sys.modules[name]
            hashes[(Path(label).parent / relative).as_posix()] = file_sha256(file)
    return module, hashes


@contextmanager
def _user_code(where: str) -> Iterator[None]:
    """Convert errors of the user's code into errors with the line."""
    try:
        yield
    except MemoryError:
        raise
    except RobustlabError as error:
        place = _place(error)
        if place is None:
            raise
        kind = InputError if isinstance(error, UsageError) else type(error)  # the fault is in the file, not the call
        raise kind(f"{place}: {error.where}", error.found, error.expected, error.hint, error.more) from error
    except SystemExit as error:
        found = "ends the program (sys.exit)" if error.code is None else f"ends the program (sys.exit({error.code!r}))"
        raise InputError(_place(error) or where, found, "code that defines plants") from error
    except Exception as error:
        raise _user_error(error, _place(error) or where) from error


def _user_error(error: Exception, place: str) -> RobustlabError:
    if isinstance(error, SyntaxError) and error.filename and error.lineno:
        return InputError(f"{Path(error.filename).name}, line {error.lineno}", f"not valid Python: {error.msg}")
    text = next(iter(str(error).strip().splitlines()), "")
    package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if package in EXTRAS:
        return DependencyMissing(place, f"needs {package}", None, f"pip install 'robustlab[{EXTRAS[package]}]'")
    hint = f"install it, or put {package}.py into the folder of the file" if package else None
    return InputError(place, f"{type(error).__name__}: {text}".removesuffix(": "), None, hint)


def _made(target: Any, given: dict[str, Any], label: str) -> Plant:
    """Return the plant that an object of the file is, or returns."""
    made = target
    if not isinstance(target, Plant):
        if not is_function(target):
            raise InputError(label, f"a {type(target).__name__}", "a plant, or a function that returns one")
        known = _arguments(target)
        takes_all = any(p.kind is Parameter.VAR_KEYWORD for p in known.values())
        made = target(**{key: given.pop(key) for key in list(given) if takes_all or key in known})
    if not isinstance(made, Plant):
        found = "None" if made is None else f"a {type(made).__name__}"
        hint = "return p.plant(**given)" if callable(getattr(made, "plant", None)) else None
        raise InputError(label, f"returned {found}", "a plant (a LinearPlant or a NonlinearPlant)", hint)
    return made.with_parameters(**given) if given else made


def _arguments(target: Callable[..., Any]) -> Mapping[str, Parameter]:
    try:
        return signature(target).parameters
    except (TypeError, ValueError):  # of compiled code
        return {}


def _check_shapes(plant: Plant, label: str) -> None:
    if type(plant).__module__.startswith("robustlab."):
        return  # checked where the plant is made
    x, u = np.zeros(len(plant.states)), np.zeros(len(plant.inputs))
    for word, function, n in (
        ("derivative", plant.derivative, len(plant.states)),
        ("output", plant.output, len(plant.outputs)),
    ):
        with _user_code(label), np.errstate(all="ignore"):
            try:
                found = np.shape(function(x, u))
            except (ArithmeticError, ValueError):
                continue  # zero may be outside the machine's domain
        if found != (n,):
            raise InputError(label, f"{word}(x, u) has the shape {found}", f"({n},)")


def _plants(module: types.ModuleType) -> tuple[str, ...]:
    """Return the names of plants, and of the file's own functions without required arguments."""
    optional = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)

    def is_plant(name: str, thing: Any) -> bool:
        if not isinstance(thing, types.FunctionType) or thing.__module__ != module.__name__ or name.startswith("_"):
            return isinstance(thing, Plant)
        return all(p.default is not Parameter.empty or p.kind in optional for p in _arguments(thing).values())

    return tuple(name for name, thing in list(vars(module).items()) if is_plant(name, thing))


# The plant in the template.
PLANT = "axis"


def write_template(name: str) -> Path:
    """Write ``NAME.py`` to the working directory, or to the folder before the name; never overwrite a file."""
    folder, last = os.path.split(name)
    stem = last.removesuffix(".py")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,59}", stem) or keyword.iskeyword(stem):
        raise UsageError(f"plant new {name}", "not a name", "letters, digits and _, with a letter first")
    path = Path(folder, f"{stem}.py")
    if path.exists() or path.is_symlink():
        raise EnvironmentFault(str(path), "exists already", "a new name")
    if find_spec(stem) is not None:
        raise UsageError(f"plant new {name}", "the name of a module that Python knows", "a name of your own")
    template = Path(__file__).with_name("plant_template.txt").read_text(encoding="utf-8")
    text = template.format(stem=stem, file=path)
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return path
