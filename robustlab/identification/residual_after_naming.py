"""What is left of the unknown force once the named effects are in the model.

The named effects' forces, the input as the plant sees it, and what the sensors add to the outputs are known from the
simulation of the windows. With them as known inputs the model is linear again, and the smoother tells the force that
still lacks, with its standard deviation, sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.dynamics.effects.simulator import Simulator, Windows
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.disturbance_smoother import smooth_disturbance
from robustlab.identification.effect_fit import Fit, NoiseModel, Problem
from robustlab.identification.prepared_record import PreparedRecord
from robustlab.identification.unnamed_effect import (
    ResidualForce,
    StructureTest,
    UnnamedForce,
    fit_unnamed,
    residual_force,
    structure_left,
)
from robustlab.statespace import StateSpaceModel

__all__ = ["LeftOver", "left_over"]

Array = NDArray[np.float64]

BLOCKS = 32  # over all records
MOST_SAMPLES = 6000  # over all records; the force is smooth, so every so manieth sample tells it


@dataclass(frozen=True, eq=False)
class LeftOver:
    """The residual force at the first joint (or the first input) with the named effects in the model.

    Attributes
    ----------
    port, unit
        The joint and the unit of the force.
    force, std, coordinates, blocks
        Samples over all records, (n,); coordinates by name; block label of each sample.
    structure
        Whether anything systematic remains.
    """

    port: str
    unit: str
    units: dict[str, str]
    force: Array
    std: Array
    coordinates: dict[str, Array]
    blocks: NDArray[np.int_]
    structure: StructureTest

    def curves(self) -> ResidualForce:
        """The force over each coordinate."""
        return residual_force(self.force, self.std, self.coordinates, self.units, unit=self.unit, blocks=self.blocks)

    def unnamed(self) -> UnnamedForce:
        """Its spline map."""
        return fit_unnamed(self.force, self.std, self.coordinates, self.blocks, unit=self.unit)


def left_over(problem: Problem, fit: Fit, noise: NoiseModel) -> LeftOver | None:
    """The residual force over the given records; None where there is hardly any motion.

    The parameters stay as fitted; the starts of all windows are found anew.
    """
    everything = problem.on(problem.records)
    placed = everything.fit(fit.hypothesis, noise, fit.z, iterations=8, fixed=True, tolerance=0.5)
    parts = [
        _of_record(everything, placed, k, simulator)
        for k, simulator in enumerate(everything.simulators(fit.hypothesis))
    ]
    known = [p for p in parts if p is not None]
    if not known:
        return None
    per_record = max(4, BLOCKS // len(known))
    step = max(1, sum(len(p[2]) for p in known) // MOST_SAMPLES)
    blocks = [k * per_record + np.arange(len(p[2])) * per_record // len(p[2]) for k, p in enumerate(known)]
    force = np.concatenate([p[2][::step] for p in known])
    std = np.concatenate([p[3][::step] for p in known])
    coordinates = {name: np.concatenate([p[4][name][::step] for p in known]) for name in known[0][4]}
    labels = np.concatenate([b[::step] for b in blocks])
    try:
        structure = structure_left(force, std, coordinates, labels)
    except InputError:  # hardly any motion
        return None
    port = known[0][0]
    return LeftOver(port, known[0][1], known[0][5], force, std, coordinates, labels, structure)


def _of_record(
    problem: Problem, fit: Fit, k: int, simulator: Simulator
) -> tuple[str, str, Array, Array, dict[str, Array], dict[str, str]] | None:
    """Port, unit, force, std, coordinates and their units along one record."""
    record = problem.records[k]
    factors, values = problem.split(fit.hypothesis, fit.z)
    model = simulator.model(factors, values)
    joint = next((p for p in model.ports.values() if p.kind == "joint"), None)
    # A plant without a joint: what it lacks is told as an addition to its first input.
    first = problem.plant.inputs[0]
    push, name, unit = (joint.force, joint.name, joint.unit) if joint else (model.B[:, 0], first.name, first.unit)
    windows = record.windows
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    x0 = problem.starts_seen(k, simulator, values) + record.x0_std * fit.starts[k]
    known, columns, added = _known_inputs(simulator, factors, values, record, x0)
    y = record.y[used] - added
    seen = np.isfinite(y).any(axis=0)
    rows, y = np.array(record.columns)[seen], y[:, seen]
    linear = StateSpaceModel(
        model.A, np.hstack([model.B, columns]), model.C[rows],
        np.hstack([model.D[rows], np.zeros((len(rows), columns.shape[1]))]),
    )  # fmt: skip
    t = record.record.dt * np.arange(len(used))
    contiguous = np.all(np.diff(used) == 1)
    if not contiguous:
        return None
    # The test turns the signs of whole blocks, which must not hang together by the smoother's own memory: where there
    # is hardly any force the likelihood makes that longer than a block, and chance would look like structure.
    least = max(4, BLOCKS // len(problem.records)) / (len(t) * record.record.dt)
    try:
        smoothed = smooth_disturbance(linear, push[:, None], t, known, y, jumps=False)
        if smoothed.bandwidth[0] < least:
            smoothed = smooth_disturbance(linear, push[:, None], t, known, y, bandwidth=least, jumps=False)
    except NoTrustworthyNumber:
        return None
    x = smoothed.x
    units, coordinates = {"time": "s"}, {"time": record.record.t[used]}
    if joint is not None:
        coordinates["speed"] = x @ joint.velocity
        units["speed"] = joint.speed_unit
    else:
        for k_y in record.columns:
            signal = problem.plant.outputs[k_y]
            coordinates[f"output {signal.name}"] = x @ model.C[k_y]
            units[f"output {signal.name}"] = signal.unit
    if joint is not None and joint.position is not None:
        coordinates["position"] = x @ joint.position
        units["position"] = joint.position_unit
    for j, signal in enumerate(problem.plant.inputs):
        coordinates[f"input {signal.name}"] = record.u[used, j]
        units[f"input {signal.name}"] = signal.unit
    return name, unit, smoothed.d[:, 0], smoothed.d_std[:, 0], coordinates, units


def _known_inputs(
    simulator: Simulator,
    factors: dict[str, float],
    values: Sequence[dict[str, float]],
    record: PreparedRecord,
    x0: Array,
) -> tuple[Array, Array, Array]:
    """Inputs of the linear model (n, n_u + n_laws), columns of the laws' forces (n_x, n_laws), what sensors add."""
    windows = Windows(record.windows.starts, record.windows.length)
    motion = simulator.run(factors, values, x0, windows)
    model = simulator.model(factors, values)
    laws = [law for (e, site), v in zip(simulator.effects, values, strict=True) for law in e.laws(site, v)]
    columns = np.zeros((len(model.A), len(laws)))
    for j, law in enumerate(laws):
        columns[:, j] = model.ports[law.port].force
    # The force noted at a sample is that of the step before it; held over a sample it belongs one sample earlier.
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    forces = motion.forces.reshape(len(used), len(laws))
    forces = np.vstack([forces[1:], forces[-1:]])
    seen = simulator.seen_input(values).reshape(-1, simulator.sub, record.u.shape[1]).mean(axis=1)[used]
    plain = motion.states @ model.C.T
    if model.D.any():
        plain = plain + seen.reshape(len(windows.starts), windows.length, -1) @ model.D.T
    added = (motion.outputs - plain)[:, :, list(record.columns)].reshape(len(used), -1)
    return np.hstack([seen, forces]), columns, added
