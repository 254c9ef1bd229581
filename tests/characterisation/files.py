"""One HDF5 file of each kind, written at the recorded revision: each loads for ever, to the same numbers.

``python -c "from characterisation.files import write; write()"`` wrote them, with tests on the path; a file that is
there is not written again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import robustlab as rl

from .cases import HERE, Case

RTOL = 1e-12
RTOLS: dict[str, float] = {}
FILES = HERE / "files"


def cases() -> Iterator[Case]:
    """One a file."""
    for path in sorted(FILES.glob("*.h5")):
        yield Case(path.stem, lambda path=path: held(path))


def held(path: Any) -> dict[str, Any]:
    """What a file holds; of evidence, whether it is proved from the file alone."""
    found = rl.load(path)
    answer = content(found)
    if path.stem in ("margin", "design", "gain"):
        answer["proved"] = rl.verify(str(path)).proved
    return answer


def content(thing: Any) -> dict[str, Any]:
    """Matrices, signals, blocks, delays, parameters, channels: what an object has of these."""
    found: dict[str, Any] = {}
    for name in ("A", "B", "C", "D", "dt", "delays", "omega", "t", "model_frequency"):
        if hasattr(thing, name):
            found[name] = np.asarray(getattr(thing, name))
    for name in ("inputs", "outputs", "states"):
        signals = getattr(thing, name, ())
        if isinstance(signals, dict) or hasattr(signals, "items"):
            found[name] = {key: np.asarray(value) for key, value in signals.items()}
        else:
            found[name] = [f"{s.name} [{s.unit}]" for s in signals]
    for name in ("M", "H", "K", "model"):
        part = getattr(thing, name, None)
        if part is not None and hasattr(part, "A"):
            found[name] = content(part)
    if hasattr(thing, "blocks"):
        found["blocks"] = [f"{type(b).__name__} {b.name} {b.rows}" for b in thing.blocks]
    if hasattr(thing, "values") and not callable(thing.values):
        found["values"] = dict(thing.values)
    if hasattr(thing, "status"):
        found["status"] = thing.status
    for name in ("lower", "upper"):
        if isinstance(getattr(thing, name, None), float):
            found[f"its {name}"] = getattr(thing, name)
    if hasattr(thing, "data") and hasattr(thing.data, "items"):
        found["data"] = {k: v for k, v in thing.data.items() if isinstance(v, (int, float, str)) and " " not in str(v)}
    return found


def pendulum() -> Any:
    """A plant of one's own that is not linear."""
    import casadi

    p = rl.PlantEquations("pendulum")
    J = p.parameter("J", 0.01, "kg m2", tolerance=0.1, role="inertia", meaning="inertia", source="assumed")
    m = p.parameter("m", 0.4, "N m", meaning="weight times arm", source="assumed")
    torque = p.input("T", "N m")
    phi, omega = p.joint("phi", "omega", "rad")
    p.motion(J, torque - 0.01 * omega - m * casadi.sin(phi))
    p.output("phi", phi, "rad")
    return p.plant()


def write() -> None:
    """Write every file that is not there."""
    for name, make in made().items():
        if not (FILES / f"{name}.h5").exists():
            rl.save(FILES / f"{name}.h5", make())


def made() -> dict[str, Callable[[], Any]]:
    """File -> what it holds."""
    G = rl.StateSpaceModel([[-1.0, 2], [0, -3]], [[0.0], [1]], [[1.0, 0]], [[0.5]], 0.0, [("u", "V")], [("y", "rad/s")])
    P = rl.StateSpaceModel([[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    motor = rl.plant("dc-motor", R=(2.07, 0.1), Kf=(4.8e-5, 0.35))
    cases_of_all = [
        rl.RealScalar("a", 2, rl.ParameterRange(1.0, 0.2, "m")),
        rl.ComplexScalar("b"),
        rl.FullBlock("c", 1, 2),
    ]
    rng = np.random.default_rng(1)
    M = rl.StateSpaceModel([[-1.0]], rng.standard_normal((1, 6)), rng.standard_normal((6, 1)), 0.1 * np.eye(6))
    t = np.arange(5) * 0.1
    return {
        "state-space": lambda: G,
        "uncertain": lambda: rl.UncertainModel(M, cases_of_all),
        "delayed": lambda: rl.with_delays(G, {"u": 0.01}),
        "frequency-data": lambda: rl.frequency_data(motor.uncertain(outputs=["omega"]), [1.0, 10.0]),
        "controller": lambda: rl.hinf(P, 1, 1).K,
        "design": lambda: rl.hinf(P, 1, 1),
        "margin": lambda: rl.robust_stability(motor.uncertain(outputs=["omega"])),
        "gain": lambda: rl.peak_gain(motor.uncertain(outputs=["omega"])),
        "norm": lambda: rl.peak_gain(G),
        "record": lambda: rl.Record(t, {"u": t**2}, {"q": np.sin(t)}, {"u": "V", "q": "rad"}, name="short"),
        "plant": lambda: motor,
        "plant-with-effects": lambda: rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction@v": {"Fc": 20.0}}),
        "platform": lambda: rl.plant("stewart-platform"),
        "own-plant": pendulum,
        "lpv": lambda: rl.lpv_model(motor.uncertain(outputs=["omega"])),
    }
