"""What "worst" may mean: the contract of a metric, and what the metrics share.

Every metric has two ways to its value: ``values`` for many Deltas at once, which a search uses, and ``evaluate`` for
one, through `UncertainModel.evaluate` and the routines that a user would call: the result is re-evaluated with it.
Where the value is smooth in the parameters (``smooth``), a search climbs along difference quotients of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.linear_analysis.structural import drop_unconnected
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import Ensemble, members


class Evaluation(NamedTuple):
    """A metric at one Delta."""

    value: float  # the metric; infinite where there is no bounded value
    at: float = np.nan  # time in s or frequency in rad/s where it is attained; NaN where there is none
    accurate: bool = True  # False where the routine behind it lost digits
    reason: str = ""  # why there is no bounded value; else empty


class Metric:
    """A number for each member of a set."""

    uncertain: UncertainModel  # the set, without what does not matter for the metric
    unit: str = ""  # unit of the value; empty where not stated
    location: str = ""  # what `at` is: `"t [s]"`, `"omega [rad/s]"`, or empty
    # 1 where the largest value is the worst, -1 where the smallest is. A member without a bounded value has `sense *
    # inf`.
    sense: float = 1.0
    tolerance: float = 1e-6  # search and re-evaluation must agree to this share of the value
    smooth: bool = True  # False where the value jumps with the parameters
    # True where re-evaluation may find a worse value than the search saw (a peak between its grid points).
    one_sided: bool = False

    @property
    def unbounded(self) -> float:
        """The value of a member that has none."""
        return self.sense * np.inf

    def of(self, ensemble: Ensemble) -> Array:
        """The metric of each member, shape (k,)."""
        raise NotImplementedError

    def values(self, delta: NDArray[Any]) -> Array:
        """The metric at a stack of Deltas (k, q, p), shape (k,)."""
        return self.of(members(self.uncertain, delta))

    def evaluate(self, delta: Mapping[str, Any]) -> Evaluation:
        """The metric at one Delta, by a second way."""
        try:
            model = self.uncertain.evaluate(delta)
        except NoTrustworthyNumber as error:  # ill-posed
            return Evaluation(self.unbounded, reason=error.found)
        return self.of_model(model)

    def of_model(self, model: StateSpaceModel) -> Evaluation:
        """The metric of one model, by a second way."""
        raise NotImplementedError

    def work(self, count: int) -> float:
        """Work of measuring so many members at once, roughly."""
        n = self.uncertain.M.n_states
        return 300 + count * (20 + n**2 + n**3 / 30)

    def slack(self, value: float) -> float:
        """How far re-evaluation may be off ``value``."""
        return self.tolerance * abs(value)

    def agrees(self, found: float, again: float) -> bool:
        """Whether re-evaluation confirms what was found."""
        if not np.isfinite(found) or not np.isfinite(again):
            return bool(found == again)
        slack = max(self.slack(found), self.slack(again))
        # A second path that may look between the search's points can find a worse value: that is no fault.
        beyond = self.sense * (again - found)
        return bool(-slack <= beyond and (self.one_sided or beyond <= slack))


# --- what metrics share ----------------------------------------------------------------------------------------------


def connected(uncertain: UncertainModel) -> UncertainModel:
    """The same set without states that no input reaches or no output sees, whatever Delta is."""
    return UncertainModel(drop_unconnected(uncertain.M), uncertain.blocks)


def selected(uncertain: UncertainModel, input: str | None, output: str | None) -> UncertainModel:
    """The set with the named input and output only; None keeps all."""
    for kind, name, known in (("input", input, uncertain.inputs), ("output", output, uncertain.outputs)):
        names = [s.name for s in known]
        if name is not None and name not in names:
            raise InputError(
                f"worst_case: {kind} {name!r}",
                "no such signal",
                f"one of {', '.join(names)}",
                did_you_mean(name, names),
            )
    return uncertain.select([input] if input else None, [output] if output else None)


def need_real(uncertain: UncertainModel, what: str) -> None:
    """Refuse complex blocks."""
    for block in uncertain.blocks:
        if not block.is_real:
            hint = "a complex Delta has a metric 'hinf' only"
            raise InputError("worst_case", f"block {block.name!r} is complex", f"real blocks for {what}", hint)


def need_stable(nominal: StateSpaceModel, what: str) -> None:
    """Refuse a nominal model that is not asymptotically stable; one without states is."""
    if nominal.n_states and not nominal.is_stable():
        poles = nominal.poles()
        worst = poles[np.argmax(np.abs(poles) if nominal.is_discrete else poles.real)]
        raise NoTrustworthyNumber(
            "worst_case",
            f"nominal model is not asymptotically stable (pole {worst:.4g}): {what}",
            None,
            "choose an output that does not see this pole, or close a loop around the model first",
        )
