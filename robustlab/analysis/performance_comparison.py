"""Proved mu of robust performance and worst-case gain of one requirement under several controllers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from robustlab.analysis.gain import peak_gain
from robustlab.display import Displayable, Facts, Part
from robustlab.errors import InputError
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.robustness import robust_performance
from robustlab.result import Status, least_trusted
from robustlab.synthesis.specifications.loop_functions import frequencies
from robustlab.uncertainty.lft import UncertainModel


class Performance(NamedTuple):
    """Order, nominal gain, margin and, if requested, worst-case gain of one controller."""

    order: int
    nominal_gain: float
    margin: Margin
    gain: Any = None

    def __repr__(self) -> str:
        return f"Performance(mu at most {inverse(self.margin.lower):.4g}, order {self.order})"

    def numbers(self) -> dict[str, Any]:
        found = {
            "order": self.order, "nominal_gain": self.nominal_gain, "mu_lower": inverse(self.margin.upper),
            "mu_upper": inverse(self.margin.lower), "frequency": self.margin.frequency,
        }  # fmt: skip
        worst = {} if self.gain is None else {"gain_lower": self.gain.lower, "gain_upper": self.gain.upper}
        return found | worst


@dataclass(frozen=True, eq=False)
class PerformanceComparison(Displayable):
    """Robust performance of one problem under several controllers, the same requirement for all.

    Attributes
    ----------
    controllers
        Controller -> its performance.
    """

    controllers: Mapping[str, Performance]

    @property
    def margins(self) -> dict[str, Margin]:
        """Controller -> margin."""
        return {name: one.margin for name, one in self.controllers.items()}

    @property
    def status(self) -> Status:
        """Least trusted status of all proofs."""
        return least_trusted([part.status for _, part in self._proofs()])

    @property
    def notes(self) -> tuple[str, ...]:
        """Meaning of the numbers, and the remarks of the proofs."""
        what = "μ at most 1: for every Δ of the set the weighted gain is at most 1."
        first = f"{what} The worst-case gain is over that set."
        return (first, *(f"{of}: {text}." for of, part in self._proofs() for text in part.notes))

    def _proofs(self) -> list[tuple[str, Any]]:
        """Every margin and gain, labelled with its controller."""
        parts = ((f"{name}, {what}", part) for name, one in self.controllers.items()
                 for what, part in (("μ", one.margin), ("gain", one.gain)))  # fmt: skip
        return [(of, part) for of, part in parts if part is not None]

    def headline(self) -> str:
        return f"robust performance under {len(self.controllers)} controllers, the same requirement for all"

    def facts(self) -> Facts:
        met = [name for name, one in self.controllers.items() if inverse(one.margin.lower) <= 1]
        return [("requirement met by every member, proved", ", ".join(met) or "by none of them")]

    def details(self) -> list[Part]:
        with_gain = any(one.gain is not None for one in self.controllers.values())
        header = ("controller", "order", "nominal gain", "μ, attained .. proved", *["worst-case gain"] * with_gain)
        rows = []
        for name, one in self.controllers.items():
            row = one.numbers()
            bounds = [f"{row['mu_lower']:.4g} .. {row['mu_upper']:.4g}"]
            bounds += [f"{row['gain_lower']:.4g} .. {row['gain_upper']:.4g}"] if with_gain else []
            rows.append((name, str(one.order), f"{one.nominal_gain:.4g}", *bounds))
        return [Part("", header, rows)]

    def numbers(self) -> dict[str, Any]:
        return {"controllers": {name: one.numbers() for name, one in self.controllers.items()}}

    def to_json(self) -> dict[str, Any]:
        return {"status": self.status, **self.numbers()}


def compare_performance(
    loops: Mapping[str, tuple[UncertainModel, int]],
    *,
    gain: bool = True,
    points: int = 120,
    accuracy: float = 1e-3,
    **options: Any,
) -> PerformanceComparison:
    """Proved mu of robust performance of each loop, and its worst-case gain.

    ``loops``: controller -> the weighted loop under it, whose gain is to be at most 1, and the controller's order.
    ``points``: frequencies of the margins' curves. ``options``: ``effort``, ``time_limit``, ``seed`` of the proofs.
    """
    found: dict[str, Performance] = {}
    for name, (loop, order) in loops.items():
        if not loop.nominal.is_stable():
            raise InputError(f"controller {name!r}", "does not stabilise the problem", "a stable nominal loop")
        margin = robust_performance(
            loop, omega=frequencies(loop.M, points), accuracy=accuracy, tolerance=math.inf, **options
        )
        worst = peak_gain(loop, tolerance=0.01, **options) if gain else None
        found[name] = Performance(order, float(peak_gain(loop.nominal).upper), margin, worst)
    return PerformanceComparison(found)


def inverse(value: float) -> float:
    """One over a margin; inf for none."""
    return 1 / value if value > 0 else math.inf
