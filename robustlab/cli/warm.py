"""``robustlab doctor --warm``: what is compiled on first use, compiled now, by using each part on a tiny problem.

Nothing here knows a compiled function: a part that gets a new one needs no line here while its problem reaches it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from robustlab.cli.progress import Display
from robustlab.errors import EnvironmentFault


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

    Raises
    ------
    EnvironmentFault
        Nothing is compiled (``NUMBA_DISABLE_JIT``).
    RuntimeError
        None of the three can be written: numba's error, which every command ends on with exit code 5.
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


def warm(display: Display) -> Warmed:
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


def _mu() -> None:
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
    members.stream(t[:101], {"u": np.full(101, 42.0)})


def _discovery() -> None:
    import numpy as np

    import robustlab as rl

    # An axis with dry friction, noise of a micrometre, and few candidates: the least that goes through every stage.
    t, rng = 2.5e-3 * np.arange(500), np.random.default_rng(0)
    u = np.repeat(rng.uniform(-3.0, 3.0, size=10), 50)
    axis = rl.plant("servo-axis")
    rl.simulate(rl.with_effects(axis, {"actuator-lag": {"T": 0.01}}), t, u)
    q = rl.simulate(rl.with_effects(axis, {"coulomb-friction": {"Fc": 20.0}}), t, u)["q"]
    record = rl.Record(t, {"u": u}, {"q": q + 1e-6 * rng.standard_normal(t.size)}, {"u": "V", "q": "m"})
    rl.compare(axis, record)
    rl.discover(axis, record, exclude=sorted(set(rl.effect_names()) - {"coulomb-friction", "constant-load"}))


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
    "mu": (19, _mu, ""),
    "responses of samples": (3, _responses, ""),
    "effects and their discovery": (20, _discovery, ""),
    "stewart-platform": (22, _platform, ""),
    "plants of your own": (5, _own_plants, "casadi"),
}
WEIGHT = sum(weight for weight, _, _ in _PARTS.values())
