r"""The compiled stepping of a linear plant with force laws at its ports.

Over a step of length h the forces are held (the plant itself is exact):

.. math::
    x^+ = \Phi x + \Gamma_u u + \sum_j \Gamma_j f_j, \qquad \Gamma_j = \int_0^h e^{A s} b_j\, ds

Each law answers with a force that fits the motion *at the end of the step that this very force brings about*: it is
given the motion at the port without it, ``q, v``, and the port's compliance ``gq = p^T Gamma, gv = c^T Gamma``, so that
the motion with it is ``q + gq f, v + gv f``. A set-valued law (dry friction, a contact) solves its own inclusion in
closed form: Coulomb's law sticks with the velocity exactly zero. Several laws are swept (Gauss-Seidel) until they
agree.

References
----------
Acary, Brogliato, *Numerical Methods for Nonsmooth Dynamical Systems* (2008), chapters 9 and 10 (time stepping).
"""

# pyright: reportMissingParameterType=false, reportUnnecessaryTypeIgnoreComment=false
from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from numba import types

__all__ = [
    "GQ",
    "GV",
    "LAW_SIGNATURE",
    "MAX_LAWS",
    "Q0",
    "STEP",
    "TIME",
    "V0",
    "HeldStep",
    "Q",
    "Run",
    "V",
    "law",
    "no_force",
    "step_windows",
]

# Entries of the vector that a law is given: position and velocity at the start of the step, both at its end without
# the law's own force, the compliance of both, the length of the step in s, and the time at its start in s.
Q0, V0, Q, V, GQ, GV, STEP, TIME = range(8)
N_SEEN = 8

VECTOR = types.float64[::1]
LAW_SIGNATURE = types.float64(VECTOR, VECTOR, VECTOR, VECTOR)
MAX_LAWS = 8
SWEEPS = 12
AGREED = 1e-9  # relative to the largest force of the step


def law(function):  # type: ignore[no-untyped-def]
    """Compile ``function(p, z, z_next, seen) -> force``.

    p are the law's parameters, z its memory at the start of the step (never to be written), z_next the memory at the
    end, seen the vector described above.
    """
    return nb.cfunc(LAW_SIGNATURE, cache=True)(function)


@law
def no_force(p, z, z_next, seen):  # type: ignore[no-untyped-def]
    """Fills unused places."""
    return 0.0


class HeldStep(NamedTuple):
    """The plant over a step with its inputs and forces held, n states.

    phi (n, n), gamma_u (n, n_u), gamma_f (n_laws, n); what each law sees: velocity, position (n_laws, n).
    """

    phi: Any
    gamma_u: Any
    gamma_f: Any
    velocity: Any
    position: Any


class Run(NamedTuple):
    """What is simulated: inputs, window starts and lengths.

    u (n_samples * sub, n_u), steps of h seconds from the time t0, ``sub`` of them a sample; first samples of the
    windows (n_windows,), each ``length`` samples long, and their initial states x0 (n_windows, n). Of these the first
    ``own`` belong to the plant; those of effects are used in the first window and carried over afterwards.
    """

    u: Any
    h: Any
    t0: Any
    sub: Any
    starts: Any
    length: Any
    x0: Any
    own: Any


@nb.njit(cache=True, nogil=True)
def step_windows(laws, n_laws, step, parameters, memory, run, states, forces):  # type: ignore[no-untyped-def]
    """Simulate windows one after the other.

    parameters (n_laws, n_p), memory (n_laws, n_z; changed in place) of the first ``n_laws`` laws; states
    (n_windows, length, n) and forces (n_windows, length, n_laws; those of the last step before the sample) are written.
    """
    phi, gamma_u, gamma_f, velocity, position = step
    u, h, t0, sub, starts, length, x0, own = run
    n = phi.shape[0]
    n_u = gamma_u.shape[1]
    x = x0[0].copy()
    free = np.empty(n)
    seen = np.zeros(N_SEEN)
    z_next = memory.copy()
    places = max(n_laws, 1)
    f = np.zeros(places)
    q0, v0, q_free, v_free = np.zeros(places), np.zeros(places), np.zeros(places), np.zeros(places)
    gq, gv = np.zeros((places, places)), np.zeros((places, places))  # what force k does to the motion at port j
    for j in range(n_laws):
        for k in range(n_laws):
            for i in range(n):
                gq[j, k] += position[j, i] * gamma_f[k, i]
                gv[j, k] += velocity[j, i] * gamma_f[k, i]
    sweeps = SWEEPS if n_laws > 1 else 1
    seen[STEP] = h
    for w in range(starts.shape[0]):
        for i in range(own):
            x[i] = x0[w, i]
        f[:] = 0.0
        for k in range(length):
            for i in range(n):
                states[w, k, i] = x[i]
            for j in range(n_laws):
                forces[w, k, j] = f[j]
            for s in range(sub):
                row = (starts[w] + k) * sub + s
                for i in range(n):
                    a = 0.0
                    for c in range(n):
                        a += phi[i, c] * x[c]
                    for c in range(n_u):
                        a += gamma_u[i, c] * u[row, c]
                    free[i] = a
                for j in range(n_laws):
                    a, b, c_q, c_v = 0.0, 0.0, 0.0, 0.0
                    for i in range(n):
                        a += position[j, i] * x[i]
                        b += velocity[j, i] * x[i]
                        c_q += position[j, i] * free[i]
                        c_v += velocity[j, i] * free[i]
                    q0[j], v0[j], q_free[j], v_free[j] = a, b, c_q, c_v
                # The forces of the step before are where the sweeps begin.
                seen[TIME] = t0 + row * h
                for _sweep in range(sweeps):
                    change = 0.0
                    largest = 0.0
                    for j in range(n_laws):
                        a, b = q_free[j], v_free[j]
                        for other in range(n_laws):
                            if other != j:
                                a += gq[j, other] * f[other]
                                b += gv[j, other] * f[other]
                        seen[Q0] = q0[j]
                        seen[V0] = v0[j]
                        seen[Q] = a
                        seen[V] = b
                        seen[GQ] = gq[j, j]
                        seen[GV] = gv[j, j]
                        force = laws[j](parameters[j], memory[j], z_next[j], seen)
                        change = max(change, abs(force - f[j]) * gv[j, j])
                        largest = max(largest, abs(force) * gv[j, j])
                        f[j] = force
                    if change <= AGREED * largest:
                        break
                for j in range(n_laws):
                    for i in range(memory.shape[1]):
                        memory[j, i] = z_next[j, i]
                    for i in range(n):
                        free[i] += gamma_f[j, i] * f[j]
                for i in range(n):
                    x[i] = free[i]


def quiet_first_class_functions() -> None:
    """Numba calls functions handed over as values experimental, once per compilation; stop it, for good.

    ``warnings.catch_warnings`` would put the filters back while another thread still needs them.
    """
    from numba.core.errors import NumbaExperimentalFeatureWarning

    if ("ignore", None, NumbaExperimentalFeatureWarning, None, 0) not in warnings.filters:
        warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)
