r"""The exact discrete model of one with delays at its inputs and outputs, for inputs held over the sample time.

A delay :math:`a = d T + f` with :math:`0 \le f < T` of an input makes two samples act within one sample time,

.. math:: x_{k+1} = \Phi(T) x_k + \Phi(T - f) \Gamma(f)\, u_{k-d-1} + \Gamma(T - f)\, u_{k-d}, \qquad
   \Phi(t) = e^{A t}, \quad \Gamma(t) = \int_0^t e^{A s} B\, ds

and a delay :math:`b = n T - \theta` of an output shows what was there between two samples, :math:`y_k = z((k - n) T +
\theta)` (the modified z-transform). The samples that are still needed are states. Nothing is approximated.

References
----------
Franklin, Powell, Workman, *Digital Control of Dynamic Systems* (1998), section 4.3.4; Jury, *Theory and Application of
the z-Transform Method* (1964), chapter 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robustlab.arrays import Array
from robustlab.delays.model import DelayedModel
from robustlab.delays.signal_delays import MOST_SAMPLES
from robustlab.errors import InputError
from robustlab.signals import Signal
from robustlab.statespace import StateSpaceModel

# A delay this near to a whole number of samples, relative to one, is one: what a decimal number rounds to.
WHOLE = 1e-9


def held_delays(model: DelayedModel, dt: float) -> StateSpaceModel:
    """The discrete model; its states are those of H, samples of the inputs, and samples of what delayed outputs show.

    Raises InputError: a delay inside a loop or between dynamic parts: no model with finitely many states is exact; too
    many samples.
    """
    held = _Held(model, dt)
    H, n, N, m = model.H, held.n, held.N, held.m
    lengths = {i: int(np.ceil(float(model.delays[i]) / dt - WHOLE)) for i in held.late}
    size = N + held.count * m + sum(lengths.values())
    if size - N > MOST_SAMPLES:
        raise InputError("discretise", f"{size - N} samples of delay", f"at most {MOST_SAMPLES}", "a larger dt")
    A, B = np.zeros((size, size)), np.zeros((size, m))

    def split(rows: Array) -> tuple[Array, Array]:
        """Parts on the states and on u_k."""
        rest = np.zeros((len(rows), size - N - held.count * m))
        return np.hstack([rows[:, :N], rows[:, N + m :], rest]), rows[:, N : N + m]

    A[:N], B[:N] = split(held.state(dt))
    past = np.arange(N, N + held.count * m)
    B[past[:m]] = np.eye(m)
    A[past[m:], past[:-m]] = 1.0
    C, D = split(held.shown(range(n, H.n_outputs), 0.0))
    names = [Signal(f"{s.name} {k + 1} before", s.unit) for k in range(held.count) for s in model.inputs]
    at = N + len(past)
    for i, length in lengths.items():
        theta = length * dt - float(model.delays[i])
        on_x, on_u = split(held.shown([i], theta if theta > WHOLE * dt else 0.0))
        if not length:
            C, D = C + np.outer(H.D[n:, i], on_x[0]), D + np.outer(H.D[n:, i], on_u[0])
            continue
        A[at], B[at] = on_x[0], on_u[0]
        A[np.arange(at + 1, at + length), np.arange(at, at + length - 1)] = 1.0
        C[:, at + length - 1] += H.D[n:, i]
        names += [Signal(f"delay{i + 1}.{k + 1}") for k in range(length)]
        at += length
    used, states = _needed(A, C, N), [*H.states, *names]
    return StateSpaceModel(
        A[np.ix_(used, used)], B[used], C[:, used], D, dt, model.inputs, model.outputs, [states[k] for k in used],
        where="discretise (zoh)",
    )  # fmt: skip


def _needed(A: Array, C: Array, N: int) -> list[int]:
    """The states of H, and the samples that some output still needs."""
    used = (C != 0).any(axis=0)
    used[:N] = True
    while (more := used | (A[used] != 0).any(axis=0)).sum() > used.sum():
        used = more
    return np.flatnonzero(used).tolist()


class _Held:
    """The continuous model within one sample time, on (x_k, u_k, u_(k-1), ..., u_(k-count))."""

    def __init__(self, model: DelayedModel, dt: float) -> None:
        H, n = model.H, len(model.delays)
        self.H, self.dt, self.n, self.N, self.m = H, dt, n, H.n_states, H.n_inputs - n
        into = np.vstack([H.B, H.D])
        self.late = [i for i in range(n) if not into[: self.N + n, i].any()]  # these show in outputs alone
        early = [i for i in range(n) if i not in self.late]
        inside = [i for i in early if H.C[i].any() or H.D[i, :n].any()]
        if inside:
            found = f"a delay of {model.delays[inside[0]]:g} s inside a loop or between dynamic parts"
            expected = "delays at inputs and outputs: others have no exact finite model"
            hint = "discretise plant and controller each on its own and close the loop then, or take .pade(order)"
            raise InputError("discretise", found, expected, hint)
        # delay, input, and the column of [B; D] through which it acts
        self.ways = [(0.0, j, into[:, n + j]) for j in range(self.m)]
        self.ways += [
            (float(model.delays[i]), j, into[:, i] * H.D[i, n + j])
            for i in early
            for j in range(self.m)
            if H.D[i, n + j]
        ]
        self.count = 1 + max((int(np.ceil(a / dt - WHOLE)) for a, _, _ in self.ways), default=0)

    def shown(self, rows: Sequence[int], theta: float) -> Array:
        """These rows of the outputs of H at ``theta`` after a sample, without what delayed outputs add."""
        found = self.H.C[list(rows)] @ self.state(theta)
        for a, j, column in self.ways:
            back = max(0, -int(np.floor((theta - a) / self.dt + WHOLE)))
            found[:, self.N + back * self.m + j] += column[[self.N + r for r in rows]]
        return found

    def state(self, theta: float) -> Array:
        """The states at ``theta`` after a sample; an input late by no whole number of samples changes on the way."""
        from scipy.linalg import expm

        A, N, m = self.H.A, self.N, self.m
        found = np.zeros((N, N + (self.count + 1) * m))
        found[:, :N] = expm(A * theta)
        for a, j, column in self.ways:
            whole = int(np.floor(a / self.dt + WHOLE))
            rest = a - whole * self.dt
            rest = min(rest if rest > WHOLE * self.dt else 0.0, theta)
            found[:, N + whole * m + j] += self._integral(theta - rest, column[:N])
            if rest:
                found[:, N + (whole + 1) * m + j] += expm(A * (theta - rest)) @ self._integral(rest, column[:N])
        return found

    def _integral(self, time: float, column: Array) -> Array:
        """``int_0^time e^(A s) b ds``."""
        from scipy.linalg import expm

        block = np.zeros((self.N + 1, self.N + 1))
        block[:-1, :-1], block[:-1, -1] = self.H.A * time, column * time
        return np.asarray(expm(block)[:-1, -1], dtype=np.float64)
