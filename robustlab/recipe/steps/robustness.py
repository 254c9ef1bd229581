"""Steps that prove: the norm of a model, and the stability of a whole set."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

import robustlab as rl
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, picked, quantity, step
from robustlab.recipe.steps.vocabulary import (
    GUARD,
    Effort,
    TimeLimit,
    ToModel,
    ToUncertain,
)


@step
class HinfNormStep(Step):
    """H-infinity norm of a model."""

    do: Literal["hinf-norm"]
    of: ToModel

    def run(self, work: Workspace) -> Outcome:
        """H-infinity norm of a model, as a proved bracket."""
        norm = rl.hinf_norm(work.values[self.of])
        numbers = picked(norm, "value", "frequency", "lower", "upper")
        facts = (
            Fact("H-infinity norm", f"{quantity(norm.value, digits=8)} (at most {quantity(norm.upper, digits=8)})"),
            Fact("attained at", quantity(norm.frequency, "rad/s")),
        )
        return Outcome(None, f"H-infinity norm of {self.of}.", numbers, facts, norm.status)


@step
class RobustStabilityStep(Step):
    """Robust stability margin over the whole frequency axis, with its mu bounds."""

    do: Literal["robust-stability"]
    of: ToUncertain
    effort: Effort = Field(1.0, description="Multiple of the usual work of the proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        """Robust stability margin with both bounds, over the whole frequency axis."""
        from robustlab.frequency import default_grid
        from robustlab.report.mu_figures import mu_figure, shares_figure

        uncertain = work.uncertain(self.of)
        grid = default_grid(uncertain.M, 60) if uncertain.M.n_states else None
        margin = rl.robust_stability(
            uncertain, omega=grid, effort=self.effort, time_limit=self.time_limit, seed=work.seed
        )
        work.keep(margin)
        numbers = picked(margin, "lower", "upper", "frequency", "delta")
        attained = f"{quantity(margin.upper)}: the values below destabilise" if margin.delta else "none found"
        facts = [
            Fact("Margin, proved from below", f"{quantity(margin.lower)}: no smaller Δ destabilises"),
            Fact("Margin, attained from above", attained),
            *(Fact(f"Destabilising {name}", quantity(value, unit)) for name, (value, unit) in margin.physical.items()),
        ]
        if margin.frequency is not None:
            facts.append(Fact("Critical frequency", quantity(margin.frequency, "rad/s")))
        work.draw(
            mu_figure(margin),
            "mu",
            "Bounds of μ over frequency. The proved margin is the inverse of the highest shaded level.",
        )
        if margin.shares:
            caption = "What each block weighs in the margin: the one on top is to be tightened first."
            work.draw(shares_figure(margin.shares), "shares", caption)
        stable = "proved stable for every Δ of the set" if margin.lower > 1 else "not proved stable over the whole set"
        scale = "A margin of 1 means the set as stated; at 2 every range could be twice as wide."
        return Outcome(None, f"{self.of}: {stable}.", numbers, tuple(facts), margin.status, (scale, *margin.notes))
