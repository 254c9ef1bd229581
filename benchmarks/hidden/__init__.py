"""Blind test data for effect identification: machines with hidden effects.

Independent of robustlab's own simulation and effects on purpose: another integrator with finer steps, another
parametrisation of every effect (bristles, contacts, thermal masses). Of robustlab only `Record` and `plant` are used.

>>> from hidden import FAMILIES, make_case
>>> case = make_case("coulomb-friction", seed=1, noise="mid")
>>> case.record.n, case.effects
(4800, ('coulomb-friction',))
"""

from .cases import NOISE, Case, make_case
from .effects import NothingInCommon
from .families import ANYWHERE, CURRENT_ONLY, FAMILIES, Family, merged

__all__ = ["ANYWHERE", "CURRENT_ONLY", "FAMILIES", "NOISE", "Case", "Family", "NothingInCommon", "make_case", "merged"]
