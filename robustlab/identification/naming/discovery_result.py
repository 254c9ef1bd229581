"""What `discover` answers: the verdict, the named effects with their evidence, the gap before and after; its text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from robustlab.dynamics.effects.kinds import KINDS
from robustlab.identification.naming.discovery_numbers import numbers_of, quantities_of
from robustlab.identification.naming.discovery_text import details_of, facts_of, headline_of
from robustlab.identification.naming.named_effects import (
    SURE,
    Gap,
    InputClock,
    NamedEffect,
    NamedKind,
    NominalValue,
    Rival,
    SearchEntry,
    SetProbability,
)
from robustlab.result import Evidence, Status
from robustlab.shown import Each, Facts, Part
from robustlab.tables import Table, Tabular

if TYPE_CHECKING:
    from robustlab.identification.comparison.repeats import NoiseFloor
    from robustlab.identification.experiment import NextExperiment
    from robustlab.identification.naming.residual_force import ResidualForce
    from robustlab.identification.record_check.suitability import Finding
    from robustlab.uncertainty.lft import UncertainModel

LINEAR = "linear about the recorded motion"  # said of the records of such runs
Verdict = Literal["no missing effect", "named", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Discovery(Tabular, Evidence):
    """Result of `robustlab.identification.naming.discovery.discover`.

    Attributes
    ----------
    status
        CONVERGED, or INCONCLUSIVE where the verdict is ambiguous or unknown, or where the named effects leave more of
        the error on held-out data than they explain.
    verdict
        ``"no missing effect"`` (``rivals`` has what the records do not exclude all the same), ``"named"``,
        ``"ambiguous"`` (named, but some name has rivals that these records cannot exclude), ``"unknown"`` (something is
        missing that no effect of the catalogue explains).
    complete
        False where structure remains beyond the named effects.
    effects, rivals
        Named effects in the order in which they were found; what could not be told apart.
    kinds
        What is sure at each place: the narrowest kind of effects with 95 %, its quantities over all its members, and
        their shares. Empty where the verdict is ``"unknown"``.
    also_detectable
        Effects that the records show and that bring next to nothing on held-out data: no part of the updated plant.
    nominal
        Refitted nominal parameters.
    gap_before, gap_after
        Windowed RMS error on held-out data in percent of the measured range, over all outputs: nominal model, and
        updated one. ``gaps`` has each output in its unit.
    gap_refitted
        The same of the nominal model refitted.
    held_out
        What the gap was measured on: names of the held-out records, or the held-out blocks of the records.
    free_run, free_run_on
        The same errors of one simulation from the record's start to its end, without restarts; the records.
    model
        The updated plant (an `ExtendedPlant` or `LinearPlant`), ready for trim, linearise, save; None where its free
        run on held-out data is worse than that of the plant as given.
    next_experiment
        What to measure next to separate the rivals; None where there are none.
    posterior
        Sets of effects, the most probable first.
    clocks
        Hold and time shift of each input, as the records tell them.
    search
        Every set that the search visited.
    residual_force, missing_force
        The force that the updated model still lacks over speed, position, time and input; the one that the refitted
        nominal model lacked.
    structure
        ``noise_ratio``: error over noise and random force; ``explained``: share of the mean-square error as given on
        held-out data that the updated model removes, noise not counted.
    noise_floor, floor_excess
        Model-free noise floor where the record repeats, and F of the updated model against it (1: nothing left).
    findings
        Remarks on the records.
    window
        Length of the windows in s.
    series
        Signals of a held-out stretch for figures: ``t``, and for each output ``measured``, ``nominal``, ``refitted``,
        ``updated`` (windowed simulation); ``free_run`` has the same of one held-out record from its start.
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
    candidates: tuple[str, ...]
    structure: Mapping[str, Any]
    kinds: tuple[NamedKind, ...] = ()
    also_detectable: tuple[NamedEffect, ...] = ()
    posterior: tuple[SetProbability, ...] = ()
    search: tuple[SearchEntry, ...] = ()
    clocks: tuple[InputClock, ...] = ()
    free_run: Mapping[str, Gap] = field(default_factory=dict)
    free_run_on: str = ""
    findings: tuple[Finding, ...] = ()
    remaining_lines: tuple[Mapping[str, Any], ...] = ()
    next_experiment: NextExperiment | None = None
    residual_force: ResidualForce | None = None
    missing_force: ResidualForce | None = None
    noise_floor: NoiseFloor | None = None
    floor_excess: Mapping[str, float] = field(default_factory=dict)
    series: Mapping[str, Any] = field(default_factory=dict)
    model: Any = None
    seconds: float = 0.0

    quantities: ClassVar[Mapping[str, Any]] = {
        "verdict": str,
        "complete": bool,
        "names": [str],
        "places": [str],
        "answer": [str],
        "kinds": [str],
        **{kind: {"probability": "1", **quantities_of(kind)} for kind in KINDS},
        "count": "1",
        **dict.fromkeys(("gap_before", "gap_refitted", "gap_after"), "%"),
        **dict.fromkeys(("gap_ratio", "refitted_ratio"), "1"),
        "gaps": Each("outputs", Gap),
        "free_run": {**dict.fromkeys(("before", "refitted", "after"), "%"), "outputs": Each("outputs", Gap)},
        "effects": {"*": {"*": float}},
        "lower": {"*": {"*": float}},
        "upper": {"*": {"*": float}},
        "confidence": {"*": "1"},
        "nominal": {"*": float},
        "next_experiment": {"name": str, "separation": float},
        "structure": {"*": ...},
        "remaining_lines": [...],
        "line": {over: {"period": unit, "amplitude": float} for over, unit in (("position", float), ("time", "s"))},
        "seconds": "s",
    }

    @property
    def whole_run(self) -> str:
        """What ``free_run`` is: of a nonlinear plant one run that is linear about the recorded motion."""
        return "one linear run" if LINEAR in self.free_run_on else "free run"

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the named effects."""
        return tuple(e.name for e in self.effects)

    @property
    def answer(self) -> tuple[str, ...]:
        """Ids of the named effects and of all their rivals."""
        return tuple(dict.fromkeys([*self.names, *(r.name for r in self.rivals)]))

    def uncertain_model(self, outputs: Any = None, **options: Any) -> UncertainModel:
        """What was found and what remains as blocks; see `robustlab.identification.naming.updated_plant`."""
        from robustlab.identification.naming.updated_plant import uncertain_from

        return uncertain_from(self, outputs, **options).model

    @property
    def collection(self) -> tuple[SetProbability, ...]:
        """The smallest collection of sets that has 95 % of the probability."""
        total, found = 0.0, []
        for entry in self.posterior:
            if total >= SURE:
                break
            found.append(entry)
            total += entry.probability
        return tuple(found)

    @property
    def interrupted(self) -> bool:
        """True where the search was stopped by the user: the answer is what was known by then."""
        return any(f.kind == "interrupted" for f in self.findings)

    def headline(self) -> str:
        """The verdict in one sentence that a person understands."""
        return headline_of(self)

    def numbers(self) -> dict[str, Any]:
        """What requirements may refer to; see `robustlab.identification.naming.discovery_numbers`."""
        return numbers_of(self)

    def facts(self) -> Facts:
        """Verdict, effects with their parameters, what is left open, errors on held-out data, what to do next."""
        return facts_of(self)

    def details(self) -> list[Part]:
        """What the answer rests on."""
        return details_of(self)

    def table(self) -> Table:
        """A row for each parameter of a named effect, with its 95 % interval."""
        rows = [(e, p) for e in self.effects for p in e.parameters]
        columns = {"effect": [e.name for e, _ in rows], "site": [e.site for e, _ in rows]}
        values = {key: [getattr(p, key) for _, p in rows] for key in ("value", "lower", "upper", "unit")}
        probability = {"probability": [e.confidence for e, _ in rows]}
        return Table(("parameter", [p.name for _, p in rows]), {**columns, **values, **probability})

    def to_json(self, series: bool = False) -> dict[str, object]:
        """All fields but the plant object; the time series only on request."""
        left_out = {"model", "findings"} | (set() if series else {"series"})
        data: dict[str, object] = {key: value for key, value in vars(self).items() if key not in left_out}
        data.update(names=self.names, answer=self.answer, findings=[vars(f) for f in self.findings])
        return data
