"""LPV models and controllers in a file: matrices over the grid of their parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.files.tree import Tree, Unread
from robustlab.result import Status
from robustlab.statespace import Signal
from robustlab.storage.matrices import Problems, decode_signals, encode_signals, entries, find_children
from robustlab.synthesis.scheduling.parameter_varying import LPVController, LPVModel, SchedulingParameter


def encode_lpv(tree: Tree, model: LPVModel) -> None:
    """Stacked ``matrices`` [A B; C D] over the grid, ``deviation`` over its cells, parameters and signals."""
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


def encode_lpv_controller(tree: Tree, controller: LPVController) -> None:
    """As an LPV model, with the attributes of kind ``controller`` as well."""
    encode_lpv(tree, controller.K)
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma


def decode_lpv(tree: Tree, problems: Problems, _transpose: bool = False) -> LPVModel:
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
        return _model(arrays, columns, sides, tree)
    except (InputError, ValueError, KeyError, IndexError) as error:
        said = error.line if isinstance(error, InputError) else str(error)
        raise InputError(problems.file, f"no LPV model: {said}", "what kind lpv of format 1 says") from None


def decode_lpv_controller(tree: Tree, problems: Problems, _transpose: bool = False) -> LPVController:
    """Inverse of `encode_lpv_controller`. Raises InputError: with all that is missing or does not fit."""
    model = decode_lpv(tree, problems)
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
