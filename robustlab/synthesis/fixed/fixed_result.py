"""Results of fixed-structure design: the controller, its parameters, and what was verified for every model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robustlab.mu_analysis.axis.worst_gain import WorstCaseGain
from robustlab.norms import H2Norm, HinfNorm
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.nonsmooth.parameter_search import Start
from robustlab.synthesis.problem.design import Synthesis

__all__ = ["FixedSynthesis", "LimitValue", "ParameterValue"]


@dataclass(frozen=True)
class ParameterValue:
    """A parameter of the controller: name, value, unit, bounds, and whether it lies at one of them."""

    name: str
    value: float
    unit: str
    low: float
    high: float

    @property
    def at_bound(self) -> bool:
        """True within 0.2 % of the range (of its own size, with one bound) from a bound."""
        if self.low == self.high:
            return False
        width = self.high - self.low if abs(self.low) + abs(self.high) < float("inf") else max(abs(self.value), 1e-300)
        return min(self.value - self.low, self.high - self.value) <= 2e-3 * width

    def to_json(self) -> dict[str, Any]:
        """All fields."""
        return vars(self) | {"at_bound": self.at_bound}


@dataclass(frozen=True)
class LimitValue:
    """A limit of the design in words, and its value: negative or zero where it is kept, -1 far inside."""

    text: str
    value: float

    @property
    def active(self) -> bool:
        """True where the design lies at the limit (within 1 %)."""
        return self.value > -1e-2

    def to_json(self) -> dict[str, Any]:
        """All fields."""
        return vars(self) | {"active": self.active}


@dataclass(frozen=True, eq=False, kw_only=True)
class FixedSynthesis(Synthesis):
    """A controller of a given structure; ``gamma`` bounds the largest norm over all models.

    Of an uncertain plant, ``gamma`` is the proved upper bound of the worst-case gain where that proof succeeded.

    Attributes
    ----------
    objective
        ``"hinf"`` or ``"h2"``.
    parameters
        The controller's parameters.
    gammas
        Verified norm (H-infinity: upper bound) of every model's loop; of an uncertain plant, of every scenario.
    norms
        Their evidence.
    closed_loops
        The loops.
    peak_frequency
        Frequency in rad/s at which the worst loop attains its norm; NaN for H2.
    limits
        The limits with their values.
    starts
        What became of every start, best first: its history is ``values``.
    scenarios
        Of an uncertain plant: the Delta of every scenario.
    worst
        Of an uncertain plant: the worst-case gain over the whole set.
    """

    objective: str
    parameters: tuple[ParameterValue, ...]
    gammas: tuple[float, ...]
    norms: tuple[HinfNorm | H2Norm, ...]
    closed_loops: tuple[StateSpaceModel, ...]
    peak_frequency: float
    limits: tuple[LimitValue, ...]
    starts: tuple[Start, ...]
    scenarios: tuple[Mapping[str, Any], ...] = ()
    worst: WorstCaseGain | None = None

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values by name; a start for another design."""
        return {p.name: p.value for p in self.parameters}

    @property
    def active(self) -> tuple[str, ...]:
        """What the design pushes against: limits and bounds."""
        bounds = tuple(f"{p.name} at its bound" for p in self.parameters if p.at_bound)
        return (*(limit.text for limit in self.limits if limit.active), *bounds)

    def _gamma_text(self) -> str:
        if self.objective == "h2":
            return f"{self.gamma:.6g} (H2 norm, both Gramians)"
        if self.worst is not None and self.gamma == self.worst.upper:
            return f"{self.gamma:.6g} (proved for the whole set; a member attains {self.worst.lower:.6g})"
        return f"{self.gamma:.6g} at {self.peak_frequency:.4g} rad/s (verified upper bound)"

    def summary(self) -> list[tuple[str, str]]:
        """What a person wants to read, as (label, text)."""
        rows = super().summary()
        if len(self.gammas) > 1:
            label = "gamma of every scenario" if self.worst is not None else "gamma of every model"
            rows.insert(2, (label, ", ".join(f"{g:.5g}" for g in self.gammas)))
        stable = sum(s.gamma < float("inf") for s in self.starts)
        rows.append(("starts", f"{len(self.starts)}, of which {stable} stabilised"))
        rows += [("limit", f"{limit.text}{' (active)' if limit.active else ''}") for limit in self.limits]
        shown = self.parameters[:40]
        rows += [(p.name, f"{p.value:.6g} {p.unit}{' (at its bound)' if p.at_bound else ''}".rstrip()) for p in shown]
        if len(shown) < len(self.parameters):
            rows.append(("further parameters", str(len(self.parameters) - len(shown))))
        return rows

    def to_json(self) -> dict[str, Any]:
        """Everything but the plants, with arrays."""
        return super().to_json() | {
            "objective": self.objective,
            "parameters": [p.to_json() for p in self.parameters],
            "gammas": list(self.gammas),
            "peak_frequency": self.peak_frequency,
            "limits": [limit.to_json() for limit in self.limits],
            "active": list(self.active),
            "starts": [s.to_json() for s in self.starts],
            "scenarios": [dict(s) for s in self.scenarios],
            "norms": [n.to_json() for n in self.norms],
            "worst_case_gain": None if self.worst is None else self.worst.to_json(),
        }
