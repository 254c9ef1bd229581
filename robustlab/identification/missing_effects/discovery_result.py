"""Result of `discover`, and its numbers for requirements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from robustlab.display import Each, Facts, Part
from robustlab.dynamics.effects.catalogue import KINDS, catalogue, effect
from robustlab.dynamics.effects.contract import Scales
from robustlab.dynamics.effects.parameter_effects import GroundedEffect
from robustlab.identification.missing_effects.discovery_parts import (
    LINEAR,
    Gap,
    InputClock,
    NamedEffect,
    NamedKind,
    NominalValue,
    Rival,
    SetProbability,
    Verdict,
    details_of,
    facts_of,
    headline_of,
    overall,
    wave_amplitude,
)
from robustlab.identification.tuning import SURE
from robustlab.result import Evidence, Status
from robustlab.tables import Table, Tabular

if TYPE_CHECKING:
    from robustlab.identification.data_checks.suitability import Finding
    from robustlab.identification.experiment import NextExperiment
    from robustlab.identification.missing_effects.residual_force import ResidualForce
    from robustlab.uncertainty.lft import UncertainModel


def units_of_effects(exclude: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return effect id, alone and with its place -> parameters with their units."""
    left_out = {effect(name).id for name in exclude}
    effects: dict[str, dict[str, Any]] = {}
    for name, kind in catalogue().items():
        units: dict[str, Any] = {p.name: p.unit for p in kind.parameters(Scales())}
        if wave_amplitude(dict.fromkeys(units, 0.0)) is not None:
            units["amplitude"] = float
        if isinstance(kind, GroundedEffect):  # at a joint that has no such parameter
            units[kind.symbol] = float
        if name not in left_out:
            effects |= {name: units, f"{name}@*": units}
    return effects


ENDS = {"": "value", "_lower": "lower", "_upper": "upper"}  # suffix of a quantity -> field


def quantities_of(kind: str) -> dict[str, Any]:
    """Return the quantities of an effect class and the ends of their 95 % intervals; units depend on the place."""
    return {f"{name}{end}": float for name in KINDS[kind].quantities for end in ENDS}


@dataclass(frozen=True)
class Discovery(Tabular, Evidence):
    """Result of `robustlab.identification.missing_effects.discovery.discover`.

    Attributes
    ----------
    status
        CONVERGED; INCONCLUSIVE if the verdict is ambiguous or unknown, or most of the held-out error remains.
    verdict
        ``"no missing effect"`` (``rivals``: effects not excluded), ``"named"``, ``"ambiguous"`` (an effect has rivals
        that these records do not exclude), ``"unknown"`` (no effect of the catalogue explains the error).
    complete
        False if structure remains beyond the named effects.
    effects, rivals, kinds
        Named effects; effects not excluded; the narrowest sure class of effects at each place, with its quantities and
        the shares of its members.
    also_detectable
        Detected effects that are negligible on held-out data: not in the updated plant.
    nominal, clocks
        Refitted parameters; hold and time shift of each input.
    gap_before, gap_refitted, gap_after, gaps, held_out
        Windowed RMS error on held-out data in percent of the range, over all outputs: as given, refitted, updated; of
        each output in its unit; description of the data.
    free_run, free_run_on
        The same errors of one simulation over the whole record; the records.
    model
        The updated plant; None if its free run on held-out data is worse than that of the plant as given.
    next_experiment
        Experiment that separates the rivals; None without rivals.
    posterior, search
        Sets of effects, the most probable first; every evaluated set with its log evidence.
    residual_force, missing_force, remaining_lines
        Force that the updated and the refitted nominal model lack, over speed, position, time and input; lines in it.
    structure
        ``noise_ratio``: error over noise and random force; ``explained``: share of the mean-square error removed.
    series
        Signals of held-out data for figures: ``t``, measured and simulated outputs; ``free_run``.
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
    search: tuple[tuple[tuple[str, ...], float], ...] = ()
    clocks: tuple[InputClock, ...] = ()
    free_run: Mapping[str, Gap] = field(default_factory=dict)
    free_run_on: str = ""
    findings: tuple[Finding, ...] = ()
    remaining_lines: tuple[Mapping[str, Any], ...] = ()
    next_experiment: NextExperiment | None = None
    residual_force: ResidualForce | None = None
    missing_force: ResidualForce | None = None
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
        """Return the name of ``free_run``: of a nonlinear plant one run, linear about the recorded motion."""
        return "one linear run" if LINEAR in self.free_run_on else "free run"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the ids of the named effects."""
        return tuple(e.name for e in self.effects)

    @property
    def answer(self) -> tuple[str, ...]:
        """Return the ids of the named effects and of all their rivals."""
        return tuple(dict.fromkeys([*self.names, *(r.name for r in self.rivals)]))

    def uncertain_model(self, outputs: Any = None, **options: Any) -> UncertainModel:
        """Return effects and residual force as blocks; see `robustlab.identification.missing_effects.updated_plant`."""
        from robustlab.identification.missing_effects.updated_plant import uncertain_from

        return uncertain_from(self, outputs, **options).model

    @property
    def collection(self) -> tuple[SetProbability, ...]:
        """Return the smallest collection of sets with 95 % of the probability."""
        total, found = 0.0, []
        for entry in self.posterior:
            if total >= SURE:
                break
            found.append(entry)
            total += entry.probability
        return tuple(found)

    @property
    def interrupted(self) -> bool:
        """Return whether the user stopped the search."""
        return any(f.kind == "interrupted" for f in self.findings)

    def headline(self) -> str:
        return headline_of(self)

    def numbers(self) -> dict[str, Any]:
        # An evaluated effect that is not named has confidence 0 and NaN parameters: a requirement on it is not met,
        # while a misspelt one is an error.
        effects, lower, upper, confidence = (_absent(self) for _ in range(4))
        confidence = dict.fromkeys(confidence, 0.0)
        for e in self.effects:
            # A second effect of the same id has its place in the key.
            key = e.name if e.name not in self.names[: self.effects.index(e)] else f"{e.name}@{e.site}"
            effects[key] = {p.name: p.value for p in e.parameters}
            if (amplitude := wave_amplitude(effects[key])) is not None:
                effects[key]["amplitude"] = amplitude
            lower[key] = {p.name: p.lower for p in e.parameters}
            upper[key] = {p.name: p.upper for p in e.parameters}
            confidence[key] = e.confidence
        return {
            **_kinds(self),
            "verdict": self.verdict,
            "complete": self.complete,
            "names": list(self.names),
            "places": [f"{e.name}@{e.site}" for e in self.effects],
            "answer": list(self.answer),
            "kinds": [k.kind for k in self.kinds],
            "count": len(self.effects),
            "gap_before": self.gap_before,
            "gap_refitted": self.gap_refitted,
            "gap_after": self.gap_after,
            "gap_ratio": self.gap_before / self.gap_after if self.gap_after > 0 else math.inf,
            "refitted_ratio": self.gap_refitted / self.gap_after if self.gap_after > 0 else math.inf,
            "gaps": {name: gap.to_json() for name, gap in self.gaps.items()},
            "free_run": {
                "before": overall(self.free_run, "nominal"),
                "refitted": overall(self.free_run, "refitted"),
                "after": overall(self.free_run, "updated"),
                "outputs": {name: gap.to_json() for name, gap in self.free_run.items()},
            },
            "effects": effects,
            "lower": lower,
            "upper": upper,
            "confidence": confidence,
            "nominal": {p.name: p.value for p in self.nominal},
            "next_experiment": {
                "name": self.next_experiment.name if self.next_experiment else "none",
                "separation": self.next_experiment.separation if self.next_experiment else math.nan,
            },
            "structure": dict(self.structure),
            "remaining_lines": [dict(line) for line in self.remaining_lines],
            "line": {over: _strongest_line(self, over) for over in ("position", "time")},
            "seconds": self.seconds,
        }

    def facts(self) -> Facts:
        return facts_of(self)

    def details(self) -> list[Part]:
        return details_of(self)

    def table(self) -> Table:
        """Return a row for each parameter of a named effect, with its 95 % interval."""
        rows = [(e, p) for e in self.effects for p in e.parameters]
        columns = {"effect": [e.name for e, _ in rows], "site": [e.site for e, _ in rows]}
        values = {key: [getattr(p, key) for _, p in rows] for key in ("value", "lower", "upper", "unit")}
        probability = {"probability": [e.confidence for e, _ in rows]}
        return Table(("parameter", [p.name for _, p in rows]), {**columns, **values, **probability})

    def to_json(self, series: bool = False) -> dict[str, object]:
        """Return all fields but the plant object; the time series only on request."""
        excluded = {"model", "findings"} | (set() if series else {"series"})
        data: dict[str, object] = {key: value for key, value in vars(self).items() if key not in excluded}
        data.update(names=self.names, answer=self.answer, findings=[vars(f) for f in self.findings])
        return data


def _kinds(d: Discovery) -> dict[str, dict[str, float]]:
    """Return every class with its quantities: NaN if it is not sure; of two places the more probable one."""
    found: dict[str, dict[str, float]] = {
        kind: {"probability": 0.0} | dict.fromkeys(quantities_of(kind), math.nan) for kind in KINDS
    }
    for k in sorted(d.kinds, key=lambda k: k.probability):
        values = {f"{v.name}{end}": getattr(v, part) for v in k.values for end, part in ENDS.items()}
        found[k.kind] |= {"probability": k.probability, **values}
    return found


def _strongest_line(d: Discovery, over: str) -> dict[str, float]:
    """Return period and amplitude of the strongest remaining line over a coordinate; NaN without one."""
    line = next((line for line in d.remaining_lines if line["over"] == over), None)
    return {name: math.nan if line is None else float(line[name]) for name in ("period", "amplitude")}


def _absent(d: Discovery) -> dict[str, dict[str, float]]:
    """Return every evaluated effect with NaN parameters."""
    known = catalogue()
    tried = [known[name] for name in d.candidates if name in known]
    found = {effect.id: {p.name: math.nan for p in effect.parameters(Scales())} for effect in tried}
    for values in found.values():
        if wave_amplitude(values) is not None:
            values["amplitude"] = 0.0
    return found
