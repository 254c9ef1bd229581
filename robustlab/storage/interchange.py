"""Load and save objects; the modules of each kind of object are imported on use (`codecs`)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.errors import InputError, UsageError, did_you_mean, error_context
from robustlab.files.atomic import atomic_write
from robustlab.files.file_types import Limits, content_of, parse_document, require_file
from robustlab.files.hdf5 import read_tree, write_tree
from robustlab.files.tree import Tree, check_header, decode_provenance, is_stamped, stamp
from robustlab.provenance import BY_DIFFERENCES, NOT_VERIFIED, Provenance, Traced, code_of
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.storage.codecs import BY_KIND, codec_of, record_of
from robustlab.storage.matrices import NAMES, PAIR, SIGNAL, Problems, decode_pair, decode_state_space

if TYPE_CHECKING:
    from robustlab.delays.model import DelayedModel
    from robustlab.dynamics.plant_base import Plant
    from robustlab.record import Record
    from robustlab.result import Result
    from robustlab.synthesis.problem.controller import Controller
    from robustlab.synthesis.scheduling.parameter_varying import LPVController, LPVModel
    from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
    from robustlab.uncertainty.lft import UncertainModel

    Models = StateSpaceModel | UncertainModel | DelayedModel | UncertainFrequencyData | LPVModel
    Stored = Models | Controller | LPVController | Record | Result | Plant
else:
    Stored = Any  # for signatures read at run time


@dataclass(frozen=True)
class Loaded:
    """An object from a file, with what is known about the file."""

    # StateSpaceModel, UncertainModel, DelayedModel, UncertainFrequencyData, LPVModel, Controller, LPVController,
    # Record, Result, Plant; for `kind = "pair"` (nominal, perturbed).
    object: Any
    kind: str  # kind of format 1, or `"pair"`
    path: str
    verified: bool  # whether the content hash is present and matches
    warnings: tuple[str, ...] = ()
    # Provenance in the file, with a note if no content hash verified it; also set on the object
    # (`robustlab.provenance.Traced`).
    provenance: Provenance | None = None

    def __post_init__(self) -> None:
        origin = self.provenance
        if not self.verified and (origin is None or NOT_VERIFIED not in origin.note):
            origin = origin or Provenance("", "")
            origin = replace(origin, note=f"{origin.note}; {NOT_VERIFIED}".removeprefix("; "))
            object.__setattr__(self, "provenance", origin)
        for thing in self.object if isinstance(self.object, tuple) else (self.object,):
            if origin is not None and isinstance(thing, Traced):
                thing.traced(origin)


@error_context("load")
def load(
    path: str | Path,
    *,
    group: str | None = None,
    transpose: bool = False,
    no_verify: bool = False,
    limits: Limits | None = None,
    isolate: bool = True,
) -> Stored:
    """Load the object in a file: HDF5 (format 1 or plain), MATLAB 5 or 7.3, JSON (a Controller) or text (a Record).

    Parameters
    ----------
    path
        The file; its kind is detected by its content, not by its name.
    group
        Take the model or record in this group.
    transpose
        The file was written column by column: swap the axes of A, B, C and D. Not needed for MATLAB's own files.
    no_verify
        Load although the content hash does not match. Certify nothing with such an object.
    limits, isolate
        See `robustlab.files.hdf5.read_tree`.

    Returns
    -------
    StateSpaceModel, or whatever else `save` takes
        A text file gives a Record whose columns are all outputs: only the user knows which are inputs (`Record.read`).
        The object's ``provenance`` is that of the file. Where no content hash verified the file, it has a note; a
        format 1 file without a hash, or with one that does not match, also raises a warning.

    Raises
    ------
    InputError
        Any fault of the file, all faults at once.
    """
    loaded = read(path, group=group, transpose=transpose, no_verify=no_verify, limits=limits, isolate=isolate)
    if loaded.kind == "pair":
        hint = 'load(path, group="nominal")'
        raise InputError(str(path), "two models, /nominal and /perturbed", "one object", hint)
    for text in loaded.warnings:
        if "content_sha256" in text:
            warnings.warn(f"{path}: {text}", stacklevel=2)
    return loaded.object


def is_plant_file(name: str) -> bool:
    """Return whether a text is the path of a file, not the name of a plant."""
    return Path(name).suffix.lower() in (".h5", ".hdf5") or Path(name).is_file()


def load_plant(path: str) -> Any:
    from robustlab.dynamics.plant_base import Plant

    found = load(path)
    if not isinstance(found, Plant):
        hint = "save one with robustlab.save(path, plant)"
        raise InputError(path, f"holds a {type(found).__name__}", "a plant", hint)
    return found


def read(
    path: str | Path,
    *,
    group: str | None = None,
    transpose: bool = False,
    no_verify: bool = False,
    limits: Limits | None = None,
    isolate: bool = True,
) -> Loaded:
    """Read as `load` does, with the properties of the file, and both models of a pair."""
    where = str(path)
    if content_of(path, limits) == "text":
        from robustlab.files.records import read_record

        keywords = read_record(path, group, limits=limits, isolate=isolate)
        return Loaded(record_of(keywords, where), "record", where, False)
    tree = read_tree(path, group, limits, isolate)
    problems, found, origin = Problems(where), list[str](), None
    verified = is_stamped(tree) and group is None
    if verified:
        kind, found = check_header(tree, no_verify)
        thing, origin = BY_KIND[kind].read(tree, problems, transpose), decode_provenance(tree)
        verified = not found
    else:
        node = tree.find(group) if group else tree
        if node is None:
            names = ", ".join(tree.group_names())
            raise InputError(where, f"missing group /{group}", f"one of {names}" if names else "a file with groups")
        kind, thing = _plain(tree, node, problems, group, transpose)
    warned = (*found, *problems.notes, *_unit_warnings(kind, thing))
    return Loaded(thing, kind, where, verified, warned, origin)


def _plain(tree: Tree, node: Tree, problems: Problems, group: str | None, transpose: bool) -> tuple[str, Any]:
    """Decode a file without header: a model by its matrices, a pair by its groups, a record by its times."""
    matrices = [name for name in NAMES if name in node.datasets]
    if not matrices and any(get_close_matches(name.lower(), PAIR, n=1, cutoff=0.7) for name in node.groups):
        return "pair", decode_pair(node, problems, transpose)
    from robustlab.files.records import CLOCK_NAMES, record_of_group

    clocked = any(name in node.datasets for name in CLOCK_NAMES) or {"inputs", "outputs"} & set(node.groups)
    if len(matrices) < 2 and clocked:
        return "record", record_of(record_of_group(problems.file, tree, node, group), problems.file)
    if not matrices and node.groups:
        problems.hint = f"groups here: {', '.join(list(node.groups)[:8])}; choose one, group=..."
    return "state-space", decode_state_space(node, problems, transpose)


def _unit_warnings(kind: str, thing: Any) -> tuple[str, ...]:
    if kind in ("result", "plant"):
        return ()
    if kind == "record":
        bare = [name for name, unit in thing.units.items() if not unit]
    else:
        outer = thing[0] if kind == "pair" else thing.K if kind in ("controller", "lpv-controller") else thing
        bare = [s.name for s in (*outer.inputs, *outer.outputs) if not s.unit]
    return (f"no unit stated for {', '.join(bare[:8])}{', ...' if len(bare) > 8 else ''}",) if bare else ()


@error_context("save")
def save(path: str | Path, obj: Any, provenance: Provenance | None = None) -> Path:
    """Write an object atomically: ``.h5`` or ``.hdf5`` as format 1, ``.mat`` as MATLAB version 5 (models, controllers).

    Parameters
    ----------
    path
        File to write; an existing file is replaced once the new one is complete.
    obj
        StateSpaceModel, UncertainModel, DelayedModel, UncertainFrequencyData, LPVModel, Controller, LPVController,
        Record, a plant with or without effects, a python-control system, or a result (with ``.status`` and
        ``.to_json()``). A plant is one as from `robustlab.dynamics.plant`, or
        one of the user's own, whose equations are stored as coefficients (`LinearPlant`) or tapes (`PlantEquations`).
    provenance
        Where it comes from; where left out, time and versions of now, and the code of a plant file (its SHA-256).

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    EnvironmentFault
        Disk full, no permission; the previous file is kept.
    InputError, UsageError
        An object or a file name that cannot be written.
    """
    if not isinstance(path, (str, PathLike)):
        turned = isinstance(obj, (str, PathLike))
        found, hint = f"a {type(path).__name__} in the place of the file", f"rl.save({str(obj)!r}, G)"
        raise InputError("save: path", found, "a file name, then the object", hint if turned else None)
    suffix = Path(path).suffix.lower()
    if suffix == ".mat":
        return _save_matlab(path, obj)
    if suffix not in (".h5", ".hdf5"):
        raise UsageError(str(path), f"extension {suffix or 'missing'!r}", ".h5, .hdf5 or .mat")
    tree = Tree(file=str(path))
    codec, thing = codec_of(obj), obj
    if codec is None and hasattr(obj, "status") and hasattr(obj, "to_json"):
        codec = BY_KIND["result"]
    if codec is None:
        codec, thing = BY_KIND["state-space"], as_model(obj, "save")
    codec.write(tree, thing)
    stamp(tree, codec.kind, _origin(obj, provenance or Provenance.now("save", code_of(obj))))
    return write_tree(path, tree)


def _origin(obj: Any, given: Provenance) -> Provenance:
    """Return the provenance to write, with the remarks of an unverified or inexact source."""
    source = getattr(obj, "provenance", None)
    if not isinstance(source, Provenance):
        return given
    for remark, text in ((NOT_VERIFIED, f"made from a file {NOT_VERIFIED}"), (BY_DIFFERENCES, BY_DIFFERENCES)):
        if remark in source.note and remark not in given.note:
            given = replace(given, note=f"{given.note}; {text}".removeprefix("; "))
    return given


def _save_matlab(path: str | Path, obj: Any) -> Path:
    codec = codec_of(obj)
    if codec and codec.kind in ("uncertain", "record", "result"):
        found = "an uncertain model" if codec.kind == "uncertain" else f"a {type(obj).__name__}"
        hint = "save it as .h5, which MATLAB reads with h5read"
        raise InputError(str(path), found, "a model or a controller for .mat", hint)
    model = as_model(obj, "save")
    variables: dict[str, Any] = {name: getattr(model, name) for name in (*NAMES, "dt")}
    point = model.operating_point
    if point is not None:
        variables["operating_point"] = {name: getattr(point, name).reshape(-1, 1) for name in ("x", "u", "y")}
    taken = any(isinstance(s, Taken) for s in model.inputs)
    for side, signals in (("State", model.states), ("Input", model.inputs), ("Output", model.outputs)):
        for word in SIGNAL if taken and side == "Input" else SIGNAL[:2]:
            texts = np.array([getattr(s, word, "") for s in signals], dtype=object)
            variables[f"{side}{word.capitalize()}"] = texts.reshape(-1, 1)  # a column of cells

    def write(temporary: Path) -> None:
        from scipy.io import savemat

        with temporary.open("wb") as stream:
            savemat(stream, variables, appendmat=False, do_compression=True)  # zlib adds a checksum, which 5 lacks

    return atomic_write(path, write)


# --- parametric models in TOML: matrices of expressions, ranges of parameters, names of signals -----------------------
#
#   A = [[0, 1], ["-k/m", "-c/m"]]       # B, C and D alike
#   inputs = [["F", "N"]]                # optional, as outputs, states and dt: a name, or a name and its unit
#   [parameters]
#   m = [3.0, 0.4]                       # nominal value, relative tolerance
#   k = [2.0, 1.4, 3.0]                  # nominal, low, high
#   c = {nominal = 1.0, low = 0.8, high = 1.5, unit = "N s/m"}
#   g = 9.81                             # exact

MAX_BYTES = 1 << 20
SIGNALS = ("inputs", "outputs", "states")
KEYS = (*NAMES, "parameters", "dt", *SIGNALS)
RANGE = ("nominal", "low", "high", "unit")


def load_parametric(path: str | Path) -> UncertainModel:
    """Return the uncertain model of a file of expressions; see `robustlab.uncertainty.parametric.parametric`."""
    from robustlab.uncertainty.parametric import parametric

    where = str(path)
    require_file(path, Limits(file=MAX_BYTES))
    data = parse_document("toml", Path(path).read_bytes(), where)
    unknown = [key for key in data if key not in KEYS]
    if unknown:
        hint = did_you_mean(unknown[0], KEYS)
        raise InputError(where, f"key {unknown[0]!r}", f"some of {', '.join(KEYS)}", hint)
    missing = [key for key in (*NAMES, "parameters") if key not in data]
    if missing:
        raise InputError(where, f"no {missing[0]}", "A, B, C, D and a table [parameters]")
    if not isinstance(data["parameters"], dict):
        raise InputError(where, "parameters is no table", "a table [parameters]")
    try:
        ranges = {name: _range(name, given) for name, given in data["parameters"].items()}
        options = {key: data[key] for key in ("dt", *SIGNALS) if key in data}
        for key in SIGNALS:
            _check_names(key, options.get(key, []))
        return parametric(data["A"], data["B"], data["C"], data["D"], ranges, **options)
    except InputError as error:
        found = f"{error.where}: {error.found}"
        raise type(error)(where, found, error.expected, error.hint, error.more) from None


def _range(name: str, given: Any) -> Any:
    from robustlab.uncertainty.blocks import ParameterRange

    if not isinstance(given, dict):
        return given
    numbers = {key: value for key, value in given.items() if key != "unit"}
    known = {"low", "high"} <= set(given) <= set(RANGE) and isinstance(given.get("unit", ""), str)
    if not known or not all(type(value) in (int, float) for value in numbers.values()):
        expected = "numbers for low and high, and where wanted nominal, and a text for unit"
        hint = next((did_you_mean(key, RANGE) for key in given if key not in RANGE), None)
        raise InputError(f"parameter {name!r}", f"{given!r}"[:80], expected, hint)
    return ParameterRange.between(**{key: float(value) for key, value in numbers.items()}, unit=given.get("unit", ""))


def _check_names(key: str, given: Any) -> None:
    pairs = [item if isinstance(item, list) else [item] for item in given] if isinstance(given, list) else [[given, 0]]
    if not all(len(pair) <= 2 and all(isinstance(part, str) for part in pair) for pair in pairs):
        raise InputError(key, f"{given!r}"[:80], "a list of names, or of [name, unit]")
