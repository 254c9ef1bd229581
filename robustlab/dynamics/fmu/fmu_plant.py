r"""Units as plants: signals, parameters and joints from what the unit says of itself and what the user states.

A co-simulation unit steps itself, and shows outputs alone. A model-exchange unit is a nonlinear plant: its program
evaluates :math:`f(x, u)` and :math:`h(x, u)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.dynamics.fmu.description import CO_SIMULATION, MODEL_EXCHANGE
from robustlab.dynamics.fmu.unit_process import UnitProcess
from robustlab.dynamics.parameters import Parameter, overridden
from robustlab.dynamics.plant_contract import InputSignal, LocalModels, NonlinearPlant, PortPlace, SteppedPlant, Trim
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.symbolic.symbolic_plant import rest
from robustlab.dynamics.tuning import TUNING
from robustlab.errors import InputError, UnitMismatch, unknown_name
from robustlab.provenance import BY_DIFFERENCES, BY_UNIT, Provenance
from robustlab.record import Record
from robustlab.result import Status
from robustlab.shown import Facts, Shown
from robustlab.statespace import OperatingPoint, Signal, StateSpaceModel
from robustlab.units import same_unit

JOINT_KEYS = ("position", "input", "inertia", "unit")
# Unit of what acts on a velocity or a current.
ACTS = {"m/s": "N", "rad/s": "N m", "A": "V"}


@dataclass(frozen=True)
class OpenedUnit:
    """A unit's process, its description, and the interface through which it is to be run."""

    process: UnitProcess
    about: dict[str, Any]
    kind: str


def opened(path: str | Path | None, kind: str | None, time_limit: float) -> OpenedUnit:
    """The unit's process, its description, and the interface: the one asked for, or model exchange where there is one.

    Raises InputError: what is wrong with the file; an interface that it has not got.
    """
    if kind not in (None, MODEL_EXCHANGE, CO_SIMULATION):
        raise InputError(f"{path}: interface", f"{kind!r}", f"{MODEL_EXCHANGE!r} or {CO_SIMULATION!r}")
    if path is None:
        raise InputError("functional mock-up unit", "no file", "a file ending .fmu")
    process = UnitProcess(path, time_limit)
    about = process.describe()
    kinds = about["kinds"]
    chosen = kind or (MODEL_EXCHANGE if MODEL_EXCHANGE in kinds else CO_SIMULATION)
    if chosen not in kinds:
        process.close()
        hint = None if kind else 'rl.plant("FILE.fmu") takes either'
        raise InputError(str(path), f"a unit for {' and '.join(kinds)}", f"one for {chosen}", hint)
    return OpenedUnit(process, about, chosen)


def described(about: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Name, parameters and signals, as `robustlab.dynamics.plant_contract.Plant` takes them."""
    name = about["name"] or "unit"
    defaults = []
    for p in about["parameters"]:
        sign: Any = "positive" if p["low"] > 0 else "nonnegative" if p["low"] == 0 else "any"
        value = p["start"]
        if (sign == "positive" and value <= 0) or (sign == "nonnegative" and value < 0):
            raise InputError(f"{name}: {p['name']}", f"start value {value:g}", f"at least its own minimum {p['low']:g}")
        source = "the unit's description"
        defaults.append(Parameter(p["name"], value, p["unit"], 0.0, source, p["meaning"], sign))
    kinds = {kind: tuple(Signal(v["name"], v["unit"]) for v in about[kind]) for kind in ("inputs", "outputs", "states")}
    return {"name": name, "parameters": overridden(defaults, given, name), **kinds}


def joints_of(plant: Any, stated: Mapping[str, Any] | None, about: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Velocity or current state -> how a force, torque or voltage acts there; the user's word, else the unit's.

    Raises InputError: a joint that is no state, an input or parameter that there is not, a joint at which nothing says
    how a force acts.
    """
    if stated is None:
        given = {j.get("velocity", ""): {k: v for k, v in j.items() if k != "velocity"} for j in about["joints"]}
        where = f"{plant.name}: joints (as its description names them)"
    else:
        given, where = stated, f"{plant.name}: joints"
    if not isinstance(given, Mapping):
        raise InputError(where, type(given).__name__, 'a table: {"v": {"position": "x", "input": "F"}}')
    states, inputs = ({s.name: s.unit for s in kind} for kind in (plant.states, plant.inputs))
    found = {}
    for velocity, how in given.items():
        here = f"{where}: {velocity!r}"
        if velocity not in states:
            raise unknown_name(here, "no such state", str(velocity), states)
        if not isinstance(how, Mapping) or not set(how) <= set(JOINT_KEYS) or ("input" in how) == ("inertia" in how):
            expected = "input= (the force acts as this input does) or inertia= (a parameter), and position=, unit="
            raise InputError(here, f"{how!r:.200}", expected)
        for key, known in (("position", states), ("input", inputs), ("inertia", plant.parameters)):
            if key in how and how[key] not in known:
                raise InputError(here, f"{key} {how[key]!r}", f"one of {', '.join(known) or 'none'}")
        family = next((acts for unit, acts in ACTS.items() if same_unit(unit, states[velocity])), "")
        unit = how.get("unit") or inputs.get(how.get("input", ""), "") or family
        found[velocity] = {**how, "unit": unit, "kind": "current" if family == "V" else "joint"}
    return found


def unit_provenance(process: UnitProcess, by_differences: bool) -> Provenance:
    """Where a plant and its models come from: the file with its hash, and whether derivatives are differences."""
    note = BY_DIFFERENCES if by_differences else ""
    return Provenance.now(BY_UNIT, {process.shown: process.sha256}, note=note)


SHOWS_NONE = "a co-simulation unit steps itself: it shows no rates, and no state of it can be set"


@dataclass(frozen=True, eq=False, repr=False)
class FreeRun(Shown):
    """A record beside the simulation of its inputs from the unit's own initial state.

    Attributes
    ----------
    record, simulated
        Measured, and simulated.
    gaps
        Output -> "rms", "peak" in its unit, and "fit" in %, 100 where they are equal.
    status
        CONVERGED: the unit ran to the end; what its own solver is good for is not known.
    """

    record: Record
    simulated: Record
    gaps: Mapping[str, Mapping[str, float]]
    status: Status = Status.CONVERGED

    def facts(self) -> Facts:
        """One an output."""
        told = [("", f"{self.simulated.name} against {self.record.name}: free run from the unit's own initial state")]
        for name, gap in self.gaps.items():
            unit = self.simulated.unit(name)
            rms, peak = (f"{gap[key]:.4g} {unit}".rstrip() for key in ("rms", "peak"))
            told.append((name, f"rms {rms}, peak {peak}, fit {gap['fit']:.4g} %"))
        return told

    def to_json(self, *, series: bool = True) -> dict[str, Any]:
        """The gaps and the names of both; with ``series`` the simulated outputs over time."""
        gaps = {name: dict(gap) for name, gap in self.gaps.items()}
        found = {"record": self.record.name, "model": self.simulated.name, "gaps": gaps, "status": self.status}
        over_time = {"t": self.simulated.t, "simulated": dict(self.simulated.outputs)}
        return {**found, **over_time} if series else found


@dataclass(frozen=True, eq=False, repr=False, init=False)
class FmuCoSimulation(SteppedPlant):
    """A functional mock-up unit for co-simulation (FMI 2.0 or 3.0) as a plant without states of ours.

    It can be simulated (inputs are held between the samples, each a communication step, or ``step=`` shorter ones),
    compared with a record (`compare`), and sampled over its parameters. It has a linear model only where it offers
    directional derivatives and names its states: the one at its own initial state.

    Parameters
    ----------
    path
        File of the unit; a program, which is run in a child process.
    time_limit
        Seconds that the unit may take for one request.
    parameters
        As of `robustlab.dynamics.fmu.fmu_plant.FmuPlant`.

    Raises
    ------
    InputError, DependencyMissing
        As of `robustlab.dynamics.fmu.fmu_plant.FmuPlant`.
    """

    process: UnitProcess
    unused_signals: tuple[str, ...]
    about: dict[str, Any]

    def __init__(
        self, path: str | Path | OpenedUnit | None = None, *, time_limit: float = 60.0, **parameters: Any
    ) -> None:
        if path is None and "process" in parameters:  # dataclasses.replace, which hands over the fields
            fields = parameters
        else:
            unit = path if isinstance(path, OpenedUnit) else opened(path, CO_SIMULATION, time_limit)
            fields = {**described(unit.about, parameters), "states": (), "process": unit.process, "about": unit.about}
            fields["unused_signals"] = tuple(unit.about["left_out"])
        for key, value in fields.items():
            object.__setattr__(self, key, value)  # plants are frozen
        self.__post_init__()
        if path is not None:
            self.process.load(CO_SIMULATION)
        self.traced(unit_provenance(self.process, by_differences=False))

    def with_parameters(self, **given: Any) -> FmuCoSimulation:
        """The same plant with other values, or (value, relative tolerance), for the named parameters."""
        return replace(self, parameters=overridden(self.parameters.values(), given, self.name))

    def stepped(self, t: Array, u: Array, x0: Array, step: float | None = None) -> tuple[Array, Array]:
        """No states (n, 0), and outputs (n, n_y), at the times t for inputs (n, n_u) held between them."""
        steps = np.diff(t)
        even = not len(steps) or np.ptp(steps) <= TUNING.clock_jitter * steps.mean()
        if not even and not self.about["kinds"][CO_SIMULATION]["variable_step"]:
            raise InputError(f"simulate {self.name}", "steps that differ", "equal ones: the unit takes no others")
        longest = np.inf if step is None else step
        request = {"op": "step", "longest": min(longest, 1e300), "values": self.values}
        _, (y,) = self.process.ask(request, [t, u])
        return np.zeros((len(t), 0)), y

    def compare(self, record: Record) -> FreeRun:
        """The record's inputs simulated from the unit's own initial state, beside its outputs; nothing is fitted.

        Raises
        ------
        InputError
            An input that the record has not got, no output in common.
        UnitMismatch
            Different units of a signal.
        """
        where = f"compare {record.name}"
        missing = [s.name for s in self.inputs if s.name not in record.inputs]
        shared = [s for s in self.outputs if s.name in record.outputs]
        if missing:
            raise InputError(where, f"no input {missing[0]!r} in the record", "every input of the unit")
        if not shared:
            raise InputError(where, "no output in common", f"one of {', '.join(s.name for s in self.outputs)}")
        for name, unit in (*self.inputs, *shared):
            measured = record.unit(name)
            if unit and measured and not same_unit(unit, measured):
                raise UnitMismatch(f"{where}: {name}", f"recorded in {measured}", f"{unit} as in the unit")
        inputs = {s.name: record.inputs[s.name] for s in self.inputs}
        simulated = simulate(self, record.t, inputs)
        gaps = {}
        for name, _ in shared:
            error, spread = record.outputs[name] - simulated.outputs[name], float(np.std(record.outputs[name]))
            rms = float(np.sqrt(np.mean(error**2)))
            fit = 100.0 * (1.0 - rms / spread) if spread else float("nan")
            gaps[name] = {"rms": rms, "peak": float(np.abs(error).max()), "fit": fit}
        return FreeRun(record, simulated, gaps)

    def linear_model(
        self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0
    ) -> StateSpaceModel:
        """The model at the unit's initial state, by its directional derivatives.

        Raises
        ------
        InputError
            A unit without them, or another operating point.
        """
        where = f"linearise {self.name}"
        if amplitude or pade:
            raise InputError(where, "amplitude or pade for a plant without effects", "neither")
        if not self.about["kinds"][CO_SIMULATION]["directional"]:
            hint = "export the unit for model exchange, or identify a model from rl.simulate"
            raise InputError(where, f"{SHOWS_NONE}; and it offers no directional derivatives", None, hint)
        if at is not None:
            raise InputError(where, "an operating point", "none: a co-simulation unit is at its own initial state")
        u = np.array([v["start"] or 0.0 for v in self.about["inputs"]])
        _, (slopes, x, y) = self.process.ask({"op": "linear", "values": self.values}, [u])
        n = len(x)
        states = tuple(Signal(v["name"], v["unit"]) for v in self.about["states"])
        matrices = slopes[:n, :n], slopes[:n, n:], slopes[n:, :n], slopes[n:, n:]
        point = OperatingPoint(x, u, y)
        model = StateSpaceModel(*matrices, 0.0, self.inputs, self.outputs, states, point, self.name)
        model.traced(unit_provenance(self.process, by_differences=False))
        return model

    def left_out(self, at: Any = None, amplitude: Mapping[str, float] | None = None, pade: int = 0) -> tuple[Any, ...]:
        """Nothing that is known."""
        return ()

    def _refused(self) -> NoReturn:
        raise InputError(self.name, SHOWS_NONE, "a unit for model exchange")

    def derivative(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Refused."""
        self._refused()

    def output(self, x: ArrayLike, u: ArrayLike) -> Array:
        """Refused."""
        self._refused()

    def jacobians(self, x: ArrayLike, u: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Refused."""
        self._refused()

    def equilibrium(self, **where: Any) -> Trim:
        """Refused."""
        self._refused()


TIME_LIMIT = 60.0


def fmu(path: str | Path, *, interface: str | None = None, **options: Any) -> FmuPlant | FmuCoSimulation:
    """A unit as a plant: through model exchange where it has that, else through co-simulation.

    ``path``: file of the unit, ending .fmu. It is a program: it is run, in a child process, because it is named here.
    ``interface``: "model-exchange" or "co-simulation", to choose. ``options``: as `FmuPlant` takes them: parameters by
    name, ``joints``, ``derivatives``, ``time_limit``; of a co-simulation unit parameters and ``time_limit``.

    Raises InputError, DependencyMissing: as `FmuPlant`.
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
    ``axis = rl.plant("axis.fmu", mass=(1.2, 0.1))``, then as any plant: ``rl.linearise(axis)``.
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
        """The rest nearest to the unit's initial state, see `robustlab.dynamics.symbolic.symbolic_plant`.

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
