r"""The force at each joint of a nonlinear plant that is left once the named effects are in it.

Along the recorded motion the plant with its effects gives the rates

.. math:: A_e \begin{bmatrix} \bar x \\ z \end{bmatrix} + B u + E\,(f(\bar x, u) - A \bar x - B u) + \sum_j b_j F_j

with the effects' states z and forces :math:`F_j` as simulated (A and E with what effects have changed). What the
sensors tell beyond these is smoothed joint by joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.dynamics.extended.simulator import Simulator, Windows
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.dynamics.ports.port_model import Port
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.hypotheses.effect_fit import Fit, Problem
from robustlab.identification.hypotheses.motion_smoother import lacking_forces

__all__ = ["JointResiduals", "joint_residuals"]


@dataclass(frozen=True, eq=False)
class JointResiduals:
    """Forces left along one record at all joints."""

    ports: tuple[Port, ...]  # of the joints, in the order of the columns
    # force, std: (n, n_joints)
    force: Array
    std: Array
    x: Array  # the motion, (n, n_x)
    used: Indices  # samples of the record, (n,)


def joint_residuals(problem: Problem, fit: Fit, k: int, simulator: Simulator, least: float) -> JointResiduals | None:
    """Of one record of a nonlinear plant; None where its windows lie in pieces, or there is no joint.

    Parameters
    ----------
    least
        Lowest bandwidth of the forces in Hz.
    """
    plant, record = problem.plant, problem.records[k]
    assert isinstance(plant, NonlinearPlant)
    assert record.motion is not None
    windows = Windows(record.windows.starts, record.windows.length)
    used = (windows.starts[:, None] + np.arange(windows.length)).ravel()
    factors, values, shift = problem.setting(fit.hypothesis, fit.z)
    x0 = problem.starts_seen(k, simulator, values) + record.x0_std * fit.starts[k]
    motion, about, model = simulator.run_along(factors, values, x0, windows, shift)
    assert about is not None
    names = [p.name for p in plant.port_places if p.kind == "joint"]
    if np.any(np.diff(used) != 1) or not names:
        return None
    n, own, n_u = len(used), model.own, len(plant.inputs)
    mean = simulator.seen_input(values, shift)[0][used]
    x = record.motion[used]
    middle = np.vstack([0.5 * (x[1:] + x[:-1]), x[-1:]])
    z = motion.states.reshape(n, -1)[:, own:]
    steps = len(about.steps) // n  # a sample
    rates, point = about.rates[::steps], about.points
    total = (model.A[point, :own] @ np.hstack([middle, z])[..., None])[..., 0]
    total += (model.B[point, :own] @ np.hstack([mean, rates])[..., None])[..., 0]
    # The force noted at a sample is that of the step before it; held over a sample it belongs one sample earlier.
    forces = motion.forces.reshape(n, -1)
    forces = np.vstack([forces[1:], forces[-1:]])
    for j, law in enumerate(simulator.laws(values)):
        total += model.ports[law.port].force[point, :own] * forces[:, j : j + 1]
    columns = list(record.columns)
    plain = simulator.plain_outputs(motion.states, about, model, mean.reshape(*motion.states.shape[:2], n_u))
    added = (motion.outputs - plain)[:, :, columns].reshape(n, -1)
    try:
        t = record.record.dt * np.arange(n)
        force, std = lacking_forces(plant, t, record.u[used], record.y[used] - added, columns, x, total, least)
    except NoTrustworthyNumber:
        return None
    return JointResiduals(tuple(model.ports[name] for name in names), force, std, x, used)
