"""Result of `watch`: whether the model explains the log; else since when it does not, and what it lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from robustlab.identification.naming.discovery_result import Discovery
from robustlab.result import Evidence, Status
from robustlab.shown import Facts, listed, number
from robustlab.tables import Table, Tabular


@dataclass(frozen=True)
class WatchedPiece(Evidence):
    """One piece of the log."""

    # start, stop: its time in the log, s
    start: float
    stop: float
    evidence: float  # log of E after it; the alarm comes at ``-log(false_alarm)``
    misfit: float  # root mean square of its errors under the model as learned, over the noise


@dataclass(frozen=True)
class Watch(Tabular, Evidence):
    """Result of `robustlab.identification.monitoring.watch.watch`.

    Attributes
    ----------
    status
        CONVERGED: the alarm, or its absence, holds at the stated rate. INCONCLUSIVE: no alarm, but the test could use
        less than half of the windows.
    verdict
        ``"explained"``: no alarm; ``"changed"``: an alarm.
    false_alarm
        Probability of an alarm in the whole log while the model explains it, as asked for.
    alarm
        Time of the alarm in the log in s, the end of its piece; NaN without one.
    since, since_lower, since_upper
        When the change began to show, s, and a 95 % interval for its beginning: beginnings of pieces.
    found
        What the plant without its effects lacks in the pieces since the change (`discover`): compare it with the
        effects and parameters of the model. None without an alarm, and where those pieces are too poor.
    pieces
        The pieces in their order.
    noise
        Output -> standard deviation of its noise in one sample, as stated.
    plant, window
        The model; the length of the windows in s.
    tested
        Share of the windows that the test used, 0..1; in the others the model is not linear in what the first piece
        leaves open of its parameters (a contact about to break away).
    """

    status: Status
    verdict: Literal["explained", "changed"]
    false_alarm: float
    alarm: float
    since: float
    since_lower: float
    since_upper: float
    found: Discovery | None
    pieces: tuple[WatchedPiece, ...]
    noise: Mapping[str, float]
    plant: str
    window: float
    tested: float

    quantities: ClassVar[Mapping[str, Any]] = {
        "verdict": str,
        "met": bool,
        **dict.fromkeys(("alarm", "since", "since_lower", "since_upper", "window"), "s"),
        "evidence": "1",
        "tested": "1",
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
        lacks = f": {self.found.headline()}" if self.found is not None else ""
        return f"{self.plant} no longer explains the log {since}{lacks}"

    def facts(self) -> Facts:
        """The verdict, the alarm, what the plant lacks since, and the noise of the test."""
        return [
            ("verdict", self.verdict),
            ("", self.headline()),
            ("alarm", "" if self.met else f"at {span_of(self.alarm)}"),
            ("largest log E", f"{self.evidence:.2f}"),
            ("false alarms", f"in at most {number(100.0 * self.false_alarm)} % of logs that the model explains"),
            ("noise", f"{listed(f'{name} {number(std)}' for name, std in self.noise.items())} a sample"),
            ("windows", f"{number(self.window, 's')}, {100.0 * self.tested:.0f} % of them tested"),
            *(self.found.facts() if self.found is not None else []),
        ]

    def table(self) -> Table:
        """A row for each piece."""
        names = ("stop", "evidence", "misfit")
        return Table(
            ("start", [p.start for p in self.pieces]), {n: [getattr(p, n) for p in self.pieces] for n in names}
        )


def span_of(seconds: float) -> str:
    """A time of a log: ``38.5 s``, ``41.2 min``, ``3.1 h``."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if abs(seconds) >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.4g} s"
