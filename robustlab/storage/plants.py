"""Plants in files: name, parameters and effects, and the linear model, which any program can read.

Equations of a user's nonlinear plant are rows of numbers without code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from robustlab.dynamics.plant_base import NonlinearPlant, Plant, PortPlace
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.files.tree import Tree, text_attr
from robustlab.statespace import StateSpaceModel
from robustlab.storage import matrices
from robustlab.storage.matrices import Problems, columns, need, put_columns
from robustlab.uncertainty.blocks import Sign

if TYPE_CHECKING:
    from robustlab.dynamics.linear_plant import AffineEquations
    from robustlab.dynamics.parameters import Parameter
    from robustlab.dynamics.symbolic.symbolic_plant import Equations

TAPES = ("rates", "outputs", "models")
ROWS = {"operations": "i", "left": "i", "right": "i", "constants": "fi", "outputs": "i"}
KINDS = ("joint", "current")
OPTIONS = ("preset", "motors")  # of a plant of the registry
PLACE: dict[str, str] = dict.fromkeys(("name", "kind", "unit", "position"), "U")
TEXTS = ("name", "unit", "source", "meaning")
PARAMETERS: dict[str, str] = {**dict.fromkeys(TEXTS, "U"), "value": "fi", "tolerance": "fi"}
# Further columns of the parameters of a plant with stored equations.
MORE: dict[str, str] = dict.fromkeys(("sign", "role"), "U")
MATRICES = ("E", "F", "G", "C", "D")
BARE = "model"  # name of a plant made of a linear model, which earlier versions stored by its matrices
AGREEMENT = 1e-6  # of the stored linear model with the rebuilt plant's, relative to the largest entry


def encode_plant(tree: Tree, obj: Plant) -> None:
    """Write A B C D and signals as of kind ``state-space`` at an equilibrium, and groups ``plant`` and ``effects``."""
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant

    base = obj.plant if isinstance(obj, ExtendedPlant) else obj
    own = not _is_rebuilt(base)
    # A plant of exactly these classes is its parameters, signals and equations.
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
    matrices.encode_state_space(tree, _linear(obj))
    group = tree.group("plant")
    group.attrs.update(name=base.name, **_options(base))
    put_columns(group.group("parameters"), PARAMETERS | (MORE if own else {}), list(base.parameters.values()))
    if equations is not None:
        held = group.group("equations")
        for name, values in equations.coefficients.items():
            held.put(name, values)
        held.put("parameters", np.array(equations.names, np.str_))
    elif tapes is not None:
        held = group.group("tapes")
        for name in TAPES:
            for row in ROWS:
                held.group(name).put(row, getattr(getattr(tapes, name), row))
        put_columns(held.group("places"), PLACE, tapes.places)
    if own:
        matrices.encode_state_space(group.group("base"), _linear(base))
    for k, e in enumerate(obj.effects if isinstance(obj, ExtendedPlant) else ()):
        one = tree.group("effects").group(str(k))
        one.attrs.update(id=e.effect.id, site=e.site.name, site_kind=e.site.kind, source=e.source)
        one.put("name", np.array(list(e.values), np.str_))
        one.put("value", np.array(list(e.values.values()), np.float64))
        one.put("std", np.array([e.std.get(name, np.nan) for name in e.values], np.float64))
    tree.group("effects")


def decode_plant(tree: Tree, problems: Problems, _transpose: bool = False) -> Plant:
    known = ("effects", "signals", "operating_point", "provenance", *"ABCD")
    matrices.find_children(tree, ("plant",), problems, known, "group")
    model = matrices.decode_model(tree, problems)
    plant = problems.built(_plant, tree, problems)
    assert model is not None
    _check_model(plant, model, problems.file)
    return plant


def _options(base: Plant) -> dict[str, Any]:
    return {name: value for name in OPTIONS if (value := getattr(base, name, None)) is not None}


def _is_rebuilt(base: Plant) -> bool:
    from robustlab.dynamics import builtin_plant, plant_names
    from robustlab.dynamics.linear_plant import LinearPlant

    if base.name not in plant_names():
        return False
    again: Any = builtin_plant(base.name, **_options(base))
    if list(again.parameters) != list(base.parameters) or type(again) is not type(base):
        return False
    again = replace(again, parameters=dict(base.parameters))
    signals = all(getattr(again, kind) == getattr(base, kind) for kind in ("inputs", "outputs", "states"))
    if isinstance(base, LinearPlant):
        pairs = zip(again.matrices(base.values), base.matrices(base.values), strict=True)
        return signals and all(np.array_equal(a, b) for a, b in pairs)
    return signals


def _linear(obj: Plant, point: Any = None) -> StateSpaceModel:
    """Return the linear model at the point, else at the plant's equilibrium, else at zero."""
    from robustlab.dynamics.linearisation import linearise

    try:
        return linearise(obj, at=point)
    except NoTrustworthyNumber:
        if point is not None or not isinstance(obj, NonlinearPlant):
            raise
        return linearise(obj, at=(np.zeros(len(obj.states)), np.zeros(len(obj.inputs))))


def _plant(tree: Tree, problems: Problems) -> Plant:
    group, effects = tree.groups["plant"], tree.groups.get("effects", Tree())
    held = next((name for name in ("equations", "tapes") if name in group.groups), "")
    base = _own_plant(group, held, problems) if held else _from_name(group, problems)
    return _with_effects(base, effects, problems) if effects.groups else base


def _own_plant(group: Tree, held: str, problems: Problems) -> Plant:
    from robustlab.dynamics.parameters import Parameter, Role

    need(group, problems, groups=("parameters", held, "base"))
    model = matrices.decode_model(group.groups["base"], problems)
    found = columns(group.groups["parameters"], PARAMETERS | MORE, problems)
    words = {"sign": get_args(Sign), "role": get_args(Role)}
    _check_rows(group.groups["parameters"], "a parameter", found, words, problems)
    assert model is not None
    rows = (dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True))
    parameters = {row["name"]: Parameter(**row) for row in rows}
    name = text_attr(group.attrs, "name") or "plant"
    of = (name, parameters, model.inputs, model.outputs, model.states)
    if held == "tapes":
        from robustlab.dynamics.symbolic.symbolic_plant import SymbolicPlant

        n_moving = len(model.states) + len(model.inputs)
        return SymbolicPlant(*of, _tapes(group.groups[held], n_moving, len(parameters), problems))
    from robustlab.dynamics.linear_plant import LinearPlant

    equations = _coefficients(group.groups[held], parameters, problems)
    return LinearPlant(*of, equations=equations, exact=tuple(equations.fixed))


def _coefficients(held: Tree, parameters: Mapping[str, Parameter], problems: Problems) -> AffineEquations:
    from robustlab.dynamics.linear_plant import AffineEquations

    need(held, problems, datasets=("parameters", *MATRICES))
    names = matrices.entries(held, "parameters", "U", problems) or []
    arrays = {key: held.datasets[key].values for key in MATRICES}
    for key, values in arrays.items():
        shape = values.shape if isinstance(values, np.ndarray) and values.dtype.kind in "fi" else ()
        if len(shape) != 3 or shape[0] != 1 + len(names):
            problems.add(f"{held.child_path(key)}: expected real numbers, one matrix more than {len(names)} parameters")
    problems.raise_any()
    unknown = [name for name in names if name not in parameters]
    if unknown or len(set(names)) < len(names):
        found = f"{unknown[0]!r} is no parameter" if unknown else "a name is there twice"
        raise InputError(problems.file, f"{held.child_path('parameters')}: {found}", "names of plant/parameters")
    fixed = {name: p.value for name, p in parameters.items() if name not in names}
    return AffineEquations(tuple(names), {key: np.asarray(v, float) for key, v in arrays.items()}, fixed)


def _tapes(held: Tree, n_moving: int, n_parameters: int, problems: Problems) -> Equations:
    from robustlab.dynamics.symbolic.symbolic_plant import Equations, Tape

    need(held, problems, groups=(*TAPES, "places"))
    group = held.groups["places"]
    found = columns(group, PLACE, problems)
    _check_rows(group, "a place", found, {"kind": KINDS}, problems)
    tapes: list[Tape] = []
    for name in TAPES:
        group = held.groups[name]
        rows = columns(group, ROWS, problems, one_length=False)
        problems.raise_any()
        numbers: Any = {row: np.array(v, matrices.TYPES[ROWS[row]]) for row, v in rows.items()}
        try:
            tapes.append(Tape(n_moving + n_parameters, **numbers, n_still=n_parameters))
        except InputError as error:
            where = error.where.removeprefix("tape").removeprefix(": ")
            path = group.child_path(where) if where in ROWS else group.path
            raise InputError(problems.file, f"{path}: {error.found}", error.expected) from None
    rates, outputs, models = tapes
    places = tuple(PortPlace(*row) for row in zip(*found.values(), strict=True))
    return Equations(rates, outputs, models, places)


def _check_rows(
    group: Tree, what: str, found: Mapping[str, Any], words: Mapping[str, Sequence[str]], problems: Problems
) -> None:
    """Raise where a column has an unknown word, or a name is there twice."""
    for name, known in words.items():
        for word in found.get(name, ()):
            if word not in known:
                expected = ", ".join(filter(None, known))
                problems.add(f"{group.child_path(name)}: {word!r}, expected one of {expected}")
    names = found.get("name", ())
    if len(set(names)) < len(names):
        problems.add(f"{group.child_path('name')}: {what} is there twice")
    problems.raise_any()


def _from_name(group: Tree, problems: Problems) -> Plant:
    from robustlab.dynamics import builtin_plant

    name = text_attr(group.attrs, "name")
    if name is None:
        problems.add(f"{group.path}: attribute name is missing or no text")
    need(group, problems, groups=("parameters", "base") if name == BARE else ("parameters",))
    found = columns(group.groups["parameters"], PARAMETERS, problems)
    model = matrices.decode_model(group.groups["base"], problems) if name == BARE else None
    problems.raise_any()
    rows = {row[0]: dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)}
    if model is not None:
        from robustlab.dynamics.ports.port_model import linear_plant_of

        made = linear_plant_of(model).with_parameters(**{n: row["value"] for n, row in rows.items()})
    else:
        options: dict[str, Any] = {key: np.asarray(group.attrs[key]).tolist() for key in OPTIONS if key in group.attrs}
        given = {n: (row["value"], row["tolerance"]) for n, row in rows.items()}
        made = builtin_plant(str(name), **options, **given)
    missing = [n for n in made.parameters if n not in rows]
    if missing:
        raise InputError(problems.file, f"{group.path}/parameters: no {missing[0]!r}", "all parameters of the plant")
    return replace(made, parameters={n: replace(p, **rows[n]) for n, p in made.parameters.items()})


def _with_effects(base: Any, group: Tree, problems: Problems) -> Plant:
    from robustlab.dynamics.effects.catalogue import effect
    from robustlab.dynamics.effects.effect import Site
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
        found = columns(one, {"name": "U", "value": "fi", "std": "fi"}, problems, ("std",))
        problems.raise_any()
        known = effect(str(attrs["id"]))
        std = {n: s for n, s in zip(found["name"], found.get("std", []), strict=False) if not np.isnan(s)}
        values = dict(zip(found["name"], found["value"], strict=True))
        site: Any = Site(attrs["site_kind"], str(attrs["site"]))  # type: ignore[arg-type]
        attached.append(AttachedEffect(known, site, values, std, text_attr(one.attrs, "source") or ""))
    problems.raise_any()
    return with_effects(base, attached)


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
