"""H-infinity and H2 designs of the COMPleib plants, and whether their evidence is proved."""

from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

import robustlab as rl

from .cases import SHARED, Case

RTOL = 1e-6
RTOLS = {"gamma": 1e-3, "smallest": 1e-3}
# Larger plants take a second and more.
SMALL = 3


def cases() -> Iterator[Case]:
    """Two a plant."""
    if not (SHARED / "compleib.h5").exists():
        return
    with h5py.File(SHARED / "compleib.h5") as file:
        sizes = {name: int(group.attrs["n"]) for name, group in file.items()}
    for name, n in sorted(sizes.items(), key=lambda item: (item[1], item[0])):
        yield Case(f"hinf {name}", lambda name=name: hinf(name), n > SMALL, True)
        yield Case(f"h2 {name}", lambda name=name: h2(name), n > SMALL, True)


def hinf(name: str) -> dict[str, Any]:
    """Level, the smallest that is known, and the proof by itself."""
    found = rl.hinf(*plant(name))
    return common(found) | {"smallest": found.smallest_gamma}


def h2(name: str) -> dict[str, Any]:
    """The norm, and the proof by itself."""
    return common(rl.h2(*plant(name)))


def common(found: Any) -> dict[str, Any]:
    """Return the values common to both kinds of design."""
    return {"status": found.status, "gamma": found.gamma, "proved": rl.verify(found).proved}


def plant(name: str) -> tuple[Any, int, int]:
    """The generalised plant, and its numbers of measurements and controls."""
    with h5py.File(SHARED / "compleib.h5") as file:
        m = {key: file[name][key][()] for key in file[name]}
    n_y, n_u = len(m["C"]), m["B"].shape[1]
    D = np.block([[m["D11"], m["D12"]], [m["D21"], np.zeros((n_y, n_u))]])
    model = rl.StateSpaceModel(m["A"], np.hstack([m["B1"], m["B"]]), np.vstack([m["C1"], m["C"]]), D)
    return model, n_y, n_u
