"""``robustlab doctor``: can this installation do its work?

With ``--warm`` what is compiled on first use is compiled now, by using each part on a tiny problem. Nothing here knows
a compiled function: a part that gets a new one needs no line here while its problem reaches it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit
from robustlab.cli.options import JsonOption, grouped
from robustlab.cli.progress import Display, ProgressOptions
from robustlab.errors import EnvironmentFault, RobustlabError
from robustlab.shown import text_table as table


@dataclass(frozen=True)
class Warmed:
    """What was made ready: seconds of each part, where the code is kept, and what was left out and why."""

    cache: str
    seconds: dict[str, float] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """Lines for people."""
        times = ", ".join(f"{name} {took:.1f} s" for name, took in self.seconds.items())
        lines = [f"ready in {sum(self.seconds.values()):.1f} s: {times}", f"compiled code is kept in {self.cache}"]
        return "\n".join(lines + [f"left out: {name} ({why})" for name, why in self.left_out.items()])


def cache_place() -> str:
    """Where numba keeps what it compiles for this package: in it, in ``NUMBA_CACHE_DIR``, or in the user's own cache.

    Raises EnvironmentFault: nothing is compiled (``NUMBA_DISABLE_JIT``); RuntimeError: none of the three can be
    written: numba's error, which every command ends on with exit code 5.
    """
    from numba import njit

    kept = getattr(njit(cache=True)(_nothing), "stats", None)  # the place is chosen here; compiled when it is called
    if kept is None:
        raise EnvironmentFault("doctor --warm", "nothing is compiled", "NUMBA_DISABLE_JIT unset")
    place = Path(kept.cache_path)
    package = Path(__file__).parents[1]
    return f"{package} (its __pycache__ folders)" if package in place.parents else str(place.parent)


def _nothing() -> None:
    """Stands for any function of this package."""


def warm_up(display: Display) -> Warmed:
    """Use every part that has something to compile, and say how long each took."""
    found, done = Warmed(cache_place()), 0
    for name, (weight, use, needed) in _PARTS.items():
        if needed and find_spec(needed) is None:
            found.left_out[name] = f"needs {needed}: pip install 'robustlab[{needed}]'"
        else:
            display(f"compiling: {name}")
            began = time.monotonic()
            use()
            found.seconds[name] = time.monotonic() - began
        done += weight
        display.step(done)
    return found


def _use_mu() -> None:
    import numpy as np

    import robustlab as rl

    row = np.array([0.1, 2.0, 0.2, 0.3, 0.1])
    matrix = np.array([np.roll(row, k) for k in range(5)], dtype=complex)
    rl.mu(matrix, [rl.RealScalar("a", 2), rl.ComplexScalar("b"), rl.FullBlock("c", 2, 2)])


def _responses() -> None:
    import numpy as np

    import robustlab as rl

    motors = rl.plant("dc-motor", R=(2.07, 0.1)).uncertain(outputs=["omega"])
    rl.robust_stability(motors)
    t = np.linspace(0.0, 0.05, 20_001)  # what is shorter is not compiled
    members = rl.sample(motors, 4)
    members.respond(t, {"u": np.full(t.size, 42.0)})


def _discovery() -> None:
    import numpy as np

    import robustlab as rl
    from robustlab.dynamics.effects.catalogue import effect_names

    # An axis with dry friction, noise of a micrometre, and few candidates: the least that goes through every stage.
    t, rng = 2.5e-3 * np.arange(500), np.random.default_rng(0)
    u = np.repeat(rng.uniform(-3.0, 3.0, size=10), 50)
    axis = rl.plant("servo-axis")
    rl.simulate(rl.with_effects(axis, {"actuator-lag": {"T": 0.01}}), t, u)
    q = rl.simulate(rl.with_effects(axis, {"coulomb-friction": {"Fc": 20.0}}), t, u)["q"]
    record = rl.Record(t, {"u": u}, {"q": q + 1e-6 * rng.standard_normal(t.size)}, {"u": "V", "q": "m"})
    rl.compare(axis, record)
    rl.discover(axis, record, exclude=sorted(set(effect_names()) - {"coulomb-friction", "constant-load"}))


def _platform() -> None:
    import numpy as np

    import robustlab as rl

    platform = rl.plant("stewart-platform")
    rest = rl.trim(platform)
    rl.linearise(platform, at=rest)
    rl.simulate(platform, np.linspace(0.0, 0.005, 6), np.tile(rest.u, (6, 1)), rest.x)


def _own_plants() -> None:
    import numpy as np

    import robustlab as rl

    equations = rl.PlantEquations("spring")
    force = equations.input("F", "N")
    x, _ = equations.joint("x", "v", "m")
    equations.motion(2.0, force - 50.0 * x)
    equations.output("x", x, "m")
    rl.simulate(equations.plant(), np.linspace(0.0, 0.1, 11), np.ones(11), np.zeros(2))


# Part -> (seconds that compiling it took alone on one core, which is its share of the bar; its problem; what it needs).
_PARTS: dict[str, tuple[int, Callable[[], None], str]] = {
    "mu": (19, _use_mu, ""),
    "responses of samples": (3, _responses, ""),
    "effects and their discovery": (20, _discovery, ""),
    "stewart-platform": (22, _platform, ""),
    "plants of your own": (5, _own_plants, "casadi"),
}
WEIGHT = sum(weight for weight, _, _ in _PARTS.values())


app = typer.Typer(help="Say whether this installation can work.", add_completion=False)

_OK = "ok"


@app.command()
@grouped
def doctor(
    *,
    warm: Annotated[
        bool, typer.Option("--warm", help="Also compile all that is compiled on first use, and keep it: minutes, once.")
    ] = False,
    progress: ProgressOptions,
    as_json: JsonOption = False,
) -> None:
    """Try every native library once and print the versions; exit code 5 where something needed is missing.

    Example: robustlab doctor --warm
    """
    from robustlab.provenance import library_versions

    warmed = None
    if warm:  # before the checks, one of which would compile a part of it unseen
        with progress.shown("doctor", WEIGHT, lines=True, budgets=False) as display:
            warmed = warm_up(display)
    checks = {name: _outcome(check) for name, check in _CHECKS.items()}
    versions = library_versions()
    healthy = all(found.startswith(_OK) for found in checks.values())
    verdict = "this installation can work" if healthy else "something needed is missing: see above"
    text = f"{table(list(checks.items()))}\n\n{table(list(versions.items()))}\n\n{verdict}"
    result: dict[str, Any] = {"healthy": healthy, "checks": checks, "versions": versions}
    if warmed is not None:
        result["warm"] = asdict(warmed)
        text += f"\n\n{warmed.text}"
    emit("doctor", result, text, as_json)
    if not healthy:
        raise typer.Exit(EnvironmentFault.exit_code)


def _outcome(check) -> str:  # pyright: ignore[reportMissingParameterType]
    try:
        return f"{_OK}: {check()}"
    except (ImportError, OSError, AssertionError, RobustlabError) as error:
        return f"missing: {type(error).__name__}: {error}"


def _mu() -> str:
    import numpy as np

    bounds = rl.mu(np.array([[0.0, 2.0], [2.0, 0.0]], dtype=complex), [rl.ComplexScalar("a"), rl.ComplexScalar("b")])
    assert abs(bounds.upper - 2.0) < 1e-6, f"mu of [[0, 2], [2, 0]] came out as {bounds.upper}, not 2"
    return "mu of a known matrix is right"


def _riccati() -> str:
    import numpy as np
    from scipy.linalg import solve_continuous_are

    one = np.ones((1, 1))
    x = solve_continuous_are(0 * one, one, one, one)
    assert abs(x[0, 0] - 1.0) < 1e-12, f"x^2 = 1 came out as {x[0, 0]}"
    return "a Riccati equation with a known answer is solved"


def _clarabel() -> str:
    from importlib import import_module

    import numpy as np
    from scipy.sparse import csc_matrix

    clarabel = import_module("clarabel")  # it ships no types

    # min x subject to x >= 1
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.NonnegativeConeT(1)]
    solution = clarabel.DefaultSolver(
        csc_matrix((1, 1)), np.ones(1), csc_matrix([[-1.0]]), -np.ones(1), cones, settings
    ).solve()
    assert abs(solution.x[0] - 1.0) < 1e-6, f"min x over x >= 1 came out as {solution.x[0]}"
    return "a program with a known answer is solved"


def _cvxpy() -> str:
    from importlib import import_module

    cvxpy: Any = import_module("cvxpy")  # its types do not say what a problem's value is
    x = cvxpy.Variable()
    try:
        found = cvxpy.Problem(cvxpy.Minimize(x), [x >= 1]).solve(solver="CLARABEL")
    except cvxpy.SolverError as error:
        raise EnvironmentFault("cvxpy", str(error), "a problem solved with Clarabel") from None
    assert abs(found - 1.0) < 1e-6, f"min x over x >= 1 came out as {found}"
    return f"cvxpy {cvxpy.__version__} solves with Clarabel"


def _hdf5() -> str:
    import tempfile
    from pathlib import Path

    import h5py
    import numpy as np

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "check.h5"
        with h5py.File(path, "w") as file:
            file.create_dataset("A", data=np.eye(2), fletcher32=True)
        with h5py.File(path, "r") as file:
            dataset = file["A"]
            assert isinstance(dataset, h5py.Dataset)
            assert (dataset[()] == np.eye(2)).all(), "a matrix came back changed"
    return f"HDF5 {h5py.version.hdf5_version} writes and reads with checksums"


def _figures() -> str:
    import matplotlib

    return f"matplotlib {matplotlib.__version__}"


def _recipes() -> str:
    from robustlab.recipe.shipped import shipped_recipes

    found = shipped_recipes()
    assert found, "no shipped recipe was found beside the package"
    return ", ".join(found)


def _threads() -> str:
    import os

    import numpy as np
    from threadpoolctl import threadpool_info

    np.dot(np.eye(2), np.eye(2))  # loads the BLAS that is asked about
    pools = ", ".join(f"{pool['internal_api']} {pool['num_threads']}" for pool in threadpool_info())
    return f"{os.cpu_count()} cores; threads: {pools or 'one'}"


_CHECKS = {
    "mu": _mu,
    "scipy": _riccati,
    "clarabel": _clarabel,
    "cvxpy": _cvxpy,
    "h5py": _hdf5,
    "matplotlib": _figures,
    "recipes": _recipes,
    "threads": _threads,
}
