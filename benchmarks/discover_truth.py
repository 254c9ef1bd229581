"""What an interval of a named effect must hold: the hidden machine's constants in the catalogue's parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["interval", "main_parameter"]

Values = Mapping[str, float]
Told = tuple[str, float]  # the catalogue's parameter, its true value


def _same(own: str, theirs: str) -> Callable[[Values], Told]:
    return lambda p: (theirs, p[own])


def _wave(size: str, phase: str, cosine: str, sine: str, sign: float) -> Callable[[Values], Told]:
    """The larger part of size cos(x + phase) = c cos x + s sin x."""

    def larger(p: Values) -> Told:
        c, s = sign * p[size] * math.cos(p[phase]), -sign * p[size] * math.sin(p[phase])
        return (cosine, c) if abs(c) > abs(s) else (sine, s)

    return larger


def _pendulum(p: Values) -> Told:
    g, h = p["mgl"] * math.cos(p["rest"]), -p["mgl"] * math.sin(p["rest"])
    return ("G", g) if abs(g) > abs(h) else ("H", h)


# No entry: gear efficiency, load-dependent friction, heating, Bouc-Wen and the like, whose hidden physics is another
# parametrisation on purpose, and effects without a parameter.
MAIN: Mapping[str, Callable[[Values], Told]] = {
    "coulomb-friction": _same("Fc", "Fc"),
    "stribeck-friction": _same("Fc", "Fc"),
    "presliding": lambda p: ("sigma0", p["Fc"] / p["bend"]),
    "asymmetric-viscous-friction": lambda p: ("dFv", 0.5 * (p["b_pos"] - p["b_neg"])),
    "constant-load": _same("T0", "T0"),
    "quadratic-drag": _same("c", "c"),
    "position-dependent-friction": _same("Fc", "Fc"),
    "cogging": _wave("A", "a", "Ac", "As", -1.0),  # the load is against the force
    "backlash": _same("gap", "gap"),
    "flexible-coupling": _same("frequency", "f"),
    "input-delay": _same("delay", "d"),
    "sensor-delay": _same("delay", "d"),
    "input-dead-zone": _same("V", "d"),
    "brush-drop": _same("V", "Vb"),
    "input-saturation": _same("limit", "u_max"),
    "sensor-eccentricity": _wave("e", "a", "c", "s", 1.0),
    "cubic-stiffness": _same("k3", "k3"),
    "end-stop": _same("high", "q_max"),
    "pendulum-gravity": _pendulum,
    "actuator-lag": _same("T", "T"),
    "asymmetric-coulomb-friction": _same("F_pos", "F_pos"),
    "torque-ripple": _same("frequency", "f"),
    "one-sided-spring": _same("place", "q0"),
}

# A factor on a plant's own parameter counts from its nominal value: what the machine's perturbation did is in it.
SCALED = {
    "inertia": ("J", "M", "m"),
    "viscous-friction": ("Kf", "Fv", "c"),
    "torque-constant": ("Km",),
    "resistance": ("R",),
    "input-gain": ("gain",),
    "sensor-gain": (),
    "stiffness": ("k",),
}


def main_parameter(effect: str, site: str, case: Any) -> Told | None:
    """The catalogue's main parameter of a hidden effect and its true value; None where the two differ in kind."""
    p = case.true_parameters[effect]
    if effect in SCALED and "factor" in p:
        names = {1.0: ("J1",), 2.0: ("J2",)}.get(p.get("body", 0.0), SCALED[effect])
        if p.get("body") and site not in names:
            return None  # the other inertia was scaled
        if effect == "inertia" and case.rig.setup.inputs == "levels" and "J_nut" in case.perturbed:
            return "s", _actuator_inertia(case)
        return "s", p["factor"] * math.prod(case.perturbed.get(name, 1.0) for name in names)
    if effect == "stiffness":
        return "k", p["k"]
    if effect == "sensor-bias":
        return "b", p["current"] if site == "i" else p["angle"]
    return MAIN[effect](p) if effect in MAIN else None


def _actuator_inertia(case: Any) -> float:
    """All inertias of the linear actuator, scaled together, against their nominal sum."""
    setup = case.rig.setup
    nominal = setup.machine({name: value for name, (value, _) in setup.nominal.items()}).J1
    return case.machine.J1 / nominal


def interval(effect: Any, case: Any) -> dict[str, Any] | None:
    """Truth and 95 % interval of a named effect's main parameter, where it is a hidden one."""
    if effect.name not in case.true_parameters:
        return None
    told = main_parameter(effect.name, effect.site, case)
    if told is None:
        return None
    name, truth = told
    value = next((v for v in effect.parameters if v.name == name), None)
    if value is None:
        return None
    return {"effect": effect.name, "parameter": name, "truth": truth,
            "value": value.value, "lower": value.lower, "upper": value.upper}  # fmt: skip
