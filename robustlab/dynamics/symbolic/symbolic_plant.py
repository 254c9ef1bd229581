r"""Nonlinear plants whose equations are tapes: what `robustlab.dynamics.symbolic.equations.PlantEquations` makes.

.. math:: \dot x = f(x, u, p), \qquad y = h(x, u, p)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.parameters import overridden
from robustlab.dynamics.plant_contract import InputSignal, LocalModels, NonlinearPlant, PortPlace, Trim
from robustlab.dynamics.symbolic.labels import labels
from robustlab.dynamics.symbolic.rest import rest
from robustlab.dynamics.symbolic.tape import Tape, tape_kernels
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.statespace import real_array

__all__ = ["Equations", "SymbolicPlant"]


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of a plant as tapes of (x, u, p): states, inputs, parameters, each in the plant's order."""

    # rates, outputs: to f (n_x,) and h (n_y,)
    rates: Tape
    outputs: Tape
    models: Tape  # to f, h, A, B, C, D and push of `robustlab.dynamics.plant_contract.LocalModels`, each row by row
    places: tuple[PortPlace, ...]  # where forces act, in the order of push


@dataclass(frozen=True, eq=False, repr=False)
class SymbolicPlant(NonlinearPlant):
    """A plant of one's own; made by `robustlab.dynamics.symbolic.equations.PlantEquations`.

    Attributes
    ----------
    equations
        Its tapes.

    Raises
    ------
    InputError
        Tapes of other sizes than the signals and parameters.
    """

    equations: Equations

    def __post_init__(self) -> None:
        super().__post_init__()
        n_x, n_u, n_y = len(self.states), len(self.inputs), len(self.outputs)
        n_in, n_ports = n_x + n_u + len(self.parameters), len(self.equations.places)
        models = n_x + n_y + (n_x + n_y) * (n_x + n_u) + n_x * n_ports
        for name, n_out in (("rates", n_x), ("outputs", n_y), ("models", models)):
            tape: Tape = getattr(self.equations, name)
            if (tape.n_in, tape.n_out) != (n_in, n_out):
                found = f"{tape.n_in} inputs and {tape.n_out} outputs"
                raise InputError(f"{self.name}: tape of {name}", found, f"{n_in} and {n_out}")
        names = {s.name for s in self.states}
        for place in self.equations.places:
            unknown = {place.name, place.position or place.name} - names
            if unknown:
                raise InputError(f"{self.name}: place of a force", f"{min(unknown)!r}", "a state")

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        """The joints' velocities and the currents."""
        return self.equations.places

    def with_parameters(self, **given: Any) -> SymbolicPlant:
        """The same plant with other values, or (value, relative tolerance), for the named parameters."""
        made = replace(self, parameters=overridden(self.parameters.values(), given, self.name))
        made.traced(self.provenance)
        return made

    # --- the contract of a plant -------------------------------------------------------------------------------------

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``f(x, u)``, shape (n_x,)."""
        state, force = self.point(x, u)
        return self._evaluated(self.equations.rates, state[None], force[None])[0]

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """``h(x, u)``, shape (n_y,)."""
        state, force = self.point(x, u)
        return self.outputs_along(state[None], force[None])[0]

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, Any] | None = None) -> Array:
        """Outputs (n, n_y) along a trajectory x (n, n_x), u (n, n_u), at the parameter values of `local_models`."""
        return self._evaluated(self.equations.outputs, x, u, values, first=len(self.states))

    def rates_along(self, x: Array, u: Array, values: Mapping[str, Any] | None = None) -> Array:
        """Rates (n, n_x) along a trajectory, at the parameter values of `local_models`."""
        return self._evaluated(self.equations.rates, x, u, values)

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Exact A, B, C, D at (x, u), at rest or moving."""
        state, force = self.point(x, u)
        local = self.local_models(state[None], force[None])
        return local.A[0], local.B[0], local.C[0], local.D[0]

    def local_models(self, x: Array, u: Array, values: Mapping[str, Any] | None = None) -> LocalModels:
        """The plant about the points x (n, n_x), u (n, n_u).

        Parameters
        ----------
        values
            Parameter -> value, or values (n,), one for each point; the plant's own where left out.

        Raises
        ------
        InputError
            An unknown parameter, or arrays of other shapes.
        NoTrustworthyNumber
            A point at which an equation or a slope of one has no finite value; the message names both.
        """
        n, n_x, n_u, n_y, n_p = (
            len(x),
            *map(len, (self.states, self.inputs, self.outputs, self.equations.places)),
        )
        found = self._evaluated(self.equations.models, x, u, values)
        shapes = ((n_x,), (n_y,), (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u), (n_x, n_p))
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
        parts = np.split(found, ends[:-1], axis=1)
        return LocalModels(*(part.reshape(n, *shape) for part, shape in zip(parts, shapes, strict=True)))

    def equilibrium(self, **where: Any) -> Trim:
        """State and input at which the plant stays, with the given states, inputs and outputs held by name.

        What is left open is found by Newton's method from zero, or from the state and input in ``start=(x, u)``; of
        many points at which the plant may rest, the one nearest to there (each number in its own unit). A name that a
        state or input has holds that, not an output of the same name.

        Raises
        ------
        InputError
            A name that is no state, input or output, with the closest one; no number.
        NoTrustworthyNumber
            No rest was found there; the message names the equation that is farthest from it.

        Examples
        --------
        >>> from robustlab.dynamics.symbolic.equations import PlantEquations
        >>> p = PlantEquations("pendulum")
        >>> torque, (a, w) = p.input("torque", "N m"), p.joint("a", "w", "rad")
        >>> p.motion(0.5, torque - 2.0 * p.parameter("k", 3.0) * a)
        >>> p.output("a", a, "rad")
        >>> p.plant().equilibrium(a=0.1).u.round(12)
        array([0.6])
        """
        return rest(self, where)

    def trajectory(self, signal: InputSignal, x0: Array, rtol: float) -> Array:
        """States (n, n_x) at the times of the signal, by DOP853 with the local error held at ``rtol``; compiled.

        Raises
        ------
        NoTrustworthyNumber
            An equation has no finite value on the way, or the integrator gives up; the message names the time.
        """
        code = tape_kernels()
        states = np.empty((len(signal.t), len(x0)))
        inputs = code.Inputs(np.array(signal.t), np.ascontiguousarray(signal.coefficients), np.array(signal.broken))
        values = np.array(list(self.values.values()), dtype=np.float64)
        outcome, time, _, culprit = code.integrate(
            self.equations.rates.code, np.array(x0, dtype=np.float64), values, inputs, float(rtol), states
        )
        if outcome == code.DONE:
            return states
        words, hint = "too many steps", "a force that jumps with a velocity is dry friction: add it by with_effects"
        if outcome == code.NOT_FINITE:
            words, hint = "the step became too small", None
            if culprit >= 0:
                words = f"the rate of {self.states[culprit].name} has no finite value there"
        raise NoTrustworthyNumber(self.name, f"no solution beyond t = {time:.9g} s: {words}", None, hint)

    # --- evaluation --------------------------------------------------------------------------------------------------

    def _evaluated(
        self, tape: Tape, x: Array, u: Array, values: Mapping[str, Any] | None = None, first: int = 0
    ) -> Array:
        """Outputs (n, n_out) of a tape, all of them finite; ``first``: place of its first one in `label`."""
        n, n_x, n_u = len(x), len(self.states), len(self.inputs)
        for name, array, width in (("x", x, n_x), ("u", u, n_u)):
            if np.shape(array) != (n, width):
                raise InputError(f"{self.name}: {name}", f"shape {np.shape(array)}", f"({n}, {width})")
        points = np.empty((n, tape.n_in))
        points[:, :n_x], points[:, n_x : n_x + n_u] = x, u
        parameters = _with_values(self, values, n)
        for k, value in enumerate(parameters):
            points[:, n_x + n_u + k] = value
        found = tape(points)
        if not np.isfinite(found).all():
            row, column = (int(k) for k in np.argwhere(~np.isfinite(found))[0])
            raise NoTrustworthyNumber(
                self.name,
                f"{self._label(first + column)} is {found[row, column]} at {self._named(points[row], row, n)}",
            )
        return found

    def _label(self, k: int) -> str:
        """What output k of the tape of models is."""
        return labels(self.states, self.inputs, self.outputs, self.equations.places)[k]

    def _named(self, point: Array, row: int, n: int) -> str:
        signals = (*self.states, *self.inputs)
        text = ", ".join(f"{s.name} = {v:.4g}" for s, v in zip(signals, point, strict=False))
        return f"point {row} of {n} ({text})" if n > 1 else text


def _with_values(plant: SymbolicPlant, given: Mapping[str, Any] | None, n: int) -> list[Any]:
    """Values of the parameters in their order, each a number or an array (n,), with the given ones in their places."""
    values: dict[str, Any] = dict(plant.values)
    if given:
        for name, value in given.items():
            place = f"{plant.name}: {name}"
            if name not in values:
                raise InputError(
                    place, "no such parameter", f"one of {', '.join(values)}", did_you_mean(name, tuple(values))
                )
            array = real_array(name, value, np.ndim(value), plant.name)
            if array.shape not in ((), (n,)):
                raise InputError(place, f"shape {array.shape}", f"one value, or {n}: one for each point")
            values[name] = array
    return list(values.values())
