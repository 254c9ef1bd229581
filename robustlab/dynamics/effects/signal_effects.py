"""Effects on one signal on its way in or out: gains, delays, limits, errors of a sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numba as nb
import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.load_effects import order_prior
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel
from robustlab.errors import InputError


class SignalGain(Effect):
    """The signal times s."""

    gain_like = True
    scale = "s"
    spread: float  # standard deviation of log s
    meaning: str  # of s, in words

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("s", "", self.meaning, Prior("log", 1.0, self.spread)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return ({"s": 1.0 + self.spread}, {"s": 1.0 - self.spread})

    def scaled(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        """``s signal``."""
        return values["s"] * signal

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, self.site_kind, values["s"], values["s"])


class SignalDelay(Effect):
    """The signal d seconds late."""

    delay = "d"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("d", "s", "delay", Prior("log", 3.0 * scales.dt, 1.2)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"d": steps * scales.dt} for steps in (1.0, 4.0, 15.0))

    def steps(self, values: Mapping[str, float], h: float) -> float:
        """The delay in steps of h seconds."""
        if values["d"] < 0.0:
            raise InputError(f"effect {self.id}: d", f"{values['d']:g} s", "a delay of 0 s or more")
        return values["d"] / h

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, self.site_kind, 1.0, 1.0, delay=values["d"])


class InputGain(SignalGain):
    """Input gain: the plant gets a multiple of the commanded input."""

    id = "input-gain"
    title = "Input gain"
    equation = "u' = s u"
    independently = "measure the driver's output voltage over the command"
    site_kind = "input"
    spread = 0.1
    meaning = "what acts over what was commanded"
    input = SignalGain.scaled
    tolerance = 0.0  # it is what forces are measured in


class InputDelay(SignalDelay):
    """Input delay: the plant sees the input d seconds late."""

    id = "input-delay"
    title = "Input delay"
    equation = "u'(t) = u(t - d)"
    independently = "put command and driver output on an oscilloscope with one trigger"
    site_kind = "input"

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        steps = self.steps(values, h)
        whole = int(min(steps, len(signal)))
        part = min(1.0, steps - whole)
        k = np.arange(len(signal)) - whole  # before the first sample the first value was held
        return (1.0 - part) * signal[np.maximum(k, 0)] + part * signal[np.maximum(k - 1, 0)]


class InputDeadZone(Effect):
    """Dead zone of the driver: it drops a constant voltage, or needs one before anything comes out."""

    id = "input-dead-zone"
    title = "Dead zone or drop of the driver"
    equation = "u' = u - d sgn(u), 0 for |u| < d"
    independently = "measure the driver's output voltage at small commands"
    constant_loss = "voltage"
    site_kind = "input"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 0.04 * scales.input, 1.0)
        return (EffectParameter("d", scales.signal_unit, "half width of the dead zone", prior),)

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.sign(signal) * np.maximum(np.abs(signal) - values["d"], 0.0)

    def input_error(self, values: Mapping[str, float]) -> float:
        return values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        return Footprint(site.name, "input", 0.0, max(0.0, 1.0 - values["d"] / amplitude))


class InputSaturation(Effect):
    """Saturation of the input: the driver gives no more than :math:`u_{max}` either way."""

    id = "input-saturation"
    title = "Saturation of the input"
    equation = "u' = clip(u, -u_max, u_max)"
    independently = "measure the driver's output voltage at full command"
    site_kind = "input"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("share", 0.75 * scales.input, 1.0, top=scales.input)
        return (EffectParameter("u_max", scales.signal_unit, "largest input that acts", prior),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"u_max": share * scales.input} for share in (0.6, 0.8, 0.94))

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.clip(signal, -values["u_max"], values["u_max"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "input", min(1.0, values["u_max"] / amplitude), 1.0)


@nb.njit(cache=True)
def _lagged_means(u, step):  # type: ignore[no-untyped-def]
    """Mean of the lagged input over each step of the length ``step`` in units of T, (n,)."""
    left, mean = math.exp(-step), -math.expm1(-step) / step
    means, x = np.empty(len(u)), u[0]
    for k in range(len(u)):
        means[k] = u[k] + (x - u[k]) * mean
        x = u[k] + (x - u[k]) * left
    return means


class ActuatorLag(Effect):
    """Lag of the actuator: its output follows the input in first order."""

    id = "actuator-lag"
    title = "Lag of the actuator"
    equation = "T du'/dt = u - u'"
    independently = "put command and driver output on an oscilloscope and step the command"
    site_kind = "input"
    time_constant = "T"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return (EffectParameter("T", "s", "time constant", Prior("log", 3.0 * scales.dt, 1.2)),)

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"T": steps * scales.dt} for steps in (1.0, 4.0, 15.0))

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        time = values["T"]
        if time < 0.0:
            raise InputError(f"effect {self.id}: T", f"{time:g} s", "a time constant of 0 s or more")
        if time == 0.0 or not len(signal):
            return signal
        return _lagged_means(np.ascontiguousarray(signal), h / time)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # A constant passes as it is. The lag is a state of its own wherever delays are rational ones.
        return Footprint(site.name, "input", 1.0, 1.0)


class SensorGain(SignalGain):
    """Sensor gain: a wrong scale factor, gear ratio or calibration."""

    id = "sensor-gain"
    title = "Sensor gain"
    equation = "y' = s y"
    independently = "move the axis by a length or angle known from elsewhere (a gauge, counted turns) and compare"
    site_kind = "output"
    spread = 0.1  # as of an input's gain: of one path no record tells them apart
    meaning = "what is recorded over what is there"
    output = SignalGain.scaled

    def shown(self, values: Mapping[str, float]) -> float:
        return values["s"]


class SensorBias(Effect):
    """Sensor bias: a constant in the reading."""

    id = "sensor-bias"
    title = "Sensor bias"
    equation = "y' = y + b"
    independently = "read the sensor at a known reference"
    site_kind = "output"

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        offered = []
        n = model.A.shape[-1]
        a, c = model.A.reshape(-1, n), model.C.reshape(-1, len(plant.outputs), n)[0]  # along a motion at every point
        both = np.vstack([a / max(np.abs(a).max(initial=0.0), 1.0), c])
        for k, signal in enumerate(plant.outputs):
            wanted = np.zeros(len(both))
            wanted[len(a) + k] = 1.0
            x = np.linalg.lstsq(both, wanted, rcond=None)[0]
            if np.abs(both @ x - wanted).max() > 1e-9:
                offered.append(Site("output", signal.name))
        return tuple(offered)

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, scales.zero * scales.output)
        return (EffectParameter("b", scales.signal_unit, "reading at zero", prior),)

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return signal + values["b"]

    def bias(self, values: Mapping[str, float]) -> float:
        return values["b"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=abs(values["b"]))


class SensorDelay(SignalDelay):
    """Sensor delay: the reading is d seconds old, or its clock runs behind that of the input."""

    id = "sensor-delay"
    title = "Sensor delay"
    equation = "y'(t) = y(t - d)"
    independently = "put command and sensor on an oscilloscope with one trigger"
    site_kind = "output"

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        steps, n = self.steps(values, h), signal.shape[1]
        if n < 4:
            return signal
        at = np.arange(n) - steps
        left = np.clip(np.floor(at).astype(int), 1, n - 3)
        p = at - left
        before, here, there, after = (signal[:, left + k] for k in (-1, 0, 1, 2))
        inside = (
            -p * (p - 1) * (p - 2) / 6 * before
            + (p + 1) * (p - 1) * (p - 2) / 2 * here
            - (p + 1) * p * (p - 2) / 2 * there
            + (p + 1) * p * (p - 1) / 6 * after
        )
        return np.where(at < 0.0, signal[:, :1] + at * (signal[:, 1:2] - signal[:, :1]), inside)

    def lag(self, values: Mapping[str, float]) -> float:
        return values["d"]


POSITION_UNITS = ("rad", "m")


class SensorEccentricity(Effect):
    """Eccentric or tilted encoder: the reading runs ahead and behind once a turn."""

    id = "sensor-eccentricity"
    title = "Eccentric or misaligned position sensor"
    equation = "y' = y + c cos(k y) + s sin(k y)"
    independently = "turn slowly against a second encoder"
    site_kind = "output"
    amplitude = ("e", "c", "s")
    spatial = True

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return tuple(Site("output", s.name) for s in plant.outputs if s.unit in POSITION_UNITS)

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        order = self._orders(scales)[0]
        seen = order_prior(replace(scales, position=2.0 * scales.output))
        line = seen if scales.orders else Prior("log", order, 3e-3)  # once a turn is known
        size = Prior("linear", 0.0, 0.01 / order)
        per = f"rad/{scales.signal_unit}" if scales.signal_unit else ""
        return (
            EffectParameter("c", scales.signal_unit, "error in phase with cos k y", size),
            EffectParameter("s", scales.signal_unit, "error in phase with sin k y", size),
            EffectParameter("k", per, "spatial frequency", line),
        )

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"c": 0.003 / k, "s": 0.003 / k, "k": k} for k in self._orders(scales)[:3])

    @staticmethod
    def _orders(scales: Scales) -> tuple[float, ...]:
        """Once a turn for angles, once over the range of a length, where the record shows nothing else."""
        return scales.orders or ((math.pi / scales.output,) if scales.signal_unit == "m" else (1.0,))

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        phase = values["k"] * signal
        return signal + values["c"] * np.cos(phase) + values["s"] * np.sin(phase)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=math.hypot(values["c"], values["s"]))


class MagnitudeSensor(Effect):
    """A sensor that shows the size of its signal and not its sign."""

    id = "magnitude-sensor"
    title = "Sensor without a sign"
    equation = "y' = |y - c|"
    independently = "read the sensor while the machine is moved by hand in both directions"
    site_kind = "output"

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("linear", 0.0, 0.03 * scales.output)
        return (EffectParameter("c", scales.signal_unit, "value at which it shows zero", prior),)

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.abs(signal - values["c"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", -1.0, 1.0, offset=abs(values["c"]))


class Quantisation(Effect):
    """Quantisation: the reading comes in steps."""

    id = "quantisation"
    title = "Quantisation"
    equation = "y' = lsb round(y / lsb)"
    site_kind = "output"
    nameable = False

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        prior = Prior("log", 1e-3 * scales.output, 1.5)
        return (EffectParameter("lsb", scales.signal_unit, "step of the reading", prior),)

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        if values["lsb"] <= 0.0:
            raise InputError("effect quantisation: lsb", f"{values['lsb']:g}", "a positive step")
        return values["lsb"] * np.round(signal / values["lsb"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=0.5 * values["lsb"])


EFFECTS = (
    InputGain(),
    InputDelay(),
    InputDeadZone(),
    InputSaturation(),
    ActuatorLag(),
    SensorGain(),
    SensorBias(),
    SensorDelay(),
    SensorEccentricity(),
    MagnitudeSensor(),
    Quantisation(),
)
