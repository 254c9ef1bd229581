"""Small files that commands are tried on."""

from pathlib import Path

import numpy as np

import robustlab as rl

SPRING = """
A = [[0, 1], ["-k/m", "-c/m"]]
B = [[0], ["1/m"]]
C = [[1, 0]]
D = [[0]]
inputs = [["F", "N"]]
outputs = ["x"]
[parameters]
m = [3.0, 0.4]
k = [2.0, 1.4, 3.0]
c = {nominal = 1.0, low = 0.8, high = 1.5, unit = "N s/m"}
"""


def write_models(folder: Path) -> None:
    """Write into ``folder``: models, sets, controllers, a design problem, a plant with effects, and a record.

    ======================  ==========================================================================
    lag, fast, unstable     first order, 1 x 1
    two-by-two              two integrators that turn, with the gain gain.h5
    bad                     an unstable mode that no control moves
    p                       a generalised plant: w, n, u to z, effort, y
    pole, lost              sets: x' = -(1 + 0.2 d) x + u; unstable
    motor, speed            sets: the motor with Kf +-35 %, all its outputs or its speed
    k, digital, silent      controllers: two with their sign, and a bare model
    machine                 a plant: the motor with dry friction, a heavier rotor and a late input
    run                     a record of the servo axis, as HDF5, and as run.csv with other names
    ======================  ==========================================================================
    """

    def save(name: str, thing: object) -> None:
        rl.save(folder / f"{name}.h5", thing)

    one = [[1.0]]
    for name, pole in (("lag", -1.0), ("fast", -1.2), ("unstable", 1.2)):
        save(name, rl.StateSpaceModel([[pole]], one, one, [[0.0]]))
    M = rl.StateSpaceModel([[1.2]], one, one, [[0.0]])
    save("lost", rl.UncertainModel(M, [rl.RealScalar("a")]))
    turning = rl.StateSpaceModel([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))
    save("two-by-two", turning)
    save("gain", rl.StateSpaceModel([], [], [], [[1, -2], [0, 1]]))
    save("bad", rl.StateSpaceModel([[1.0]], [[1, 0]], [[1], [1]], np.eye(2)))
    p = rl.StateSpaceModel(
        [[-1.0]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        inputs=["w", "n", "u"], outputs=["z", "effort", "y"],
    )  # fmt: skip
    save("p", p)
    M = rl.StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    save("pole", rl.UncertainModel(M, [rl.RealScalar("pole", parameter=rl.ParameterRange(1.0, 0.2, "1/s"))]))
    save("motor", rl.plant("dc-motor", Kf=(4.8e-5, 0.35)).uncertain())
    save("speed", rl.plant("dc-motor", Kf=(4.8e-5, 0.35)).uncertain(["omega"]))
    K = rl.StateSpaceModel([[-1.7, 0], [0, -90]], [[0.5], [0.01]], [[-0.4, 0.01]], [[0]], inputs=["y"], outputs=["u"])
    save("k", rl.Controller(K))
    save("silent", rl.StateSpaceModel([], [], [], [[0.3]]))
    save("digital", rl.Controller(rl.StateSpaceModel([], [], [], [[-2.0]], 0.01, [("q", "m")], [("u", "V")])))
    effects = {"coulomb-friction": {"Fc": (2e-3, 1e-4)}, "inertia": {"s": (1.2, 0.03)}, "input-delay": {"d": 2e-3}}
    save("machine", rl.with_effects(rl.plant("dc-motor", R=(2.1, 0.1)), effects))
    (folder / "spring.toml").write_text(SPRING)
    t = np.arange(800) * 1e-2
    u = np.repeat(np.random.default_rng(0).standard_normal(16), 50)
    q = rl.simulate(rl.plant("servo-axis", M=110.0), t, u)["q"]
    save("run", rl.Record(t, {"u": u}, {"q": q}, {"u": "V", "q": "m"}, "run"))
    columns = np.column_stack([t, u, q])
    np.savetxt(folder / "run.csv", columns, delimiter=",", header="time,drive [V],Q", comments="", fmt="%.12g")
    text = (folder / "run.csv").read_text().replace(",", ";").replace(".", ",")
    (folder / "comma.csv").write_text(text)
