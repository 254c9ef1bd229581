r"""A linear plant under feedback, as a plant of its own: it takes effects, other parameters, and any reference.

.. math::
    E(p) \dot x = F(p) x + G(p) u, \qquad \dot x_k = A_k x_k + B_k v, \qquad u = C_k x_k + D_k v, \qquad
    v = \begin{bmatrix} r \\ y_m \end{bmatrix}

The physical parameters stay where they are in the equations, so that dry friction and the like are attached in their
own units (`robustlab.with_effects`), and a member of the uncertain set is simulated with ``with_parameters``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robustlab.dynamics.control.controllers import torque_gains
from robustlab.dynamics.linear_plant import Descriptor, LinearPlant
from robustlab.dynamics.plant_contract import Plant
from robustlab.errors import InputError, did_you_mean
from robustlab.statespace import Signal, StateSpaceModel, as_model, real_array

__all__ = ["actuator_cascade", "controlled_plant", "loop_parts"]


def controlled_plant(plant: LinearPlant, K: Any, controlled: Sequence[str], measured: Sequence[str]) -> LinearPlant:
    """The plant under ``u = K v`` with v = (references of the controlled outputs, measured outputs).

    Parameters
    ----------
    plant
        Continuous linear plant without direct term.
    K
        Continuous controller: an input for each reference and each measured output, in this order, an output for each
        input of the plant.
    controlled, measured
        Names of outputs of the plant.

    Returns
    -------
    LinearPlant
        Inputs ``<name>_ref``; outputs those of the plant and its inputs; states those of the plant, then
        ``controller_1`` ...

    Raises
    ------
    InputError
        Unknown outputs, a controller of other sizes or a discrete one, a plant with a direct term.

    Examples
    --------
    >>> from robustlab.dynamics import plant, simulate
    >>> motor = plant("dc-motor")
    >>> gain = StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[2.0, -2.0]])
    >>> loop = controlled_plant(motor, gain, ["phi"], ["phi"])
    >>> float(simulate(loop, [0.0, 0.1, 0.2], [1.0, 1.0, 1.0])["phi"][-1].round(3))
    1.0
    """
    where = f"{plant.name} under control"
    model, c, m = loop_parts(plant, K, controlled, measured)
    n, n_k, n_r = len(plant.states), model.n_states, len(c)
    from_r, from_y = model.B[:, :n_r], model.B[:, n_r:]
    d_r, d_y = model.D[:, :n_r], model.D[:, n_r:]

    def equations(p: Mapping[str, float]) -> Descriptor:
        e, f, g, out, direct = plant.matrices(p)
        if direct.any():
            raise InputError(where, "a direct term from input to output", "a plant without one")
        seen = out[m]
        return Descriptor(
            E=np.block([[e, np.zeros((n, n_k))], [np.zeros((n_k, n)), np.eye(n_k)]]),
            F=np.block([[f + g @ d_y @ seen, g @ model.C], [from_y @ seen, model.A]]),
            G=np.vstack([g @ d_r, from_r]),
            C=np.block([[out, np.zeros((len(out), n_k))], [d_y @ seen, model.C]]),
            D=np.vstack([np.zeros((len(out), n_r)), d_r]),
        )

    references = tuple(Signal(f"{plant.outputs[i].name}_ref", plant.outputs[i].unit) for i in c)
    states = (*plant.states, *(Signal(f"controller_{k + 1}") for k in range(n_k)))
    return LinearPlant(
        where, plant.parameters, references, (*plant.outputs, *plant.inputs), states,
        equations=equations, exact=plant.exact,
    )  # fmt: skip


def loop_parts(
    plant: Plant, K: Any, controlled: Sequence[str], measured: Sequence[str]
) -> tuple[StateSpaceModel, list[int], list[int]]:
    """A controller as a model, and the numbers of the outputs that it controls and that it sees.

    Raises
    ------
    InputError
        Unknown outputs, a controller of other sizes or a discrete one.
    """
    model, where = as_model(K, "controller"), f"{plant.name} under control"
    c, m = _positions(where, controlled, plant), _positions(where, measured, plant)
    sizes = (len(c) + len(m), len(plant.inputs))
    if (model.n_inputs, model.n_outputs) != sizes:
        found = f"{model.n_inputs} inputs and {model.n_outputs} outputs"
        raise InputError(f"{where}: controller", found, f"{sizes[0]} and {sizes[1]}")
    if model.is_discrete:
        hint = "the design before its step discretise; that step (rl.discretise_controller) judges the sampled loop"
        raise InputError(f"{where}: controller", f"a discrete one, dt = {model.dt:g} s", "a continuous one", hint)
    return model, c, m


def actuator_cascade(plant: LinearPlant, p_up: float = 236.0, p_low: float = 3000.0) -> StateSpaceModel:
    r"""The two layers of the thesis for one actuator: an I-PD for the angle above a loop for the motor's torque.

    .. math::
        m_{ref} = K_i \int (r - \varphi) - K_p \varphi - K_d \omega, \quad m = K_m i - K_f \omega, \quad
        u = \sigma - k_d m, \quad \dot\sigma = k_i \xi - k_p m, \quad \dot\xi = m_{ref} - m

    with :math:`K_p, K_d, K_i = (3 p^2, 3 p, p^3)\, J_t` for the whole inertia :math:`J_t` at the motor's shaft and the
    lower layer's gains for a motor that turns its rotor alone (`robustlab.dynamics.control.controllers.torque_gains`).

    Parameters
    ----------
    plant
        ``plant("linear-actuator")`` with a rotor inertia J > 0.
    p_up, p_low
        Triple poles of the layers in 1/s.

    Returns
    -------
    StateSpaceModel
        Inputs phi_ref [rad], phi [rad], omega [rad/s], i [A]; output u [V]; three states.

    Raises
    ------
    InputError
        Another plant, poles that are not positive, no rotor inertia.

    References
    ----------
    Březina 2010, eqs 9.1-9.4.
    """
    needed = ("R", "L", "Km", "Kb", "Kf", "J")
    if not isinstance(plant, LinearPlant) or any(n not in plant.values for n in needed) or len(plant.states) != 3:
        raise InputError("actuator cascade", f"plant {plant.name!r}", 'plant("linear-actuator")')
    for name, value in (("p_up", p_up), ("p_low", p_low), ("J", plant.values["J"])):
        if not float(real_array(name, value, 0, "actuator cascade")) > 0:
            raise InputError(f"actuator cascade: {name}", f"{value:g}", "a positive number")
    p, model = plant.values, plant.state_space()
    inertia = p["Km"] / model.A[1, 2]
    gains = torque_gains(p_low, **{name: p[name] for name in needed})
    torque = np.array([0.0, 0.0, -p["Kf"], p["Km"]])
    upper = np.array([0.0, -3 * p_up**2, -3 * p_up, 0.0]) * inertia
    a = [[0.0, 0.0, 0.0], [p_up**3 * inertia, 0.0, 0.0], [0.0, gains.ki, 0.0]]
    b = np.vstack([[1.0, -1.0, 0.0, 0.0], upper - torque, -gains.kp * torque])
    names = [("phi_ref", "rad"), *(Signal(s.name, s.unit) for s in plant.states)]
    states = ["error_integral", "torque_integral", "sigma"]
    return StateSpaceModel(
        a, b, [[0.0, 0.0, 1.0]], -gains.kd * torque[None], 0.0, names, plant.inputs, states, where="actuator cascade"
    )


def _positions(where: str, names: Sequence[str], plant: Plant) -> list[int]:
    known = [s.name for s in plant.outputs]
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"{where}: output {name!r}", "no such output", f"one of {', '.join(known)}", hint)
    return [known.index(name) for name in names]
