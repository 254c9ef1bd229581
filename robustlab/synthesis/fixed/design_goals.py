r"""Goals of a loop ``u = K (r - y)``, each a norm of a weighted closed loop that is to be at most one.

.. math:: \|W_i T_i\|_\infty \le 1 \qquad\text{or}\qquad \|T_i\|_2 \le \text{bound}

T_i leads from one group of signals of the loop to another: the references r, disturbances d at the controls and noise n
on the measurements; the outputs y, the controls u, the total inputs u + d of the plant, and the errors r - y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.checks import number
from robustlab.errors import InputError, did_you_mean
from robustlab.norms import bilinear_to_discrete
from robustlab.signals import Taken
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.hinf.mixed_sensitivity import weight_on_channels
from robustlab.synthesis.problem.partition import GeneralizedPlant, signal_positions
from robustlab.synthesis.specifications.weight_design import performance_weight

INPUTS = ("reference", "disturbance", "noise")
OUTPUTS = ("output", "control", "total", "error")


@dataclass(frozen=True, eq=False)
class StandardLoop:
    """A plant in the loop ``u = K (r - y)``, before K closes it."""

    g: StateSpaceModel  # the plant
    model: StateSpaceModel  # from (r, d, n, u) to (y, u, u + d, r - y, and what K takes, r - y - n)

    @classmethod
    def of(cls, g: StateSpaceModel) -> StandardLoop:
        """That of a plant."""
        n, m, p = g.n_states, g.n_inputs, g.n_outputs
        r, d, noise, u = np.split(np.eye(p + m + p + m), np.cumsum([p, m, p]))
        through, none = g.D @ (u + d), np.zeros((m, n))
        C = np.vstack([g.C, none, none, -g.C, -g.C])
        D = np.vstack([through, u, u + d, r - through, r - through - noise])
        y, v = g.output_names, g.input_names
        ins = [f"{group} {s}" for group, names in zip(INPUTS, (y, v, y), strict=True) for s in names]
        outs = [f"{group} {s}" for group, names in zip(OUTPUTS, (y, v, v, y), strict=True) for s in names]
        measured = [Taken(f"error {s.name} measured", s.unit, "r - y", s.name) for s in g.outputs]
        model = StateSpaceModel(
            g.A, g.B @ (u + d), C, D, g.dt, [*ins, *g.inputs], [*outs, *measured], g.states, where="tune"
        )
        return cls(g, model)

    @property
    def plant(self) -> GeneralizedPlant:
        """With all of its signals."""
        return GeneralizedPlant(self.model, self.g.n_outputs, self.g.n_inputs)

    def channel(
        self, inputs: Sequence[int], outputs: Sequence[int], weight: StateSpaceModel | None, minus: float = 0.0
    ) -> GeneralizedPlant:
        """``W (T - minus I)`` from some inputs to some outputs, by their places."""
        g, m = self.g, self.model
        columns = [*inputs, *range(m.n_inputs - g.n_inputs, m.n_inputs)]
        rows = [*outputs, *range(m.n_outputs - g.n_outputs, m.n_outputs)]
        D = np.array(m.D[np.ix_(rows, columns)])
        k = len(outputs)
        if minus:
            D[:k, :k] -= minus * np.eye(k)
        A, B, C = m.A, m.B[:, columns], np.array(m.C[rows])
        if weight is not None:
            o = np.zeros
            A = np.block([[A, o((m.n_states, weight.n_states))], [weight.B @ C[:k], weight.A]])
            B = np.vstack([B, weight.B @ D[:k]])
            C = np.block([[weight.D @ C[:k], weight.C], [C[k:], o((g.n_outputs, weight.n_states))]])
            D = np.vstack([weight.D @ D[:k], D[k:]])
        n_z = len(D) - g.n_outputs
        names = [f"z{i + 1}" for i in range(n_z)]
        model = StateSpaceModel(
            A, B, C, D, g.dt, [m.inputs[i] for i in columns], [*names, *m.outputs[m.n_outputs - g.n_outputs :]]
        )
        return GeneralizedPlant(model, g.n_outputs, g.n_inputs)

    def places(self, group: str, names: Sequence[str] | None, inside: bool) -> list[int]:
        """Where the signals of a group stand among the inputs (``inside``) or outputs of the model."""
        groups = INPUTS if inside else OUTPUTS
        if group not in groups:
            where = f"goal: {'inputs' if inside else 'outputs'}"
            raise InputError(where, f"{group!r}", f"one of {', '.join(groups)}", did_you_mean(group, groups))
        known = self.g.input_names if group in ("disturbance", "control", "total") else self.g.output_names
        chosen = [known[i] for i in signal_positions(known if names is None else names, known, f"goal: {group}")]
        every = self.model.input_names if inside else self.model.output_names
        return [every.index(f"{group} {name}") for name in chosen]


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What all goals have; ``hard`` ones must be met before the others are made small."""

    hard: bool = False
    norm: ClassVar[str] = "hinf"

    @property
    def text(self) -> str:
        """The goal in words."""
        raise NotImplementedError

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """The generalised plant whose norm is at most one where the goal is met."""
        raise NotImplementedError


@dataclass(frozen=True)
class TrackingGoal(Goal):
    """The named outputs (all where left out) follow their references: ``|W S| <= 1`` with the weight of
    `robustlab.performance_weight` at the bandwidth 2 / response_time, with this steady-state error and peak.
    """

    response_time: float
    error: float = 1e-2
    peak: float = 2.0
    outputs: Sequence[str] | None = None

    @property
    def text(self) -> str:
        """See `Goal`."""
        of = "" if self.outputs is None else f" of {', '.join(self.outputs)}"
        return f"tracking{of} within {self.response_time:g} s, error {self.error:g}, peak {self.peak:g}"

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """See `Goal`."""
        weight = performance_weight(2 / _positive("response_time", self.response_time), self.error, self.peak)
        into = loop.places("reference", self.outputs, True)
        return loop.channel(into, loop.places("error", self.outputs, False), _each(weight, len(into), loop.g.dt))


@dataclass(frozen=True)
class SensitivityGoal(Goal):
    """The sensitivity at the plant's outputs (or inputs) stays below ``peak``, and, with a ``bandwidth`` in rad/s,
    below ``error`` at low frequency: disturbances there are rejected.
    """

    peak: float = 2.0
    at: str = "output"
    bandwidth: float | None = None
    error: float = 1e-2

    @property
    def text(self) -> str:
        """See `Goal`."""
        low = "" if self.bandwidth is None else f", {self.error:g} at low frequency, bandwidth {self.bandwidth:g} rad/s"
        return f"sensitivity at the {self.at}: peak {self.peak:g}{low}"

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """See `Goal`."""
        into, out = _cut(loop, self.at)
        if self.bandwidth is None:
            return loop.channel(into, out, _each(1 / _positive("peak", self.peak), len(into), loop.g.dt))
        weight = performance_weight(self.bandwidth, self.error, self.peak)
        return loop.channel(into, out, _each(weight, len(into), loop.g.dt))


@dataclass(frozen=True)
class GainGoal(Goal):
    """The gain from one group of signals to another, times ``weight`` where given, is at most ``bound``; from
    disturbances to outputs: rejection.
    """

    bound: float = 1.0
    inputs: str = "disturbance"
    outputs: str = "output"
    weight: Any = None

    @property
    def text(self) -> str:
        """See `Goal`."""
        weighted = "" if self.weight is None else "weighted "
        return f"{weighted}gain from {self.inputs} to {self.outputs} <= {self.bound:g}"

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """See `Goal`."""
        out = loop.places(self.outputs, None, False)
        weight = weight_on_channels(1.0 if self.weight is None else self.weight, len(out), loop.g.dt, "goal: weight")
        if weight.D.shape == (1, 1):
            weight = _each(weight, len(out), loop.g.dt)
        share = 1 / _positive("bound", self.bound)
        weight = StateSpaceModel(weight.A, weight.B, share * weight.C, share * weight.D, weight.dt)
        return loop.channel(loop.places(self.inputs, None, True), out, weight)


@dataclass(frozen=True)
class VarianceGoal(Goal):
    """The root of the summed variances of a group of signals, for white noise of unit intensity in another, is at most
    ``bound``: an H2 norm.
    """

    bound: float = 1.0
    inputs: str = "disturbance"
    outputs: str = "output"
    norm: ClassVar[str] = "h2"

    @property
    def text(self) -> str:
        """See `Goal`."""
        return f"deviation of {self.outputs} from white {self.inputs} <= {self.bound:g}"

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """See `Goal`."""
        out = loop.places(self.outputs, None, False)
        weight = _each(1 / _positive("bound", self.bound), len(out), loop.g.dt)
        return loop.channel(loop.places(self.inputs, None, True), out, weight)


@dataclass(frozen=True)
class MarginGoal(Goal):
    r"""A disk margin of at least ``disk`` at the plant's outputs, inputs: :math:`\|S - I/2\|_\infty \le 1/\alpha`.

    With several loops the norm takes them as one full block, which asks for more than a margin of all loops at once.
    `MarginGoal.of` gives the disk of a gain and a phase margin.
    """

    disk: float
    at: str = "output"

    @classmethod
    def of(cls, gain_db: float, phase_degrees: float, *, at: str = "output", hard: bool = False) -> MarginGoal:
        """The smallest disk that holds this gain margin (dB) and phase margin."""
        factor = 10 ** (_positive("gain_db", gain_db) / 20)
        if not _positive("phase_degrees", phase_degrees) < 180:
            raise InputError("goal: phase_degrees", f"{phase_degrees!r}", "less than 180")
        angle = np.radians(phase_degrees)
        return cls(float(max(2 * (factor - 1) / (factor + 1), 2 * np.tan(angle / 2))), at, hard=hard)

    @property
    def text(self) -> str:
        """See `Goal`."""
        return f"disk margin at the {self.at} >= {self.disk:g}"

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """See `Goal`."""
        into, out = _cut(loop, self.at)
        return loop.channel(into, out, _each(_positive("disk", self.disk), len(into), loop.g.dt), 0.5)


@dataclass(frozen=True)
class OvershootGoal(Goal):
    r"""A proxy of a bound on the overshoot of step responses, in percent: the peak gain from references to outputs is
    at most that of the second-order system with this overshoot,

    .. math:: \|T\|_\infty \le \frac{1}{2 \zeta \sqrt{1 - \zeta^2}}, \qquad
        \text{overshoot} = 100\, e^{-\pi \zeta / \sqrt{1 - \zeta^2}}

    and at most 1 for less than 4.3 %. Loops of higher order may overshoot more: the result has the simulated overshoot.
    """

    percent: float

    @property
    def text(self) -> str:
        """See `Goal`."""
        return f"overshoot {self.percent:g} % by its proxy, peak gain {self.peak:.4g}"

    @property
    def peak(self) -> float:
        """The peak gain that stands for the overshoot."""
        if not _positive("percent", self.percent) < 100:
            raise InputError("goal: percent", f"{self.percent!r}", "less than 100: no oscillator overshoots more")
        log = -np.log(self.percent / 100) / np.pi
        zeta = float(log / np.sqrt(1 + log**2))
        return 1 / (2 * zeta * np.sqrt(1 - zeta**2)) if 0 < zeta < np.sqrt(0.5) else 1.0

    def channel(self, loop: StandardLoop) -> GeneralizedPlant:
        """See `Goal`."""
        into = loop.places("reference", None, True)
        return loop.channel(into, loop.places("output", None, False), _each(1 / self.peak, len(into), loop.g.dt))


GOALS: Mapping[str, type[Goal]] = {
    "tracking": TrackingGoal,
    "sensitivity": SensitivityGoal,
    "gain": GainGoal,
    "rejection": GainGoal,
    "variance": VarianceGoal,
    "margin": MarginGoal,
    "overshoot": OvershootGoal,
}


def goal_in_words(word: str, options: Mapping[str, Any], hard: bool = False) -> Goal:
    """A goal by its word and its numbers, as commands and recipes give it."""
    if word not in GOALS:
        raise InputError(f"goal {word!r}", "unknown", f"one of {', '.join(GOALS)}", did_you_mean(word, list(GOALS)))
    kind = GOALS[word]
    known = [f.name for f in fields(kind) if f.name not in ("hard", "weight")]
    for name in options:
        if name not in known:
            where, hint = f"goal {word!r}: {name!r}", did_you_mean(name, known)
            raise InputError(where, "unknown", f"one of {', '.join(known)}", hint)
    try:
        return kind(hard=hard, **options)
    except TypeError as error:
        missing = str(error).partition("argument")[2].lstrip("s: ")
        raise InputError(f"goal {word!r}", f"{missing or error} missing", f"of {', '.join(known)}") from None


def _positive(name: str, value: Any) -> float:
    number(f"goal: {name}", value, "a positive number", above=0)
    return float(value)


def _cut(loop: StandardLoop, at: str) -> tuple[list[int], list[int]]:
    """Signals between which the sensitivity at the plant's outputs or inputs stands."""
    if at not in ("output", "input"):
        raise InputError("goal: at", f"{at!r}", '"output" or "input"')
    pair = ("reference", "error") if at == "output" else ("disturbance", "total")
    return loop.places(pair[0], None, True), loop.places(pair[1], None, False)


def _each(weight: StateSpaceModel | float, n: int, dt: float) -> StateSpaceModel:
    """One weight on each of n channels, in the plant's time; a continuous one by Tustin's rule."""
    if not isinstance(weight, StateSpaceModel):
        return StateSpaceModel([], [], [], weight * np.eye(n), dt)
    w = bilinear_to_discrete(weight, dt) if dt and not weight.dt else weight
    one: AnyArray = np.eye(n)
    return StateSpaceModel(np.kron(one, w.A), np.kron(one, w.B), np.kron(one, w.C), np.kron(one, w.D), dt)
