# pyright: reportMissingParameterType=false, reportCallIssue=false
r"""Compiled responses of many linear members: LANES of them side by side, so that every step is a vector operation.

.. math:: x_{j+1} = \Phi x_j + \Gamma v_j, \qquad y_j = C x_j + D u_j

Arrays hold their members in the last axis, in groups of LANES: Phi is (n_groups, n_x, n_x, LANES). A member's numbers
do not depend on its neighbours: every lane does the same operations in the same order.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

# Members of a group: their sums are taken together.
LANES = 32
# Lanes that go through a stretch of times together: few enough for their Phi to stay in the first cache. They divide
# LANES; compilers make vector instructions of any length out of so many numbers side by side.
SIDE_BY_SIDE = 8
# Times of a stretch, after which the next members are taken: what is counted in it stays in the cache.
TIMES = 16


@njit(nogil=True, error_model="numpy")
def _outputs(c, d, c_entries, d_entries, x, u, y):
    """``y = C x + D u`` for one group; the entries (i, j) listed are those that are not zero in every member."""
    row = -1
    for e in range(len(c_entries)):
        i, j = c_entries[e]
        if i == row:
            for lane in range(y.shape[1]):
                y[i, lane] += c[i, j, lane] * x[j, lane]
            continue
        for blank in range(row + 1, i):
            y[blank, :] = 0.0
        row = i
        for lane in range(y.shape[1]):
            y[i, lane] = 0.0 + c[i, j, lane] * x[j, lane]  # never -0.0
    for blank in range(row + 1, y.shape[0]):
        y[blank, :] = 0.0
    for e in range(len(d_entries)):
        i, j = d_entries[e]
        for lane in range(y.shape[1]):
            y[i, lane] += d[i, j, lane] * u[j]


@intrinsic
def _advance(_, phi, gamma, x, v, next_x, lane):
    """``next_x = Phi x + Gamma v`` in SIDE_BY_SIDE lanes from one on; arrays are contiguous in memory.

    Written for the compiler as sums of vectors, which it does not find by itself: twice as fast as the same loops.
    Products and sums are rounded one by one, in the order of the columns; a v that is zero adds nothing.
    """
    number = ir.DoubleType()
    vector, places = ir.VectorType(number, SIDE_BY_SIDE), ir.VectorType(ir.IntType(32), SIDE_BY_SIDE)

    def generate(context, builder, signature, arguments):
        arrays = [
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(signature.args[:5], arguments[:5], strict=True)
        ]
        phi, gamma, x, v, next_x = (array.data for array in arrays)
        n, lanes = cgutils.unpack_tuple(builder, arrays[2].shape)
        (m,) = cgutils.unpack_tuple(builder, arrays[3].shape)
        total = cgutils.alloca_once(builder, vector)

        def at(start, row):
            """Where the lanes of a row begin."""
            place = builder.add(builder.mul(row, lanes), arguments[5])
            return builder.bitcast(builder.gep(start, [place]), vector.as_pointer())

        def add(factor, value):
            builder.store(builder.fadd(builder.load(total), builder.fmul(factor, value)), total)

        with cgutils.for_range(builder, n) as rows:
            builder.store(ir.Constant(vector, [0.0] * SIDE_BY_SIDE), total)
            with cgutils.for_range(builder, m) as columns:
                value = builder.load(builder.gep(v, [columns.index]))
                with builder.if_then(builder.fcmp_unordered("!=", value, ir.Constant(number, 0.0))):
                    row = builder.add(builder.mul(rows.index, m), columns.index)
                    one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.IntType(32)(0))
                    same = builder.shuffle_vector(one, one, ir.Constant(places, [0] * SIDE_BY_SIDE))
                    add(builder.load(at(gamma, row), align=8), same)
            with cgutils.for_range(builder, n) as columns:
                row = builder.add(builder.mul(rows.index, n), columns.index)
                add(builder.load(at(phi, row), align=8), builder.load(at(x, columns.index), align=8))
            builder.store(builder.load(total), at(next_x, rows.index), align=8)
        return context.get_dummy_value()

    return types.void(phi, gamma, x, v, next_x, types.int64), generate


@njit(nogil=True, error_model="numpy")
def _march(phi, gamma, v, states):
    """The states after the first ones of one group, (len(v) + 1, n, LANES)."""
    for lane in range(0, LANES, SIDE_BY_SIDE):
        for t in range(len(v)):
            _advance(phi, gamma, states[t], v[t], states[t + 1], lane)


@njit(cache=True, nogil=True, error_model="numpy")
def respond(lanes, out):
    """Responses of all members of `Lanes` into out (k, n_t, n_y); k may end inside the last group."""
    phi, gamma, c, d, c_entries, d_entries, u, v, x0 = lanes
    n_t, n_y = out.shape[1], out.shape[2]
    states, y = np.empty((TIMES + 1, phi.shape[1], LANES)), np.empty((n_y, LANES))
    for group in range(phi.shape[0]):
        used = min(LANES, out.shape[0] - LANES * group)
        for i in range(len(x0)):
            states[0, i, :] = x0[i]
        for begin in range(0, n_t, TIMES):
            drive = v[begin : begin + TIMES]
            _march(phi[group], gamma[group], drive, states)
            for t in range(begin, min(begin + TIMES, n_t)):
                _outputs(c[group], d[group], c_entries, d_entries, states[t - begin], u[t], y)
                for lane in range(used):
                    for i in range(n_y):
                        out[LANES * group + lane, t, i] = y[i, lane]
            states[0] = states[len(drive)]


@njit(nogil=True, error_model="numpy")
def _placed(y, t, bins, last, gap, place, largest):
    """Deviations of one group's outputs from nominal and their bins; whether every one is finite."""
    nominal, low, per_bin = bins
    finite = 0
    for i in range(y.shape[0]):
        centre, start, scale = nominal[t, i], low[t, i], per_bin[t, i]
        for lane in range(y.shape[1]):
            gap[i, lane] = y[i, lane] - centre
            finite += abs(gap[i, lane]) < math.inf
            largest[i, lane] = max(largest[i, lane], abs(gap[i, lane]))
            place[i, lane] = int(min(max((y[i, lane] - start) * scale, 0.0), last))
    return finite == y.size


@njit(nogil=True, error_model="numpy")
def _added(y, t, gap, place, sums, counts):
    """Add the outputs of a whole group without any that is not finite."""
    lower, upper, total, squares, _ = sums
    for i in range(y.shape[0]):
        smallest, greatest, added, added_squares = lower[t, i], upper[t, i], 0.0, 0.0
        for lane in range(y.shape[1]):
            smallest = min(smallest, y[i, lane])
            greatest = max(greatest, y[i, lane])
            added += gap[i, lane]
            added_squares += gap[i, lane] * gap[i, lane]
            counts[t, i, place[i, lane]] += 1
        lower[t, i], upper[t, i] = smallest, greatest
        total[t, i] += added
        squares[t, i] += added_squares


@njit(nogil=True, error_model="numpy")
def _added_with_losses(y, t, used, gap, place, largest, sums, counts):
    """The same of the first lanes; what is not finite is counted as lost."""
    lower, upper, total, squares, lost = sums
    for i in range(y.shape[0]):
        added, added_squares = 0.0, 0.0
        for lane in range(used):
            if not abs(gap[i, lane]) < math.inf:
                lost[t, i] += 1
                largest[i, lane] = math.inf
                continue
            lower[t, i], upper[t, i] = min(lower[t, i], y[i, lane]), max(upper[t, i], y[i, lane])
            added += gap[i, lane]
            added_squares += gap[i, lane] * gap[i, lane]
            counts[t, i, place[i, lane]] += 1
        total[t, i] += added
        squares[t, i] += added_squares


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(lanes, bins, sums, counts, peak):
    """Add the responses of the first ``len(peak)`` members of `Lanes` to the running statistics ``sums``.

    ``bins`` are `streaming.Bins`, ``sums`` `streaming.Sums`; ``counts (n_t, n_y, n_bins)`` gets how many values fall
    into each bin, ``peak (count, n_y)`` each member's largest deviation.
    """
    phi, gamma, c, d, c_entries, d_entries, u, v, x0 = lanes
    n_t, n_y, n_bins = counts.shape
    n, groups = phi.shape[1], min(phi.shape[0], -(-len(peak) // LANES))
    last, states, y = np.empty((groups, n, LANES)), np.empty((TIMES + 1, n, LANES)), np.empty((n_y, LANES))
    gap, place, largest = np.empty((n_y, LANES)), np.empty((n_y, LANES), np.int32), np.zeros((groups, n_y, LANES))
    for group in range(groups):
        for i in range(n):
            last[group, i, :] = x0[i]
    for begin in range(0, n_t, TIMES):
        for group in range(groups):
            used, drive = min(LANES, len(peak) - LANES * group), v[begin : begin + TIMES]
            states[0] = last[group]
            _march(phi[group], gamma[group], drive, states)
            last[group] = states[len(drive)]
            for t in range(begin, min(begin + TIMES, n_t)):
                _outputs(c[group], d[group], c_entries, d_entries, states[t - begin], u[t], y)
                if _placed(y, t, bins, n_bins - 1.0, gap, place, largest[group]) and used == LANES:
                    _added(y, t, gap, place, sums, counts)
                else:
                    _added_with_losses(y, t, used, gap, place, largest[group], sums, counts)
    for group in range(groups):
        for lane in range(min(LANES, len(peak) - LANES * group)):
            for i in range(n_y):
                peak[LANES * group + lane, i] = largest[group, i, lane]
