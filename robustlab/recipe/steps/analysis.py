"""Steps that judge uncertain models: samples, worst case, norms, robust stability."""

from __future__ import annotations

import math
from typing import Any

from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import (
    DrivenStep,
    HinfNormStep,
    MetricStep,
    RobustStabilityStep,
    SampleStep,
    ViolationStep,
    WorstCaseStep,
)

__all__ = ["metric_options", "hinf_norm", "robust_stability", "sample", "violation_probability", "worst_case"]


def sample(step: SampleStep, work: Workspace) -> Outcome:
    """Responses of seeded members and of vertices, with their envelope; nothing is proved about members not drawn."""
    import robustlab as rl

    model = work.uncertain(step.of)
    known = [s.name for s in model.outputs]
    for name in step.outputs or []:
        _known(name, known, "outputs:")
    for reference in step.reference:
        _known(reference.output, step.outputs or known, "reference: output")
    if step.outputs:
        model = model.select(None, step.outputs)
    t, u = _excitation(model, step, step.t_end, step.points)
    seed = work.seed if step.seed is None else step.seed
    responses = rl.sample(model, step.n, seed, vertices=step.vertices).respond(t, u, hold=_hold(step))
    if not responses.status.trustworthy:
        raise NoTrustworthyNumber(f"sample {step.of}", "responses outgrow every number", hint="a smaller t_end")
    numbers: dict[str, Any] = {}
    facts: list[Fact] = []
    for k, (name, _) in enumerate(responses.outputs):
        numbers[name], found = _sampled_output(step, work, responses, k)
        facts += found
    if step.percent is not None:
        facts.append(_percent_bands(step, work, responses, numbers, step.percent))
    count = len(responses.y)
    summary = f"{count} members of {step.of} simulated ({step.n} random, seed {seed}; the rest vertices of Δ)."
    notes = ["Sampled, not proved: members that were not drawn may lie outside this envelope."]
    if responses.unstable:
        notes.insert(0, f"{len(responses.unstable)} of these {count} members are unstable.")
    numbers = {"outputs": numbers, "members": count, "unstable": len(responses.unstable)}
    return Outcome(None, summary, numbers, tuple(facts), notes=tuple(notes))


def _sampled_output(step: SampleStep, work: Workspace, responses: Any, k: int) -> tuple[dict[str, Any], list[Fact]]:
    """Numbers, facts and figure of the k-th output."""
    from robustlab.report.worst_case_figures import response_figure

    name, unit = responses.outputs[k]
    y, nominal = responses.y[:, :, k], responses.nominal[:, k]
    lower, upper = responses.lower[:, k], responses.upper[:, k]
    final = {"nominal": float(nominal[-1]), "lower": float(lower[-1]), "upper": float(upper[-1])}
    references = [(r.value, r.text) for r in step.reference if r.output == name]
    covers = [final["lower"] <= value <= final["upper"] for value, _ in references]
    span = f"{quantity(final['lower'])} … {quantity(final['upper'], unit)}"
    facts = [Fact(f"{name} at the end", f"{span} (nominal {quantity(final['nominal'], unit)})")]
    for (value, text), inside in zip(references, covers, strict=True):
        facts.append(Fact(text, f"{quantity(value, unit)}: {'covered' if inside else 'not covered'}"))
    if step.percent is None:  # else the curves would lie on one another
        figure = response_figure(responses.t, y, nominal, (lower, upper), output=(name, unit), references=references)
        members = f"{step.n} random members and {step.vertices} vertices of Δ"
        work.draw(figure, name, f"{name} after {_amplitudes(step, responses.inputs)}: {members}.")
    deviation = float(abs(y - nominal).max(initial=0.0))
    numbers = {"final": final, "peak_deviation": deviation, "covers": covers, "worst_member": responses.worst[k]}
    size = float(abs(nominal).max())
    if size > 0:
        numbers["peak_percent"] = 100 * deviation / size
    return numbers, facts


def _percent_bands(step: SampleStep, work: Workspace, responses: Any, numbers: Any, published: float) -> Fact:
    """The members' deviations in percent of the largest nominal value, drawn beside a published band."""
    import numpy as np

    from robustlab.thesis.figures import percent_figure

    bands: dict[str, Any] = {}
    for k, (name, _) in enumerate(responses.outputs):
        nominal = responses.nominal[:, k]
        if np.abs(nominal).max() > 0:
            bands[name] = 100 * (responses.y[:, :, k] - nominal) / np.abs(nominal).max()
    caption = f"Change of {', '.join(bands)} in percent of the largest nominal value, and the published band."
    work.draw(percent_figure(responses.t, bands, published), "percent", caption)
    found = ", ".join(f"{name} {numbers[name]['peak_percent']:.4g} %" for name in bands)
    return Fact("Largest change of a member", f"{found}; published ±{published:g} %")


def worst_case(step: WorstCaseStep, work: Workspace) -> Outcome:
    """The worst value of a metric that a search over Delta found, evaluated again at that Delta."""
    import numpy as np

    import robustlab as rl
    from robustlab.report.worst_case_figures import worst_case_figure

    model = work.uncertain(step.of)
    options = metric_options(step, work)
    if step.n is not None:
        options["n"] = step.n
    found = rl.worst_case(model, step.metric, effort=step.effort, time_limit=step.time_limit, **options)
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
    if step.of_a_response:
        index = [s.name for s in model.outputs].index(step.output) if step.output else 0
        name, unit = model.outputs[index]
        t, u = options["t"], options["u"]
        both = (model.nominal, model.evaluate(found.delta))
        nominal, worst = (_respond(m, t, u, options["hold"])[:, index] for m in both)
        if np.abs(nominal).max() > 0:
            numbers["percent"] = 100 * float(np.abs(worst - nominal).max() / np.abs(nominal).max())
            facts.append(Fact("Largest change of the response", quantity(numbers["percent"], "%", 4)))
        figure = worst_case_figure(t, nominal, worst, (name, unit), "worst member found")
        work.draw(figure, name, f"{name}: nominal and worst member found.")
    summary = f"Worst {step.metric} over Δ of {step.of}; {found.label}."
    return Outcome(None, summary, numbers, tuple(facts), found.status)


def violation_probability(step: ViolationStep, work: Workspace) -> Outcome:
    """Probability that random members violate a limit, with its bounds, and which parameters matter."""
    import robustlab as rl
    from robustlab.report.worst_case_figures import distribution_figure, influence_figure

    limit = step.limit if step.unit is None else f"{step.limit!r} {step.unit}"
    options = metric_options(step, work)
    options |= {"confidence": step.confidence, "probability": step.probability}
    found = rl.violation_probability(work.uncertain(step.of), step.metric, limit, n=step.n, **options)
    work.keep(found)
    keys = ("n", "violations", "unbounded", "probability", "lower", "upper", "at_most", "worst_value", "worst_delta")
    numbers: dict[str, Any] = {key: getattr(found, key) for key in keys}
    for key in ("shown", "samples_needed"):
        if getattr(found, key) is not None:
            numbers[key] = getattr(found, key)
    numbers["quantiles"] = {f"{100 * q.share:g}": q._asdict() for q in found.quantiles}
    sure = f"{100 * step.confidence:g} %"
    facts = [
        Fact("Violations", f"{found.violations} of {found.n} samples (seed {found.seed})"),
        Fact("P(violation)", f"between {found.lower:.4g} and {found.upper:.4g} at {sure} confidence (Clopper-Pearson)"),
        Fact("Worst sample", f"number {found.worst_index}: {quantity(found.worst_value, found.unit)}"),
    ]
    if step.probability is not None:
        word = "shown" if found.shown else "not shown"
        facts.append(Fact(f"P(violation) at most {step.probability:g}", f"{word}: at most {found.at_most:.4g}, {sure}"))
    work.draw(distribution_figure(found), "distribution", f"{step.metric} of {found.n} random members of {step.of}.")
    if found.influence is not None and found.influence.names:
        numbers["influence"] = dict(zip(found.influence.names, found.influence.first_order.tolist(), strict=True))
        caption = "Which parameters matter: share of the spread, and the worst sample with one of them nominal."
        work.draw(influence_figure(found.influence, step.metric), "influence", caption)
    summary = f"{step.metric} of {found.n} members of {step.of} against {quantity(found.limit, found.unit)}."
    return Outcome(None, summary, numbers, tuple(facts), found.status, (*found.notes, found.label))


def metric_options(step: MetricStep, work: Workspace) -> dict[str, Any]:
    """Keyword arguments for a metric as the step says."""
    import numpy as np

    options: dict[str, Any] = {"seed": work.seed if step.seed is None else step.seed, "band": step.band}
    options |= {"output": step.output, "input": step.from_input}
    if step.of_a_response:
        assert step.t_end is not None
        options["t"], options["u"] = _excitation(work.uncertain(step.of), step, step.t_end, step.points)
        options["hold"] = _hold(step)
    elif step.t_end is not None:
        options["t"] = np.linspace(0.0, step.t_end, step.points)
    return options


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
    margin = rl.robust_stability(uncertain, omega=grid, effort=step.effort, time_limit=step.time_limit, seed=work.seed)
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


def _excitation(model: Any, step: DrivenStep, t_end: float, points: int) -> tuple[Any, Any]:
    """Times (n_t,) and inputs (n_t, n_u): steps, plus sines, of the given amplitudes on the named inputs."""
    import numpy as np

    known = [s.name for s in model.inputs]
    for name in [*step.input, *step.sine]:
        _known(name, known, "input")
    t = np.linspace(0.0, t_end, points)
    u = np.tile([step.input.get(name, 0.0) for name in known], (points, 1))
    if step.frequency is not None:
        wave = np.sin(2 * np.pi * step.frequency * t)
        u = u + wave[:, None] * [step.sine.get(name, 0.0) for name in known]
    return t, u


def _hold(step: DrivenStep) -> Any:
    return "foh" if step.sine else "zoh"


def _known(name: str, known: list[str], where: str) -> None:
    if name not in known:
        raise InputError(f"{where} {name!r}", "no such signal", f"one of {', '.join(known)}", did_you_mean(name, known))


def _respond(model: Any, t: Any, u: Any, hold: Any) -> Any:
    """Outputs (n_t, n_y) of a linear model."""
    import numpy as np

    import robustlab as rl

    record = rl.simulate(model, t, u, hold=hold)
    return np.column_stack([record.outputs[name] for name in model.output_names])


def _amplitudes(step: DrivenStep, inputs: Any) -> str:
    """What drives, in words."""
    units = dict(inputs)
    parts: list[str] = []
    sine = f"a sine of {step.frequency:g} Hz" if step.frequency else ""
    for amplitudes, what in ((step.input, "a step"), (step.sine, sine)):
        given = {name: quantity(value, units[name]) for name, value in amplitudes.items()}
        if len(given) > 2 and len(set(given.values())) == 1:
            parts.append(f"{what} of {next(iter(given.values()))} on {len(given)} inputs")
        elif given:
            parts.append(f"{what} of {', '.join(f'{value} on {name}' for name, value in given.items())}")
    return " and ".join(parts)
