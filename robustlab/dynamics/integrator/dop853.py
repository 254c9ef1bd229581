"""Coefficients of the explicit Runge-Kutta pair of order 8(5, 3) with its dense output of order 7: those of scipy.

They stand in a module of scipy that is not part of its public interface. What is taken from it is checked here by
shape, and by a test against published values and the order conditions.
"""

from __future__ import annotations

from robustlab.errors import EnvironmentFault

try:
    from scipy.integrate._ivp import dop853_coefficients as table
    from scipy.integrate._ivp.dop853_coefficients import E3, E5, A, B, C, D
except ImportError as error:
    raise EnvironmentFault(
        "DOP853", f"scipy no longer has its coefficients where they were ({error})", "scipy < 1.18"
    ) from error

__all__ = ["E3", "E5", "STAGES_EXTENDED", "TABLE", "A", "B", "C", "D"]

# Stages 0..11 make the step, stage 12 is its end, 13..15 serve the dense output.
STAGES_EXTENDED = 16
TABLE = table.__file__
SHAPES = {"A": (16, 16), "B": (12,), "C": (16,), "D": (4, 16), "E3": (13,), "E5": (13,)}

for name, shape in SHAPES.items():
    if getattr(table, name).shape != shape:
        raise EnvironmentFault("DOP853", f"scipy's {name} has the shape {getattr(table, name).shape}", f"{shape}")
