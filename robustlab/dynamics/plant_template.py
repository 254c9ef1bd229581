"""A plant to start from: the file that ``robustlab plant new`` writes."""

from __future__ import annotations

import keyword
import os
import re
from importlib.util import find_spec
from pathlib import Path

from robustlab.errors import EnvironmentFault, UsageError
from robustlab.files.atomic import atomic_write

__all__ = ["PLANT", "TEMPLATE", "write_template"]

# The plant in the template.
PLANT = "axis"

TEMPLATE = '''\
"""{stem}: a carriage on an incline, pushed by a motor and held by a spring that stiffens.

Look at it:                robustlab plant show {file}:axis
Against a measurement:     robustlab data compare {file}:axis run.csv --inputs F --outputs x
What does the model lack:  robustlab data discover {file}:axis run.csv --inputs F --outputs x
"""

import casadi as ca  # sin, cos, sqrt, ... of expressions

import robustlab as rl


def axis(**given):
    p = rl.PlantEquations("{stem}")

    # What you know of the machine: name, value, SI unit. tolerance=0.05: the true value is within 5 % of this one. With
    # a tolerance, say the parameter's role: inertia, viscous-friction, torque-constant, resistance, inductance,
    # stiffness, input-gain, or none. An effect such as "inertia wrong" changes all parameters of that role.
    m = p.parameter("m", 12.0, "kg", tolerance=0.05, role="inertia", meaning="moving mass", source="weighed")
    c = p.parameter("c", 60.0, "N s/m", tolerance=0.3, role="viscous-friction", meaning="guide", source="assumed")
    k = p.parameter("k", 800.0, "N/m", tolerance=0.1, role="stiffness", meaning="spring", source="data sheet")
    h = p.parameter("h", 2e5, "N/m3", meaning="how the spring stiffens", source="measured once")
    slope = p.parameter("slope", 0.35, "rad", meaning="incline", source="drawing")
    g = p.parameter("g", 9.81, "m/s2", meaning="gravity", source="standard value, rounded")

    # What drives the machine.
    F = p.input("F", "N")

    # A joint: a coordinate (in m or rad) and its velocity. Friction, backlash and other effects can act there.
    x, v = p.joint("x", "v", "m")

    # Its equation of motion, mass matrix times accelerations = forces, with one row for each joint. Write it as on
    # paper: robustlab makes derivatives, points of rest and linear models of it.
    p.motion([[m]], [F - m * g * ca.sin(slope) - k * x - h * x**3 - c * v])

    # What is measured.
    p.output("x", x, "m")
    return p.plant(**given)
'''


def write_template(name: str) -> Path:
    """Write ``NAME.py`` in the working directory, or in the folder before the name; a file that is there stays.

    Raises
    ------
    UsageError
        A name that a module cannot have, or that Python knows as another module.
    EnvironmentFault
        The file exists already, or cannot be written.
    """
    folder, last = os.path.split(name)
    stem = last.removesuffix(".py")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,59}", stem) or keyword.iskeyword(stem):
        raise UsageError(f"plant new {name}", "not a name", "letters, digits and _, with a letter first")
    path = Path(folder, f"{stem}.py")
    if path.exists() or path.is_symlink():
        raise EnvironmentFault(str(path), "exists already", "a new name")
    if find_spec(stem) is not None:
        raise UsageError(f"plant new {name}", "the name of a module that Python knows", "a name of your own")
    text = TEMPLATE.format(stem=stem, file=path)
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return path
