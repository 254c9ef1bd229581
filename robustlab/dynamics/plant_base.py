"""Base classes of plants x' = f(x, u), y = h(x, u): named parameters and signals, sampled inputs."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.display import AllFields, Displayable, Facts, listed, number, with_units
from robustlab.dynamics.equilibrium import held_descriptor
from robustlab.dynamics.parameters import Parameter, overridden, parameter_ranges
from robustlab.dynamics.parametric_descriptor import TrimmedDescriptor, uncertain_family
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.provenance import Traced
from robustlab.result import Status
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel, real_array, signals
from robustlab.uncertainty.lft import UncertainModel

# Slopes of a sampled input that differ by less than this share of the largest count as one straight line. Larger: fewer
# restarts of the integrator, but reduced order where the input bends.
STRAIGHT = 1e-9

NonlinearHold = Literal["zoh", "foh", "spline"]


@dataclass(frozen=True, eq=False)
class InputSignal:
    """Inputs that are a polynomial of degree 5 between two times."""

    t: Array  # times in s, shape (n,)
    # ``u(t) = sum_j coefficients[k, j] (t - t[k])^j`` for t[k] <= t <= t[k + 1]; shape (n - 1, 6, n_u)
    coefficients: Array
    # true where interval k does not continue the previous one smoothly and an integrator must restart; (n - 1,)
    broken: NDArray[np.bool_]

    @property
    def samples(self) -> Array:
        return np.vstack([self.coefficients[:, 0], self.at(self.t[-1], len(self.t) - 2)[None]])

    def at(self, time: float, interval: int) -> Array:
        """Evaluate the input (n_u,) at a time, by the polynomial of the given interval."""
        return np.polynomial.polynomial.polyval(time - self.t[interval], self.coefficients[interval])


def input_signal(t: Array, samples: Array, hold: NonlinearHold) -> InputSignal:
    """Interpolate the samples (n, n_u)."""
    coefficients = np.zeros((len(t) - 1, 6, samples.shape[1]))
    broken = np.zeros(len(t) - 1, dtype=np.bool_)
    if hold == "zoh":
        coefficients[:, 0] = samples[:-1]
        broken[1:] = (samples[1:-1] != samples[:-2]).any(axis=1)
    elif hold == "foh":
        slope = np.diff(samples, axis=0) / np.diff(t)[:, None]
        coefficients[:, 0], coefficients[:, 1] = samples[:-1], slope
        broken[1:] = (np.abs(np.diff(slope, axis=0)) > STRAIGHT * np.abs(slope).max(initial=0.0)).any(axis=1)
    elif hold == "spline":
        if len(t) < 6:
            raise InputError("simulate: hold", f"'spline' through {len(t)} samples", "at least 6")
        from scipy.interpolate import make_interp_spline

        spline = make_interp_spline(t, samples, k=5)
        for j in range(6):
            coefficients[:, j] = spline(t[:-1], nu=j) / math.factorial(j)
    else:
        raise InputError("simulate: hold", f"{hold!r}", "'zoh', 'foh' or 'spline'")
    return InputSignal(t, coefficients, broken)


@dataclass(frozen=True, eq=False, repr=False)
class Plant(Displayable, Traced, ABC):
    """Base class of `robustlab.dynamics.linear_plant.LinearPlant` and `NonlinearPlant`."""

    name: str  # in the registry, for example ``"dc-motor"``
    parameters: Mapping[str, Parameter]  # name -> parameter
    # in the order of u, y and x
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[Signal, ...]

    def __post_init__(self) -> None:
        for key, parameter in self.parameters.items():
            if key != parameter.name:
                raise InputError(f"{self.name}: parameters", f"{key!r} holds {parameter.name!r}", "one name")
        object.__setattr__(self, "parameters", dict(self.parameters))
        for kind in ("inputs", "outputs", "states"):
            given = getattr(self, kind)
            object.__setattr__(self, kind, signals(given, len(given), kind, f"{self.name}: {kind}"))

    @abstractmethod
    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Return ``f(x, u)``: rates of the states, shape (n_x,), for x of shape (n_x,) and u of shape (n_u,)."""

    @abstractmethod
    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Return ``h(x, u)``: outputs, shape (n_y,)."""

    def with_parameters(self, **given: Any) -> Any:
        """Return the plant with other values, or (value, relative tolerance), of the named parameters."""
        made = replace(self, parameters=overridden(self.parameters.values(), given, self.name))
        made.traced(self.provenance)
        return made

    @property
    def values(self) -> dict[str, float]:
        return {name: p.value for name, p in self.parameters.items()}

    def point(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
        """Return x and u as finite vectors, checked against the plant's sizes."""
        vectors = real_array("x", x, 1, self.name), real_array("u", u, 1, self.name)
        for vector, kind in zip(vectors, (self.states, self.inputs), strict=True):
            if len(vector) != len(kind):
                names = ", ".join(s.name for s in kind)
                raise InputError(self.name, f"{len(vector)} numbers for {names}", f"{len(kind)}")
        return vectors

    def facts(self) -> Facts:
        return [
            ("plant", self.name),
            ("parameters", listed(f"{p.name} = {number(p.value, p.unit)}" for p in self.parameters.values())),
            ("inputs", with_units(self.inputs)),
            ("outputs", with_units(self.outputs)),
            ("states", with_units(self.states)),
        ]

    def __repr__(self) -> str:
        values = listed((f"{p.name}={p.value:g}" for p in self.parameters.values()), 12)
        return f"{type(self).__name__}({self.name!r}: {values})"


@dataclass(frozen=True, eq=False)
class Trim(Displayable, AllFields):
    """An equilibrium of a plant: ``f(x, u) = 0``."""

    plant: str  # name of the plant
    # states, inputs and outputs in the plant's order and units
    x: Array
    u: Array
    y: Array
    residual: float  # largest ``|f(x, u)|`` there
    pose: Array | None = None  # (tx, ty, tz, ax, ay, az) of a platform; None for other plants
    status: Status = Status.CONVERGED  # CONVERGED: the residual is at rounding; INACCURATE: it is not

    def __post_init__(self) -> None:
        for array in (self.x, self.u, self.y, self.pose):
            if array is not None:
                array.setflags(write=False)

    @property
    def operating_point(self) -> OperatingPoint:
        return OperatingPoint(self.x, self.u, self.y)

    def facts(self) -> Facts:
        point = [(which, listed(number(float(v)) for v in getattr(self, which))) for which in ("x", "u", "y")]
        return [("plant", self.plant), *point, ("residual", number(self.residual))]


@dataclass(frozen=True)
class PortPlace:
    """A state of a nonlinear plant at which a force, torque or voltage can act."""

    name: str  # the velocity state (kind ``"joint"``) or current state (kind ``"current"``)
    kind: Literal["joint", "current"]  # as of `robustlab.dynamics.ports.port_model.Port`
    unit: str  # of the force, torque or voltage
    position: str = ""  # the state that integrates the velocity; empty without one


@dataclass(frozen=True, eq=False)
class LocalModels:
    """Linear models of a nonlinear plant about n points (x_k, u_k), which need not be equilibria."""

    # rates, outputs: f_k and y_k, shapes (n, n_x) and (n, n_y)
    rates: Array
    outputs: Array
    # A, B, C, D: exact Jacobians, (n, n_x, n_x), (n, n_x, n_u), (n, n_y, n_x), (n, n_y, n_u)
    A: Array
    B: Array
    C: Array
    D: Array
    # b_kj: rates of the states per unit force at each of the plant's `port_places`, (n, n_x, n_ports)
    push: Array


class NonlinearPlant(Plant):
    """Base class of plants whose equations are not linear in state and input."""

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        return ()

    def local_models(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> LocalModels:
        """Linearise about the points x (n, n_x), u (n, n_u), at the values of all parameters (default: nominal)."""
        raise InputError(self.name, "a plant without models along a motion", "one that has them", None)

    def rates_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        """Return only the rates of `local_models`, (n, n_x); override where these alone are cheaper."""
        return self.local_models(x, u, values).rates

    def check_reach(self, t: Array, x: Array) -> None:
        """Raise an error if the machine cannot reach one of the states x (n, n_x) at the times t."""

    @abstractmethod
    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Return exact A, B, C, D = df/dx, df/du, dh/dx, dh/du at (x, u)."""

    def jacobians_at(self, trim: Trim) -> tuple[Array, Array, Array, Array]:
        """Return `jacobians` at a trim, which may include a pose."""
        return self.jacobians(trim.x, trim.u)

    @abstractmethod
    def equilibrium(self, **where: Any) -> Trim:
        """Return an equilibrium; the conditions depend on the plant."""

    @property
    def start(self) -> Array:
        return np.zeros(len(self.states))

    def trimmed_descriptor(
        self, trim: Trim, hold: Sequence[str] | None, tried: Mapping[str, Mapping[str, float]]
    ) -> TrimmedDescriptor:
        """Return the descriptor form at the equilibrium as a function of the parameters."""
        return held_descriptor(self, trim.x, trim.u, hold, tried)

    def uncertain(
        self,
        outputs: Sequence[str] | None = None,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        at: Any = None,
        hold: Sequence[str] | None = None,
    ) -> UncertainModel:
        """Return the set of the linear models at a trim, for all parameters within their tolerances."""
        allowed = parameter_ranges(self.parameters, ranges or {}, self.name)
        point = point_of(self, at, "uncertain: at")
        if not isinstance(point, Trim):
            raise InputError("uncertain: at", "a state and an input", "a trim, a pose or None")
        model = StateSpaceModel(
            *self.jacobians_at(point),
            0.0, self.inputs, self.outputs, self.states, point.operating_point, self.name,
        )  # fmt: skip
        ends = [(name, end) for name, r in allowed.items() for end in (r.low, r.high)]
        tried = {f"{name} = {end:.6g}": {**self.values, name: end} for name, end in ends}
        trimmed = self.trimmed_descriptor(point, hold, tried)
        return uncertain_family(self.name, model, trimmed, self.values, allowed, outputs)

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        """Return outputs (n, n_y) along a trajectory x (n, n_x), u (n, n_u)."""
        if values is not None:
            return self.local_models(x, u, values).outputs
        return np.array([self.output(state, force) for state, force in zip(x, u, strict=True)])

    def trajectory(self, signal: InputSignal, x0: Array, rtol: float) -> Array:
        """Integrate by DOP853 with local error ``rtol``; return states (n, n_x) at the times of the signal."""
        from scipy.integrate import solve_ivp

        states = np.empty((len(signal.t), len(x0)))
        states[0] = x0
        starts = [0, *(int(k) for k in np.flatnonzero(signal.broken))]
        for first, last in zip(starts, [*starts[1:], len(signal.t) - 1], strict=True):
            t = signal.t[first : last + 1]

            def rates(time: float, x: Array, t: Array = t, first: int = first, last: int = last) -> Array:
                k = min(max(int(np.searchsorted(t, time, side="right")) - 1 + first, first), last - 1)
                return self.derivative(x, signal.at(time, k))

            # From an equilibrium the solver's own first step would leave the domain of a mechanism.
            step: Any = (t[1] - t[0]) * 1e-2
            found = solve_ivp(
                rates, (t[0], t[-1]), states[first], "DOP853", t_eval=t, rtol=max(rtol, 3e-14), atol=rtol * 1e-2,
                first_step=step,
            )  # fmt: skip
            if not found.success:
                raise NoTrustworthyNumber(self.name, f"no solution beyond t = {found.t[-1]:.9g} s", None, found.message)
            states[first : last + 1] = found.y.T
        return states


def point_of(plant: NonlinearPlant, at: Any, where: str) -> Trim | tuple[Array, Array]:
    """Return the trim, or the state and input, given by a trim, (x, u), a pose, trim conditions, or None."""
    if isinstance(at, Trim):
        if at.plant != plant.name or (len(at.x), len(at.u)) != (len(plant.states), len(plant.inputs)):
            raise InputError(where, f"a trim of {at.plant} with {len(at.x)} states", f"one of {plant.name}")
        return at
    if at is None or isinstance(at, dict):
        return plant.equilibrium(**(at or {}))
    if isinstance(at, OperatingPoint):
        return plant.point(at.x, at.u)
    if isinstance(at, (tuple, list)) and len(at) == 2:
        return plant.point(*at)
    if not isinstance(at, str) and np.ndim(at) == 1:
        return plant.equilibrium(pose=at)
    raise InputError(where, type(at).__name__, "a trim or (x, u), a pose, or None")


class PlantAlong(NonlinearPlant):
    """A nonlinear plant whose equations are evaluated at many points at once."""

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        state, force = self.point(x, u)
        return self.rates_along(state[None], force[None])[0]

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        state, force = self.point(x, u)
        return self.outputs_along(state[None], force[None])[0]

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        state, force = self.point(x, u)
        local = self.local_models(state[None], force[None])
        return local.A[0], local.B[0], local.C[0], local.D[0]


class SteppedPlant(NonlinearPlant):
    """A nonlinear plant with dry friction, delays or a solver of its own, simulated in steps."""

    @abstractmethod
    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        """Return states (n, n_x) and outputs (n, n_y) for inputs (n, n_u) held between the times t in s."""

    def whole_state(self, x: Array) -> Array:
        """Append zeros for the states that effects have added, where they are missing."""
        return x

    @abstractmethod
    def linear_model(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> StateSpaceModel:
        """Return the linear model at an operating point; sectors at the given amplitudes, delays of the Padé order."""

    def left_out(self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0) -> tuple[Any, ...]:
        """Return the effects that `linear_model` omits."""
        return ()
