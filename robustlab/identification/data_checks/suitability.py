"""Checks of a record before effect identification.

A record with too little information, or a channel with the wrong sign, unit or name, would still be "explained" by some
effect of the catalogue: an invented one. `check_record` reports on the samples of any record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.display import Facts, Part
from robustlab.dynamics.plant_base import NonlinearPlant, SteppedPlant
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.data_checks.channel_identity import (
    Finding,
    contradictions,
    response_factors,
    turned_channels,
    turned_sign,
)
from robustlab.identification.data_checks.resampling import UniformRecord, uniform
from robustlab.identification.response.response import (
    Response,
    longest_period,
    matched,
    response_of,
    slowest_time_constant,
    with_units,
)
from robustlab.record import Record
from robustlab.result import Evidence, Status
from robustlab.time_base import summarise_clock

SHORTEST_CLIP = 5  # constant samples at the end of the range
FEWEST_LEVELS = 20  # a signal with fewer levels (a switch, a coarse sensor) is not checked for clipping
CLIPPED_SHARE = 1e-3


@dataclass(frozen=True)
class RecordCheck(Evidence):
    """Content and peculiarities of a record; with a model, its fitness for effect identification."""

    record: Record
    channels: tuple[dict[str, Any], ...]  # name, side, unit, and in that unit least, greatest value, root mean square
    remarks: tuple[str, ...]
    suitability: Suitability | None = None

    quantities: ClassVar[Mapping[str, Any]] = {
        "record": {"n": "1", "duration": "s", "dt": "s", "is_uniform": bool},
        "remarks": [str],
        "channels": {
            "*": {**dict.fromkeys(("name", "side", "unit"), str), **dict.fromkeys(("least", "greatest", "rms"), float)}
        },
    }

    @property
    def status(self) -> Status:
        """CONVERGED, also for an unfit record (see `require`)."""
        return Status.CONVERGED

    def headline(self) -> str:
        fit = "" if self.suitability is None else ", fit for naming" if self.suitability.fit else ", not fit for naming"
        return f"{self.clock}; {len(self.remarks)} remarks{fit}"

    @property
    def clock(self) -> str:
        """Samples, duration and sample time."""
        r = self.record
        even = "uniform" if r.is_uniform else "not uniform"
        return f"{r.n} samples, {r.duration:.6g} s, dt {r.dt:.6g} s, {even}"

    def facts(self) -> Facts:
        fit = () if self.suitability is None else self.suitability.facts()
        remarks = [("remark", text) for text in self.remarks]
        findings = [("for naming", f"{kind}: {text}" if kind else text) for kind, text in fit]
        return [(self.record.name, self.clock), *remarks, *findings]

    def details(self) -> list[Part]:
        rows = [
            (c["name"], c["side"], c["unit"] or "?", *(f"{c[key]:.6g}" for key in ("least", "greatest", "rms")))
            for c in self.channels
        ]
        return [Part("", ("signal", "side", "unit", "least", "greatest", "rms"), rows)]

    def require(self) -> None:
        """Raise if a requested check against a model found the record unfit; see `Suitability.require`."""
        if self.suitability is not None:
            self.suitability.require()

    def numbers(self) -> dict[str, Any]:
        """Return the time base, the remarks, and the range of each channel by name."""
        clock = {name: getattr(self.record, name) for name in ("n", "duration", "dt", "is_uniform")}
        return {"record": clock, "remarks": self.remarks, "channels": {c["name"]: c for c in self.channels}}

    def to_json(self) -> dict[str, object]:
        """Return all but the samples."""
        fit = {} if self.suitability is None else {"suitability": self.suitability.to_json()}
        channels = {"channels": self.channels, "remarks": self.remarks}
        return {"name": self.record.name, **self.numbers()["record"], **channels, **fit, "status": self.status}


def check_record(record: Record, plant: Any = None) -> RecordCheck:
    """Report the content of a record and its irregularities; with a model, also whether it suits identification."""
    channels, remarks = [], []
    if not record.is_uniform:
        steps = np.diff(record.t)
        k = int(np.argmax(np.abs(steps - record.dt)))
        jitter = f"jitter {summarise_clock(record.t).jitter:.3g} s rms without gaps"
        size = f"{steps.min():.6g} to {steps.max():.6g} s"
        remarks.append(f"t: steps of {size}, the most unusual after sample {k}; {jitter}")
    remarks += [f"t: {line}" for line in record.meaning.get("t", "").splitlines()]  # resampling while reading
    for side, group in (("input", record.inputs), ("output", record.outputs)):
        for name, x in group.items():
            sizes = {"least": float(x.min()), "greatest": float(x.max()), "rms": float(np.sqrt(np.mean(x**2)))}
            channels.append({"name": name, "side": side, "unit": record.units[name], **sizes})
            if not record.units[name]:
                remarks.append(f"{name}: no unit stated")
    remarks.extend(channel_warnings(record, tuple(record.inputs), tuple(record.outputs)))
    fit = suitability(plant, record) if plant is not None else None
    return RecordCheck(record, tuple(channels), tuple(remarks), fit)


def channel_warnings(record: Record, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> list[str]:
    """Return one line for each constant channel and each clipped output."""
    # Inputs are not checked for clipping: a step or a square wave is correctly at its extremes.
    constant = [name for name in (*inputs, *outputs) if not np.ptp(record[name])]
    warnings = [f"{name} is constant: {record[name][0]:.6g} {record.unit(name)}".rstrip() for name in constant]
    for f in _clipped(record, outputs):
        runs: Any = f.evidence["runs"]
        warnings.append(f"{f.channel} looks {f.found} (first: samples {runs[0][0]} to {runs[0][1] - 1})")
    return warnings


def _clipped(record: Record, outputs: tuple[str, ...]) -> list[Finding]:
    """Find the clipped outputs, if that is not a negligible part of the record."""
    found: list[Finding] = []
    for name in outputs:
        y, runs = record[name], clipped_runs(record[name])
        count = sum(last - first for first, last in runs)
        if count > CLIPPED_SHARE * record.n:
            text = f"clipped: {count} of {record.n} samples are at the end of its range, reached at full slope"
            hint = "choose a larger range of the sensor, or cut these stretches out: record.between(start, stop)"
            evidence: dict[str, object] = {"samples": count, "runs": runs, "range": [float(y.min()), float(y.max())]}
            found.append(Finding("clipped", name, text, "a sensor within its range", hint, False, evidence))
    return found


def clipped_runs(y: Array) -> list[tuple[int, int]]:
    """Return runs ``(first, last + 1)`` of constant samples at the largest or smallest value, reached at full slope.

    A sensor at its limit stops from full slope; a machine that comes to a stop slows down first. A run has 5 samples or
    more, and one of the two steps before it (the last is cut short by the limit) is at least half the signal's median
    step.
    """
    if len(y) < SHORTEST_CLIP + 2 or len(np.unique(y)) < FEWEST_LEVELS:
        return []
    step = np.abs(np.diff(y))
    usual = float(np.median(step[step > 0]))
    runs = []
    for extreme in (y.min(), y.max()):
        held = np.concatenate([[0], (y == extreme).astype(int), [0]])
        change = np.flatnonzero(np.diff(held))
        for first, last in change.reshape(-1, 2).tolist():
            before = step[max(0, first - 2) : first]
            if last - first >= SHORTEST_CLIP and before.max(initial=0.0) >= 0.5 * usual:
                runs.append((first, last))
    return sorted(runs)


# Kinds that require another record, not a correction of this one: exit code 4 instead of 3.
TOO_POOR = ("too-short", "unexcited")
WHITE = 1.5  # an output whose spread is below this many times its sample-to-sample noise does not move
FEWEST_STEPS = 4  # quantisation steps that a moving output crosses
RESPONDS = 0.3  # share of an output explained by the input, from which it is not noise
MULTIPLE = 0.02  # distance from a whole multiple that rounding may cause
STEPS_APART = 1000.0  # differences of more steps do not determine the step
FEWEST_DIFFERENCES = 10


@dataclass(frozen=True)
class Suitability(Evidence):
    """Result of `suitability`."""

    record: str  # name of the record
    findings: tuple[Finding, ...]  # fatal ones first

    @property
    def fatal(self) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.fatal)

    @property
    def fit(self) -> bool:
        return not self.fatal

    def of(self, kind: str) -> tuple[Finding, ...]:
        return tuple(finding for finding in self.findings if finding.kind == kind)

    def require(self) -> None:
        """Raise for an unfit record."""
        if self.fit:
            return
        wrong = sorted(self.fatal, key=lambda finding: finding.kind in TOO_POOR)
        first, more = wrong[0], tuple(f"{self.record}: {finding.message}" for finding in wrong[1:])
        error = NoTrustworthyNumber if first.kind in TOO_POOR else InputError
        raise error(f"{self.record}: {first.channel}", first.found, first.expected or None, first.hint or None, more)

    def facts(self) -> Facts:
        findings = [
            ("FATAL" if f.fatal else "note", f"{f.message}; {f.hint}" if f.hint and f.fatal else f.message)
            for f in self.findings
        ]
        return findings or [("", f"{self.record}: fit for naming")]

    def to_json(self) -> dict[str, object]:
        return {"record": self.record, "fit": self.fit, "findings": [finding.to_json() for finding in self.findings]}


def suitability(plant: Any, record: Record) -> Suitability:
    """Check a record before effect identification; ``require()`` of the result raises for fatal findings.

    ``plant``: a plant or linear model with all of its inputs in the record; for a nonlinear plant also the positions of
    all joints. Signals and units must match.

    Examples
    --------
    >>> import robustlab as rl
    >>> t = np.arange(2000) * 1e-3
    >>> axis = rl.plant("servo-axis")
    >>> run = rl.simulate(axis, t, np.sign(np.sin(9 * t)) + np.sin(5 * t))
    >>> wrong = Record(t, run.inputs, {"q": run["q"], "v": -run["v"]}, run.units, "run 7")
    >>> suitability(axis, run).fit, suitability(axis, wrong).fatal[0].kind
    (True, 'sign')
    """
    nonlinear = isinstance(plant, NonlinearPlant)
    response = None if nonlinear else response_of(plant, record)
    outputs = response.outputs if response else matched(plant.inputs, plant.outputs, record)[0]
    model = response.model if response else plant
    names, inputs = tuple(s.name for s in outputs), tuple(s.name for s in model.inputs)
    record = with_units(record, (*model.inputs, *outputs))
    level = uniform(record)
    # A dead sensor of a nonlinear plant would indicate a joint at standstill.
    dead = [replace(f, fatal=f.fatal or nonlinear) for f in _dead(record, names)]
    findings = [*_clock(level), *_clipped(record, names), *_quantised(record, names), *dead]
    if response is None:
        findings += _unexcited(record, inputs, names, {})
        if not isinstance(plant, SteppedPlant) and not any(f.fatal for f in findings):
            findings += _along_motion(plant, level)
    else:
        findings += _too_short(response, record)
        good = np.logical_and.reduce([level.valid[name] for name in names])
        factors = response_factors(response.model, names, level.record, good)
        unexcited = _unexcited(record, inputs, names, {n: f.share for n, f in zip(names, factors, strict=True)})
        findings += unexcited
        if not any(finding.fatal for finding in unexcited):
            findings += contradictions(response.model, names, level.record, good, factors)
    order = sorted(findings, key=lambda finding: not finding.fatal)
    return Suitability(record.name, tuple(order))


def quantisation_step(y: Array) -> float | None:
    """Estimate the step of an encoder or converter from its samples (n,), or None if they are not quantised.

    The smallest difference between any two samples, if nearly all other small differences are whole multiples of it.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 500)
    >>> quantisation_step(0.025 * np.round(np.sin(5 * t) / 0.025)), quantisation_step(np.sin(5 * t))
    (0.025, None)
    """
    levels = np.unique(y)
    # Single precision has its own grid; steps must be much larger.
    kind = np.float32 if (y.astype(np.float32) == y).all() else np.float64
    rounding = 16 * float(np.finfo(kind).eps) * float(np.abs(levels).max())
    apart = np.diff(levels)
    apart = apart[apart > rounding]  # one level written in two ways
    if len(levels) < 3 or not len(apart):
        return None
    step = float(apart.min())
    near = apart[apart < STEPS_APART * step]
    steps = np.round(near / step)
    enough = len(near) >= min(FEWEST_DIFFERENCES, len(levels) - 1)
    if not enough or step < 10 * rounding or (np.abs(near / step - steps) > MULTIPLE).mean() > 0.01:
        return None
    # The mean over all differences reduces the rounding of one; 9 digits remove the rest.
    return float(np.format_float_scientific(near.sum() / steps.sum(), precision=9))


# --- time base and samples -------------------------------------------------------------------------------------------


def _clock(level: UniformRecord) -> list[Finding]:
    if not level.gaps:
        return []
    lost, longest = sum(gap.missing for gap in level.gaps), max(level.gaps, key=lambda gap: gap.missing)
    where = f"the longest from {longest.start:.6g} s to {longest.stop:.6g} s"
    evidence: dict[str, object] = {"missing": lost, "gaps": [gap._asdict() for gap in level.gaps]}
    text = f"{lost} samples missing in {len(level.gaps)} gaps, {where}"
    return [Finding("gaps", "t", text, "", "only windows without gaps are used", False, evidence)]


def _quantised(record: Record, outputs: tuple[str, ...]) -> list[Finding]:
    found: list[Finding] = []
    for name in outputs:
        if step := quantisation_step(record[name]):
            text = f"steps of {step:.6g} {record.unit(name)}".rstrip()
            evidence: dict[str, object] = {"step": step, "noise": step / np.sqrt(12.0)}
            found.append(Finding("quantisation", name, text, "", "", False, evidence))
    return found


def _dead(record: Record, outputs: tuple[str, ...]) -> list[Finding]:
    dead = [name for name in outputs if not np.ptp(record[name])]
    hint = "check its cable and scaling, or leave it out, with outputs=... for the others"
    found: list[Finding] = []
    for name in dead:
        value, fatal = float(record[name][0]), len(dead) == len(outputs)
        text = f"is {value:.6g} {record.unit(name)}".rstrip() + " throughout: a dead sensor"
        found.append(Finding("constant-output", name, text, "an output that moves", hint, fatal, {"value": value}))
    return found


# --- information in the record ---------------------------------------------------------------------------------------


def _too_short(response: Response, record: Record) -> list[Finding]:
    """Check that the record covers one period of the slowest oscillation; its decay does not matter."""
    # A mode that decays more slowly behaves as an integrator within the record: reported, not fatal.
    slowest, period = slowest_time_constant(response.model), longest_period(response.model)
    if record.duration >= (period or slowest):
        return []
    text, expected, hint = f"lasts {record.duration:.6g} s", "", f"record {3 * (period or slowest):.3g} s or more"
    evidence: dict[str, object] = {"duration": record.duration, "time_constant": slowest}
    if period:
        expected, evidence["period"] = f"at least one period of the model's slowest oscillation, {period:.6g} s", period
    else:
        text += f", less than the model's slowest time constant of {slowest:.6g} s: how that mode ends is not seen"
    return [Finding("too-short", "t", text, expected, hint, bool(period), evidence)]


def _unexcited(
    record: Record, inputs: tuple[str, ...], outputs: tuple[str, ...], shown: dict[str, float]
) -> list[Finding]:
    alive = [name for name in outputs if np.ptp(record[name])]
    still = [name for name in alive if not _moves(record[name], shown.get(name, 0.0))]
    constant = [name for name in inputs if not np.ptp(record[name])]
    nothing = bool(alive) and len(still) == len(alive)
    if inputs and len(constant) == len(inputs):
        values = ", ".join(f"{name} = {record[name][0]:.6g} {record.unit(name)}".rstrip() for name in constant)
        if nothing:
            reason = "no output leaves its noise either"
        elif any(record[name].any() for name in constant):
            reason = "a constant load cannot be distinguished from it"
        else:
            reason = "free motion alone, which does not determine the gain of an input"
        hint = "move the machine: steps in both directions, at two levels at least, and slow ramps through zero"
        evidence: dict[str, object] = {"constant": constant, "outputs_in_noise": still}
        text, expected = f"constant: {values}; {reason}", "an input that moves"
        return [Finding("unexcited", ", ".join(inputs), text, expected, hint, nothing, evidence)]
    found: list[Finding] = []
    hint = f"excite more strongly: {', '.join(inputs)} is too small to move it"
    for name in still:
        noise = _noise(record[name])
        text = f"does not leave its noise ({noise:.3g} {record.unit(name)}".rstrip() + " rms from sample to sample)"
        evidence = {"spread": float(record[name].std()), "noise": noise}
        found.append(Finding("unexcited", name, text, "an output that moves", hint, nothing, evidence))
    return found


def _noise(y: Array) -> float:
    """Estimate the sample-to-sample noise of y (n,): rms of its third difference over sqrt(20)."""
    return float(np.sqrt(np.mean(np.diff(y, 3) ** 2) / 20.0)) if len(y) > 3 else 0.0


def _moves(y: Array, share: float) -> bool:
    from scipy.signal import detrend

    if share >= RESPONDS:
        return True
    if np.ptp(y) < FEWEST_STEPS * (quantisation_step(y) or 0.0):
        return False
    rest = detrend(y)
    before = np.column_stack([rest[1:-1], rest[:-2]])
    # The error of a prediction from two samples is near zero even for fast oscillations.
    unpredicted = float(np.std(rest[2:] - before @ np.linalg.lstsq(before, rest[2:], rcond=None)[0]))
    return float(rest.std()) > WHITE * min(_noise(y), unpredicted)


# --- wrong channels --------------------------------------------------------------------------------------------------


def _along_motion(plant: NonlinearPlant, level: UniformRecord) -> list[Finding]:
    """Check that a nonlinear plant can have the measured motion, and find channels with a wrong sign."""
    positions = ", ".join(s.name for s in plant.outputs if s.name in level.record.outputs)
    try:
        turned = turned_channels(plant, level.record)
    except InputError as wrong:
        return [Finding("motion", positions, wrong.found, wrong.expected or "", wrong.hint or "", True, {})]
    except NoTrustworthyNumber as none:
        hint = "check signs, units and zeros of the outputs"
        text = f"show a motion that {plant.name} cannot have: {none.found}"
        return [Finding("motion", positions, text, "positions within its reach", hint, True, {})]
    return [
        turned_sign((name,), f"inverted, {100 * share:.2g} % of the squared error remains", {"error_left": share})
        for name, share in turned.items()
    ]
