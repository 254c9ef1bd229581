"""From a gap to a better controller, before and after an effect was named: four pairs of numbers, in one picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.effect_loads import resting_start
from robustlab.dynamics.extended.extended_plant import ExtendedPlant
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.simulation import simulate
from robustlab.errors import InputError
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.record import Record
from robustlab.shown import Facts, Shown


@dataclass(frozen=True, eq=False)
class Story(Shown):
    """What the picture shows; pairs are before and after."""

    # `t`, `record`, `origin` (measured or simulated), `curves` (two simulations), `rms` and `label` of a record; None
    # without one.
    gap: Mapping[str, Any] | None
    # Unmodelled dynamics in the sets, shares of the input; None where they are told otherwise.
    radii: Sequence[float] | None
    held_out: Mapping[str, float] | None  # `before` and `after`: what held-out records need; None without such
    # margins, mu: margins of robust performance, and the mu that they prove
    margins: Sequence[Margin]
    mu: Sequence[float]
    # t, curves, errors, unit, after: of the referee, which is a simulation: time in s, tracking error over it,
    # largest error of any member, unit, and the time in s from which it counts
    t: Array
    curves: Sequence[Array]
    errors: Sequence[float]
    unit: str
    after: float = 0.0

    PAIR: ClassVar[Mapping[str, Any]] = {"before": float, "after": float, "ratio": "1"}

    def headline(self) -> str:
        """What it is."""
        return "The whole way in one picture"

    @property
    def caption(self) -> str:
        """What its picture shows, and what of it is simulated."""
        told = (
            "From the gap to the better controller: before and after the effects were named. The errors are simulated"
        )
        return f"{told}." if self.gap is None else f"{told}, the record is {self.gap['origin']}."

    def numbers(self) -> dict[str, Any]:
        """The pairs with their ratios, and by how many percent mu fell."""
        mu = {"before": self.mu[0], "after": self.mu[1], "fall_percent": fall_percent(*self.mu)}
        found: dict[str, Any] = {"mu": mu, "error": pair(*self.errors)}
        if self.gap is not None:
            found["gap"] = pair(*self.gap["rms"])
        if self.radii is not None:
            found["radius"] = pair(*self.radii)
        return found if self.held_out is None else {**found, "held_out": dict(self.held_out)}

    def facts(self) -> Facts:
        """Every pair in words."""
        told: Facts = []
        if self.gap is not None:
            before, after = self.gap["rms"]
            words = f"{before:.4g} → {after:.4g}: {times_in_words(before, after)}"
            told.append((f"Gap of {self.gap['label']}, {self.gap['origin']} record, RMS", words))
        told.append(
            ("μ of robust performance, proved", f"{self.mu[0]:.4g} → {self.mu[1]:.4g}: {fall_in_words(*self.mu)}")
        )
        if self.held_out is not None:
            words = f"{self.held_out['before']:.3g} → {self.held_out['after']:.3g}"
            told.append(("Unmodelled dynamics that held-out data need", words))
        if self.radii is not None:
            words = f"{self.radii[0]:.3g} → {self.radii[1]:.3g} of the input"
            told.append(("Unmodelled dynamics in the set", words))
        before, after = self.errors
        words = f"{before:.4g} → {after:.4g} {self.unit}: {times_in_words(before, after)}"
        return [*told, ("Largest tracking error of the referee, simulated", words)]

    def to_json(self) -> dict[str, Any]:
        """The pairs."""
        return self.numbers()


def simulated_gap(record: Record, output: str, plants: Sequence[tuple[str, Any]], origin: str) -> dict[str, Any]:
    """The record's output with the simulations of both plants, from rest, and the RMS errors: `Story.gap`.

    ``output``: the first of the record where empty. ``origin``: whether the record is measured or simulated.
    Raises InputError: a plant is not linear.
    """
    output = output or next(iter(record.outputs))
    curves = []
    for name, plant in plants:
        if not isinstance(plant, LinearPlant | ExtendedPlant):
            raise InputError(f"plants: {name}", f"a {type(plant).__name__}", "a linear plant, with or without effects")
        clock, x0 = resting_start(plant, record)
        inputs = {s.name: record[s.name] for s in plant.inputs}
        curves.append(simulate(plant, clock, inputs, x0)[output])
    recorded = record[output]
    rms = [float(np.sqrt(np.mean((c - recorded) ** 2))) for c in curves]
    label = f"{output} [{record.unit(output)}]"
    return {"t": record.t, "record": recorded, "origin": origin, "curves": curves, "rms": rms, "label": label}


def pair(before: float, after: float) -> dict[str, float]:
    """Two numbers, and how many times smaller the second is."""
    return {"before": before, "after": after, "ratio": before / after if after > 0 else math.inf}


def fall_percent(before: float, after: float) -> float:
    """By how many percent mu fell; NaN where one of both is not proved: a fall from infinity is none."""
    return 100 * (1 - after / before) if np.isfinite([before, after]).all() and before > 0 else float("nan")


def fall_in_words(before: float, after: float) -> str:
    """The fall of mu, or that there is none to tell."""
    fall = fall_percent(before, after)
    if not np.isfinite(fall):
        return "not to be compared"
    return f"{abs(fall):.3g} % {'higher' if fall < 0 else 'lower'}"


def times_in_words(before: float, after: float) -> str:
    """How many times smaller, or larger, the second is: ``1.1 times larger``."""
    if after > before:
        return f"{_number(after / max(before, 1e-300))} times larger"
    return f"{_number(before / max(after, 1e-300))} times smaller"


def _number(ratio: float) -> str:
    """Three digits, and no powers of ten below a million."""
    return f"{ratio:.0f}" if 100 <= ratio < 1e6 else f"{ratio:.3g}"
