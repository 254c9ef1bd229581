"""Other formulas of the same physics: a namer has to find the kind, whichever formula the machine follows.

Each takes the place of the usual one of its effect (`hidden.effects`), with the same draws and some of its own.

References
----------
Dahl, A solid friction model (1968); Tustin, The effects of backlash and of speed-dependent friction on the stability of
closed-cycle control systems (1947), an exponential fall; Hunt and Crossley, Coefficient of restitution interpreted as
damping in vibroimpact (1975); Hertz, contact of two spheres: force over the 3/2-th power of the depth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from .effects import STIFF, Draw, Hidden, Parameters, Put, Setting, hidden_effect
from .machine import Machine

__all__ = ["LAWS", "hidden_law"]


def _nothing(r: np.random.Generator, s: Setting) -> Parameters:
    return {}


def _width(r: np.random.Generator, s: Setting) -> Parameters:
    """A hundredth of the speed, or less: smoothed as simulations do, not a viscous friction."""
    return {"width": s.speed * r.uniform(0.3, 1.5)}


def _ratio(r: np.random.Generator, s: Setting) -> Parameters:
    return {"ratio": r.uniform(0.05, 0.3)}


def _depth(r: np.random.Generator, s: Setting) -> Parameters:
    """Of the stroke; there the stop is as stiff as the straight one."""
    return {"depth": s.length * r.uniform(0.02, 0.1)}


def _bristle(m: Machine, level: float, bend: float, damping: float) -> Machine:
    stiffness = level / bend
    return m._replace(s0=stiffness, s1=2 * damping * math.sqrt(stiffness * m.J1))


def _usual(effect: str, **fields: str) -> Put:
    """The usual formula, with constants of its own beside it: field of the machine = parameter."""

    def put(m: Machine, p: Parameters, s: Setting) -> Machine:
        own = {field: p[parameter] for field, parameter in fields.items()}
        return hidden_effect("", effect).put(m, p, s)._replace(**own)

    return put


def _kelvin_stop(m: Machine, p: Parameters, s: Setting) -> Machine:
    stopped = hidden_effect("", "end-stop").put(m, p, s)
    return stopped._replace(kelvin=2 * p["ratio"] * math.sqrt(stopped.k_stop * m.J1), c_stop=0.0)


def _kelvin_teeth(m: Machine, p: Parameters, s: Setting) -> Machine:
    geared = hidden_effect("", "backlash").put(m, p, s)
    reduced = geared.J1 * geared.J2 / (geared.J1 + geared.J2)
    return geared._replace(kelvin_teeth=2 * p["ratio"] * math.sqrt(geared.k_s * reduced))


LAWS: Mapping[str, Mapping[str, tuple[Draw, Put]]] = {
    "coulomb-friction": {
        "tanh": (_width, _usual("coulomb-friction", smooth="width")),
        "micro-damped": (
            _ratio,
            lambda m, p, s: _bristle(m, p["Fc"], STIFF * s.length, p["ratio"])._replace(Fc=p["Fc"]),
        ),
        "dahl": (_nothing, lambda m, p, s: _bristle(m, p["Fc"], STIFF * s.length, 0.0)._replace(Fc=p["Fc"])),
    },
    "stribeck-friction": {
        "tanh": (_width, _usual("stribeck-friction", smooth="width")),
        "exponential": (lambda r, s: {"power": 1.0}, _usual("stribeck-friction", bend_vs="power")),
    },
    "presliding": {
        "damped": (
            lambda r, s: {"ratio": r.uniform(0.3, 0.7)},
            lambda m, p, s: _bristle(m, p["Fc"], p["bend"], p["ratio"])._replace(Fc=p["Fc"]),
        ),
        "dahl": (_nothing, lambda m, p, s: _bristle(m, p["Fc"], p["bend"], 0.0)._replace(Fc=p["Fc"])),
    },
    "end-stop": {"kelvin-voigt": (_ratio, _kelvin_stop), "hertz": (_depth, _usual("end-stop", hertz="depth"))},
    "backlash": {"kelvin-voigt": (_ratio, _kelvin_teeth)},
}


def hidden_law(plant: str, effect: str, law: str | None) -> Hidden:
    """The effect as this plant may have it, after one of its other formulas where one is named.

    Raises ValueError: no such formula.
    """
    usual = hidden_effect(plant, effect)
    if law is None:
        return usual
    if law not in LAWS.get(effect, {}):
        raise ValueError(f"law {law!r} of {effect}: one of {', '.join(LAWS.get(effect, {})) or 'none'}")
    more, put = LAWS[effect][law]
    return Hidden(lambda r, s: {**usual.draw(r, s), **more(r, s)}, put, usual.by_the_clock)
