"""``robustlab doctor``: working and missing parts."""

import numpy as np
from shell import robustlab

from robustlab.provenance import library_versions


def test_doctor_reports_every_check():
    data = robustlab("doctor", "--json", code=0).json
    assert data["healthy"]
    assert data["versions"]["numpy"] == np.__version__
    assert all(line.startswith("ok") for line in data["checks"].values())


def test_doctor_tells_the_version_of_the_module_cvxpy_whichever_package_brought_it(monkeypatch):
    from importlib import metadata

    import cvxpy

    data = robustlab("doctor", "--json").json
    assert data["checks"]["cvxpy"] == f"ok: cvxpy {cvxpy.__version__} solves with Clarabel"
    assert cvxpy.__version__ in data["versions"]["cvxpy"]

    both = {"cvxpy": "1.9.3", "cvxpy-base": "1.8.2"}
    monkeypatch.setattr(metadata, "version", lambda name: both.get(name, "7"))
    assert library_versions()["cvxpy"] == "1.8.2 or 1.9.3"
    monkeypatch.setattr(metadata, "version", lambda name: {"cvxpy": "1.7.0", "cvxpy-base": "1.7.0"}.get(name, "7"))
    assert library_versions()["cvxpy"] == "1.7.0"


def test_doctor_reports_cvxpy_without_clarabel(monkeypatch):
    import cvxpy

    def unsolved(*_: object, **__: object) -> float:
        raise cvxpy.SolverError("The solver CLARABEL is not installed.")

    monkeypatch.setattr(cvxpy.Problem, "solve", unsolved)
    out = robustlab("doctor", code=5).out
    assert "missing: EnvironmentFault: cvxpy: The solver CLARABEL is not installed." in out
