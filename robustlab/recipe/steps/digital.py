"""Steps for the controller on the machine: files for other programs, and feed-forward of named effects."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.operations.vocabulary import RefersTo, ToController, ToPlantOrFile
from robustlab.recipe.steps.contract import Fact, Outcome, Step, Workspace, facts_of, step

FORMATS = (".c", ".mat", ".h5")


@step
class ExportStep(Step):
    """A controller for other programs: STEP.c (C99), STEP.mat and STEP.h5 in the output folder."""

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

    feed_forward: Annotated[str, RefersTo(("feed-forward",))] | None = Field(
        None, description="Added to a control signal in the C code, before the limits; the other files do not have it."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.provenance import file_sha256
        from robustlab.statespace import as_model

        given = work.values[self.of]
        K = as_model(given, self.of)
        origin = work.provenance()
        limits = {name: tuple(pair) for name, pair in self.saturation.items()} or None
        digests: dict[str, str] = {}
        for suffix in FORMATS:
            path = work.folder / f"{work.step}{suffix}"
            options: dict[str, Any] = {"prefix": self.prefix, "saturation": limits} if suffix == ".c" else {}
            if suffix == ".c" and self.feed_forward is not None:
                options["feed_forward"] = work.values[self.feed_forward]
            rl.export_controller(path, given, provenance=origin, **options)
            work.files.append(path.name)
            digests[suffix[1:]] = file_sha256(path)
        facts = (
            Fact("Sample time", f"{K.dt:g} s"),
            Fact("Measurements", ", ".join(f"{s.name} [{s.unit}]" for s in K.inputs)),
            Fact("Control signals", ", ".join(f"{s.name} [{s.unit}]" for s in K.outputs)),
            *(Fact(f"SHA-256 of {work.step}.{kind}", digest) for kind, digest in digests.items()),
        )
        if self.feed_forward is not None:
            facts += tuple(
                Fact(fact.label, fact.value, f"{work.step}.c") for fact in facts_of(work.values[self.feed_forward])
            )
        numbers = {"order": K.n_states, "dt": K.dt, "sha256": digests}
        names = ", ".join(f"{work.step}{suffix}" for suffix in FORMATS)
        return Outcome(work.folder / f"{work.step}.h5", f"{self.of} written to {names}.", numbers, facts)


@step
class FeedForwardStep(Step):
    """The input that a motion needs because of named effects, from its reference."""

    gives: ClassVar[str] = "feed-forward"
    leaves: ClassVar[Any] = {"largest": float, "waves": [float], "counts": ["1"], "dry": float, "left": float}
    do: Literal["feed-forward"]
    of: ToPlantOrFile = Field(description="A discover step, or a plant with effects.")

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.extended.feed_forward import feed_forward

        found = feed_forward(work.values[self.of])
        numbers = {
            "largest": found.largest, "waves": [math.hypot(w.c, w.s) for w in found.waves],
            "counts": [w.k for w in found.waves], "dry": sum(d.level for d in found.dry), "left": found.left,
        }  # fmt: skip
        return Outcome(found, f"Feed-forward of {self.of}.", numbers, facts_of(found))
