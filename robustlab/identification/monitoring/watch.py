"""`watch`: detect when a model stops explaining a running log, with a bounded rate of false alarms.

The first piece gives the model's parameters within their tolerances, and the noise where that is not stated. Every
piece is cut into windows that start anew from their best-fitting state, so that gaps, restarts and drift do no harm.
After an alarm `discover` reports what the plant lacks in the pieces since the change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.budget import one_thread
from robustlab.checks import number
from robustlab.dynamics.effects.catalogue import effect
from robustlab.dynamics.effects.contract import EffectParameter, Scales
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.dynamics.extended.extended_equations import ExtendedEquations
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel, linear_plant_of
from robustlab.errors import InputError, NoTrustworthyNumber, told_as, unknown_name
from robustlab.identification import tuning
from robustlab.identification.hypotheses.candidates import (
    candidates,
    nuisance_parameters,
    stated_tolerances,
    with_absolute_tolerances,
)
from robustlab.identification.hypotheses.effect_fit import Candidate, Clock, Fit, FitPlan, Hypothesis, Problem
from robustlab.identification.hypotheses.noise import careful, first_noise, whitening
from robustlab.identification.hypotheses.normal_equations import NoiseModel
from robustlab.identification.hypotheses.prepared_record import PreparedRecord, ports_of, prepare, window_length
from robustlab.identification.monitoring.change_test import Alternatives, ChangeTest
from robustlab.identification.monitoring.changes import Change, columns_of, possible_changes
from robustlab.identification.monitoring.piece import equations, faithful_windows, fine_steps, placed
from robustlab.identification.monitoring.watch_result import Watch, WatchedPiece
from robustlab.identification.naming.discovery import discover
from robustlab.identification.naming.discovery_result import Discovery
from robustlab.identification.naming.set_search import clock_nuisances, held_inputs
from robustlab.identification.record_check.resampling import clock_step, uniform
from robustlab.identification.response.response import with_units
from robustlab.record import Record
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model

FAR = 2.0  # standard deviations, as the first piece tells the parameters, within which a window has to be linear
CLEAR = 10.0  # log evidence beyond an alarm, at which the onset is estimated; a later change may not be linear
MOST_DISCOVERED = 8  # pieces at the end that `discover` gets
OWN_SPREAD = 0.3  # relative: how well a model's effect is known before its first piece, where it does not say


@one_thread()
@told_as("watch")
def watch(
    model: Any,
    records: Record | Iterable[Record],
    *,
    every: float | None = None,
    noise: Mapping[str, float] | None = None,
    false_alarm: float = 0.01,
    tolerances: Mapping[str, float] | None = None,
    exclude: Sequence[str] = (),
    window: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Watch:
    r"""Detect when a model stops explaining a running log, and report what it lacks since then.

    While the model explains the log, :math:`P(\exists t: E_t \ge 1/\alpha) \le \alpha` for the test's E (Ville's
    inequality), however long the log is and whenever one looks; see `robustlab.identification.monitoring.change_test`.

    ASSUMPTIONS: the sensors' noise is white and Gaussian (for named changes: sub-Gaussian) of the standard deviation
    ``noise``; without it, of the size that the first piece shows. The parameters are constant, and the model is linear
    in what the first piece does not determine of them; windows in which it is not are left out. A drift of the state
    that is slower than a window is no change.

    Parameters
    ----------
    model
        A plant, a plant with effects (what `discover` updated), or a continuous model as `discover` takes it.
    records
        The log in pieces, in their order, or one record; an iterator is asked for the next piece when the last one has
        been judged. All have the sample time and the outputs of the first.
    every
        Cut each record into pieces of so many seconds.
    noise
        Output -> standard deviation of its noise in one sample, in its unit; from the first piece where left out.
    false_alarm
        Probability, at most, of an alarm in the whole log while the model explains it.
    tolerances
        Parameter -> relative tolerance within which the first piece may refit it, as of `discover`.
    exclude
        Effect ids that are not to be tried.
    window
        Length of the windows in s, as `discover` chooses it where left out.
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
    number("watch: false_alarm", false_alarm, "a probability between 0 and 1", above=0.0, below=1.0)
    for word, value in (("every", every), ("window", window)):
        if value is not None:
            number(f"watch: {word}", value, "a length in s above 0", above=0.0)
    if not isinstance(records, Record | Iterable):
        raise InputError("watch: records", f"a {type(records).__name__}", "a record, or records")
    if not isinstance(noise, Mapping | None):
        raise InputError("watch: noise", f"{noise!r}", "standard deviations by outputs, {...}, or None")
    plant, attached = _parts_of(model)
    stated = stated_tolerances(plant, tolerances)
    plant = with_absolute_tolerances(plant, stated)
    left_out = {effect(name).id for name in exclude}
    settings = _Settings(plant, attached, stated, noise, false_alarm, left_out, window)
    given = [records] if isinstance(records, Record) else records
    watched: _Watched | None = None
    log_limit = -np.log(false_alarm)
    for piece in _one_clock(_cut(given, every)):
        if watched is None:
            watched = _Watched(settings, piece)
        else:
            watched.add(piece)
        if progress is not None:
            last = watched.pieces[-1]
            word = "ALARM: " if last.evidence >= log_limit else ""
            progress(f"{word}piece {len(watched.pieces)}, up to {last.stop:.6g} s: log E = {last.evidence:.2f}")
    if watched is None or len(watched.pieces) < 2:
        raise InputError(
            "watch", f"{0 if watched is None else 1} piece", "at least two",
            "one record is cut into pieces by every=SECONDS",
        )  # fmt: skip
    return watched.result()


@dataclass(frozen=True)
class _Settings:
    """What is watched, and how."""

    plant: AnyPlant
    attached: tuple[AttachedEffect, ...]
    stated: Mapping[str, tuple[float, bool]]
    noise: Mapping[str, float] | None
    false_alarm: float
    left_out: set[str]
    window: float | None


def _parts_of(model: Any) -> tuple[AnyPlant, tuple[AttachedEffect, ...]]:
    """The plant without effects, and its effects."""
    if isinstance(model, ExtendedEquations):
        return model.plant, tuple(model.effects)
    if isinstance(model, NonlinearPlant):
        return model, ()
    if isinstance(model, LinearPlant | StateSpaceModel):
        return linear_plant_of(model, "watch"), ()
    return linear_plant_of(as_model(model, "watch"), "watch"), ()


def _cut(records: Iterable[Record], every: float | None) -> Iterator[Record]:
    """The pieces; a rest of less than half a piece belongs to the last one of its record."""
    for record in records:
        if not isinstance(record, Record):
            raise InputError("watch", f"a {type(record).__name__}", "records")
        count = 1 if every is None else max(1, round(record.duration / every))
        edges = (
            np.linspace(0, record.n, count + 1)
            if every is None
            else np.append(np.searchsorted(record.t, record.t[0] + every * np.arange(count) - 1e-9 * every), record.n)
        )
        for k, (first, last) in enumerate(zip(edges[:-1].astype(int), edges[1:].astype(int), strict=True)):
            yield record if count == 1 else _samples(record, first, last, f"{record.name}, piece {k + 1}")


def _samples(record: Record, first: int, last: int, name: str) -> Record:
    part = slice(first, last)
    inputs, outputs = ({k: v[part] for k, v in side.items()} for side in (record.inputs, record.outputs))
    return replace(record, t=record.t[part], inputs=inputs, outputs=outputs, name=name)


def _one_clock(pieces: Iterable[Record]) -> Iterator[Record]:
    """The pieces on the clock of the log: one that does not begin after the end of the last follows it at once."""
    end: float | None = None
    for piece in pieces:
        if end is not None and piece.t[0] <= end:
            piece = replace(piece, t=piece.t - piece.t[0] + end + piece.dt)
        end = float(piece.t[-1])
        yield piece


class _Watched:
    """The log so far: the model as learned from its first piece, the test, and the prepared pieces."""

    def __init__(self, settings: _Settings, first: Record) -> None:
        self.settings = settings
        plant = settings.plant
        self.dt = clock_step(first.t)
        self.seen = {s.name for s in plant.outputs} & set(first.outputs)
        record = self._uniform(first)
        self.model: PortModel = ports_of(plant, record)
        window = settings.window
        least = tuning.FEWEST_WINDOWS * tuning.SHORTEST_WINDOW // 2
        if window is None and record.n < least:
            raise InputError(f"watch {first.name}", f"{record.n} samples", f"at least {least} in a piece")
        self.length = window_length(plant, [record], self.model) if window is None else round(window / self.dt)
        prepared = self._prepared(first)
        self.thin = prepared.thin
        nuisances = nuisance_parameters(plant, settings.stated)
        nuisances += clock_nuisances(tuple(s.name for s in plant.inputs), self.dt)
        problem = Problem(plant, [prepared], nuisances, clock=Clock(tuning.LEAST_STEPS))
        pool = candidates(plant, self.model, [prepared])
        self.problem, learned = self._learned(problem, Hypothesis(tuple(_own(e, pool) for e in settings.attached)))
        self.hypothesis, self.z, self.noise = learned.hypothesis, learned.z, learned.noise
        sizes, directions = np.linalg.eigh(np.linalg.inv(learned.hessian))
        self.spread = FAR * directions * np.sqrt(np.maximum(sizes, 0.0))
        pool = [c for c in pool if c.effect.id not in settings.left_out]
        self.changes: tuple[Change, ...] = possible_changes(self.problem, self.hypothesis, self.z, pool)
        self.test = ChangeTest(columns_of(self.changes, len(self.z)), 1 if settings.noise is None else 0, 1)
        self.told: Alternatives | None = None  # the alternatives once an alarm is clear
        self.highest = -np.log(settings.false_alarm)  # evidence that they had, or that of an alarm
        self.records: list[Record] = []
        self.windows = [0, 0]  # that the test has seen, and all
        self.outputs = [settings.plant.outputs[k].name for k in prepared.columns]
        self.pieces: list[WatchedPiece] = []
        self._judge(first, prepared)

    def add(self, piece: Record) -> None:
        """One more piece."""
        if abs(clock_step(piece.t) - self.dt) > 1e-3 * self.dt:
            found = f"a sample time of {clock_step(piece.t):.6g} s"
            raise InputError(f"watch {piece.name}", found, f"{self.dt:.6g} s, that of the first piece")
        missing = sorted(self.seen - set(piece.outputs))
        if missing:
            raise InputError(f"watch {piece.name}", f"no output {missing[0]!r}", "the outputs of the first piece")
        self._judge(piece, replace(self._prepared(piece), thin=self.thin))

    def _uniform(self, piece: Record) -> Record:
        return with_units(uniform(piece, None if piece.is_uniform else self.dt).record, self._signals)

    @property
    def _signals(self) -> tuple[Any, ...]:
        return (*self.settings.plant.inputs, *self.settings.plant.outputs)

    def _prepared(self, piece: Record) -> PreparedRecord:
        found = uniform(piece, None if piece.is_uniform else self.dt)
        record = with_units(found.record, self._signals)
        return prepare(self.settings.plant, self.model, record, self.length, dict(found.valid), self.seen)

    def _learned(self, problem: Problem, hypothesis: Hypothesis) -> tuple[Problem, Fit]:
        """The model refitted within its tolerances to the first piece; clock, steps and noise of the watch."""
        stated = self.settings.noise
        noise = first_noise(problem) if stated is None else self._stated(problem, stated)
        z = np.zeros(problem.size(hypothesis))
        fit = problem.fit(hypothesis, noise, z, plan=FitPlan(tuning.BASE))
        fit, problem = held_inputs(problem, fit)
        for _ in range(2):
            if stated is None:
                noise = careful(problem, fit, _noise_left(problem, fit))
            fit = problem.fit(hypothesis, noise, fit.z, fit.starts, FitPlan(tuning.BASE, 1e-3))
            problem = fine_steps(problem, fit)
        return problem, fit

    def _stated(self, problem: Problem, stated: Mapping[str, float]) -> NoiseModel:
        """White noise of the stated size, averaged as the errors are."""
        names = [self.settings.plant.outputs[k].name for k in problem.records[0].columns]
        for name in stated:
            if name not in names:
                raise unknown_name("watch: noise", f"{name!r}", name, names)
        for name in names:
            if name not in stated:
                raise InputError("watch: noise", f"none of {name!r}", "one for each recorded output")
            number(f"watch: noise of {name}", stated[name], "a standard deviation above 0", above=0.0)
        std = np.array([stated[name] for name in names]) / np.sqrt(self.thin)
        return NoiseModel(std, np.zeros((0, len(names))))

    def _judge(self, piece: Record, prepared: PreparedRecord) -> None:
        """Place the model in the piece, and hand what it tells to the test."""
        there = self.problem.on([prepared])
        fit = placed(there, self.hypothesis, self.noise, self.z)
        there, fit = faithful_windows(there, fit, self.spread)
        told = equations(there, fit, self.changes)
        misfit = float(np.sqrt(told.whole[-1, -1] / max(told.points, 1)))
        self.records.append(piece)
        self.windows = [self.windows[0] + len(there.chosen[0]), self.windows[1] + there.records[0].count]
        evidence = self.test.add(told)
        self.pieces.append(WatchedPiece(float(piece.t[0]), float(piece.t[-1]), evidence, misfit))
        if self.highest <= evidence and self.highest < CLEAR - np.log(self.settings.false_alarm):
            self.highest, self.told = evidence, self.test.alternatives()

    def result(self) -> Watch:
        """What was found in all pieces so far."""
        settings, alarm = self.settings, -np.log(self.settings.false_alarm)
        over = [k for k, p in enumerate(self.pieces) if p.evidence >= alarm]
        sizes = self.noise.std * np.sqrt(self.thin)
        used = self.windows[0] / self.windows[1]
        result = Watch(
            Status.CONVERGED if over or used >= 0.5 else Status.INCONCLUSIVE, "explained", settings.false_alarm,
            np.nan, np.nan, np.nan, np.nan, None, tuple(self.pieces),
            dict(zip(self.outputs, map(float, sizes), strict=True)), settings.noise is not None, settings.plant.name,
            self.length * self.dt, used,
        )  # fmt: skip
        if self.told is None:
            return result
        began, lower, upper = self.told.onset()
        # A change may begin within a piece, and too late in it to show there.
        times = [self.pieces[k].start for k in (began, max(lower - 1, 0), upper)]
        found = self._found(max(began, len(self.pieces) - MOST_DISCOVERED))
        return replace(
            result, verdict="changed", alarm=self.pieces[over[0]].stop, since=times[0], since_lower=times[1],
            since_upper=times[2], found=found,
        )  # fmt: skip

    def _found(self, first: int) -> Discovery | None:
        """What `discover` reports of the plant without effects from a piece on; None where the pieces are too poor."""
        stated = {name: tolerance for name, (tolerance, assumed) in self.settings.stated.items() if not assumed}
        out = tuple(self.settings.left_out)
        try:
            return discover(self.settings.plant, self.records[first:], tolerances=stated, exclude=out)
        except (InputError, NoTrustworthyNumber):
            return None


def _noise_left(problem: Problem, fit: Fit) -> NoiseModel:
    """White noise of the size of a fit's errors, for the parameters and starts that the fit was free to choose.

    An autoregression would take what the starts took out of the windows for a lack of slow noise, and the test for a
    change that the noise is no slower elsewhere.
    """
    white = whitening(problem, fit, 0)
    points = sum(int(np.isfinite(e).sum()) for e in problem.errors(fit.hypothesis, fit.z, fit.starts))
    free = len(fit.z) + sum(x.size for x in fit.starts)
    return replace(white, std=white.std * np.sqrt(points / max(points - free, 1)))


def _own(there: AttachedEffect, pool: Sequence[Candidate]) -> Candidate:
    """An effect of the model as one to be refitted: its priors about the values that the model has."""
    known = next((c for c in pool if (c.effect, c.site) == (there.effect, there.site)), None)
    parameters = there.parameters if known is None else known.parameters  # with the units of its joint
    parameters = tuple(_about(p, there.values[p.name], there.std.get(p.name, 0.0)) for p in parameters)
    return Candidate(there.effect, there.site, parameters, (dict(there.values),), known.scales if known else Scales())


def _about(parameter: EffectParameter, value: float, std: float) -> EffectParameter:
    prior = parameter.prior
    if prior.kind == "log":
        centre = value or np.finfo(float).tiny ** 0.25 * prior.centre
        return replace(parameter, prior=replace(prior, centre=centre, spread=OWN_SPREAD))
    if prior.kind == "linear":
        return replace(
            parameter, prior=replace(prior, centre=value, spread=std or OWN_SPREAD * abs(value) or prior.spread)
        )
    return replace(parameter, prior=replace(prior, centre=value))
