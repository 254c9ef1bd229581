"""Models in a file, but for plain ones: uncertain, frequency responses, with exact delays, LPV, pairs; controllers."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robustlab.delays.model import DelayedModel
from robustlab.errors import InputError, UnitMismatch
from robustlab.files.tree import Tree, Unread
from robustlab.result import Status
from robustlab.signals import Taken
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.storage.matrices import (
    Problems,
    decode_model,
    decode_point,
    decode_signals,
    encode_model,
    encode_point,
    encode_signals,
    entries,
    find_children,
    sample_time,
)
from robustlab.synthesis.scheduling.parameter_varying import LPVModel, SchedulingParameter
from robustlab.synthesis.scheduling.scheduled_synthesis import LPVController
from robustlab.uncertainty.blocks import KINDS, Block, ParameterRange
from robustlab.uncertainty.frequency_responses import UncertainFrequencyData
from robustlab.uncertainty.lft import UncertainModel

if TYPE_CHECKING:
    from robustlab.synthesis.problem.design import Controller

# How designs called what a controller takes, before its inputs said it themselves.
OLD_NAMES = (
    (re.compile(r"e (.+)|error (.+) measured"), "r - y"),
    (re.compile(r"(.+) reference(?: taken)?|(.+)_ref"), "r"),
    (re.compile(r"(.+) measured"), "y"),
)
# Those whose measurements are named by the plant: "e NAME" is a signal of it.
BY_PLANT = ("hinf", "h2", "h2-hinf", "dk", "fixed")
DESIGNED = re.compile(r"mixsyn|tune|lqg|lqr|lqi|ncf( with a reference model)?|cascade|(reduced|sampled) .+")
FIELDS = ("name", "kind", "rows", "cols", "nominal", "radius", "unit", "below", "origin", "sign")


def encode_uncertain(tree: Tree, model: UncertainModel) -> None:
    """Group ``M`` as a state-space model, group ``blocks`` with one entry per block in each dataset.

    The dataset ``below`` (width of a range beneath its nominal value) is there only if some range is not symmetric,
    ``origin`` only if some block says where it comes from, ``sign`` only if physics limits some parameter's sign.

    Raises InputError: a kind of block that files do not know.
    """
    encode_model(tree.group("M"), model.M)
    if model.operating_point is not None:
        encode_point(tree, model.operating_point)
    encode_blocks(tree, model.blocks)


def encode_blocks(tree: Tree, blocks: Sequence[Block]) -> None:
    """Group ``blocks``; see `encode_uncertain`."""
    for b in blocks:
        if KINDS.get(b.stored_as) is not type(b):
            found = f"a {type(b).__name__}, a kind of block without a place in the file format"
            raise InputError(f"save: block {b.name!r}", found, f"blocks of the kinds {', '.join(KINDS)}")
    parameters = [b.parameter for b in blocks]
    columns: dict[str, Any] = {
        "name": np.array([b.name for b in blocks], dtype=np.str_),
        "kind": np.array([b.stored_as for b in blocks], dtype=np.str_),
        "rows": np.array([b.rows for b in blocks], dtype=np.int64),
        "cols": np.array([b.cols for b in blocks], dtype=np.int64),
        "nominal": np.array([p.nominal if p else np.nan for p in parameters], dtype=np.float64),
        "radius": np.array([p.radius if p else np.nan for p in parameters], dtype=np.float64),
        "unit": np.array([p.unit if p else "" for p in parameters], dtype=np.str_),
    }
    if any(p and p.below is not None for p in parameters):
        widths = [np.nan if p is None or p.below is None else p.below for p in parameters]
        columns["below"] = np.array(widths, dtype=np.float64)
    signs = [p.sign if p else "any" for p in parameters]
    if any(sign != "any" for sign in signs):
        columns["sign"] = np.array(signs, dtype=np.str_)
    if any(b.origin for b in blocks):
        columns["origin"] = np.array([b.origin for b in blocks], dtype=np.str_)
    for name, values in columns.items():
        tree.group("blocks").put(name, values)


def decode_uncertain(tree: Tree, problems: Problems, transpose: bool = False) -> UncertainModel:
    """Inverse of `encode_uncertain`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("M", "blocks"), problems, kind="group")
    model = decode_model(tree.groups["M"], problems, transpose) if "M" in tree.groups else None
    blocks = decode_blocks(tree.groups["blocks"], problems) if "blocks" in tree.groups else ()
    point = decode_point(tree, problems)
    problems.raise_any()
    assert model is not None
    try:
        return UncertainModel(model, blocks, point)
    except InputError as error:
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None


def decode_blocks(group: Tree, problems: Problems) -> tuple[Block, ...]:
    """Inverse of `encode_blocks`; what does not fit is noted in ``problems``."""
    find_children(group, FIELDS[:4], problems, kind="dataset")
    columns: dict[str, list[Any]] = {}
    for name in FIELDS:
        if name not in group.datasets:
            continue
        found = entries(group, name, "U" if name in ("name", "kind", "unit", "origin", "sign") else "fi", problems)
        if found is not None:
            columns[name] = found
    lengths = {name: len(values) for name, values in columns.items()}
    if problems.lines:
        return ()
    for name, length in lengths.items():
        if length != lengths["name"]:
            names = group.child_path("name")
            problems.add(f"{group.child_path(name)} has {length} entries, expected {lengths['name']} as {names}")
    if problems.lines:
        return ()
    result = [_block(i, columns, group.path, problems) for i in range(lengths["name"])]
    return tuple(block for block in result if block is not None)


def _block(i: int, columns: dict[str, list[Any]], path: str, problems: Problems) -> Block | None:
    name, kind, rows, cols = (columns[field][i] for field in FIELDS[:4])
    if kind not in KINDS:
        problems.add(f"{path}/kind[{i}] is {kind!r}, expected real, complex or full")
        return None
    whole = all(math.isfinite(size) and size == int(size) and size >= 1 for size in (rows, cols))
    if not whole or (KINDS[kind].is_scalar and rows != cols):
        problems.add(
            f"{path}: block {name!r} ({kind}) is {rows:g} x {cols:g}, expected whole sizes, square for a scalar block"
        )
        return None
    origin = columns["origin"][i] if "origin" in columns else ""
    try:
        return KINDS[kind].from_row(name, int(rows), int(cols), _parameter(i, columns, path, problems), origin)
    except InputError as error:
        problems.absorb(error)
        return None


def _parameter(i: int, columns: dict[str, list[Any]], path: str, problems: Problems) -> ParameterRange | None:
    if "nominal" not in columns or "radius" not in columns:
        return None
    nominal, radius = columns["nominal"][i], columns["radius"][i]
    if np.isnan(nominal) and np.isnan(radius):
        return None
    if not (np.isfinite(nominal) and np.isfinite(radius)):
        name = columns["name"][i]
        problems.add(
            f"{path}: block {name!r}: nominal {nominal:g}, radius {radius:g}, expected both finite or both NaN"
        )
        return None
    below = columns["below"][i] if "below" in columns and not np.isnan(columns["below"][i]) else None
    sign = columns["sign"][i] if "sign" in columns else "any"
    return ParameterRange(nominal, radius, columns["unit"][i] if "unit" in columns else "", below, sign=sign)


def encode_controller(tree: Tree, controller: Controller) -> None:
    """K as a state-space model; ``gamma``, ``status``, ``method`` as attributes."""
    encode_model(tree, controller.K)
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma


def decode_controller(tree: Tree, problems: Problems, transpose: bool = False) -> Controller:
    """Inverse of `encode_controller`. Raises InputError: with all that is missing or does not fit."""
    model: StateSpaceModel | None = decode_model(tree, problems, transpose)
    gamma = None
    if "gamma" in tree.attrs:
        value = np.asarray(tree.attrs["gamma"])
        if value.dtype.kind in "fi" and value.size == 1:
            gamma = float(value.flat[0])
        else:
            problems.add("attribute gamma is not one real number")
    text = str(np.asarray(tree.attrs.get("status", Status.INCONCLUSIVE.value)))
    if text not in [status.value for status in Status]:
        problems.add(f"attribute status is {text!r}, expected one of {', '.join(s.value for s in Status)}")
    problems.raise_any()
    assert model is not None
    from robustlab.synthesis.problem.design import Controller

    method = str(np.asarray(tree.attrs.get("method", "")))
    return Controller(said_by_names(model, method), gamma, Status(text), method)


def said_by_names(K: StateSpaceModel, method: str) -> StateSpaceModel:
    """A controller of an older file, which does not say what it takes, with what its method and its names say.

    Designs called the error ``e NAME`` or ``error NAME measured``, a reference ``NAME reference (taken)`` or
    ``NAME_ref``, a signal itself ``NAME`` or ``NAME measured``. Of a controller by other hands nothing is known.
    """
    ours = method in BY_PLANT or DESIGNED.fullmatch(method)
    if not ours or any(isinstance(s, Taken) for s in K.inputs):
        return K
    inputs = []
    known = [(pattern, takes) for pattern, takes in OLD_NAMES if takes != "r - y" or method not in BY_PLANT]
    for name, unit in K.inputs:
        met = ((pattern.fullmatch(name), takes) for pattern, takes in known)
        takes, of = next(((t, next(filter(None, m.groups()))) for m, t in met if m), ("y", name))
        inputs.append(Taken(name, unit, takes, of))
    return K.renamed(inputs)


def encode_frequency_data(tree: Tree, data: UncertainFrequencyData) -> None:
    """Datasets ``omega`` and ``M``, group ``blocks`` as of an uncertain model, ``signals``."""
    tree.put("omega", np.asarray(data.omega, dtype=np.float64))
    tree.put("M", np.asarray(data.M, dtype=np.complex128))
    encode_blocks(tree, data.blocks)
    encode_signals(tree, ((), data.inputs, data.outputs))


def decode_frequency_data(tree: Tree, problems: Problems) -> UncertainFrequencyData:
    """Inverse of `encode_frequency_data`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("omega", "M"), problems, kind="dataset")
    find_children(tree, ("blocks",), problems, kind="group")
    omega = entries(tree, "omega", "fi", problems) if "omega" in tree.datasets else None
    values = tree.datasets["M"].values if "M" in tree.datasets else None
    if isinstance(values, Unread) or (values is not None and values.dtype.kind not in "fic"):
        problems.add(f"{tree.child_path('M')} is not readable as complex numbers")
    blocks = decode_blocks(tree.groups["blocks"], problems) if "blocks" in tree.groups else ()
    _, inputs, outputs = decode_signals(tree, problems)
    problems.raise_any()
    assert omega is not None
    assert isinstance(values, np.ndarray)
    try:
        return UncertainFrequencyData(omega, values, blocks, inputs, outputs)
    except InputError as error:
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None


def encode_delayed(tree: Tree, model: DelayedModel) -> None:
    """Group ``H`` as a state-space model, dataset ``delays`` in s: those of its first inputs and outputs."""
    encode_model(tree.group("H"), model.H)
    tree.put("delays", np.asarray(model.delays, dtype=np.float64))


def decode_delayed(tree: Tree, problems: Problems, transpose: bool = False) -> DelayedModel:
    """Inverse of `encode_delayed`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("H",), problems, kind="group")
    find_children(tree, ("delays",), problems, kind="dataset")
    model = decode_model(tree.groups["H"], problems, transpose) if "H" in tree.groups else None
    lengths = entries(tree, "delays", "fi", problems) if "delays" in tree.datasets else None
    problems.raise_any()
    assert model is not None
    try:
        return DelayedModel(model, np.array(lengths, dtype=np.float64))
    except InputError as error:
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None


def encode_lpv(tree: Tree, thing: LPVModel | LPVController) -> str:
    """Stacked ``matrices`` [A B; C D] over the grid, ``deviation`` over its cells, parameters and signals; the kind.

    A controller has the attributes of kind ``controller`` as well.
    """
    model = thing.K if isinstance(thing, LPVController) else thing
    tree.put("matrices", model.matrices)
    tree.put("deviation", model.deviation)
    tree.attrs.update(states=model.n_states, known=model.known)
    group = tree.group("parameters")
    group.put("name", np.array([p.name for p in model.parameters], dtype=np.str_))
    group.put("unit", np.array([p.unit for p in model.parameters], dtype=np.str_))
    group.put("rate", np.array([p.rate for p in model.parameters]))
    group.put("count", np.array([len(p.points) for p in model.parameters]))
    group.put("points", np.concatenate([p.points for p in model.parameters]))
    encode_signals(tree, (model.states, model.inputs, model.outputs))
    if not isinstance(thing, LPVController):
        return "lpv"
    tree.attrs.update(status=thing.status.value, method=thing.method)
    if thing.gamma is not None:
        tree.attrs["gamma"] = thing.gamma
    return "lpv-controller"


def decode_lpv(tree: Tree, problems: Problems, *, controller: bool) -> LPVModel | LPVController:
    """Inverse of `encode_lpv`. Raises InputError: with all that is missing or does not fit."""
    find_children(tree, ("matrices", "deviation"), problems, kind="dataset")
    find_children(tree, ("parameters", "signals"), problems, kind="group")
    problems.raise_any()
    arrays = {name: _array(tree, name, problems) for name in ("matrices", "deviation")}
    group, columns = tree.groups["parameters"], {}
    for name, kinds in (("name", "U"), ("unit", "U"), ("rate", "fi"), ("count", "i"), ("points", "fi")):
        find_children(group, (name,), problems, kind="dataset")
        columns[name] = entries(group, name, kinds, problems) if name in group.datasets else None
    sides = [side or [] for side in decode_signals(tree, problems)]
    problems.raise_any()
    try:
        model = _model(arrays, columns, sides, tree)
    except (InputError, ValueError, KeyError, IndexError) as error:
        said = error.line if isinstance(error, InputError) else str(error)
        raise InputError(problems.file, f"no LPV model: {said}", "what kind lpv of format 1 says") from None
    if not controller:
        return model
    gamma = np.asarray(tree.attrs.get("gamma", np.nan), dtype=float)
    text = str(np.asarray(tree.attrs.get("status", Status.INCONCLUSIVE.value)))
    if gamma.size != 1 or text not in [s.value for s in Status]:
        raise InputError(problems.file, f"attributes gamma or status ({text!r})", "a number, and a status")
    value = float(gamma.flat[0])
    method = str(np.asarray(tree.attrs.get("method", "")))
    return LPVController(model, None if np.isnan(value) else value, Status(text), method)


def _array(tree: Tree, name: str, problems: Problems) -> Any:
    values = tree.datasets[name].values
    if isinstance(values, Unread) or values.dtype.kind not in "fi" or values.ndim < 3 or not np.isfinite(values).all():
        problems.add(f"{tree.child_path(name)}: expected finite real numbers, three dimensions or more")
        return None
    return values.astype(np.float64)


def _model(arrays: dict[str, Any], columns: dict[str, Any], sides: list[list[Signal]], tree: Tree) -> LPVModel:
    ends, given = np.cumsum(columns["count"]), len(columns["points"])
    if not len(ends) or ends[-1] != given:
        raise InputError("parameters", f"{given} points", f"{sum(columns['count'])}, as count says")
    points = np.split(np.asarray(columns["points"], float), ends[:-1])
    parameters = tuple(
        SchedulingParameter(name, tuple(values), rate, unit)
        for name, unit, rate, values in zip(columns["name"], columns["unit"], columns["rate"], points, strict=True)
    )
    states, inputs, outputs = sides
    n, matrices = int(np.asarray(tree.attrs["states"])), arrays["matrices"]
    grid = tuple(len(p.points) for p in parameters)
    expected = (*grid, n + len(outputs), n + len(inputs))
    if matrices.shape != expected or len(states) != n:
        raise InputError("matrices", f"shape {matrices.shape}", f"{expected}")
    known = str(np.asarray(tree.attrs["known"]))
    return LPVModel.of(parameters, matrices, n, inputs, outputs, states, arrays["deviation"], known)


GROUPS = ("nominal", "perturbed")


def looks_like_a_pair(tree: Tree) -> bool:
    """True where the root holds no matrices, but groups called ``nominal`` or ``perturbed`` or much like it."""
    import difflib

    if any(name in tree.datasets for name in "ABCD"):
        return False
    return any(difflib.get_close_matches(name.lower(), GROUPS, n=1, cutoff=0.7) for name in tree.groups)


def decode_pair(tree: Tree, problems: Problems, transpose: bool = False) -> tuple[StateSpaceModel, StateSpaceModel]:
    """The models in groups ``nominal`` and ``perturbed``.

    Raises InputError: with all that is missing, misspelt or does not fit, in both groups; `UnitMismatch` where only
    units disagree.
    """
    find_children(tree, GROUPS, problems)
    dt = sample_time(tree, problems)
    models: dict[str, StateSpaceModel | None] = {}
    for name in GROUPS:
        if name in tree.groups and "E" in tree.groups[name].datasets:
            hint = "--group nominal, or --group perturbed, reads one model (group=)"
            problems.add(f"/{name}/E: a pair in descriptor form: its entries are no entries of A, B, C, D", hint)
        elif name in tree.groups:
            models[name] = decode_model(tree.groups[name], problems, transpose, models.get("nominal"), dt)
        elif name in tree.datasets:
            problems.add(f"/{name} is a dataset, expected a group with A B C D")
    problems.raise_any()
    nominal, perturbed = models["nominal"], models["perturbed"]
    assert nominal is not None
    assert perturbed is not None
    check_pair(nominal, perturbed, tree.file)
    return nominal, perturbed


def check_pair(nominal: StateSpaceModel, perturbed: StateSpaceModel, where: str = "nominal and perturbed") -> None:
    """Refuse two models whose entries do not mean the same; a unit that is not stated agrees with every unit.

    Raises UnitMismatch: a signal carries different units; InputError: sizes, sample times or signal names differ.
    """
    sizes = [(m.n_states, m.n_inputs, m.n_outputs) for m in (nominal, perturbed)]
    if sizes[0] != sizes[1]:
        raise InputError(
            where,
            "perturbed has {} states, {} inputs, {} outputs".format(*sizes[1]),
            "{}, {}, {} as nominal".format(*sizes[0]),
        )
    if nominal.dt != perturbed.dt:
        raise InputError(
            where, f"nominal has dt = {nominal.dt:g} s, perturbed dt = {perturbed.dt:g} s", "equal sample times"
        )
    names, units = [], []
    for side in ("states", "inputs", "outputs"):
        for a, b in zip(getattr(nominal, side), getattr(perturbed, side), strict=True):
            (names if a.name != b.name else units).extend(_differences(side[:-1], a, b))
    if names:
        more = tuple(f"{where}: {line}" for line in names[1:])
        raise InputError(where, names[0], "the same signals in the same order", None, more)
    if units:
        raise UnitMismatch(where, units[0], "equal units", None, tuple(f"{where}: {line}" for line in units[1:]))


def _differences(side: str, a: Signal, b: Signal) -> list[str]:
    if a.name != b.name:
        return [f"{side} {a.name!r} of nominal is {b.name!r} in perturbed"]
    if a.unit and b.unit and a.unit != b.unit:
        return [f"{side} {a.name}: nominal [{a.unit}], perturbed [{b.unit}]"]
    return []


@dataclass(frozen=True)
class Change:
    """One entry of A, B, C or D that differs."""

    matrix: str  # `"A"`, `"B"`, `"C"` or `"D"`
    # row, column: names of the signals: the entry says how `column` acts on `row` (on its derivative, in A and B)
    row: str
    column: str
    # first, second: the two values
    first: float
    second: float

    @property
    def relative(self) -> float:
        """``(second - first) / |first|``; infinite where the first value is zero."""
        step = self.second - self.first
        return step / abs(self.first) if self.first else np.copysign(np.inf, step)

    def to_json(self) -> dict[str, object]:
        """All attributes and the relative change."""
        return {**vars(self), "relative": self.relative}


def difference(first: StateSpaceModel, second: StateSpaceModel, rtol: float = 0.0) -> tuple[Change, ...]:
    """Entries with ``|second - first| > rtol * max(|first|, |second|)``.

    Raises InputError: the models have other sizes, signals, units or sample times; see `check_pair`.
    """
    check_pair(first, second, "difference of two models")
    rows = {"A": first.state_names, "B": first.state_names, "C": first.output_names, "D": first.output_names}
    columns = {"A": first.state_names, "B": first.input_names, "C": first.state_names, "D": first.input_names}
    changes = []
    for name in "ABCD":
        a, b = getattr(first, name), getattr(second, name)
        for i, j in np.argwhere(np.abs(b - a) > rtol * np.maximum(np.abs(a), np.abs(b))):
            changes.append(Change(name, rows[name][i], columns[name][j], float(a[i, j]), float(b[i, j])))
    return tuple(changes)
