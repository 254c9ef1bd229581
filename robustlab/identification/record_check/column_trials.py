r"""Which column is which signal, by trying the model: what it makes of the columns taken as inputs is what others show.

Every assignment of columns to signals that names and units leave open is simulated, in a few windows over the record
with one free initial state each, and judged by the share of the outputs' movement that the model leaves,

.. math:: e_j = \frac{\sum (y_j - \hat y_j)^2}{\sum (y_j - \bar y_j)^2}, \qquad e = \Big( \prod_j e_j \Big)^{1 / n_y} .

The model is as it is, its gains included: a column in another unit than the model's, that does not say so, is no match.
A signal is sure where every assignment that gives it another column leaves far more.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.identification.response.response import Response
from robustlab.record import Record
from robustlab.statespace import StateSpaceModel
from robustlab.units import factor_between

WINDOWS = 4  # over the record
LONGEST = 1000  # samples of a window
SEEN = 200  # of them that are compared
FEWEST = 40  # samples of a record that a trial takes
MOST = 5000  # assignments that are tried
GROWS = 3.0  # exponent of what an unstable model may grow by in a window
LEAST = 1e-6  # of what is left: rounding
FOLLOWS = 0.5  # share left, above which a model is not said to follow
CLEAR = 2.0  # times what is left by the best assignment: another one that leaves less is a rival


@dataclass(frozen=True)
class Trial:
    """The assignment that leaves least, and what another column would leave."""

    columns: Mapping[str, str]  # signal -> column
    left: float  # share of the outputs' movement that is left
    shares: Mapping[str, float]  # output -> its own share
    others: Mapping[str, tuple[str, float]]  # signal -> the next likely column ("" for none), and what is left with it

    @property
    def follows(self) -> bool:
        """Whether the model reproduces the columns so at all."""
        return self.left <= FOLLOWS

    def is_sure(self, signal: str) -> bool:
        """Whether the model follows this column, and with any other column for this signal leaves far more."""
        if not self.follows or self.shares.get(signal, 0.0) > FOLLOWS:
            return False
        return self.others.get(signal, ("", np.inf))[1] >= CLEAR * self.left


def best_assignment(model: StateSpaceModel, record: Record, choices: Mapping[str, Sequence[str]]) -> Trial | None:
    """The columns that the model's signals are, by the smallest error of its simulation.

    ``choices``: signal -> the columns that it may be; an output without one is left out.
    Returns None where a trial tells nothing: too many assignments, a clock that is not uniform or not the model's, a
    short record, a model that is unstable over a window, nothing that moves.
    """
    if record.n < FEWEST or not record.is_uniform or model.n_states == 0:
        return None
    if model.is_discrete and abs(model.dt - record.dt) > 1e-3 * record.dt:
        return None
    length = min(LONGEST, record.n // WINDOWS)
    rate = np.log(max(np.abs(model.poles()).max(), 1e-9)) / model.dt if model.is_discrete else model.poles().real.max()
    assignments = list(_limited(_assignments(model, choices)))
    if rate * length * record.dt > GROWS or not 1 <= len(assignments) <= MOST:
        return None
    most = max(len(a) for a in assignments)
    try:
        trials = _Trials(model, record, choices, length)
        left = [(float(np.exp(np.log(trials.left(a)).mean())), a) for a in assignments if len(a) == most]
    except (InputError, NoTrustworthyNumber):
        return None
    best, columns = min(left, key=lambda found: found[0])
    if not np.isfinite(best):
        return None
    others: dict[str, tuple[str, float]] = {}
    for signal, column in columns.items():
        rivals = [(share, a.get(signal, "")) for share, a in left if a.get(signal, "") != column]
        if rivals:
            share, other = min(rivals)
            others[signal] = other, share
    shown = [s for s in model.output_names if s in columns]
    shares = dict(zip(shown, trials.left(columns).tolist(), strict=True))
    return Trial(columns, best, shares, others)


def _limited(found: Iterator[dict[str, str]]) -> Iterator[dict[str, str]]:
    for k, assignment in enumerate(found):
        yield assignment
        if k == MOST:
            return


def _assignments(model: StateSpaceModel, choices: Mapping[str, Sequence[str]]) -> Iterator[dict[str, str]]:
    """Each input with a column, and as many outputs as there are columns for, none twice."""
    inputs = set(model.input_names)
    signals = [*model.input_names, *model.output_names]
    columns = {c for given in choices.values() for c in given}
    spare = len(columns) - model.n_inputs  # that outputs can take
    leave = max(0, sum(bool(choices.get(s)) for s in model.output_names) - spare)

    def extended(k: int, taken: dict[str, str], left_out: int) -> Iterator[dict[str, str]]:
        if k == len(signals):
            if len(taken) > len(inputs):
                yield dict(taken)
            return
        signal = signals[k]
        for column in choices.get(signal, ()):
            if column not in taken.values():
                yield from extended(k + 1, {**taken, signal: column}, left_out)
        if signal not in inputs:
            given = bool(choices.get(signal))
            if left_out + given <= leave:
                yield from extended(k + 1, taken, left_out + given)

    return extended(0, {}, 0)


class _Trials:
    """Windows of the columns, and what the model makes of each column as each input."""

    def __init__(
        self, model: StateSpaceModel, record: Record, choices: Mapping[str, Sequence[str]], length: int
    ) -> None:
        self.inputs, self.outputs = model.input_names, model.output_names
        starts = np.unique(np.linspace(0, record.n - length, WINDOWS).astype(int)).tolist()
        rows = np.unique(np.linspace(0, length - 1, min(SEEN, length)).astype(int))
        clock = record.dt * np.arange(length)
        response = Response(model, model.outputs, ())
        self.free = response.free_response(clock)[rows]
        at_rest, point = np.zeros(model.n_states), model.operating_point
        steady = np.zeros(model.n_inputs) if point is None else np.asarray(point.u)
        rest = dict(zip(self.inputs, np.broadcast_to(steady[:, None], (model.n_inputs, length)), strict=True))
        self.still = response.simulate(clock, rest, at_rest)[rows]
        units = {s.name: s.unit for s in (*model.inputs, *model.outputs)}
        columns = {**record.inputs, **record.outputs}
        self.made: dict[tuple[str, str], Array] = {}
        self.seen: dict[tuple[str, str], Array] = {}
        for signal, given in choices.items():
            for name in given:
                unit = record.unit(name)
                factor = (factor_between(unit, units[signal]) if unit and units[signal] else None) or 1.0
                parts = [factor * columns[name][a : a + length] for a in starts]
                if signal in self.inputs:
                    runs = [response.simulate(clock, {**rest, signal: part}, at_rest)[rows] for part in parts]
                    self.made[signal, name] = np.stack(runs) - self.still
                else:
                    self.seen[signal, name] = np.stack([part[rows] for part in parts])
        self.bases: dict[tuple[tuple[str, str], ...], Array] = {}

    def left(self, assignment: Mapping[str, str]) -> Array:
        """Share of each output's movement that this assignment leaves; infinite where an output does not move."""
        shown = tuple((s, assignment[s]) for s in self.outputs if s in assignment)
        rows = [self.outputs.index(s) for s, _ in shown]
        y = np.stack([self.seen[pair] for pair in shown], axis=2)  # (windows, n, outputs)
        moved = y - y.mean(axis=1, keepdims=True)
        size = np.sqrt((moved**2).mean(axis=(0, 1)))
        if not size.all():
            return np.full(len(rows), np.inf)
        made = sum(self.made[s, assignment[s]][:, :, rows] for s in self.inputs) + self.still[:, rows]
        if shown not in self.bases:
            free = (self.free[:, rows] / size[:, None]).reshape(-1, self.free.shape[2])
            scale = np.linalg.norm(free, axis=0)
            left, sigma, _ = np.linalg.svd(free[:, scale > 0] / scale[scale > 0], full_matrices=False)
            self.bases[shown] = left[:, sigma > 1e-10 * sigma.max(initial=0.0)]
        basis = self.bases[shown]
        error = ((y - made) / size).reshape(len(y), -1)
        error = (error - (error @ basis) @ basis.T).reshape(y.shape)
        return np.maximum((error**2).mean(axis=(0, 1)), LEAST)
