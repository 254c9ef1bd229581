r"""An uncertain continuous plant behind sampler, computation delay and hold, as an uncertain discrete plant.

A member's discretisation is no LFT of its Delta, and the LFT's discretisation holds no member: Delta acts between the
samples too. Therefore the signals of Delta are carried over whole periods (lifted): on every interval of constant
control they are Legendre polynomials of degree below m plus a rest.

====================  ==================================================================================================
real parameter        the same real number acts on every coefficient: a repeated real block; the rests of all of them,
                      multiplied by the same numbers, are covered by one full block
dynamic block         a contraction of whole signals: one full block on coefficients and rest together. It covers
                      every linear Delta of that norm whose action repeats from period to period
performance           disturbances and performance over a period: coefficients and rest together
====================  ==================================================================================================

What a rest :math:`w_0` does to the state and the coefficients has finite rank and is exact; what it does to other rests
in the same interval is covered by its norm. For weights :math:`\theta` of sum one

.. math:: |z_{0,i}|^2 = \Big| R_i v + \sum_j H_{ij} w_{0,j} \Big|^2 \le
   \frac{|R_i v|^2}{\theta_{i0}} + \sum_j \frac{\|H_{ij}\|^2}{\theta_{ij}} |w_{0,j}|^2

so that a full block sees the rows of the right side. All of it is sound for every m; larger m is tighter, the error of
the cover falls like :math:`(\omega T)^{2 m}`.

References
----------
Dullerud, Glover, "Robust stabilization of sampled-data systems to structured LTI perturbations", IEEE TAC 38 (1993);
Sivashankar, Khargonekar, "Robust stability and performance analysis of sampled-data systems", IEEE TAC 38 (1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.sampled.held_intervals import ChannelGroup, held_interval, thin_rows
from robustlab.synthesis.sampled.lifting import HeldControls
from robustlab.synthesis.sampled.tuning import TUNING
from robustlab.uncertainty.blocks import Block, FullBlock, block_slices
from robustlab.uncertainty.lft import UncertainModel

REST = "rest of the real blocks"


@dataclass(frozen=True, eq=False)
class SampledUncertainPlant:
    """The uncertain discrete plant over whole periods."""

    # From [w of the blocks; disturbances; u] to [z of the blocks; performance; y], discrete. Real blocks keep their
    # names, with more repetitions; one more block covers what they do beyond the polynomials.
    uncertain: UncertainModel
    degree: int  # m, the number of polynomials on each interval
    # Names of the disturbances that are taken as constant over a period, because they reach the sampler directly.
    held: tuple[str, ...]
    widened: tuple[str, ...]  # names of blocks that a larger one covers: repeated complex scalars became full
    # Gain from the loop to the rests of the real blocks and back, for Delta of norm one: what the cover may add to
    # the loop.
    looseness: float


def sample_uncertain_plant(
    plant: GeneralizedPlant, dt: float, degree: int, delay: float, size: float = 1.0
) -> SampledUncertainPlant:
    """The plant with its controls held from ``k dt + delay`` on.

    ``plant``: continuous generalised plant with its blocks; the channels of Delta come first.
    ``dt``: sample time in s.
    ``degree``: number of polynomials, at least one.
    ``delay``: time in s from the sample to the change of the control, of any number of periods.
    ``size``: norm of Delta for which the cover of the rests is tightest; it holds for every norm.
    Raises InputError: a dynamic block that reaches the sampler directly: samples of its output have no bound;
    NoTrustworthyNumber: see `held_interval`.
    """
    channels = _Channels.of(plant)
    period = _Period(plant, channels, dt, degree, delay)
    return period.assembled(size)


# --- who is who -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Channels:
    """Groups of channels (the blocks', then performance), and what the sampler sees directly."""

    groups: tuple[ChannelGroup, ...]
    held: NDArray[np.intp]
    at_samples: tuple[int, ...]  # blocks
    point_w: NDArray[np.intp]
    point_z: NDArray[np.intp]

    @classmethod
    def of(cls, plant: GeneralizedPlant) -> _Channels:
        m, blocks = plant.model, plant.blocks
        n_w, n_z = m.n_inputs - plant.n_con, m.n_outputs - plant.n_meas
        slices = block_slices(blocks)
        q, p = (slices[-1][0].stop, slices[-1][1].stop) if slices else (0, 0)
        seen = m.D[n_z:, :n_w]
        direct = [i for i, (w, _) in enumerate(slices) if seen[:, w].any()]
        for i in direct:  # grows while it is walked through
            direct += [j for j, (w, _) in enumerate(slices) if j not in direct and m.D[slices[i][1], w].any()]
        for i in direct:
            if not blocks[i].interval:
                raise InputError(
                    f"block {blocks[i].name!r}", "dynamic, and it reaches the sampler directly",
                    "a path of low-pass character", "a filter before the sampler: antialiasing=",
                )  # fmt: skip
        point_w, point_z = (
            np.array([k for i in sorted(direct) for k in range(slices[i][side].start, slices[i][side].stop)], dtype=int)
            for side in (0, 1)
        )
        reaching = seen.any(axis=0) | m.D[point_z, :n_w].any(axis=0)
        held = np.flatnonzero(reaching)
        held = held[held >= q]
        free = np.setdiff1d(np.arange(q, n_w), held)
        groups = [ChannelGroup(np.arange(w.start, w.stop), np.arange(z.start, z.stop)) for w, z in slices]
        groups.append(ChannelGroup(free, np.arange(p, n_z)))
        return cls(tuple(groups), held, tuple(sorted(direct)), point_w, point_z)


# --- one period -------------------------------------------------------------------------------------------------------


class _Period:
    """All signals of one period as linear maps of one vector.

    The vector: (x, past controls, coefficients of each interval, held disturbances, kicks of each interval and group,
    the size of what each group's rest has beyond its kicks, Delta's outputs at the sample, u).
    """

    def __init__(self, plant: GeneralizedPlant, channels: _Channels, dt: float, degree: int, delay: float) -> None:
        self.plant, self.channels, self.dt, self.degree = plant, channels, dt, degree
        m = plant.model
        self.n, self.n_u = m.n_states, plant.n_con
        self.n_z = m.n_outputs - plant.n_meas
        self.free = np.concatenate([g.w for g in channels.groups])
        self.held_u = HeldControls(delay, dt, self.n_u)
        part = self.held_u.part
        controls = np.arange(m.n_inputs - self.n_u, m.n_inputs)
        constant = np.concatenate([channels.held, controls])
        lengths = [part, dt - part] if part else [dt]
        self.intervals = [held_interval(m, channels.groups, constant, self.n_z, h, degree) for h in lengths]
        self._join_rests()
        self._lay_out()
        self._run()

    def _join_rests(self) -> None:
        """Units whose rests are covered together: all real blocks, each dynamic block, the disturbances.

        The rests of the real blocks are scaled first, so that each acts on the rest of the loop as strongly as it is
        driven; ``wide`` is the largest entry of Delta.
        """
        blocks, groups = self.plant.blocks, self.channels.groups
        real = [i for i, b in enumerate(blocks) if b.interval]
        self.units = [real] * bool(real) + [[i] for i in range(len(groups)) if i not in real]
        self.real_unit = bool(real)
        gains = np.max([interval.gains for interval in self.intervals], axis=0)
        m = self.plant.model
        for i, to in enumerate(groups):
            for j, by in enumerate(groups):
                direct = m.D[to.z][:, by.w]
                gains[i, j] += float(np.linalg.norm(direct, 2)) if direct.size else 0.0
        wide = np.array([max(1.0, -b.interval[0]) if b.interval else 1.0 for b in blocks] + [1.0])
        out = np.array([max(_norm(v.rests[i]) for v in self.intervals) for i in range(len(groups))]) * wide
        into = np.array([max(_norm(v.kicks[i]) for v in self.intervals) for i in range(len(groups))])
        self.scale = np.ones(len(groups))
        self.scale[real] = _scales(into[real], out[real], (wide[:, None] * gains)[np.ix_(real, real)])
        scaled = (wide * self.scale)[:, None] * gains / self.scale
        self.gains = np.array([[_norm(scaled[np.ix_(to, by)]) for by in self.units] for to in self.units])
        self.row_scale = wide * self.scale
        self.joint_kicks = [
            [thin_rows(np.hstack([v.kicks[i] / self.scale[i] for i in unit]).T).T for unit in self.units]
            for v in self.intervals
        ]

    def _lay_out(self) -> None:
        """Where everything stands in the vector."""
        at = 0

        def take(count: int) -> slice:
            nonlocal at
            at += count
            return slice(at - count, at)

        self.x, self.past = take(self.n), take(self.held_u.n_past * self.n_u)
        self.coefficients = [take(self.degree * len(self.free)) for _ in self.intervals]
        self.b = take(len(self.channels.held))
        self.kicks = [[take(k.shape[1]) for k in interval] for interval in self.joint_kicks]
        self.beyond = [take(1) for _ in self.units]
        self.point, self.u = take(len(self.channels.point_w)), take(self.n_u)
        self.width = at

    def _control(self, index: int) -> AnyArray:
        """The control that acts in an interval, as a map of the vector."""
        return self.held_u.acting(index < len(self.intervals) - 1, self.past, self.u)

    def _run(self) -> None:
        """State, coefficients and rests through the intervals."""
        state = np.zeros((self.n, self.width))
        state[:, self.x] = np.eye(self.n)
        self.means: list[AnyArray] = []
        rests: list[list[AnyArray]] = [[] for _ in self.units]
        for i, interval in enumerate(self.intervals):
            v = np.vstack([state, self._rows(self.coefficients[i]), self._held(), self._control(i)])
            state, means = interval.move @ v, interval.means @ v
            for j, (unit, kick) in enumerate(zip(self.units, self.joint_kicks[i], strict=True)):
                state[:, self.kicks[i][j]] += kick[: self.n]
                means[:, self.kicks[i][j]] += kick[self.n :]
                rests[j] += [self.row_scale[g] * interval.rests[g] @ v for g in unit]
            self.means.append(means)
        self.end, self.rests = state, [thin_rows(np.vstack(rows)) for rows in rests]

    def _rows(self, part: slice) -> AnyArray:
        rows = np.zeros((part.stop - part.start, self.width))
        rows[:, part] = np.eye(len(rows))
        return rows

    def _held(self) -> AnyArray:
        return self._rows(self.b) / np.sqrt(self.dt)

    def _sampled(self, rows: NDArray[np.intp]) -> AnyArray:
        """Outputs of the plant at the moment of the sample."""
        m, c = self.plant.model, self.channels
        found = np.zeros((len(rows), self.width))
        found[:, self.x] = m.C[rows]
        found += m.D[rows][:, c.held] @ self._held() + m.D[rows][:, m.n_inputs - self.n_u :] @ self._control(0)
        return found + m.D[rows][:, c.point_w] @ self._rows(self.point)

    # --- the rests ----------------------------------------------------------------------------------------------------

    def rest_rows(self, size: float) -> list[AnyArray]:
        """For each unit the rows whose norm bounds that of its outputs' rest."""
        gains = self.gains
        shares = _shares(size * gains)
        found = []
        for i, rest in enumerate(self.rests):
            rows = [rest / np.sqrt(1 - shares[i].sum())]
            for j in np.flatnonzero(gains[i]):
                scale = gains[i, j] / np.sqrt(shares[i, j])
                rows += [scale * self._rows(part) for part in self._rest_inputs(int(j))]
            found.append(np.vstack(rows))
        return found

    def _rest_inputs(self, unit: int) -> list[slice]:
        return [*(kicks[unit] for kicks in self.kicks), self.beyond[unit]]

    # --- the model ----------------------------------------------------------------------------------------------------

    def assembled(self, size: float) -> SampledUncertainPlant:
        """The uncertain discrete plant."""
        given = self.plant.blocks
        rest_rows = self.rest_rows(size)
        used = np.vstack([*rest_rows, *self.means, self.end]).any(axis=0)
        blocks: list[Block] = []
        rows, columns = list[AnyArray](), list[AnyArray]()
        for i, block in enumerate(given):
            if block.interval:
                mean_rows, mean_columns = self._coefficient_channels(i)
                blocks.append(block.resized(len(mean_columns), len(mean_columns)))
                rows.append(mean_rows)
                columns.append(mean_columns)
        for rest, unit in zip(rest_rows, self.units, strict=True):
            rest_columns = np.concatenate(
                [np.arange(s.start, s.stop) for s in self._rest_inputs(self.units.index(unit))]
            )
            rest_columns = rest_columns[np.take(used, rest_columns)]
            if self.real_unit and unit is self.units[0]:
                if len(rest_columns) and rest.any():
                    blocks.append(FullBlock(REST, len(rest_columns), len(rest)))
                    rows.append(rest)
                    columns.append(rest_columns)
                continue
            mean_rows, mean_columns = self._coefficient_channels(unit[0])
            rows.append(np.vstack([mean_rows, rest]))
            columns.append(np.concatenate([mean_columns, rest_columns]))
            if unit[0] < len(given):
                block = given[unit[0]]
                blocks.append(FullBlock(block.name, len(columns[-1]), len(rows[-1]), origin=block.origin))
        names = tuple(self.plant.model.input_names[i] for i in self.channels.held)
        widened = tuple(b.name for b in given if not (b.is_ball or b.interval))
        uncertain = UncertainModel(self._model(rows, columns), blocks)
        return SampledUncertainPlant(uncertain, self.degree, names, widened, self._looseness())

    def _looseness(self) -> float:
        if not self.real_unit:
            return 0.0
        return _norm(self.rests[0]) * _norm(np.hstack([kicks[0] for kicks in self.joint_kicks]))

    def _coefficient_channels(self, index: int) -> tuple[AnyArray, NDArray[np.intp]]:
        """Coefficients of a group's outputs and inputs, with what Delta does at the sample, or what is held."""
        group = self.channels.groups[index]
        rows = [
            means.reshape(self.degree, self.n_z, self.width)[:, group.z].reshape(-1, self.width) for means in self.means
        ]
        columns = [self._coefficients_of(k, group) for k in range(len(self.intervals))]
        if index in self.channels.at_samples:
            here = np.isin(self.channels.point_w, group.w)
            rows.append(self._sampled(self.channels.point_z[here]))
            columns.append(self.point.start + np.flatnonzero(here))
        if index == len(self.channels.groups) - 1:
            columns.append(np.arange(self.b.start, self.b.stop))
        return np.vstack(rows), np.concatenate(columns)

    def _coefficients_of(self, interval: int, group: ChannelGroup) -> NDArray[np.intp]:
        start, k = self.coefficients[interval].start, len(self.free)
        places = np.array([np.flatnonzero(self.free == i)[0] for i in group.w], dtype=int)
        return np.concatenate([start + d * k + places for d in range(self.degree)])

    def _model(self, rows: Sequence[AnyArray], columns: Sequence[AnyArray]) -> StateSpaceModel:
        m = self.plant.model
        measured = self._sampled(np.arange(self.n_z, m.n_outputs))
        states, outputs = np.vstack([self.end, self.held_u.shifted(self.past, self.u)]), np.vstack([*rows, measured])
        inputs = np.concatenate([*columns, np.arange(self.u.start, self.u.stop)])
        x = slice(0, self.past.stop)
        return StateSpaceModel(states[:, x], states[:, inputs], outputs[:, x], outputs[:, inputs], self.dt)


def _norm(matrix: AnyArray) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def _scales(into: AnyArray, out: AnyArray, gains: AnyArray) -> AnyArray:
    """Scales d of rests that drive the loop by ``into / d``, are driven by it by ``d out``, by each other by gains."""
    from scipy.linalg import matrix_balance

    loop = np.zeros((len(into) + 1,) * 2)
    loop[0, 1:], loop[1:, 0] = into, out
    loop[1:, 1:] = gains
    _, (scale, _) = matrix_balance(loop, permute=False, separate=True)
    return scale[0] / scale[1:]


def _shares(gains: AnyArray) -> AnyArray:
    r"""Weights :math:`\theta_{ij}`, for which the rests' gains on each other cost least: by Perron's vector.

    With it all rows have the same sum, the spectral radius; where that leaves less than the room, the rows are made
    smaller, and the bound is looser, not wrong.
    """
    if not gains.any():
        return np.zeros_like(gains)
    values, vectors = np.linalg.eig(gains + 1e-9 * gains.max())
    s = np.abs(np.real(vectors[:, int(np.argmax(np.real(values)))]))
    shares = gains * s[None, :] / s[:, None]
    total = shares.sum(axis=1, keepdims=True)
    return shares * np.minimum(1.0, (1 - TUNING.room) / np.maximum(total, 1e-300))
