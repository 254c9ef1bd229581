r"""The smallest disk margin of an uncertain loop: a skewed mu problem.

.. math:: \alpha_{wc} = \max \{ \alpha : \text{stable for all } \|\Delta\| \le 1 \text{ and all } |\delta_i| < \alpha
   \text{ in the loops} \}

With the disks' channels scaled by :math:`\alpha`, m times the whole set is just destabilising. Where :math:`m \ge 1`
the loop is stable for :math:`\|\Delta\| \le 1` and disks of :math:`m \alpha`; where :math:`m \le 1` it is not stable
for some :math:`\|\Delta\| \le m` and disks of :math:`m \alpha`. Either way one bound moves to :math:`m \alpha`.

References
----------
Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020); Fan, Tits, "A
measure of worst-case H-infinity performance and of largest acceptable uncertainty", Systems and Control Letters 18
(1992), for the iteration.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from robustlab.budget import Budget, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, told_as
from robustlab.mu_analysis.axis.axis_model import continuous, seed_frequencies
from robustlab.mu_analysis.axis.axis_problems import SkewedProblem
from robustlab.mu_analysis.axis.margin import Margin, delta_rows
from robustlab.mu_analysis.axis.pole_migration import search_work
from robustlab.mu_analysis.axis.stability import margin_within
from robustlab.mu_analysis.axis.worst_gain import skewed_cover
from robustlab.mu_analysis.constants import WORK
from robustlab.mu_analysis.margins.disk_margin import (
    DiskBounds,
    DiskMargin,
    DiskMargins,
    Place,
    closed_around,
    disk_channels,
    disk_margin_of,
    gain_and_phase,
)
from robustlab.mu_analysis.matrix.box import widest
from robustlab.mu_analysis.matrix.branch_and_bound import tighten
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.result import Status
from robustlab.shown import Facts, Part, bracket, member
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import Block, ComplexScalar
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import perturbed_model, realise_delta

ALONE = 0.2  # share of the work for the question whether a member is unstable without any disk
MARGIN_ACCURACY = 2e-4  # of the scaled set's margin: it changes less than the size of the disks does
ON_THE_AXIS = 1e-9  # a pole this close to the stability boundary, beside the fastest, is not stable
MARGINS = 25  # after which a search ends whose bounds no longer move

__all__ = ["WorstCaseDiskMargin", "worst_case_disk_margin"]


@dataclass(frozen=True, eq=False)
class WorstCaseDiskMargin(DiskMargins):
    """The smallest disk margin over an uncertain set, with the attributes of `DiskMargins` for every member.

    Attributes
    ----------
    lower, upper
        Every member of the set tolerates disks of ``lower``; the member at ``delta`` has the disk margin ``upper``.
    delta
        The worst member found, one value per block of the uncertain model, ``|delta| <= 1``.
    physical
        Its parameters in their own units.
    member
        Disk margin of that member, with its critical perturbation; None where the member's loop is unstable.
    nominal
        Disk margin of the nominal loop.
    status
        CERTIFIED where ``lower`` is proved and positive, or where an unstable member was found; TIMEOUT where the
        time limit ended the search before the bounds met; INCONCLUSIVE where nothing could be proved.
    channels
        The one loop that was asked for, or the only one; empty where all of several are changed at once.
    """

    kind: ClassVar[str] = "worst-case disk margin"

    physical: Mapping[str, tuple[float, str]]
    member: DiskMargin | None
    nominal: DiskMargin

    def facts(self) -> Facts:
        first, *rest = super().facts()
        nominal = bracket(self.nominal.lower, self.nominal.upper, ("proved", "attained"))
        return [first, ("nominal disk margin", nominal), ("worst member", member(self.delta, self.physical)), *rest]

    def details(self) -> list[Part]:
        rows = delta_rows(self.delta, self.physical)
        return [*super().details(), Part("worst member found:", ("block", "delta", "parameter"), rows)]


@told_as("worst_case_disk_margin")
def worst_case_disk_margin(
    uncertain: UncertainModel,
    K: Any = None,
    *,
    at: Place = "output",
    channel: str | None = None,
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    accuracy: float = 0.005,
    time_limit: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
) -> WorstCaseDiskMargin:
    """Of an uncertain plant, the worst over its set: `robustlab.disk_margin`."""
    if not isinstance(uncertain, UncertainModel):
        raise InputError("worst_case_disk_margin", type(uncertain).__name__, "an UncertainModel")
    if not 0 < accuracy < 1:
        raise InputError("worst_case_disk_margin", f"accuracy {accuracy}", "0 < accuracy < 1")
    compile_kernels()
    budget = search_budget("worst_case_disk_margin", WORK, effort, time_limit)
    with one_thread():
        search = _Search(uncertain, K, at, channel, skew, sign, budget, seed)
        search.run(accuracy)
        return search.result(accuracy)


class _Search:
    """Bounds of the worst-case disk margin, moved by one robust stability margin after the other."""

    def __init__(
        self,
        uncertain: UncertainModel,
        K: Any,
        at: Place,
        channel: str | None,
        skew: float,
        sign: Literal[-1, 1] | None,
        budget: Budget,
        seed: int,
    ) -> None:
        closed = closed_around(uncertain, K, sign, "worst_case_disk_margin")
        uncertain, self.said = closed.plant, closed.said
        self.at: Place = at
        self.blocks, self.skew, self.budget, self.seed = uncertain.blocks, skew, budget, seed
        self.uncertain = uncertain
        loop, self.names = disk_channels(uncertain.M, closed.K, uncertain.delta_shape, at, skew, closed.sign)
        q, p = uncertain.delta_shape
        if channel is not None:
            if channel not in self.names:
                hint = did_you_mean(channel, self.names)
                raise InputError("worst_case_disk_margin", f"channel {channel!r}", f"one of {self.names}", hint)
            i = self.names.index(channel)
            loop = loop.select(
                [*loop.input_names[:q], loop.input_names[q + i]], [*loop.output_names[:p], loop.output_names[p + i]]
            )
            self.names = (channel,)
        self.loop = UncertainModel(loop, self.blocks)
        self.nominal = disk_margin_of(self.loop.nominal, self.names, skew, budget, seed)
        self.lower, self.upper = 0.0, self.nominal.upper
        self.member: DiskMargin | None = self.nominal
        self.delta: Mapping[str, Any] = {b.name: b.zero for b in self.blocks}
        self.asked: list[tuple[float, float]] = []  # sizes of the disks, and the margins proved for them

    def run(self, accuracy: float) -> None:
        """Move the bounds until they meet, the budget is over, or nothing moves any more."""
        if not self.blocks:
            self.lower = self.nominal.lower
            return
        alone = margin_within(
            UncertainModel(self.loop.delta_channels, self.blocks), self.budget.share(ALONE), seed=self.seed
        )
        if alone.upper <= 1:  # a member on the stability boundary, if not beyond
            self._take(alone, alone.delta)
            if self.member is not None:
                self.lower, self.upper, self.member, self.delta = 0.0, 0.0, None, alone.delta
            return
        # The set alone leaves no more than this to what D, G may miss.
        self._from_below(accuracy, min(accuracy / 4, max(0.5 * (alone.lower - 1), 1e-9)))
        while self.upper > self.lower * (1 + accuracy) and not self.budget.over:
            before = self.lower, self.upper
            self._step(self._next(accuracy))
            if len(self.asked) >= MARGINS or (before == (self.lower, self.upper) and self._closed_in(accuracy)):
                return

    def _from_below(self, accuracy: float, room: float) -> None:
        """One proof by D, G with the set as it is and disks as large as may be; then a member next to that size."""
        m, blocks = continuous(self.loop.M), (*self.blocks, *self._disks())
        varying = np.arange(m.n_inputs) >= self.loop.delta_shape[0]
        first = np.unique(np.concatenate([[0.0, np.inf], seed_frequencies(m)]))
        around = widest(blocks)  # of ranges that are wider on one side, the smallest set around them that is not
        set_around = StateSpaceModel(m.A, m.B * around, m.C, m.D * around)
        _, level = skewed_cover(
            set_around, blocks, 1 / self.upper, varying, first=first, budget=self.budget, accuracy=room
        )
        self._proved(level)
        if self.upper <= self.lower * (1 + accuracy):
            return
        if self.lower:
            self._step(self.lower * (1 + accuracy / 2))
        while self.lower * (1 + accuracy) < self.upper < np.inf and not self.budget.over:
            before = self.upper
            self._step(self.upper / (1 + accuracy / 2))
            if self.upper > 0.5 * before:
                break
        if self.lower * (1 + accuracy) < self.upper < np.inf and any(b.interval for b in self.blocks):
            sought = np.array([block in blocks[len(self.blocks) :] for block in blocks])
            problem = SkewedProblem(m, blocks, sought, None)
            part = self.budget.share(ALONE)
            self._proved(tighten(problem, 1 / self.upper, level, accuracy, part).upper)

    def _proved(self, level: float) -> None:
        """Disks of size ``1 / level`` leave every member's loop stable."""
        if np.isfinite(level):
            self.lower = min(max(self.lower, 1 / level), self.upper)
            self.asked.append((self.lower, 1.0))

    def _disks(self) -> list[Block]:
        return [ComplexScalar(f"disk: {name}") for name in self.names]

    def _next(self, accuracy: float) -> float:
        """Size of the disks to ask for next: a little below the one at which the proved margin would be 1."""
        top = min(self.upper, 1e3)
        failed = min((point for point in self.asked if point[1] < 1), default=None)
        proved = max((point for point in self.asked if point[1] >= 1), default=None)
        if failed is None:
            return top / (1 + accuracy / 2)
        if proved is None:
            return 0.5 * failed[0] * failed[1]
        # The margin falls with the size, nearly by a power law.
        (low, high_margin), (high, low_margin) = proved, failed
        slope = np.log(high_margin / low_margin) / np.log(high / low) if high > low * (1 + 1e-9) else 1.0
        crossing = low * high_margin ** (1 / max(float(slope), 0.05))
        return float(np.clip(crossing, low**0.9 * high**0.1, high / (1 + accuracy / 10)))

    def _closed_in(self, accuracy: float) -> bool:
        """Whether the sizes that were proved and those that were not already meet."""
        failed = min((alpha for alpha, margin in self.asked if margin < 1), default=np.inf)
        return bool(self.lower * (1 + accuracy / 4) >= failed)

    def _step(self, alpha: float) -> None:
        """One margin; where it is above 1 it moves the lower bound, where it is below 1 the upper one."""
        margin = self._margin(alpha)
        self.asked.append((alpha, margin.lower))
        if margin.lower >= 1:
            self.lower = max(self.lower, min(margin.lower * alpha, self.upper))
        if margin.upper <= 1:
            self._take(margin, {b.name: margin.delta[b.name] for b in self.blocks})

    def _margin(self, alpha: float) -> Margin:
        """Margin of the set with disks of size ``alpha``."""
        m, q = self.loop.M, self.loop.delta_shape[0]
        scale = np.ones(m.n_inputs)
        scale[q:] = alpha
        scaled = StateSpaceModel(m.A, m.B * scale, m.C, m.D * scale, m.dt)
        loop = UncertainModel(scaled, [*self.blocks, *self._disks()])
        self.budget.spend(search_work(m.n_states, loop.blocks))
        return margin_within(loop, self.budget, accuracy=MARGIN_ACCURACY, seed=self.seed)

    def _take(self, margin: Margin, found: Mapping[str, Any]) -> None:
        """Take the member at ``found``, and at the ends of the set in its direction, as candidates for the worst."""
        for delta in _towards_the_edge(self.blocks, found):
            member = self._member(margin, delta)
            if member is None:  # its loop is unstable
                self.lower, self.upper, self.member, self.delta = 0.0, 0.0, None, delta
                return
            if member.upper < self.upper:
                self.upper, self.member, self.delta = member.upper, member, delta

    def _member(self, margin: Margin, delta: Mapping[str, Any]) -> DiskMargin | None:
        """Disk margin of the member at ``delta``; None where its loop is unstable or ill-posed."""
        try:
            made = realise_delta(self.blocks, delta, margin.frequency or 0.0, self.uncertain.dt)
        except InputError:  # complex values at an end of the axis: not a member with real coefficients
            return self.member or self.nominal
        try:
            model = perturbed_model(self.loop, made)
        except NoTrustworthyNumber:  # ill-posed
            return None
        if len(self.names) > 1:
            self.budget.spend(search_work(model.n_states, [ComplexScalar(name) for name in self.names]))
        try:
            return disk_margin_of(model, self.names, self.skew, self.budget, self.seed)
        except NoTrustworthyNumber:
            speed = float(np.abs(model.poles()).max(initial=0.0))
            if model.spectral_abscissa() > -ON_THE_AXIS * speed:
                return None
            return self.member or self.nominal  # stable, only without a number: no candidate

    def result(self, accuracy: float) -> WorstCaseDiskMargin:
        """The bounds as a result."""
        if self.lower > self.upper * (1 + 1e-4):
            text = f"a member has the margin {self.upper:.9g} below the proved {self.lower:.9g}: digits were lost"
            raise NoTrustworthyNumber("worst_case_disk_margin", text)
        self.lower = min(self.lower, self.upper)
        met = self.upper <= self.lower * (1 + accuracy) or self.upper == 0
        notes: list[str] = []
        if self.upper == 0:
            notes.append("a member of the set has a loop that is not stable")
        elif not met:
            apart = (
                f"the bounds differ by {100 * (self.upper / self.lower - 1):.3g} %" if self.lower else "nothing proved"
            )
            notes.append(apart)
        if not met and self.budget.remark:
            notes.append(self.budget.remark)
        if met:
            status = Status.CERTIFIED
        elif self.budget.struck:
            status = Status.TIMEOUT
        else:
            status = Status.CERTIFIED if self.lower > 0 else Status.INCONCLUSIVE
        notes += [*self.uncertain.impossible(self.delta), *self.uncertain.remarks]
        low, high, phase = gain_and_phase(float(self.lower), self.skew)
        physical = self.uncertain.physical(self.delta)
        frequency = None if self.member is None else self.member.frequency
        every = DiskBounds(
            float(self.lower), float(self.upper), frequency, status, (low, high), phase, self.skew, dict(self.delta),
            tuple(notes),
        )  # fmt: skip
        channels = {self.names[0]: every} if len(self.names) == 1 else {}
        evidence = {"physical": physical, "member": self.member, "nominal": self.nominal}
        return WorstCaseDiskMargin.of(every, channels, self.at, self.said, **evidence)


def _size(value: Any) -> float:
    array = np.asarray(value)
    return float(np.linalg.norm(array, 2) if array.ndim == 2 else abs(array.reshape(()).item()))


def _towards_the_edge(blocks: tuple[Block, ...], found: Mapping[str, Any]) -> Iterator[dict[str, NDArray[Any] | Any]]:
    """The Delta as found, and with every block (every real one) at the edge of the set."""
    yield dict(found)
    sizes = {name: _size(value) for name, value in found.items()}
    yield {name: value / sizes[name] if sizes[name] > 0.5 else value for name, value in found.items()}
    real = {b.name for b in blocks if b.interval}
    if len(real) < len(blocks):
        yield {n: v / sizes[n] if n not in real and sizes[n] > 0.5 else v for n, v in found.items()}
