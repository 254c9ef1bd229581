"""Steps that take a controller out of the computer: its digital form, verified anew, and files for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robustlab.errors import InputError
from robustlab.recipe.control_schema import DiscretiseStep, ExportStep
from robustlab.recipe.outcome import Fact, Outcome, Workspace

if TYPE_CHECKING:
    from robustlab.uncertainty.lft import UncertainModel

__all__ = ["discretise", "export"]

FORMATS = (".c", ".json", ".mat", ".h5")


def discretise(step: DiscretiseStep, work: Workspace) -> Outcome:
    """The digital controller with the proved norm of the sampled loop."""
    import robustlab as rl
    from robustlab.recipe.steps.design import designed
    from robustlab.statespace import as_model

    K = as_model(work.values[step.of], step.of)
    plant = _uncertain(work.values[step.plant])
    found = rl.discretise_controller(
        plant.nominal, step.dt, K, method=step.method, loss=step.loss, delay=step.delay, antialiasing=step.antialiasing,
        prewarp=step.prewarp, time_limit=step.time_limit,
    )  # fmt: skip
    return designed(found, f"{step.of} with a sample time of {step.dt:g} s.", work)


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
