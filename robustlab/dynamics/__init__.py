"""Plants from physics: parameters with sources, equations of motion, linear models, simulation."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, overload

from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.linearisation import linearise, trim
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.dynamics.plant_base import NonlinearPlant, Plant, Trim
from robustlab.dynamics.plant_file import plant_from_file, plant_reference, unit_reference
from robustlab.dynamics.simulation import simulate
from robustlab.errors import InputError, did_you_mean
from robustlab.public_names import lazily

if TYPE_CHECKING:
    from robustlab.dynamics.stewart.stewart_platform import StewartPlatform

# Further names for other packages and tests, loaded on first use: module -> names.
_INNER = {
    "control.controlled_plant": "TorqueGains actuator_cascade controlled_nonlinear controlled_plant driver_in_loop"
    " torque_gains",
    "control.platform": "LayeredController SineTrajectory closed_loop follow follow_sine follow_with_torques measured"
    " torque_loop two_layer upper_layer",
    "descriptor_elimination": "eliminated",
    "effects.catalogue": "KINDS KIND_OF MEANINGS add_effect catalogue effect upwards",
    "effects.effect": "Effect EffectParameter Footprint Law Prior Scales Site",
    "effects.spring_effects": "DAMPING",
    "extended.attached_effect": "AttachedEffect holding_force is_set_valued rest_band steady_force",
    "extended.effect_blocks": "Dry delay_block effect_blocks effect_loads",
    "extended.extended_plant": "ExtendedPlant extended_model",
    "extended.feed_forward": "DryLevel FeedForward Wave feed_forward",
    "extended.simulator": "SampledInput Simulator Windows stepping",
    "plant_base": "LocalModels PortPlace input_signal",
    "plants.linear": "linear_actuator",
    "ports.port_model": "linear_plant_of local_port_model parameter_groups port_model shares_behind",
    "symbolic.symbolic_plant": "OPERATIONS Tape tape_of",
}
_, __getattr__ = lazily(__name__, _INNER)

__all__ = [
    "Descriptor",
    "LinearPlant",
    "NonlinearPlant",
    "Parameter",
    "Plant",
    "Trim",
    "builtin_plant",
    "linearise",
    "overridden",
    "plant",
    "plant_names",
    "simulate",
    "trim",
]

# name -> the function that makes the plant from its parameters
_PLANTS = {
    "dc-motor": "plants.linear.dc_motor",
    "brushless-motor": "plants.linear.brushless_motor",
    "servo-axis": "plants.linear.servo_axis",
    "mass-spring-damper": "plants.linear.mass_spring_damper",
    "two-mass": "plants.linear.two_mass",
    "linear-actuator": "plants.linear.linear_actuator",
    "stewart-platform": "stewart.stewart_platform.stewart_platform",
}


# Completion of ``rl.plant(...)`` in editors; a test compares the names with the table.
LinearName = Literal[
    "dc-motor", "brushless-motor", "servo-axis", "mass-spring-damper", "two-mass", "linear-actuator"
]  # fmt: skip


@overload
def plant(name: LinearName, **parameters: Any) -> LinearPlant: ...
@overload
def plant(name: Literal["stewart-platform"], **parameters: Any) -> StewartPlatform: ...
@overload
def plant(name: str, **parameters: Any) -> Plant: ...
def plant(name: str, **parameters: Any) -> Plant:
    """The named plant with its published parameters, or with the given ones in their places.

    Parameters
    ----------
    name
        One of `plant_names`; or ``"path/to/file.py:name"``, a plant of your own or a function that returns one; or
        ``"path/to/machine.fmu"``, a functional mock-up unit for co-simulation: that file is run.
    **parameters
        Name -> value (the published tolerance stays) or name -> ``(value, relative tolerance)``. The Stewart platform
        also takes ``preset="thesis"`` or ``"physical"`` and ``motors=True`` or ``False``; a unit ``time_limit``.

    Returns
    -------
    Plant
        A `LinearPlant`, or a `NonlinearPlant`; from a file, with the file's SHA-256 in its ``provenance``.

    Raises
    ------
    InputError
        Unknown plant or parameter (with the closest known name), NaN, a mass or resistance that is not positive; a file
        that raises, or in which no plant of that name is (`robustlab.dynamics.plant_file`).

    Examples
    --------
    >>> motor = plant("dc-motor", Kf=(4.8e-5, 0.35))
    >>> motor.parameters["R"].value, motor.parameters["R"].unit
    (2.07, 'ohm')
    """
    if isinstance(name, str) and unit_reference(name):
        from robustlab.dynamics.fmu import fmu

        return fmu(name, **parameters)
    if isinstance(name, str) and plant_reference(name):
        return plant_from_file(name, parameters)
    return builtin_plant(name, **parameters)


def builtin_plant(name: str, **parameters: Any) -> Any:
    """Return a built-in plant; names from data files must run no code."""
    if not isinstance(name, str) or name not in _PLANTS:
        known = f"one of {', '.join(_PLANTS)}, path/to/file.py:name or path/to/machine.fmu"
        raise InputError(f"plant {name!r}", "no such plant", known, did_you_mean(str(name), plant_names()))
    module, _, function = _PLANTS[name].rpartition(".")
    return getattr(import_module(f"robustlab.dynamics.{module}"), function)(**parameters)


def plant_names() -> tuple[str, ...]:
    """Return the names of the built-in plants."""
    return tuple(_PLANTS)
