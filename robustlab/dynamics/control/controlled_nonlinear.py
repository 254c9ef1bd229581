r"""A nonlinear plant under feedback, as a plant of its own: it takes effects, other parameters, and any reference.

About the rest :math:`(x_0, u_0, y_0)` at which the controller takes hold,

.. math::
    \dot x = f(x, u), \quad \dot x_k = A_k x_k + B_k v, \quad u = u_0 + C_k x_k + D_k v, \quad
    v = \begin{bmatrix} r \\ y_m \end{bmatrix} - \begin{bmatrix} y_{0,c} \\ y_{0,m} \end{bmatrix}, \quad y = h(x)

Its slopes are exact where the plant's own are, and forces act at the plant's own ports: dry friction is attached to
the loop as it is to the plant (`robustlab.with_effects`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.control.controlled_plant import loop_parts
from robustlab.dynamics.extended.extended_nonlinear import ExtendedNonlinearPlant
from robustlab.dynamics.extended.extended_plant import with_effects
from robustlab.dynamics.plant_contract import LocalModels, NonlinearPlant, PortPlace, Trim
from robustlab.errors import InputError
from robustlab.result import Status
from robustlab.statespace import Signal, StateSpaceModel

__all__ = ["ControlledNonlinearPlant", "controlled_nonlinear"]


def controlled_nonlinear(
    plant: NonlinearPlant, K: Any, controlled: Sequence[str], measured: Sequence[str], at: Trim
) -> ControlledNonlinearPlant | ExtendedNonlinearPlant:
    """The plant under ``u = K v``, with v = (references of the controlled outputs, measured outputs).

    Parameters
    ----------
    plant
        Without direct term; with effects at its joints and parameters or without.
    K
        Continuous controller in deviations from ``at``: an input for each reference and each measured output, in this
        order, an output for each input of the plant.
    controlled, measured
        Names of outputs of the plant.
    at
        A rest of the plant.

    Returns
    -------
    ControlledNonlinearPlant or ExtendedNonlinearPlant
        Inputs ``<name>_ref``, outputs those of the plant and its inputs, states those of the plant, then
        ``controller_1`` ...; the latter where the plant has effects.

    Raises
    ------
    InputError
        Unknown outputs, a controller of other sizes or a discrete one; an effect on an input or output, or one that
        splits a joint: these act inside the loop, between controller and plant.
    """
    model, c, m = loop_parts(plant, K, controlled, measured)
    base, effects = (plant.plant, plant.effects) if isinstance(plant, ExtendedNonlinearPlant) else (plant, ())
    for e in effects:
        if e.on_signal or e.effect.structural:
            raise InputError(f"{plant.name} under control", e.in_words, "forces at joints, and parameters")
    n = len(base.states)
    rest = replace(at, x=at.x[:n].copy())
    loop = ControlledNonlinearPlant.of(f"{plant.name} under control", base, model, c, m, rest)
    return with_effects(loop, effects) if effects else loop


@dataclass(frozen=True, eq=False, repr=False)
class ControlledNonlinearPlant(NonlinearPlant):
    """A nonlinear plant under a linear controller; made by `controlled_nonlinear`.

    Inputs are the references ``<name>_ref``, outputs those of the plant and its inputs, states those of the plant, then
    ``controller_1`` ...

    Attributes
    ----------
    plant
        The plant, without direct term from inputs to outputs.
    K
        The controller, from (references, measured outputs) to the plant's inputs, in deviations from ``at``.
    measured
        Numbers of the plant's outputs that the controller sees.
    at
        The rest of the plant at which it takes hold.
    offset
        v at that rest, (n_r + n_m,).
    """

    plant: NonlinearPlant
    K: StateSpaceModel
    measured: tuple[int, ...]
    at: Trim
    offset: Array

    @classmethod
    def of(
        cls, name: str, plant: NonlinearPlant, K: StateSpaceModel, controlled: Sequence[int], measured: Sequence[int],
        at: Trim,
    ) -> ControlledNonlinearPlant:  # fmt: skip
        """The loop of a controller whose sizes are known to be right."""
        references = tuple(Signal(f"{plant.outputs[i].name}_ref", plant.outputs[i].unit) for i in controlled)
        states = (*plant.states, *(Signal(f"controller_{k + 1}") for k in range(K.n_states)))
        offset = at.y[[*controlled, *measured]]
        return cls(
            name, plant.parameters, references, (*plant.outputs, *plant.inputs), states, plant, K, tuple(measured), at,
            offset,
        )  # fmt: skip

    def with_parameters(self, **given: Any) -> ControlledNonlinearPlant:
        """The same controller at the plant with other values, or (value, relative tolerance)."""
        plant = self.plant.with_parameters(**given)
        return replace(self, plant=plant, parameters=plant.parameters)

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        """Those of the plant."""
        return self.plant.port_places

    @property
    def start(self) -> Array:
        """The rest at which the controller takes hold."""
        return np.concatenate([self.at.x, np.zeros(self.K.n_states)])

    def check_reach(self, t: Array, x: Array) -> None:
        """Whether the plant can be there."""
        self.plant.check_reach(t, x[:, : len(self.plant.states)])

    # --- rates and outputs -------------------------------------------------------------------------------------------

    def _parts(self, x: Array, r: Array, values: Mapping[str, float] | None) -> tuple[Array, Array, Array, Array]:
        """The plant's states, its outputs, v and its inputs at points x (n, n_x), r (n, n_r)."""
        own, inner = np.split(x, [len(self.plant.states)], axis=1)
        y = self.plant.outputs_along(own, np.tile(self.at.u, (len(x), 1)), values)
        v = np.hstack([r, y[:, list(self.measured)]]) - self.offset
        return own, y, v, self.at.u + inner @ self.K.C.T + v @ self.K.D.T

    def rates_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        """Rates (n, n_x) of the plant's states and of the controller's."""
        own, _, v, force = self._parts(x, u, values)
        inner = x[:, own.shape[1] :] @ self.K.A.T + v @ self.K.B.T
        return np.hstack([self.plant.rates_along(own, force, values), inner])

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        """The plant's outputs and its inputs along a trajectory."""
        _, y, _, force = self._parts(x, u, values)
        return np.hstack([y, force])

    def local_models(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> LocalModels:
        """The loop about points x (n, n_x), references u (n, n_r).

        Raises
        ------
        InputError
            A plant with a direct term from an input to an output.
        """
        own, y, v, force = self._parts(x, u, values)
        local, k, n = self.plant.local_models(own, force, values), self.K, len(x)
        if local.D.any():
            raise InputError(self.name, "a direct term from input to output", "a plant without one")
        n_r = len(self.inputs)
        seen = local.C[:, list(self.measured)]

        def many(matrix: Array) -> Array:
            return np.broadcast_to(matrix, (n, *matrix.shape))

        to_force = np.concatenate([k.D[:, n_r:] @ seen, many(k.C)], axis=2)
        to_inner = np.concatenate([k.B[:, n_r:] @ seen, many(k.A)], axis=2)
        none = np.zeros((n, 1, k.n_states))
        a = np.concatenate([local.A, none.repeat(own.shape[1], axis=1)], axis=2) + local.B @ to_force
        c = np.concatenate([local.C, none.repeat(y.shape[1], axis=1)], axis=2)
        return LocalModels(
            np.hstack([local.rates, x[:, own.shape[1] :] @ k.A.T + v @ k.B.T]),
            np.hstack([y, force]),
            np.concatenate([a, to_inner], axis=1),
            np.concatenate([local.B @ k.D[:, :n_r], many(k.B[:, :n_r])], axis=1),
            np.concatenate([c, to_force], axis=1),
            np.concatenate([np.zeros((n, y.shape[1], n_r)), many(k.D[:, :n_r])], axis=1),
            np.concatenate([local.push, np.zeros((n, k.n_states, local.push.shape[2]))], axis=1),
        )

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``f(x, r)``, shape (n_x,)."""
        state, reference = self.point(x, u)
        return self.rates_along(state[None], reference[None])[0]

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``h(x, r)``, shape (n_y + n_u,)."""
        state, reference = self.point(x, u)
        return self.outputs_along(state[None], reference[None])[0]

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D at (x, r), as exact as the plant's own."""
        state, reference = self.point(x, u)
        local = self.local_models(state[None], reference[None])
        return local.A[0], local.B[0], local.C[0], local.D[0]

    def equilibrium(self, **where: Any) -> Trim:
        """The rest at which the controller takes hold, with the references there.

        Raises
        ------
        InputError
            Anything asked for: the rest is the controller's.
        """
        if where:
            raise InputError(f"{self.name}: trim", f"{next(iter(where))!r}", "nothing: the controller has its rest")
        x, r = self.start, self.offset[: len(self.inputs)].copy()
        residual = float(np.abs(self.derivative(x, r)).max())
        return Trim(self.name, x, r, self.output(x, r), residual, None, Status.CONVERGED)
