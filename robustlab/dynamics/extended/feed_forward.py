"""Feed-forward of named effects: the input that compensates them along a reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.display import Displayable, Facts, number
from robustlab.errors import InputError
from robustlab.signals import Signal
from robustlab.statespace import real_array

ALONG = 1e-9  # allowed relative difference of direction between a force and the input's: rounding


class Wave(NamedTuple):
    """``c cos(k q) + s sin(k q)``: c, s in units of the input, k in 1/rad or 1/m; k = 0 is a constant."""

    c: float
    s: float
    k: float


class DryLevel(NamedTuple):
    """``(level + more exp(-(v / vs)^2)) sgn v``: level, more in units of the input, vs in units of the speed."""

    level: float
    more: float = 0.0
    vs: float = 1.0


@dataclass(frozen=True)
class FeedForward(Displayable):
    """An input as a function of the reference's position and speed."""

    input: Signal
    position: Signal
    waves: tuple[Wave, ...] = ()
    dry: tuple[DryLevel, ...] = ()
    of: tuple[str, ...] = ()
    left: float = 0.0

    quantities: ClassVar[Mapping[str, Any]] = {"largest": float, "left": float}

    def __call__(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the input at positions q and speeds v of the reference, both of one shape, (n,) or ()."""
        at, speed = (real_array(name, x, np.ndim(x), "feed-forward") for name, x in (("q", q), ("v", v)))
        if at.shape != speed.shape:
            raise InputError("feed-forward", f"positions {at.shape}, speeds {speed.shape}", "one shape")
        found = np.zeros(at.shape)
        for c, s, k in self.waves:
            found = found + c * np.cos(k * at) + s * np.sin(k * at)
        for level, more, vs in self.dry:
            found = found + (level + more * np.exp(-((speed / vs) ** 2))) * np.sign(speed)
        return found

    @property
    def largest(self) -> float:
        """Bound of its magnitude, in the unit of the input."""
        return sum(math.hypot(c, s) for c, s, _ in self.waves) + sum(abs(level) + abs(b) for level, b, _ in self.dry)

    def facts(self) -> Facts:
        unit, per = self.input.unit, f"1/{self.position.unit}"
        waves = [f"{number(math.hypot(c, s), unit)} at {number(k, per)}" for c, s, k in self.waves]
        dry = [number(level, unit) for level, _, _ in self.dry]
        return [
            ("feed-forward of", ", ".join(self.of)),
            ("waves over the position", ", ".join(waves)),
            ("dry friction", ", ".join(dry)),
            ("left within the fitted intervals", number(self.left, unit) if self.left else ""),
        ]


Values = Mapping[str, float]

# Effect -> waves and levels of the compensating force -f.
_AGAINST: Mapping[str, Callable[[Values], tuple[list[Wave], list[DryLevel]]]] = {
    "cogging": lambda p: ([Wave(-p["Ac"], -p["As"], p["k"])], []),
    "pendulum-gravity": lambda p: ([Wave(p["H"], p["G"], 1.0)], []),
    "constant-load": lambda p: ([Wave(p["T0"], 0.0, 0.0)], []),
    "coulomb-friction": lambda p: ([], [DryLevel(p["Fc"])]),
    "presliding": lambda p: ([], [DryLevel(p["Fc"])]),
    "stribeck-friction": lambda p: ([], [DryLevel(p["Fc"], p["dF"], p["vs"])]),
    "asymmetric-coulomb-friction": lambda p: (
        [Wave(0.5 * (p["F_pos"] - p["F_neg"]), 0.0, 0.0)],
        [DryLevel(0.5 * (p["F_pos"] + p["F_neg"]))],
    ),
}


def feed_forward(plant: Any, sigmas: float = 2.0) -> FeedForward:
    """Return the feed-forward of a plant's named effects, such as those of ``rl.discover(...).model``."""
    where = f"feed-forward of {getattr(plant, 'name', type(plant).__name__)}"
    laws = [(e, port) for e, _, port in getattr(plant, "laws", ())]
    known = [(e, port) for e, port in laws if e.effect.id in _AGAINST]
    if not known:
        found = ", ".join(e.in_words for e, _ in laws) or "no effect that is a force"
        raise InputError(where, found, f"a plant with one of {', '.join(_AGAINST)}")
    ports = {port.name: port for _, port in known}
    if len(ports) > 1:
        raise InputError(where, f"effects at {', '.join(ports)}", "effects at one joint")
    port = next(iter(ports.values()))
    size = float(port.force @ port.force)
    driving = [
        (signal, gain)
        for signal, column in zip(plant.inputs, plant.model.B.T, strict=True)
        if (gain := float(column @ port.force) / size)
        and np.abs(column - gain * port.force).max() <= ALONG * np.abs(column).max()
    ]
    if not driving:
        raise InputError(where, f"no input that acts at {port.name} alone", "a plant driven at that joint")
    signal, gain = driving[0]
    rows = zip(plant.outputs, plant.model.C, strict=True)
    position = [s for s, row in rows if port.position is not None and np.array_equal(row, port.position)]
    made = [_AGAINST[e.effect.id](e.values) for e, _ in known]
    waves = [Wave(c / gain, s / gain, k) for parts, _ in made for c, s, k in parts]
    dry = [DryLevel(level / gain, more / gain, vs) for _, parts in made for level, more, vs in parts]
    left = sum(e.largest_offset(sigmas) - e.largest_offset(0.0) for e, _ in known) / abs(gain)
    words = tuple(e.in_words for e, _ in known)
    if not position:
        raise InputError(where, f"no output that is the position of {port.name}", "a plant that shows it")
    return FeedForward(signal, position[0], tuple(waves), tuple(dry), words, left)
