"""Wrong parameters of the plant (p' = s p), and effects on its inputs and outputs: gains, delays, limits, errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numba as nb
import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.effect import Effect, EffectParameter, Footprint, Prior, Scales, Site
from robustlab.dynamics.effects.friction_effects import order_prior
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.dynamics.ports.port_model import AnyPlant, Port, PortModel, parameter_groups, port_model
from robustlab.errors import InputError


class ParameterEffect(Effect, ids="inertia"):
    """Factor of every parameter of a group (`robustlab.dynamics.ports.port_model.parameter_groups`)."""

    site_kind = "parameter"
    gain_like = True
    scale = "s"

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        (s,) = self._of_rows(self.rows, scales)
        return {"s": (s.prior.value(1.0), s.prior.value(-1.0))}

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        if site.kind != "parameter":
            return {}
        return dict.fromkeys(site.name.split("+"), values["s"])


def has_ground_term(plant: AnyPlant, port: Port, role: str, rows: tuple[Port, ...], of: str) -> bool:
    """Return whether parameters of this role already create a force between the joint and the ground."""
    if isinstance(plant, NonlinearPlant):
        return any(p.role == role and not p.value for p in plant.parameters.values())
    directions = [getattr(r, of) for r in rows if getattr(r, of) is not None]
    together = np.sum(directions, axis=0)
    nominal = port_model(plant).A
    at_zero = [(p.role, p.name, (p.name,)) for p in plant.parameters.values() if not p.value and p.tolerance]
    for group_role, _, names in (*parameter_groups(plant), *at_zero):
        if group_role == role:
            change = port_model(plant, dict.fromkeys(names, 2.0)).A - nominal
            row = port.velocity @ change
            if abs(row @ together) > 1e-9 * np.abs(row).sum():
                return True
    return False


class MotorEffect(ParameterEffect, ids="resistance torque-constant"):
    """A wrong parameter of all motors, or of one: it scales the terms of the motor's current."""

    couples: bool  # whether it is in the terms that couple the current with other states, else in that of the current

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        currents = tuple(p.name for p in model.ports.values() if p.kind == "current")
        one = tuple(Site("current", name) for name in currents) if len(currents) > 1 else ()
        return (*super().sites(plant, model), *one)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        if site.kind != "current":
            return model
        k = int(np.argmax(model.ports[site.name].velocity))
        others = [j for j in range(model.own) if j != k]
        a = model.A.copy()
        for row, column in [*((j, k) for j in others), *((k, j) for j in others)] if self.couples else [(k, k)]:
            a[..., row, column] += (values["s"] - 1.0) * model.A[..., row, column]
        return replace(model, A=a)


class MisplacedEffect(ParameterEffect, ids="centre-of-mass gravity-direction"):
    """Wrong coordinates: each is shifted, zero or not."""

    gain_like = False
    scale = ""

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        return tuple(s for s in super().sites(plant, model) if len(s.name.split("+")) == len(self.rows))

    def starts(self, scales: Scales) -> tuple[dict[str, float], ...]:
        return ({p.name: p.prior.value(0.1) for p in self.parameters(scales)},)

    def factors(self, plant: AnyPlant, site: Site, values: Mapping[str, float]) -> dict[str, float]:
        own = [plant.parameters[name] for name in site.name.split("+")]
        return {p.name: (p.value + values[n]) / p.reference for p, n in zip(own, self.rows, strict=True)}


class GroundedEffect(ParameterEffect, ids="stiffness viscous-friction"):
    """A wrong parameter, or at a joint without the term a force to ground, linear in position or velocity."""

    at_joint: Mapping[str, tuple[Any, ...]]  # row of the coefficient at a joint
    of: str  # argument of the force: ``"position"`` or ``"velocity"``

    @property
    def symbol(self) -> str:
        """Name of the coefficient at a joint."""
        return next(iter(self.at_joint))

    def parameters(self, scales: Scales) -> tuple[EffectParameter, ...]:
        return self._of_rows(self.at_joint if scales.force_unit else self.rows, scales)

    def tried(self, scales: Scales) -> dict[str, tuple[float, ...]]:
        if not scales.force_unit:
            return super().tried(scales)
        (p,) = self.parameters(scales)
        return {p.name: (p.prior.value(0.0), p.prior.value(-1.5))}

    def sites(self, plant: AnyPlant, model: PortModel) -> tuple[Site, ...]:
        joints = tuple(p for p in model.ports.values() if p.kind == "joint" and getattr(p, self.of) is not None)
        whole = model if isinstance(plant, NonlinearPlant) else port_model(plant)
        own = tuple(p for p in whole.ports.values() if p.kind == "joint" and "." not in p.name)
        nominal = {p.name: p for p in own}
        missing = tuple(
            Site("joint", p.name)
            for p in joints
            if p.name not in nominal or not has_ground_term(plant, nominal[p.name], self.id, own, self.of)
        )
        return (*super().sites(plant, model), *missing)

    def extend(self, model: PortModel, site: Site, values: Mapping[str, float]) -> PortModel:
        if site.kind != "joint":
            return model
        port = model.ports[site.name]
        return model.with_state_feedback(port, -values[self.symbol] * getattr(port, self.of))

    def names_of(self, values: Mapping[str, float]) -> Sequence[str]:
        return list(self.at_joint) if self.symbol in values else super().names_of(values)


# --- inputs and outputs -----------------------------------------------------------------------------------------------


class SignalGain(Effect, ids="input-gain sensor-gain"):
    """The signal times s."""

    gain_like = True
    scale = "s"

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return values["s"] * signal

    output = input

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, self.site_kind, values["s"], values["s"])


class SignalDelay(Effect, ids="input-delay"):
    """The signal delayed by d seconds; `Simulator` shifts the samples of an input."""

    delay = "d"

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, self.site_kind, 1.0, 1.0, delay=values["d"])


class InputDeadZone(Effect, ids="input-dead-zone"):
    """Dead zone of the driver: a constant voltage drop."""

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.sign(signal) * np.maximum(np.abs(signal) - values["d"], 0.0)

    def input_error(self, values: Mapping[str, float]) -> float:
        return values["d"]

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint | None:
        return Footprint(site.name, "input", 0.0, max(0.0, 1.0 - values["d"] / amplitude))


class InputSaturation(Effect, ids="input-saturation"):
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


class ActuatorLag(Effect, ids="actuator-lag"):
    """First-order lag of the actuator."""

    def input(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        if values["T"] == 0.0 or not len(signal):
            return signal
        return _lagged_means(np.ascontiguousarray(signal), h / values["T"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        # Unit static gain; the lag is a state wherever delays are rational.
        return Footprint(site.name, "input", 1.0, 1.0)


class SensorBias(Effect, ids="sensor-bias"):
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


class SensorDelay(SignalDelay, ids="sensor-delay"):
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


class SensorEccentricity(Effect, ids="sensor-eccentricity"):
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


class MagnitudeSensor(Effect, ids="magnitude-sensor"):
    """A sensor that shows the magnitude of its signal."""

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        return np.abs(signal - values["c"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", -1.0, 1.0, offset=abs(values["c"]))


class Quantisation(Effect, ids="quantisation"):
    """Quantisation of the reading."""

    def output(self, signal: Array, values: Mapping[str, float], h: float) -> Array:
        if values["lsb"] <= 0.0:
            raise InputError("effect quantisation: lsb", f"{values['lsb']:g}", "a positive step")
        return values["lsb"] * np.round(signal / values["lsb"])

    def footprint(self, site: Site, values: Mapping[str, float], amplitude: float) -> Footprint:
        return Footprint(site.name, "output", 1.0, 1.0, offset=0.5 * values["lsb"])
