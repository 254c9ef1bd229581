r"""Matrices P that prove an H-infinity or an H2 norm, found in floating point and checked in ball arithmetic.

The inequality (robustlab/verification/theorems.md) holds strictly for the stabilising solution of the Riccati
equation with :math:`C^T C + \varepsilon I` in the place of :math:`C^T C`: the norm with :math:`\sqrt\varepsilon x` as
further outputs is at most :math:`\sqrt{\gamma_0^2 + \varepsilon h^2}`, h that from the inputs to the states. Where
the gain is flat the margin is a millionth everywhere: Newton's method corrects P by residuals in extended precision,
and P is the sum of two matrices of doubles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from flint import arb
from numpy.typing import NDArray

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.linear_analysis import slicot
from robustlab.linear_analysis.matrices import balancing_exponents, care, dare, judged_afterwards, lyapunov
from robustlab.norms.bilinear_map import bilinear_to_continuous
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.verification.balls import Matrix, exact, identity, inverse, midpoints, precision, radii
from robustlab.verification.checker import check
from robustlab.verification.claim import Claim, Outcome
from robustlab.verification.models import Model, model_of, on_the_axis, shifted

Numbers = dict[str, NDArray[Any]]

ABOVE = 1 + 1e-6  # ratio of the claimed to the computed level, so that the evidence holds with a margin


def above(number: float) -> float:
    """Return the level claimed for a computed number."""
    return float(number * ABOVE) if number > 0 else 1e-300


def matrices(model: StateSpaceModel, name: str = "{}") -> Numbers:
    return {name.format(letter): getattr(model, letter) for letter in "ABCD"}


def model_numbers(model: StateSpaceModel) -> Numbers:
    """Return a model's matrices with its dt in s."""
    return {**matrices(model), "dt": np.array(float(model.dt))}


def loop_numbers(plant: StateSpaceModel, K: StateSpaceModel) -> Numbers:
    """Return a plant and the controller u = K y of its last outputs and inputs."""
    return {
        **matrices(plant, "P_{}"), **matrices(K, "K_{}"), "dt": np.array(float(plant.dt)),
        "n_meas": np.array(K.n_inputs, dtype=np.int64), "n_con": np.array(K.n_outputs, dtype=np.int64),
    }  # fmt: skip


def block_rows(blocks: Sequence[Any]) -> NDArray[np.int64]:
    """Return ``[kind, rows, cols]`` of each block: 0 real, 1 complex number times I, 2 a full matrix or another set."""
    rows = [(0 if b.interval else 1 if b.is_scalar else 2, b.rows, b.cols) for b in blocks]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


SHARE = 0.5  # of the difference of the squares of level and norm, for the further outputs
# Levels, relative to the requested one, at which the equation is solved in doubles: near the norm all digits are lost.
FIRST = (1.0, 1.0001, 1.01, 2.0)
RANGE = (1e-150, 1e150)  # of levels whose squares are doubles
BITS = 240  # precision of residuals
ROUGH = 1e-2  # largest relative residual that corrections remove
STEPS = 40  # of Newton's method
SMALL = 1e-26  # share of P below which a correction changes no digit of two doubles


def norm_matrix(model: StateSpaceModel, gamma: float, norm: float, numbers: Numbers | None = None) -> Numbers:
    """Return ``P`` and ``P_low`` (n, n), exactly symmetric, that prove the level ``gamma`` above ``norm``; or nothing.

    ``numbers``: those of a loop of which ``model`` has the rounded matrices; the proof is for the loop itself.
    """
    n = model.n_states
    if not n or not model.n_inputs or not norm < gamma or not RANGE[0] < gamma < RANGE[1]:
        return {}
    claimed: Numbers = {**(model_numbers(model) if numbers is None else numbers), "gamma": np.array(gamma)}
    C, D = model.C / gamma, model.D / gamma  # the equation with a level tiny against A would lose its digits
    t = np.exp2(balancing_exponents(model.A, model.B, C).astype(float))
    A, B, C = model.A / t[:, None] * t, model.B / t[:, None], C * t
    try:
        states = StateSpaceModel(A, B, np.eye(n), np.zeros((n, model.n_inputs)), model.dt)
        states = bilinear_to_continuous(states) if model.is_discrete else states
        into = slicot.peak_gain(states.A, states.B, states.C, states.D)[0]
    except (InputError, NoTrustworthyNumber):
        return {}
    if not 0 < into < np.inf:
        return {}
    room = SHARE * (1 - norm / gamma) * (1 + norm / gamma) / into / into
    solve = dare if model.is_discrete else care
    for more in FIRST:
        try:
            with judged_afterwards():
                R = D.T @ D - more**2 * np.eye(model.n_inputs)
                X = gamma**2 * solve(A, B, C.T @ C + room * np.eye(n), R, C.T @ D, tolerance=ROUGH).X
                P, low = _refined(Claim("", claimed), 0.5 * (X + X.T), t, gamma, gamma**2 * room)
        except (InputError, NoTrustworthyNumber, np.linalg.LinAlgError):
            continue
        found = {"P": P / t[:, None] / t, "P_low": low / t[:, None] / t}
        if check(Claim("bounded-real", {**claimed, **found})).outcome is Outcome.PROVED:
            return found
    return {}


def _refined(claim: Claim, X: Array, t: Array, gamma: float, room: float) -> tuple[Array, Array]:
    """Return the Riccati equation's solution next to X, of states divided by t, as a sum of two matrices of doubles."""
    from scipy.linalg import solve_continuous_lyapunov as solve

    n = len(X)
    with precision(BITS):
        G = model_of(claim)
        into, back = exact(np.diag(1 / t)), exact(np.diag(t))
        A, B, C, D, P = into * G.A * back, into * G.B, G.C * back, G.D, exact(X)
        Q, one = C.transpose() * C + identity(n) * arb(room), identity(G.m)
        for _ in range(STEPS):
            PA, PB = P * A, P * B
            R, side, left = D.transpose() * D - one * arb(gamma) ** 2, PB + C.transpose() * D, PA.transpose() + PA
            if G.dt:
                R, side, left = R + B.transpose() * PB, A.transpose() * PB + C.transpose() * D, A.transpose() * PA - P
            gain = inverse(R)
            if gain is None:
                raise NoTrustworthyNumber("norm_matrix", "a level that is too low")
            gain = gain * side.transpose()
            residual, loop = midpoints(left + Q - side * gain), midpoints(A - B * gain)
            residual = 0.5 * (residual + residual.T)
            if not (np.isfinite(residual).all() and np.isfinite(loop).all()):
                raise NoTrustworthyNumber("norm_matrix", "Newton's steps diverge")
            # scipy's solver if continuous: with SB03MD the steps end early if the states span ten decades
            discrete = G.dt > 0
            step = lyapunov(loop.T, residual, True, tolerance=ROUGH) if discrete else solve(loop.T, -residual)
            P = (P + exact(0.5 * (step + step.T))).mid()
            if np.abs(step).max() <= SMALL * np.abs(X).max():
                break
        return _in_doubles(P)


def gain_in_balls(model: StateSpaceModel, omega: float) -> float:
    """Compute ``sigma_max`` at a finite frequency in rad/s in extended precision; 0 if even that has no digits."""
    with precision(BITS):
        G = model_of(Claim("", model_numbers(model)))
        mapped = on_the_axis(G) if G.dt else G
        if mapped is None:
            return 0.0
        at = np.tan(omega * G.dt / 2) if G.dt else omega
        try:
            response = mapped.D + mapped.C * shifted(mapped, at).solve(exact(np.eye(G.n, dtype=complex)) * mapped.B)
        except ZeroDivisionError:
            return 0.0
        if midpoints(radii(response)).max(initial=0.0) > 1e-12 * np.abs(midpoints(response)).max(initial=0.0):
            return 0.0
        return float(np.linalg.norm(midpoints(response), 2)) * (1 - 1e-11)


def gramian_matrix(model: StateSpaceModel, value: float, level: float, numbers: Numbers) -> Numbers:
    """Return ``P`` and ``P_low`` (n, n) that prove the H2 norm ``value`` at the ``level`` above it, or nothing."""
    # A'P + P A + C'C + e I = 0 in balanced states, with e so small that P still proves the level.
    n = model.n_states
    t = np.exp2(balancing_exponents(model.A, model.B, model.C).astype(float))
    A, B = model.A / t[:, None] * t, model.B / t[:, None]
    try:
        # The derivative by e is tr(B'XB) with A'X + XA + I = 0.
        unit = lyapunov(A.T, np.eye(n), model.is_discrete, tolerance=ROUGH)
        size = float(np.abs(B).max(initial=0.0)) or 1.0
        cost = float(np.trace(B.T / size @ unit @ B / size))
        e = 0.5 * ((level - value) / size) * ((level + value) / size) / cost if cost > 0 else 1.0
        with precision(BITS):
            high, low = _in_doubles(_gramian(model_of(Claim("", numbers)), A, t, e))
    except (InputError, NoTrustworthyNumber):
        return {}
    return {"P": high / t[:, None] / t, "P_low": low / t[:, None] / t}


def gramian_square(model: StateSpaceModel) -> float | None:
    """Return the square of the H2 norm of a stable model, to the last bit; None if the Gramian does not settle."""
    t = np.exp2(balancing_exponents(model.A, model.B, model.C).astype(float))
    try:
        with precision(BITS):
            G = model_of(Claim("", model_numbers(model)))
            P, into = _gramian(G, model.A / t[:, None] * t, t, 0.0), exact(np.diag(1 / t)) * G.B
            parts = (into.transpose() * P * into, G.D.transpose() * G.D)
            return float(sum((X[i, i] for X in parts for i in range(G.m)), arb(0)))
    except (InputError, NoTrustworthyNumber):
        return None


def _gramian(G: Model, A: Array, t: Array, e: float) -> Matrix:
    """Compute P of states divided by t, with G's A about ``A``, by residuals in extended precision."""
    into, back = exact(np.diag(1 / t)), exact(np.diag(t))
    exact_A, C = into * G.A * back, G.C * back
    Q, P = C.transpose() * C + identity(G.n) * arb(e), exact(np.zeros((G.n, G.n)))
    for _ in range(STEPS):
        PA = P * exact_A
        residual = midpoints((exact_A.transpose() * PA - P if G.dt else PA.transpose() + PA) + Q)
        step = lyapunov(A.T, 0.5 * (residual + residual.T), G.dt > 0, tolerance=ROUGH)
        P = (P + exact(0.5 * (step + step.T))).mid()
        if np.abs(step).max() <= SMALL * np.abs(midpoints(P)).max():
            return P
    raise NoTrustworthyNumber("gramian", "residuals that do not settle")


def _in_doubles(P: Matrix) -> tuple[Array, Array]:
    """Return a matrix as the sum of two of doubles, exactly symmetric."""
    high = midpoints(P)
    high = 0.5 * (high + high.T)
    low = midpoints(P - exact(high))
    return high, 0.5 * (low + low.T)


def band_scalings(q: int, p: int, band: tuple[float, float]) -> Numbers:
    """Return one full block with D = 1 over the band: its mu is the gain."""
    low, high = band
    whole = {"low": np.array([low]), "high": np.array([high]), "band": np.array([low, high])}
    scalings = {"D_w": np.eye(q)[None], "D_z": np.eye(p)[None], "G": np.zeros((1, q, p))}
    return {"blocks": np.array([[2, q, p]], dtype=np.int64), **whole, **scalings}


def gramian_claims(model: StateSpaceModel, value: float, numbers: Numbers | None = None) -> list[Claim]:
    numbers, level = model_numbers(model) if numbers is None else numbers, above(value)
    proof = gramian_matrix(model, value, level, numbers) if model.n_states else {}
    return [Claim("gramian", {**numbers, "value": np.array(level), **proof})] if proof else []


def loop_claims(plant: StateSpaceModel, K: StateSpaceModel, gamma: float) -> list[Claim]:
    """Claim that K, on the last outputs and inputs of the plant, makes a stable loop with a norm up to ``gamma``."""
    if not np.isfinite(gamma):
        return []
    numbers, level = loop_numbers(plant, K), above(gamma)
    proof = norm_matrix(lower_lft(plant, K), level, gamma, numbers)
    return [Claim("loop-norm", {**numbers, "gamma": np.array(level), **proof})]


def h2_loop_claims(plant: StateSpaceModel, K: StateSpaceModel, value: float) -> list[Claim]:
    return gramian_claims(lower_lft(plant, K), value, loop_numbers(plant, K)) if np.isfinite(value) else []
