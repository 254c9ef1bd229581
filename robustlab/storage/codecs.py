"""Writers by class and readers by kind of file; each imports its class on use.

Classes are identified by name, so a process loads only the modules of the objects that it reads or writes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robustlab.arrays import not_finite
from robustlab.errors import InputError
from robustlab.files.signature import Limits
from robustlab.files.tree import Tree, Unread
from robustlab.result import Status
from robustlab.storage.matrices import (
    Problems,
    columns,
    decode_model,
    decode_signals,
    decode_state_space,
    encode_model,
    encode_signals,
    entries,
    find_children,
    put_columns,
    real_attribute,
)

if TYPE_CHECKING:
    from robustlab.record import Record


class Codec(NamedTuple):
    """A kind of file of format 1, and the class of its objects."""

    kind: str
    type: str  # of the class: its module's path below `robustlab` and its name
    write: Callable[[Tree, Any], None]
    read: Callable[[Tree, Problems, bool], Any]  # the bool: transpose the matrices


def codec_of(obj: Any) -> Codec | None:
    """Return the codec of an object's class or its nearest base, or None."""
    names = (f"{cls.__module__}.{cls.__qualname__}".removeprefix("robustlab.") for cls in type(obj).__mro__)
    by_type = {codec.type: codec for codec in BY_KIND.values()}
    return next((by_type[name] for name in names if name in by_type), None)


def _later(module: str, kind: str) -> tuple[Callable[..., None], Callable[..., Any]]:
    """Return the writer and the reader of a kind, in a module that is imported on use."""

    def called(way: str, *given: Any) -> Any:
        return getattr(import_module(f"robustlab.storage.{module}"), f"{way}_{kind}")(*given)

    return partial(called, "encode"), partial(called, "decode")


def _encode_delayed(tree: Tree, model: Any) -> None:
    """Write group ``H`` as a state-space model, dataset ``delays`` in s, of its first inputs and outputs."""
    encode_model(tree.group("H"), model.H)
    tree.put("delays", np.asarray(model.delays, dtype=np.float64))


def _decode_delayed(tree: Tree, problems: Problems, transpose: bool) -> Any:
    from robustlab.delays.model import DelayedModel

    find_children(tree, ("H",), problems, kind="group")
    find_children(tree, ("delays",), problems, kind="dataset")
    model = decode_model(tree.groups["H"], problems, transpose) if "H" in tree.groups else None
    lengths = entries(tree, "delays", "fi", problems) if "delays" in tree.datasets else None
    return problems.built(DelayedModel, model, np.asarray(lengths, dtype=np.float64))


# --- controllers ------------------------------------------------------------------------------------------------------


def _encode_controller(tree: Tree, controller: Any) -> None:
    """Write K as a state-space model; ``gamma``, ``status``, ``method`` as attributes; the claims of its design."""
    from robustlab.evidence.verification import claims_of
    from robustlab.storage.results import encode_claims

    encode_model(tree, controller.K)
    _put_design(tree, controller)
    claims = claims_of(controller.design)
    own = {f"K_{letter}": getattr(controller.K, letter) for letter in "ABCD"}
    if any(all(np.array_equal(claim.numbers.get(name, np.nan), X) for name, X in own.items()) for claim in claims):
        encode_claims(tree, claims)


def _decode_controller(tree: Tree, problems: Problems, transpose: bool) -> Any:
    from robustlab.synthesis.problem.controller import Controller

    model = decode_model(tree, problems, transpose)
    return problems.built(Controller, model, *_design(tree, problems))


def _put_design(tree: Tree, controller: Any) -> None:
    tree.attrs.update(status=controller.status.value, method=controller.method)
    if controller.gamma is not None:
        tree.attrs["gamma"] = controller.gamma


def _design(tree: Tree, problems: Problems) -> tuple[float | None, Status, str]:
    gamma = real_attribute(tree, "gamma", problems)
    text = str(np.asarray(tree.attrs.get("status", Status.INCONCLUSIVE.value)))
    if text not in list(Status):
        problems.add(f"attribute status is {text!r}, expected one of {', '.join(s.value for s in Status)}")
        text = Status.INCONCLUSIVE
    return gamma, Status(text), str(np.asarray(tree.attrs.get("method", "")))


# --- models and controllers over a grid of parameters -----------------------------------------------------------------

COLUMNS = {"name": "U", "unit": "U", "rate": "fi"}


def _encode_lpv(tree: Tree, model: Any) -> None:
    """Write ``matrices`` [A B; C D] over the grid, ``deviation`` over its cells, parameters and signals."""
    tree.put("matrices", model.matrices)
    tree.put("deviation", model.deviation)
    tree.attrs.update(states=model.n_states, known=model.known)
    group = tree.group("parameters")
    put_columns(group, COLUMNS, model.parameters)
    group.put("count", np.array([len(p.points) for p in model.parameters]))
    group.put("points", np.concatenate([p.points for p in model.parameters]))
    encode_signals(tree, (model.states, model.inputs, model.outputs))


def _decode_lpv(tree: Tree, problems: Problems, _transpose: bool = False) -> Any:
    find_children(tree, ("matrices", "deviation"), problems, kind="dataset")
    find_children(tree, ("parameters", "signals"), problems, kind="group")
    problems.raise_any()
    for name in ("matrices", "deviation"):
        values = tree.datasets[name].values
        if isinstance(values, Unread) or values.dtype.kind not in "fi" or values.ndim < 3 or not_finite(values):
            problems.add(f"{tree.child_path(name)}: expected finite real numbers, three dimensions or more")
    group = tree.groups["parameters"]
    found = columns(group, {**COLUMNS, "count": "i"}, problems)
    points = columns(group, {"points": "fi"}, problems).get("points", [])
    sides = [side or [] for side in decode_signals(tree, problems)]
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


def _encode_lpv_controller(tree: Tree, controller: Any) -> None:
    """Write an LPV model with the attributes of kind ``controller``."""
    _encode_lpv(tree, controller.K)
    _put_design(tree, controller)


def _decode_lpv_controller(tree: Tree, problems: Problems, _transpose: bool) -> Any:
    from robustlab.synthesis.scheduling.parameter_varying import LPVController

    return problems.built(LPVController, _decode_lpv(tree, problems), *_design(tree, problems))


# --- records ----------------------------------------------------------------------------------------------------------


def _encode_record(tree: Tree, record: Any) -> None:
    """Write dataset ``t``, and one for each signal in groups ``inputs`` and ``outputs``."""
    from robustlab.files.records import encode_record

    encode_record(tree, {key: getattr(record, key) for key in ("t", "inputs", "outputs", "units", "name", "meaning")})


def _decode_record(tree: Tree, _problems: Problems, _transpose: bool) -> Record:
    from robustlab.files.records import decode_record

    return _record(decode_record(tree, tree.file), tree.file)


def record_from(path: str | Path, group: str | None, limits: Limits | None, isolate: bool) -> Record:
    """Return the record in a file without header; see `robustlab.files.records.read_record`."""
    from robustlab.files.records import RecordOptions, read_record

    return _record(read_record(path, RecordOptions(group), limits, isolate), str(path))


def _record(keywords: dict[str, Any], where: str) -> Record:
    from robustlab.record import Record

    name = keywords.pop("name")
    try:
        return Record(**keywords, name=name)
    except InputError as error:
        found = f"{error.where.removeprefix(name).lstrip(': ')} {error.found}".strip()
        raise InputError(where, found, error.expected, error.hint) from None


BY_KIND = {
    codec.kind: codec
    for codec in (
        Codec("state-space", "statespace.StateSpaceModel", encode_model, decode_state_space),
        Codec("uncertain", "uncertainty.lft.UncertainModel", *_later("uncertain_models", "uncertain")),
        Codec("delayed", "delays.model.DelayedModel", _encode_delayed, _decode_delayed),
        Codec("frequency-data", "uncertainty.frequency_responses.UncertainFrequencyData",
              *_later("uncertain_models", "frequency_data")),
        Codec("lpv", "synthesis.scheduling.parameter_varying.LPVModel", _encode_lpv, _decode_lpv),
        Codec("lpv-controller", "synthesis.scheduling.parameter_varying.LPVController", _encode_lpv_controller,
              _decode_lpv_controller),
        Codec("controller", "synthesis.problem.controller.Controller", _encode_controller, _decode_controller),
        Codec("record", "record.Record", _encode_record, _decode_record),
        Codec("plant", "dynamics.plant_contract.Plant", *_later("plants", "plant")),
        Codec("result", "result.Result", *_later("results", "result")),
    )
}  # fmt: skip
