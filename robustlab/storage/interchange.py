"""Loading and saving: which object a file holds, and which file an object becomes.

A result becomes nested groups of what its ``to_json`` gave.

What knows one kind of object is loaded where one is met: a command that reads a model needs no plants and no delays.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.errors import InputError, UsageError, told_as
from robustlab.files.atomic import atomic_write
from robustlab.files.hdf5 import read_tree, write_tree
from robustlab.files.matlab import write_matlab5
from robustlab.files.records import CLOCK_NAMES, RecordOptions, decode_record, encode_record, read_record
from robustlab.files.signature import Limits, content_of
from robustlab.files.tree import (
    Dataset,
    Tree,
    Unread,
    check_header,
    decode_provenance,
    is_stamped,
    link_name,
    signal_name,
    stamp,
    text_attr,
)
from robustlab.provenance import BY_DIFFERENCES, NOT_VERIFIED, Provenance, Traced
from robustlab.record import Record
from robustlab.result import Result, Status
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.storage.matrices import Problems, decode_model, encode_model
from robustlab.storage.models import decode_pair, looks_like_a_pair

if TYPE_CHECKING:
    from robustlab.delays.model import DelayedModel
    from robustlab.dynamics.plant_contract import Plant
    from robustlab.synthesis.problem.design import Controller
    from robustlab.synthesis.scheduling.parameter_varying import LPVModel
    from robustlab.synthesis.scheduling.scheduled_synthesis import LPVController
    from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
    from robustlab.uncertainty.lft import UncertainModel

    Models = StateSpaceModel | UncertainModel | DelayedModel | UncertainFrequencyData | LPVModel
    Stored = Models | Controller | LPVController | Record | Result | Plant
else:
    Stored = Any  # what reads the signatures while the program runs


@dataclass(frozen=True)
class Loaded:
    """An object from a file, with what is known about the file."""

    # StateSpaceModel, UncertainModel, DelayedModel, UncertainFrequencyData, LPVModel, Controller, LPVController,
    # Record, Result, Plant; for `kind = "pair"` (nominal, perturbed).
    object: Any
    kind: str  # kind of format 1, or `"pair"`
    path: str
    verified: bool  # True where the content hash was there and matched
    warnings: tuple[str, ...] = ()  # what a reader should know; empty where all is well
    # Where the file says it comes from; its note says so where no content hash verified the file. The object carries
    # the same (`robustlab.provenance.Traced`).
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


@told_as("load")
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
        The file; its kind is told by its content, not by its name.
    group
        Take the model or record in this group.
    transpose
        The file was written column by column: swap the axes of A, B, C and D. MATLAB's own files need no such word.
    no_verify
        Load although the content hash does not match. Certify nothing with such an object.
    limits, isolate
        See `robustlab.files.hdf5.read_tree`.

    Returns
    -------
    StateSpaceModel, or whatever else `save` takes
        A text file gives a Record whose columns are all outputs: only the user knows which are inputs (`Record.read`).
        The object's ``provenance`` is that of the file. Where no content hash verified the file, its note says so; a
        format 1 file without one, or with one that does not match, also brings a warning.

    Raises
    ------
    InputError
        Anything that is wrong with the file, all findings at once.
    """
    loaded = read(path, group=group, transpose=transpose, no_verify=no_verify, limits=limits, isolate=isolate)
    if loaded.kind == "pair":
        raise InputError(
            str(path),
            "two models, /nominal and /perturbed",
            "one object",
            'load_pair(path), or load(path, group="nominal")',
        )
    for text in loaded.warnings:
        if "content_sha256" in text:
            warnings.warn(f"{path}: {text}", stacklevel=2)
    return loaded.object


def load_pair(
    path: str | Path, *, transpose: bool = False, limits: Limits | None = None, isolate: bool = True
) -> tuple[StateSpaceModel, StateSpaceModel]:
    """The nominal and the perturbed model of one file with groups ``nominal`` and ``perturbed``, A B C D in each.

    Raises InputError: anything that is missing, misspelt or does not fit; `UnitMismatch` where units disagree.
    """
    tree = _tree(path, None, limits, isolate)
    return decode_pair(tree, Problems(str(path)), transpose)


def is_plant_file(name: str) -> bool:
    """True where a text means a file with a plant, and not the name of a plant."""
    return Path(name).suffix.lower() in (".h5", ".hdf5") or Path(name).is_file()


def load_plant(path: str) -> Any:
    """The plant in a file. Raises InputError: the file holds something else."""
    from robustlab.dynamics.plant_contract import Plant

    found = load(path)
    if not isinstance(found, Plant):
        raise InputError(
            path, f"holds a {type(found).__name__}", "a plant", "save one with robustlab.save(path, plant)"
        )
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
    """Like `load`, but with what is known about the file, and for a pair file with both models."""
    where = str(path)
    content = content_of(path, limits)
    if content in ("text", "parquet", "mcap"):
        from robustlab.storage.controller_json import is_json, read_controller_json

        if content == "text" and is_json(path):
            if group or transpose:
                raise InputError(where, "group or transpose with a JSON file", "neither: it holds one controller")
            held = read_controller_json(path, limits, isolate)
            warnings = (*held.warnings, *_unit_warnings("controller", held.controller))
            return Loaded(held.controller, "controller", where, False, warnings, held.provenance)
        keywords = read_record(path, RecordOptions(group), limits, isolate)
        return Loaded(_record(keywords, where), "record", where, False)
    tree = _tree(path, group, limits, isolate)
    problems = Problems(where)
    if is_stamped(tree) and group is None:
        kind, found = check_header(tree, no_verify)
        thing = _of_kind(kind, tree, problems, transpose)
        verified = not found and not (no_verify and text_attr(tree.attrs, "content_sha256") is None)
        return Loaded(
            thing,
            kind,
            where,
            verified,
            (*found, *problems.notes, *_unit_warnings(kind, thing)),
            decode_provenance(tree),
        )
    node = tree.find(group) if group else tree
    if node is None:
        names = ", ".join(tree.group_names())
        raise InputError(where, f"missing group /{group}", f"one of {names}" if names else "a file with groups")
    kind, thing = _plain(node, problems, group, transpose=transpose, limits=limits, isolate=isolate)
    return Loaded(thing, kind, where, False, (*problems.notes, *_unit_warnings(kind, thing)))


def _tree(path: str | Path, group: str | None, limits: Limits | None, isolate: bool) -> Tree:
    return read_tree(path, group, limits, isolate)


def _of_kind(kind: str, tree: Tree, problems: Problems, transpose: bool) -> Stored:
    if kind in ("uncertain", "controller"):
        from robustlab.storage.models import decode_controller, decode_uncertain

        return (decode_uncertain if kind == "uncertain" else decode_controller)(tree, problems, transpose)
    if kind == "delayed":
        from robustlab.storage.models import decode_delayed

        return decode_delayed(tree, problems, transpose)
    if kind == "frequency-data":
        from robustlab.storage.models import decode_frequency_data

        return decode_frequency_data(tree, problems)
    if kind in ("lpv", "lpv-controller"):
        from robustlab.storage.models import decode_lpv

        return decode_lpv(tree, problems, controller=kind == "lpv-controller")
    if kind == "record":
        return _record(decode_record(tree, tree.file), tree.file)
    if kind == "result":
        return decode_result(tree)
    if kind == "plant":
        from robustlab.storage.plants import decode_plant

        return decode_plant(tree, problems)
    return _model(tree, problems, transpose)


def _plain(
    node: Tree, problems: Problems, group: str | None, *, transpose: bool, limits: Limits | None, isolate: bool
) -> tuple[str, Any]:
    """A file without header: a model by its matrices, a pair by its groups, a record by its clock."""
    where = problems.file
    matrices = [name for name in "ABCD" if name in node.datasets]
    if not matrices and looks_like_a_pair(node):
        return "pair", decode_pair(node, problems, transpose)
    has_signals = any(name in node.datasets for name in CLOCK_NAMES) or {"inputs", "outputs"} & set(node.groups)
    if has_signals and len(matrices) < 2:
        return "record", _record(read_record(where, RecordOptions(group), limits, isolate), where)
    if not matrices and node.groups:
        problems.hint = f"groups here: {', '.join(list(node.groups)[:8])}; choose one (group=, --group)"
    return "state-space", _model(node, problems, transpose)


def _model(node: Tree, problems: Problems, transpose: bool) -> StateSpaceModel:
    model = decode_model(node, problems, transpose)
    problems.raise_any()
    assert model is not None
    return model


def _record(keywords: dict[str, Any], where: str) -> Record:
    name = keywords.pop("name")
    try:
        return Record(**keywords, name=name)
    except InputError as error:
        raise InputError(
            where, f"{error.where.removeprefix(name).lstrip(': ')} {error.found}".strip(), error.expected, error.hint
        ) from None


def _unit_warnings(kind: str, thing: Any) -> tuple[str, ...]:
    """Row 17 of the fault table: missing units are accepted, and said."""
    if kind in ("result", "plant"):
        return ()
    if kind == "record":
        bare = [name for name, unit in thing.units.items() if not unit]
    else:
        outer = thing[0] if kind == "pair" else thing.K if kind in ("controller", "lpv-controller") else thing
        bare = [s.name for s in (*outer.inputs, *outer.outputs) if not s.unit]
    return (f"no unit stated for {', '.join(bare[:8])}{', ...' if len(bare) > 8 else ''}",) if bare else ()


# --- saving ----------------------------------------------------------------------------------------------------------


@told_as("save")
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
    from robustlab.dynamics.plant_file import code_of

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
    kind = _encode(tree, obj)
    stamp(tree, kind, _origin(obj, provenance or Provenance.now("save", code_of(obj))))
    return write_tree(path, tree)


def _origin(obj: Any, given: Provenance) -> Provenance:
    """The provenance to write: what nothing verified, and what is not exact, says so in every file made of it."""
    source = getattr(obj, "provenance", None)
    if not isinstance(source, Provenance):
        return given
    for remark, text in ((NOT_VERIFIED, f"made from a file {NOT_VERIFIED}"), (BY_DIFFERENCES, BY_DIFFERENCES)):
        if remark in source.note and remark not in given.note:
            given = replace(given, note=f"{given.note}; {text}".removeprefix("; "))
    return given


def _encode(tree: Tree, obj: Any) -> str:
    from robustlab.delays.model import DelayedModel
    from robustlab.dynamics.plant_contract import Plant
    from robustlab.storage.models import (
        encode_controller,
        encode_delayed,
        encode_frequency_data,
        encode_lpv,
        encode_uncertain,
    )
    from robustlab.storage.plants import encode_plant
    from robustlab.synthesis.problem.design import Controller
    from robustlab.synthesis.scheduling.parameter_varying import LPVModel
    from robustlab.synthesis.scheduling.scheduled_synthesis import LPVController
    from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
    from robustlab.uncertainty.lft import UncertainModel

    if isinstance(obj, UncertainModel):
        encode_uncertain(tree, obj)
        return "uncertain"
    if isinstance(obj, DelayedModel):
        encode_delayed(tree, obj)
        return "delayed"
    if isinstance(obj, UncertainFrequencyData):
        encode_frequency_data(tree, obj)
        return "frequency-data"
    if isinstance(obj, (LPVModel, LPVController)):
        return encode_lpv(tree, obj)
    if isinstance(obj, Controller):
        encode_controller(tree, obj)
        return "controller"
    if isinstance(obj, Record):
        keywords = {key: getattr(obj, key) for key in ("t", "inputs", "outputs", "units", "name", "meaning")}
        encode_record(tree, keywords)
        return "record"
    if isinstance(obj, Plant):
        encode_plant(tree, obj)
        return "plant"
    if not isinstance(obj, StateSpaceModel) and hasattr(obj, "status") and hasattr(obj, "to_json"):
        encode_result(tree, obj)
        return "result"
    encode_model(tree, as_model(obj, "save"))
    return "state-space"


def _save_matlab(path: str | Path, obj: Any) -> Path:
    from robustlab.uncertainty.lft import UncertainModel

    if isinstance(obj, (UncertainModel, Record, Result)):
        found = "an uncertain model" if isinstance(obj, UncertainModel) else f"a {type(obj).__name__}"
        hint = "save it as .h5, which MATLAB reads with h5read"
        raise InputError(str(path), found, "a model or a controller for .mat", hint)
    model = as_model(obj, "save")
    variables: dict[str, Any] = {name: getattr(model, name) for name in "ABCD"}
    variables["dt"] = model.dt
    point = model.operating_point
    if point is not None:
        variables["operating_point"] = {name: getattr(point, name).reshape(-1, 1) for name in ("x", "u", "y")}
    for side, signals in (("State", model.states), ("Input", model.inputs), ("Output", model.outputs)):
        variables[f"{side}Name"] = [s.name for s in signals]
        variables[f"{side}Unit"] = [s.unit for s in signals]
    if any(isinstance(s, Taken) for s in model.inputs):
        variables["InputTakes"] = [getattr(s, "takes", "") for s in model.inputs]
        variables["InputOf"] = [getattr(s, "of", "") for s in model.inputs]
    return atomic_write(path, lambda temporary: write_matlab5(temporary, variables))


# --- results ---------------------------------------------------------------------------------------------------------


def encode_result(tree: Tree, result: Any) -> None:
    """Attributes ``type`` and ``status``; group ``data`` with one dataset per value and one group per table."""
    data = dict(result.to_json())
    if isinstance(result, Result):
        data.pop("type")
    data.pop("status", None)
    tree.attrs.update(
        type=result.type if isinstance(result, Result) else type(result).__name__, status=Status(result.status).value
    )
    _table(tree.group("data"), data)


def _table(tree: Tree, data: Mapping[Any, Any]) -> None:
    for key, value in data.items():
        _put(tree, link_name(str(key)), value)


def _put(tree: Tree, link: str, value: Any) -> None:
    if hasattr(value, "to_json"):
        value = value.to_json()
    if isinstance(value, Enum):
        value = value.value
    if value is None:
        tree.put(link, "", null=True)
    elif isinstance(value, Mapping):
        _table(tree.group(link), value)
    elif isinstance(value, (list, tuple, set, frozenset)):
        _put_list(tree, link, list(value))
    elif isinstance(value, np.ndarray) and value.dtype == object:
        _put_list(tree, link, value.tolist())
    else:
        tree.put(link, value)


def _put_list(tree: Tree, link: str, items: list[Any]) -> None:
    """Lists of numbers or of texts, rectangular if nested, become one dataset; others a group of numbered children."""
    leaves = _leaf_types(items)
    if leaves and len(leaves) == 1 and _is_rectangular(items):
        tree.put(link, np.asarray(items))
        return
    group = tree.group(link)
    group.attrs["sequence"] = len(items)
    for i, item in enumerate(items):
        _put(group, str(i), item)


def _leaf_types(items: list[Any]) -> set[str]:
    kinds: set[str] = set()
    for item in items:
        if isinstance(item, (list, tuple)):
            kinds |= _leaf_types(list(item))
        elif isinstance(item, str) and not isinstance(item, Enum):
            kinds.add("text")
        elif isinstance(item, (bool, np.bool_)):
            kinds.add("bool")
        elif isinstance(item, (int, float, np.integer, np.floating)):
            kinds.add("number")
        elif isinstance(item, (complex, np.complexfloating)):
            kinds.add("complex")
        else:
            kinds.add(type(item).__name__)
            kinds.add("other")
    return kinds


def _is_rectangular(items: list[Any]) -> bool:
    try:
        return np.asarray(items).dtype != object
    except ValueError:
        return False


def decode_result(tree: Tree) -> Result:
    """Inverse of `encode_result`; lists of numbers come back as arrays.

    Raises InputError: no group ``data``, an unknown status.
    """
    text = str(np.asarray(tree.attrs.get("status", "")))
    if text not in [status.value for status in Status]:
        raise InputError(tree.file, f"attribute status is {text!r}", f"one of {', '.join(s.value for s in Status)}")
    if "data" not in tree.groups:
        raise InputError(tree.file, "missing /data")
    data = _value(tree.groups["data"])
    if not isinstance(data, dict):
        raise InputError(tree.file, "/data is a sequence", "a table")
    return Result(str(np.asarray(tree.attrs.get("type", ""))), Status(text), data)


def _value(node: Tree) -> Any:
    if "sequence" in node.attrs:
        length = np.asarray(node.attrs["sequence"])
        if length.dtype.kind != "i" or length.size != 1:
            raise InputError(node.file, f"{node.path}: attribute sequence is no whole number", "the length of the list")
        count = int(length.flat[0])
        names = [str(i) for i in range(min(count, len(node.datasets) + len(node.groups)))]
        return [_child(node, name) for name in names if name in node.datasets or name in node.groups]
    return {signal_name(link): _child(node, link) for link in [*node.datasets, *node.groups]}


def _child(node: Tree, link: str) -> Any:
    return _leaf(node, link, node.datasets[link]) if link in node.datasets else _value(node.groups[link])


def _leaf(node: Tree, link: str, dataset: Dataset) -> Any:
    if isinstance(dataset.values, Unread):
        raise InputError(node.file, f"{node.child_path(link)} has dtype {dataset.values.dtype}", "numbers or text")
    if "null" in dataset.attrs:
        return None
    if dataset.values.ndim == 0 or dataset.values.dtype.kind == "U":
        return dataset.values.tolist()
    return dataset.values
