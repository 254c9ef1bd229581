"""Steps that judge uncertain models: samples, worst case, norms, robust stability."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import HinfNormStep, RobustStabilityStep, SampleStep, WorstCaseStep

__all__ = ["hinf_norm", "robust_stability", "sample", "worst_case"]


def sample(step: SampleStep, work: Workspace) -> Outcome:
    """Responses of seeded members and of vertices, with their envelope; nothing is proved about members not drawn."""
    import robustlab as rl

    model = work.uncertain(step.of)
    t, u = _step_input(model, step.input, step.t_end, step.points)
    for reference in step.reference:
        _known(reference.output, [s.name for s in model.outputs], "reference: output")
    seed = work.seed if step.seed is None else step.seed
    responses = rl.sample(model, step.n, seed, vertices=step.vertices).respond(t, u)
    if not responses.status.trustworthy:
        raise NoTrustworthyNumber(f"sample {step.of}", "responses outgrow every number", hint="a smaller t_end")
    numbers: dict[str, Any] = {}
    facts: list[Fact] = []
    for k, (name, _) in enumerate(model.outputs):
        numbers[name], found = _sampled_output(step, work, responses, k)
        facts += found
    count = len(responses.y)
    summary = f"{count} members of {step.of} simulated ({step.n} random, seed {seed}; the rest vertices of Δ)."
    notes = ["Sampled, not proved: members that were not drawn may lie outside this envelope."]
    if responses.unstable:
        notes.insert(0, f"{len(responses.unstable)} of these {count} members are unstable.")
    numbers = {"outputs": numbers, "members": count, "unstable": len(responses.unstable)}
    return Outcome(None, summary, numbers, tuple(facts), notes=tuple(notes))


def _sampled_output(step: SampleStep, work: Workspace, responses: Any, k: int) -> tuple[dict[str, Any], list[Fact]]:
    """Numbers, facts and figure of the k-th output."""
    from robustlab.report.response_figures import response_figure

    model = work.uncertain(step.of)
    name, unit = model.outputs[k]
    y, nominal = responses.y[:, :, k], responses.nominal[:, k]
    lower, upper = responses.lower[:, k], responses.upper[:, k]
    final = {"nominal": float(nominal[-1]), "lower": float(lower[-1]), "upper": float(upper[-1])}
    references = [(r.value, r.text) for r in step.reference if r.output == name]
    covers = [final["lower"] <= value <= final["upper"] for value, _ in references]
    span = f"{quantity(final['lower'])} … {quantity(final['upper'], unit)}"
    facts = [Fact(f"{name} at the end", f"{span} (nominal {quantity(final['nominal'], unit)})")]
    for (value, text), inside in zip(references, covers, strict=True):
        facts.append(Fact(text, f"{quantity(value, unit)}: {'covered' if inside else 'not covered'}"))
    figure = response_figure(responses.t, y, nominal, (lower, upper), output=(name, unit), references=references)
    members = f"{step.n} random members and {step.vertices} vertices of Δ"
    work.draw(figure, name, f"{name} after a step of {_amplitudes(step.input, model)}: {members}.")
    deviation = float(abs(y - nominal).max(initial=0.0))
    return {"final": final, "peak_deviation": deviation, "covers": covers}, facts


def worst_case(step: WorstCaseStep, work: Workspace) -> Outcome:
    """The largest value of a metric that a search over Delta found, evaluated again at that Delta."""
    import robustlab as rl
    from robustlab.report.response_figures import worst_case_figure

    model = work.uncertain(step.of)
    options: dict[str, Any] = {"seed": work.seed if step.seed is None else step.seed}
    if step.n is not None:
        options["n"] = step.n
    if step.output is not None:
        options["output"] = step.output
    t = u = None
    if step.metric == "peak-deviation":
        assert step.t_end is not None
        t, u = _step_input(model, step.input, step.t_end, step.points)
        options |= {"t": t, "u": u}
    found = rl.worst_case(model, step.metric, **options)
    work.keep(found)
    numbers = {
        "value": found.value,
        "nominal_value": found.nominal_value,
        "evaluations": found.evaluations,
        "delta": found.delta,
    }
    where = f" at {found.location} = {quantity(found.at)}" if math.isfinite(found.at) else ""
    facts = [
        Fact(f"Worst {step.metric} found", f"{quantity(found.value, found.unit)}{where}"),
        Fact("The same at Δ = 0", quantity(found.nominal_value, found.unit)),
        Fact("How it was found", f"{found.evaluations} evaluations, seed {found.seed}"),
        *(Fact(f"Its {name}", quantity(value, unit)) for name, (value, unit) in found.physical.items()),
    ]
    if t is not None and u is not None:
        index = [s.name for s in model.outputs].index(step.output) if step.output else 0
        name, unit = model.outputs[index]
        nominal, worst = (_respond(m, t, u)[:, index] for m in (model.nominal, model.evaluate(found.delta)))
        figure = worst_case_figure(t, nominal, worst, (name, unit), "worst member found")
        work.draw(figure, name, f"{name}: nominal and worst member found.")
    summary = f"Worst {step.metric} over Δ of {step.of}; {found.label}."
    return Outcome(None, summary, numbers, tuple(facts), found.status)


def hinf_norm(step: HinfNormStep, work: Workspace) -> Outcome:
    """H-infinity norm of a model, as a proved bracket."""
    import robustlab as rl

    norm = rl.hinf_norm(work.values[step.of])
    numbers = {"value": norm.value, "frequency": norm.frequency, "lower": norm.lower, "upper": norm.upper}
    facts = (
        Fact("H-infinity norm", f"{quantity(norm.value, digits=8)} (at most {quantity(norm.upper, digits=8)})"),
        Fact("attained at", quantity(norm.frequency, "rad/s")),
    )
    return Outcome(None, f"H-infinity norm of {step.of}.", numbers, facts, norm.status)


def robust_stability(step: RobustStabilityStep, work: Workspace) -> Outcome:
    """Robust stability margin with both bounds, over the whole frequency axis."""
    import robustlab as rl
    from robustlab.frequency import default_grid
    from robustlab.report.mu_figures import mu_figure, shares_figure

    uncertain = work.uncertain(step.of)
    grid = default_grid(uncertain.M, 60) if uncertain.M.n_states else None
    margin = rl.robust_stability(uncertain, omega=grid, seed=work.seed)
    work.keep(margin)
    numbers = {"lower": margin.lower, "upper": margin.upper, "frequency": margin.frequency, "delta": margin.delta}
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
    return Outcome(None, f"{step.of}: {stable}.", numbers, tuple(facts), margin.status, (scale, *margin.notes))


def _step_input(model: Any, amplitudes: Mapping[str, float], t_end: float, points: int) -> tuple[Any, Any]:
    """Times (n_t,) and a step of the given amplitudes on the named inputs (n_t, n_u)."""
    import numpy as np

    known = [s.name for s in model.inputs]
    for name in amplitudes:
        _known(name, known, "input")
    t = np.linspace(0.0, t_end, points)
    return t, np.tile([amplitudes.get(name, 0.0) for name in known], (points, 1))


def _known(name: str, known: list[str], where: str) -> None:
    if name not in known:
        raise InputError(f"{where} {name!r}", "no such signal", f"one of {', '.join(known)}", did_you_mean(name, known))


def _respond(model: Any, t: Any, u: Any) -> Any:
    """Outputs (n_t, n_y) of a linear model."""
    import numpy as np

    import robustlab as rl

    record = rl.simulate(model, t, u)
    return np.column_stack([record.outputs[name] for name in model.output_names])


def _amplitudes(amplitudes: Mapping[str, float], model: Any) -> str:
    units = dict(model.inputs)
    return ", ".join(f"{quantity(value, units[name])} on {name}" for name, value in amplitudes.items())
