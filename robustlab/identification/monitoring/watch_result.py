"""What `watch` answers: whether the model went on explaining the log; else what changed, since when and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from robustlab.identification.naming.named_effects import EffectValue, KindMember
from robustlab.result import Evidence, Status
from robustlab.shown import Facts, Part, listed, number
from robustlab.tables import Table, Tabular

Verdict = Literal["explained", "named", "ambiguous", "unknown"]


@dataclass(frozen=True)
class WatchedPiece(Evidence):
    """One piece of the log.

    Attributes
    ----------
    start, stop
        Its time in the log, s.
    evidence
        Log of E after it; the alarm comes at ``-log(false_alarm)``.
    misfit
        Root mean square of its errors under the model as learned, over the noise.
    value, lower, upper
        What changed as it was in this piece, with its 95 % interval; NaN without an alarm.
    """

    start: float
    stop: float
    evidence: float
    misfit: float
    value: float = math.nan
    lower: float = math.nan
    upper: float = math.nan


@dataclass(frozen=True)
class Growth(Evidence):
    """What changed.

    Attributes
    ----------
    kind, title, place
        The narrowest kind that is sure, in the tree of kinds; in words; where.
    members
        The changes that it may be, with their shares, the most probable first. Where no kind is sure they are of
        several, and ``kind`` is empty.
    effect
        Id of the most probable one in the catalogue; empty of a parameter without a role.
    before, now
        Its parameter before the change and in the last piece; ``before`` is None of an effect that came in.
    growing
        Probability that it grew from piece to piece, against all at once.
    explained
        Share of what the learned model lacks that it explains, 0..1.
    complete
        False where more than noise remains beside it.
    """

    kind: str
    title: str
    place: str
    members: tuple[KindMember, ...]
    effect: str
    before: EffectValue | None
    now: EffectValue
    growing: float
    explained: float
    complete: bool

    quantities: ClassVar[Mapping[str, Any]] = {
        "kind": str,
        "effect": str,
        "growing": "1",
        "explained": "1",
        "complete": bool,
    }

    @property
    def ratio(self) -> EffectValue | None:
        """Parameter now over before, with its 95 % interval; None of an effect that came in."""
        if self.before is None or not self.before.value:
            return None
        ratio = self.now.value / self.before.value
        spread = math.hypot(*((v.upper - v.lower) / 2.0 / v.value for v in (self.now, self.before) if v.value))
        low, high = ratio * (1.0 - spread), ratio * (1.0 + spread)
        return EffectValue("ratio", ratio, "1", min(low, high), max(low, high), "parameter now over before")

    @property
    def words(self) -> str:
        """``dry friction at w: Fc up 30 % (25 .. 36 %) to 0.026 N m``."""
        what = f"{self.title} at {self.place}" if self.kind else "several kinds are possible"
        now = f"{self.now.name} {number(self.now.value, self.now.unit)}"
        span = f"({number(self.now.lower)} .. {number(self.now.upper)})"
        ratio = self.ratio
        if ratio is None:
            return f"{what}: came in with {now} {span}"
        sign = 1.0 if ratio.value >= 1.0 else -1.0
        low, middle, high = sorted(sign * 100.0 * (x - 1.0) for x in (ratio.lower, ratio.value, ratio.upper))
        word = "up" if sign > 0 else "down"
        share = f"{number(middle, digits=3)} % ({number(low, digits=3)} .. {number(high, digits=3)} %)"
        return f"{what}: {self.now.name} {word} {share} to {number(self.now.value, self.now.unit)}"


@dataclass(frozen=True)
class Watch(Tabular, Evidence):
    """Result of `robustlab.identification.monitoring.watch.watch`.

    Attributes
    ----------
    status
        CONVERGED: the alarm, or its absence, holds at the stated rate, whether the change has a name or not.
        INCONCLUSIVE: no alarm, but the test could use less than half of the windows.
    verdict
        ``"explained"``: no alarm; ``"named"``: an alarm, and the kind of the change has 95 %; ``"ambiguous"``: several
        kinds; ``"unknown"``: nothing in the catalogue explains it.
    false_alarm
        Probability of an alarm in the whole log while the model explains it, as asked for.
    alarm
        Time of the alarm in the log in s, the end of its piece; NaN without one.
    since, since_lower, since_upper
        When the change began to show, s, and a 95 % interval for its beginning: beginnings of pieces.
    growth
        What changed; None without an alarm and where it is unknown.
    pieces
        The pieces in their order.
    noise
        Output -> standard deviation of its noise in one sample that the test took.
    noise_stated
        Whether it was given; else it is that of the first piece.
    plant, window
        The model; the length of the windows in s.
    tested
        Share of the windows that the test used, 0..1; in the others the model is not linear in what the first piece
        leaves open of its parameters (a contact about to break away).
    """

    status: Status
    verdict: Verdict
    false_alarm: float
    alarm: float
    since: float
    since_lower: float
    since_upper: float
    growth: Growth | None
    pieces: tuple[WatchedPiece, ...]
    noise: Mapping[str, float]
    noise_stated: bool
    plant: str
    window: float
    tested: float

    quantities: ClassVar[Mapping[str, Any]] = {
        "verdict": str,
        "met": bool,
        **dict.fromkeys(("alarm", "since", "since_lower", "since_upper", "window"), "s"),
        "evidence": "1",
        "tested": "1",
        "growth": Growth,
        "ratio": EffectValue,
    }

    @property
    def met(self) -> bool:
        """Whether the model explains the log from beginning to end."""
        return self.verdict == "explained"

    @property
    def evidence(self) -> float:
        """Largest log of E so far: E is at least 1 / x with probability x at most while the model explains the log."""
        return max(p.evidence for p in self.pieces)

    def headline(self) -> str:
        """What was found, in one sentence."""
        if self.met:
            return f"{self.plant} explains all of the log, {len(self.pieces)} pieces"
        since = f"since {span_of(self.since)} ({span_of(self.since_lower)} .. {span_of(self.since_upper)})"
        if not self.since > self.pieces[0].start:
            return f"{self.plant} never explained the log: `robustlab data discover` names what it lacks"
        if self.growth is None:
            return f"{self.plant} no longer explains the log {since}: nothing in the catalogue does"
        return f"{self.plant} no longer explains the log: {self.growth.words} {since}"

    def facts(self) -> Facts:
        """The verdict, the alarm, what changed, and what the test took for noise."""
        g, told = self.growth, "as stated" if self.noise_stated else "as the first piece has it"
        rows = [
            ("verdict", self.verdict if g is None or g.complete else f"{self.verdict}, incomplete: more remains"),
            ("", self.headline()),
            ("alarm", "" if self.met else f"at {span_of(self.alarm)}, E = {_large(self.evidence)}"),
            ("largest E", _large(self.evidence) if self.met else ""),
            ("false alarms", f"in at most {number(100.0 * self.false_alarm)} % of logs that the model explains"),
        ]
        if g is not None:
            shares = (f"{m.title} at {m.site} {100.0 * m.share:.0f} %" for m in g.members if m.share >= 0.005)
            rows += [
                ("may be", listed(shares)),
                ("course", f"growing {100.0 * g.growing:.0f} %, at once {100.0 * (1.0 - g.growing):.0f} %"),
                ("explains", f"{100.0 * g.explained:.1f} % of what the model as learned lacks"),
            ]
        rows += [
            ("noise", f"{listed(f'{name} {number(std)}' for name, std in self.noise.items())} a sample, {told}"),
            ("windows", f"{number(self.window, 's')}, {100.0 * self.tested:.0f} % of them tested"),
        ]
        return rows

    def details(self) -> list[Part]:
        """The pieces with the value of what changed."""
        g = self.growth
        name = "" if g is None else f"{g.now.name} [{g.now.unit}]"
        header = ("piece", "from", "to", "log E", "misfit", *([name, "95 %"] if g else []))
        rows = []
        for k, p in enumerate(self.pieces, 1):
            value = [number(p.value), f"{number(p.lower)} .. {number(p.upper)}"] if g else []
            plain = (str(k), span_of(p.start), span_of(p.stop), f"{p.evidence:.2f}", f"{p.misfit:.3f}")
            rows.append((*plain, *value))
        return [Part("pieces", header, rows)]

    def table(self) -> Table:
        """A row for each piece."""
        names = ("stop", "evidence", "misfit", "value", "lower", "upper")
        return Table(
            ("start", [p.start for p in self.pieces]), {n: [getattr(p, n) for p in self.pieces] for n in names}
        )

    @property
    def ratio(self) -> EffectValue | None:
        """Parameter that changed, now over before; None without."""
        return None if self.growth is None else self.growth.ratio


def span_of(seconds: float) -> str:
    """A time of a log: ``38.5 s``, ``41.2 min``, ``3.1 h``."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if abs(seconds) >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.4g} s"


def _large(log: float) -> str:
    """E to the power of ``log`` as a power of ten where it is large."""
    return f"{math.exp(log):.3g}" if log < 14.0 else f"1e{log / math.log(10.0):.0f}"
