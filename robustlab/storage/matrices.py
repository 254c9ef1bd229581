"""State-space models in files: the matrices A B C D, signals, operating point; all faults are raised at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from robustlab.arrays import Array, not_finite
from robustlab.display import AllFields, Displayable, Facts, Part
from robustlab.errors import InputError, UnitMismatch, did_you_mean
from robustlab.files.tree import Tree, Unread, one_number, type_name
from robustlab.result import Status
from robustlab.signals import COMPLEX, TAKES, Taken
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel

Made = TypeVar("Made")


@dataclass
class Problems:
    """Faults of one file, in the order in which they were found."""

    file: str  # name of the file in messages
    lines: list[str] = field(default_factory=list)  # one fault each, beginning with the path in the file
    hint: str | None = None  # the first hint given
    notes: list[str] = field(default_factory=list)  # remarks on a valid file

    def add(self, line: str, hint: str | None = None) -> None:
        self.lines.append(line)
        self.hint = self.hint or hint

    def absorb(self, error: InputError) -> None:
        where = error.where.removeprefix(f"{self.file}: ").removeprefix(self.file)
        text = f"{error.found}" + (f", expected {error.expected}" if error.expected else "")
        self.add(f"{where}: {text}" if where else text, error.hint)
        self.lines.extend(error.more)

    def raise_any(self) -> None:
        """Raise one `InputError` with all faults, if there are any."""
        if self.lines:
            more = tuple(f"{self.file}: {line.removeprefix(f'{self.file}: ')}" for line in self.lines[1:])
            raise InputError(self.file, self.lines[0], None, self.hint, more)

    def built(self, make: Callable[..., Made], *parts: Any) -> Made:
        """Construct an object of the parts read; its error names the file."""
        self.raise_any()
        try:
            return make(*parts)
        except InputError as error:
            if error.where.startswith(self.file):
                raise
            raise InputError(self.file, f"{error.where}: {error.found}", error.expected, error.hint) from None


Shape = tuple[int, ...]
NAMES = ("A", "B", "C", "D")
SIDES = ("state", "input", "output")
SIGNAL = ("name", "unit", "takes", "of")
TYPES: dict[str, type] = {"U": np.str_, "i": np.int64, "fi": np.float64}  # kinds of a column
COLUMN_MAJOR = "file looks column-major: use transpose=True"


def encode_state_space(tree: Tree, model: StateSpaceModel) -> None:
    for name in NAMES:
        tree.put(name, getattr(model, name))
    tree.attrs["dt"] = model.dt
    encode_signals(tree, (model.states, model.inputs, model.outputs))
    encode_point(tree, model.operating_point)


def encode_signals(tree: Tree, given: Sequence[Sequence[Signal]]) -> None:
    """Write names and units of states, inputs and outputs into ``tree``, and the signals a controller takes."""
    for side, signals in zip(SIDES, given, strict=True):
        taken = any(isinstance(s, Taken) for s in signals)
        put_columns(tree.group("signals").group(side), dict.fromkeys(SIGNAL if taken else SIGNAL[:2], "U"), signals)


def encode_point(tree: Tree, point: OperatingPoint | None) -> None:
    for name in ("x", "u", "y") if point is not None else ():
        tree.group("operating_point").put(name, getattr(point, name))


def decode_model(
    node: Tree,
    problems: Problems,
    transpose: bool = False,
    like: StateSpaceModel | None = None,
    dt: float | None = None,
) -> StateSpaceModel | None:
    """Return the model in ``node``, or None with the faults in ``problems``; a descriptor form (with E) is noted."""
    found = len(problems.lines)
    matrices = _matrices(node, problems, transpose)
    if len(problems.lines) > found:
        return None
    _fit(matrices, node, problems, like)
    e = matrices.get("E")
    own_dt = sample_time(node, problems)
    signals = decode_signals(node, problems)
    point = decode_point(node, problems)
    if len(problems.lines) > found:
        return None
    if like is not None:
        signals = tuple(s or t for s, t in zip(signals, (like.states, like.inputs, like.outputs), strict=True))
    states, inputs, outputs = signals
    step = own_dt if own_dt is not None else dt or 0.0
    where = problems.file if node.path == "/" else f"{problems.file}: {node.path}"
    try:
        a, b, c, d = (matrices[name] for name in NAMES)
        at = point if e is None else None
        model = StateSpaceModel(a, b, c, d, step, inputs, outputs, states, at, where=where)
        return model if e is None else _eliminated(model, e, point, problems, where)
    except InputError as error:
        problems.absorb(error)
        return None


def _eliminated(
    model: StateSpaceModel, e: Array, point: OperatingPoint | None, problems: Problems, where: str
) -> StateSpaceModel:
    """Return the model of a descriptor form, at its operating point if the states allow it."""
    from robustlab.dynamics.descriptor_elimination import eliminated

    found, kept, residual = eliminated(model, e, where)
    count, n = model.n_states - found.n_states, model.n_states
    words = f"{count} of {n} states eliminated" if count else "E has an inverse, all states stay"
    problems.notes.append(f"descriptor form of index {int(count > 0)}: {words}; relative residual {residual:.1e}")
    if point is None or kept is None:
        return found
    if len(point.x) != n:
        raise InputError("", f"operating_point.x has {len(point.x)} entries", f"{n}")
    return replace(found, operating_point=replace(point, x=np.asarray(point.x)[kept]))


def decode_state_space(tree: Tree, problems: Problems, transpose: bool = False) -> StateSpaceModel:
    model = decode_model(tree, problems, transpose)
    problems.raise_any()
    assert model is not None
    return model


def find_children(
    node: Tree, wanted: Sequence[str], problems: Problems, known: Sequence[str] = (), kind: str = "dataset"
) -> None:
    """Add a fault for every missing child, and for similar names; ``kind`` is ``dataset`` or ``group``."""
    present = [*node.datasets, *node.groups]
    missing = [name for name in wanted if name not in present]
    for name in wanted:
        if name in present and name not in (node.groups if kind == "group" else node.datasets):
            other = "dataset" if kind == "group" else "group"
            problems.add(f"{node.child_path(name)} is a {other}, expected a {kind}")
    for name in missing:
        problems.add(f"missing {node.child_path(name)}")
    lower = {item.lower(): item for item in missing}
    for name in present:
        if name not in wanted and name not in known:
            hint = (did_you_mean(name, missing) or "").removeprefix("did you mean ").removesuffix("?")
            close = lower.get(name.lower()) or hint
            if close:
                problems.add(f"unexpected {node.child_path(name)} (did you mean {node.child_path(close)}?)")


def need(tree: Tree, problems: Problems, groups: Sequence[str] = (), datasets: Sequence[str] = ()) -> None:
    find_children(tree, datasets, problems)
    find_children(tree, groups, problems, kind="group")
    problems.raise_any()


def _matrices(node: Tree, problems: Problems, transpose: bool) -> dict[str, Array]:
    """Return A, B, C, D, and E of a descriptor form (MATLAB writes [] for the identity)."""
    find_children(node, NAMES, problems, known=("E",))
    matrices = {}
    for name in (*NAMES, "E"):
        values = node.datasets[name].values if name in node.datasets else np.zeros(0)
        if name == "E" and not isinstance(values, Unread) and not values.size:
            continue
        matrix = _real(node, name, problems) if name in node.datasets else None
        if matrix is not None:
            matrices[name] = np.ascontiguousarray(matrix.T) if transpose else matrix
    return matrices


def _real(node: Tree, name: str, problems: Problems) -> Array | None:
    values, path = node.datasets[name].values, node.child_path(name)
    if isinstance(values, Unread) or values.dtype.kind not in "fi":
        hint = COMPLEX if not isinstance(values, Unread) and values.dtype.kind == "c" else None
        if isinstance(values, Unread) and values.dtype.startswith("MATLAB object"):
            hint = "MATLAB's own objects cannot be read: save the matrices, [A,B,C,D] = ssdata(sys)"
        problems.add(f"{path} has dtype {type_name(values)}, expected real numbers", hint)
        return None
    array = values.astype(np.float64)
    if array.ndim == 0:
        array = array.reshape(1, 1)
    if array.ndim != 2:
        column = f" ({len(array)}, 1) for a column, (1, {len(array)}) for a row" if array.ndim == 1 else ""
        problems.add(f"{path} is {array.shape}, expected 2 dimensions{column and ':' + column}")
        return None
    bad = not_finite(array)
    if bad is not None:
        problems.add(f"{path}[{bad[0]}] {bad[1]}")
        return None
    return array


def _fit(matrices: dict[str, Array], node: Tree, problems: Problems, like: StateSpaceModel | None) -> None:
    """Reshape empty matrices of a static gain; add faults for shapes that do not fit."""
    if matrices["A"].shape == (0, 0):  # MATLAB writes [] for all three
        p, m = matrices["D"].shape
        for name, proper in (("B", (0, m)), ("C", (p, 0))):
            matrices[name] = matrices[name] if matrices[name].size else np.zeros(proper)
    shapes = {name: matrices[name].shape for name in NAMES}
    expected = {name: getattr(like, name).shape for name in NAMES} if like is not None else _expected(shapes)
    wrong = [name for name in NAMES if shapes[name] != expected[name]]
    swapped = {name: shape[::-1] for name, shape in shapes.items()}
    hint = None
    if wrong and (swapped == expected or (like is None and swapped == _expected(swapped))):
        expected, hint = swapped, COLUMN_MAJOR
        wrong = [name for name in NAMES if shapes[name] != expected[name]]
    elif wrong and all(swapped[name] == expected[name] for name in wrong):
        both = " and ".join(wrong)
        hint = f"only {both} looks transposed; store the transpose (transpose=True swaps all four matrices)"
    for name in wrong:
        match = f" to match {node.path.rsplit('/', 1)[0]}/nominal/{name}" if like is not None else ""
        problems.add(f"{node.child_path(name)} is {shapes[name]}, expected {expected[name]}{match}", hint)
    if not wrong and "E" in matrices and matrices["E"].shape != shapes["A"]:
        same = f"expected {shapes['A']} as {node.child_path('A')}"
        problems.add(f"{node.child_path('E')} is {matrices['E'].shape}, {same}")


def _expected(shapes: Mapping[str, Shape]) -> dict[str, Shape]:
    a, b, c, d = (shapes[name] for name in NAMES)
    # A square A defines the number of states.
    n = a[0] if a[0] == a[1] else Counter([a[0], a[1], b[0], c[1]]).most_common(1)[0][0]
    m = b[1] if b[0] == n else d[1]
    p = c[0] if c[1] == n else d[0]
    return {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}


def sample_time(node: Tree, problems: Problems) -> float | None:
    """Return ``dt`` in s from an attribute or a scalar dataset (``dt`` or ``Ts``), or None."""
    held = {f"{node.path} attribute {name}": node.attrs[name] for name in ("dt", "Ts") if name in node.attrs}
    held |= {node.child_path(name): node.datasets[name].values for name in ("dt", "Ts") if name in node.datasets}
    for path, item in held.items():
        number = one_number(item)
        if number is None:
            problems.add(f"{path} is not one real number, expected a sample time in s (0 = continuous)")
        elif not np.isfinite(number) or number < 0:
            problems.add(f"{path} is {number:g}, expected 0 (continuous) or a positive sample time in s")
        return number
    return None


def decode_signals(node: Tree, problems: Problems) -> tuple[list[Signal] | None, ...]:
    """Return states, inputs, outputs from ``signals/``, or from the variables of a MATLAB export."""
    result: list[list[Signal] | None] = []
    for side in SIDES:
        group, names = node.groups.get("signals", Tree()).groups.get(side), SIGNAL
        if group is None:
            group, names = node, tuple(f"{side.capitalize()}{word.capitalize()}" for word in SIGNAL)
            if names[0] not in node.datasets:
                result.append(None)
                continue
        found = columns(group, dict.fromkeys(names, "U"), problems, names[1:])
        n = len(next(iter(found.values()), ()))
        rows = [found.get(name, [""] * n) for name in names]
        unknown = [word for word in rows[2] if word and word not in TAKES]
        if unknown:
            problems.add(f"{group.child_path(names[2])} is {unknown[0]!r}, expected one of {', '.join(TAKES)}")
        known = [row for row in zip(*rows, strict=False) if row[2] not in unknown]
        result.append([Taken(*row) if row[2] else Signal(*row[:2]) for row in known])
    return tuple(result)


def put_columns(group: Tree, kinds: Mapping[str, str], rows: Sequence[Any]) -> None:
    """Write a dataset for each of these fields of the rows: texts (``U``), whole (``i``) or real (``fi``) numbers."""
    for name, kind in kinds.items():
        empty = "" if kind == "U" else np.nan
        group.put(name, np.array([getattr(row, name, empty) for row in rows], dtype=TYPES[kind]))


def columns(
    group: Tree, kinds: Mapping[str, str], problems: Problems, optional: Sequence[str] = (), one_length: bool = True
) -> dict[str, list[Any]]:
    """Invert `put_columns`; add faults for missing columns, wrong kinds, and lengths unlike the first."""
    find_children(group, [name for name in kinds if name not in optional], problems)
    found: dict[str, list[Any]] = {}
    for name, kind in kinds.items():
        values = entries(group, name, kind, problems) if name in group.datasets else None
        if values is None:
            continue
        shape, first = group.datasets[name].values.shape, next(iter(found), name)
        if max(shape, default=1) < len(values):
            problems.add(f"{group.child_path(name)} is of shape {shape}, expected one row")
        elif one_length and len(values) != len(found.get(first, values)):
            wanted = f"{len(found[first])} as {group.child_path(first)}"
            problems.add(f"{group.child_path(name)} has {len(values)} entries, expected {wanted}")
        else:
            found[name] = values
    return found


def entries(group: Tree, name: str, kinds: str, problems: Problems) -> list[Any] | None:
    """Return the entries of a dataset as a list; None, with a fault, if they are of another kind."""
    values = group.datasets[name].values
    if isinstance(values, Unread) or (values.dtype.kind not in kinds and values.size):
        wanted = "texts" if kinds == "U" else "real numbers"
        problems.add(f"{group.child_path(name)} has dtype {type_name(values)}, expected {wanted}")
        return None
    return values.ravel().tolist()


def decode_point(node: Tree, problems: Problems) -> OperatingPoint | None:
    group = node.groups.get("operating_point")
    if group is None:
        return None
    found = columns(group, dict.fromkeys("xuy", "fi"), problems, one_length=False)
    return OperatingPoint(**{name: np.asarray(v, np.float64) for name, v in found.items()}) if len(found) == 3 else None


# --- pairs of models with the same signals: nominal and perturbed in one file, and their difference ------------------

PAIR = ("nominal", "perturbed")


def decode_pair(tree: Tree, problems: Problems, transpose: bool = False) -> tuple[StateSpaceModel, StateSpaceModel]:
    find_children(tree, PAIR, problems, kind="group")
    dt = sample_time(tree, problems)
    models: dict[str, Any] = {}
    for name in PAIR:
        if name in tree.groups and "E" in tree.groups[name].datasets:
            hint = "group='nominal', or group='perturbed', reads one model"
            problems.add(f"/{name}/E: a pair in descriptor form: its entries are no entries of A, B, C, D", hint)
        elif name in tree.groups:
            models[name] = decode_model(tree.groups[name], problems, transpose, models.get("nominal"), dt)
    problems.raise_any()
    check_pair(models["nominal"], models["perturbed"], tree.file)
    return models["nominal"], models["perturbed"]


def check_pair(nominal: StateSpaceModel, perturbed: StateSpaceModel, where: str = "nominal and perturbed") -> None:
    """Raise where two models differ in size, sample time, names or units; a missing unit agrees with every unit."""
    sizes = [(m.n_states, m.n_inputs, m.n_outputs) for m in (nominal, perturbed)]
    if sizes[0] != sizes[1]:
        found = "perturbed has {} states, {} inputs, {} outputs".format(*sizes[1])
        raise InputError(where, found, "{}, {}, {} as nominal".format(*sizes[0]))
    if nominal.dt != perturbed.dt:
        found = f"nominal has dt = {nominal.dt:g} s, perturbed dt = {perturbed.dt:g} s"
        raise InputError(where, found, "equal sample times")
    names, units = list[str](), list[str]()
    for side in ("states", "inputs", "outputs"):
        for a, b in zip(getattr(nominal, side), getattr(perturbed, side), strict=True):
            if a.name != b.name:
                names.append(f"{side[:-1]} {a.name!r} of nominal is {b.name!r} in perturbed")
            elif a.unit and b.unit and a.unit != b.unit:
                units.append(f"{side[:-1]} {a.name}: nominal [{a.unit}], perturbed [{b.unit}]")
    error, expected = (InputError, "the same signals in the same order") if names else (UnitMismatch, "equal units")
    if lines := names or units:
        raise error(where, lines[0], expected, None, tuple(f"{where}: {line}" for line in lines[1:]))


@dataclass(frozen=True)
class Change(AllFields):
    """One entry of A, B, C or D that differs: the gain from a signal, ``column``, to ``row`` or its derivative."""

    matrix: str  # `"A"`, `"B"`, `"C"` or `"D"`
    row: str
    column: str
    first: float
    second: float
    relative: float  # `(second - first) / |first|`; infinite where the first value is zero


@dataclass(frozen=True)
class Difference(AllFields, Displayable):
    """The entries in which two models differ."""

    changes: tuple[Change, ...]  # one for each entry that differs
    entries: int  # number of entries of A, B, C and D
    status: Status = Status.CONVERGED  # all entries were compared

    quantities: ClassVar[Mapping[str, Any]] = {"count": "1", "entries": "1", "largest": "1"}

    @property
    def count(self) -> int:
        return len(self.changes)

    @property
    def largest(self) -> float:
        return max((abs(c.relative) for c in self.changes), default=0.0)

    def headline(self) -> str:
        return f"{self.count} of {self.entries} entries differ"

    def facts(self) -> Facts:
        change = f"{100 * self.largest:.4g} %" if self.changes else ""
        return [("differ", f"{self.count} of {self.entries} entries"), ("largest change", change)]

    def details(self) -> list[Part]:
        rows = [
            (f"{c.matrix}[{c.row}, {c.column}]", f"{c.first:.9g}", f"{c.second:.9g}", f"{100 * c.relative:+.4g} %")
            for c in self.changes
        ]
        return [Part("", ("entry", "first", "second", "change"), rows)]


def difference(first: StateSpaceModel, second: StateSpaceModel) -> Difference:
    check_pair(first, second, "difference of two models")
    changes, x, u, y = [], first.state_names, first.input_names, first.output_names
    for name, rows, columns in (("A", x, x), ("B", x, u), ("C", y, x), ("D", y, u)):
        a, b = getattr(first, name), getattr(second, name)
        for i, j in np.argwhere(a != b):
            old, new = float(a[i, j]), float(b[i, j])
            relative = (new - old) / abs(old) if old else float(np.copysign(np.inf, new))
            changes.append(Change(name, rows[i], columns[j], old, new, relative))
    return Difference(tuple(changes), sum(getattr(first, name).size for name in "ABCD"))
