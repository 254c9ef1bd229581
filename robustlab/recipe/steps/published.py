"""Step on published numbers: the thesis beside ours, row by row, and its figures."""

from __future__ import annotations

from typing import Any

from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import PublishedNumbersStep, ThesisCaseStep

__all__ = ["published_numbers", "thesis_case"]

_MEANING = {
    "R": "reproduced within the fair tolerance",
    "P": "reproduced in part, or under the reading stated",
    "N": "not reproducible from the text, for the reason stated",
}


def published_numbers(step: PublishedNumbersStep, work: Workspace) -> Outcome:
    """All rows of the thesis, computed from parameters; figures of chapters 8, 9 and 10."""
    from robustlab.dynamics.stewart.thesis_numbers import published_numbers as compute

    found = compute()
    work.keep(found)
    _draw_conditions(work)
    _draw_sines(found, work)
    _draw_tracking(found, work)
    bands = {case.name: _band(case, step.n, work) for case in found.cases}
    rows = {key: row.to_json() for key, row in found.rows.items()}
    counts = {status: len(found.with_status(status)) for status in _MEANING}
    off = found.disagreeing
    facts = tuple(Fact(f"Rows {status}: {meaning}", str(counts[status])) for status, meaning in _MEANING.items())
    facts += (Fact("Rows R that do not agree", ", ".join(off) or "none"),)
    facts += tuple(_fact(row) for row in found.rows.values())
    summary = f"{len(rows)} rows: {counts['R'] - len(off)} of {counts['R']} said to be reproduced are."
    numbers = {"rows": rows, "counts": counts, "disagreeing": len(off), "bands": bands}
    return Outcome(None, summary, numbers, facts, found.status)


def _fact(row: Any) -> Fact:
    """A row as a line of the report: published, ours, difference; the reason as its source."""
    limit = {"equal": "", "at most": "at most ", "at least": "at least "}[row.bound]
    published = "not printed" if row.published is None else f"published {limit}{quantity(row.published, row.unit)}"
    ours = "ours: none" if row.ours is None else f"ours {quantity(row.ours, row.unit, 6)}"
    gap = "" if row.difference is None else f"; difference {quantity(row.difference, row.unit, 3)}"
    return Fact(f"{row.key} ({row.status}): {row.quantity}, {row.where}", f"{published}; {ours}{gap}", row.why)


def _draw_conditions(work: Workspace) -> None:
    import numpy as np

    from robustlab.dynamics.stewart import condition_map, stewart_platform
    from robustlab.report.stewart_figures import condition_figure

    geometry, side, tilt = stewart_platform().geometry, np.linspace(-0.025, 0.025, 101), np.linspace(-0.15, 0.15, 101)
    maps = [condition_map(geometry, ("tx", "ty"), side, side), condition_map(geometry, ("ax", "ay"), tilt, tilt)]
    work.draw(
        condition_figure(maps),
        "condition",
        "How near poses about home are to a singular one; white is out of the workspace (6.2.1).",
    )


def _draw_sines(found: Any, work: Workspace) -> None:
    from robustlab.report.stewart_figures import sine_figure

    for name, run in found.sines.items():
        until = run.when_height(0.1407) if name == "0.1 N m at 2 Hz" else run.t[-1]
        caption = f"{name} on all motors: the machine, its linear model at home, and their difference (8.1-8.6)."
        work.draw(sine_figure(run, until), f"sine-{name}", caption)


def _draw_tracking(found: Any, work: Workspace) -> None:
    from robustlab.report.stewart_figures import tracking_effort_figure, tracking_error_figure

    words = {"thesis": "all signs +", "link-4": "signs +++-+-", "rotors": "all signs +, with the rotors' inertia"}
    for name, run in found.tracking.items():
        work.draw(tracking_error_figure(run), f"error-{name}", f"Section 9.1.3, {words[name]}: errors of the pose.")
        caption = f"Section 9.1.3, {words[name]}: torques, voltages, lengths of the actuators."
        work.draw(tracking_effort_figure(run), f"effort-{name}", caption)


def _band(case: Any, n: int, work: Workspace) -> dict[str, float]:
    """Largest change in percent of angle and rate over members between the case's two models; draws them."""
    import math

    import numpy as np

    import robustlab as rl
    from robustlab.dynamics.stewart.thesis_numbers import UP_TO
    from robustlab.report.stewart_figures import percent_figure

    between = rl.elementwise(case.nominal, case.perturbed, "single")
    t = np.linspace(0.0, UP_TO, 201)
    sine = np.tile(0.1 * np.sin(2 * math.pi * 2 * t)[:, None], 6)
    responses = rl.sample(between, n, work.seed, vertices=2).respond(t, sine)
    names = [s.name for s in between.outputs]
    bands: dict[str, Any] = {}
    for name in ("phi_1", "phidot_1"):
        k = names.index(name)
        nominal = responses.nominal[:, k]
        bands[name] = 100 * (responses.y[:, :, k] - nominal) / np.abs(nominal).max()
    caption = (
        f"Case {case.name} ({case.words}): {n} random members from -Δ to +Δ and both ends, trimmed anew,"
        f" 0.1 N m at 2 Hz, in percent of the largest nominal value; the thesis has ±{case.published:g} % (10.2-10.21)."
    )
    work.draw(percent_figure(t, bands, case.published), f"case-{case.name}", caption)
    return {name: float(np.abs(curves).max()) for name, curves in bands.items()}


def thesis_case(step: ThesisCaseStep, work: Workspace) -> Outcome:
    """The uncertain platform of one case, with gravity as an input of its own (figure 10.5)."""
    import robustlab as rl
    from robustlab.dynamics.stewart.stewart_platform import stewart_platform
    from robustlab.dynamics.stewart.thesis_runs import cases

    (case,) = [c for c in cases(stewart_platform()) if c.name == step.case]
    nominal, perturbed = (
        _with_gravity(m, extra) for m, extra in ((case.nominal, 0.0), (case.perturbed, case.released))
    )
    model = rl.elementwise(nominal, perturbed, step.structure)
    numbers = {
        "blocks": len(model.blocks),
        "channels": model.delta_shape[0],
        "published": case.published,
        "gain_percent": case.gain_percent,
        "released": case.released,
    }
    facts = (
        Fact("Uncertain", f"{len(model.blocks)} real parameters ({step.structure}), {model.delta_shape[0]} channels"),
        Fact("The thesis prints", f"±{quantity(case.published, '%')}", "figures 10.6-10.21"),
        Fact("Change of the torques' gain B alone", quantity(case.gain_percent, "%")),
        Fact("Holding torque, nominal minus perturbed", quantity(case.released, "N m")),
    )
    return Outcome(model, f"Case {case.name}: {case.words}.", numbers, facts)


def _with_gravity(model: Any, torque: float) -> Any:
    """The model with one more input, ``gravity``, that acts like so much torque on every motor."""
    import numpy as np

    import robustlab as rl

    b = np.hstack([model.B, torque * model.B.sum(axis=1, keepdims=True)])
    d = np.hstack([model.D, torque * model.D.sum(axis=1, keepdims=True)])
    return rl.StateSpaceModel(
        model.A, b, model.C, d, model.dt, [*model.inputs, ("gravity", "1")], model.outputs, model.states
    )
