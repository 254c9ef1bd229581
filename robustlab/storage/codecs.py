"""Writers by class and readers by kind of file; each imports its class on use.

Classes are identified by name, so a process loads only the modules of the objects that it reads or writes.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robustlab.arrays import not_finite
from robustlab.errors import InputError
from robustlab.files.signature import Limits
from robustlab.files.tree import Tree, Unread, one_number
from robustlab.result import Status
from robustlab.storage.matrices import (
    Problems,
    columns,
    decode_model,
    decode_signals,
    encode_signals,
    encode_state_space,
    entries,
    need,
    put_columns,
)

if TYPE_CHECKING:
    from robustlab.record import Record


class Codec(NamedTuple):
    """A kind of file of format 1, the class of its objects, and the module with its ``encode_`` and ``decode_``."""

    kind: str
    type: str  # of the class: its module's path below `robustlab` and its name
    module: str = "codecs"

    def write(self, tree: Tree, obj: Any) -> None:
        self._called("encode", tree, obj)

    def read(self, tree: Tree, problems: Problems, transpose: bool) -> Any:
        return self._called("decode", tree, problems, transpose)

    def _called(self, way: str, *given: Any) -> Any:
        module = import_module(f"robustlab.storage.{self.module}")
        return getattr(module, f"{way}_{self.kind.replace('-', '_')}")(*given)


def codec_of(obj: Any) -> Codec | None:
    """Return the codec of an object's class or its nearest base, or None."""
    names = (f"{cls.__module__}.{cls.__qualname__}".removeprefix("robustlab.") for cls in type(obj).__mro__)
    by_type = {codec.type: codec for codec in BY_KIND.values()}
    return next((by_type[name] for name in names if name in by_type), None)


def encode_delayed(tree: Tree, model: Any) -> None:
    """Write group ``H`` as a state-space model, dataset ``delays`` in s, of its first inputs and outputs."""
    encode_state_space(tree.group("H"), model.H)
    tree.put("delays", np.asarray(model.delays, dtype=np.float64))


def decode_delayed(tree: Tree, problems: Problems, transpose: bool) -> Any:
    """Invert `encode_delayed`."""
    from robustlab.delays.model import DelayedModel

    need(tree, problems, groups=("H",), datasets=("delays",))
    model, lengths = decode_model(tree.groups["H"], problems, transpose), entries(tree, "delays", "fi", problems)
    return problems.built(DelayedModel, model, np.asarray(lengths, dtype=np.float64))


# --- controllers ------------------------------------------------------------------------------------------------------


def encode_controller(tree: Tree, controller: Any) -> None:
    """Write K as a state-space model; ``gamma``, ``status``, ``method`` as attributes; the claims of its design."""
    from robustlab.evidence.verification import claims_of
    from robustlab.storage.results import encode_claims

    encode_state_space(tree, controller.K)
    _put_design(tree, controller)
    claims = claims_of(controller.design)
    own = {f"K_{letter}": getattr(controller.K, letter) for letter in "ABCD"}
    if any(all(np.array_equal(claim.numbers.get(name, np.nan), X) for name, X in own.items()) for claim in claims):
        encode_claims(tree, claims)


def decode_controller(tree: Tree, problems: Problems, transpose: bool) -> Any:
    from robustlab.synthesis.problem.controller import Controller

    model = decode_model(tree, problems, transpose)
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
    encode_signals(tree, (model.states, model.inputs, model.outputs))


def decode_lpv(tree: Tree, problems: Problems, _transpose: bool = False) -> Any:
    need(tree, problems, groups=("parameters", "signals"), datasets=("matrices", "deviation"))
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


def encode_lpv_controller(tree: Tree, controller: Any) -> None:
    """Write an LPV model with the attributes of kind ``controller``."""
    encode_lpv(tree, controller.K)
    _put_design(tree, controller)


def decode_lpv_controller(tree: Tree, problems: Problems, _transpose: bool) -> Any:
    from robustlab.synthesis.scheduling.parameter_varying import LPVController

    return problems.built(LPVController, decode_lpv(tree, problems), *_design(tree, problems))


# --- records ----------------------------------------------------------------------------------------------------------


def encode_record(tree: Tree, record: Any) -> None:
    """Write dataset ``t``, and one for each signal in groups ``inputs`` and ``outputs``."""
    from robustlab.files.records import encode_record as put

    put(tree, record)


def decode_record(tree: Tree, _problems: Problems, _transpose: bool) -> Record:
    from robustlab.files.records import decode_record as keywords_of

    return _record(keywords_of(tree, tree.file), tree.file)


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
        Codec("state-space", "statespace.StateSpaceModel", "matrices"),
        Codec("uncertain", "uncertainty.lft.UncertainModel", "uncertain_models"),
        Codec("delayed", "delays.model.DelayedModel"),
        Codec("frequency-data", "uncertainty.frequency_responses.UncertainFrequencyData", "uncertain_models"),
        Codec("lpv", "synthesis.scheduling.parameter_varying.LPVModel"),
        Codec("lpv-controller", "synthesis.scheduling.parameter_varying.LPVController"),
        Codec("controller", "synthesis.problem.controller.Controller"),
        Codec("record", "record.Record"),
        Codec("plant", "dynamics.plant_contract.Plant", "plants"),
        Codec("result", "result.Result", "results"),
    )
}
