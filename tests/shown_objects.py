"""One small object of every class with a display; each is made at its first use."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import robustlab as rl
from robustlab import result
from robustlab.synthesis import Damping, MarginGoal, TrackingGoal

OMEGA = np.geomspace(0.01, 100.0, 60)


@cache
def motor() -> Any:
    return rl.plant("dc-motor", Kf=(4.8e-5, 0.35), R=(2.07, 0.1))


@cache
def uncertain_motor() -> rl.UncertainModel:
    return motor().uncertain(outputs=["omega"])


@cache
def spring() -> rl.UncertainModel:
    ranges = {"m": (3.0, 2.8, 3.6), "c": (1.0, 0.8, 1.5), "k": (2.0, 1.4, 3.0)}
    found = rl.parametric([[0, 1], ["-k/m", "-c/m"]], [[0], ["1/m"]], [[1, 0]], [[0]], ranges)
    M = found.M
    named = M.renamed([*M.inputs[:-1], ("F", "N")], [*M.outputs[:-1], ("x", "m")])
    return rl.UncertainModel(named, found.blocks)


INTEGRAL = rl.StateSpaceModel([[0.0]], [[1.0]], [[0.2]], [[0.0]], inputs=[("x", "m")], outputs=[("F", "N")])


@cache
def loop() -> rl.UncertainModel:
    return spring().feedback(INTEGRAL)


@cache
def problem() -> rl.StateSpaceModel:
    return rl.StateSpaceModel(
        [[-1.0, 1.0], [0.0, -3.0]], [[1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], [[1, 0], [0, 0], [1, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]], inputs=["d", "n", "u"], outputs=["x", "effort", "y"],
    )  # fmt: skip


def lag() -> rl.StateSpaceModel:
    return rl.StateSpaceModel([[-0.1]], [[1.0]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("y", "m")])


@cache
def record() -> rl.Record:
    from naming_cases import T, U

    rough = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    run = rl.simulate(rough, T, U)
    noise = 1e-5 * np.random.default_rng(3).normal(size=len(T))
    return rl.Record(T, {"u": U}, {"q": run["q"] + noise}, {"u": "V", "q": "m"}, "friction run")


@cache
def comparison() -> Any:
    return rl.compare(rl.plant("servo-axis"), record())


@cache
def watch() -> Any:
    """A log of a servo axis whose dry friction rises in its second half."""
    from naming_cases import T, U, all_but

    rough = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
    rougher = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 26.0}})
    noise, pieces = np.random.default_rng(4), []
    for machine in (rough, rough, rougher):
        q = rl.simulate(machine, T, U)["q"] + 1e-4 * noise.normal(size=len(T))
        pieces.append(rl.Record(T, {"u": U}, {"q": q}, {"u": "V", "q": "m"}, "piece"))
    return rl.watch(rough, pieces, noise={"q": 1e-4}, exclude=all_but("coulomb-friction", "constant-load"))


@cache
def validation() -> Any:
    t = np.arange(40) * 0.1
    run = rl.simulate(lag(), t, np.sin(t))
    off = rl.Record(t, {"u": np.sin(t)}, {"y": 1.05 * run["y"]}, {"u": "V", "y": "m"}, "run")
    return rl.validate(rl.unstructured(lag(), 0.2), off, {"y": 0.01})


@cache
def data_cover() -> Any:
    t = np.arange(200) * 5e-3
    push = np.where(t < 0.5, 2.0, -1.5)
    plain = rl.plant("servo-axis", M=(95.0, 0.05), Fv=(200.0, 0.1), gain=35.0)
    rough = rl.with_effects(plain, {"coulomb-friction": {"Fc": 20.0}})
    run = rl.simulate(rough, t, push)
    return rl.data_cover(rough, [rl.Record(t, {"u": push}, {"q": run["q"]}, {"u": "V", "q": "m"}, "run")], {"q": 1e-4})


@cache
def measured_response() -> rl.FrequencyData:
    response = rl.frequency_response(lag(), OMEGA)[:, 0, 0]
    return rl.FrequencyData(OMEGA, response, "u", ["y"])


def measured_loop() -> rl.UncertainFrequencyData:
    response = rl.frequency_response(lag(), OMEGA[::6])[:, 0, 0]
    return rl.frequency_data(response, OMEGA[::6], radius=0.05 * abs(response)).feedback(0.5)


@cache
def discovery() -> Any:
    from unit.identification.test_discovery_report import unknown

    return unknown()


@cache
def campaign(folder: str) -> Any:
    from robustlab.campaign import CampaignSettings, WorkerOptions, run_campaign

    settings = CampaignSettings("peak-deviation", 200, u={"u": 42.0}, t_end=0.1, points=51)
    path = Path(folder) / "campaign.sqlite"
    return run_campaign(uncertain_motor(), settings, path, workers=WorkerOptions(workers=1), limit=10.0)


def four_models() -> list[rl.StateSpaceModel]:
    return [spring().evaluate(delta) for delta in ({}, {"m": 1.0}, {"k": -0.5, "c": 0.3}, {"c": -1.0, "m": 0.4})]


def first_order() -> rl.UncertainModel:
    M = rl.StateSpaceModel([[-1.0]], [[-0.3, 1.0, 1.0]], [[1.0]] * 3, [[0.0] * 3] * 3)
    return rl.UncertainModel(M, [rl.RealScalar("pole")])


def digital() -> rl.StateSpaceModel:
    return rl.StateSpaceModel([], [], [], [[-3.0]], 0.05)


def made_effects() -> Any:
    from robustlab.dynamics import effect_blocks

    return effect_blocks(rl.plant("servo-axis", M=(95.0, 0.05), Fv=(200.0, 0.1)))


def scheduled_plant() -> rl.LPVModel:
    def vertex(a: float) -> rl.StateSpaceModel:
        return rl.StateSpaceModel([[a]], [[1, 0, 1]], [[1], [0], [1]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])

    return rl.LPVModel({"a": [-2.0, 0.0]}, [vertex(-2.0), vertex(0.0)])


@cache
def scheduled() -> Any:
    return rl.hinf(scheduled_plant(), 1, 1)


@cache
def mixsyn() -> Any:
    W1 = rl.performance_weight(1.0, 0.01, 2.0)
    return rl.mixsyn(lag(), W1, 0.1)


def performance_comparison() -> Any:
    from robustlab.analysis import compare_performance

    return compare_performance({"first": (first_order(), 1), "second": (first_order(), 1)}, points=20)


def controlled_runs() -> Any:
    from robustlab.dynamics import follow_sine

    K = rl.StateSpaceModel([], [], [], [[0.5, -0.5]], inputs=["omega_ref", ("omega", "rad/s")], outputs=[("u", "V")])
    sine: dict[str, Any] = {"amplitude": 10.0, "omega": 30.0, "rise_time": 0.1, "t_end": 0.4, "points": 41}
    return follow_sine(motor(), {"gain": K}, ["omega"], ["omega"], **sine, limits={"u": 42.0})


def tracking_loop() -> Any:
    from robustlab.synthesis import TrackingLoop, tracking_problem

    problem = tracking_problem(lag(), ["y"], ["y"], W1=rl.performance_weight(1.0, 0.01, 2.0), W2=0.1)
    design = rl.hinf(problem.plant)
    return TrackingLoop(problem, design, design.gamma)


def critical_response() -> Any:
    from robustlab.mu_analysis import replay

    return replay(loop(), made("Margin"))


# Class name -> how one is made; a campaign needs a folder and is made by `campaign`.
OBJECTS: dict[str, Any] = {
    "StateSpaceModel": lambda: spring().nominal,
    "UncertainModel": spring,
    "DelayedModel": lambda: rl.with_delays(lag(), inputs={"u": 0.5}),
    "UncertainFrequencyData": measured_loop,
    "Controller": lambda: mixsyn().controller,
    "LPVModel": scheduled_plant,
    "LPVController": lambda: scheduled().controller,
    "LPVGain": lambda: scheduled().gain,
    "LPVSynthesis": scheduled,
    "GeneralizedPlant": lambda: rl.generalized_plant(problem(), ["y"], ["u"]),
    "Record": record,
    "DcMotor": motor,
    "Trim": lambda: rl.trim(rl.plant("stewart-platform"), pose=None),
    "Samples": lambda: rl.sample(spring(), 20, 1, 8),
    "Responses": lambda: rl.sample(spring(), 20, 1, 8).respond(np.linspace(0.0, 20.0, 201)),
    "Reduction": lambda: rl.reduce_model(spring() + spring()),
    "Cover": lambda: rl.cover(four_models(), "output-multiplicative"),
    "Conservatism": lambda: rl.cover(four_models(), "elements").conservatism,
    "Overbound": lambda: rl.overbound(OMEGA, 0.1 + OMEGA / (1.0 + OMEGA)),
    "EffectBlocks": made_effects,
    "WorstCase": lambda: rl.worst_case(spring(), "peak-deviation", n=32),
    "ViolationProbability": lambda: rl.violation_probability(spring(), "peak-deviation", 0.3, n=200),
    "Influence": lambda: made("ViolationProbability").influence,
    "MuBounds": lambda: rl.mu(np.array([[[0.5, 1.0], [1.0, 0.0]], [[1.0, 0.2], [0.1, 1.0j]]]), [[1, 0], [1, 0]]),
    "Margin": lambda: rl.robust_stability(loop(), omega=np.geomspace(0.05, 20.0, 200)),
    "WorstCaseGain": lambda: rl.peak_gain(loop(), omega=np.geomspace(0.05, 20.0, 40)),
    "MarginAt": lambda: rl.robust_stability(measured_loop()),
    "GainAt": lambda: rl.peak_gain(measured_loop()),
    "DiskMarginAt": lambda: rl.disk_margin(2.0 * rl.delay(0.5) @ lag(), frequency=[0.5, 1.0]).simultaneous,
    "CriticalResponse": critical_response,
    "PerformanceMargin": lambda: rl.robust_performance(loop(), tolerance=0.2),
    "DiskMargins": lambda: rl.disk_margin(spring().nominal, INTEGRAL),
    "DiskMargin": lambda: rl.disk_margin(spring().nominal, INTEGRAL).simultaneous,
    "DelayStability": lambda: rl.robust_stability(rl.with_delays(lag(), inputs={"u": 0.5}).feedback()),
    "DelayGain": lambda: rl.peak_gain(rl.with_delays(lag(), inputs={"u": 0.5})),
    "GapMetric": lambda: rl.gap(lag(), 2.0 * lag()),
    "RobustGain": lambda: rl.robust_gain(rl.elementwise(lag(), 2.0 * lag()), 15.0, tolerance=0.2),
    "NuGap": lambda: rl.nu_gap(spring().nominal, four_models()[1]),
    "CoprimeMargin": lambda: rl.coprime_margin(spring().nominal, INTEGRAL),
    "HinfNorm": lambda: rl.peak_gain(spring().nominal),
    "ClassicalMargins": lambda: rl.classical_margins(lag()),
    "Zeros": lambda: rl.zeros(lag()),
    "Verified": lambda: rl.verify(rl.peak_gain(lag())),
    "IqcGain": lambda: rl.peak_gain(loop(), block_types={"k": rl.Varying(0.1)}),
    "IqcStability": lambda: rl.robust_stability(first_order(), block_types={"pole": rl.Varying()}, order=0),
    "H2Norm": lambda: rl.h2(problem(), 1, 1).norm,
    "StructuralTest": lambda: rl.controllability(problem()),
    "HinfSynthesis": mixsyn,
    "H2Synthesis": lambda: rl.h2(problem(), 1, 1),
    "NcfSynthesis": lambda: rl.ncf(lag()),
    "DKSynthesis": lambda: rl.dk(problem(), [rl.ComplexScalar("gain")], 1, 1, direct=False),
    "TunedSynthesis": lambda: rl.tune(
        lag(), "pi", [TrackingGoal(1.0), MarginGoal(1.0, hard=True), Damping(0.5)], starts=0
    ),
    "FixedSynthesis": lambda: rl.fixed_structure(problem(), "static", n_meas=1, n_con=1, starts=1),
    "TrackingLoop": tracking_loop,
    "TrackingProblem": lambda: tracking_loop().problem,
    "PerformanceComparison": performance_comparison,
    "ControlledRuns": controlled_runs,
    "LoopFunctions": lambda: rl.loop_functions(spring().nominal, INTEGRAL),
    "ReducedModel": lambda: rl.reduce_model((spring().nominal @ lag().renamed([("F", "N")], [("F", "N")])), 2),
    "ReducedController": lambda: rl.reduce_controller(mixsyn().plant, mixsyn().K),
    "SampledController": lambda: rl.discretise(mixsyn(), dt=0.01),
    "SampledDataNorm": lambda: rl.sampled_data_norm(problem(), digital()),
    "Comparison": comparison,
    "Discovery": discovery,
    "Validation": validation,
    "DataCover": data_cover,
    "Watch": watch,
    "WatchedPiece": lambda: watch().pieces[0],
    "FrequencyData": measured_response,
    "Result": lambda: result.Result("Margin", rl.Status.CERTIFIED, {"lower": 1.5}),
}


@cache
def made(name: str) -> Any:
    """The object of a class; made once."""
    return OBJECTS[name]()
