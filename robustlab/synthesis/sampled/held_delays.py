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

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array
from robustlab.delays.model import MOST_SAMPLES, DelayedModel
from robustlab.errors import InputError
from robustlab.statespace import Signal, StateSpaceModel

__all__ = ["held_delays"]

# A delay this near to a whole number of samples, relative to one, is one: what a decimal number rounds to.
WHOLE = 1e-9


def held_delays(model: DelayedModel, dt: float) -> StateSpaceModel:
    """The discrete model; its states are those of H, samples of the inputs, and samples of what delayed outputs show.

    Raises
    ------
    InputError
        A delay inside a loop or between dynamic parts: no model with finitely many states is exact; too many samples.
    """
    return _Held(model, dt).made()


@dataclass(frozen=True)
class _Held:
    model: DelayedModel
    dt: float

    def made(self) -> StateSpaceModel:
        """States x, then the past of the inputs, then the rows of the delayed outputs."""
        H, n = self.model.H, len(self.model.delays)
        early, late = self._kinds()
        N, m = H.n_states, H.n_inputs - n
        terms = [(0.0, j, H.B[:, n + j]) for j in range(m)]  # delay, input, column of B
        direct = [(0.0, j, H.D[:, n + j]) for j in range(m)]  # the same for what passes at once, columns of D
        for i in early:
            for j in np.flatnonzero(H.D[i, n:]).tolist():
                tau, gain = float(self.model.delays[i]), H.D[i, n + j]
                terms.append((tau, j, H.B[:, i] * gain))
                direct.append((tau, j, H.D[:, i] * gain))
        count = 1 + max((int(np.ceil(a / self.dt - WHOLE)) for a, _, c in [*terms, *direct] if c.any()), default=0)
        # columns: x, then u_k, u_(k-1), ..., u_(k-count)
        into_x = self._state_after(self.dt, terms, count)
        rows = {
            i: self._seen(i, n_late, theta, terms, direct, count) for i, (n_late, theta) in self._late(late).items()
        }
        straight = self._row(H.C[n:], H.D[n:], 0.0, direct, count)
        outs = straight
        # each delayed output: its value within the sample time, kept for as many samples as it is late
        lengths = {i: kept for i, (kept, _) in self._late(late).items()}
        size = N + count * m + sum(lengths.values())
        if size > MOST_SAMPLES + N:
            raise InputError("discretise", f"{size - N} samples of delay", f"at most {MOST_SAMPLES}", "a larger dt")
        return self._assembled(into_x, rows, lengths, outs, (N, m, count, size))

    def _assembled(
        self,
        into_x: Array,
        rows: dict[int, Array],
        lengths: dict[int, int],
        outs: Array,
        sizes: tuple[int, int, int, int],
    ) -> StateSpaceModel:
        N, m, count, size = sizes
        H, n = self.model.H, len(self.model.delays)
        A, B = np.zeros((size, size)), np.zeros((size, m))
        C, D = np.zeros((len(outs), size)), np.zeros((len(outs), m))

        def split(row: Array) -> tuple[Array, Array]:
            """Parts on the states and on u_k."""
            on_x = np.zeros((len(row), size))
            on_x[:, :N], on_x[:, N : N + count * m] = row[:, :N], row[:, N + m :]
            return on_x, row[:, N : N + m]

        A[:N], B[:N] = split(into_x)
        past = np.arange(N, N + count * m)
        B[past[:m]] = np.eye(m)
        A[past[m:], past[:-m]] = 1.0
        C, D = split(outs)
        at = N + count * m
        names = [Signal(f"{s.name} {k + 1} before", s.unit) for k in range(count) for s in self.model.inputs]
        for i, length in lengths.items():
            on_x, on_u = split(rows[i])
            gain = H.D[n:, i]
            if not length:
                C, D = C + np.outer(gain, on_x[0]), D + np.outer(gain, on_u[0])
                continue
            A[at], B[at] = on_x[0], on_u[0]
            A[np.arange(at + 1, at + length), np.arange(at, at + length - 1)] = 1.0
            C[:, at + length - 1] += gain
            names += [Signal(f"delay{i + 1}.{k + 1}") for k in range(length)]
            at += length
        used = self._reached(A, C, N)
        states = [*H.states, *names]
        return StateSpaceModel(
            A[np.ix_(used, used)], B[used], C[:, used], D, self.dt, self.model.inputs, self.model.outputs,
            [states[k] for k in used], where="discretise (zoh)",
        )  # fmt: skip

    @staticmethod
    def _reached(A: Array, C: Array, N: int) -> list[int]:
        """The states of H, and samples that some output still needs."""
        used = np.zeros(len(A), dtype=bool)
        used[:N] = True
        used |= (C != 0).any(axis=0)
        while True:
            more = used | (A[used] != 0).any(axis=0)
            if (more == used).all():
                return np.flatnonzero(used).tolist()
            used = more

    def _kinds(self) -> tuple[list[int], list[int]]:
        """Delays that hold inputs alone, and delays that show in outputs alone."""
        H, n = self.model.H, len(self.model.delays)
        late = [i for i in range(n) if not H.B[:, i].any() and not H.D[:n, i].any()]
        early = [i for i in range(n) if i not in late]
        inside = [i for i in early if H.C[i].any() or H.D[i, :n].any()]
        if inside:
            found = f"a delay of {self.model.delays[inside[0]]:g} s inside a loop or between dynamic parts"
            hint = "discretise plant and controller each on its own and close the loop then, or take .pade(order)"
            raise InputError(
                "discretise", found, "delays at inputs and outputs: others have no exact finite model", hint
            )
        return early, late

    def _late(self, late: list[int]) -> dict[int, tuple[int, float]]:
        """For each delayed output the samples it is kept for, and the time within a sample time that it shows."""
        found = {}
        for i in late:
            share = float(self.model.delays[i]) / self.dt
            whole = int(np.ceil(share - WHOLE))
            theta = (whole - share) * self.dt
            found[i] = whole, theta if theta > WHOLE * self.dt else 0.0
        return found

    def _seen(
        self, i: int, kept: int, theta: float, terms: list[tuple[float, int, Array]],
        direct: list[tuple[float, int, Array]], count: int,
    ) -> Array:  # fmt: skip
        """What delay i holds at ``theta`` after the sample k, on x_k and the inputs."""
        H = self.model.H
        row = self._row(H.C[[i]], H.D[[i]], theta, direct, count, through=[i])
        if not theta:
            return row
        after = self._state_after(theta, terms, count)
        row[:, : H.n_states] = 0.0
        return row + H.C[[i]] @ after

    def _row(
        self, C: Array, D: Array, theta: float, direct: list[tuple[float, int, Array]], count: int,
        through: list[int] | None = None,
    ) -> Array:  # fmt: skip
        """``C x_k`` and what passes at once at ``theta`` after the sample k, on x_k and the inputs."""
        H, n = self.model.H, len(self.model.delays)
        m = H.n_inputs - n
        rows = list(range(n, H.n_outputs)) if through is None else through
        found = np.zeros((len(rows), H.n_states + (count + 1) * m))
        found[:, : H.n_states] = C
        for a, j, column in direct:
            back = -int(np.floor((theta - a) / self.dt + WHOLE))
            found[:, H.n_states + max(back, 0) * m + j] += column[rows]
        return found

    def _state_after(self, theta: float, terms: list[tuple[float, int, Array]], count: int) -> Array:
        """X at ``theta`` after the sample k, on x_k and u_k, u_(k-1), ..."""
        from scipy.linalg import expm

        N, m = self.model.H.n_states, self.model.H.n_inputs - len(self.model.delays)
        found = np.zeros((N, N + (count + 1) * m))
        found[:, :N] = expm(self.model.H.A * theta)
        for a, j, column in terms:
            if not column.any():
                continue
            whole = int(np.floor(a / self.dt + WHOLE))
            rest = a - whole * self.dt
            rest = min(rest if rest > WHOLE * self.dt else 0.0, theta)
            old = expm(self.model.H.A * (theta - rest)) @ self._integral(rest, column)
            if whole + 1 <= count:
                found[:, N + (whole + 1) * m + j] += old
            found[:, N + whole * m + j] += self._integral(theta - rest, column)
        return found

    def _integral(self, time: float, column: Array) -> Array:
        """``int_0^time e^(A s) b ds``."""
        from scipy.linalg import expm

        A = self.model.H.A
        block = np.zeros((len(A) + 1, len(A) + 1))
        block[:-1, :-1], block[:-1, -1] = A * time, column * time
        return np.asarray(expm(block)[:-1, -1], dtype=np.float64)
