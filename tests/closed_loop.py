"""Records of unstable plants: a controller holds them, and every sample is one step of the plant's own integrator."""

from collections.abc import Callable, Sequence

import numpy as np

from robustlab.dynamics import NonlinearPlant, input_signal
from robustlab.record import Record

__all__ = ["closed_loop"]


def closed_loop(
    plant: NonlinearPlant,
    control: Callable[[float, np.ndarray], np.ndarray],
    x0: np.ndarray,
    n: int,
    dt: float,
    outputs: Sequence[str],
    noise: float,
    seed: int = 0,
) -> tuple[Record, np.ndarray]:
    """A record of n samples with white noise on the outputs, and the true states; ``control(t, x)`` gives inputs."""
    states, inputs = [np.array(x0, dtype=float)], []
    for k in range(n):
        inputs.append(np.asarray(control(k * dt, states[-1]), dtype=float))
        signal = input_signal(dt * np.array([k, k + 0.5, k + 1]), np.array([inputs[-1]] * 3), "zoh")
        states.append(plant.trajectory(signal, states[-1], 1e-10)[-1])
    x, u = np.array(states[:-1]), np.array(inputs)
    made, names = plant.outputs_along(x, u), [s.name for s in plant.outputs]
    rng = np.random.default_rng(seed)
    seen = {name: made[:, names.index(name)] + noise * rng.standard_normal(n) for name in outputs}
    units = {s.name: s.unit for s in (*plant.inputs, *plant.outputs) if s in plant.inputs or s.name in outputs}
    record = Record(dt * np.arange(n), {s.name: u[:, i] for i, s in enumerate(plant.inputs)}, seen, units, "run")
    return record, x
