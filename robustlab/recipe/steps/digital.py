"""Steps that take a controller out of the computer: its digital form, verified anew, and files for other programs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from robustlab.errors import InputError
from robustlab.recipe.control_schema import DiscretiseStep, ExportStep
from robustlab.recipe.outcome import Fact, Outcome, Workspace
from robustlab.recipe.steps.control import inverse
from robustlab.result import Status

if TYPE_CHECKING:
    from robustlab.statespace import StateSpaceModel
    from robustlab.uncertainty.lft import UncertainModel

__all__ = ["discretise", "export"]

FORMATS = (".c", ".json", ".mat", ".h5")


def discretise(step: DiscretiseStep, work: Workspace) -> Outcome:
    """The digital controller with the proved norm of the sampled loop, and mu of its uncertain one."""
    import robustlab as rl
    from robustlab.recipe.steps.design import designed
    from robustlab.statespace import as_model

    K = as_model(work.values[step.of], step.of)
    plant = _uncertain(work.values[step.plant])
    found = rl.discretise_controller(
        plant.nominal, step.dt, K, method=step.method, loss=step.loss, delay=step.delay, antialiasing=step.antialiasing,
        prewarp=step.prewarp, effort=step.effort, time_limit=step.time_limit,
    )  # fmt: skip
    outcome = designed(found, f"{step.of} with a sample time of {step.dt:g} s.", work)
    return _with_robustness(outcome, step, plant, K, found.K, work) if plant.blocks else outcome


def _with_robustness(
    outcome: Outcome, step: DiscretiseStep, plant: UncertainModel, K: StateSpaceModel, digital: Any, work: Workspace
) -> Outcome:
    """The same with mu and margin of the uncertain loop, continuous before and sampled after."""
    import robustlab as rl

    options: dict[str, Any] = {"effort": step.effort, "time_limit": step.time_limit, "seed": work.seed}
    before = rl.robust_performance(plant.close(K), accuracy=1e-3, tolerance=math.inf, **options)
    after = rl.sampled_robustness(plant, digital, delay=step.delay, antialiasing=step.antialiasing, **options)
    work.keep(after, "robustness")
    mu = {"lower": inverse(before.upper), "upper": inverse(before.lower)}
    numbers = {
        "mu_before": mu,
        "mu_after": {"lower": after.mu_lower, "upper": after.mu_upper},
        "margin_before": before.lower,
        "margin_after": after.margin,
        "stability_margin_after": after.stability.lower,
        "mu_growth": after.mu_upper / mu["upper"] - 1 if mu["upper"] > 0 else 0.0,
    }
    facts = (
        Fact("μ of robust performance, continuous", f"{mu['lower']:.4g} .. {mu['upper']:.4g} (attained .. proved)"),
        *(Fact(f"Sampled: {label}", text) for label, text in after.summary()),
    )
    statuses = [status for status in (outcome.status, before.status, after.status) if status is not None]
    sentence = f"{outcome.summary} mu of robust performance: {mu['upper']:.4g} before, {after.mu_upper:.4g} sampled."
    note = (
        "mu of the sampled loop holds for every member of the continuous set with its own exact discretisation, and "
        "for the signals between the samples."
    )
    return replace(
        outcome, summary=sentence, numbers={**outcome.numbers, **numbers}, facts=(*outcome.facts, *facts),
        status=max(statuses, key=list(Status).index), notes=(*outcome.notes, note),
    )  # fmt: skip


def _uncertain(given: Any) -> UncertainModel:
    """The generalised plant of a problem or a model with its Delta channels first; without any where it is certain."""
    from robustlab.statespace import as_model
    from robustlab.uncertainty.lft import UncertainModel

    uncertain = given.to_uncertain() if hasattr(given, "to_uncertain") else given
    return uncertain if isinstance(uncertain, UncertainModel) else UncertainModel(as_model(uncertain, "plant"), [])


def export(step: ExportStep, work: Workspace) -> Outcome:
    """The files of a controller, with its provenance."""
    import robustlab as rl
    from robustlab.provenance import Provenance, file_sha256
    from robustlab.statespace import as_model

    given = work.values[step.of]
    K = as_model(given, step.of)
    if not K.is_discrete:
        found = "gave a continuous controller"
        raise InputError(f"step {step.of!r}", found, "a digital one", "a step discretise with its sample time before")
    origin = Provenance.now(f"recipe step {work.step}", work.inputs, work.seed)
    limits = {name: tuple(pair) for name, pair in step.saturation.items()} or None
    digests: dict[str, str] = {}
    for suffix in FORMATS:
        path = work.folder / f"{work.step}{suffix}"
        options: dict[str, Any] = {"prefix": step.prefix, "saturation": limits} if suffix in (".c", ".json") else {}
        rl.export_controller(path, given, provenance=origin, **options)
        work.files.append(path.name)
        digests[suffix[1:]] = file_sha256(path)
    facts = (
        Fact("Sample time", f"{K.dt:g} s"),
        Fact("Measurements", ", ".join(f"{s.name} [{s.unit}]" for s in K.inputs)),
        Fact("Control signals", ", ".join(f"{s.name} [{s.unit}]" for s in K.outputs)),
        *(Fact(f"SHA-256 of {work.step}.{kind}", digest) for kind, digest in digests.items()),
    )
    numbers = {"order": K.n_states, "dt": K.dt, "sha256": digests}
    names = ", ".join(f"{work.step}{suffix}" for suffix in FORMATS)
    return Outcome(work.folder / f"{work.step}.h5", f"{step.of} written to {names}.", numbers, facts)
