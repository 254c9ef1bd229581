r"""A model-exchange unit as a nonlinear plant: :math:`\dot x = f(x, u)`, :math:`y = h(x, u)` evaluated by its program."""

from __future__ import annotations

import copy
from collections.abc import Mapping
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
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean
from robustlab.statespace import real_array

__all__ = ["TIME_LIMIT", "FmuPlant", "fmu"]

TIME_LIMIT = 60.0
REST_PASSES, HALVINGS = 60, 20
# A rate is zero where it is at most this share of the terms that make it up.
STILL, STILL_BY_DIFFERENCES = 1e-11, 1e-8


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
    parameters
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

    def __init__(
        self,
        path: str | Path | OpenedUnit,
        *,
        joints: Mapping[str, Mapping[str, str]] | None = None,
        derivatives: str | None = None,
        time_limit: float = TIME_LIMIT,
        **parameters: Any,
    ) -> None:
        unit = path if isinstance(path, OpenedUnit) else opened(path, MODEL_EXCHANGE, time_limit)
        process, about = unit.process, unit.about
        own = about["kinds"][MODEL_EXCHANGE]["directional"]
        if derivatives not in (None, "differences") and not (derivatives == "directional" and own):
            expected = "'directional' or 'differences'" if own else "'differences': the unit has no directional ones"
            raise InputError(f"{process.shown}: derivatives", f"{derivatives!r}", expected)
        put = object.__setattr__  # plants are frozen
        for key, value in described(about, parameters).items():
            put(self, key, value)
        put(self, "derivatives", derivatives or ("directional" if own else "differences"))
        put(self, "unused_signals", tuple(about["left_out"]))
        put(self, "process", process)
        put(self, "_nominal", np.array([v["nominal"] for v in about["states"]]))
        self.__post_init__()
        put(self, "joints", joints_of(self, joints, about))
        put(self, "joints_source", "" if not self.joints else "stated by the user" if joints else "its description")
        process.load(MODEL_EXCHANGE)
        self.traced(unit_provenance(process, self.derivatives == "differences"))

    process: UnitProcess
    derivatives: str
    unused_signals: tuple[str, ...]
    joints: dict[str, dict[str, str]]
    joints_source: str
    _nominal: Array

    def with_parameters(self, **given: Any) -> FmuPlant:
        """The same plant with other values, or (value, relative tolerance), for the named parameters."""
        other = copy.copy(self)
        vars(other).pop("_start", None)
        object.__setattr__(other, "parameters", overridden(self.parameters.values(), given, self.name))
        return other

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
        request = {"op": "evaluate", "derivatives": derivatives, "values": dict(self.values if values is None else values)}
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

    def outputs_along(self, x: Array, u: Array) -> Array:
        """Outputs (n, n_y) along a trajectory x (n, n_x), u (n, n_u)."""
        return self._evaluated(x, u)[1][1]

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

    def response(self, signal: InputSignal, x0: Array, rtol: float) -> tuple[Array, Array]:
        """States (n, n_x) and outputs (n, n_y) at the times of the signal, by DOP853 with events, in the child.

        Raises
        ------
        NoTrustworthyNumber
            Rates or outputs that are not finite, a unit that ended the simulation, events without end; with the time.
        """
        request = {"op": "integrate", "rtol": rtol, "values": self.values}
        arrays = [signal.t, signal.coefficients, signal.broken.astype(float), x0]
        _, (states, outputs) = self.process.ask(request, arrays)
        return states, outputs

    def trajectory(self, signal: InputSignal, x0: Array, rtol: float) -> Array:
        """States of `response`."""
        return self.response(signal, x0, rtol)[0]

    def equilibrium(self, **where: Any) -> Trim:
        """State and input with f(x, u) = 0, by Newton steps from the unit's initial state.

        Parameters
        ----------
        where
            Name of an input, state or output -> its value; a name that is both output and state means the state.
            Inputs that are not named keep their start values; where a state or an output is named, they are found.

        Raises
        ------
        InputError
            An unknown name.
        NoTrustworthyNumber
            No rest was found there.
        """
        n = len(self.states)
        s, free, wanted = self._asked(where)
        rows, target = list(wanted), np.array(list(wanted.values()))
        scale = np.concatenate([self._nominal, np.ones(len(self.inputs))])
        still = STILL if self.derivatives == "directional" else STILL_BY_DIFFERENCES

        def off(rates: Array, y: Array) -> Array:
            return np.concatenate([rates, y[rows] - target])

        residual = np.zeros(0)
        for _ in range(REST_PASSES):
            _, (rates, y, slopes) = self._evaluated(s[None, :n], s[None, n:], self.derivatives)
            matrix = np.vstack([slopes[0, :n], slopes[0, n:][rows]])
            residual = off(rates[0], y[0])
            terms = np.abs(matrix) @ np.maximum(np.abs(s), 1e-3 * scale)
            if (np.abs(residual) <= still * terms).all():
                return Trim(self.name, s[:n], s[n:], y[0], float(np.abs(rates).max(initial=0.0)))
            size = np.where(terms > 0, terms, 1.0)
            step = np.zeros(len(s))
            moved = matrix[:, free] * scale[free] / size[:, None]
            step[free] = scale[free] * np.linalg.lstsq(moved, -residual / size, rcond=1e-12)[0]
            # As far as the residual falls: a whole step may lead out of where the equations hold.
            trials = s + step * 0.5 ** np.arange(HALVINGS)[:, None]
            s = self._best(trials, s, off, residual / size, size)
        given = ", ".join(f"{name} = {value:g}" for name, value in where.items()) or "the inputs at their start values"
        k = int(np.argmax(np.abs(residual)))
        what = self.states[k].name if k < n else self.outputs[rows[k - n]].name
        found = f"no rest with {given}: {what} is off by {residual[k]:.3g}"
        raise NoTrustworthyNumber(f"{self.name}: trim", found, None, "name inputs, states or outputs: trim(plant, u=0.1)")

    def _best(self, trials: Array, s: Array, off: Any, residual: Array, size: Array) -> Array:
        """The first of the trials at which the residual is smaller; the last where none is."""
        n = len(self.states)
        for trial in trials:
            try:
                _, (rates, y, _) = self._evaluated(trial[None, :n], trial[None, n:])
            except NoTrustworthyNumber:
                continue  # out of where the unit has values
            if np.linalg.norm(off(rates[0], y[0]) / size) < np.linalg.norm(residual):
                return trial
        return s

    def _asked(self, where: Mapping[str, Any]) -> tuple[Array, Array, dict[int, float]]:
        """Start with what is given in place, the indices of what is free, and outputs that are wanted."""
        n = len(self.states)
        states, inputs, outputs = ([v.name for v in kind] for kind in (self.states, self.inputs, self.outputs))
        s, fixed = np.concatenate(self._start), np.zeros(n + len(inputs), dtype=np.bool_)
        wanted: dict[int, float] = {}
        moved = any(name not in inputs for name in where)
        fixed[n:] = not moved
        for name, value in where.items():
            number = float(real_array(name, value, 0, f"{self.name}: trim"))
            if name in states or name in inputs:
                k = states.index(name) if name in states else n + inputs.index(name)
                s[k], fixed[k] = number, True
            elif name in outputs:
                wanted[outputs.index(name)] = number
            else:
                known = (*inputs, *outputs, *(x for x in states if x not in outputs))
                hint = did_you_mean(name, known)
                raise InputError(f"{self.name}: trim", f"{name!r}", f"one of {', '.join(known)}", hint)
        return s, np.flatnonzero(~fixed), wanted
