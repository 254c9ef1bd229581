"""Files of a data set: a model and two records per case; a separate JSON file has the hidden effects.

``cases/0001/model.h5`` is a plant in robustlab's format 1 (docs/hdf5-format.md): the matrices A, B, C, D at its root,
``signals/{input,state,output}`` with names and units, ``plant/parameters`` with values and relative tolerances.
``cases/0001/records.h5`` holds the groups ``record`` (to name from) and ``held_out`` (another input on the same
machine): ``t`` in s and one dataset a signal with the attributes ``unit`` and ``role`` ("input" or "output").
``truth.json`` has the hidden effects; ``manifest.json`` has a digest of every case's numbers.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import robustlab as rl
from robustlab.provenance import Provenance

from .composition import CONDITIONS, Entry, accepted, composition, drawn

SCHEMA = "robustlab.naming/1"


def make(folder: Path, seed: int, ids: set[str] | None = None) -> dict[str, str]:
    """Write the data set, or some of its cases, and return the digest of each."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = [e for e in composition(seed) if ids is None or e.id in ids]
    digests = {}
    for entry in entries:
        case = drawn(entry)
        _write(folder / "cases" / entry.id, case)
        digests[entry.id] = digest(case)
    _json(folder / "truth.json", {"schema": SCHEMA, "seed": seed, "cases": {e.id: truth_of(e) for e in entries}})
    _json(folder / "manifest.json", {"schema": SCHEMA, "seed": seed, "sha256": digests})
    return digests


def truth_of(entry: Entry) -> dict[str, Any]:
    """Return the hidden effects of a case; ``kinds``: every accepted set of kinds, none outside the catalogue."""
    assert entry.condition in CONDITIONS
    described = {name: getattr(entry, name) for name in ("family", "condition", "excitation")}
    return {**described, "effects": list(entry.effects), "kinds": accepted(entry)}


def digest(case: Any) -> str:
    """SHA-256 of the numbers that a program is given: nominal values, tolerances, both records."""
    sha = hashlib.sha256()
    for name, p in case.plant.parameters.items():
        sha.update(name.encode() + np.array([p.value, p.tolerance or 0.0], dtype="<f8").tobytes())
    for record in (case.record, case.held_out):
        for name in ("t", *record.inputs, *record.outputs):
            values = record.t if name == "t" else record[name]
            sha.update(name.encode() + np.ascontiguousarray(values, dtype="<f8").tobytes())
    return sha.hexdigest()


def _write(folder: Path, case: Any) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rl.save(folder / "model.h5", case.plant, Provenance("naming benchmark", "1970-01-01T00:00:00+00:00"))
    with h5py.File(folder / "records.h5", "w", libver=("earliest", "v108")) as file:
        for name, record in (("record", case.record), ("held_out", case.held_out)):
            group = file.create_group(name)
            _dataset(group, "t", record.t, "s", "time")
            for role, signals in (("input", record.inputs), ("output", record.outputs)):
                for signal, values in signals.items():
                    _dataset(group, signal, values, record.units[signal], role)


def _dataset(group: Any, name: str, values: Any, unit: str, role: str) -> None:
    made = group.create_dataset(name, data=values, compression="gzip", shuffle=True, track_times=False)
    made.attrs["unit"], made.attrs["role"] = unit, role


def _json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=1, sort_keys=True) + "\n", encoding="utf-8")
