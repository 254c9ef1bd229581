"""`watch`: detect when a model stops explaining a running log, with a bounded rate of false alarms (docs/watch.md).

The sequential test is an e-process: E mixes the likelihood ratios of all changes from each piece on, with the
parameters integrated out; by Ville's inequality it reaches 1 / alpha with probability alpha at most while the model is
valid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from robustlab import checks
from robustlab.arrays import Array, Mask
from robustlab.budget import one_thread
from robustlab.display import Facts, listed, number
from robustlab.dynamics.effects.catalogue import effect
from robustlab.dynamics.effects.effect import Scales
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_plant import ExtendedPlant
from robustlab.dynamics.ports.port_model import AnyPlant
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.identification import constants
from robustlab.identification.data_checks.resampling import clock_step, uniform
from robustlab.identification.greybox.candidates import candidates, nuisance_parameters, stated_tolerances
from robustlab.identification.greybox.effect_fit import Candidate, Clock, Fit, FitPlan, Hypothesis, NoiseModel, Problem
from robustlab.identification.greybox.prepared_record import PreparedRecord, ports_of, prepare, window_length
from robustlab.identification.missing_effects.discovery import discover, known_plant
from robustlab.identification.missing_effects.discovery_result import Discovery
from robustlab.identification.missing_effects.effect_search import clock_nuisances, held_inputs
from robustlab.identification.response.response import with_units
from robustlab.record import Record
from robustlab.result import Evidence, Status, Table, Tabular

FAR = 2.0  # standard deviations of the parameters after the first piece, within which a window must be linear
CLEAR = 10.0  # log evidence beyond an alarm, at which the onset is estimated; a later change may not be linear
MOST_DISCOVERED = 8  # pieces at the end for `discover`
MOST_BENT = 1.0  # square of the change of a window's residuals, over the noise of one point
STEPS = 4  # per sample
SLOW = 6  # cosines in a window, for errors that are not a parameter
OWN_SPREAD = 0.3  # relative: prior of a model's effect before its first piece, if not given
DIFFUSE = 1e-4  # precision of the standardised parameters: 100 times their tolerances is practically flat
SIZES = (0.05, 0.5)  # of a change to be detected, over its usual size
GROWING = 5.0  # pieces in which a growing change reaches the size of an abrupt one
SCATTERS = (1.0, 100.0)  # variance of random errors, over the noise; below one half it would test the noise itself
UNNAMED = 0.5  # share of the alternatives that are not a parameter
NEGLIGIBLE = 1e-9  # of a column's own square: rounding


@dataclass(frozen=True)
class WatchedPiece(Evidence):
    """One piece of the log."""

    start: float  # its time in the log, s
    stop: float
    evidence: float  # log of E after it; an alarm from ``-log(false_alarm)`` on
    misfit: float  # root mean square of its errors with the learned model, over the noise


@dataclass(frozen=True)
class Watch(Tabular, Evidence):
    """Result of `watch`."""

    # CONVERGED: the alarm, or its absence, is valid at the stated rate. INCONCLUSIVE: no alarm, but the test could use
    # less than half of the windows.
    status: Status
    verdict: Literal["explained", "changed"]  # no alarm, an alarm
    false_alarm: float  # requested probability of an alarm in the whole log while the model explains it
    alarm: float  # time in the log in s, the end of its piece; NaN without one
    # estimated onset of the change, s, and its 95 % interval: beginnings of pieces
    since: float
    since_lower: float
    since_upper: float
    # Effects that the plant without its own lacks in the pieces since the change: compare them with the effects and
    # parameters of the model. None without an alarm, and if those pieces are too poor.
    found: Discovery | None
    pieces: tuple[WatchedPiece, ...]
    noise: Mapping[str, float]  # output -> standard deviation of its noise in one sample, as stated
    plant: str  # the model
    window: float  # length of the windows, s
    # Share of the windows that the test used; in the others the model is not linear within the uncertainty of its
    # parameters after the first piece (a contact about to break away).
    tested: float

    quantities: ClassVar[Mapping[str, Any]] = {
        "verdict": str,
        "met": bool,
        **dict.fromkeys(("alarm", "since", "since_lower", "since_upper", "window"), "s"),
        **dict.fromkeys(("evidence", "tested"), "1"),
    }

    @property
    def met(self) -> bool:
        return self.verdict == "explained"

    @property
    def evidence(self) -> float:
        """Largest log E: E is at least 1 / x with probability x at most while the model explains the log."""
        return max(p.evidence for p in self.pieces)

    def headline(self) -> str:
        if self.met:
            return f"{self.plant} explains all of the log, {len(self.pieces)} pieces"
        since = f"since {span_of(self.since)} ({span_of(self.since_lower)} .. {span_of(self.since_upper)})"
        if not self.since > self.pieces[0].start:
            return f"{self.plant} never explained the log: `robustlab data discover` names what it lacks"
        lacks = f": {self.found.headline()}" if self.found is not None else ""
        return f"{self.plant} no longer explains the log {since}{lacks}"

    def facts(self) -> Facts:
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
        columns = {name: [getattr(p, name) for p in self.pieces] for name in ("stop", "evidence", "misfit")}
        return Table(("start", [p.start for p in self.pieces]), columns)


def span_of(seconds: float) -> str:
    """Format a time of a log: ``38.5 s``, ``41.2 min``, ``3.1 h``."""
    unit, size = ("h", 3600.0) if abs(seconds) >= 7200.0 else ("min", 60.0)
    return f"{seconds / size:.1f} {unit}" if abs(seconds) >= 120.0 else f"{seconds:.4g} s"


@one_thread()
@error_context("watch")
def watch(
    model: Any,
    records: Record | Iterable[Record],
    *,
    every: float | None = None,
    noise: Mapping[str, float],
    false_alarm: float = 0.01,
    exclude: Sequence[str] = (),
    progress: Callable[[str], None] | None = None,
) -> Watch:
    r"""Detect when a model stops explaining a running log, and report what it lacks since then.

    While the model explains the log, :math:`P(\exists t: E_t \ge 1/\alpha) \le \alpha` for the test's E (Ville's
    inequality), for any length of the log and at any time.

    ASSUMPTIONS: the sensors' noise is white and Gaussian of the standard deviation ``noise``; the parameters are
    constant, and the model is linear within their uncertainty after the first piece (windows in which it is not are
    excluded). A drift of the state that is slower than a window is no change.

    Parameters
    ----------
    model
        A plant, also with effects (what `discover` updated), or a continuous model as `discover` takes it.
    records
        The log in pieces, in their order, or one record; an iterator yields the next piece after the last one has
        been evaluated. All have the sample time and the outputs of the first.
    every
        Cut each record into pieces of this length in s.
    noise
        Output -> standard deviation of its noise in one sample, in its unit; for each recorded output.
    false_alarm
        Probability, at most, of an alarm in the whole log while the model explains it.
    exclude
        Effect ids that `discover` does not try.
    progress
        Called with a line of text for each piece.

    Returns
    -------
    Watch
        ``.verdict``, ``.alarm`` (s), ``.since`` (s), ``.found`` (`Discovery` of the pieces since), ``.pieces``.

    Raises
    ------
    InputError
        Fewer than two pieces, a piece that does not fit the model or is too short, no noise for an output, an unknown
        effect in ``exclude``.

    References
    ----------
    Pérez-Ortiz, Lardy, de Heide, Grünwald, *E-statistics, group invariance and anytime-valid testing*, Annals of
    Statistics 52 (2024).
    """
    checks.number("watch: false_alarm", false_alarm, "a probability between 0 and 1", above=0.0, below=1.0)
    if every is not None:
        checks.number("watch: every", every, "a length in s above 0", above=0.0)
    extended = isinstance(model, ExtendedPlant)
    plant, attached = (model.plant, tuple(model.effects)) if extended else (known_plant(model, "watch"), ())
    left_out, watched = tuple(effect(name).id for name in exclude), None
    alarm, highest, onsets = -np.log(false_alarm), -np.inf, None  # evidence of each onset once an alarm is clear
    for piece in _pieces([records] if isinstance(records, Record) else records, every):
        watched = watched or _Watched(plant, attached, noise, piece)
        evidence = watched.add(piece)
        if max(alarm, highest) <= evidence and highest < alarm + CLEAR:
            highest, onsets = evidence, watched.test.evidence()
        if progress is not None:
            word, stop = "ALARM: " if evidence >= alarm else "", watched.pieces[-1].stop
            progress(f"{word}piece {len(watched.pieces)}, up to {stop:.6g} s: log E = {evidence:.2f}")
    if watched is None or len(watched.pieces) < 2:
        hint = "one record is cut into pieces by every=SECONDS"
        raise InputError("watch", f"{0 if watched is None else 1} piece", "at least two", hint)
    pieces, used = tuple(watched.pieces), watched.windows[0] / watched.windows[1]
    since, found = (np.nan, np.nan, np.nan), None
    if onsets is not None:
        began, lower, upper = onset(onsets)
        # A change may begin too late within a piece to be visible there.
        since = pieces[began].start, pieces[max(lower - 1, 0)].start, pieces[upper].start
        with suppress(InputError, NoTrustworthyNumber):  # too poor
            last = watched.records[max(began, len(watched.records) - MOST_DISCOVERED) :]
            found = discover(plant, last, exclude=left_out)
    return Watch(
        Status.INCONCLUSIVE if onsets is None and used < 0.5 else Status.CONVERGED,
        "explained" if onsets is None else "changed", false_alarm,
        next((p.stop for p in pieces if p.evidence >= alarm), np.nan), *since, found, pieces,
        watched.sizes, plant.name, watched.length * watched.dt, used,
    )  # fmt: skip


def _pieces(records: Iterable[Record], every: float | None) -> Iterator[Record]:
    """Yield the pieces on the time base of the log; records that do not begin after the last one are appended to it."""
    end: float | None = None
    for record in records:
        if not isinstance(record, Record):
            raise InputError("watch", f"a {type(record).__name__}", "records")
        if end is not None and record.t[0] <= end:
            record = replace(record, t=record.t - record.t[0] + end + record.dt)
        end = float(record.t[-1])
        # A remainder of less than half a piece joins the last one.
        count = 1 if every is None else max(1, round(record.duration / every))
        if every is None or count == 1:
            yield record
        else:
            edges = [*(record.t[0] + every * (np.arange(count) - 1e-9)), np.inf]
            for k, (start, stop) in enumerate(pairwise(edges), 1):
                yield replace(record.between(start, stop), name=f"{record.name}, piece {k}")


class _Watched:
    """The log so far: the model learned from its first piece, the test, and the pieces."""

    def __init__(
        self, plant: AnyPlant, attached: Sequence[AttachedEffect], noise: Mapping[str, float], first: Record
    ) -> None:
        self.plant, self.dt = plant, clock_step(first.t)
        self.outputs = {s.name for s in plant.outputs} & set(first.outputs)
        least = constants.FEWEST_WINDOWS * constants.SHORTEST_WINDOW // 2
        if first.n < least:
            raise InputError(f"watch {first.name}", f"{first.n} samples", f"at least {least} in a piece")
        record, _ = self._uniform(first)
        self.model = ports_of(plant, record)
        self.length = window_length(plant, [record], self.model)
        prepared = self._prepared(first)
        self.thin = prepared.thin
        names = [plant.outputs[k].name for k in prepared.columns]
        for name in (*noise, *names):
            checks.choice("watch: noise", name, names)
            if name not in noise:
                raise InputError("watch: noise", f"none of {name!r}", "one for each recorded output")
        expected = "a standard deviation above 0"
        self.sizes = {n: checks.number(f"watch: noise of {n}", noise[n], expected, above=0.0) for n in names}
        self.noise = NoiseModel(np.array([*self.sizes.values()]) / np.sqrt(self.thin), np.zeros((0, len(self.sizes))))
        nuisances = nuisance_parameters(plant, stated_tolerances(plant, None))
        nuisances += clock_nuisances(tuple(s.name for s in plant.inputs), self.dt)
        pool = candidates(plant, self.model, [prepared])
        self.hypothesis = Hypothesis(tuple(_own(e, pool) for e in attached))
        problem = Problem(plant, [prepared], nuisances, clock=Clock(constants.LEAST_STEPS))
        z = np.zeros(problem.size(self.hypothesis))
        fit, problem = held_inputs(problem, problem.fit(self.hypothesis, self.noise, z, plan=FitPlan(constants.BASE)))
        self.problem = problem.under(replace(problem.clock, sub=STEPS))
        learned = self.problem.fit(self.hypothesis, self.noise, fit.z, fit.starts, FitPlan(constants.BASE, 1e-3))
        self.z = learned.z
        sizes, directions = np.linalg.eigh(np.linalg.inv(learned.hessian))
        self.spread = FAR * directions * np.sqrt(np.maximum(sizes, 0.0))
        # A usual change of each standardised parameter: a log factor of one if it scales; 0 for clocks.
        usual = [0.0 if n.input else 1.0 if n.additive else 1.0 / n.spread for n in self.problem.nuisances]
        own = [p.prior for c in self.hypothesis.candidates for p in c.parameters]
        self.test = ChangeTest(np.array([*usual, *(1.0 / p.spread if p.kind == "log" else 1.0 for p in own)]))
        self.records, self.pieces = list[Record](), list[WatchedPiece]()
        self.windows = [0, 0]  # used by the test, and all

    def add(self, piece: Record) -> float:
        """Fit the initial states of one more piece and update the test; return log E."""
        if abs(clock_step(piece.t) - self.dt) > 1e-3 * self.dt:
            found = f"a sample time of {clock_step(piece.t):.6g} s"
            raise InputError(f"watch {piece.name}", found, f"{self.dt:.6g} s, that of the first piece")
        if missing := sorted(self.outputs - set(piece.outputs)):
            raise InputError(f"watch {piece.name}", f"no output {missing[0]!r}", "the outputs of the first piece")
        there = self.problem.on([replace(self._prepared(piece), thin=self.thin)])
        fit = there.fit(self.hypothesis, self.noise, self.z, plan=FitPlan(constants.LAST, 0.5, fixed=True))
        equations, used = _equations(there, fit, self.spread)
        misfit = float(np.sqrt(equations.whole[-1, -1] / max(equations.points, 1)))
        self.records.append(piece)
        self.windows = [self.windows[0] + used, self.windows[1] + there.records[0].count]
        self.pieces.append(WatchedPiece(float(piece.t[0]), float(piece.t[-1]), self.test.add(equations), misfit))
        return self.pieces[-1].evidence

    def _uniform(self, piece: Record) -> tuple[Record, dict[str, Mask]]:
        found = uniform(piece, None if piece.is_uniform else self.dt)
        return with_units(found.record, (*self.plant.inputs, *self.plant.outputs)), dict(found.valid)

    def _prepared(self, piece: Record) -> PreparedRecord:
        record, valid = self._uniform(piece)
        return prepare(self.plant, self.model, record, self.length, valid, self.outputs)


def _own(there: AttachedEffect, pool: Sequence[Candidate]) -> Candidate:
    """Make an effect of the model a candidate to be refitted, with priors about its present values."""
    known = next((c for c in pool if (c.effect, c.site) == (there.effect, there.site)), None)
    parameters = []
    for p in known.parameters if known else there.parameters:  # of the pool: with the units of its joint
        prior, value = p.prior, there.values[p.name]
        if prior.kind == "log":
            prior = replace(prior, centre=value or np.finfo(float).tiny ** 0.25 * prior.centre, spread=OWN_SPREAD)
        else:
            std = there.std.get(p.name, 0.0) or OWN_SPREAD * abs(value) if prior.kind == "linear" else 0.0
            prior = replace(prior, centre=value, spread=std or prior.spread)
        parameters.append(replace(p, prior=prior))
    scales = known.scales if known else Scales()
    return Candidate(there.effect, there.site, tuple(parameters), (dict(there.values),), scales)


def _equations(problem: Problem, fit: Fit, spread: Array) -> tuple[PieceEquations, int]:
    """Return a piece's equations about its fit, and the number of windows used."""
    # Excluded: windows in which halved time steps or the even part of the parameter steps ``spread`` (k, m) change the
    # residuals by more than `MOST_BENT` (a contact about to break away).

    def residual(z: Array, problem: Problem = problem) -> Array:
        return problem.whitened(problem.errors(fit.hypothesis, z, fit.starts), fit.noise)[0]

    here = residual(fit.z)
    ((over_z, over_x),) = problem.derivatives(fit)
    free = np.linalg.qr(over_x)[0]  # response to the initial states
    halved = problem.under(replace(problem.clock, sub=2 * STEPS))
    steps = [residual(fit.z, halved), *(0.5 * (residual(fit.z + step) + residual(fit.z - step)) for step in spread.T)]
    changes = np.stack([step - here for step in steps], axis=2)
    changes -= free @ (np.swapaxes(free, 1, 2) @ changes)
    kept = ((changes**2).sum(axis=1) < MOST_BENT).all(axis=1)
    here, over_z, over_x = here[kept], over_z[kept], over_x[kept]
    columns = np.nan_to_num(np.concatenate([over_z, here[:, :, None]], axis=2), posinf=0.0, neginf=0.0)
    known, n_y = here != 0.0, len(fit.noise.std)
    count, points, n_x = over_x.shape
    most = max(1, min(SLOW, (points - n_x) // (2 * n_y)))
    waves = np.cos(np.pi * np.outer(np.arange(points // n_y) + 0.5, np.arange(most)) / (points // n_y))
    slow = np.kron(waves, np.eye(n_y))[None] * known[:, :, None]
    basis = np.linalg.qr(np.concatenate([over_x, slow], axis=2))[0]
    starts, slow = basis[:, :, :n_x], basis[:, :, n_x:]
    left = columns - starts @ (np.swapaxes(starts, 1, 2) @ columns)
    within = np.swapaxes(slow, 1, 2) @ left
    whole, inside = (np.einsum("wpi,wpj->ij", part, part, optimize=True) for part in (left, within))
    return PieceEquations(whole, inside, int(known.sum()) - count * n_x, count * slow.shape[2]), count


# --- the sequential test ---------------------------------------------------------------------------------------------


class PieceEquations(NamedTuple):
    """A piece with M = [J r], (points, k + 1), its windows' initial states projected out."""

    whole: Array  # M^T M
    slow: Array  # M^T U U^T M with the slow directions U of its windows
    points: int
    slow_points: int


@dataclass(eq=False)
class ChangeTest:
    """The test over the pieces so far; ``size`` (k,): a usual change of each parameter, 0 for nuisances."""

    size: Array
    pieces: list[PieceEquations] = field(default_factory=list)

    def add(self, piece: PieceEquations) -> float:
        self.pieces.append(piece)
        return float(np.logaddexp(np.logaddexp.reduce(self.evidence()), -np.log(len(self.pieces) + 1.0)))

    def evidence(self) -> Array:
        """Compute the log evidence of a change from each piece on, with its prior share, (n_tau,)."""
        tau = np.arange(len(self.pieces))
        may = self.size > 0.0
        named = self._strengths() + np.log((1.0 - UNNAMED) / 2.0 / max(may.sum(), 1))
        named[0], named[:, :, ~may] = -np.inf, -np.inf  # from the first piece on it is no change
        whole, slow, points, slow_points = (np.array(column) for column in zip(*self.pieces, strict=True))
        scatter = [self._scatter(*kind, v) for kind in ((slow, slow_points), (whole, points)) for v in SCATTERS]
        unnamed = _log_mean(scatter) + np.log(UNNAMED)
        both = np.concatenate([named.reshape(len(tau), -1), unnamed[:, None]], axis=1)
        return np.logaddexp.reduce(both, axis=1) - np.log((tau + 1.0) * (tau + 2.0))

    def _strengths(self) -> Array:
        """Compute the log ratio of an abrupt or growing change of each parameter, (n_tau, 2, k)."""
        k = len(self.size)
        once = _since(np.stack([p.whole for p in self.pieces]))  # sums over the pieces since each one
        growing = _since(once)  # the same weighted with 1, 2, ...
        squares = np.diagonal(np.stack([once, 2.0 * _since(growing) - growing], axis=1), axis1=2, axis2=3)[..., :k]
        rows = np.stack([once, growing], axis=1)[:, :, :k]  # (n_tau, 2, k, k + 1)
        inverse = np.linalg.inv(once[0, :k, :k] + DIFFUSE * np.eye(k))
        cross = rows[..., :k]
        a = np.maximum(squares - ((cross @ inverse) * cross).sum(axis=-1), 0.0) + NEGLIGIBLE * squares
        b = rows[..., k] - cross @ (inverse @ once[0, :k, k])
        variances = [(size * self.size / np.array([[1.0], [GROWING]])) ** 2 for size in SIZES]
        return _log_mean([0.5 * b**2 * v / (1.0 + a * v) - 0.5 * np.log1p(a * v) for v in variances])

    def _scatter(self, parts: Array, points: Array, variance: float) -> Array:
        """Compute the log ratio, (n_tau,), of random errors with this variance in the directions of the parts."""
        k, whole = len(self.size), np.sum([p.whole for p in self.pieces], axis=0)
        before, after = _profile(whole, k), _profile(whole - variance / (1.0 + variance) * _since(parts), k)
        return -0.5 * (after - before + _since(points) * np.log1p(variance))


def onset(evidence: Array) -> tuple[int, int, int]:
    """Return the piece at which the change most probably began, and the ends of its 95 % interval."""
    share = np.exp(evidence - np.logaddexp.reduce(evidence))
    below = np.cumsum(share)
    lower, upper = np.minimum(np.searchsorted(below, (0.025, 0.975)), len(below) - 1).tolist()
    return int(np.argmax(share)), lower, upper


def _since(values: Array) -> Array:
    return np.cumsum(values[::-1], axis=0)[::-1]


def _log_mean(logs: Sequence[Array]) -> Array:
    """Average numbers given by their logarithms, over the first axis."""
    return np.logaddexp.reduce(np.array(logs)) - np.log(len(logs))


def _profile(sums: Array, k: int) -> Array:
    """Return the least cost over k parameters plus the log determinant of their information; (..., k+1, k+1)."""
    information, right = sums[..., :k, :k] + DIFFUSE * np.eye(k), sums[..., :k, k]
    explained = (right * np.linalg.solve(information, right[..., None])[..., 0]).sum(axis=-1)
    return sums[..., k, k] - explained + np.linalg.slogdet(information)[1]
