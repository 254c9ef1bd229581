"""``robustlab synth lqr | lqi | kalman``: designs in the states of a model, weights and noises by name."""

from __future__ import annotations

from typing import Annotated

import typer

import robustlab as rl
from robustlab.cli.options import OutputOptions, assignments, grouped, load_model
from robustlab.errors import UsageError

ModelArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", metavar="FILE")]


IntegralOption = Annotated[
    list[str] | None,
    typer.Option(
        "--integral", help="Output that is to follow, with the weight on its integrated error: NAME=VALUE; repeatable."
    ),
]
StateOption = Annotated[list[str] | None, typer.Option("--state", help="Weight on a state: NAME=VALUE; repeatable.")]
ControlOption = Annotated[
    list[str] | None, typer.Option("--control", help="Weight on a control: NAME=VALUE; repeatable. Else 1.")
]
ProcessOption = Annotated[
    list[str] | None,
    typer.Option("--process", help="Intensity of the noise on a state or input: NAME=VALUE; repeatable."),
]
MeasurementOption = Annotated[
    list[str] | None, typer.Option("--measurement", help="The same of each output: NAME=VALUE; repeatable.")
]


@grouped
def lqr(
    *, file: ModelArgument, state: StateOption = None, control: ControlOption = None, output: OutputOptions
) -> None:
    """State feedback u = -K x of least quadratic cost; all states are measured. --out writes K, to close with x.

    Exit code 4: no gain could be vouched for.

    Example: robustlab synth lqr motor.h5 --state omega=100 --control u=0.1 --out k.h5
    """
    from robustlab.synthesis.h2.named_weights import integral_weights
    from robustlab.synthesis.h2.state_feedback import gain_controller

    weights = assignments("--state", state)
    if not weights:
        raise UsageError("synth lqr", "no state", "--state NAME=VALUE: which state is to be small, and its weight")
    model = load_model(file)
    found = rl.lqr(model, *integral_weights(model, {}, weights, assignments("--control", control)))
    output.finish_made("synth lqr", found, gain_controller(model, found), [file])


@grouped
def lqi(
    *,
    file: ModelArgument,
    integral: IntegralOption = None,
    state: StateOption = None,
    control: ControlOption = None,
    output: OutputOptions,
) -> None:
    """State feedback with integral action: outputs follow constant references without error; the loop is rebuilt.

    All states are measured. Exit code 4: no controller could be vouched for.

    Example: robustlab synth lqi motor.h5 --integral omega=100 --control u=0.1 --out k.h5
    """
    from robustlab.synthesis.h2.named_weights import integral_weights

    followed = assignments("--integral", integral)
    if not followed:
        raise UsageError("synth lqi", "no output", "--integral NAME=VALUE: which output follows, and its weight")
    model = load_model(file)
    Q, R = integral_weights(model, followed, assignments("--state", state), assignments("--control", control))
    found = rl.lqi(model, Q, R, outputs=list(followed))
    output.finish_made("synth lqi", found, found.controller, [file])


@grouped
def kalman(
    *, file: ModelArgument, process: ProcessOption = None, measurement: MeasurementOption = None, output: OutputOptions
) -> None:
    """Steady-state Kalman filter: from inputs and measured outputs to estimated states; checked by a second equation.

    White noise; of a discrete model the numbers are variances. Exit code 4: no filter could be vouched for.

    Example: robustlab synth kalman motor.h5 --process u=0.04 --measurement omega=1e-4 --out filter.h5
    """
    from robustlab.synthesis.h2.named_weights import diagonal_weight, process_noise

    model = load_model(file)
    W = process_noise(model, assignments("--process", process), "--process")
    V = diagonal_weight(assignments("--measurement", measurement), model.output_names, "--measurement")
    found = rl.kalman(model, W, V)
    output.finish_made("synth kalman", found, found.estimator, [file])
