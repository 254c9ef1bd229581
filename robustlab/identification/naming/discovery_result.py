"""What `discover` answers: the verdict, the named effects with their evidence, the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from robustlab.identification.response.response import Evidence
from robustlab.result import Status

if TYPE_CHECKING:
    from robustlab.identification.comparison.noise_floor import NoiseFloor
    from robustlab.identification.experiment.next_experiment import NextExperiment
    from robustlab.identification.record_check.suitability import Finding
    from robustlab.identification.unnamed.unnamed_effect import ResidualForce, UnnamedForce
    from robustlab.uncertainty.lft import UncertainModel

__all__ = [
    "Discovery",
    "EffectValue",
    "Gap",
    "NamedEffect",
    "NamingStep",
    "NominalValue",
    "Rival",
    "StepEntry",
    "Verdict",
]

Verdict = Literal["no missing effect", "named", "ambiguous", "unknown"]


@dataclass(frozen=True)
class EffectValue(Evidence):
    """One fitted parameter of an effect: value, unit, 95 % interval (posterior, given the effect), and meaning."""

    name: str
    value: float
    unit: str
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True)
class NominalValue(Evidence):
    """One refitted nominal parameter: value before and after, unit, 95 % interval, and the tolerance it was given.

    ``assumed`` is True where the plant states no tolerance and one was assumed.
    """

    name: str
    nominal: float
    value: float
    unit: str
    lower: float
    upper: float
    tolerance: float
    assumed: bool


@dataclass(frozen=True)
class Rival(Evidence):
    """An effect that these records cannot separate from a named one.

    Attributes
    ----------
    name, title, site
        The rival.
    instead_of
        Id of the named effect whose place it could take; "none" where nothing was named, but this effect is about as
        probable as none: the tolerances of other parameters may hide it.
    distance
        Refit distance d in standard deviations of the noise: how far the rival's best fit stays from what the named
        effect predicts for these very records. d < 3 cannot be told apart. Of a rival of "none" it is how far the bare
        model stays from what the rival predicts.
    evidence
        Log evidence relative to the named effect (negative: behind).
    wins
        Share of bootstrap samples in which it was the best.
    parameters
        As it was fitted.
    """

    name: str
    title: str
    site: str
    instead_of: str
    distance: float
    evidence: float
    wins: float
    parameters: tuple[EffectValue, ...]


@dataclass(frozen=True)
class NamedEffect(Evidence):
    """One effect that the records show.

    Attributes
    ----------
    name
        Id in the catalogue.
    title, equation, site
        In words; as a formula; where it sits.
    parameters
        Fitted values with intervals.
    confidence
        Share of bootstrap samples of the windows in which it was the best of all candidates, 0..1.
    evidence
        Log evidence over the model without it.
    rivals
        Ids that these records cannot separate from it; empty where the name is unique.
    """

    name: str
    title: str
    equation: str
    site: str
    parameters: tuple[EffectValue, ...]
    confidence: float
    evidence: float
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Gap(Evidence):
    """Windowed simulation error (RMS) of one output on data that the fit never saw.

    Attributes
    ----------
    output, unit, range
        The output, its unit, its measured range on that data.
    nominal, refitted, updated
        RMS of the nominal model as given, of the nominal model refitted within its tolerances, and of the updated one.
    """

    output: str
    unit: str
    range: float
    nominal: float
    refitted: float
    updated: float


@dataclass(frozen=True)
class StepEntry(Evidence):
    """One hypothesis of a step: effect id and site ("none" for nothing added), log evidence and bootstrap share."""

    name: str
    site: str
    evidence: float
    wins: float


@dataclass(frozen=True)
class NamingStep(Evidence):
    """One step of the greedy search: what it had named before, the ranking, and what it decided.

    ``held_out`` is the windowed RMS error on held-out data, in percent of the outputs' ranges, with the best addition.
    """

    named_before: tuple[str, ...]
    ranking: tuple[StepEntry, ...]
    decision: str
    held_out: float


@dataclass(frozen=True)
class Discovery(Evidence):
    """Result of `robustlab.identification.naming.discovery.discover`.

    Attributes
    ----------
    status
        CONVERGED, or INCONCLUSIVE where the verdict is ambiguous or unknown (a finding, no failure).
    verdict
        ``"no missing effect"`` (``rivals`` has what the records do not exclude all the same), ``"named"``,
        ``"ambiguous"`` (named, but some name has rivals that these records cannot exclude), ``"unknown"`` (something is
        missing that no effect of the catalogue explains).
    complete
        False where structure remains beyond the named effects.
    effects, rivals
        Named effects in the order in which they were found; what could not be told apart.
    nominal
        Refitted nominal parameters.
    gap_before, gap_after
        Windowed RMS error on held-out data in percent of the measured range, over all outputs: nominal model, and
        updated one. ``gaps`` has each output in its unit.
    gap_refitted
        The same of the nominal model refitted within its tolerances.
    held_out
        What the gap was measured on: names of the held-out records, or the held-out blocks of the records.
    model
        The updated plant (an `ExtendedPlant` or `LinearPlant`), ready for trim, linearise, save.
    next_experiment
        What to measure next to separate the rivals; None where there are none.
    steps
        The greedy search.
    residual_force, unnamed
        Where something remains: the residual force over speed, position, time and input; its spline map.
    structure
        Cross-validated share of the residual force that a smooth map explains, its p-value, and over what.
    noise_floor, floor_excess
        Model-free noise floor where the record repeats, and F of the updated model against it (1: nothing left).
    findings
        Remarks on the records.
    window
        Length of the windows in s.
    series
        Signals of a held-out stretch for figures: ``t``, and for each output ``measured``, ``nominal``, ``refitted``,
        ``updated`` (windowed simulation).
    candidates
        Ids that were tried.
    seconds
        Time that the naming took.
    """

    status: Status
    verdict: Verdict
    complete: bool
    effects: tuple[NamedEffect, ...]
    rivals: tuple[Rival, ...]
    nominal: tuple[NominalValue, ...]
    gap_before: float
    gap_refitted: float
    gap_after: float
    gaps: Mapping[str, Gap]
    held_out: str
    plant: str
    records: tuple[str, ...]
    window: float
    steps: tuple[NamingStep, ...]
    candidates: tuple[str, ...]
    structure: Mapping[str, Any]
    findings: tuple[Finding, ...] = ()
    remaining_lines: tuple[Mapping[str, Any], ...] = ()
    next_experiment: NextExperiment | None = None
    residual_force: ResidualForce | None = None
    unnamed: UnnamedForce | None = None
    noise_floor: NoiseFloor | None = None
    floor_excess: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Any] = field(default_factory=dict)
    model: Any = None
    seconds: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the named effects."""
        return tuple(e.name for e in self.effects)

    @property
    def answer(self) -> tuple[str, ...]:
        """Ids of the named effects and of all their rivals."""
        return tuple(dict.fromkeys([*self.names, *(r.name for r in self.rivals)]))

    def uncertain_model(self, outputs: Any = None, **options: Any) -> UncertainModel:
        """What was found and what remains as blocks; see `robustlab.identification.naming.remaining_uncertainty`."""
        from robustlab.identification.naming.remaining_uncertainty import uncertain_from

        return uncertain_from(self, outputs, **options).model

    def summary(self) -> str:
        """The result as a few lines of text."""
        from robustlab.identification.naming.discovery_text import summary

        return summary(self)

    def to_json(self, series: bool = False) -> dict[str, object]:
        """All fields but the plant object; the time series only on request."""
        left_out = {"model", "findings"} | (set() if series else {"series"})
        data: dict[str, object] = {key: value for key, value in vars(self).items() if key not in left_out}
        data.update(names=self.names, answer=self.answer, findings=[vars(f) for f in self.findings])
        return data
