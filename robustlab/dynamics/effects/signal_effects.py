"""Effects on inputs and outputs: gains, delays, limits, sensor errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numba as nb
import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Effect, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.friction_effects import order_prior
from robustlab.dynamics.ports.port_model import AnyPlant, PortModel
from robustlab.errors import InputError


class SignalGain(Effect):
    """The signal times s."""

    gain_like = True
    scale = "s"

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return values["s"] * signal

    output = input

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, self.site_kind, values["s"], values["s"])


class SignalDelay(Effect):
    """The signal delayed by d seconds."""

    delay = "d"

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, self.site_kind, 1.0, 1.0, delay=values["d"])


class InputGain(SignalGain, row="input-gain"):
    """Input gain: a multiple of the commanded input acts."""


class InputDelay(SignalDelay, row="input-delay"):
    """Input delay: the input acts d seconds late, by `Simulator`, which shifts the samples."""


class InputDeadZone(Effect, row="input-dead-zone"):
    """Dead zone of the driver: a constant voltage drop."""

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.sign(signal) * np.maximum(np.abs(signal) - values["d"], 0.0)

    def input_error(self, values: Mapping[str, float]) -> float:
        return values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        return Footprint(site.name, "input", 0.0, max(0.0, 1.0 - values["d"] / amplitude))


class InputSaturation(Effect, row="input-saturation"):
    """Symmetric saturation of the input."""

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.clip(signal, -values["u_max"], values["u_max"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "input", min(1.0, values["u_max"] / amplitude), 1.0)


@nb.njit(cache=True)
def _lagged_means(u, step):  # type: ignore[no-untyped-def]
    """Return the mean of the lagged input over each step, (n,); ``step``: its length in units of T."""
    left, mean = math.exp(-step), -math.expm1(-step) / step
    means, x = np.empty(len(u)), u[0]
    for k in range(len(u)):
        means[k] = u[k] + (x - u[k]) * mean
        x = u[k] + (x - u[k]) * left
    return means


class ActuatorLag(Effect, row="actuator-lag"):
    """First-order lag of the actuator."""

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        if values["T"] == 0.0 or not len(signal):
            return signal
        return _lagged_means(np.ascontiguousarray(signal), h / values["T"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Unit static gain; the lag is a state wherever delays are rational.
        return Footprint(site.name, "input", 1.0, 1.0)


class SensorGain(SignalGain, row="sensor-gain"):
    """Sensor gain: a wrong scale factor, gear ratio or calibration."""


class SensorBias(Effect, row="sensor-bias"):
    """Sensor bias: a constant offset of the reading."""

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        offered = []
        n = model.A.shape[-1]
        a, c = model.A.reshape(-1, n), model.C.reshape(-1, len(plant.outputs), n)[0]  # along a motion: at every point
        both = np.vstack([a / max(np.abs(a).max(initial=0.0), 1.0), c])
        for k, signal in enumerate(plant.outputs):
            wanted = np.zeros(len(both))
            wanted[len(a) + k] = 1.0
            x = np.linalg.lstsq(both, wanted, rcond=None)[0]
            if np.abs(both @ x - wanted).max() > 1e-9:
                offered.append(Site("output", signal.name))
        return tuple(offered)

    def priors(self, scales: Scales) -> dict[str, Prior]:
        return {"b": Prior("linear", 0.0, scales.zero * scales.output)}

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return signal + values["b"]

    def bias(self, values: Mapping[str, float]) -> float:
        return values["b"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=abs(values["b"]))


class SensorDelay(SignalDelay, row="sensor-delay"):
    """Sensor delay: the reading is d seconds late, or its clock lags behind that of the input."""

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        steps, n = values["d"] / h, signal.shape[1]
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


POSITION_UNITS = ("rad", "m")


class SensorEccentricity(Effect, row="sensor-eccentricity"):
    """Eccentric or tilted encoder: an error with one period per turn."""

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return tuple(Site("output", s.name) for s in plant.outputs if s.unit in POSITION_UNITS)

    def priors(self, scales: Scales) -> dict[str, Prior]:
        order = self._orders(scales)[0]
        seen = order_prior(replace(scales, position=2.0 * scales.output))
        size = Prior("linear", 0.0, 0.01 / order)
        return {"c": size, "s": size, "k": seen if scales.orders else Prior("log", order, 3e-3)}  # once a turn is known

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return tuple({"c": 0.003 / k, "s": 0.003 / k, "k": k} for k in self._orders(scales)[:3])

    @staticmethod
    def _orders(scales: Scales) -> tuple[float, ...]:
        """Return one period per turn for angles or per range for lengths, unless the record shows lines."""
        return scales.orders or ((math.pi / scales.output,) if scales.signal_unit == "m" else (1.0,))

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        phase = values["k"] * signal
        return signal + values["c"] * np.cos(phase) + values["s"] * np.sin(phase)

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=math.hypot(values["c"], values["s"]))


class MagnitudeSensor(Effect, row="magnitude-sensor"):
    """A sensor that shows the magnitude of its signal."""

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.abs(signal - values["c"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", -1.0, 1.0, offset=abs(values["c"]))


class Quantisation(Effect, row="quantisation"):
    """Quantisation of the reading."""

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        if values["lsb"] <= 0.0:
            raise InputError("effect quantisation: lsb", f"{values['lsb']:g}", "a positive step")
        return values["lsb"] * np.round(signal / values["lsb"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=0.5 * values["lsb"])
