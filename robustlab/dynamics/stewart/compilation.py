"""The compiled kernels of the platform, loaded on first use."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import ModuleType

from robustlab.dynamics.integrator.compilation import compiled

__all__ = ["kernels", "motion_kernels"]

HERE = Path(__file__).parent
TEXT = "stewart-platform: compiling the equations of motion (once on this machine, a minute or two) ..."


@cache
def kernels() -> ModuleType:
    """Module of the compiled kinematics and dynamics."""
    return compiled(HERE / "kernels.py", "robustlab.dynamics.stewart.kernels", (), TEXT)


@cache
def motion_kernels() -> ModuleType:
    """Module of the compiled integrators."""
    from robustlab.dynamics.integrator.dop853 import TABLE

    steps = HERE.parent / "integrator" / "steps.py"
    leaves = (HERE / "kernels.py", steps, TABLE)
    return compiled(HERE / "motion_kernels.py", "robustlab.dynamics.stewart.motion_kernels", leaves, TEXT)
