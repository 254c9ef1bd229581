"""Writers by class and readers by kind of file; each imports its class on use.

Classes are identified by name, so a process loads only the modules of the objects that it reads or writes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robustlab.arrays import not_finite
from robustlab.errors import InputError
from robustlab.files.tree import Tree, Unread, link_name, one_number, signal_name
from robustlab.result import Result, Status
from robustlab.statespace import StateSpaceModel
from robustlab.storage import matrices
from robustlab.storage.matrices import Problems, columns, need, put_columns

if TYPE_CHECKING:
    from robustlab.record import Record
    from robustlab.uncertainty.blocks import Block, ParameterRange
    from robustlab.uncertainty.lft import UncertainModel
    from robustlab.verification.claim import Claim


class Codec(NamedTuple):
    """A kind of file of format 1, the class of its objects, and the module with its ``encode_`` and ``decode_``."""

    kind: str
    type: str  # of the class: its module's path below `robustlab` and its name
    module: str = "codecs"

    def write(self, tree: Tree, obj: Any) -> None:
        self._function("encode")(tree, obj)

    def read(self, tree: Tree, problems: Problems, transpose: bool) -> Any:
        return self._function("decode")(tree, problems, transpose)

    def _function(self, way: str) -> Any:
        module = import_module(f"robustlab.storage.{self.module}")
        return getattr(module, f"{way}_{self.kind.replace('-', '_')}")


def codec_of(obj: Any) -> Codec | None:
    """Return the codec of an object's class or its nearest base, or None."""
    names = (f"{cls.__module__}.{cls.__qualname__}".removeprefix("robustlab.") for cls in type(obj).__mro__)
    by_type = {codec.type: codec for codec in BY_KIND.values()}
    return next((by_type[name] for name in names if name in by_type), None)


def encode_delayed(tree: Tree, model: Any) -> None:
    """Write group ``H`` as a state-space model, dataset ``delays`` in s, of its first inputs and outputs."""
    matrices.encode_state_space(tree.group("H"), model.H)
    tree.put("delays", np.asarray(model.delays, dtype=np.float64))


def decode_delayed(tree: Tree, problems: Problems, transpose: bool) -> Any:
    from robustlab.delays.model import DelayedModel

    need(tree, problems, groups=("H",), datasets=("delays",))
    model = matrices.decode_model(tree.groups["H"], problems, transpose)
    lengths = matrices.entries(tree, "delays", "fi", problems)
    return problems.built(DelayedModel, model, np.asarray(lengths, dtype=np.float64))


# Columns of a block, those of its range, and optional ones.
OF_BLOCK = {"name": "U", "stored_as": "U", "rows": "i", "cols": "i"}
OF_RANGE = {"nominal": "fi", "radius": "fi", "unit": "U"}
RARE = {"below": "fi", "sign": "U", "origin": "U"}


def encode_uncertain(tree: Tree, model: UncertainModel) -> None:
    """Write group ``M`` as a state-space model, and group ``blocks`` with one entry per block in each dataset."""
    matrices.encode_state_space(tree.group("M"), model.M)
    matrices.encode_point(tree, model.operating_point)
    encode_blocks(tree, model.blocks)


def encode_blocks(tree: Tree, blocks: Sequence[Block]) -> None:
    """Write group ``blocks``; the columns of `RARE` only where some block needs them."""
    group, ranges = tree.group("blocks"), [b.parameter for b in blocks]
    put_columns(group, OF_BLOCK, blocks)
    group.datasets["kind"] = group.datasets.pop("stored_as")
    put_columns(group, OF_RANGE, ranges)
    if any(p and p.below is not None for p in ranges):
        put_columns(group, {"below": "fi"}, ranges)
    if any(p and p.sign != "any" for p in ranges):
        group.put("sign", np.array([p.sign if p else "any" for p in ranges], np.str_))
    if any(b.origin for b in blocks):
        put_columns(group, {"origin": "U"}, blocks)


def decode_uncertain(tree: Tree, problems: Problems, transpose: bool = False) -> UncertainModel:
    """Invert `encode_uncertain`. Raises InputError: with all faults."""
    from robustlab.uncertainty.lft import UncertainModel

    need(tree, problems, groups=("M", "blocks"))
    model, blocks = matrices.decode_model(tree.groups["M"], problems, transpose), decode_blocks(tree, problems)
    return problems.built(UncertainModel, model, blocks, matrices.decode_point(tree, problems))


def decode_blocks(tree: Tree, problems: Problems) -> tuple[Block, ...]:
    from robustlab.uncertainty.blocks import KINDS

    group = tree.groups["blocks"]
    kinds = {"name": "U", "kind": "U", "rows": "fi", "cols": "fi", **OF_RANGE, **RARE}
    found = columns(group, kinds, problems, (*OF_RANGE, *RARE))
    if problems.lines:
        return ()
    rows = [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]
    blocks: list[Block] = []
    for i, row in enumerate(rows):
        name, kind, size = row["name"], row["kind"], (row["rows"], row["cols"])
        if kind not in KINDS:
            problems.add(f"{group.path}/kind[{i}] is {kind!r}, expected real, complex or full")
        elif not all(math.isfinite(n) and n == int(n) >= 1 for n in size) or (
            KINDS[kind].is_scalar and size[0] != size[1]
        ):
            found_size = f"block {name!r} ({kind}) is {size[0]:g} x {size[1]:g}"
            problems.add(f"{group.path}: {found_size}, expected whole sizes, square for a scalar block")
        else:
            try:
                span = _range(row, f"{group.path}: block {name!r}")
                made: Any = KINDS[kind]
                sizes = [int(n) for n in size][: 1 if made.is_scalar else 2]
                known = {"parameter": span} if made.is_real else {}
                blocks.append(made(name, *sizes, **known, origin=row.get("origin", "")))
            except InputError as error:
                problems.absorb(error)
    return tuple(blocks)


def _range(row: dict[str, Any], where: str) -> ParameterRange | None:
    from robustlab.uncertainty.blocks import ParameterRange

    nominal, radius = (row.get(name, math.nan) for name in ("nominal", "radius"))
    if math.isnan(nominal) and math.isnan(radius):
        return None
    if not (math.isfinite(nominal) and math.isfinite(radius)):
        raise InputError(where, f"nominal {nominal:g}, radius {radius:g}", "both finite or both NaN")
    below = row.get("below", math.nan)
    below = None if math.isnan(below) else below
    return ParameterRange(nominal, radius, row.get("unit", ""), below, sign=row.get("sign", "any"))


def encode_frequency_data(tree: Tree, data: Any) -> None:
    """Write datasets ``omega`` and ``M``, group ``blocks`` as of an uncertain model, ``signals``."""
    tree.put("omega", np.asarray(data.omega, dtype=np.float64))
    tree.put("M", np.asarray(data.M, dtype=np.complex128))
    encode_blocks(tree, data.blocks)
    matrices.encode_signals(tree, ((), data.inputs, data.outputs))


def decode_frequency_data(tree: Tree, problems: Problems, _transpose: bool = False) -> Any:
    from robustlab.uncertainty.frequency_responses import UncertainFrequencyData

    need(tree, problems, groups=("blocks",), datasets=("omega", "M"))
    omega, values = matrices.entries(tree, "omega", "fi", problems), tree.datasets["M"].values
    if isinstance(values, Unread) or values.dtype.kind not in "fic":
        problems.add(f"{tree.child_path('M')} is not readable as complex numbers")
    blocks = decode_blocks(tree, problems)
    _, inputs, outputs = matrices.decode_signals(tree, problems)
    return problems.built(UncertainFrequencyData, omega, values, blocks, inputs, outputs)


def encode_controller(tree: Tree, controller: Any) -> None:
    """Write K as a state-space model; ``gamma``, ``status``, ``method`` as attributes; the claims of its design."""
    from robustlab.evidence.verification import claims_of

    matrices.encode_state_space(tree, controller.K)
    _put_design(tree, controller)
    claims = claims_of(controller.design)
    own = {f"K_{letter}": getattr(controller.K, letter) for letter in "ABCD"}
    if any(all(np.array_equal(claim.numbers.get(name, np.nan), X) for name, X in own.items()) for claim in claims):
        encode_claims(tree, claims)


def decode_controller(tree: Tree, problems: Problems, transpose: bool) -> Any:
    from robustlab.synthesis.problem.controller import Controller

    model = matrices.decode_model(tree, problems, transpose)
    return problems.built(Controller, model, *_design(tree, problems))


def _put_design(tree: Tree, controller: Any) -> None:
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma


def _design(tree: Tree, problems: Problems) -> tuple[float | None, Status, str]:
    gamma = one_number(tree.attrs.get("gamma"))
    if gamma is None and "gamma" in tree.attrs:
        problems.add("attribute gamma is not one real number")
    text = str(np.asarray(tree.attrs.get("status", Status.INCONCLUSIVE.value)))
    if text not in list(Status):
        problems.add(f"attribute status is {text!r}, expected one of {', '.join(s.value for s in Status)}")
        text = Status.INCONCLUSIVE
    return gamma, Status(text), str(np.asarray(tree.attrs.get("method", "")))


# --- models and controllers over a grid of parameters -----------------------------------------------------------------

COLUMNS = {"name": "U", "unit": "U", "rate": "fi"}


def encode_lpv(tree: Tree, model: Any) -> None:
    """Write ``matrices`` [A B; C D] over the grid, ``deviation`` over its cells, parameters and signals."""
    tree.put("matrices", model.matrices)
    tree.put("deviation", model.deviation)
    tree.attrs.update(states=model.n_states, known=model.known)
    group = tree.group("parameters")
    put_columns(group, COLUMNS, model.parameters)
    group.put("count", np.array([len(p.points) for p in model.parameters]))
    group.put("points", np.concatenate([p.points for p in model.parameters]))
    matrices.encode_signals(tree, (model.states, model.inputs, model.outputs))


def decode_lpv(tree: Tree, problems: Problems, _transpose: bool = False) -> Any:
    need(tree, problems, groups=("parameters", "signals"), datasets=("matrices", "deviation"))
    for name in ("matrices", "deviation"):
        values = tree.datasets[name].values
        if isinstance(values, Unread) or values.dtype.kind not in "fi" or values.ndim < 3 or not_finite(values):
            problems.add(f"{tree.child_path(name)}: expected finite real numbers, three dimensions or more")
    group = tree.groups["parameters"]
    found = columns(group, {**COLUMNS, "count": "i"}, problems)
    points = columns(group, {"points": "fi"}, problems).get("points", [])
    sides = [side or [] for side in matrices.decode_signals(tree, problems)]
    problems.raise_any()
    try:
        return _lpv_model(tree, found, points, sides)
    except (InputError, ValueError, KeyError, IndexError) as error:
        text = error.line if isinstance(error, InputError) else str(error)
        raise InputError(problems.file, f"no LPV model: {text}", "what kind lpv of format 1 says") from None


def _lpv_model(tree: Tree, found: dict[str, Any], points: list[float], sides: list[Any]) -> Any:
    from robustlab.synthesis.scheduling.parameter_varying import LPVModel, SchedulingParameter

    matrices, deviation = (np.asarray(tree.datasets[name].values, float) for name in ("matrices", "deviation"))
    ends = np.cumsum(found["count"])
    if not len(ends) or ends[-1] != len(points):
        raise InputError("parameters", f"{len(points)} points", f"{sum(found['count'])}, as count says")
    grids = [tuple(grid) for grid in np.split(np.asarray(points, float), ends[:-1])]
    rows = zip(found["name"], grids, found["rate"], found["unit"], strict=True)
    states, inputs, outputs = sides
    n = int(np.asarray(tree.attrs["states"]))
    expected = (*map(len, grids), n + len(outputs), n + len(inputs))
    if matrices.shape != expected or len(states) != n:
        raise InputError("matrices", f"shape {matrices.shape}", f"{expected}")
    parameters = tuple(SchedulingParameter(*row) for row in rows)
    return LPVModel.of(parameters, matrices, n, inputs, outputs, states, deviation, str(tree.attrs["known"]))


def encode_lpv_controller(tree: Tree, controller: Any) -> None:
    """Write an LPV model with the attributes of kind ``controller``."""
    encode_lpv(tree, controller.K)
    _put_design(tree, controller)


def decode_lpv_controller(tree: Tree, problems: Problems, _transpose: bool) -> Any:
    from robustlab.synthesis.scheduling.parameter_varying import LPVController

    return problems.built(LPVController, decode_lpv(tree, problems), *_design(tree, problems))


def encode_record(tree: Tree, record: Any) -> None:
    """Write dataset ``t``, and one for each signal in groups ``inputs`` and ``outputs``."""
    tree.attrs["name"] = record.name
    tree.put("t", record.t, unit="s", **({"meaning": record.meaning["t"]} if "t" in record.meaning else {}))
    for side in ("inputs", "outputs"):
        group = tree.group(side)
        for position, (name, values) in enumerate(getattr(record, side).items()):
            attrs = {"unit": record.units.get(name, ""), "meaning": record.meaning.get(name, ""), "position": position}
            group.put(link_name(name), values, **attrs)


def decode_record(tree: Tree, _problems: Problems, _transpose: bool) -> Record:
    from robustlab.files.records import stored_record

    return record_of(stored_record(tree, tree.file), tree.file)


def record_of(keywords: dict[str, Any], where: str) -> Record:
    """Return the record of these arguments; its error names the file."""
    from robustlab.record import Record

    name = keywords.pop("name")
    try:
        return Record(**keywords, name=name)
    except InputError as error:
        found = f"{error.where.removeprefix(name).lstrip(': ')} {error.found}".strip()
        raise InputError(where, found, error.expected, error.hint) from None


# --- results: nested groups of the values of ``to_json`` --------------------------------------------------------------

LEAVES: dict[str, Any] = {
    "text": str,
    "bool": (bool, np.bool_),
    "number": (int, float, np.integer, np.floating),
    "complex": (complex, np.complexfloating),
}


def encode_result(tree: Tree, result: Any) -> None:
    """Write attributes ``type`` and ``status``, group ``data`` of datasets and tables, and the claims."""
    from robustlab.evidence.verification import claims_of

    data = dict(result.to_json())
    if isinstance(result, Result):
        data.pop("type")
    data.pop("status", None)
    tree.attrs.update(
        type=result.type if isinstance(result, Result) else type(result).__name__, status=Status(result.status).value
    )
    _table(tree.group("data"), data)
    encode_claims(tree, claims_of(result))


def encode_claims(tree: Tree, claims: Sequence[Claim]) -> None:
    """Write groups ``claims/0``, ``claims/1``, ..., with the kind in the attribute ``claim``."""
    for k, claim in enumerate(claims):
        node = tree.group("claims").group(str(k))
        node.attrs["claim"] = claim.kind
        for name, values in claim.numbers.items():
            node.put(name, values)


def _table(tree: Tree, data: Mapping[Any, Any]) -> None:
    for key, value in data.items():
        _put(tree, link_name(str(key)), value)


def _put(tree: Tree, link: str, value: Any) -> None:
    """Write a rectangular list of numbers or texts as one dataset, another list as a group of numbered children."""
    if hasattr(value, "to_json"):
        value = value.to_json()
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, (set, frozenset)) or (isinstance(value, np.ndarray) and value.dtype == object):
        value = list(value)
    if value is None:
        tree.put(link, "", null=True)
    elif isinstance(value, Mapping):
        _table(tree.group(link), value)
    elif not isinstance(value, (list, tuple)):
        tree.put(link, value)
    elif len(kinds := set(map(_kind, _leaves(value)))) == 1 and None not in kinds and _is_rectangular(value):
        tree.put(link, np.asarray(value))
    else:
        group = tree.group(link)
        group.attrs["sequence"] = len(value)
        for i, item in enumerate(value):
            _put(group, str(i), item)


def _leaves(items: Sequence[Any]) -> Iterator[Any]:
    for item in items:
        yield from _leaves(item) if isinstance(item, (list, tuple)) else (item,)


def _kind(value: Any) -> str | None:
    words = (word for word, types in LEAVES.items() if isinstance(value, types))
    return None if isinstance(value, Enum) else next(words, None)


def _is_rectangular(items: Sequence[Any]) -> bool:
    try:
        return np.asarray(items).dtype != object
    except ValueError:
        return False


class NotStored(InputError, AttributeError):
    """An attribute of a result that is not in its file."""


class LoadedResult(Result):
    """A result from a file, with the stored values as attributes."""

    def __getattr__(self, name: str) -> Any:
        data = vars(self).get("data", {})
        if name not in data:
            raise NotStored(type(self).__name__, f"{name!r} is not in its file", f"one of {', '.join(data)}")
        return _attribute(data[name])

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.data]

    def __reduce__(self) -> tuple[Any, ...]:
        return restored, (self.type, self.status, self.data)


def restored(kind: str, status: Status, data: Mapping[str, Any]) -> LoadedResult:
    return _class(kind)(kind, status, data)


@cache
def _class(name: str) -> type[LoadedResult]:
    return type(name, (LoadedResult,), {"__doc__": LoadedResult.__doc__}) if name.isidentifier() else LoadedResult


def _attribute(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_attribute, value))
    if not isinstance(value, Mapping):
        return value
    if value.get("type") and value.get("status") in list(Status):
        rest = {name: x for name, x in value.items() if name not in ("type", "status")}
        return restored(str(value["type"]), Status(value["status"]), rest)
    if {"A", "B", "C", "D", "dt", "inputs", "outputs", "states"} <= set(value):
        A, B, C, D = (value[letter] for letter in "ABCD")
        u, y, x = ([tuple(pair) for pair in value[side]] for side in ("inputs", "outputs", "states"))
        return StateSpaceModel(A, B, C, D, value["dt"], u, y, x)
    return {name: _attribute(x) for name, x in value.items()}


def decode_result(tree: Tree, _problems: Problems, _transpose: bool = False) -> LoadedResult:
    """Invert `encode_result`; lists of numbers become arrays."""
    text = str(np.asarray(tree.attrs.get("status", "")))
    if text not in list(Status):
        raise InputError(tree.file, f"attribute status is {text!r}", f"one of {', '.join(Status)}")
    data = _value(tree.groups["data"]) if "data" in tree.groups else None
    if not isinstance(data, dict):
        raise InputError(tree.file, "/data is a sequence" if data else "missing /data", "a table")
    return restored(str(np.asarray(tree.attrs.get("type", ""))), Status(text), data)


def _value(node: Tree) -> Any:
    names = [*node.datasets, *node.groups]
    if "sequence" not in node.attrs:
        return {signal_name(link): _child(node, link) for link in names}
    length = np.asarray(node.attrs["sequence"])
    if length.dtype.kind != "i" or length.size != 1:
        raise InputError(node.file, f"{node.path}: attribute sequence is no whole number", "the length of the list")
    numbered = [str(i) for i in range(min(int(length.flat[0]), len(names)))]
    return [_child(node, name) for name in numbered if name in names]


def _child(node: Tree, link: str) -> Any:
    if link not in node.datasets:
        return _value(node.groups[link])
    values = node.datasets[link].values
    if isinstance(values, Unread):
        raise InputError(node.file, f"{node.child_path(link)} has dtype {values.dtype}", "numbers or text")
    if "null" in node.datasets[link].attrs:
        return None
    return values.tolist() if values.ndim == 0 or values.dtype.kind == "U" else values


BY_KIND = {
    codec.kind: codec
    for codec in (
        Codec("state-space", "statespace.StateSpaceModel", "matrices"),
        Codec("uncertain", "uncertainty.lft.UncertainModel"),
        Codec("delayed", "delays.model.DelayedModel"),
        Codec("frequency-data", "uncertainty.frequency_responses.UncertainFrequencyData"),
        Codec("lpv", "synthesis.scheduling.parameter_varying.LPVModel"),
        Codec("lpv-controller", "synthesis.scheduling.parameter_varying.LPVController"),
        Codec("controller", "synthesis.problem.controller.Controller"),
        Codec("record", "record.Record"),
        Codec("plant", "dynamics.plant_base.Plant", "plants"),
        Codec("result", "result.Result"),
    )
}
