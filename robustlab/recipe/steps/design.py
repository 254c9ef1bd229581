"""Steps that design controllers and close loops with them."""

from __future__ import annotations

from typing import Any

from robustlab.errors import InputError
from robustlab.recipe.control_schema import (
    DesignStep,
    DkStep,
    FixedStep,
    H2Step,
    HinfStep,
    NcfStep,
    ReduceControllerStep,
)
from robustlab.recipe.outcome import Fact, Outcome, Workspace, quantity
from robustlab.recipe.schema import CloseLoopStep, MixsynStep

__all__ = ["close_loop", "designed", "dk", "fixed", "h2", "hinf", "mixsyn", "ncf", "reduce_controller", "tracking_loop"]


def mixsyn(step: MixsynStep, work: Workspace) -> Outcome:
    """A mixed-sensitivity controller, verified in the loop rebuilt from it."""
    import robustlab as rl
    from robustlab.synthesis.specifications.weight_design import (
        complementary_weight,
        control_weight,
        performance_weight,
    )

    model = work.values[step.of]
    makers = ((step.W1, performance_weight), (step.W2, control_weight), (step.W3, complementary_weight))
    weights = [None if given is None else make(**given.model_dump()) for given, make in makers]
    found = rl.mixsyn(model, *weights)
    _draw_sensitivities(found, model, work)
    return designed(found, f"Mixed-sensitivity controller for {step.of}.", work)


def hinf(step: HinfStep, work: Workspace) -> Outcome:
    """An H-infinity controller of a generalised plant, verified in the loop rebuilt from it."""
    import robustlab as rl

    P, *channels = generalised(step, work, nominal=step.nominal)
    found = rl.hinf(P, *channels, gamma_rel=step.gamma_rel, effort=step.effort, time_limit=step.time_limit)
    _draw_loop(found, work)
    _draw_functions(found, step.of, work)
    return designed(found, f"H-infinity controller for {step.of}.", work)


def h2(step: H2Step, work: Workspace) -> Outcome:
    """An H2 controller of the nominal plant, verified in the loop rebuilt from it."""
    import robustlab as rl

    P, *channels = generalised(step, work, nominal=True)
    found = rl.h2(P, *channels, effort=step.effort, time_limit=step.time_limit)
    _draw_loop(found, work)
    _draw_functions(found, step.of, work)
    return designed(found, f"H2 controller for {step.of}.", work)


def ncf(step: NcfStep, work: Workspace) -> Outcome:
    """A loop-shaping controller, verified in the shaped loop and in that of the plant as given."""
    import robustlab as rl
    from robustlab.report.design_pictures import functions_picture

    found = rl.ncf(work.values[step.of], step.W1, step.W2, factor=step.factor)
    _draw_loop(found, work)
    work.draw(functions_picture(found), "functions", "S, K S, T and S G of the loop.")
    return designed(found, f"Loop-shaping controller for {step.of}.", work)


def dk(step: DkStep, work: Workspace) -> Outcome:
    """A robust controller; mu proved at all frequencies."""
    import robustlab as rl
    from robustlab.report.design_pictures import history_picture

    P, *channels = generalised(step, work)
    start = None if step.start is None else work.values[step.start]
    taken = {"direct", "mixed", "max_order", "order_rel", "effort", "time_limit"}
    options: dict[str, Any] = step.model_dump(include=taken)
    found = rl.dk(P, None, *channels, K0=start, **options)
    _draw_loop(found, work)
    work.draw(history_picture(found), "history", "The search: what each iterate proves of μ, and its order.")
    _draw_functions(found, step.of, work, proved=False)
    return designed(found, f"Robust controller for {step.of}.", work)


def fixed(step: FixedStep, work: Workspace) -> Outcome:
    """A controller of a given structure, verified in the loop rebuilt from it."""
    import robustlab as rl
    from robustlab.synthesis.laws.controller_structures import structure_in_words
    from robustlab.synthesis.problem.partition import as_generalized_plant

    plant = as_generalized_plant(*generalised(step, work, nominal=step.nominal), "fixed")
    options: dict[str, Any] = step.model_dump(include={"objective", "starts", "effort", "time_limit"})
    found = rl.fixed_structure(plant, structure_in_words(step.structure, plant), seed=work.seed, **options)
    _draw_loop(found, work)
    _draw_functions(found, step.of, work, proved=step.nominal and step.objective == "hinf")
    return designed(found, f"Controller of structure {step.structure} for {step.of}.", work)


def reduce_controller(step: ReduceControllerStep, work: Workspace) -> Outcome:
    """A controller of lower order whose loop was verified anew."""
    from robustlab.statespace import as_model
    from robustlab.synthesis.reduction.controller_reduction import reduce_controller as reduce

    P, n_meas, n_con = generalised(step, work, nominal=step.measure != "mu")
    K = as_model(work.values[step.controller], step.controller)
    options: dict[str, Any] = step.model_dump(include={"loss", "order", "measure", "effort", "time_limit"})
    found = reduce(P, K, n_meas=n_meas, n_con=n_con, **options)
    return designed(found, f"{step.controller} with fewer states.", work)


def generalised(step: DesignStep, work: Workspace, nominal: bool = False) -> tuple[Any, int | None, int | None]:
    """The generalised plant of a design step with its numbers of measurements and controls."""
    from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

    given = work.values[step.of]
    if isinstance(given, TrackingProblem):
        if step.measurements is not None or step.controls is not None:
            raise InputError("measurements or controls", "given", "neither: a tracking problem has its own")
        return given.nominal if nominal else given.plant, None, None
    if step.measurements is None or step.controls is None:
        found = "measurements or controls is missing"
        raise InputError(step.kind, found, "how many of the last outputs are measured, of the last inputs are controls")
    return given, step.measurements, step.controls


def close_loop(step: CloseLoopStep, work: Workspace) -> Outcome:
    """The uncertain tracking loop: reference in; controlled outputs and control signals out."""
    from robustlab.recipe.steps.models import uncertain_numbers

    loop = tracking_loop(work.values[step.of], work.values[step.controller])
    abscissa = loop.nominal.spectral_abscissa()
    numbers = {**uncertain_numbers(loop), "spectral_abscissa": abscissa, "nominally_stable": abscissa < 0}
    facts = (
        Fact("Inputs", ", ".join(s.name for s in loop.inputs)),
        Fact("Outputs", ", ".join(s.name for s in loop.outputs)),
        Fact("Rightmost pole of the nominal loop", quantity(abscissa, "1/s")),
    )
    word = "stable" if abscissa < 0 else "unstable"
    return Outcome(loop, f"Loop of {step.controller} around {step.of}: nominally {word}.", numbers, facts)


def tracking_loop(system: Any, controller: Any) -> Any:
    """The loop ``u = K (r - y)`` around a model or an uncertain model, as an uncertain model.

    Inputs: a reference for each output. Outputs: the outputs y and the control signals u.
    """
    import numpy as np

    from robustlab.statespace import Signal, StateSpaceModel, as_model
    from robustlab.uncertainty.lft import UncertainModel

    base = system if isinstance(system, UncertainModel) else UncertainModel(as_model(system), [])
    K = as_model(controller, "controller")
    sizes = (len(base.outputs), len(base.inputs))
    if (K.n_inputs, K.n_outputs) != sizes:
        found = f"{K.n_inputs} inputs and {K.n_outputs} outputs"
        raise InputError(
            "controller", found, f"{sizes[0]} and {sizes[1]}: an input per output of the model, and vice versa"
        )
    m, (q, p) = base.M, base.delta_shape
    n, n_u, n_y = m.n_states, m.n_inputs - q, m.n_outputs - p
    c_y, d_yw, d_yu = m.C[p:], m.D[p:, :q], m.D[p:, q:]
    plant = StateSpaceModel(
        m.A,
        np.hstack([m.B[:, :q], np.zeros((n, n_y)), m.B[:, q:]]),
        np.vstack([m.C, np.zeros((n_u, n)), -c_y]),
        np.block(
            [
                [m.D[:, :q], np.zeros((m.n_outputs, n_y)), m.D[:, q:]],
                [np.zeros((n_u, q)), np.zeros((n_u, n_y)), np.eye(n_u)],
                [-d_yw, np.eye(n_y), -d_yu],
            ]
        ),
        m.dt,
        [*m.inputs[:q], *(Signal(f"{s.name}_ref", s.unit) for s in base.outputs), *base.inputs],
        [*m.outputs, *base.inputs, *(Signal(f"{s.name}_error", s.unit) for s in base.outputs)],
        m.states,
        where="tracking loop",
    )
    return UncertainModel(plant, base.blocks).close(K)


def designed(found: Any, summary: str, work: Workspace) -> Outcome:
    """What a design leaves: every number of it that stands alone, and what a person wants to read."""
    from robustlab.synthesis.problem.performance_limits import limits_in_words

    work.keep(found)
    numbers = {key: value for key, value in found.to_json().items() if isinstance(value, (bool, int, float))}
    numbers["stable"] = found.closed_loop_abscissa < 0
    facts = tuple(Fact(f"{label[:1].upper()}{label[1:]}", text) for label, text in found.summary() if text)
    reason = f"{found.reason[:1].upper()}{found.reason[1:]}"
    text = "\n".join(["What limits any controller of this plant:", *limits_in_words(found)])
    return Outcome(found.controller, f"{summary} {reason}.", numbers, facts, found.status, (), text)


def _draw_loop(found: Any, work: Workspace) -> None:
    """Singular values of the weighted loop with the peak, and the controller."""
    from robustlab.report.design_pictures import loop_picture

    work.draw(loop_picture(found), "loop", "The weighted closed loop with its peak, and the controller.")


def _draw_functions(found: Any, of: str, work: Workspace, proved: bool = True) -> None:
    """S, K S and T of a tracking problem against what the weights ask for and, if wanted, what gamma proves."""
    from robustlab.report.design_figures import functions_figure, tracking_panels
    from robustlab.synthesis.specifications.loop_functions import frequencies
    from robustlab.synthesis.specifications.tracking_problem import TrackingProblem

    problem = work.values[of]
    if not isinstance(problem, TrackingProblem):
        return
    omega = frequencies(found.closed_loop)
    gamma = found.gamma if proved else None
    panels = tracking_panels(problem, {found.method: found.K}, omega, gamma)
    work.draw(functions_figure(omega, panels, gamma), "functions", "The nominal loop against its weights.")


def _draw_sensitivities(found: Any, model: Any, work: Workspace) -> None:
    import numpy as np

    import robustlab as rl
    from robustlab.frequency import default_grid
    from robustlab.report.design_figures import WeightedResponse, sensitivity_figure
    from robustlab.statespace import as_model

    loop = tracking_loop(as_model(model), found.K).nominal
    omega = default_grid(as_model(model), 400, decades=3.0)  # the weights live around the plant's dynamics
    response = rl.frequency_response(loop, omega)
    n_y = as_model(model).n_outputs
    output, control = response[:, :n_y], response[:, n_y:]
    functions = {
        "W1": ("S: control error", np.eye(n_y) - output),
        "W2": ("KS: control signal", control),
        "W3": ("T: output", output),
    }
    curves = []
    for name, (label, values) in functions.items():
        bound = None
        if name in found.weights:
            bound = found.gamma / np.abs(rl.frequency_response(found.weights[name], omega)[:, 0, 0])
        curves.append(WeightedResponse(label, np.linalg.norm(values, 2, axis=(1, 2)), bound))
    caption = "Closed loop against its weights: each curve lies below γ / |W|, with the verified γ."
    work.draw(sensitivity_figure(omega, curves, found.gamma), "sensitivities", caption)
