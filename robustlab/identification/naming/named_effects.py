"""What a discovery consists of: values with intervals, named effects and rivals, gaps, sets with probabilities."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from robustlab.result import Evidence

INTERVAL = 1.96  # standard deviations of a 95 % interval
SURE = 0.95  # probability of what is named
WAVES = (("Ac", "As"), ("Pc", "Ps"), ("c", "s"))  # cosine and sine part of what is periodic in the position


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
    """One refitted nominal parameter with its 95 % interval, and the tolerance it was given (0: held fixed)."""

    # assumed: the plant states no tolerance; beyond: the value left it. Absolute where the nominal value is 0.

    name: str
    nominal: float
    value: float
    unit: str
    lower: float
    upper: float
    tolerance: float
    assumed: bool
    beyond: bool = False


@dataclass(frozen=True)
class Rival(Evidence):
    """An effect that these records cannot separate from a named one."""

    # name, title, site: the rival
    name: str
    title: str
    site: str
    # id of the named effect whose place it could take; "none" where nothing was named, but this effect is about as
    # probable as none: the tolerances of other parameters may hide it
    instead_of: str
    # refit distance d in standard deviations of the noise: how far the rival's best fit stays from what the named
    # effect predicts for these very records. d < 3 cannot be told apart. Of a rival of "none" it is how far the bare
    # model stays from what the rival predicts.
    distance: float
    evidence: float  # log evidence relative to the named effect (negative: behind)
    probability: float  # of the most probable set that has it in that place
    parameters: tuple[EffectValue, ...]  # as it was fitted


@dataclass(frozen=True)
class NamedEffect(Evidence):
    """One effect that the records show."""

    name: str  # id in the catalogue
    # title, equation, site: in words; as a formula; where it sits
    title: str
    equation: str
    site: str
    parameters: tuple[EffectValue, ...]  # fitted values with intervals
    confidence: float  # its probability: that of all sets of effects that contain it, 0..1
    evidence: float  # log evidence over the model without it
    rivals: tuple[str, ...]  # ids that these records cannot separate from it; empty where the name is unique
    # windowed error on held-out data in percent of the range with all names but this one, refitted; NaN if not known
    error_without: float = math.nan


@dataclass(frozen=True)
class KindMember(Evidence):
    """An effect that a kind may be: id, title, site, and its share of the kind's probability, 0..1."""

    name: str
    title: str
    site: str
    share: float


@dataclass(frozen=True)
class NamedKind(Evidence):
    """What the records are sure of at one place."""

    # kind, title, place: id in the tree of kinds (`robustlab.dynamics.effects.kinds`), in words, and where
    kind: str
    title: str
    place: str
    probability: float  # of all sets that have a member of it there, 0..1
    values: tuple[EffectValue, ...]  # what every member can be asked for, with 95 % intervals over all members
    members: tuple[KindMember, ...]  # the effects that it may be, the most probable first
    form: str  # how to tell the members apart, as an instruction
    # whether more than noise is left beside it: that may be what its best form differs from the true one by
    misfit: bool = False

    quantities: ClassVar[Mapping[str, Any]] = {"probability": "1"}

    @property
    def words(self) -> str:
        """What and where: ``dry friction at omega``, ``a lateness from u to q``."""
        return f"{self.title} {'from' if ' to ' in self.place else 'at'} {self.place}"

    @property
    def settled(self) -> bool:
        """Whether one member alone has 95 % of it, and nothing is left that another could be told by."""
        return [m.share >= SURE for m in self.members if m.share > 1.0 - SURE] == [True] and not self.misfit

    @property
    def open_form(self) -> str:
        """Why the form is not told: several members at once, a misfit beside it, or records that do not settle it."""
        if sum(m.share >= SURE for m in self.members) > 1:
            return "more than one at once"
        return "not settled beside what remains" if self.misfit else "not settled"


def wave_amplitude(values: Mapping[str, float]) -> float | None:
    """Amplitude of an effect that is periodic, from its cosine and sine part; None of any other."""
    pair = next(((c, s) for c, s in WAVES if c in values and s in values), None)
    return math.hypot(values[pair[0]], values[pair[1]]) if pair else None


@dataclass(frozen=True)
class Gap(Evidence):
    """Simulation error (RMS) of one output: in windows, or in one run from the record's start."""

    # output, unit, range: the output, its unit, its measured range on that data
    output: str
    unit: str
    range: float
    # nominal, refitted, updated: RMS of these models; infinite where the simulation diverges
    nominal: float
    refitted: float
    updated: float

    quantities: ClassVar[Mapping[str, Any]] = dict.fromkeys(("range", "nominal", "refitted", "updated"), "*")


def overall(gaps: Mapping[str, Gap], model: str) -> float:
    """RMS over the outputs of the error of ``nominal``, ``refitted`` or ``updated`` in percent of the range."""
    shares = [getattr(g, model) / (g.range or 1.0) for g in gaps.values()]
    return 100.0 * math.sqrt(sum(share**2 for share in shares) / len(shares)) if shares else math.nan


@dataclass(frozen=True)
class SetProbability(Evidence):
    """A set of effects and how probable it is among all that the search visited."""

    effects: tuple[str, ...]  # its effects with their places, ``"coulomb-friction@omega"``; empty: nothing is missing
    names: tuple[str, ...]  # their ids in the catalogue
    probability: float  # of this set, 0..1; over all visited sets it sums to one
    evidence: float  # log evidence, prior of the set included, relative to the most probable one
    # refit distance from the most probable set in standard deviations of the noise (3 tell); NaN where not asked
    distance: float = math.nan
    unnamed: str = ""  # the unnamed force that belongs to it (``"force over speed"``), empty where none does


@dataclass(frozen=True)
class InputClock(Evidence):
    """What an input does between its samples, and by how much its clock is late against the outputs', in s."""

    input: str
    hold: Literal["held", "linear", "smooth"]
    shift: float
    std: float


@dataclass(frozen=True)
class SearchEntry(Evidence):
    """One set that the search visited, in its order: effects with places, log evidence, what became of it."""

    effects: tuple[str, ...]
    evidence: float
    decision: str
