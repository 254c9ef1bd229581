r"""A machine of one axis as its records show it, place by place: a stand-in for the machine that no law was fitted to.

.. math:: \alpha \ddot q = u - m(q) - f \operatorname{sgn} \dot q - b\, \dot q, \qquad m(q + P) = m(q)

in units of the input u: m is a table over one period P of the position, with straight lines between its nodes. All are
linear in the records, and every term is seen through one and the same smoothing kernel, so that smoothing blurs none:

.. math:: g * u = \alpha\, (g * q)'' + \sum_n m_n\, (g * h_n(q)) + f\, (g * \operatorname{sgn} \dot q) + b\, (g * q)'

No name of the catalogue, no model and no prior is in it; a controller that was designed on a named model can be judged
on it. It is simulated with steps of its own: the velocity is moved by the forces at hand, then dry friction takes what
it can of it, so that the axis sticks where friction holds it (Moreau's time stepping).

References
----------
Shinbrot, "On the analysis of linear and nonlinear systems", Trans. ASME 79 (1957): moments with smooth functions in
place of derivatives. Acary, Brogliato, *Numerical Methods for Nonsmooth Dynamical Systems* (2008), chapter 10.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.extended.feed_forward import DryLevel, FeedForward, Wave
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.record import Record
from robustlab.signals import Signal
from robustlab.statespace import StateSpaceModel

NODES = 144  # of a period: four to the shortest of 36 waves a turn
SMOOTHED = 4.0  # standard deviation of the kernel in samples; it reaches over three of them to either side
ROUGHNESS = 1e-3  # weight of the table's second differences beside the records: what no record visits is bridged
# Central differences of order six: of order two, a wave of nine samples a period would lose 4 % of its acceleration.
FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
FAR = 100.0  # periods from the reference: it has run away
STEP = 2e-5  # s, the longest of the simulation


class MachineRun(NamedTuple):
    """Samples of a run: times in s, position, speed, and what was put in, (n,) each."""

    t: Array
    q: Array
    v: Array
    u: Array


@dataclass(frozen=True, eq=False)
class MeasuredMachine:
    """What `measured_machine` read off the records, in units of the input.

    Attributes
    ----------
    inertia, viscous, friction
        alpha, b and f.
    table
        The map m at equal steps of a period, (n,); the first node at q = 0.
    period
        P, in the unit of the position.
    left, samples
        Root mean square of what the equation leaves of the smoothed input, over so many samples.
    """

    input: Signal
    position: Signal
    inertia: float
    viscous: float
    friction: float
    table: Array
    period: float
    left: float
    samples: int

    def at(self, q: Array) -> Array:
        """The map at positions (n,)."""
        nodes = np.arange(len(self.table) + 1) * self.period / len(self.table)
        return np.interp(np.mod(q, self.period), nodes, np.append(self.table, self.table[0]))

    def waves(self, count: int) -> tuple[Wave, ...]:
        """The ``count`` largest waves of the map, the largest first."""
        found = 2.0 * np.fft.rfft(self.table) / len(self.table)
        order = 1 + np.argsort(-np.abs(found[1:-1]))[:count]
        return tuple(
            Wave(float(found[k].real), float(-found[k].imag), 2.0 * math.pi * int(k) / self.period) for k in order
        )

    def feed_forward(self, count: int) -> FeedForward:
        """The input that the largest waves of the map, its mean and the dry friction need."""
        waves = (Wave(float(self.table.mean()), 0.0, 0.0), *self.waves(count))
        said = f"map of {self.position.name} ({count} waves)", "dry friction of the same records"
        return FeedForward(self.input, self.position, waves, (DryLevel(self.friction),), said)

    def run(
        self, K: StateSpaceModel, q_ref: Array, v_ref: Array, ahead: FeedForward | None = None, lsb: float = 0.0
    ) -> MachineRun:
        """The machine under a digital controller, from rest at the first reference.

        ``K``: discrete, from (reference, position) to the input. ``q_ref``, ``v_ref``: reference and its rate at the
        samples, (n,). ``ahead``: added to what K gives. ``lsb``: step of the encoder, 0: none.

        Raises InputError: a controller of other sizes, or a continuous one. NoTrustworthyNumber: the machine runs away.
        """
        if (K.n_inputs, K.n_outputs) != (2, 1) or not K.is_discrete:
            found = f"{K.n_inputs} inputs, {K.n_outputs} outputs, {'discrete' if K.is_discrete else 'continuous'}"
            raise InputError(
                "measured machine: controller", found, "reference and position in, one input out, discrete"
            )
        more = np.zeros_like(q_ref) if ahead is None else ahead(q_ref, v_ref)
        steps = math.ceil(K.dt / STEP)
        numbers = np.array([self.inertia, self.viscous, self.friction, self.period, lsb, K.dt / steps])
        found = _run(K.A, K.B, K.C[0], K.D[0], q_ref, more, self.table, numbers, steps)
        if not np.isfinite(found).all():
            raise NoTrustworthyNumber("measured machine", "it runs away under this controller", "a stable loop")
        return MachineRun(K.dt * np.arange(len(q_ref)), *found)


def measured_machine(
    records: Sequence[Record],
    input: str,
    position: str,
    speeds: tuple[float, float],
    period: float = 2.0 * math.pi,
    nodes: int = NODES,
) -> MeasuredMachine:
    """Read a machine's inertia, friction and map over the position off its records.

    ``records``: uniform, with this input and this position. ``speeds``: only samples are used whose speed, and that of
    all samples within reach of the kernel, lies between the two: above the first it surely moves; the faster it is, the
    fewer samples a wave has. ``period``: of the map, a turn by default. ``nodes``: of the table.

    Raises InputError: a record without these signals, or sampled irregularly. NoTrustworthyNumber: fewer samples
    between the speeds than unknowns, or an inertia that is not positive.
    """
    where = "measured machine"
    rows, rights = zip(*(_equations(r, input, position, speeds, period, nodes, where) for r in records), strict=True)
    A, u = np.vstack(rows), np.concatenate(rights)
    if len(A) <= nodes + 3:
        raise NoTrustworthyNumber(where, f"{len(A)} samples between these speeds", f"more than {nodes + 3}")
    size = np.sqrt((A[:, nodes:] ** 2).mean(axis=0))
    A[:, nodes:] /= size
    bend = np.zeros((nodes, nodes + 3))
    bend[:, :nodes] = np.roll(np.eye(nodes), 1, 1) - 2.0 * np.eye(nodes) + np.roll(np.eye(nodes), -1, 1)
    whole = np.vstack([A, math.sqrt(ROUGHNESS * len(A) / nodes) * bend])
    found = np.linalg.lstsq(whole, np.append(u, np.zeros(nodes)), rcond=None)[0]
    left = float(np.sqrt(np.mean((u - A @ found) ** 2)))
    inertia, friction, viscous = (found[nodes:] / size).tolist()
    if not inertia > 0.0:
        raise NoTrustworthyNumber(where, f"an inertia of {inertia:.3g}", "records in which the machine accelerates")
    signals = Signal(input, records[0].unit(input)), Signal(position, records[0].unit(position))
    table = np.ascontiguousarray(found[:nodes])
    return MeasuredMachine(*signals, inertia, viscous, friction, table, period, left, len(A))


def _equations(
    record: Record, name: str, position: str, speeds: tuple[float, float], period: float, nodes: int, where: str
) -> tuple[Array, Array]:
    """Rows (n, nodes + 3) and right-hand side (n,) of a record: hats, then acceleration, direction and speed."""
    from scipy.ndimage import gaussian_filter1d, maximum_filter1d, minimum_filter1d

    for wanted, side in ((name, record.inputs), (position, record.outputs)):
        if wanted not in side:
            raise InputError(where, f"{record.name} has no {wanted!r}", "a record of input and position")
    if not record.is_uniform:
        raise InputError(where, f"irregular sampling of {record.name}", "equal steps", "resample the record")
    u, q, h = record.inputs[name], record.outputs[position], record.dt

    def smooth(x: Array) -> Array:
        return gaussian_filter1d(x, SMOOTHED, axis=0)

    from_start = smooth(q - q[0])
    speed = np.convolve(from_start, FIRST[::-1] / h, "same")
    terms = np.zeros((len(q), nodes + 3))
    place = np.mod(q, period) / period * nodes
    node, share = np.floor(place).astype(int), place - np.floor(place)
    every = np.arange(len(q))
    terms[every, node % nodes] += 1.0 - share
    terms[every, (node + 1) % nodes] += share
    terms[:, nodes + 1], terms[:, nodes + 2] = np.sign(speed), speed
    rows = smooth(terms)
    rows[:, nodes] = np.convolve(from_start, SECOND / h**2, "same")
    reach = math.ceil(3.0 * SMOOTHED)
    size = np.abs(speed)
    near = 2 * reach + 1
    kept = (minimum_filter1d(size, near) > speeds[0]) & (maximum_filter1d(size, near) < speeds[1])
    kept[:reach] = kept[-reach:] = False
    return rows[kept], smooth(u)[kept]


@nb.njit(cache=True)
def _run(A, B, C, D, q_ref, more, table, numbers, steps):  # type: ignore[no-untyped-def]
    """Position, speed and input (3, n) at the samples."""
    inertia, viscous, friction, period, lsb, h = numbers
    n, nodes = len(q_ref), len(table)
    out, x = np.zeros((3, n)), np.zeros(len(A))
    q, v, kick = q_ref[0], 0.0, h * friction / inertia
    for k in range(n):
        if not abs(q - q_ref[k]) < FAR * period:  # NaN, too
            out[:, k:] = np.nan
            return out
        seen = q if lsb == 0.0 else lsb * math.floor(q / lsb + 0.5)
        u = C @ x + D[0] * q_ref[k] + D[1] * seen + more[k]
        x = A @ x + B[:, 0] * q_ref[k] + B[:, 1] * seen
        out[0, k], out[1, k], out[2, k] = q, v, u
        for _ in range(steps):
            place = (q / period - math.floor(q / period)) * nodes
            node = min(int(place), nodes - 1)
            share = place - node
            pull = (1.0 - share) * table[node] + share * table[(node + 1) % nodes]
            v += h * (u - pull - viscous * v) / inertia
            v = math.copysign(max(abs(v) - kick, 0.0), v)
            q += h * v
    return out
