r"""Disk margins: how much gain and phase may change in every loop at once before the closed loop is unstable.

Each loop is multiplied by a complex factor of the disk

.. math:: f = \frac{1 + \frac{1 - \sigma}{2} \delta}{1 - \frac{1 + \sigma}{2} \delta}
   = 1 + \frac{\delta}{1 - \frac{1 + \sigma}{2} \delta}, \qquad |\delta| < \alpha

with the skew :math:`\sigma`: 0 for as much increase as decrease of gain, 1 for S, -1 for T based margins. The largest
:math:`\alpha` is :math:`1 / \|S + (\sigma - 1)/2\|_\infty` for one loop, and one over the peak of mu with one complex
scalar per loop for several.

References
----------
Seiler, Packard, Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020), equations 9-17.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from robustlab.budget import Budget, one_thread, search_budget
from robustlab.closing import Closing, closing
from robustlab.errors import InputError, told_as
from robustlab.linear_analysis.frequency import default_grid, frequency_response
from robustlab.mu_analysis.axis.stability import margin_within
from robustlab.mu_analysis.margins.small_gain import replayed_pole, signed, small_gain
from robustlab.mu_analysis.matrix.bounds import mu
from robustlab.mu_analysis.matrix.certificate import singularity
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.mu_analysis.tuning import TUNING
from robustlab.result import Status
from robustlab.shown import Facts, Shown, bracket, number
from robustlab.statespace import StateSpaceModel, as_model, lower_lft
from robustlab.uncertainty.blocks import ComplexScalar, FullBlock, delta_matrix, delta_values
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.realised_delta import realise_delta

__all__ = [
    "PLACES",
    "DiskBounds",
    "DiskMargin",
    "DiskMargins",
    "Place",
    "channel_names",
    "channel_places",
    "closed_around",
    "disk_channels",
    "disk_margin",
    "disk_margin_of",
    "factor_model",
    "gain_and_phase",
]

Place = Literal["input", "output", "both"]
PLACES: tuple[Place, ...] = ("input", "output", "both")


@dataclass(frozen=True, eq=False)
class DiskBounds(Shown):
    """Bounds of a disk margin, and what the lower one guarantees.

    Attributes
    ----------
    lower, upper
        ``lower <= margin <= upper``; ``lower`` is proved over the whole axis.
    gain_margin
        Interval of factors that leave the loop stable, in each loop independently; it belongs to ``lower``.
    phase_margin
        Change of phase in rad that leaves the loop stable, either way, in each loop independently; pi where the disk
        holds every change of phase.
    skew
        sigma.
    """

    lower: float
    upper: float
    gain_margin: tuple[float, float]
    phase_margin: float
    skew: float

    @property
    def value(self) -> float:
        """The disk margin that is proved: ``lower``."""
        return self.lower

    def facts(self) -> Facts:
        """The margin, and the changes of gain and phase that it allows."""
        low, high = self.gain_margin
        with np.errstate(divide="ignore"):
            decibels = [f"{20 * np.log10(factor):.3g}" if factor > 0 else "-inf" for factor in (low, high)]
        phase = f"+-{number(self.phase_margin, 'rad')} ({number(math.degrees(self.phase_margin))} degrees)"
        return [
            ("disk margin", bracket(self.lower, self.upper, ("proved", "attained"))),
            ("gain", f"factors {number(low)} .. {number(high)} ({decibels[0]} .. {decibels[1]} dB)"),
            ("phase", phase),
            ("skew", number(self.skew)),
        ]

    def to_json(self) -> dict[str, Any]:
        """All attributes; models stay models."""
        return {"type": type(self).__name__, **{name: getattr(self, name) for name in self.__dataclass_fields__}}


@dataclass(frozen=True, eq=False)
class DiskMargin(DiskBounds):
    """Margin against disks of one size in some loops at once, with the attributes of `DiskBounds`.

    Attributes
    ----------
    lower, upper
        Stable for all ``|delta| < lower``, not for the ``delta`` below, whose largest modulus is ``upper``. Both inf
        where nothing destabilises.
    frequency
        Critical frequency in rad/s; None where nothing destabilises.
    delta
        Critical delta by the name of the loop.
    factor
        The critical factors f; inf where f is infinite.
    perturbation
        Models of the critical factors: stable (of first order, second at most, per loop) where ``(1 + sigma) |delta| <
        2``. Empty where a factor is infinite, or where only complex numbers at frequency zero are critical.
    pole
        The pole of the loop with these perturbations that lies next to the stability boundary at ``frequency``; None
        where the loop is then ill-posed (``frequency`` inf, or no states), or where no perturbation with real
        coefficients takes the critical values.
    status
        CERTIFIED where ``lower`` is proved and ``pole`` is where it was foretold; TIMEOUT where the time limit ended
        the proof.
    notes
        Remarks for the reader of a report.
    """

    frequency: float | None
    delta: Mapping[str, complex]
    factor: Mapping[str, complex]
    perturbation: Mapping[str, StateSpaceModel]
    pole: complex | None
    status: Status
    notes: tuple[str, ...] = ()

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        notes = [("note", note) for note in self.notes]
        return [*super().facts(), ("critical frequency", number(self.frequency, "rad/s")), *notes]


@dataclass(frozen=True, eq=False)
class DiskMargins(Shown):
    """Disk margins of a loop: one channel at a time, and all at once.

    Attributes
    ----------
    channels
        Margin of each channel with the others unchanged, by name.
    simultaneous
        Margin with all channels changed independently at once.
    at
        ``"input"``, ``"output"`` or ``"both"``: where the factors are.
    loop
        The law that closes the loop, and who says so.
    """

    channels: Mapping[str, DiskMargin]
    simultaneous: DiskMargin
    at: Place
    loop: str = ""

    @property
    def status(self) -> Status:
        """CERTIFIED where all are, else the first that is not."""
        every = [*self.channels.values(), self.simultaneous]
        return next((m.status for m in every if m.status is not Status.CERTIFIED), Status.CERTIFIED)

    def facts(self) -> Facts:
        """The margins of all loops at once and of each, gain and phase of the first."""
        every = {"all at once": self.simultaneous, **self.channels}
        bounds = [(name, bracket(m.lower, m.upper, ("proved", "attained"))) for name, m in every.items()]
        return [("loop", self.loop), ("at", f"the plant's {self.at}"), *bounds, *self.simultaneous.facts()[1:]]

    def to_json(self) -> dict[str, Any]:
        """All attributes."""
        parts = {name: margin.to_json() for name, margin in self.channels.items()}
        together = self.simultaneous.to_json()
        return {
            "type": "DiskMargins",
            "loop": self.loop,
            "at": self.at,
            "channels": parts,
            "simultaneous": together,
            "status": self.status,
        }


@told_as("disk_margin")
def disk_margin(
    plant: Any,
    K: Any = None,
    *,
    at: Place = "output",
    skew: float = 0.0,
    sign: Literal[-1, 1] | None = None,
    time_limit: float | None = None,
    seed: int = 0,
    effort: float = 1.0,
) -> DiskMargins:
    r"""Disk margins of the loop ``y = P u``, ``u = sign K y``, one loop at a time and all loops at once.

    Parameters
    ----------
    plant
        Plant P (p outputs, m inputs), or the whole open loop L, square, where K is left out.
    K
        Controller (m outputs, p inputs), or one whose signals have names that the plant has too.
    at
        Where the factors act: on the plant's outputs, its inputs, or both at once.
    skew
        sigma: 0 balanced, positive where the gain is more likely to rise, negative where it is more likely to fall.
    sign
        -1 for negative feedback, 1 for positive feedback. Left out: what the controller says of itself, as every
        designed one does; negative for one that says nothing.
    time_limit, seed, effort
        For several loops at once, as in `robust_stability`.

    Returns
    -------
    DiskMargins
        One margin per channel by the name of the plant's signal, and the margin of all together.

    Raises
    ------
    InputError
        Sizes, names or sample times that do not fit; a skew that is not finite; a sign that contradicts the controller.
    NoTrustworthyNumber
        The nominal loop is unstable.

    References
    ----------
    Seiler, Packard, Gahinet (2020).

    Examples
    --------
    >>> L = StateSpaceModel([[-1.0]], [[1.0]], [[-2.0]], [[1.0]])  # (s - 1)/(s + 1)
    >>> margin = disk_margin(StateSpaceModel(L.A, L.B, 0.5 * L.C, 0.5 * L.D)).simultaneous
    >>> round(margin.value, 6), [round(g, 6) for g in margin.gain_margin]
    (0.666667, [0.5, 2.0])
    """
    p = as_model(plant, "disk_margin: plant")
    found = closed_around(p, K, sign, "disk_margin")
    loop, names = disk_channels(found.plant, found.K, (0, 0), at, skew, found.sign)
    if len(names) > 1:
        compile_kernels()
    budget = search_budget("disk_margin", TUNING.work, effort, time_limit)
    with one_thread():
        channels = {
            name: disk_margin_of(loop.select([loop.input_names[i]], [loop.output_names[i]]), [name], skew, budget)
            for i, name in enumerate(names)
        }
        if len(names) == 1:
            return DiskMargins(channels, channels[names[0]], at, found.said)
        return DiskMargins(channels, disk_margin_of(loop, names, skew, budget, seed), at, found.said)


def disk_margin_of(M: StateSpaceModel, names: Sequence[str], skew: float, budget: Budget, seed: int = 0) -> DiskMargin:
    """The margin of all channels of M (what the disks see: see `disk_channels`) at once.

    Raises
    ------
    NoTrustworthyNumber
        M is unstable.
    """
    return _one_loop(M, names[0], skew) if len(names) == 1 else _many_loops(M, names, skew, budget, seed)


def closed_around(plant: Any, K: Any, sign: int | None, where: str) -> Closing:
    """How K closes its loop, as `robustlab.closing.closing`, K a model: the identity where it is left out."""
    found = closing(plant, K, sign, where)
    k = StateSpaceModel([], [], [], np.eye(len(found.plant.inputs))) if found.K is None else found.K
    return replace(found, K=as_model(k, f"{where}: K"))


def disk_channels(
    plant: StateSpaceModel, K: StateSpaceModel, delta: tuple[int, int], at: Place, skew: float, sign: Literal[-1, 1]
) -> tuple[StateSpaceModel, tuple[str, ...]]:
    r"""The closed loop as the disks see it, and the names of its channels.

    Parameters
    ----------
    plant
        Plant whose first ``delta[0]`` inputs and ``delta[1]`` outputs are channels of another Delta, which stay first.

    Returns
    -------
    StateSpaceModel
        From (w of Delta, w at the inputs, w at the outputs) to the z of the same; per disk channel ``z = v +
        (1 + sigma)/2 w`` and ``v + w`` goes on in place of the signal v.
    """
    if at not in PLACES:
        raise InputError("disk_margin: at", f"{at!r}", "input, output or both")
    if not abs(skew) <= 1e6:
        raise InputError("disk_margin: skew", f"{skew}", "a number of at most 1e6 either way")
    q, r = delta
    m, p, n = plant.n_inputs - q, plant.n_outputs - r, plant.n_states
    half = (1 + skew) / 2
    # Columns: w of Delta, w at the inputs, w at the outputs, u of the controller.
    unit = np.eye(q + m + p + m)
    w_delta, w_in, w_out, u = np.split(unit, np.cumsum([q, m, p]))
    driven = np.vstack([w_delta, u + w_in])
    through = plant.D @ driven
    rows = [through[:r], u + half * w_in, through[r:] + half * w_out, through[r:] + w_out]
    zero = np.zeros((m, n))
    inputs = [f"w{i}" for i in range(q)] + [f"in{i}" for i in range(m)] + [f"out{i}" for i in range(p)]
    general = StateSpaceModel(
        plant.A,
        plant.B @ driven,
        np.vstack([plant.C[:r], zero, plant.C[r:], plant.C[r:]]),
        np.vstack(rows),
        plant.dt,
        [*inputs, *(f"u{i}" for i in range(m))],
        [*inputs[:0], *(f"z{i}" for i in range(r)), *inputs[q:], *(f"y{i}" for i in range(p))],
    )
    loop = lower_lft(general, signed(K, sign))
    places = channel_places(m, p, at)
    kept = [inputs[q + i] for i in places]
    loop = loop.select([*inputs[:q], *kept], [*(f"z{i}" for i in range(r)), *kept])
    return loop, tuple(channel_names(plant.input_names[q:], plant.output_names[r:], at))


def channel_places(n_inputs: int, n_outputs: int, at: Place) -> range:
    """Which of the inputs and then the outputs of a plant the disks act on."""
    every = n_inputs + n_outputs
    return {"input": range(n_inputs), "output": range(n_inputs, every), "both": range(every)}[at]


def channel_names(inputs: Sequence[str], outputs: Sequence[str], at: Place) -> list[str]:
    """Names of the channels that the disks act on."""
    names, places = [*inputs, *outputs], channel_places(len(inputs), len(outputs), at)
    chosen = [names[i] for i in places]
    if len(set(chosen)) < len(chosen):  # an input and an output of one name
        chosen = [f"{'input' if i < len(inputs) else 'output'} {names[i]}" for i in places]
    return chosen


# --- one loop, many loops --------------------------------------------------------------------------------------------


def _one_loop(M: StateSpaceModel, name: str, skew: float) -> DiskMargin:
    """Exact: the H-infinity norm of ``S + (sigma - 1)/2``."""
    uncertain = UncertainModel(M, [FullBlock(name, 1, 1)])
    test = small_gain(uncertain)
    delta = {name: complex(value[0, 0]) for name, value in test.delta.items()}
    return _result(uncertain, (test.lower, test.upper), test.frequency, delta, test.status, skew)


def _many_loops(M: StateSpaceModel, names: Sequence[str], skew: float, budget: Budget, seed: int) -> DiskMargin:
    uncertain = UncertainModel(M, [ComplexScalar(name) for name in names])
    margin = margin_within(uncertain, budget, seed=seed, accuracy=1e-4)
    upper, frequency, values = margin.upper, margin.frequency, margin.delta
    if margin.pole is not None and margin.pole.imag < 0:  # the same crossing seen at the positive frequency
        values = {name: np.conj(value) for name, value in values.items()}
    if upper > margin.lower * (1 + TUNING.disk_close):
        found = _largest_on_the_axis(uncertain, frequency)
        if found is not None and found[0] < upper:
            upper, frequency, values = found
    delta = {name: complex(value) for name, value in values.items()}
    if frequency is not None:
        frequency = _crossing(uncertain, delta, frequency)
    notes = [budget.remark] if budget.remark else []
    return _result(uncertain, (margin.lower, upper), frequency, delta, margin.status, skew, notes)


def _crossing(uncertain: UncertainModel, delta: Mapping[str, complex], frequency: float) -> float:
    """Where this Delta makes the loop singular: an end of the axis if it does so there, else ``frequency``.

    A loop that is about to become ill-posed has a pole that runs off to infinity, and eigenvalues show another one.
    """
    M = uncertain.delta_channels
    matrix = delta_matrix(uncertain.blocks, delta).astype(complex)
    ends = np.array([0.0, np.pi / M.dt if M.is_discrete else np.inf])
    for omega, response in zip(ends, frequency_response(M, ends), strict=True):
        if singularity(response, matrix) <= TUNING.at_end:
            return float(omega)
    return frequency


def _largest_on_the_axis(
    uncertain: UncertainModel, frequency: float | None
) -> tuple[float, float, Mapping[str, Any]] | None:
    """The smallest Delta that mu finds at frequencies around the model's dynamics, and closer at the best of them."""
    M, blocks = uncertain.delta_channels, uncertain.blocks
    grid = default_grid(M, 40) if M.n_states else np.zeros(1)
    omega = np.unique(np.append(grid, [0.0, *([frequency] if frequency is not None and frequency < np.inf else [])]))
    best: tuple[float, float, Mapping[str, Any]] | None = None
    for _ in range(4):
        bounds = mu(frequency_response(M, omega), blocks)
        k = int(np.argmax(bounds.lower))
        size = float(np.asarray(bounds.lower)[k])
        if size > 0 and (best is None or 1 / size < best[0]):
            best = 1 / size, float(omega[k]), delta_values(blocks, bounds.delta[k])
        omega = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], 9)
    return best


def _result(
    uncertain: UncertainModel,
    bounds: tuple[float, float],
    frequency: float | None,
    delta: Mapping[str, complex],
    status: Status,
    skew: float,
    remarks: Sequence[str] = (),
) -> DiskMargin:
    low, high, phase = gain_and_phase(bounds[0], skew)
    factor = {name: _factor(d, skew) for name, d in delta.items()}
    perturbation, pole, notes = {}, None, list(remarks)
    if frequency is not None:
        loop = frequency_response(uncertain.delta_channels, [frequency])[0]
        seen = singularity(loop, delta_matrix(uncertain.blocks, delta).astype(complex)) <= TUNING.disk_singular
        try:
            pole, on_axis = replayed_pole(uncertain, delta, frequency)
            made = realise_delta(uncertain.blocks, delta, frequency, uncertain.dt)
        except InputError:
            on_axis = True
            notes.append(
                f"the critical deltas are complex at {frequency:.3g} rad/s, where systems with real coefficients are "
                "real: no such system takes them there"
            )
        else:
            models = {name: factor_model(as_model(made[name]), skew) for name in delta}
            perturbation = {name: model for name, model in models.items() if model is not None}
            if len(perturbation) < len(models):
                perturbation = {}
                notes.append("a critical factor is infinite: no model of it is given")
        if status is Status.CERTIFIED and not (seen and on_axis):
            status = Status.INACCURATE
    return DiskMargin(
        bounds[0], bounds[1], (low, high), phase, skew, frequency, dict(delta), factor, perturbation, pole, status,
        tuple(notes),
    )  # fmt: skip


def _factor(delta: complex, skew: float) -> complex:
    below = 1 - (1 + skew) / 2 * delta
    return (1 + (1 - skew) / 2 * delta) / below if abs(below) > 1e-12 else complex(np.inf)


def factor_model(delta: StateSpaceModel, skew: float) -> StateSpaceModel | None:
    """``f = 1 + delta / (1 - (1 + sigma)/2 delta)`` as a model; None where it is not proper."""
    half = (1 + skew) / 2
    below = 1 - half * float(delta.D[0, 0])
    if abs(below) < 1e-12:
        return None
    # z = u + half w with w = delta z, and f u = u + w.
    z_x, z_u = half * delta.C / below, 1 / below
    return StateSpaceModel(delta.A + delta.B @ z_x, delta.B * z_u, delta.C + delta.D @ z_x, 1 + delta.D * z_u, delta.dt)


def gain_and_phase(alpha: float, skew: float = 0.0) -> tuple[float, float, float]:
    r"""Gain margin interval and phase margin in rad of the disk of size ``alpha``.

    .. math:: \gamma_{min} = \frac{2 - \alpha (1 - \sigma)}{2 + \alpha (1 + \sigma)}, \qquad
       \gamma_{max} = \frac{2 + \alpha (1 - \sigma)}{2 - \alpha (1 + \sigma)}, \qquad
       \cos \phi = \frac{4 - \alpha^2 (1 + \sigma^2)}{4 + \alpha^2 (1 - \sigma^2)}

    An end whose denominator is not positive is infinite; phi is pi where the disk holds the whole unit circle.

    Examples
    --------
    >>> [round(x, 4) for x in gain_and_phase(0.4581)]
    [0.6273, 1.5942, 0.4503]
    """
    if not np.isfinite(alpha):
        return -np.inf, np.inf, np.pi
    low, high = 2 + alpha * (1 + skew), 2 - alpha * (1 + skew)
    gamma_min = (2 - alpha * (1 - skew)) / low if low > 0 else -np.inf
    gamma_max = (2 + alpha * (1 - skew)) / high if high > 0 else np.inf
    # |delta| of the factor e^(j phi) grows with phi up to 2/|sigma| at pi.
    if alpha * abs(skew) >= 2:
        return gamma_min, gamma_max, float(np.pi)
    cosine = (4 - alpha**2 * (1 + skew**2)) / (4 + alpha**2 * (1 - skew**2))
    return gamma_min, gamma_max, float(np.arccos(np.clip(cosine, -1.0, 1.0)))
