"""Steps that take a controller out of the computer: its digital form, verified anew, and files for other programs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.doors.vocabulary import GUARD, Effort, Positive, TimeLimit, ToController, ToDesignable
from robustlab.errors import InputError
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, least_trusted, step
from robustlab.recipe.steps.design import designed, numbers_of

FORMATS = (".c", ".json", ".mat", ".h5")


@step
class DiscretiseStep(Step):
    """The digital form of a controller, with what the sampled loop loses; robust performance is proved for it anew.

    The norm and mu are those of the continuous plant with sampler, computation delay and hold, between the samples too.
    """

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = {
        **numbers_of("loss", "allowed_loss"), **dict.fromkeys(("dt", "delay"), "s"), "antialiasing": "rad/s",
        **{key: {"lower": "1", "upper": "1"} for key in ("mu_before", "mu_after")},
        **dict.fromkeys(("margin_before", "margin_after", "stability_margin_after", "mu_growth"), "1"),
    }  # fmt: skip
    do: Literal["discretise"]
    of: ToController
    plant: ToDesignable = Field(description="The problem or generalised plant that the controller was designed for.")
    dt: Positive = Field(description="Sample time in s.")
    method: Literal["auto", "direct", "tustin", "tustin-prewarp", "zoh", "foh", "impulse", "matched"] = "auto"
    delay: Annotated[float, Field(ge=0)] = Field(0.0, description="Computation delay in s.")
    prewarp: Positive | None = Field(None, description="rad/s; the peak of the continuous loop where left out.")
    loss: Annotated[float, Field(ge=0, le=100)] = Field(
        0.1, description="Share of the norm from which on auto designs for the sampled plant."
    )
    antialiasing: Positive | None = Field(None, description="Corner of a filter before the sampler in rad/s.")
    effort: Effort = Field(1.0, description="Multiple of the usual work of the search and of each proof.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model

        K = as_model(work.values[self.of], self.of)
        plant = _uncertain(work.values[self.plant])
        found = rl.discretise(
            K, self.dt, plant=plant.nominal, method=self.method, loss=self.loss, delay=self.delay,
            antialiasing=self.antialiasing, prewarp=self.prewarp, effort=self.effort, time_limit=self.time_limit,
        )  # fmt: skip
        outcome = designed(found, f"{self.of} with a sample time of {self.dt:g} s.", work)
        return _with_robustness(outcome, self, plant, K, found.K, work) if plant.blocks else outcome


@step
class ExportStep(Step):
    """A controller for other programs: STEP.c (C99), STEP.json, STEP.mat and STEP.h5 in the output folder."""

    gives: ClassVar[str] = "saved"
    leaves: ClassVar[Any] = {"order": "1", "dt": "s", "sha256": {"*": str}}
    do: Literal["export"]
    of: ToController
    prefix: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")] = Field(
        "controller", description="Of every name in the C code."
    )
    saturation: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(
        {}, description="Limits [low, high] of each control signal in the C code."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.provenance import file_sha256
        from robustlab.statespace import as_model

        given = work.values[self.of]
        K = as_model(given, self.of)
        if not K.is_discrete:
            found = "gave a continuous controller"
            raise InputError(
                f"step {self.of!r}", found, "a digital one", "a step discretise with its sample time before"
            )
        origin = work.provenance()
        limits = {name: tuple(pair) for name, pair in self.saturation.items()} or None
        digests: dict[str, str] = {}
        for suffix in FORMATS:
            path = work.folder / f"{work.step}{suffix}"
            options: dict[str, Any] = {"prefix": self.prefix, "saturation": limits} if suffix in (".c", ".json") else {}
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
        return Outcome(work.folder / f"{work.step}.h5", f"{self.of} written to {names}.", numbers, facts)


def _with_robustness(
    outcome: Outcome,
    step: DiscretiseStep,
    plant: rl.UncertainModel,
    K: rl.StateSpaceModel,
    digital: Any,
    work: Workspace,
) -> Outcome:
    """The same with mu and margin of the uncertain loop, continuous before and sampled after."""
    from robustlab.recipe.steps.control import inverse

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
        *(Fact(f"Sampled: {label}", text) for label, text in after.facts()),
    )
    statuses = [status for status in (outcome.status, before.status, after.status) if status is not None]
    sentence = f"{outcome.summary} mu of robust performance: {mu['upper']:.4g} before, {after.mu_upper:.4g} sampled."
    note = (
        "mu of the sampled loop holds for every member of the continuous set with its own exact discretisation, and "
        "for the signals between the samples."
    )
    return replace(
        outcome, summary=sentence, numbers={**outcome.numbers, **numbers}, facts=(*outcome.facts, *facts),
        status=least_trusted(statuses), notes=(*outcome.notes, note),
    )  # fmt: skip


def _uncertain(given: Any) -> rl.UncertainModel:
    """The generalised plant of a problem or a model with its Delta channels first; without any where it is certain."""
    from robustlab.statespace import as_model

    uncertain = given.to_uncertain() if hasattr(given, "to_uncertain") else given
    return (
        uncertain if isinstance(uncertain, rl.UncertainModel) else rl.UncertainModel(as_model(uncertain, "plant"), [])
    )
