"""One HDF5 file of each kind, written by 3842bc3f: each loads for ever, to the same numbers."""

from collections.abc import Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .cases import HERE, Case

RTOL = 1e-12
FILES = HERE / "files"


def cases() -> Iterator[Case]:
    """One a file."""
    for path in sorted(FILES.glob("*.h5")):
        yield Case(path.stem, lambda path=path: held(path))


def held(path: Any) -> dict[str, Any]:
    """Return the contents of a file; for evidence, whether it is proved from the file alone."""
    found = rl.load(path)
    answer = content(found)
    if path.stem in ("margin", "design", "gain"):
        answer["proved"] = rl.verify(str(path)).proved
    return answer


def content(thing: Any) -> dict[str, Any]:
    """Matrices, signals, blocks, delays, parameters, channels: what an object has of these."""
    found: dict[str, Any] = {}
    for name in ("A", "B", "C", "D", "dt", "delays", "omega", "t", "model_frequency"):
        if hasattr(thing, name):
            found[name] = np.asarray(getattr(thing, name))
    for name in ("inputs", "outputs", "states"):
        signals = getattr(thing, name, ())
        if isinstance(signals, dict) or hasattr(signals, "items"):
            found[name] = {key: np.asarray(value) for key, value in signals.items()}
        else:
            found[name] = [f"{s.name} [{s.unit}]" for s in signals]
    for name in ("M", "H", "K", "model"):
        part = getattr(thing, name, None)
        if part is not None and hasattr(part, "A"):
            found[name] = content(part)
    if hasattr(thing, "blocks"):
        found["blocks"] = [f"{type(b).__name__} {b.name} {b.rows}" for b in thing.blocks]
    if hasattr(thing, "values") and not callable(thing.values):
        found["values"] = dict(thing.values)
    if hasattr(thing, "status"):
        found["status"] = thing.status
    for name in ("lower", "upper"):
        if isinstance(getattr(thing, name, None), float):
            found[f"its {name}"] = getattr(thing, name)
    if hasattr(thing, "data") and hasattr(thing.data, "items"):
        found["data"] = {k: v for k, v in thing.data.items() if isinstance(v, (int, float, str)) and " " not in str(v)}
    return found
