"""Steps on tracking problems: pose them, close them with a known law, judge and simulate several controllers alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

import robustlab as rl
from robustlab.doors.vocabulary import (
    GUARD,
    ComplementaryWeight,
    ControlWeight,
    Effort,
    ErrorWeight,
    Names,
    PerformanceWeight,
    Positive,
    RefersTo,
    TimeLimit,
    ToController,
    ToPlant,
    ToPlantOrFile,
    ToUncertainOrProblem,
)
from robustlab.errors import InputError, unknown_name
from robustlab.recipe.steps.contract import (
    Ahead,
    Fact,
    Foretold,
    Outcome,
    Step,
    Workspace,
    least_trusted,
    quantity,
    step,
)

if TYPE_CHECKING:
    from robustlab.dynamics.control.trajectory_following import TrajectoryFollowing

Sizes = Positive | dict[str, Positive]

Controllers = Annotated[list[ToController], Field(min_length=1, max_length=12)]

Outputs = Annotated[list[str], Field(min_length=1, max_length=100), Names("outputs")]


@dataclass(frozen=True, eq=False)
class Runs:
    """Simulated runs: time in s, controller -> error over it, its unit, and the time in s from which errors count."""

    t: Any
    errors: Mapping[str, Any]
    unit: str
    after: float


@step
class TrackingProblemStep(Step):
    """What a loop is asked for: references that outputs follow, disturbances, noise, and weights on error and control.

    The controller sees the references of `controlled` and the outputs `measured`. The gain of the weighted loop is at
    most 1 where every requirement holds.
    """

    gives: ClassVar[str] = "problem"
    leaves: ClassVar[Any] = {"states": "1", "blocks": [str], "channels": "1", "measurements": "1", "controls": "1"}
    do: Literal["tracking-problem"]
    of: Annotated[str, RefersTo(("plant", "model", "uncertain", "any"))]
    controlled: Outputs = Field(description='Names of outputs; "phi_*" stands for all that begin so.')
    measured: Outputs = Field(description="The same.")
    W1: Positive | ErrorWeight | PerformanceWeight | None = Field(
        None, description="On the error, as a share of the reference."
    )
    W2: Positive | ControlWeight | None = Field(None, description="On the control, in its own unit.")
    W3: Positive | ComplementaryWeight | None = Field(None, description="On the output, as a share of the reference.")
    reference: Sizes = Field(1.0, description="Size of the references in the outputs' units.")
    reference_bandwidth: Positive | None = Field(None, description="rad/s, above which references get smaller.")
    disturbance: Sizes | None = Field(None, description="Size of what is added to the controls, in their units.")
    loads: Annotated[dict[str, Positive], Names("inputs")] = Field(
        {}, description='Inputs of the model that are no controls, with their sizes: { "load *" = 1.0 }.'
    )
    noise: Sizes | None = Field(
        None, description='Size of the noise on what is seen, in its units: { "*_ref" = 0.1, "phi_*" = 0.1 }.'
    )

    @model_validator(mode="after")
    def _some_weight(self) -> Self:
        if self.W1 is None and self.W2 is None and self.W3 is None:
            raise PydanticCustomError("some_weight", "expected at least one of W1, W2, W3")
        return self

    def run(self, work: Workspace) -> Outcome:
        from robustlab.synthesis.specifications.tracking_problem import tracking_problem as pose
        from robustlab.synthesis.specifications.weight_design import error_weight

        given = work.values[self.of]
        G = given.uncertain() if hasattr(given, "uncertain") and hasattr(given, "with_parameters") else given
        first = error_weight if isinstance(self.W1, ErrorWeight) else rl.performance_weight
        makers = {"W1": first, "W2": rl.control_weight, "W3": rl.complementary_weight}
        weights = {name: _weight(getattr(self, name), make) for name, make in makers.items()}
        inputs, outputs = _signals(G)
        controlled, measured = _matching(self.controlled, outputs), _matching(self.measured, outputs)
        loads = {k: v for k, v in _sizes_of(self.loads, inputs).items() if "*" not in k}
        controls = [name for name in inputs if name not in loads]
        problem = pose(
            G,
            controlled,
            measured,
            **weights,
            reference=_sizes_of(self.reference, controlled),
            reference_bandwidth=self.reference_bandwidth,
            disturbance=_sizes_of(self.disturbance, controls),
            loads=loads,
            noise=_sizes_of(self.noise, [*(f"{name}_ref" for name in controlled), *measured]),
        )
        blocks = problem.uncertain.blocks
        numbers = {
            "states": problem.uncertain.M.n_states,
            "blocks": [b.name for b in blocks],
            "channels": problem.uncertain.delta_shape[0],
            "measurements": problem.n_meas,
            "controls": problem.n_con,
        }
        seen = [s.name for s in problem.plant.measurements]
        facts = (
            Fact("The controller sees", ", ".join(seen)),
            Fact("It drives", ", ".join(f"{s.name} [{s.unit}]" for s in problem.plant.controls)),
            Fact("Size of the references", _sizes(problem.reference, problem.controlled)),
            Fact("of the disturbances", _sizes(problem.disturbance, problem.plant.controls)),
            *(
                [Fact("of the loads", ", ".join(f"{n} {s:g}" for n, s in problem.loads.items()))]
                if problem.loads
                else []
            ),
            Fact("of the noise", _sizes(problem.noise, problem.plant.measurements)),
            Fact("Uncertain", f"{len(blocks)} blocks, {problem.uncertain.delta_shape[0]} channels"),
            Fact("States, weights included", str(problem.uncertain.M.n_states)),
        )
        return Outcome(problem, f"Tracking problem of {self.of}: a gain of at most 1 is asked for.", numbers, facts)


@step
class CascadeStep(Step):
    """The two layers of L. Březina's thesis (eqs 9.1-9.4) for the linear actuator or the Stewart platform with motors.

    Of the platform it is the upper layer, which asks for torques; its torque loops stay where they are.
    """

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = {"order": "1", "p_up": "1/s", "p_low": "1/s"}
    do: Literal["cascade"]
    of: ToPlant
    p_up: Positive = 236.0
    p_low: Positive = 3000.0

    def run(self, work: Workspace) -> Outcome:
        from robustlab.dynamics.control.controlled_plant import actuator_cascade
        from robustlab.dynamics.control.controllers import two_layer
        from robustlab.dynamics.stewart.stewart_platform import StewartPlatform

        plant = work.values[self.of]
        if isinstance(plant, StewartPlatform):
            K = two_layer(plant, self.p_up, self.p_low).upper_layer()
            what = "upper layer of the thesis, angles and rates to torques"
        else:
            K = actuator_cascade(plant, self.p_up, self.p_low)
            what = "two layers of the thesis, angle, speed and current to volts"
        numbers = {"order": K.n_states, "p_up": self.p_up, "p_low": self.p_low}
        poles = f"{self.p_up:g} and {self.p_low:g} 1/s, triple"
        facts = (Fact("Order", str(K.n_states)), Fact("Poles of the layers", poles))
        return Outcome(rl.Controller(K, method="cascade"), f"{what[:1].upper()}{what[1:]}.", numbers, facts)


@step
class RobustPerformanceStep(Step):
    """Robust performance of one problem under several controllers: certified mu, worst-case gain, order."""

    gives: ClassVar[str] = "performance"
    do: Literal["robust-performance"]
    of: ToUncertainOrProblem
    controllers: Controllers
    accuracy: Annotated[float, Field(gt=0, lt=1)] = Field(1e-3, description="Relative distance to the best proof.")
    effort: Effort = Field(1.0, description="Multiple of the usual work, for mu and for the gain of each controller.")
    time_limit: TimeLimit | None = Field(None, description=GUARD)
    set: Annotated[str, RefersTo(("uncertain", "any"))] | None = Field(
        None, description="Of a tracking problem: another set of models to judge it on."
    )
    gain: bool = Field(True, description="The worst-case gain, too.")
    points: Annotated[int, Field(ge=2, le=10_000)] = Field(120, description="Frequencies of the curves in the figure.")

    def foretell(self, ahead: Ahead) -> Foretold:
        pure = ("order", "nominal_gain", "mu_lower", "mu_upper", *(("gain_lower", "gain_upper") if self.gain else ()))
        row = {**dict.fromkeys(pure, "1"), "frequency": "rad/s"}
        return Foretold(leaves={"controllers": dict.fromkeys(self.controllers, row)})

    def run(self, work: Workspace) -> Outcome:
        from robustlab.report.design_figures import mu_comparison_figure
        from robustlab.synthesis.specifications.loop_functions import frequencies

        margins: dict[str, Any] = {}
        rows: dict[str, dict[str, Any]] = {}
        statuses: list[rl.Status] = []
        remarks: list[str] = []
        for name in self.controllers:
            loop, K = _closed(self, work, name)
            row: dict[str, Any] = {"order": K.n_states, "nominal_gain": rl.peak_gain(loop.nominal).upper}
            if not loop.nominal.is_stable():
                raise InputError(f"controller {name!r}", f"does not stabilise {self.of}", "a stable nominal loop")
            grid = frequencies(loop.M, self.points)
            options: dict[str, Any] = {"effort": self.effort, "time_limit": self.time_limit, "seed": work.seed}
            margin = rl.robust_performance(loop, omega=grid, accuracy=self.accuracy, tolerance=math.inf, **options)
            row |= {"mu_lower": inverse(margin.upper), "mu_upper": inverse(margin.lower), "frequency": margin.frequency}
            margins[name] = margin
            statuses.append(margin.status)
            remarks += [f"{name}, μ: {text}." for text in margin.notes]
            if self.gain:
                worst = rl.peak_gain(loop, tolerance=0.01, **options)
                row |= {"gain_lower": worst.lower, "gain_upper": worst.upper}
                statuses.append(worst.status)
                remarks += [f"{name}, gain: {text}." for text in worst.notes]
            rows[name] = row
            work.keep(margin, name)
        caption = (
            "μ of robust performance; thin lines: proved at all frequencies. "
            "Below 1 every member meets the requirement."
        )
        work.draw(mu_comparison_figure(margins), "mu", caption)
        header = ["controller", "order", "nominal gain", "μ, attained .. proved"] + ["worst-case gain"] * self.gain
        table = [
            [name, str(row["order"]), f"{row['nominal_gain']:.4g}", f"{row['mu_lower']:.4g} .. {row['mu_upper']:.4g}"]
            + ([f"{row['gain_lower']:.4g} .. {row['gain_upper']:.4g}"] if self.gain else [])
            for name, row in rows.items()
        ]
        met = [name for name, row in rows.items() if row["mu_upper"] <= 1]
        facts = (Fact("Requirement met by every member, proved", ", ".join(met) or "by none of them"),)
        status = least_trusted(statuses)
        where = self.of if self.set is None else f"{self.of} on {self.set}"
        summary = f"Robust performance of {where} under {len(rows)} controllers, the same requirement for all."
        note = (
            "μ at most 1: for every Δ of the set the weighted gain is at most 1. The worst-case gain is over that set."
        )
        return Outcome(
            margins, summary, {"controllers": rows}, facts, status, (note, *remarks), text_table(header, table)
        )


@step
class SimulateControlStep(Step):
    """A linear plant with effects under several controllers: a sine is followed, members of the set included."""

    gives: ClassVar[str] = "runs"
    do: Literal["simulate-control"]
    of: ToPlant
    controllers: Controllers
    controlled: Outputs
    measured: Outputs
    amplitude: Positive = Field(description="Of the reference, in the controlled output's unit.")
    omega: Positive = Field(description="Of the reference in rad/s.")
    rise_time: Positive = Field(description="s, in which the sine grows to its amplitude.")
    t_end: Positive
    after: Annotated[float, Field(ge=0)] = Field(0.0, description="s from which on the error counts.")
    points: Annotated[int, Field(ge=2, le=100_000)] = 2001
    step: Positive = Field(1e-4, description="s between samples of the reference; it is held between them.")
    effects: dict[str, dict[str, float]] = Field(
        {}, description='As "coulomb-friction@omega" = { Fc = 3e-3 }, "input-dead-zone@u" = { d = 0.6 }.'
    )
    members: list[dict[str, float]] = Field([], description="Parameters of further members of the set to simulate.")
    scale: Positive = Field(1.0, description="Factor from the controlled output to `unit`.")
    unit: str = ""
    limits: Annotated[dict[str, Positive], Names("signals")] = Field(
        {}, description="Largest magnitude of a signal; compared, not clipped."
    )

    def foretell(self, ahead: Ahead) -> Foretold:
        known = {**(ahead[self.of].inputs or {}), **(ahead[self.of].outputs or {})}
        plant = ahead[self.of].value
        if plant is not None:  # unknown effects, places and parameters are refused
            for member in self.members:
                plant.with_parameters(**member)
            if self.effects:
                rl.with_effects(plant, self.effects)
        unit = self.unit or known.get(self.controlled[0], float)
        row = {
            "order": "1", "largest_error": unit, "worst_error": unit, "within_limits": bool,
            "largest": {name: known.get(name, float) for name in self.limits},
        }  # fmt: skip
        return Foretold(leaves={"controllers": dict.fromkeys(self.controllers, row)})

    def _wave(self) -> tuple[Any, Any, int]:
        """Times (n,), the reference at them, and how many of them lie between two points that are kept."""
        import numpy as np

        fine = max(1, math.ceil(self.t_end / (self.points - 1) / self.step))
        t = np.linspace(0.0, self.t_end, fine * (self.points - 1) + 1)
        share = np.clip(t / self.rise_time, 0.0, 1.0)
        return t, self.amplitude * share**3 * (10 - 15 * share + 6 * share**2) * np.sin(self.omega * t), fine

    def run(self, work: Workspace) -> Outcome:
        import numpy as np

        from robustlab.dynamics import LinearPlant
        from robustlab.dynamics.control.controlled_plant import controlled_plant
        from robustlab.report.design_figures import TimePanel, runs_figure

        plant = work.values[self.of]
        if not isinstance(plant, LinearPlant):
            raise InputError(f"step {self.of!r}", f"gave a {type(plant).__name__}", "a linear plant")
        for name in self.limits:
            known = [s.name for s in (*plant.outputs, *plant.inputs)]
            if name not in known:
                raise unknown_name(f"limits.{name}", "no such signal", name, known)
        t, wave, fine = self._wave()
        reference = np.tile(wave[:, None], len(self.controlled))
        rows: dict[str, dict[str, Any]] = {}
        errors: dict[str, Any] = {}
        efforts: dict[str, dict[str, Any]] = {name: {} for name in self.limits}
        for name in self.controllers:
            loop = controlled_plant(plant, work.values[name], self.controlled, self.measured)
            members = [_rough(loop, plant, self.effects, member) for member in ({}, *self.members)]
            runs = [rl.simulate(member, t, reference) for member in members]
            error = [np.column_stack([wave - run[c] for c in self.controlled]) * self.scale for run in runs]
            late = t >= self.after
            row: dict[str, Any] = {
                "order": len(loop.states) - len(plant.states),
                "largest_error": float(np.abs(error[0][late]).max()),
                "worst_error": float(max(np.abs(e[late]).max() for e in error)),
                "largest": {n: float(max(np.abs(run[n]).max() for run in runs)) for n in self.limits},
            }
            row["within_limits"] = all(row["largest"][n] <= limit for n, limit in self.limits.items())
            rows[name] = row
            errors[name] = error[0][::fine, 0]
            for signal in self.limits:
                efforts[signal][name] = runs[0][signal][::fine]
        units = {s.name: s.unit for s in (*plant.outputs, *plant.inputs)}
        unit, amplitude = self.unit or units[self.controlled[0]], quantity(self.amplitude, units[self.controlled[0]])
        panels = [TimePanel(f"error of {self.controlled[0]} [{unit}]", errors)]
        panels += [TimePanel(f"{n} [{units[n]}]", efforts[n], limit) for n, limit in self.limits.items()]
        words = " and ".join(e.replace("-", " ").replace("@", " at ") for e in self.effects) or "no further effect"
        work.draw(runs_figure(t[::fine], panels), "runs", f"A sine is followed; nominal parameters, with {words}.")
        header = ["controller", "order", f"error [{unit}]", f"of the worst member [{unit}]"]
        header += [f"largest {n} [{units[n]}]" for n in self.limits]
        table = [
            [name, str(row["order"]), f"{row['largest_error']:.4g}", f"{row['worst_error']:.4g}"]
            + [f"{row['largest'][n]:.4g}" for n in self.limits]
            for name, row in rows.items()
        ]
        facts = (
            Fact("Reference", f"{amplitude} at {quantity(self.omega, 'rad/s')}"),
            Fact("Effects that no design knew", words),
            Fact("Further members simulated", str(len(self.members))),
            Fact("Errors count from", quantity(self.after, "s")),
        )
        summary = f"{self.of} under {len(rows)} controllers, simulated with {words}."
        note = "Limits are compared with, not applied: nothing is clipped."
        kept = Runs(t[::fine], errors, unit, self.after)
        return Outcome(
            kept, summary, {"controllers": rows}, facts, rl.Status.CONVERGED, (note,), text_table(header, table)
        )


@step
class FollowTrajectoryStep(Step):
    """The nonlinear Stewart platform under several controllers, following the path of section 9.1.3.

    With motors the controllers are upper layers that ask for torques, above the motors' torque loops. Without, the
    machine takes their torques; it may have effects then, as after `discover`, and controllers may see angles alone.
    """

    gives: ClassVar[str] = "runs"
    do: Literal["follow-trajectory"]
    of: ToPlantOrFile
    controllers: Controllers
    p_low: Positive = Field(3000.0, description="Triple pole of the motors' torque loops in 1/s.")
    at: Annotated[list[float], Field(min_length=6, max_length=6)] | None = Field(
        None, description="Pose at which the path begins; home, where the controllers are trimmed, where left out."
    )
    scale: Positive = Field(1.0, description="Of the path: at 1 a lift of 5 mm, sines of 5 mm and 20 mrad.")
    rise_time: Annotated[float, Field(ge=0)] = 0.0
    t_end: Positive = 5.0
    after: Annotated[float, Field(ge=0)] = Field(3.0, description="s from which on the errors count.")
    points: Annotated[int, Field(ge=2, le=100_000)] = 2501

    def foretell(self, ahead: Ahead) -> Foretold:
        row = {
            "order": "1", "worst_error": "mm", "position_error": "m", "orientation_error": "rad",
            "nut_errors": {f"phi_{i}": "rad" for i in range(1, 7)}, "largest_torque": "N m", "largest_voltage": "V",
            "within_limits": bool, "spectral_abscissa": "1/s",
        }  # fmt: skip
        return Foretold(leaves={"controllers": dict.fromkeys(self.controllers, row)})

    def run(self, work: Workspace) -> Outcome:
        """The nonlinear platform under each controller, with its motors' torque loops below if it has motors.

        Numbers, by controller: ``worst_error`` (largest distance from the path in mm), ``position_error`` in m and
        ``orientation_error`` in rad of the worst axis, ``nut_errors.phi_1`` ... in rad, ``largest_torque`` and, with
        motors, ``largest_voltage``, ``within_limits``, ``spectral_abscissa`` of the linear loop.
        """
        import numpy as np

        from robustlab.report.design_figures import TimePanel, runs_figure
        from robustlab.statespace import as_model

        runs, abscissas, asked, below = _followed(self, work)
        t, limits = np.linspace(0.0, self.t_end, self.points), next(iter(runs.values())).limits
        late = t >= self.after
        rows: dict[str, dict[str, Any]] = {}
        curves: dict[str, dict[str, Any]] = {key: {} for key in ("position", "torque", "voltage")}
        for name, run in runs.items():
            error = run.largest_error(self.after)
            curves["position"][name] = distance = 1e3 * np.linalg.norm(run.error[:, :3], axis=1)
            rows[name] = {
                "order": as_model(work.values[name], name).n_states,
                "worst_error": float(distance[late].max()),
                "position_error": float(error[:3].max()),
                "orientation_error": float(error[3:].max()),
                "nut_errors": {f"phi_{i + 1}": float(off) for i, off in enumerate(_largest(run.phi - asked, late))},
                "largest_torque": float(run.largest_torque().max()),
                "within_limits": run.within_limits,
                "spectral_abscissa": abscissas[name],
            }
            curves["torque"][name] = 1e3 * np.abs(run.torque).max(axis=1)
            if run.voltage.size:
                rows[name]["largest_voltage"] = float(run.largest_voltage().max())
                curves["voltage"][name] = np.abs(run.voltage).max(axis=1)
        panels = [
            TimePanel("distance to path [mm]", curves["position"]),
            TimePanel("largest |torque| [mN m]", curves["torque"], 1e3 * limits.torque),
            TimePanel("largest |voltage| [V]", curves["voltage"], limits.voltage),
        ]
        sizes = f"a lift of {5 * self.scale:g} mm, then sines of {5 * self.scale:g} mm and {20 * self.scale:g} mrad"
        caption = f"The nonlinear machine on the path of section 9.1.3: {sizes}."
        work.draw(runs_figure(t, [p for p in panels if p.curves]), "runs", caption)
        columns = (
            ("position [mm]", "position_error", 1e3),
            ("angle [mrad]", "orientation_error", 1e3),
            ("torque [mN m]", "largest_torque", 1e3),
            *([("voltage [V]", "largest_voltage", 1.0)] if curves["voltage"] else []),
        )
        header = ["controller", "order", *(title for title, _, _ in columns), "in limits"]
        table = [
            [
                name,
                str(row["order"]),
                *(f"{factor * row[key]:.4g}" for _, key, factor in columns),
                "yes" if row["within_limits"] else "no",
            ]
            for name, row in rows.items()
        ]
        pose = "home" if self.at is None else ", ".join(f"{v:g}" for v in self.at)
        facts = (
            Fact("Path begins at", pose),
            Fact("Path", sizes),
            below,
            Fact("Errors count from", quantity(self.after, "s")),
        )
        summary = f"Nonlinear simulation of {self.of} under {len(rows)} controllers."
        what = "torque and voltage" if curves["voltage"] else "torque"
        note = f"Nothing is clipped: 'in limits' says whether the motors' {what} would have been enough."
        kept = Runs(t, curves["position"], "mm", self.after)
        return Outcome(
            kept, summary, {"controllers": rows}, facts, rl.Status.CONVERGED, (note,), text_table(header, table)
        )


def _followed(
    step: FollowTrajectoryStep, work: Workspace
) -> tuple[dict[str, TrajectoryFollowing], dict[str, float], Any, Fact]:
    """The run under each controller, the rightmost pole of its linear loop, the nut angles asked for (n, 6), and what
    is below the controllers.
    """
    import numpy as np

    from robustlab.dynamics.control.controllers import LayeredController, closed_loop, two_layer
    from robustlab.dynamics.control.trajectory_following import SineTrajectory, follow, follow_with_torques, torque_loop
    from robustlab.dynamics.extended.extended_plant import ExtendedNonlinearPlant
    from robustlab.dynamics.stewart.kinematics import nut_angles
    from robustlab.dynamics.stewart.stewart_platform import StewartPlatform
    from robustlab.statespace import as_model

    plant = work.values[step.of]
    machine = plant.plant if isinstance(plant, ExtendedNonlinearPlant) else plant
    if not isinstance(machine, StewartPlatform) or (machine.motors and machine is not plant):
        expected = "one, with motors, or without them and perhaps with effects"
        raise InputError(f"step {step.of!r}", "gave no Stewart platform that can be followed here", expected)
    point = rl.trim(plant) if step.at is None else rl.trim(plant, pose=step.at)
    path = SineTrajectory(machine.geometry.home if step.at is None else step.at, rise_time=step.rise_time)
    path = replace(path, lift=step.scale * np.asarray(path.lift), amplitude=step.scale * np.asarray(path.amplitude))
    t = np.linspace(0.0, step.t_end, step.points)
    asked = nut_angles(machine.geometry, path.pose(t))
    models = {name: as_model(work.values[name], name) for name in step.controllers}
    if not machine.motors:
        named = f", with {', '.join(e.in_words for e in plant.effects)}" if machine is not plant else ""
        runs = {name: follow_with_torques(plant, K, path, t, at=point) for name, K in models.items()}
        poles = {name: rl.linearise(torque_loop(machine, K, point)).spectral_abscissa() for name, K in models.items()}
        return runs, poles, asked, Fact("The machine", f"takes torques{named}")
    lower = two_layer(machine, p_low=step.p_low).lower
    layered = {name: LayeredController(K, lower, point) for name, K in models.items()}
    runs = {name: follow(machine, controller, path, t) for name, controller in layered.items()}
    poles = {name: closed_loop(machine, controller).spectral_abscissa() for name, controller in layered.items()}
    return runs, poles, asked, Fact("Torque loops below", f"triple pole at {step.p_low:g} 1/s")


def _largest(errors: Any, late: Any) -> Any:
    """Largest magnitude of each column at the times that count."""
    return abs(errors[late]).max(axis=0)


def _rough(loop: Any, plant: Any, effects: Mapping[str, Mapping[str, float]], member: Mapping[str, float]) -> Any:
    """A member's loop with effects; one at a control acts on what the controller commands."""
    from robustlab.dynamics.control.controlled_plant import driver_in_loop

    made, own = (p.with_parameters(**member) if member else p for p in (loop, plant))
    at_controls = [f"input-dead-zone@{s.name}" for s in plant.inputs]
    rest = {key: values for key, values in effects.items() if key not in at_controls}
    moved = rl.with_effects(made, rest) if rest else made
    for key in at_controls:
        if key in effects:
            drop = driver_in_loop(made, own, key.partition("@")[2], effects[key])
            moved = rl.with_effects(moved, drop)
    return moved


def text_table(header: list[str], rows: list[list[str]]) -> str:
    """Aligned columns for the report's text."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in (header, *rows)]
    return "\n".join([lines[0], "  ".join("-" * w for w in widths), *lines[1:]])


def _closed(step: RobustPerformanceStep, work: Workspace, name: str) -> tuple[Any, Any]:
    """The loop of a problem (or of a generalised plant) under a controller, and that controller's model."""
    from robustlab.statespace import as_model
    from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

    given, K = work.values[step.of], as_model(work.values[name], name)
    if isinstance(given, TrackingProblem):
        problem = given if step.set is None else given.on(work.uncertain(step.set))
        return problem.close(K), K
    if step.set is not None:
        raise InputError("set", f"given, but {step.of} is no tracking problem", "no set")
    return work.uncertain(step.of).close(K), K


def _signals(G: Any) -> tuple[list[str], list[str]]:
    """Names of the inputs and outputs of a model or an uncertain model."""
    from robustlab.statespace import as_model

    base = G if hasattr(G, "blocks") else as_model(G, "tracking problem")
    return [s.name for s in base.inputs], [s.name for s in base.outputs]


def _matching(names: Sequence[str], known: Sequence[str]) -> list[str]:
    """The names with each pattern replaced by what it matches; a pattern without a match stays, to be refused."""
    found: list[str] = []
    for name in names:
        found += [k for k in known if fnmatchcase(k, name)] or [name] if "*" in name else [name]
    return found


def _sizes_of(given: Any, known: Sequence[str]) -> Any:
    """Sizes with each pattern replaced by what it matches; the first pattern that matches a signal counts."""
    if not isinstance(given, dict):
        return given
    sizes: dict[str, float] = {}
    for pattern, size in given.items():
        for name in _matching([pattern], known):
            sizes.setdefault(name, size)
    return sizes


def inverse(value: float) -> float:
    """One over a margin; inf for none."""
    return 1 / value if value > 0 else math.inf


def _weight(given: Any, make: Any) -> Any:
    return given if given is None or isinstance(given, float) else make(**given.model_dump())


def _sizes(sizes: Mapping[str, float], signals: Any) -> str:
    units = {s.name: s.unit for s in signals}
    return ", ".join(f"{name} {quantity(size, units.get(name, ''))}" for name, size in sizes.items()) or "none"
