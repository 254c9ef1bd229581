"""robustlab: a robust-control workbench. ``import robustlab as rl``; every public name is loaded on first use.

The table below is the whole public interface.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {
    # models
    "StateSpaceModel": "statespace",
    "Signal": "statespace",
    "Record": "record",
    "load": "storage",
    "save": "storage",
    # plants from physics
    "plant": "dynamics",
    "trim": "dynamics",
    "linearise": "dynamics",
    "simulate": "dynamics",
    # uncertainty
    "RealScalar": "uncertainty.blocks",
    "ComplexScalar": "uncertainty.blocks",
    "FullBlock": "uncertainty.blocks",
    "ParameterRange": "uncertainty.blocks",
    "UncertainModel": "uncertainty.lft",
    "elementwise": "uncertainty.elementwise",
    # analysis
    "sample": "worst_case_analysis",
    "worst_case": "worst_case_analysis",
    "mu": "mu_analysis",
    "robust_stability": "mu_analysis",
    "hinf_norm": "norms",
    "controllability": "structural",
    "observability": "structural",
    "frequency_response": "frequency",
    # synthesis
    "hinf": "synthesis",
    "mixsyn": "synthesis",
    "Controller": "synthesis",
    # measurements
    "compare": "identification",
    # trust
    "Status": "result",
    "RobustlabError": "errors",
    "InputError": "errors",
    "NoTrustworthyNumber": "errors",
}

__all__ = list(_PUBLIC)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from robustlab.provenance import robustlab_version

        return robustlab_version()
    if name in _PUBLIC:
        return getattr(import_module(f"robustlab.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module 'robustlab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, "__version__"])
