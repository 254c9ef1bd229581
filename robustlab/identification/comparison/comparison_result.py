"""What `compare` answers: the gap at every output, where it lives, what the residual still contains; and its text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import Array
from robustlab.identification.comparison.best_linear_approximation import BestLinearApproximation
from robustlab.identification.comparison.comparison_parts import (
    FreeRun,
    Linearisation,
    OutputGap,
    ResidualTests,
    WindowErrors,
)
from robustlab.identification.comparison.input_disturbance import InputDisturbance, located
from robustlab.identification.comparison.localisation import (
    Bin,
    DirectionError,
    Motion,
    NoiseGap,
    Spectrum,
)
from robustlab.identification.comparison.noise_floor import NoiseFloor
from robustlab.identification.comparison.residual_tests import EvenOdd
from robustlab.identification.response.windowed_simulation import InitialState
from robustlab.record import Record
from robustlab.result import Evidence, Status
from robustlab.shown import Each, Facts, number
from robustlab.tables import Table, Tabular

POSE = ("tx", "ty", "tz", "ax", "ay", "az")
LINEAR = 0.5  # bands whose coherence is lower say nothing about a linear model
MOST_INPUTS_TOLD = 3  # one by one
ROUNDING = 1e-9  # a residual below this share of the range is rounding, and no test of it means anything

REFERENCE = (
    "output-error model y = G(u) + e with white e independent of u; tested on the recursive residual of the windows "
    "(each sample predicted from the samples of the same output before it in its window)"
)


@dataclass(frozen=True)
class Comparison(Tabular, Evidence):
    """Result of `compare`.

    Attributes
    ----------
    status
        CONVERGED: both simulations are finite and every number follows from the series kept here.
    model, record
        What was compared.
    outputs
        Output name -> `OutputGap`.
    windows
        Output name -> `WindowErrors`.
    speed, position
        Output name -> bins of the windowed error over the measured speed and position; empty where neither is recorded.
    motions
        Output name -> the speed and position signals used for that: one for all, or of several joints each its own.
    frequency
        Output name -> `Spectrum`; empty where the free run does not reach the end of the record.
    residual
        Output name -> `ResidualTests`.
    initial_state
        Where the free run starts.
    window
        Length of the windows in s.
    measured, simulated, windowed, recursive
        The compared signals: measured, free run (as far as it goes; None where that is nowhere), windowed simulation,
        and the recursive residual (n,) by output, NaN where a sample only fixes the state of its window.
    disturbance
        Input name, or a joint as ``torque at omega`` -> the `InputDisturbance` there, and nowhere else, with which the
        model follows the record best. Joints alone of a nonlinear plant; empty for a discrete model and an uneven
        clock.
    warnings
        What a reader must know before trusting the numbers.
    direction
        Output name -> windowed error moving backward, at rest, moving forward; empty where no speed is known.
    amplitude
        Output name -> input name -> bins of the windowed error over the magnitude of the input (its deviation from the
        operating point); inputs that are constant are left out.
    noise, noise_reason
        Noise floor where the record repeats, else None and the reason why there is none.
    against_noise
        Output name -> `NoiseGap`; empty without a noise floor.
    linear, linear_reason
        Output name -> input name -> `BestLinearApproximation` beside the model's response; the reason where one is
        missing.
    nonlinearity
        Even/odd test; its ``reason`` says why it could not be made, or not wholly.
    free_run
        How far the free run goes.
    linearisation
        Of a nonlinear plant, what the windows' linearisation is worth; None of a linear one.
    sensor_noise
        Of a nonlinear plant: output name -> standard deviation of its samples about the smooth motion that they tell,
        in its unit. Empty of a linear one.
    left_out
        What is not told, and why.
    pose
        Of a machine with poses: its pose in the middle of the `worst` window, m and rad; else empty.
    """

    status: Status
    model: str
    record: str
    outputs: Mapping[str, OutputGap]
    windows: Mapping[str, WindowErrors]
    speed: Mapping[str, tuple[Bin, ...]]
    position: Mapping[str, tuple[Bin, ...]]
    motions: Mapping[str, Motion]
    frequency: Mapping[str, Spectrum]
    residual: Mapping[str, ResidualTests]
    initial_state: InitialState
    window: float
    measured: Record
    simulated: Record | None
    windowed: Record
    recursive: Mapping[str, Array]
    disturbance: Mapping[str, InputDisturbance]
    warnings: tuple[str, ...]
    direction: Mapping[str, Mapping[str, DirectionError]]
    amplitude: Mapping[str, Mapping[str, tuple[Bin, ...]]]
    noise: NoiseFloor | None
    noise_reason: str
    against_noise: Mapping[str, NoiseGap]
    linear: Mapping[str, Mapping[str, BestLinearApproximation]]
    linear_reason: str
    nonlinearity: EvenOdd
    free_run: FreeRun
    linearisation: Linearisation | None = None
    sensor_noise: Mapping[str, float] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    pose: Mapping[str, float] = field(default_factory=dict)

    percent_of: ClassVar[str] = "measured range (max - min) of the output"
    residual_reference: ClassVar[str] = REFERENCE
    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("model", "record", "percent_of", "residual_reference"), str),
        "outputs": Each("outputs", OutputGap),
        "windows": Each("outputs", WindowErrors),
        "worst_window": Each("outputs", ("s", "s")),
        "worst": {"output": str, "start": "s", "stop": "s", "pose": dict.fromkeys(POSE, float)},
        "residual": Each("outputs", ResidualTests),
        "direction": Each("outputs", {"*": DirectionError}),
        "amplitude": Each("outputs", {"*": [Bin]}),
        "disturbance": Each("inputs", InputDisturbance, ("torque at *", "force at *")),
        "nonlinearity": EvenOdd,
        "initial_state": InitialState,
        "free_run": FreeRun,
        "linearisation": Linearisation,
        "sensor_noise": Each("outputs", "*"),
        "window": "s",
        "left_out": [str],
        "warnings": [str],
        **dict.fromkeys(("speed", "position", "frequency", "noise", "linear"), ...),
    }

    @property
    def worst_window(self) -> dict[str, tuple[float, float]]:
        """Output name -> first and last time in s of the window with its largest error."""
        return {name: (float(w.start[w.worst]), float(w.stop[w.worst])) for name, w in self.windows.items()}

    @property
    def worst(self) -> dict[str, Any]:
        """The output with the largest windowed error of its range, its worst window in s, and the pose amid that."""
        name = max(self.outputs.values(), key=lambda gap: gap.windowed_rms_percent).name
        start, stop = self.worst_window[name]
        return {"output": name, "start": start, "stop": stop, **({"pose": self.pose} if self.pose else {})}

    @property
    def located(self) -> tuple[InputDisturbance, ...]:
        """Disturbances that explain half of the error as well as the best one does; inputs first."""
        return located(self.disturbance)

    def summary(self) -> str:
        """The result as a few lines of text."""
        return _text(self)

    def headline(self) -> str:
        """The output that is furthest off, in free run where that is whole, else in windows."""
        if self.free_run.whole:
            most = max(self.outputs.values(), key=lambda gap: gap.rms_percent)
            size, how = most.rms_percent, "in free run"
            when = f"most at {number(most.peak_time, 's', 3)}"
        else:
            most = max(self.outputs.values(), key=lambda gap: gap.windowed_rms_percent)
            size, how = most.windowed_rms_percent, f"in windows of {number(self.window, 's', 3)}"
            when = f"the free run ends at {number(self.free_run.end, 's', 3)}"
        return f"against {self.record}: {how} {most.name} is off by {size:.3g} % of its range (rms); {when}"

    def facts(self) -> Facts:
        """What was compared, the error of each output in windows, then in free run, and where it is largest."""
        gaps = [
            (
                f"{name}: in windows",
                f"rms error {number(g.windowed_rms, g.unit)} ({g.windowed_rms_percent:.3g} % of its range)",
            )
            for name, g in self.outputs.items()
        ]
        end = "" if self.free_run.whole else f"ends at {number(self.free_run.end, 's')}: {self.free_run.reason}"
        return [
            ("model", self.model),
            ("record", f"{self.record}: {self.measured.n} samples, {number(self.measured.duration, 's')}"),
            *gaps,
            ("windows", f"of {number(self.window, 's')}, each from its best start"),
            ("free run", end),
            *(fact for name in self.outputs for fact in self._more(name)),
            ("worst of all", self._worst_in_words()),
            *(("warning", text) for text in self.warnings),
        ]

    def _more(self, name: str) -> Facts:
        """The error of an output in free run and in windows, and where the windowed error is largest."""
        g, motion = self.outputs[name], self.motions[name]
        free = _errors(g.unit, g.peak, g.peak_percent, g.rms, g.rms_percent, g.fit) if self.free_run.whole else ""
        sizes = g.windowed_peak, g.windowed_peak_percent, g.windowed_rms, g.windowed_rms_percent, g.windowed_fit
        places = ["{:.3g} to {:.3g} s".format(*self.worst_window[name])]
        for bins, over, unit in (
            (self.speed.get(name), "of speed", motion.speed_unit),
            (self.position.get(name), "of position", motion.position_unit),
        ):
            if bins:
                worst = max(bins, key=lambda b: b.rms)
                places.append(f"{worst.low:.3g} to {worst.high:.3g} {unit} {over}")
        return [
            (f"{name}: free run", free),
            (f"{name}: restarted every {number(self.window, 's', 3)}", _errors(g.unit, *sizes)),
            (f"{name}: where", f"windowed error largest at {'; at '.join(places)}"),
        ]

    def _worst_in_words(self) -> str:
        worst = self.worst
        text = f"{worst['output']}, {worst['start']:.3g} to {worst['stop']:.3g} s"
        axes = [f"{axis} {1e3 * v:.3g} {'mm' if axis[0] == 't' else 'mrad'}" for axis, v in self.pose.items()]
        return f"{text}, at the pose {', '.join(axes)}" if axes else text

    def numbers(self) -> dict[str, Any]:
        """All but the time series, and the `worst`."""
        return {**self.to_json(series=False), "worst": self.worst}

    def table(self) -> Table:
        """A row for each output: sizes of its error in its unit."""
        names = ("range", "rms", "peak", "fit", "windowed_rms", "windowed_peak", "windowed_fit", "unit")
        columns = {key: [getattr(gap, key) for gap in self.outputs.values()] for key in names}
        return Table(("output", list(self.outputs)), columns, {"fit": "%", "windowed_fit": "%"})

    def to_json(self, series: bool = True) -> dict[str, object]:
        """All fields; without ``series`` the time series and the densities over frequency are left out."""
        data: dict[str, object] = {
            "status": self.status,
            "model": self.model,
            "record": self.record,
            "percent_of": self.percent_of,
            "outputs": self.outputs,
            "windows": self.windows,
            "worst_window": self.worst_window,
            "speed": {**self._of_motions(signal="speed_source", unit="speed_unit"), "bins": self.speed},
            "position": {**self._of_motions(signal="position_name", unit="position_unit"), "bins": self.position},
            "frequency": {name: s.to_json() if series else s.band_table() for name, s in self.frequency.items()},
            "direction": self.direction,
            "amplitude": self.amplitude,
            "noise": {"floor": self.noise, "reason": self.noise_reason, "outputs": self.against_noise},
            "linear": {
                "reason": self.linear_reason,
                "outputs": {
                    y: {u: g.to_json() if series else g.band_table() for u, g in row.items()}
                    for y, row in self.linear.items()
                },
            },
            "nonlinearity": self.nonlinearity,
            "disturbance": self.disturbance,
            "residual_reference": REFERENCE,
            "residual": self.residual,
            "initial_state": self.initial_state,
            "free_run": self.free_run,
            "linearisation": self.linearisation,
            "sensor_noise": self.sensor_noise,
            "left_out": list(self.left_out),
            "window": self.window,
            "warnings": list(self.warnings),
        }
        if series:
            data |= {
                "t": self.measured.t,
                "input": self.measured.inputs,
                "measured": self.measured.outputs,
                "simulated": self.simulated.outputs if self.simulated else {},
                "windowed": self.windowed.outputs,
            }
        return data

    def _of_motions(self, **fields: str) -> dict[str, object]:
        """These fields of the motion, or of each output's own by its name."""
        alike = all(m is next(iter(self.motions.values())) for m in self.motions.values())
        told = {key: {y: getattr(m, name) for y, m in self.motions.items()} for key, name in fields.items()}
        return {key: next(iter(by.values())) if alike else by for key, by in told.items()}


# --- the text --------------------------------------------------------------------------------------------------------


def _text(c: Comparison) -> str:
    """A dozen lines: sizes of the gap, where it lives, what the residual tests say, warnings."""
    head = (
        f"{c.model} against {c.record}: {c.measured.n} samples, {c.measured.duration:.4g} s; "
        f"windows of {c.window:.4g} s; percent of the record's range"
    )
    lines = [head, *_run_lines(c)]
    for name in c.outputs:
        lines += ["", *_gap_lines(c, name), *_noise_lines(c, name), *_place_lines(c, name)]
        lines += [*_response_lines(c, name), *_residual_lines(c, name)]
    lines += ["", *_repetition_lines(c), *_harmonic_lines(c)]
    lines += _disturbance_lines(c)
    lines += ["", *(f"left out: {text}" for text in c.left_out)] if c.left_out else []
    if c.warnings:
        lines += ["", *(f"warning: {text}" for text in c.warnings)]
    return "\n".join(lines)


def _errors(unit: str, peak: float, peak_percent: float, rms: float, rms_percent: float, fit: float) -> str:
    peak_text = f"peak {number(peak, unit, 3)} ({peak_percent:.3g} % of the range)"
    return f"{peak_text}, rms {number(rms, unit, 3)} ({rms_percent:.3g} %), fit {fit:.4g} %"


def _run_lines(c: Comparison) -> list[str]:
    """What the free run and the linearisation of the windows are worth."""
    lines: list[str] = []
    if not c.free_run.whole:
        lines.append(
            f"free run: ends at {c.free_run.end:.4g} s of {c.measured.t[-1]:.4g} s ({c.free_run.reason}); "
            "what follows is of the windows only"
        )
    if c.linearisation is not None and len(c.linearisation.windows):
        name = max(c.linearisation.share, key=lambda key: c.linearisation.share[key] if c.linearisation else 0.0)
        lines.append(
            f"windows: linear about the recorded motion; from the same starts the nonlinear plant differs in "
            f"{len(c.linearisation.windows)} of {len(next(iter(c.windows.values())).start)} windows by at most "
            f"{_percent(c.linearisation.share[name])} of the error ({name}, "
            f"{c.linearisation.difference[name]:.2g} {c.outputs[name].unit})"
        )
    return lines


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def _gap_lines(c: Comparison, name: str) -> list[str]:
    g = c.outputs[name]
    unit = f" {g.unit}" if g.unit else ""
    free = (
        f"  free run   peak {g.peak:.4g}{unit} ({g.peak_percent:.3g} %) at {g.peak_time:.4g} s, "
        f"rms {g.rms:.4g}{unit} ({g.rms_percent:.3g} %), fit {g.fit:.2f} %"
    )
    windowed = (
        f"  windowed   peak {g.windowed_peak:.4g}{unit} ({g.windowed_peak_percent:.3g} %), "
        f"rms {g.windowed_rms:.4g}{unit} ({g.windowed_rms_percent:.3g} %), fit {g.windowed_fit:.2f} %"
    )
    lines = [f"{name}: range {g.range:.4g}{unit}", *([free] if c.free_run.whole else []), windowed]
    if noise := c.sensor_noise.get(name):
        lines.append(
            f"  sensor     its samples scatter by {noise:.3g}{unit} about a smooth motion; "
            f"the windowed error is {g.windowed_rms / noise:.3g} times that"
        )
    return lines


def _place_lines(c: Comparison, name: str) -> list[str]:
    w = c.windows[name]
    time = (
        f"  time       worst window {w.start[w.worst]:.4g} to {w.stop[w.worst]:.4g} s holds "
        f"{100 * w.windowed_share[w.worst]:.1f} % of the windowed squared error "
        f"({100 / len(w.start):.1f} % if spread evenly)"
    )
    return [time, *_speed_lines(c, name), *_amplitude_lines(c, name), *_frequency_lines(c, name)]


def _frequency_lines(c: Comparison, name: str) -> list[str]:
    s = c.frequency.get(name)
    if s is None:
        return []
    top = int(s.error_share.argmax())
    text = (
        f"  frequency  {s.bands[top]:.3g} to {s.bands[top + 1]:.3g} Hz holds {100 * s.error_share[top]:.0f} % of the "
        f"free run's squared error, where it is {100 * s.relative_error[top]:.3g} % of the recorded signal"
    )
    return [text]


def _speed_lines(c: Comparison, name: str) -> list[str]:
    if name not in c.speed:
        return []
    b = c.speed[name]
    rest = len(b) // 2
    parts = {"backward": b[:rest], "rest": b[rest : rest + 1], "forward": b[rest + 1 :]}
    shares = ", ".join(f"{word} {100 * sum(x.share for x in part):.0f} %" for word, part in parts.items())
    worst = max(b, key=lambda x: x.rms)
    text = (
        f"  speed      windowed squared error: {shares}; largest rms {worst.rms:.3g} {c.outputs[name].unit} "
        f"at {worst.low:.3g} to {worst.high:.3g} {c.motions[name].speed_unit}"
    )
    return [text]


def _amplitude_lines(c: Comparison, name: str) -> list[str]:
    lines: list[str] = []
    for u, bins in c.amplitude[name].items():
        filled = [b for b in bins if b.samples]
        least, most = min(filled, key=lambda b: b.rms), max(filled, key=lambda b: b.rms)
        unit, of_input = c.outputs[name].unit, c.measured.unit(u)
        text = (
            f"  amplitude  windowed rms {least.rms:.3g} {unit} at |{u}| {least.low:.3g} to {least.high:.3g} {of_input}"
            f", {most.rms:.3g} {unit} at {most.low:.3g} to {most.high:.3g} {of_input}"
        )
        lines.append(text)
    return lines


def _noise_lines(c: Comparison, name: str) -> list[str]:
    gap = c.against_noise.get(name)
    if gap is None:
        return []
    unit = c.outputs[name].unit
    if gap.rms_percent is None or gap.windowed_rms_percent is None or gap.excess.F is None:
        return ["  noise      none: the repeats are equal to the last bit"]
    e = gap.excess
    verdict = "the model leaves something to explain" if (e.p_value or 0.0) < 0.01 else "nothing is left to explain"
    free = f"{_times(gap.rms_percent)} (free run), " if c.free_run.whole else ""
    text = (
        f"  noise      {gap.std:.3g} {unit} a sample; the error is {free}"
        f"{_times(gap.windowed_rms_percent)} (windowed) the noise"
    )
    test = (
        f"             {verdict}: F {e.F:.4g} (p {_p(e.p_value or 0.0)}); "
        f"of the windowed error {e.repeatable:.3g} {unit} repeat, {e.noise:.3g} {unit} do not"
    )
    return [text, test]


def _times(percent: float) -> str:
    return f"{percent / 100:.3g} times"


def _response_lines(c: Comparison, name: str) -> list[str]:
    lines: list[str] = []
    for u, g in c.linear.get(name, {}).items():
        head = f"  response   {u} to {name} ({g.method}): "
        known = [k for k, share in enumerate(g.band_coherence()) if share is not None and share >= LINEAR]
        errors = [(error, k) for k in known if (error := g.relative_error[k]) is not None]
        if not errors:
            lines.append(f"{head}nowhere linear in the input (coherence below {LINEAR:g} in all bands)")
            continue
        (least, a), (most, b) = min(errors), max(errors)
        text = f"{head}model off by {100 * most:.3g} % at {g.bands[b]:.3g} to {g.bands[b + 1]:.3g} Hz"
        if a != b:
            text += f", {100 * least:.3g} % at {g.bands[a]:.3g} to {g.bands[a + 1]:.3g} Hz"
        if len(known) < len(g.bands) - 1:
            text += (
                f" (coherence above {LINEAR:g} from {g.bands[known[0]]:.3g} to {g.bands[known[-1] + 1]:.3g} Hz only)"
            )
        lines.append(text)
        size = np.abs(g.response)
        if g.noise_std is not None and g.nonlinear_std is not None and (size > 0).all():
            distortion, noise = (100 * np.median(s / size) for s in (g.nonlinear_std, g.noise_std))
            text = (
                f"             no linear model explains {distortion:.2g} % of the response (nonlinear distortion; "
                f"noise {noise:.2g} %; medians over {len(size)} lines)"
            )
            lines.append(text)
    return lines


def _repetition_lines(c: Comparison) -> list[str]:
    n = c.noise
    if n is None:
        return [f"noise floor: none ({c.noise_reason})"]
    what = (
        f"{n.count} records with the same input"
        if n.period is None
        else f"{n.count} periods of {n.period:.6g} s ({n.signal or 'stated'})"
    )
    fed_back = ", ".join(f"{name} {s:.3g} {c.measured.units.get(name, '')}".rstrip() for name, s in n.input_std.items())
    closed = f"; not repeated exactly, so fed back by a controller: {fed_back}" if fed_back else ""
    return [f"noise floor: from {what}{closed}", *(f"             {note}" for note in n.notes)]


def _harmonic_lines(c: Comparison) -> list[str]:
    t = c.nonlinearity
    if not t.signals:
        return [f"even/odd nonlinearity: {t.reason}"]
    lines = [f"even/odd nonlinearity, from {t.excitation}:"]
    lines += [f"  {name}: {s.words()} of its power" for name, s in t.signals.items()]
    return [*lines, *([f"  {t.reason}"] if t.reason else [])]


def _disturbance_lines(c: Comparison) -> list[str]:
    """Where a disturbance would explain the error, and its means; the best place where none does."""
    if not c.disturbance:
        return []
    best = max(c.disturbance.values(), key=lambda d: d.explained_share)
    head = [] if c.located else [f"no disturbance at one place explains half of the error (best {best.place})"]
    return ["", *head, *(f"disturbance at {d.place}: {_disturbance(d)}" for d in c.located or (best,))]


def _disturbance(d: InputDisturbance) -> str:
    """Its size, its share of the error, and the means that are sure to differ from zero."""
    means = [f"{mean:+.3g} +- {std:.2g} {d.unit}".rstrip() + f" {way}" for way, (mean, std) in d.sure_means.items()]
    text = f"rms {number(d.rms, d.unit, 3)}, {100 * d.explained_share:.0f} % of the squared error goes"
    return f"{text}; mean {', '.join(means)}" if means else f"{text}; no mean that differs from zero"


def _residual_lines(c: Comparison, name: str) -> list[str]:
    r = c.residual[name]
    w = r.whiteness
    if r.rms <= ROUNDING * c.outputs[name].range:
        return [f"  residual   zero to rounding (rms {r.rms:.1g} {c.outputs[name].unit})"]
    past = (
        f"  residual   {_verdict(w.p_value, 'white', 'not white')} (Ljung-Box {w.statistic:.4g}, {w.dof} lags, "
        f"p {_p(w.p_value)}); {100 * w.predictable_share:.1f} % of its variance is predictable from its past"
    )
    if len(r.inputs) > MOST_INPUTS_TOLD:
        return [past, _many_inputs(r)]
    lines = [past]
    for u, test in r.inputs.items():
        text = (
            f"  input {u + ' ':<5}{_verdict(test.p_value, 'independent of the residual', 'still in the residual')} "
            f"(statistic {test.statistic:.4g}, {test.dof} degrees, p {_p(test.p_value)}); "
            f"explains {100 * test.explained_share:.1f} % of its variance; "
            f"largest correlation {np.abs(test.correlation).max():.3f} (99 % band {test.band:.3f})"
        )
        lines.append(text)
    return lines


def _many_inputs(r: ResidualTests) -> str:
    found = {u: test for u, test in r.inputs.items() if test.p_value < 0.01}
    if not found:
        return f"  inputs     the residual is independent of all {len(r.inputs)}"
    most = max(found, key=lambda u: found[u].explained_share)
    return (
        f"  inputs     {len(found)} of {len(r.inputs)} still in the residual; {most} explains most of its variance, "
        f"{100 * found[most].explained_share:.1f} %"
    )


def _verdict(p_value: float, accepted: str, rejected: str) -> str:
    return accepted if p_value >= 0.01 else rejected


def _p(p_value: float) -> str:
    return f"{p_value:.2g}" if p_value > 1e-6 else "< 1e-6"
