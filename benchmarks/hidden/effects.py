"""Hidden effects of a machine: their random sizes and their action.

Draws are in a motor's units (N m, rad, s, V, A); `Setting.torque` and `Setting.length` carry them over to an axis in
metres. Every effect reads its parameters from a dict, so that a test can set them instead of drawing them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .machine import Array, Machine, Run, simulate
from .plants import Setup

Parameters = dict[str, float]

# How far the bristle of "pure Coulomb" friction bends before it slides, in rad: a hundredth of the encoder's step.
STIFF = 3e-5


@dataclass(frozen=True)
class Timeline:
    """Functions of time, equal in every run of a machine: load torque (n,) and whether the driver works."""

    load: Array
    alive: Array


@dataclass(frozen=True)
class Setting:
    """Input of a random draw: the effect-free machine with its true values, the record's and the held-out input."""

    setup: Setup
    machine: Machine
    u: Array
    other_u: Array
    dt: float
    feedback: tuple[float, float, float] | None = None

    @property
    def length(self) -> float:
        return self.setup.length

    @property
    def torque(self) -> float:
        """Factor from a motor's torque to this plant's force; on an oscillator what counts is the damping's."""
        if self.setup.inputs == "resonant":
            return 80.0 * self.machine.b_pos * float(np.std(self.free.omega))
        return self.setup.force_scale

    @property
    def speed(self) -> float:
        """Factor from a motor's speed to this plant's."""
        if self.setup.inputs == "resonant":
            return float(np.std(self.free.omega)) / 150.0
        return self.setup.speed_scale

    @property
    def frequency(self) -> float:
        """Bandwidth of the effect-free machine in rad/s."""
        m = self.machine
        return (m.b_pos + m.c_s + (m.Kt * m.Ke / m.R if m.winding else 0.0)) / m.J1

    @cached_property
    def free(self) -> Run:
        """The effect-free machine along the first record."""
        return simulate(self.machine, self.u, self.dt, feedback=self.feedback)

    @property
    def reach(self) -> float:
        """Largest distance from the start."""
        return float(np.abs(self.free.phi).max())

    @property
    def travel(self) -> float:
        """Distance travelled in all."""
        return float(np.abs(np.diff(self.free.phi)).sum())

    @property
    def top_speed(self) -> float:
        return float(np.abs(self.free.omega).max())


class NothingInCommon(ValueError):
    """A machine whose two records cannot both show the effect: another seed draws another one."""


Draw = Callable[[np.random.Generator, Setting], Parameters]
Put = Callable[[Machine, Parameters, Setting], Machine]


@dataclass(frozen=True)
class Hidden:
    """One effect: a draw of its parameters, and the machine that has it (given the machine that has not).

    ``by_the_clock(parameters, n, dt)`` gives the `Timeline` of effects that follow the time instead of the state.
    """

    draw: Draw
    put: Put
    by_the_clock: Callable[[Parameters, int, float], Timeline] | None = None


def _sign(r: np.random.Generator) -> float:
    return float(r.choice([-1.0, 1.0]))


def _either(r: np.random.Generator, low: tuple[float, float], high: tuple[float, float]) -> float:
    """A factor from one of two ranges, each half the time."""
    return float(r.uniform(*(low if r.random() < 0.5 else high)))


def _angle(r: np.random.Generator) -> float:
    return float(r.uniform(0, 2 * math.pi))


def _bristle(m: Machine, force: float, bend: float, damping: float) -> Machine:
    """LuGre constants of a bristle that carries ``force`` at the bend; light micro-damping (share of critical)."""
    stiffness = force / bend
    return m._replace(s0=stiffness, s1=2 * damping * math.sqrt(stiffness * m.J1))


def _dry(m: Machine, force: float, s: Setting, **more: float) -> Machine:
    """Stiff dry friction of the given largest level, critically damped: a bristle that rings is no Coulomb friction."""
    return _bristle(m, force, STIFF * s.length, 1.0)._replace(**more)


def _scaled(name: str, low: tuple[float, float], high: tuple[float, float] | None, *fields: str) -> Hidden:
    return Hidden(
        lambda r, s: {name: _either(r, low, high or low)},
        lambda m, p, s: m._replace(**{f: getattr(m, f) * p[name] for f in fields}),
    )


def _set(draw: Draw, **fields: str) -> Hidden:
    """Constants of the machine that are drawn values: constant="value"."""
    return Hidden(draw, lambda m, p, s: m._replace(**{own: p[name] for own, name in fields.items()}))


def _stribeck(r: np.random.Generator, s: Setting) -> Parameters:
    Fc = s.torque * r.uniform(4e-3, 8e-3)
    return {"Fc": Fc, "dF": Fc * r.uniform(0.7, 1.5), "vs": s.speed * r.uniform(6, 20)}


def _asymmetric(r: np.random.Generator, s: Setting) -> Parameters:
    """About the plant's own coefficient, which a shift of the mean would make wrong as well."""
    b, x = s.machine.b_pos, _sign(r) * r.uniform(0.4, 0.8)
    return {"b_pos": b * (1 + x), "b_neg": b * (1 - x)}


def _position_friction(r: np.random.Generator, s: Setting) -> Parameters:
    Fc = s.torque * r.uniform(3e-3, 7e-3)
    turns = float(r.choice([1.0, 4.8, 9.371428571428572])) if s.setup.electrical else 1.0
    return {"Fc": Fc, "P": Fc * r.uniform(0.4, 0.8), "N": s.length * turns, "a": _angle(r)}


def _cogging(r: np.random.Generator, s: Setting) -> Parameters:
    # Once a turn it would be the gravity of a pendulum.
    order = float(r.choice([2.0, 4.0, 7.0, 13.0] if s.setup.unit == "rad" else [1.0, 2.0]))
    size = r.uniform(2e-3, 5e-3) * (1.0 + order / 13.0)
    return {"A": s.torque * size, "n": order / s.length, "a": _angle(r)}


def _put_shaft(m: Machine, share: float, stiffness: float, **more: float) -> Machine:
    """The share of the inertia behind a shaft."""
    return m._replace(J1=m.J1 * (1 - share), J2=m.J1 * share, k_s=stiffness, **more)


def _reduced(m: Machine, share: float) -> float:
    return m.J1 * share * (1 - share)


def _flexible(r: np.random.Generator, s: Setting) -> Parameters:
    return {"share": r.uniform(0.3, 0.6), "frequency": r.uniform(*s.setup.resonance), "damping": r.uniform(0.03, 0.12)}


def _put_flexible(m: Machine, p: Parameters, s: Setting) -> Machine:
    w, J = 2 * math.pi * p["frequency"], _reduced(m, p["share"])
    return _put_shaft(m, p["share"], J * w**2, c_s=2 * p["damping"] * J * w)


def _put_backlash(m: Machine, p: Parameters, s: Setting) -> Machine:
    stiffness = _reduced(m, p["share"]) * (2 * math.pi * p["contact_frequency"]) ** 2
    return _put_shaft(m, p["share"], stiffness, gap=p["gap"], hc=p["hc"])


def _backlash(r: np.random.Generator, s: Setting) -> Parameters:
    gap, share, frequency = s.length * r.uniform(0.12, 0.3), r.uniform(0.45, 0.65), r.uniform(200, 400)
    return {"gap": gap, "share": share, "contact_frequency": frequency, "hc": r.uniform(0.05, 0.2) / s.length}


def _put_gear(m: Machine, driven: float, braking: float, share: float, s: Setting) -> Machine:
    """Losses of a gear before the share of the inertia.

    ``driven`` and ``braking`` are those of the torque T that moves the whole: J a = (1 - driven) T and (1 + braking) T.
    """
    w, J = 2 * math.pi * 1000.0, _reduced(m, share)
    m = _put_shaft(m, share, J * w**2, c_s=2 * 0.3 * J * w)
    m = m._replace(loss=driven / (1 - driven) / share, loss_back=braking / (1 + braking) / share)
    return _bristle(m, 5e-3 * s.torque, STIFF * s.length, 0.1)


def _end_stop(r: np.random.Generator, s: Setting) -> Parameters:
    """Two stops that both records meet, where their input goes both ways: closer together until they do."""
    other = simulate(s.machine, s.other_u, s.dt, feedback=s.feedback).phi
    way = min(np.ptp(s.free.phi), np.ptp(other)) * r.uniform(0.4, 0.6)
    below, stiffness, hc = r.uniform(0.3, 0.7), s.torque * r.uniform(2, 10), r.uniform(0.003, 0.01)
    p: Parameters = {}
    for _ in range(8):
        p = {"low": -way * below, "high": way * (1 - below), "stiffness": stiffness / s.length, "hc": hc / s.length}
        p = {key: float(value) for key, value in p.items()}
        stopped = [simulate(_put_end_stop(s.machine, p, s), u, s.dt, feedback=s.feedback).phi for u in (s.u, s.other_u)]
        if all(phi.max() > p["high"] and phi.min() < p["low"] for phi in stopped):
            break
        way *= 0.75
    return p


def _put_end_stop(m: Machine, p: Parameters, s: Setting) -> Machine:
    return m._replace(x_low=p["low"], x_high=p["high"], k_stop=p["stiffness"], c_stop=p["hc"])


def _one_sided(r: np.random.Generator, s: Setting) -> Parameters:
    """A spring that begins well within what both records would reach without it."""
    other = simulate(s.machine, s.other_u, s.dt, feedback=s.feedback).phi
    up, down = min(s.free.phi.max(), other.max()), min(-s.free.phi.min(), -other.min())
    side = 1.0 if up > down else -1.0
    far = float(max(up, down))
    if not far > 0.0:
        raise NothingInCommon("the two records go apart: there is no place that both come to")
    return {"side": side, "place": side * far * r.uniform(0.1, 0.4), "k": s.torque * r.uniform(15e-3, 40e-3) / far}


def _load_dependent(r: np.random.Generator, s: Setting) -> Parameters:
    """Another loss when the load drives the motor than the other way round."""
    low, high = r.uniform(0.05, 0.12), r.uniform(0.2, 0.35)
    driven, braking = (low, high) if r.random() < 0.5 else (high, low)
    return {"driven": driven, "braking": braking, "share": r.uniform(0.5, 0.7)}


def _asymmetric_coulomb(r: np.random.Generator, s: Setting) -> Parameters:
    high = s.torque * r.uniform(4e-3, 9e-3)
    low = high * r.uniform(0.2, 0.6)
    return {"F_pos": high, "F_neg": low} if r.random() < 0.5 else {"F_pos": low, "F_neg": high}


def _ripple(r: np.random.Generator, s: Setting) -> Parameters:
    """Mains and its double, or a beat of two clocks."""
    choice = r.random()
    frequency = 50.0 if choice < 1 / 3 else 100.0 if choice < 2 / 3 else r.uniform(3, 9)
    # An inertia shows a torque as an angle that falls with the square of its frequency.
    return {"A": s.torque * r.uniform(6e-3, 12e-3) * max(1.0, frequency / 12), "frequency": frequency, "a": _angle(r)}


def _bouc_wen(r: np.random.Generator, s: Setting) -> Parameters:
    """Wen's exponent 1; gamma = 1/2 would come back along a straight line, 0 is dry friction with a soft contact."""
    k = s.torque * r.uniform(15e-3, 30e-3) / (0.1 * s.reach)
    return {"k": k, "yield": s.reach * r.uniform(0.05, 0.1), "gamma": r.uniform(0.25, 0.48)}


def _heating(r: np.random.Generator, s: Setting) -> Parameters:
    duration = len(s.u) * s.dt
    rise = r.uniform(0.15, 0.35)
    p = {"rise": rise, "tau_winding": duration * r.uniform(0.3, 1.0), "tau_housing": duration * r.uniform(3, 8)}
    p["share_housing"] = r.uniform(0.1, 0.3)
    # The losses fall as R grows less than i**2 does; three rounds of scaling meet the wanted rise within a per cent.
    heat = 1.0
    for _ in range(4):
        got = simulate(_put_heating(s.machine, {**p, "heat_capacity": heat}, s), s.u, s.dt, feedback=s.feedback)
        heat *= float(got.temperature.max()) * ALPHA / rise
    return {**p, "heat_capacity": heat}


ALPHA = 0.0039  # copper, per kelvin


def _put_heating(m: Machine, p: Parameters, s: Setting) -> Machine:
    C_w, G = p["heat_capacity"], p["heat_capacity"] / p["tau_winding"]
    C_h = G / p["share_housing"] * p["tau_winding"]
    return m._replace(alpha=ALPHA, C_w=C_w, G_wh=G, C_h=C_h, G_ha=C_h / p["tau_housing"])


EFFECTS: Mapping[str, Hidden] = {
    "inertia": _scaled("factor", (0.6, 0.78), (1.25, 1.6), "J1"),
    "viscous-friction": _scaled("factor", (4.0, 10.0), None, "b_pos", "b_neg"),
    "torque-constant": _scaled("factor", (0.82, 0.9), (1.1, 1.15), "Kt", "Ke"),
    "resistance": _scaled("factor", (1.25, 1.5), None, "R"),
    "resistance-heating": Hidden(_heating, _put_heating),
    "coulomb-friction": Hidden(lambda r, s: {"Fc": s.torque * r.uniform(2e-3, 8e-3)},
                               lambda m, p, s: _dry(m, p["Fc"], s, Fc=p["Fc"])),
    "stribeck-friction": Hidden(
        _stribeck, lambda m, p, s: _dry(m, p["Fc"] + p["dF"], s, Fc=p["Fc"], dF=p["dF"], vs=p["vs"])),
    "presliding": Hidden(lambda r, s: {"Fc": s.torque * r.uniform(6e-3, 15e-3), "bend": s.length * r.uniform(0.1, 0.5)},
                         lambda m, p, s: _bristle(m, p["Fc"], p["bend"], 0.03)._replace(Fc=p["Fc"])),
    "asymmetric-viscous-friction": _set(_asymmetric, b_pos="b_pos", b_neg="b_neg"),
    "constant-load": _set(lambda r, s: {"T0": s.torque * _sign(r) * r.uniform(1.5e-3, 6e-3)}, T0="T0"),
    "quadratic-drag": _set(lambda r, s: {"c": s.torque / s.speed**2 * r.uniform(4e-8, 1.2e-7)}, drag="c"),
    "position-dependent-friction": Hidden(
        _position_friction, lambda m, p, s: _dry(m, p["Fc"] + p["P"], s, Fc=p["Fc"], P=p["P"], N=p["N"], a_P=p["a"])),
    "cogging": _set(_cogging, A="A", n="n", a_A="a"),
    "gear-efficiency": Hidden(lambda r, s: {"eta": r.uniform(0.65, 0.88), "share": r.uniform(0.5, 0.7)},
                              lambda m, p, s: _put_gear(m, 1 - p["eta"], 1 - p["eta"], p["share"], s)),
    "backlash": Hidden(_backlash, _put_backlash),
    "flexible-coupling": Hidden(_flexible, _put_flexible),
    "input-delay": _set(lambda r, s: {"delay": r.uniform(2e-3, 8e-3)}, delay="delay"),
    "input-dead-zone": _set(lambda r, s: {"V": s.setup.largest * r.uniform(1 / 60, 1 / 20)}, dead="V"),
    "brush-drop": Hidden(lambda r, s: {"V": r.uniform(0.3, 1.0)}, lambda m, p, s: m._replace(Vb=p["V"], i_s=1e-3)),
    "input-saturation": _set(lambda r, s: {"limit": s.setup.largest * r.uniform(0.5, 0.8)}, limit="limit"),
    # A bridge switching at 25 kHz loses two dead times of each period; a supply above its rating gains.
    "input-gain": _set(
        lambda r, s: {"factor": 1 - 2 * 25e3 * r.uniform(2e-6, 4e-6) if r.random() < 0.5 else r.uniform(1.1, 1.2)},
        amplify="factor"),
    "sensor-gain": _scaled("factor", (0.9, 0.95), (1.05, 1.1), "y_gain"),
    "sensor-bias": _set(lambda r, s: {"angle": s.length * _sign(r) * r.uniform(0.1, 0.3),
                                      "current": _sign(r) * r.uniform(0.15, 0.5)}, y_bias="angle", i_bias="current"),
    "sensor-eccentricity": Hidden(lambda r, s: {"e": s.length * r.uniform(0.03, 0.06), "a": _angle(r)},
                                  lambda m, p, s: m._replace(y_e=p["e"], y_a=p["a"], y_n=1.0 / s.length)),
    "sensor-delay": _set(lambda r, s: {"delay": r.uniform(2e-3, 8e-3)}, y_delay="delay"),
    "stiffness": _set(lambda r, s: {"k": s.torque * r.uniform(6e-3, 20e-3) / s.reach}, k="k"),
    "cubic-stiffness": _set(lambda r, s: {"k3": s.torque * r.uniform(10e-3, 30e-3) / s.reach**3}, k3="k3"),
    "end-stop": Hidden(_end_stop, _put_end_stop),
    "pendulum-gravity": _set(lambda r, s: {"mgl": s.torque * r.uniform(3e-3, 8e-3),
                                           "rest": r.uniform(-math.pi, math.pi)}, grav="mgl", x_grav="rest"),
    "actuator-lag": _set(lambda r, s: {"T": r.uniform(2e-3, 20e-3)}, lag="T"),
    "asymmetric-coulomb-friction": Hidden(
        _asymmetric_coulomb, lambda m, p, s: _dry(m, (p["F_pos"] + p["F_neg"]) / 2, s, Fc=(p["F_pos"] + p["F_neg"]) / 2,
                                                  dFc=(p["F_pos"] - p["F_neg"]) / 2)),
    "load-dependent-friction": Hidden(
        _load_dependent, lambda m, p, s: _put_gear(m, p["driven"], p["braking"], p["share"], s)),
    "bouc-wen": _set(_bouc_wen, k_h="k", x_h="yield", gamma_h="gamma"),
    "torque-ripple": Hidden(
        _ripple, lambda m, p, s: m._replace(rip=p["A"], rip_w=2 * math.pi * p["frequency"], rip_a=p["a"])),
    "one-sided-spring": _set(_one_sided, side="side", x_side="place", k_side="k"),
    "magnitude-sensor": Hidden(lambda r, s: {}, lambda m, p, s: m._replace(y_abs=1.0)),
}  # fmt: skip

# Effects of winding, brushes and back-EMF; and the torque constant, which a force-driven axis has only as input gain.
MOTOR_ONLY = ("torque-constant", "resistance", "resistance-heating", "brush-drop")


def _telegraph(p: Parameters, n: int, dt: float) -> Timeline:
    """A neighbour that starts and stops: +-A, switching at random times that belong to the machine."""
    r, t, level = np.random.default_rng(int(p["schedule"])), np.arange(n) * dt, np.ones(n)
    switch, value = 0.0, 1.0
    while switch < t[-1]:
        level[t >= switch] = value
        switch, value = switch + r.exponential(p["dwell"]) + 0.02, -value
    return Timeline(p["A"] * level, np.ones(n))


def _dropouts(p: Parameters, n: int, dt: float) -> Timeline:
    r, t, alive = np.random.default_rng(int(p["schedule"])), np.arange(n) * dt, np.ones(n)
    at = 0.0
    while at < t[-1]:
        at += r.exponential(p["every"]) + 0.05
        lasts = r.uniform(0.5, 1.5) * p["lasts"]
        alive[(t >= at) & (t < at + lasts)] = 0.0
        at += lasts
    return Timeline(np.zeros(n), alive)


def _resonance(r: np.random.Generator, s: Setting) -> Parameters:
    share, frequency = r.uniform(0.5, 0.6), s.setup.resonance[0] * r.uniform(0.8, 1.3)
    return {"share": share, "frequency": frequency, "hardening": r.uniform(4, 8)}


def _put_resonance(m: Machine, p: Parameters, s: Setting) -> Machine:
    J, w = _reduced(m, p["share"]), 2 * math.pi * p["frequency"]
    twist = 0.1 * s.length  # where the cubic part of the spring equals the linear one times the hardening
    return _put_shaft(
        m, p["share"], J * w**2, c_s=0.02 * J * w, k3_s=p["hardening"] * J * w**2 / twist**2, cq_s=0.3 * J / s.length
    )


OUTSIDE_EFFECTS: Mapping[str, Hidden] = {
    "field-weakening": _set(lambda r, s: {"speed": r.uniform(1.5, 2.3) * s.setup.largest / s.machine.Ke},
                            weakening="speed"),
    "telegraph-load": Hidden(lambda r, s: {"A": s.torque * r.uniform(5e-3, 10e-3), "dwell": r.uniform(0.08, 0.2),
                                           "schedule": float(r.integers(2**31))}, lambda m, p, s: m, _telegraph),
    "wearing-friction": Hidden(lambda r, s: {"final": s.torque * r.uniform(15e-3, 30e-3)},
                               lambda m, p, s: _dry(m, p["final"], s, wear=p["final"] / s.travel)),
    "one-sided-magnet": _set(lambda r, s: {"A": s.torque * r.uniform(20e-3, 40e-3),
                                           "place": float(np.quantile(s.free.phi, r.uniform(0.35, 0.65))),
                                           "width": float(np.ptp(s.free.phi)) * r.uniform(0.08, 0.15)},
                             magnet="A", x_m="place", w_m="width"),
    "slew-rate-limit": _set(lambda r, s: {"rate": s.setup.largest * r.uniform(4, 12)}, slew="rate"),
    "square-root-drag": Hidden(lambda r, s: {"c": s.torque * r.uniform(20e-3, 40e-3) / math.sqrt(s.top_speed)},
                               lambda m, p, s: m._replace(root_drag=p["c"], root_w=s.length)),
    "driver-dropouts": Hidden(lambda r, s: {"every": r.uniform(0.1, 0.25), "lasts": r.uniform(0.015, 0.04),
                                            "schedule": float(r.integers(2**31))}, lambda m, p, s: m, _dropouts),
    "nonlinear-resonance": Hidden(_resonance, _put_resonance),
    "speed-gated-brake": _set(lambda r, s: {"speed": s.top_speed * r.uniform(0.35, 0.5),
                                            "b": r.uniform(0.3, 0.6) * s.frequency * s.machine.J1},
                              bite="speed", brake="b"),
}  # fmt: skip

ALL_EFFECTS = {**EFFECTS, **OUTSIDE_EFFECTS}


def _one_inertia(m: Machine, p: Parameters, s: Setting) -> Machine:
    body = "J1" if p["body"] < 1.5 else "J2"
    return m._replace(**{body: getattr(m, body) * p["factor"]})


def _stop_of_a_spring(r: np.random.Generator, s: Setting) -> Parameters:
    return {**_end_stop(r, s), "stiffness": s.machine.k * r.uniform(0.5, 3), "hc": r.uniform(0.1, 0.3) / s.speed / 150}


def _ripple_near_resonance(r: np.random.Generator, s: Setting) -> Parameters:
    p = _ripple(r, s)
    beyond = max(1.0, (2 * math.pi * p["frequency"]) ** 2 * s.machine.J1 / s.machine.k)
    return {**p, "A": beyond * s.setup.largest * r.uniform(0.02, 0.06)}


# Where a plant has a spring of its own or two bodies, some effects are another thing or another size.
OF_A_PLANT: Mapping[str, Mapping[str, Hidden]] = {
    "mass-spring-damper": {
        "inertia": _scaled("factor", (0.85, 0.93), (1.08, 1.2), "J1"),
        "viscous-friction": _scaled("factor", (2.0, 4.0), None, "b_pos", "b_neg"),
        "stiffness": _scaled("factor", (0.88, 0.95), (1.06, 1.14), "k"),
        "cubic-stiffness": _set(lambda r, s: {"k3": s.machine.k * r.uniform(0.01, 0.05) / float(np.var(s.free.phi))},
                                k3="k3"),
        "constant-load": _set(lambda r, s: {"T0": s.machine.k * s.length * _sign(r) * r.uniform(0.1, 0.4)}, T0="T0"),
        "end-stop": Hidden(_stop_of_a_spring, _put_end_stop),
        "input-delay": _set(lambda r, s: {"delay": s.dt * r.uniform(0.3, 3)}, delay="delay"),
        "sensor-delay": _set(lambda r, s: {"delay": s.dt * r.uniform(0.3, 3)}, y_delay="delay"),
        "actuator-lag": _set(lambda r, s: {"T": r.uniform(2e-3, 8e-3)}, lag="T"),
        "one-sided-spring": Hidden(lambda r, s: {**_one_sided(r, s), "k": s.machine.k * r.uniform(0.05, 0.3)},
                                   EFFECTS["one-sided-spring"].put),
        "bouc-wen": Hidden(lambda r, s: {**_bouc_wen(r, s), "k": s.machine.k * r.uniform(0.03, 0.1),
                                         "yield": s.reach * r.uniform(0.1, 0.3)}, EFFECTS["bouc-wen"].put),
        "torque-ripple": Hidden(_ripple_near_resonance, EFFECTS["torque-ripple"].put),
    },
    "two-mass": {
        "inertia": Hidden(lambda r, s: {"factor": _either(r, (0.6, 0.78), (1.25, 1.6)),
                                         "body": float(r.integers(1, 3))}, _one_inertia),
        "viscous-friction": Hidden(lambda r, s: {"factor": r.uniform(3, 8)},
                                   lambda m, p, s: m._replace(c_s=m.c_s * p["factor"])),
        "stiffness": _scaled("factor", (0.6, 0.78), (1.25, 1.6), "k_s"),
    },
}  # fmt: skip


def hidden_effect(plant: str, name: str) -> Hidden:
    return OF_A_PLANT.get(plant, {}).get(name, ALL_EFFECTS[name])
