"""Plants in a file: their name, parameters and effects, and beside them the linear model that any program can read.

Equations of nonlinear plants of somebody's own are rows of numbers, in which there is no code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from robustlab.dynamics.plant_contract import NonlinearPlant, Plant, PortPlace
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.files.tree import Tree, text_attr
from robustlab.statespace import StateSpaceModel
from robustlab.storage.matrices import Problems, decode_model, encode_model, entries, find_children
from robustlab.uncertainty.blocks import Sign

if TYPE_CHECKING:
    from robustlab.dynamics.parameters import Parameter
    from robustlab.dynamics.symbolic.symbolic_plant import Equations
    from robustlab.dynamics.symbolic.tape import Tape

TAPES = ("rates", "outputs", "models")
ROWS = ("operations", "left", "right", "constants", "outputs")
KINDS = ("joint", "current")
PLACE = ("name", "kind", "unit", "position")


def encode_equations(tree: Tree, equations: Equations) -> None:
    """Groups ``rates``, ``outputs``, ``models`` and ``places``."""
    for name in TAPES:
        tape: Tape = getattr(equations, name)
        for row in ROWS:
            tree.group(name).put(row, getattr(tape, row))
    for field in PLACE:
        tree.group("places").put(field, np.array([getattr(p, field) for p in equations.places], np.str_))


def decode_equations(tree: Tree, n_moving: int, n_parameters: int, problems: Problems) -> Equations:
    """Inverse of `encode_equations`, for as many states and inputs, and parameters."""
    from robustlab.dynamics.symbolic.symbolic_plant import Equations
    from robustlab.dynamics.symbolic.tape import Tape

    find_children(tree, (*TAPES, "places"), problems, kind="group")
    problems.raise_any()
    places = _places(tree.groups["places"], problems)
    tapes: list[Tape] = []
    for name in TAPES:
        group = tree.groups[name]
        columns = {row: "fi" if row == "constants" else "i" for row in ROWS}
        rows = _columns(group, columns, problems, one_length=False)
        problems.raise_any()
        numbers: Any = {row: np.array(v, float if row == "constants" else int) for row, v in rows.items()}
        try:
            tapes.append(Tape(n_moving + n_parameters, **numbers, n_still=n_parameters))
        except InputError as error:
            where = error.where.removeprefix("tape").removeprefix(": ")
            path = group.child_path(where) if where in ROWS else group.path
            raise InputError(problems.file, f"{path}: {error.found}", error.expected) from None
    rates, outputs, models = tapes
    return Equations(rates, outputs, models, places)


def _places(group: Tree, problems: Problems) -> tuple[PortPlace, ...]:
    columns = _columns(group, dict.fromkeys(PLACE, "U"), problems)
    problems.raise_any()
    places = tuple(PortPlace(*row) for row in zip(*columns.values(), strict=True))
    for place in places:
        if place.kind not in KINDS:
            problems.add(f"{group.child_path('kind')}: {place.kind!r}, expected one of {', '.join(KINDS)}")
    if len({place.name for place in places}) < len(places):
        problems.add(f"{group.child_path('name')}: a place is there twice")
    problems.raise_any()
    return places


def _columns(
    group: Tree, kinds: Mapping[str, str], problems: Problems, one_length: bool = True
) -> dict[str, list[Any]]:
    """Datasets by their names, of texts or numbers as ``kinds`` says; of one length."""
    find_children(group, list(kinds), problems, kind="dataset")
    found = {name: entries(group, name, of, problems) for name, of in kinds.items() if name in group.datasets}
    columns = {name: values for name, values in found.items() if values is not None}
    for name in columns:
        if (shape := group.datasets[name].values.shape) and len(shape) > 1:
            problems.add(f"{group.child_path(name)} is of shape {shape}, expected one row")
    lengths = {len(values) for values in columns.values()}
    if one_length and len(lengths) > 1:
        problems.add(f"{group.path}: columns of {', '.join(map(str, sorted(lengths)))} entries, expected one length")
    return columns


# Of a plant whose equations are stored: what its parameters may be is not known elsewhere.
MORE_TEXTS = ("sign", "role")
MATRICES = ("E", "F", "G", "C", "D")
TEXTS, NUMBERS = ("name", "unit", "source", "meaning"), ("value", "tolerance")
PARAMETERS = dict.fromkeys(TEXTS, "U") | dict.fromkeys(NUMBERS, "fi")
# Name of a bare model that stands as a plant; its matrices are stored with it.
BARE = "model"
# Entries of the stored linear model and of the rebuilt plant's agree to this share of the largest.
AGREEMENT = 1e-6


def encode_plant(tree: Tree, obj: Plant) -> None:
    """A B C D and signals as kind ``state-space`` at a rest of the plant; groups ``plant`` and ``effects``."""
    from robustlab.dynamics.extended.extended_equations import ExtendedEquations

    base = obj.plant if isinstance(obj, ExtendedEquations) else obj
    own = not _is_rebuilt(base)
    # Without methods of its own a plant is its parameters, signals and equations.
    kind, of = type(base).__name__, getattr(base, "affine_equations", None)
    equations = of() if own and of is not None and kind == "LinearPlant" else None
    tapes = getattr(base, "equations", None) if own and kind == "SymbolicPlant" else None
    if own and equations is None and tapes is None:
        raise InputError(
            f"{base.name}: save",
            "a plant of your own making that is not linear: its equations are a program, which a file cannot hold",
            "a plant as from plant(name), a LinearPlant, PlantEquations(...).plant(), or a model",
            "to keep its linear model alone: save(path, linearise(plant))",
        )
    encode_model(tree, _linear(obj))
    group = tree.group("plant")
    group.attrs["name"] = base.name
    for name, value in _options(base).items():
        group.attrs[name] = value
    for field in (*TEXTS, *NUMBERS, *(MORE_TEXTS if own else ())):
        kind = np.float64 if field in NUMBERS else np.str_
        group.group("parameters").put(field, np.array([getattr(p, field) for p in base.parameters.values()], kind))
    if equations is not None:
        for name, values in equations.coefficients.items():
            group.group("equations").put(name, values)
        group.group("equations").put("parameters", np.array(equations.names, np.str_))
        encode_model(group.group("base"), _linear(base))
    elif tapes is not None:
        encode_equations(group.group("tapes"), tapes)
        encode_model(group.group("base"), _linear(base))
    elif base.name == BARE:
        encode_model(group.group("base"), _bare_model(base))
    effects = tree.group("effects")
    for k, e in enumerate(obj.effects if isinstance(obj, ExtendedEquations) else ()):
        one = effects.group(str(k))
        one.attrs.update(id=e.effect.id, site=e.site.name, site_kind=e.site.kind, source=e.source)
        one.put("name", np.array(list(e.values), np.str_))
        one.put("value", np.array(list(e.values.values()), np.float64))
        one.put("std", np.array([e.std.get(name, np.nan) for name in e.values], np.float64))


def decode_plant(tree: Tree, problems: Problems, _transpose: bool = False) -> Plant:
    """Inverse of `encode_plant`."""
    known = ("effects", "signals", "operating_point", "provenance", *"ABCD")
    find_children(tree, ("plant",), problems, known, "group")
    model = decode_model(tree, problems)
    problems.raise_any()
    assert model is not None
    try:
        base = _base(tree.groups["plant"], problems)
        plant = _with_effects(base, tree.groups.get("effects", Tree()), problems)
    except InputError as error:
        if error.where.startswith(problems.file):
            raise
        raise InputError(problems.file, f"{error.where}: {error.found}", error.expected, error.hint) from None
    _check_model(plant, model, problems.file)
    return plant


# --- writing ---------------------------------------------------------------------------------------------------------


def _options(base: Plant) -> dict[str, Any]:
    return {name: value for name in ("preset", "motors") if (value := getattr(base, name, None)) is not None}


def _is_rebuilt(base: Plant) -> bool:
    """True where name, options and parameters make the same plant again."""
    from robustlab.dynamics import builtin_plant, plant_names
    from robustlab.dynamics.linear_plant import LinearPlant
    from robustlab.dynamics.ports.port_model import linear_plant_of

    if base.name == BARE and isinstance(base, LinearPlant):
        again: Any = replace(linear_plant_of(_bare_model(base)), parameters=dict(base.parameters))
    elif base.name in plant_names():
        again = builtin_plant(base.name, **_options(base))
        if list(again.parameters) != list(base.parameters) or type(again) is not type(base):
            return False
        again = replace(again, parameters=dict(base.parameters))
    else:
        return False
    signals = all(getattr(again, kind) == getattr(base, kind) for kind in ("inputs", "outputs", "states"))
    if isinstance(base, LinearPlant):
        pairs = zip(again.matrices(base.values), base.matrices(base.values), strict=True)
        return signals and all(np.array_equal(a, b) for a, b in pairs)
    return signals


def _bare_model(base: Any) -> StateSpaceModel:
    """The model from which a bare plant was made: that of gains and inertias of 1."""
    units = {name: 1.0 for name in base.parameters if name.startswith(("gain_", "inertia_"))}
    e, f, g, c, d = base.matrices({**base.values, **units})
    return StateSpaceModel(
        np.linalg.solve(e, f), np.linalg.solve(e, g), c, d, 0.0, base.inputs, base.outputs, base.states
    )


def _linear(obj: Plant, point: Any = None) -> StateSpaceModel:
    """The linear model at the point, or at the plant's rest; at zero where it has none."""
    from robustlab.dynamics.linearisation import linearise

    try:
        return linearise(obj, at=point)
    except NoTrustworthyNumber:
        if point is not None or not isinstance(obj, NonlinearPlant):
            raise
        return linearise(obj, at=(np.zeros(len(obj.states)), np.zeros(len(obj.inputs))))


# --- reading ---------------------------------------------------------------------------------------------------------


def _base(group: Tree, problems: Problems) -> Plant:
    if "equations" in group.groups:
        return _from_equations(group, problems)
    if "tapes" in group.groups:
        return _from_tapes(group, problems)
    return _from_name(group, problems)


def _from_equations(group: Tree, problems: Problems) -> Plant:
    """A linear plant of somebody's own, from the coefficients of its equations and the signals of its model."""
    from robustlab.dynamics.linear_plant import AffineEquations, LinearPlant

    held = group.groups["equations"]
    find_children(group, ("parameters", "equations", "base"), problems, kind="group")
    find_children(held, ("parameters", *MATRICES), problems, kind="dataset")
    problems.raise_any()
    model = decode_model(group.groups["base"], problems)
    parameters = _own_parameters(group.groups["parameters"], problems)
    names = entries(held, "parameters", "U", problems) or []
    arrays = {key: held.datasets[key].values for key in MATRICES}
    for key, values in arrays.items():
        shape = values.shape if isinstance(values, np.ndarray) and values.dtype.kind in "fi" else ()
        if len(shape) != 3 or shape[0] != 1 + len(names):
            problems.add(f"{held.child_path(key)}: expected real numbers, one matrix more than {len(names)} parameters")
    problems.raise_any()
    assert model is not None
    unknown = [name for name in names if name not in parameters]
    if unknown or len(set(names)) < len(names):
        found = f"{unknown[0]!r} is no parameter" if unknown else "a name is there twice"
        raise InputError(problems.file, f"{held.child_path('parameters')}: {found}", "names of plant/parameters")
    fixed = {name: p.value for name, p in parameters.items() if name not in names}
    equations = AffineEquations(tuple(names), {key: np.asarray(v, float) for key, v in arrays.items()}, fixed)
    name = text_attr(group.attrs, "name") or "plant"
    return LinearPlant(
        name, parameters, model.inputs, model.outputs, model.states, equations=equations, exact=tuple(fixed)
    )


def _from_tapes(group: Tree, problems: Problems) -> Plant:
    from robustlab.dynamics.symbolic.symbolic_plant import SymbolicPlant

    find_children(group, ("parameters", "tapes", "base"), problems, kind="group")
    problems.raise_any()
    model = decode_model(group.groups["base"], problems)
    parameters = _own_parameters(group.groups["parameters"], problems)
    problems.raise_any()
    assert model is not None
    n_moving = len(model.states) + len(model.inputs)
    equations = decode_equations(group.groups["tapes"], n_moving, len(parameters), problems)
    name = text_attr(group.attrs, "name") or "plant"
    return SymbolicPlant(name, parameters, model.inputs, model.outputs, model.states, equations)


def _own_parameters(group: Tree, problems: Problems) -> dict[str, Parameter]:
    """Parameters with all that is said of them; what is wrong is in ``problems``."""
    from robustlab.dynamics.parameters import Parameter, Role

    columns = _columns(group, PARAMETERS | dict.fromkeys(MORE_TEXTS, "U"), problems)
    for field, choices in (("sign", get_args(Sign)), ("role", get_args(Role))):
        for found in columns.get(field, ()):
            if found not in choices:
                known = ", ".join(filter(None, choices))
                problems.add(f"{group.child_path(field)}: {found!r}, expected one of {known}")
    problems.raise_any()
    names = columns["name"]
    if len(set(names)) < len(names):
        problems.add(f"{group.child_path('name')}: a parameter is there twice")
        problems.raise_any()
    fields = (*TEXTS, *NUMBERS, *MORE_TEXTS)
    return {name: Parameter(**{field: columns[field][k] for field in fields}) for k, name in enumerate(names)}


def _from_name(group: Tree, problems: Problems) -> Plant:
    from robustlab.dynamics import builtin_plant

    name = text_attr(group.attrs, "name")
    if name is None:
        problems.add(f"{group.path}: attribute name is missing or no text")
    find_children(group, ("parameters", "base") if name == BARE else ("parameters",), problems, kind="group")
    problems.raise_any()
    columns = _columns(group.groups["parameters"], PARAMETERS, problems)
    model = decode_model(group.groups["base"], problems) if name == BARE and "base" in group.groups else None
    problems.raise_any()
    assert name is not None
    options = {key: np.asarray(group.attrs[key]).tolist() for key in ("preset", "motors") if key in group.attrs}
    values, tolerances = columns["value"], columns["tolerance"]
    given: dict[str, Any] = dict(zip(columns["name"], zip(values, tolerances, strict=True), strict=True))
    if model is not None:
        from robustlab.dynamics.ports.port_model import linear_plant_of

        base = linear_plant_of(model)
        made = base.with_parameters(**{n: v for n, (v, _) in given.items()})
    else:
        made = builtin_plant(name, **options, **given)
    missing = [n for n in made.parameters if n not in given]
    if missing:
        raise InputError(problems.file, f"{group.path}/parameters: no {missing[0]!r}", "all parameters of the plant")
    stored = {}
    for k, n in enumerate(columns["name"]):
        about = {field: columns[field][k] for field in ("value", "tolerance", "unit", "source", "meaning")}
        stored[n] = replace(made.parameters[n], **about)
    return replace(made, parameters={n: stored[n] for n in made.parameters})


def _with_effects(base: Any, group: Tree, problems: Problems) -> Plant:
    if not group.groups:
        return base
    from robustlab.dynamics.effects.catalogue import effect
    from robustlab.dynamics.effects.contract import Site
    from robustlab.dynamics.extended.attached_effect import AttachedEffect
    from robustlab.dynamics.extended.extended_plant import with_effects

    attached = []
    for k in range(len(group.groups)):
        one = group.groups.get(str(k))
        if one is None:
            problems.add(f"missing {group.child_path(str(k))}: effects are numbered from 0")
            break
        attrs = {name: text_attr(one.attrs, name) for name in ("id", "site", "site_kind")}
        for name, value in attrs.items():
            if value is None:
                problems.add(f"{one.path}: attribute {name} is missing or no text")
        kinds = {"name": "U", "value": "fi", **({"std": "fi"} if "std" in one.datasets else {})}
        columns = _columns(one, kinds, problems)
        problems.raise_any()
        known = effect(str(attrs["id"]))
        std = {n: s for n, s in zip(columns["name"], columns.get("std", []), strict=False) if not np.isnan(s)}
        values = dict(zip(columns["name"], columns["value"], strict=True))
        site: Any = Site(attrs["site_kind"], str(attrs["site"]))  # type: ignore[arg-type]
        attached.append(AttachedEffect(known, site, values, std, text_attr(one.attrs, "source") or ""))
    problems.raise_any()
    return with_effects(base, attached) if attached else base


def _check_model(plant: Plant, stored: StateSpaceModel, where: str) -> None:
    point = stored.operating_point
    found = _linear(plant, None if point is None else (point.x, point.u))
    for name in "ABCD":
        a, b = getattr(stored, name), getattr(found, name)
        if a.shape != b.shape or np.abs(a - b).max(initial=0.0) > AGREEMENT * np.abs(b).max(initial=0.0):
            raise InputError(
                where,
                f"/{name} is not the linear model of {plant.name} with these parameters and effects",
                "a file as robustlab wrote it",
                "the file was changed, or its plant is another one in this version: take A B C D alone with group='/'",
            )
