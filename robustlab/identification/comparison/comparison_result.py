"""Result of `compare`: the model error at every output, its distribution, and the tests of the residual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from robustlab.display import Each, Facts, listed, number
from robustlab.identification.comparison.error_analysis import (
    Bin,
    FreeRun,
    InputDisturbance,
    Linearisation,
    Motion,
    OutputGap,
    ResidualTests,
    Spectrum,
    WindowErrors,
)
from robustlab.identification.comparison.repeats import Excess, NoiseFloor
from robustlab.identification.response.windowed_simulation import InitialState
from robustlab.record import Record
from robustlab.result import Evidence, Status, Table, Tabular

# Fields that become JSON in another form, or not at all.
NOT_AS_IT_IS = ("measured", "simulated", "windowed", "noise_reason", "against_noise")
EXPLAINS = 0.5  # share of the squared error that a located disturbance removes at least
TIE = 2.0  # times the best: squared error that remains with another place that is as good
ROUNDING = 1e-9  # a residual below this share of the range is rounding and is not tested


@dataclass(frozen=True)
class Comparison(Tabular, Evidence):
    """Result of `compare`.

    Attributes
    ----------
    status
        CONVERGED: both simulations are finite and every number follows from the series kept here.
    model, record
        Names of the compared model and record.
    outputs
        Output name -> `OutputGap`.
    windows
        Output name -> `WindowErrors`.
    speed, position
        Output name -> bins of the windowed error over the measured speed and position; empty where neither is recorded.
    motions
        Output name -> the speed and position signals used for that: one for all, or one per joint.
    frequency
        Output name -> `Spectrum`; empty where the free run does not reach the end of the record.
    residual
        Output name -> `ResidualTests`.
    initial_state
        Initial state of the free run.
    window
        Length of the windows in s.
    measured, simulated, windowed
        The compared signals: measured, free run (None if it ends at once), windowed simulation.
    disturbance
        Input name, or a joint as ``torque at omega`` -> the single `InputDisturbance` there with which the model
        reproduces the record best. Joints only for a nonlinear plant; empty for a discrete model and a nonuniform time
        base.
    warnings
        Limits of the numbers.
    direction
        Output name -> windowed error moving backward, at standstill, moving forward; empty without a known speed.
    noise, noise_reason
        Noise floor where the record repeats, else None and the reason why there is none.
    against_noise
        Output name -> `Excess` of the windowed error, with windows at the same phases of every period. Its ``noise`` is
        larger than the sensor's in closed loop, where noise also enters at the input. Empty without a noise floor.
    free_run
        Extent of the free run.
    linearisation
        Linearisation error of the windows of a nonlinear plant; None for a linear one.
    sensor_noise
        For a nonlinear plant: output name -> standard deviation of its samples about the smoothed motion, in its unit.
        Empty for a linear one.
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
    disturbance: Mapping[str, InputDisturbance]
    warnings: tuple[str, ...]
    direction: Mapping[str, Mapping[str, Bin]]
    noise: NoiseFloor | None
    noise_reason: str
    against_noise: Mapping[str, Excess]
    free_run: FreeRun
    linearisation: Linearisation | None = None
    sensor_noise: Mapping[str, float] = field(default_factory=dict)

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("model", "record"), str),
        "outputs": Each("outputs", OutputGap),
        "windows": Each("outputs", WindowErrors),
        "worst_window": Each("outputs", ("s", "s")),
        "worst": {"output": str, "start": "s", "stop": "s"},
        "residual": Each("outputs", ResidualTests),
        "direction": Each("outputs", {"*": Bin}),
        "disturbance": Each("inputs", InputDisturbance, ("torque at *", "force at *")),
        "initial_state": InitialState,
        "free_run": FreeRun,
        "linearisation": Linearisation,
        "sensor_noise": Each("outputs", "*"),
        "window": "s",
        "warnings": [str],
        **dict.fromkeys(("speed", "position", "frequency", "noise"), ...),
    }

    @property
    def worst_window(self) -> dict[str, tuple[float, float]]:
        """Return output name -> first and last time in s of the window with its largest error."""
        return {name: (float(w.start[w.worst]), float(w.stop[w.worst])) for name, w in self.windows.items()}

    @property
    def worst(self) -> dict[str, Any]:
        """Return the output with the largest windowed error over its range, its and its worst window in s."""
        name = max(self.outputs.values(), key=lambda gap: gap.windowed_rms_percent).name
        start, stop = self.worst_window[name]
        return {"output": name, "start": start, "stop": stop}

    @property
    def located(self) -> tuple[InputDisturbance, ...]:
        """Return the best disturbances that explain half of the error, and equally good ones; inputs first."""
        found = self.disturbance.values()
        left = min((1.0 - d.explained_share for d in found), default=1.0)
        good = [d for d in found if d.explained_share >= EXPLAINS and 1.0 - d.explained_share <= TIE * left]
        return tuple(sorted(good, key=lambda d: (not d.place.startswith("input "), -d.explained_share)))

    def headline(self) -> str:
        """Report the output with the largest error, in free run where that is complete, else in windows."""
        free, gaps = self.free_run, self.outputs.values()
        if free.whole:
            most = max(gaps, key=lambda gap: gap.rms_percent)
            size, how, when = most.rms_percent, "in free run", f"most at {number(most.peak_time, 's', 3)}"
        else:
            most = max(gaps, key=lambda gap: gap.windowed_rms_percent)
            size, how = most.windowed_rms_percent, f"in windows of {number(self.window, 's', 3)}"
            when = f"the free run ends at {number(free.end, 's', 3)}"
        return f"against {self.record}: {how} {most.name} is off by {size:.3g} % of its range (rms); {when}"

    def facts(self) -> Facts:
        gaps = [(f"{name}: in windows", _errors(g, "windowed_")) for name, g in self.outputs.items()]
        end = "" if self.free_run.whole else f"ends at {number(self.free_run.end, 's')}: {self.free_run.reason}"
        return [
            ("model", self.model),
            ("record", f"{self.record}: {self.measured.n} samples, {number(self.measured.duration, 's')}"),
            *gaps,
            ("windows", f"of {number(self.window, 's')}, each from its best start"),
            ("free run", end),
            ("windows linear about the motion", self._linear_in_words()),
            *(fact for name in self.outputs for fact in self._more(name)),
            ("worst of all", "{output}, {start:.3g} to {stop:.3g} s".format(**self.worst)),
            *self._missing(),
            ("noise floor", self._floor_in_words()),
            *(("warning", text) for text in self.warnings),
        ]

    def _more(self, name: str) -> Facts:
        g, motion = self.outputs[name], self.motions[name]
        free = _errors(g, "") if self.free_run.whole else ""
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
            (f"{name}: where", f"windowed error largest at {'; at '.join(places)}"),
            (f"{name}: noise", self._noise_in_words(name)),
            (f"{name}: residual", self._residual_in_words(name)),
        ]

    def _noise_in_words(self, name: str) -> str:
        """Report the windowed error in multiples of the noise: of the repeats, else of the sensor's scatter."""
        g, e, scatter = self.outputs[name], self.against_noise.get(name), self.sensor_noise.get(name)
        std = self.noise.std[name] if self.noise else scatter
        if not std:
            return "none: the repeats are equal to the last bit" if e else ""
        size = f"{number(std, g.unit, 3)}; the windowed error is {g.windowed_rms / std:.3g} times that"
        if e is None:
            return size
        if e.F is None or e.p_value is None:
            return "none: the repeats are equal to the last bit"
        verdict = "the model leaves something to explain" if e.p_value < 0.01 else "nothing is left to explain"
        return f"{size}; {verdict} (F {e.F:.4g}, p {_p(e.p_value)})"

    def _residual_in_words(self, name: str) -> str:
        r, unit = self.residual[name], self.outputs[name].unit
        if r.rms <= ROUNDING * self.outputs[name].range:
            return f"zero to rounding (rms {number(r.rms, unit, 1)})"
        left = sorted((u for u, test in r.inputs.items() if test.p_value < 0.01), key=lambda u: r.inputs[u].p_value)
        white = "white" if r.whiteness.p_value >= 0.01 else "not white"
        share = f"{100 * r.whiteness.explained_share:.1f} % of its variance is predictable from its past"
        rest = f"{listed(left)} still in it" if left else "independent of the inputs"
        return f"{white} (p {_p(r.whiteness.p_value)}), {share}; {rest}"

    def _linear_in_words(self) -> str:
        found = self.linearisation
        if found is None or not len(found.windows):
            return ""
        name = max(found.share, key=lambda key: found.share[key])
        size = number(found.difference[name], self.outputs[name].unit, 2)
        return f"within {100 * found.share[name]:.2g} % of the error ({name}, {size}) in {len(found.windows)} windows"

    def _floor_in_words(self) -> str:
        n = self.noise
        if n is None:
            return f"none ({self.noise_reason})"
        spread = ", ".join(number(v, self.measured.units.get(u, ""), 3) + f" at {u}" for u, v in n.input_std.items())
        fed_back = [f"fed back by a controller: {spread}"] if spread else []
        return "; ".join([f"from {n.count} periods of {n.period:.6g} s ({n.signal})", *fed_back, *n.notes])

    def _missing(self) -> Facts:
        if not self.disturbance:
            return []
        if not self.located:
            best = max(self.disturbance.values(), key=lambda d: d.explained_share)
            text = f"no disturbance at one place explains half of the error (best {best.place}, "
            return [("missing", f"{text}{100 * best.explained_share:.0f} %)")]
        found: Facts = []
        for d in self.located:
            means = [f"{mean:+.3g} +- {number(std, d.unit, 2)} {way}" for way, (mean, std) in d.sure_means.items()]
            mean_text = ", ".join(means) or "no mean that differs from zero"
            share = f"{100 * d.explained_share:.0f} % of the squared error goes"
            found.append((f"missing: {d.place}", f"rms {number(d.rms, d.unit, 3)}; {mean_text}; {share}"))
        return found

    def numbers(self) -> dict[str, Any]:
        """Return all but the time series, and the `worst`."""
        return {**self.to_json(series=False), "worst": self.worst}

    def table(self) -> Table:
        """Return a row for each output: sizes of its error in its unit."""
        names = ("range", "rms", "peak", "fit", "windowed_rms", "windowed_peak", "windowed_fit", "unit")
        columns = {key: [getattr(gap, key) for gap in self.outputs.values()] for key in names}
        return Table(("output", list(self.outputs)), columns, {"fit": "%", "windowed_fit": "%"})

    def to_json(self, series: bool = True) -> dict[str, object]:
        """Return all fields; without ``series`` no time series and no densities over frequency."""
        bands = {name: {"bands": f.bands, "error_share": f.error_share} for name, f in self.frequency.items()}
        data: dict[str, object] = {
            **{key: value for key, value in vars(self).items() if key not in NOT_AS_IT_IS},
            "worst_window": self.worst_window,
            "motions": {name: m.named() for name, m in self.motions.items()},
            "frequency": self.frequency if series else bands,
            "noise": {"floor": self.noise, "reason": self.noise_reason, "outputs": self.against_noise},
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


def _errors(gap: OutputGap, of: str) -> str:
    peak, peak_percent, rms, rms_percent, fit = (
        float(getattr(gap, of + key)) for key in ("peak", "peak_percent", "rms", "rms_percent", "fit")
    )
    peak_text = f"peak {number(peak, gap.unit, 3)} ({peak_percent:.3g} % of the range)"
    return f"{peak_text}, rms {number(rms, gap.unit, 3)} ({rms_percent:.3g} %), fit {fit:.4g} %"


def _p(p_value: float) -> str:
    return f"{p_value:.2g}" if p_value > 1e-6 else "< 1e-6"
