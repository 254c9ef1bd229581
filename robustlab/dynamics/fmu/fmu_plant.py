r"""A model-exchange unit as a nonlinear plant: its program evaluates :math:`f(x, u)` and :math:`h(x, u)`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.fmu.description import CO_SIMULATION, MODEL_EXCHANGE
from robustlab.dynamics.fmu.fmu_co_simulation import FmuCoSimulation
from robustlab.dynamics.fmu.unit_process import UnitProcess
from robustlab.dynamics.fmu.unit_signals import OpenedUnit, described, joints_of, opened, unit_provenance
from robustlab.dynamics.parameters import overridden
from robustlab.dynamics.plant_contract import InputSignal, LocalModels, NonlinearPlant, PortPlace, Trim
from robustlab.dynamics.symbolic.rest import rest
from robustlab.errors import InputError

__all__ = ["TIME_LIMIT", "FmuPlant", "fmu"]

TIME_LIMIT = 60.0


def fmu(path: str | Path, *, interface: str | None = None, **options: Any) -> FmuPlant | FmuCoSimulation:
    """A unit as a plant: through model exchange where it has that, else through co-simulation.

    Parameters
    ----------
    path
        File of the unit, ending .fmu. It is a program: it is run, in a child process, because it is named here.
    interface
        "model-exchange" or "co-simulation", to choose.
    options
        As `FmuPlant` takes them: parameters by name, ``joints``, ``derivatives``, ``time_limit``; of a co-simulation
        unit parameters and ``time_limit``.

    Raises
    ------
    InputError, DependencyMissing
        As `FmuPlant`.
    """
    unit = opened(path, interface, options.get("time_limit", TIME_LIMIT))
    made = FmuCoSimulation if unit.kind == CO_SIMULATION else FmuPlant
    return made(unit, **options)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class FmuPlant(NonlinearPlant):
    r"""A functional mock-up unit for model exchange (FMI 2.0 or 3.0) as a nonlinear plant.

    .. math:: \dot x = f(x, u; p), \qquad y = h(x, u; p)

    The unit is a program. It runs in a child process that ends with this one; a crash, a hang or an error of it is an
    error of one line here, and what it prints reaches nobody. It is not kept from what a program of the user's may do.

    Parameters
    ----------
    path
        File of the unit.
    joints
        Where forces can act: velocity state -> ``{"position": state, "input": name}`` where a force there acts as that
        input does, or ``{"position": state, "inertia": name}`` where it acts through that parameter alone; ``unit`` of
        the force where the states' units do not tell it. Left out: what the description says in an annotation of the
        tool "robustlab", or no joints.
    derivatives
        "directional": the unit's own, checked against differences of its values at the first point of each request;
        "differences": Richardson's central differences, so labelled. Left out: its own where it has them.
    time_limit
        Seconds that the unit may take for one request (a simulation, a set of points).
    **parameters
        Name -> value or (value, relative tolerance), of the fixed and tunable real parameters of the description.

    Attributes
    ----------
    parameters, inputs, outputs, states
        As the description names them; its states stand for outputs where it names none.
    derivatives
        "directional" or "differences".
    unused_signals
        Inputs and outputs that are no real numbers: inputs stay at their start values, outputs are not shown.

    Raises
    ------
    InputError
        A damaged file, another version of FMI, array signals, clocks, no model exchange, unknown parameters.
    DependencyMissing
        FMPy is not installed (``pip install 'robustlab[fmi]'``).

    Examples
    --------
    ``axis = rl.FmuPlant("axis.fmu", mass=(1.2, 0.1))``, then as any plant: ``rl.linearise(axis)``.
    """

    process: UnitProcess
    derivatives: str
    unused_signals: tuple[str, ...]
    joints: dict[str, dict[str, str]]
    joints_source: str

    def __init__(
        self,
        path: str | Path | OpenedUnit | None = None,
        *,
        joints: Mapping[str, Mapping[str, str]] | None = None,
        derivatives: str | None = None,
        time_limit: float = TIME_LIMIT,
        **parameters: Any,
    ) -> None:
        put = object.__setattr__  # plants are frozen
        if path is None and "process" in parameters:  # dataclasses.replace, which hands over the fields
            for key, value in {"joints": joints, "derivatives": derivatives, **parameters}.items():
                put(self, key, value)
            self.__post_init__()
            self.traced(unit_provenance(self.process, self.derivatives == "differences"))
            return
        unit = path if isinstance(path, OpenedUnit) else opened(path, MODEL_EXCHANGE, time_limit)
        process, about = unit.process, unit.about
        own = about["kinds"][MODEL_EXCHANGE]["directional"]
        if derivatives not in (None, "differences") and not (derivatives == "directional" and own):
            expected = "'directional' or 'differences'" if own else "'differences': the unit has no directional ones"
            raise InputError(f"{process.shown}: derivatives", f"{derivatives!r}", expected)
        for key, value in described(about, parameters).items():
            put(self, key, value)
        put(self, "derivatives", derivatives or ("directional" if own else "differences"))
        put(self, "unused_signals", tuple(about["left_out"]))
        put(self, "process", process)
        self.__post_init__()
        put(self, "joints", joints_of(self, joints, about))
        put(self, "joints_source", "" if not self.joints else "stated by the user" if joints else "its description")
        process.load(MODEL_EXCHANGE)
        self.traced(unit_provenance(process, self.derivatives == "differences"))

    def with_parameters(self, **given: Any) -> FmuPlant:
        """The same plant with other values, or (value, relative tolerance), for the named parameters."""
        return replace(self, parameters=overridden(self.parameters.values(), given, self.name))

    # --- points ------------------------------------------------------------------------------------------------------

    @cached_property
    def _start(self) -> tuple[Array, Array]:
        _, (x, u) = self.process.ask({"op": "start", "values": self.values})
        return x, u

    @property
    def start(self) -> Array:
        """The unit's own initial state with these parameters, (n_x,)."""
        return self._start[0].copy()

    def _evaluated(
        self, x: Array, u: Array, derivatives: str = "", values: Mapping[str, float] | None = None
    ) -> tuple[float, list[Array]]:
        request = {
            "op": "evaluate",
            "derivatives": derivatives,
            "values": dict(self.values if values is None else values),
        }
        header, arrays = self.process.ask(request, [x, u])
        return header.get("truncation", 0.0), arrays

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """As the contract says, at t = 0."""
        point = self.point(x, u)
        return self._evaluated(point[0][None], point[1][None])[1][0][0]

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """As the contract says, at t = 0."""
        point = self.point(x, u)
        return self._evaluated(point[0][None], point[1][None])[1][1][0]

    def outputs_along(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> Array:
        """As the contract says, through one message."""
        return self._evaluated(x, u, "", values)[1][1]

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D at (x, u): the unit's directional derivatives, or differences (``derivatives`` says which)."""
        point = self.point(x, u)
        return self._split(self._evaluated(point[0][None], point[1][None], self.derivatives)[1][2][0])

    def difference_error(self, x: ArrayLike, u: ArrayLike) -> float:
        """How far plain differences are from those that `jacobians` gives, relative to their column: the truncation
        that Richardson's step has removed, hence more than the error where the equations are smooth. 0 where the unit's
        own derivatives are taken.
        """
        point = self.point(x, u)
        return self._evaluated(point[0][None], point[1][None], self.derivatives)[0]

    def _split(self, slopes: Array) -> tuple[Array, Array, Array, Array]:
        n = len(self.states)
        return slopes[..., :n, :n], slopes[..., :n, n:], slopes[..., n:, :n], slopes[..., n:, n:]

    # --- along a motion ----------------------------------------------------------------------------------------------

    @property
    def port_places(self) -> tuple[PortPlace, ...]:
        """The joints; ``joints_source`` tells who named them."""
        return tuple(
            PortPlace(velocity, how["kind"], how["unit"], how.get("position", ""))  # type: ignore[arg-type]
            for velocity, how in self.joints.items()
        )

    def local_models(self, x: Array, u: Array, values: Mapping[str, float] | None = None) -> LocalModels:
        """As the contract says, through one message; the Jacobians as in `jacobians`."""
        values = dict(self.values if values is None else values)
        _, (rates, outputs, slopes) = self._evaluated(x, u, self.derivatives, values)
        A, B, C, D = self._split(slopes)
        push = np.zeros((len(x), len(self.states), len(self.joints)))
        names = [s.name for s in self.states]
        for j, (velocity, how) in enumerate(self.joints.items()):
            if "input" in how:
                push[:, :, j] = B[:, :, [s.name for s in self.inputs].index(how["input"])]
            else:
                push[:, names.index(velocity), j] = 1.0 / values[how["inertia"]]
        return LocalModels(rates, outputs, A, B, C, D, push)

    # --- motions -----------------------------------------------------------------------------------------------------

    def response(self, signal: InputSignal, x0: Array, **options: float) -> tuple[Array, Array]:
        """States (n, n_x) and outputs (n, n_y) at the times of the signal, by DOP853 with events, in the child.

        Raises
        ------
        InputError
            Fixed steps.
        NoTrustworthyNumber
            Rates or outputs that are not finite, a unit that ended the simulation, events without end; with the time.
        """
        if "step" in options:
            raise InputError(f"simulate {self.name}", "step", "rtol: its steps are chosen so that the error is held")
        request = {"op": "integrate", **options, "values": self.values}
        arrays = [signal.t, signal.coefficients, signal.broken.astype(float), x0]
        _, (states, outputs) = self.process.ask(request, arrays)
        return states, outputs

    def trajectory(self, signal: InputSignal, x0: Array, rtol: float) -> Array:
        """States of `response`."""
        return self.response(signal, x0, rtol=rtol)[0]

    def equilibrium(self, **where: Any) -> Trim:
        """The rest nearest to the unit's initial state, see `robustlab.dynamics.symbolic.rest`.

        Parameters
        ----------
        where
            Name of an input, state or output -> its value. Inputs that are not named keep their start values; where a
            state or an output is named, they are found. ``start=(x, u)``: where the search begins.

        Raises
        ------
        InputError
            An unknown name.
        NoTrustworthyNumber
            No rest was found.
        """
        x, u = self._start
        inputs = {s.name: float(value) for s, value in zip(self.inputs, u, strict=True)}
        free = any(name not in inputs and name != "start" for name in where)
        return rest(self, {"start": (x, u), **({} if free else inputs), **where})
