"""Parameters of the Stewart platform: geometry, drive, bodies, motor; each with its unit and its source."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

from robustlab.dynamics.parameters import Parameter, Sign
from robustlab.errors import InputError, did_you_mean

__all__ = ["PRESETS", "Preset", "machine_parameters"]

Preset = Literal["thesis", "physical"]
PRESETS = ("thesis", "physical")

_A = "Březina 2010, App. A"
_B = "Březina 2010, App. B"
_FIT = "fitted to the holding torque 0.8701e-3 N m of section 8.2; not printed in the text"
_DISC = "uniform disc of 3.167 kg, radius 190 mm, height 10 mm; not printed in the text"
_SHEET = "Březina 2010, App. A and section 7.2 (Maxon RE 35, order number 273754)"

_PLATFORM_MASS = 3.167
_DISC_ACROSS = _PLATFORM_MASS * (3 * 0.190**2 + 0.010**2) / 12
_DISC_ALONG = _PLATFORM_MASS * 0.190**2 / 2


def _body(prefix: str, words: str, mass: float, inertia: tuple[float, float, float]) -> tuple[Parameter, ...]:
    """Mass and principal inertias about the centre of gravity, in the leg's axes I, J, K."""
    axes = zip(("I", "J", "K"), inertia, strict=True)
    return (
        Parameter(f"{prefix}_mass", mass, "kg", 0.0, _A, f"mass of the {words}", "nonnegative"),
        *(
            Parameter(
                f"{prefix}_{axis}",
                value,
                "kg m2",
                0.0,
                _A,
                f"inertia of the {words} about its {axis} axis",
                "nonnegative",
            )
            for axis, value in axes
        ),
    )


_GEOMETRY = (
    Parameter("r_b", 0.17502, "m", 0.0, _B, "radius of the base points", "positive"),
    Parameter("alpha_b", math.radians(10.84), "rad", 0.0, _B, "base points: angle from the middle of their pair"),
    Parameter("r_p", 0.190, "m", 0.0, _B, "radius of the platform points", "positive"),
    Parameter("alpha_p", math.radians(6.47), "rad", 0.0, _B, "platform points: angle from the middle of their pair"),
    Parameter("r_m", 0.17611, "m", 0.0, _B, "radius of the bearing points", "positive"),
    Parameter("alpha_m", math.radians(5.52), "rad", 0.0, _B, "bearing points: angle from their base points"),
    Parameter("z_m", 0.0169, "m", 0.0, _B, "height of the bearing points over the base points"),
    Parameter("c", 0.010, "m", 0.0, _A, "distance of the joint's two axes; 0: plain joint", "nonnegative"),
    Parameter("z_home", 0.1262, "m", 0.0, _B, "height of the home pose, where the nut angles are zero", "positive"),
    Parameter("L_min", 0.1590, "m", 0.0, "Březina 2010, section 6.1.1", "shortest actuator", "positive"),
    Parameter(
        "L_max", 0.1881, "m", 0.0, "Březina 2010, section 6.1.1 (188 mm; z = 0.1462 m needs 188.06)",
        "longest actuator",
        "positive",
    ),
)  # fmt: skip

_DRIVE = (
    Parameter("lead", 0.004, "m", 0.0, _A, "travel of the screw per turn of the nut", "positive"),
    Parameter("ratio", 4.8 * 41 / 21, "rad/rad", 0.0, "Březina 2010, section 6.1.1", "motor turns per nut turn",
              "positive"),
    Parameter("gravity", 9.81, "m/s2", 0.0, "standard", "acceleration of gravity, along -z"),
)  # fmt: skip

_ALONG: tuple[tuple[str, float, str, Sign], ...] = (
    ("link_cg", 0.06309, "lower link: centre of gravity from the second joint axis", "any"),
    ("nut_at", 0.08412, "where the nut begins, from the second joint axis", "any"),
    ("nut_cg", 0.004, "nut: centre of gravity from where it begins", "any"),
    ("screw_cg", 0.07414, "ball screw: centre of gravity from the platform point, towards the base", "any"),
    ("motor_x", 0.03, "motor body: offset from the leg's axis along I", "any"),
    ("motor_at", 0.1041, "where the motor body begins, from the second joint axis", "any"),
    ("motor_cg", 0.1087 / 2, "motor body: centre of gravity from where it begins; negative points to the base", "any"),
)

_BODIES = (
    Parameter("platform_mass", _PLATFORM_MASS, "kg", 0.0, _FIT, "mass of the platform", "positive"),
    Parameter("platform_x", _DISC_ACROSS, "kg m2", 0.0, _DISC, "inertia of the platform about its x axis", "positive"),
    Parameter("platform_y", _DISC_ACROSS, "kg m2", 0.0, _DISC, "inertia of the platform about its y axis", "positive"),
    Parameter("platform_z", _DISC_ALONG, "kg m2", 0.0, _DISC, "inertia of the platform about its z axis", "positive"),
    *_body("link", "lower link", 0.435, (5.07492e-4, 4.99276e-4, 1.31934e-4)),
    *_body("nut", "screw nut", 0.125, (1.9318e-5, 1.9312e-5, 2.2071e-5)),
    *_body("screw", "ball screw", 0.112, (1.93005e-4, 1.92973e-4, 1.996e-6)),
    *_body("motor", "motor body", 0.34, (3.73333e-4, 3.73325e-4, 6.4002e-5)),
    *(Parameter(name, value, "m", 0.0, _A, words, sign) for name, value, words, sign in _ALONG),
    Parameter(
        "rotor_J",
        0.0,
        "kg m2",
        0.0,
        "left out by the thesis (eqs 7.3, 7.4)",
        "inertia of the motor's rotor",
        "nonnegative",
    ),
)

_MOTOR = (
    Parameter("R", 2.07, "ohm", 0.0, _SHEET, "terminal resistance", "positive"),
    Parameter("L", 0.62e-3, "H", 0.0, _SHEET, "terminal inductance", "positive"),
    Parameter("Km", 0.052, "N m/A", 0.0, _SHEET, "torque constant", "positive"),
    Parameter("Kb", 0.052, "V s/rad", 0.0, _SHEET, "back-EMF constant", "nonnegative"),
    Parameter("Kf", 4.8e-5, "N m s/rad", 0.35, f"{_SHEET}; cover: section 10.1.1", "viscous friction", "nonnegative"),
)  # fmt: skip


def machine_parameters(preset: str, motors: bool) -> tuple[Parameter, ...]:
    """The published parameters; preset ``physical`` adds the rotor's inertia that the thesis leaves out.

    Raises
    ------
    InputError
        A preset that is not ``thesis`` or ``physical``, a ``motors`` that is not True or False.
    """
    if preset not in PRESETS:
        hint = did_you_mean(str(preset), PRESETS)
        raise InputError("stewart-platform: preset", f"{preset!r}", " or ".join(map(repr, PRESETS)), hint)
    if not isinstance(motors, bool):
        raise InputError("stewart-platform: motors", f"{motors!r}", "True or False")
    parameters = (*_GEOMETRY, *_DRIVE, *_BODIES, *(_MOTOR if motors else ()))
    if preset == "thesis":
        return parameters
    rotor = {"value": 7.2e-6, "source": _SHEET}
    return tuple(replace(p, **rotor) if p.name == "rotor_J" else p for p in parameters)
