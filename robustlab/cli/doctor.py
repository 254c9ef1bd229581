"""``robustlab doctor``: check the installation."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

import typer

import robustlab as rl
from robustlab.cli.console import emit
from robustlab.cli.generated import JsonOption
from robustlab.display import text_table as table
from robustlab.errors import EnvironmentFault, RobustlabError

app = typer.Typer(help="Say whether this installation can work.", add_completion=False)

_OK = "ok"


@app.command()
def doctor(as_json: JsonOption = False) -> None:
    """Try every native library once and print the versions; exit code 5 where something needed is missing.

    Example: robustlab doctor
    """
    from robustlab.provenance import library_versions

    checks = {name: _outcome(check) for name, check in _CHECKS.items()}
    versions = library_versions()
    healthy = all(found.startswith(_OK) for found in checks.values())
    verdict = "this installation can work" if healthy else "something needed is missing: see above"
    text = f"{table(list(checks.items()))}\n\n{table(list(versions.items()))}\n\n{verdict}"
    result: dict[str, Any] = {"healthy": healthy, "checks": checks, "versions": versions}
    emit("doctor", result, text, as_json)
    if not healthy:
        raise typer.Exit(EnvironmentFault.exit_code)


def _outcome(check) -> str:  # pyright: ignore[reportMissingParameterType]
    try:
        return f"{_OK}: {check()}"
    except (ImportError, OSError, AssertionError, RobustlabError) as error:
        return f"missing: {type(error).__name__}: {error}"


def _solvers() -> str:
    import numpy as np
    from scipy.linalg import solve_continuous_are

    bounds = rl.mu(np.array([[0.0, 2.0], [2.0, 0.0]], dtype=complex), [rl.ComplexScalar("a"), rl.ComplexScalar("b")])
    assert abs(bounds.upper - 2.0) < 1e-6, f"mu of [[0, 2], [2, 0]] came out as {bounds.upper}, not 2"
    one = np.ones((1, 1))
    x = solve_continuous_are(0 * one, one, one, one)
    assert abs(x[0, 0] - 1.0) < 1e-12, f"x^2 = 1 came out as {x[0, 0]}"
    return "mu of a known matrix and a Riccati equation with a known answer are right"


def _cvxpy() -> str:
    cvxpy: Any = import_module("cvxpy")  # untyped
    x = cvxpy.Variable()
    try:
        found = cvxpy.Problem(cvxpy.Minimize(x), [x >= 1]).solve(solver="CLARABEL")
    except cvxpy.SolverError as error:
        raise EnvironmentFault("cvxpy", str(error), "a problem solved with Clarabel") from None
    assert abs(found - 1.0) < 1e-6, f"min x over x >= 1 came out as {found}"
    return f"cvxpy {cvxpy.__version__} solves with Clarabel"


def _hdf5() -> str:
    import tempfile

    model = rl.ss(-1.0, 1.0, 1.0, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        again: Any = rl.load(rl.save(Path(folder) / "check.h5", model))
    assert (again.A == model.A).all(), "a matrix came back changed"
    return "HDF5 is written, and read in a process of its own, with checksums"


def _recipes() -> str:
    from robustlab.recipe.shipped import shipped_recipes

    found = shipped_recipes()
    assert found, "no shipped recipe was found beside the package"
    return ", ".join(found)


def _threads() -> str:
    from threadpoolctl import threadpool_info

    import_module("numpy.linalg")  # loads BLAS
    pools = ", ".join(f"{pool['internal_api']} {pool['num_threads']}" for pool in threadpool_info())
    return f"{os.cpu_count()} cores; threads: {pools or 'one'}"


_CHECKS = {
    "mu, scipy": _solvers,
    "cvxpy": _cvxpy,
    "h5py": _hdf5,
    "matplotlib": lambda: f"matplotlib {import_module('matplotlib').__version__}",
    "recipes": _recipes,
    "threads": _threads,
}
