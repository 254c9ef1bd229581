r"""Where an error could come from: what would have to be added at an input or a joint for the model to be right.

An output error grows and is carried on by the model's own dynamics; where it comes from is plainer at the place where
something pushes. The record is cut into short pieces, and in each a constant :math:`d_j` at one or two places is fitted
together with the initial state,

.. math:: y(t) \approx y_u(t) + S(t) x_0 + \sum_j \Big( \int_0^t C e^{A s} b_j ds + D_j \Big) d_j,

so that the model with the addition reproduces the piece best. Sorted by speed, d shows a friction that the model lacks
as a friction curve, with its sign turned round.

An output counts by what its sensor can tell: its error is divided by the noise of the sensor, or by what the addition
leaves of it where that is more, so that an output whose error is of another kind does not pull at the others. What an
addition is worth is the sum over the outputs of the logarithms of the squared errors that it leaves, which are no less
than the noise: one that is to be told halves them at least, and two places are told where they halve what one leaves.
Dry friction of a motor, for example, makes the current larger and the speed smaller, a voltage that is missing makes
both smaller: an addition to the input leaves the current of a motor that rubs, a torque at its shaft does not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.ports.port_model import linear_plant_of, port_model
from robustlab.errors import InputError
from robustlab.identification.comparison.localisation import REST, Motion
from robustlab.identification.response.response import Response, Stretch
from robustlab.result import Evidence
from robustlab.shown import Each
from robustlab.statespace import StateSpaceModel

# Share of the squared error that an addition has to take away to be told, and two places of what one leaves.
EXPLAINS = 0.5
# Mean additions that are less than this many standard errors from zero are not told.
SURE = 3.0
FEWEST_PIECES = 8  # that pieces longer than asked for leave in the record
GROWS = 3.0  # exponent of what an unstable model grows by within such a piece
MOST_PLACES = 4  # for pairs of places to be tried
MOST_TOLD = 3  # that explain the error each alone
TIE = 0.3  # difference of their worth up to which two additions are as good
ROUNDS = 3  # of weighing the outputs by what is left of them
# Of what a place does to the outputs, the share that no initial state does, to be told from one at all.
RANK_TOLERANCE = 1e-9
LEAST_NOISE = 1e-7  # of a sensor, as a share of its range


@dataclass(frozen=True)
class Addition(Evidence):
    """Constant addition at one place that reproduces each piece of the record best; arrays have shape (n_pieces,)."""

    place: str  # ``input u``, or ``torque at omega``
    unit: str  # of the addition
    seconds: float  # length of a piece in s
    time: Array  # middle of each piece in s
    speed: Array | None  # mean measured speed over each piece, or None where there is no speed
    # value, std: the addition d in its unit, and its standard deviation if the error left were white; NaN in pieces
    # where the outputs cannot tell d from the initial state
    value: Array
    std: Array
    # forward, backward: means of d over the pieces that move throughout in one direction; NaN where there are none
    forward: float
    backward: float
    # forward_std, backward_std: their standard errors, by the scatter of the pieces or by ``std`` if that says more
    forward_std: float
    backward_std: float
    # error, left, noise: output -> rms error of all pieces, each with its own initial state, without and with the
    # addition, and the noise of the sensor; in units of the output
    error: Mapping[str, float]
    left: Mapping[str, float]
    noise: Mapping[str, float]
    # output -> a constant that its sensor is off by, which was fitted beside the addition; 0 where that brought little
    offsets: Mapping[str, float]
    speed_source: str = ""  # the speed it is sorted by, as in `robustlab.identification.comparison.localisation.Motion`
    together: tuple[str, ...] = field(default=())  # the other places of the same fit

    quantities: ClassVar[Mapping[str, Any]] = {
        "seconds": "s",
        **dict.fromkeys(("forward", "backward", "forward_std", "backward_std"), "*"),
        "shares": Each("outputs", float),
        "explained_share": float,
    }

    @property
    def shares(self) -> dict[str, float]:
        """Output -> share of its squared error that the addition takes away; negative where it makes it larger."""
        return {k: 1.0 - (self.left[k] / e) ** 2 if e else 0.0 for k, e in self.error.items()}

    @property
    def explains(self) -> frozenset[str]:
        """The outputs half of whose squared error it takes away, where that is more than their sensor's noise."""
        return frozenset(k for k, share in self.shares.items() if share >= EXPLAINS and self.error[k] > self.noise[k])

    @property
    def explained_share(self) -> float:
        """Share of the squared error of all outputs that it takes away, 0..1, each in multiples of its noise."""
        before, after = (sum((x[k] / n) ** 2 for k, n in self.noise.items()) for x in (self.error, self.left))
        return max(0.0, 1.0 - after / before) if before else 0.0

    @property
    def worth(self) -> float:
        """Sum over the outputs of the logarithms of their squared errors with the addition over those without."""
        ratios = [max(self.left[k], n) / max(self.error[k], n) for k, n in self.noise.items()]
        return float(2.0 * np.log(np.maximum(ratios, 1e-300)).sum())

    @property
    def mean(self) -> tuple[float, float]:
        """Mean of d over all pieces, whichever way they move, and its standard error; NaN where nothing is known."""
        return _mean(self.value, self.std, np.ones(len(self.value), dtype=bool))

    @property
    def lasts(self) -> bool:
        """Whether a mean of d, over all pieces or those of one direction, is sure to differ from zero."""
        ways = self.mean, (self.forward, self.forward_std), (self.backward, self.backward_std)
        return any(abs(mean) > SURE * std for mean, std in ways if np.isfinite(std))

    def to_json(self) -> dict[str, Any]:
        """All fields and the shares."""
        return {**vars(self), "shares": self.shares, "explained_share": self.explained_share}


def located(found: Mapping[str, Addition]) -> tuple[str, ...]:
    """Keys of the additions to be told: two places together where they halve what any one leaves; else those at one
    place, the best first, others that are nearly as good, and those that explain further outputs.

    Empty where none takes away half of the error.
    """
    least = float(np.log(1.0 - EXPLAINS))
    worth = {key: d.worth for key, d in found.items()}
    alone = {key: worth[key] for key, d in found.items() if not d.together}
    best = min(alone.values(), default=0.0)
    pair = [key for key, d in found.items() if d.together]
    if pair and worth[pair[0]] <= min(best, 0.0) + least:
        return tuple(pair)
    if best > least:
        return ()
    # Of two that the record does not tell apart the input comes first.
    order = {key: (alone[key] > best + TIE, not found[key].place.startswith("input "), alone[key]) for key in alone}
    told: list[str] = []
    covered: frozenset[str] = frozenset()
    for key in sorted(alone, key=lambda key: order[key]):
        more = found[key].explains - covered
        if more or (found[key].explains and alone[key] <= best - least and len(told) < MOST_TOLD):
            told.append(key)
            covered |= more
    return tuple(told)


class Place(NamedTuple):
    """Where something may be added: an input, or a joint of the plant."""

    name: str  # of the input or of the port
    text: str
    unit: str
    column: str  # of the model with all places as inputs


def additions_that_tell(
    plant: Any, response: Response, whole: Stretch, length: int, motion: Motion
) -> dict[str, Addition]:
    """`additions` in pieces of ``length`` samples, or in as long ones as it takes for a lasting one to be told.

    What a constant push does within a piece grows with the square of its length and more, the noise does not: one that
    the noise hides in short pieces is plain in longer ones. Longer pieces mix up what changes within them, so they are
    tried only where no shorter ones tell anything, and believed only where what is told has a mean that is sure.
    """
    first = additions(plant, response, whole, length, motion)
    if not first or located(first) or not whole.is_uniform:
        return first
    rate = float(np.real(np.linalg.eigvals(response.model.A)).max(initial=0.0)) if not response.model.is_discrete else 0
    step = float(whole.t[-1] - whole.t[0]) / (len(whole.t) - 1)
    longest = len(whole.t) // FEWEST_PIECES
    while 2 * length <= longest and rate * 2 * length * step <= GROWS:
        length *= 2
        longer = additions(plant, response, whole, length, motion)
        if (told := located(longer)) and any(longer[key].lasts for key in told):
            return longer
    return first


def additions(plant: Any, response: Response, whole: Stretch, length: int, motion: Motion) -> dict[str, Addition]:
    """An addition at each input and each joint that differs from them, in every piece of ``length`` samples, and at the
    two places that together leave least; a shorter rest is left out.

    Keys are names of inputs and texts of joints (``torque at omega``); the two of a pair have `Addition.together`.
    """
    model, places = _with_joints(plant, response)
    fit = _Fit(model, response, whole, length, places)
    distinct = fit.apart(places)
    asked = [p for p in places if p in distinct or p.name in whole.u]
    alone = {_key(p): fit.additions([p], motion)[0] for p in asked}
    if alone:  # a sensor that is off by a constant is no reason for a second place
        fit.start = np.array([min(alone.values(), key=lambda d: d.worth).offsets[name] for name in fit.outputs])
    if not 2 <= len(distinct) <= MOST_PLACES:
        return alone
    pairs = [fit.additions(list(pair), motion) for pair in combinations(distinct, 2)]
    best = min(pairs, key=lambda pair: pair[0].worth)
    return {**alone, **{f"{found.place}, together": found for found in best}}


def _key(place: Place) -> str:
    return place.name if place.text.startswith("input ") else place.text


def _with_joints(plant: Any, response: Response) -> tuple[StateSpaceModel, list[Place]]:
    """The model with a further input for each joint, and all places; joints of linear plants and models alone."""
    model = response.model
    places = [Place(s.name, f"input {s.name}", s.unit, s.name) for s in model.inputs]
    if not isinstance(plant, (LinearPlant, StateSpaceModel)) or model.is_discrete:
        return model, places
    try:
        ports = port_model(linear_plant_of(plant)).ports
    except (InputError, np.linalg.LinAlgError):
        return model, places
    joints = [p for p in ports.values() if p.kind == "joint" and p.force.shape == (model.n_states,)]
    words = {"rad/s": "torque", "m/s": "force"}
    for port in joints:
        text = f"{words[port.speed_unit]} at {port.name}"
        places.append(Place(port.name, text, port.unit, text))
    wide = StateSpaceModel(
        model.A, np.column_stack([model.B, *(p.force for p in joints)]), model.C,
        np.hstack([model.D, np.zeros((model.n_outputs, len(joints)))]), model.dt,
        [*model.inputs, *((p.column, p.unit) for p in places[model.n_inputs :])], model.outputs, model.states,
    )  # fmt: skip
    return wide, places


class _Fit:
    """The pieces of a record, and what a unit of each initial state and of each place does to them."""

    def __init__(
        self, model: StateSpaceModel, response: Response, whole: Stretch, length: int, places: Sequence[Place]
    ) -> None:
        self.whole, self.outputs, self.length = whole, response.output_names, length
        self.edges = np.arange(0, len(whole.t) + 1, length)
        self.noise = sensor_noise(whole.y)
        self.start = np.zeros(whole.y.shape[1])  # constants that the sensors are off by
        wide = Response(model, response.outputs, ())
        self.cuts = [whole.cut(a, b) for a, b in pairwise(self.edges.tolist())]
        # The responses are the same in all pieces where the clock is uniform.
        clocks = [piece.t for piece in self.cuts[:1]] if whole.is_uniform else [piece.t for piece in self.cuts]
        self.free = [wide.free_response(t) for t in clocks]
        self.held = {p.column: [wide.step_response(p.column, t) for t in clocks] for p in places}
        at_rest = np.zeros(response.n_states)
        self.errors = [piece.y - response.simulate(piece.t, piece.u, at_rest) for piece in self.cuts]

    def apart(self, places: Sequence[Place]) -> list[Place]:
        """The places that differ from those before: a force beside an input that is that force is left out."""
        found: list[Place] = []
        for place in places:
            if not self.free:
                return list(places)
            rest = [self.held[other.column][0] for other in found]
            if _rank(self.held[place.column][0], rest, 1.0 / self.noise):
                found.append(place)
        return found

    def additions(self, places: Sequence[Place], motion: Motion) -> list[Addition]:
        """Those at these places, fitted together."""
        without, fitted, offsets = self._settled([], 0 * self.start), *self._with_offsets(places)
        said = [
            dict(zip(self.outputs, values.tolist(), strict=True))
            for values in (without.rms, fitted.rms, self.noise, offsets)
        ]
        made = []
        for j, place in enumerate(places):
            others = tuple(p.text for p in places if p is not place)
            made.append(sorted_addition(
                self.whole.t, self.edges, fitted.value[:, j], fitted.std[:, j], said, motion, place.text, place.unit,
                others,
            ))  # fmt: skip
        return made

    def _with_offsets(self, places: Sequence[Place]) -> tuple[_Fitted, Array]:
        """The additions, and the constants that sensors are off by, each where it halves what is left of its output."""
        plain = self._settled(places, self.start)
        offsets = self.start
        for _ in range(ROUNDS):
            tried = self._settled(places, offsets)
            offsets = offsets + tried.mean
        tried = self._settled(places, offsets)
        gained = np.maximum(tried.rms, self.noise) ** 2 <= (1 - EXPLAINS) * np.maximum(plain.rms, self.noise) ** 2
        if not gained.any():
            return plain, self.start
        kept = np.where(gained, offsets, self.start)
        return self._settled(places, kept), kept

    def _settled(self, places: Sequence[Place], offsets: Array) -> _Fitted:
        """Additions of all pieces, the outputs weighed by what is left of them."""
        fitted = self._fitted(places, 1.0 / self.noise, offsets)
        for _ in range(ROUNDS - 1):
            fitted = self._fitted(places, 1.0 / np.maximum(self.noise, fitted.rms), offsets)
        return fitted

    def _fitted(self, places: Sequence[Place], weight: Array, offsets: Array) -> _Fitted:
        """Additions of all pieces for given weights of the outputs, and what they leave."""
        k, n_y = len(self.cuts), len(self.outputs)
        value, std = np.full((k, len(places)), np.nan), np.full((k, len(places)), np.nan)
        squares, total, samples = np.zeros(n_y), np.zeros(n_y), 0
        solved = None
        for i, error in enumerate(self.errors):
            if solved is None or len(self.free) > 1:
                at = min(i, len(self.free) - 1)
                solved = _Solved.of(self.free[at], [self.held[p.column][at] for p in places], weight)
            d, spread, left = solved.fit((error - offsets) * weight)
            if solved.told:
                value[i], std[i] = d, spread
            squares += (left.reshape(-1, n_y) ** 2).sum(axis=0) / weight**2
            total += left.reshape(-1, n_y).sum(axis=0) / weight
            samples += len(error)
        n = max(samples, 1)
        return _Fitted(value, std, np.sqrt(squares / n), total / n)


class _Fitted(NamedTuple):
    value: Array
    std: Array
    rms: Array  # of the error that is left, by output
    mean: Array


class _Solved(NamedTuple):
    """Orthogonal bases of what initial states do, and of what the places do beyond that."""

    states: Array
    own: Array  # (rows, places), orthonormal
    back: Array  # (places, places): from coordinates in ``own`` to additions
    told: bool

    @classmethod
    def of(cls, free: Array, held: Sequence[Array], weight: Array) -> _Solved:
        rows, n_y, n_x = free.shape
        states = _basis((free * weight[:, None]).reshape(rows * n_y, n_x))
        if not held:
            return cls(states, np.zeros((len(states), 0)), np.zeros((0, 0)), told=False)
        columns = np.column_stack([(h[:, :, 0] * weight).ravel() for h in held])
        size = np.linalg.norm(columns, axis=0)
        size[size == 0] = 1.0
        rest = columns / size - states @ (states.T @ (columns / size))
        own, sigma, right = np.linalg.svd(rest, full_matrices=False)
        told = bool(sigma[-1] > RANK_TOLERANCE)
        if not told:
            return cls(states, own[:, :0], np.zeros((len(held), 0)), told)
        return cls(states, own, (right.T / sigma) / size[:, None], told)

    def fit(self, error: Array) -> tuple[Array, Array, Array]:
        """Additions, their standard deviations for white errors, and the error that is left, (rows,)."""
        row = error.ravel()
        alone = row - self.states @ (self.states.T @ row)
        at = self.own.T @ alone
        left = alone - self.own @ at
        spare = max(1, len(row) - self.states.shape[1] - len(at))
        spread = np.sqrt(float(left @ left) / spare * (self.back**2).sum(axis=1))
        return self.back @ at, spread, left


def _basis(columns: Array) -> Array:
    """An orthonormal basis of what the columns span."""
    size = np.abs(columns).max(axis=0, initial=0.0)
    size[size == 0] = 1.0
    left, sigma, _ = np.linalg.svd(columns / size, full_matrices=False)
    return left[:, sigma > RANK_TOLERANCE * max(sigma.max(initial=0.0), 1e-300)]


def _rank(column: Array, others: Sequence[Array], weight: Array) -> bool:
    """Whether a response differs from those of other places by more than a thousandth of itself."""
    one = (column[:, :, 0] * weight).ravel()
    if not others:
        return True
    one = one / max(np.abs(one).max(initial=0.0), 1e-300)
    basis = _basis(np.column_stack([(h[:, :, 0] * weight).ravel() for h in others]))
    return bool(np.linalg.norm(one - basis @ (basis.T @ one)) > 1e-3 * np.linalg.norm(one))


def sensor_noise(y: Array) -> Array:
    r"""Standard deviation of each sensor's noise, (n_y,): by third differences, which take away what moves smoothly.

    .. math:: \mathrm{var}(\Delta^3 y) = 20\, \sigma^2

    for white noise; the median, so that steps do not count. A sensor in steps has at least that of its rounding.
    """
    spread, level = np.ptp(y, axis=0), np.abs(y).max(axis=0, initial=0.0)
    spread = np.where(spread > 1e-300, spread, np.where(level > 1e-300, level, 1.0))  # one that stands tells little
    if len(y) < 8:
        return LEAST_NOISE * spread
    size = np.median(np.abs(np.diff(y, 3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0)
    rounding = np.array([_step(column, s) for column, s in zip(y.T, spread, strict=True)]) / np.sqrt(12.0)
    return np.maximum.reduce([size, rounding, LEAST_NOISE * spread])


def _step(y: Array, spread: float) -> float:
    """The step in which a sensor counts; 0 where it does not."""
    steps = np.abs(np.diff(y))
    moved = steps[steps > 1e-9 * spread]
    if not len(moved) or len(moved) > 0.98 * len(steps):
        return 0.0
    small = moved[moved < 30 * moved.min()] / moved.min()
    return float(moved.min()) if (np.abs(small - np.round(small)) < 0.1).mean() > 0.95 else 0.0


def sorted_addition(
    t: Array,
    edges: NDArray[np.int_],
    value: Array,
    std: Array,
    errors: Sequence[Mapping[str, float]],
    motion: Motion,
    place: str,
    unit: str,
    together: tuple[str, ...] = (),
) -> Addition:
    """Additions in pieces between ``edges``, all equally long, sorted by the speed of a motion.

    ``errors``: output -> rms without and with the addition, noise, and offset.
    """
    error, left, noise, offsets = errors
    length = int(edges[1] - edges[0]) if len(edges) > 1 else 0
    middle = 0.5 * (t[edges[:-1]] + t[edges[1:] - 1])
    seconds = length * float(t[-1] - t[0]) / (len(t) - 1)
    ends = [(np.nan, np.nan)] * 2
    speed = None
    if motion.speed is not None and length:
        pieces = motion.speed[: edges[-1]].reshape(-1, length)
        rest = REST * float(np.abs(motion.speed).max())
        ends = [_mean(value, std, side) for side in (pieces.min(axis=1) > rest, pieces.max(axis=1) < -rest)]
        speed = pieces.mean(axis=1)
    (forward, forward_std), (backward, backward_std) = ends
    return Addition(
        place, unit, seconds, middle, speed, value, std, forward, backward, forward_std, backward_std,
        error, left, noise, offsets,
        motion.speed_source if speed is not None else "", together,
    )  # fmt: skip


def _mean(values: Array, std: Array, chosen: NDArray[np.bool_]) -> tuple[float, float]:
    """Mean of the known values and its standard error."""
    told = chosen & np.isfinite(values)
    known, n = values[told], int(told.sum())
    if not n:
        return np.nan, np.nan
    scatter = float(known.std(ddof=1)) / np.sqrt(n) if n > 1 else np.inf
    return float(known.mean()), max(scatter, float(np.sqrt((std[told] ** 2).sum())) / n)
