"""Blind test data for naming a missing effect: machines with something hidden in them.

Independent of robustlab's own simulation and effects on purpose: another integrator with finer steps, another
parametrisation of every effect (bristles, contacts, thermal masses). Of robustlab only `Record` and `plant` are used.

>>> from hidden import CLASSES, make_case
>>> case = make_case("coulomb-friction", seed=1, noise="mid")
>>> case.record.n, case.effects
(4800, ('coulomb-friction',))
"""

from .cases import CLASSES, CURRENT_ONLY, NOISE, OUTSIDE, PAIRS, SERVO_CLASSES, SERVO_OUTSIDE, Case, make_case

__all__ = [
    "CLASSES",
    "CURRENT_ONLY",
    "NOISE",
    "OUTSIDE",
    "PAIRS",
    "SERVO_CLASSES",
    "SERVO_OUTSIDE",
    "Case",
    "make_case",
]
