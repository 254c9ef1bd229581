"""Steps that design state feedback and estimators of least quadratic cost."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

import robustlab as rl
from robustlab.doors.vocabulary import Names, Positive, ToModel
from robustlab.recipe.steps.contract import Outcome, Step, Workspace, step, told
from robustlab.recipe.steps.leaves import COMPLEX

Weights = dict[str, Annotated[float, Field(ge=0)]]


@step
class LqrStep(Step):
    """State feedback of least quadratic cost, ``u = -K x``. All states are measured.

    The controller takes the states, by their names.
    """

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = {"K": [[float]], "poles": [COMPLEX], "X": [[float]]}
    do: Literal["lqr"]
    of: ToModel
    states: Annotated[Weights, Field(min_length=1)] = Field(description="Weights on states by name; 0 where left out.")
    controls: Annotated[dict[str, Positive], Names("inputs")] = Field(
        {}, description="Weights on controls by name; 1 where left out."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model
        from robustlab.synthesis.h2.named_weights import integral_weights
        from robustlab.synthesis.h2.state_feedback import gain_controller

        model = as_model(work.values[self.of], self.of)
        found = rl.lqr(model, *integral_weights(model, {}, self.states, self.controls))
        return told(found, gain_controller(model, found), f"States of {self.of} fed back.", found.numbers(), work)


@step
class LqiStep(Step):
    """State feedback with integral action: outputs follow constant references without error. All states are measured.

    The controller takes references, followed outputs and states; it is made for export, not for `close-loop`.
    """

    gives: ClassVar[str] = "controller"
    leaves: ClassVar[Any] = {
        "K": [[float]], "K_i": [[float]], "poles": [COMPLEX], "steady_error": ..., "spectral_abscissa": float,
    }  # fmt: skip
    do: Literal["lqi"]
    of: ToModel
    integral: Annotated[Weights, Field(min_length=1), Names("outputs")] = Field(
        description="Outputs that are to follow, with the weights on their integrated errors."
    )
    states: Weights = Field({}, description="Weights on states by name; 0 where left out.")
    controls: Annotated[dict[str, Positive], Names("inputs")] = Field(
        {}, description="Weights on controls by name; 1 where left out."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model
        from robustlab.synthesis.h2.named_weights import integral_weights

        model = as_model(work.values[self.of], self.of)
        Q, R = integral_weights(model, self.integral, self.states, self.controls)
        found = rl.lqi(model, Q, R, outputs=list(self.integral))
        said = f"{', '.join(self.integral)} of {self.of} held by states."
        return told(found, found.controller, said, found.numbers(), work)


@step
class KalmanStep(Step):
    """Steady-state Kalman filter, as a model from inputs and measured outputs to estimated states."""

    gives: ClassVar[str] = "model"
    leaves: ClassVar[Any] = {"L": [[float]], "poles": [COMPLEX], "deviations": {"*": float}}
    do: Literal["kalman"]
    of: ToModel
    process: Weights = Field(description="Intensities of the noise on states, or on inputs, by name.")
    measurement: Annotated[Weights, Names("outputs")] = Field(
        description="Intensities of the noise on each output by name; discrete: variances."
    )

    def run(self, work: Workspace) -> Outcome:
        from robustlab.statespace import as_model
        from robustlab.synthesis.h2.named_weights import diagonal_weight, process_noise

        model = as_model(work.values[self.of], self.of)
        W = process_noise(model, self.process, "process")
        found = rl.kalman(model, W, diagonal_weight(self.measurement, model.output_names, "measurement"))
        return told(found, found.estimator, f"States of {self.of} from its outputs.", found.numbers(), work)
