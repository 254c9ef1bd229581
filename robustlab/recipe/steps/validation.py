"""Steps on the numbers that the thesis prints."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.operations.vocabulary import Count
from robustlab.recipe.steps.contract import Ahead, Fact, Inferred, Outcome, Step, Workspace, quantity, step

_MEANING = {
    "R": "reproduced within the fair tolerance",
    "F": "fitted: a value that is not printed was chosen so that it agrees; no reproduction",
    "P": "reproduced in part, or under the reading stated",
    "N": "not reproducible from the text, for the reason stated",
}


@step
class PublishedNumbersStep(Step):
    """The numbers that L. Březina's thesis prints about its Stewart platform, and ours, with its figures redrawn."""

    do: Literal["published-numbers"]
    n: Annotated[int, Field(ge=1, le=1000)] = Field(20, description="Random members in each figure of perturbed models")

    def infer(self, ahead: Ahead) -> Inferred:
        from robustlab.thesis.numbers import PublishedNumber

        row = {f.name: ... for f in fields(PublishedNumber)} | {"difference": ..., "agrees": ...}
        bands = {"*": {"*": "%"}}
        return Inferred(leaves={"rows": {"*": row}, "counts": {"*": "1"}, "disagreeing": "1", "bands": bands})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.thesis.figures import case_picture, pictures_of_numbers
        from robustlab.thesis.numbers import published_numbers as compute

        found = compute()
        work.keep(found)
        bands: dict[str, dict[str, float]] = {}
        for name, picture in pictures_of_numbers(found):
            work.draw(picture.figure, name, picture.caption)
        for case in found.cases:
            picture, bands[case.name] = case_picture(case, self.n, work.seed)
            work.draw(picture.figure, f"case-{case.name}", picture.caption)
        rows = {key: row.to_json() for key, row in found.rows.items()}
        counts = {status: len(found.with_status(status)) for status in _MEANING}
        off = found.disagreeing
        facts = tuple(Fact(f"Rows {status}: {meaning}", str(counts[status])) for status, meaning in _MEANING.items())
        facts += (Fact("Rows R and F that do not agree", ", ".join(off) or "none"),)
        facts += tuple(_fact(row) for row in found.rows.values())
        reproduced = sum(row.agrees is True for row in found.with_status("R"))
        summary = (
            f"{len(rows)} rows: {reproduced} of {counts['R']} said to be reproduced are; {counts['F']} more are fits, "
            "which are not counted."
        )
        numbers = {"rows": rows, "counts": counts, "disagreeing": len(off), "bands": bands}
        return Outcome(None, summary, numbers, facts, found.status)


@step
class ThesisCaseStep(Step):
    """The platform of L. Březina's thesis, uncertain as in a case of its section 10.3.1.

    Inputs: the six torques, and `gravity`: 1 where the holding torque stays that of the nominal machine while gravity
    acts on the perturbed one, 0 where each member is trimmed anew.
    """

    gives: ClassVar[str] = "uncertain"
    leaves: ClassVar[Any] = {
        "blocks": "1", "channels": "1", "published": "%", "gain_percent": "%", "released": "N m", "worst": "1",
        "changes": {"*": "%"},
    }  # fmt: skip
    do: Literal["thesis-case"]
    case: Literal["1", "2a", "2b", "2c"]
    structure: Literal["elements", "columns", "rows", "matrices", "single"] = "single"
    n: Count = Field(0, description="Random members in the picture with nominal and worst Δ; no picture where 0.")

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.stewart.stewart_platform import stewart_platform
        from robustlab.thesis.figures import case_picture
        from robustlab.thesis.numbers import cases

        (case,) = [c for c in cases(stewart_platform()) if c.name == self.case]
        model = rl.elementwise(*case.with_gravity(), self.structure)
        numbers: dict[str, Any] = {"blocks": len(model.blocks), "channels": model.delta_shape[0]}
        numbers |= {name: getattr(case, name) for name in ("published", "gain_percent", "released", "worst")}
        if self.n:
            picture, numbers["changes"] = case_picture(case, self.n, work.seed)
            work.draw(picture.figure, f"case-{case.name}", picture.caption)
        what = f"{len(model.blocks)} real parameters ({self.structure}), {model.delta_shape[0]} channels"
        facts = (
            Fact("Uncertain", what),
            Fact("The thesis prints", f"±{quantity(case.published, '%')}", "figures 10.6-10.21"),
            Fact("Change of the torques' gain B alone", quantity(case.gain_percent, "%")),
            Fact("Holding torque, nominal minus perturbed", quantity(case.released, "N m")),
            Fact("Worst end of the set with one parameter", case.worst_in_words),
        )
        return Outcome(model, f"Case {case.name}: {case.words}.", numbers, facts)


def _fact(row: Any) -> Fact:
    """Return a row as a line of the report: published, ours, difference; the reason as its source."""
    limit = {"equal": "", "at most": "at most ", "at least": "at least "}[row.bound]
    published = "not printed" if row.published is None else f"published {limit}{quantity(row.published, row.unit)}"
    ours = "ours: none" if row.ours is None else f"ours {quantity(row.ours, row.unit, 6)}"
    gap = "" if row.difference is None else f"; difference {quantity(row.difference, row.unit, 3)}"
    return Fact(f"{row.key} ({row.status}): {row.quantity}, {row.where}", f"{published}; {ours}{gap}", row.why)
