"""Uncertain gains, delays and lags of effects at inputs and outputs of a set."""
# Wang, Lundström, Skogestad, "Representation of uncertain time delays in the H-infinity framework", Int. J. Control 59
# (1994).

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robustlab.delays.approximation import checked_order
from robustlab.delays.model import covering
from robustlab.dynamics.extended.attached_effect import AttachedEffect
from robustlab.errors import InputError
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.uncertainty.blocks import FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel, product


def _lag_block(time: float, spread: float, name: str, origin: str) -> UncertainModel:
    """Return the exact set of all lags :math:`1 / (1 + s T)` with T within ``spread`` of ``time``, in s."""
    if not 0.0 <= spread < time:
        raise InputError(f"lag {name}", f"{time:g} s +- {spread:g} s", "a time constant that stays positive")
    a = -1.0 / time
    if not spread:
        return UncertainModel(StateSpaceModel([[a]], [[-a]], [[1.0]], [[0.0]]), [])
    model = StateSpaceModel([[a]], [[a * spread, -a]], [[a], [1.0]], [[a * spread, -a], [0.0, 0.0]])
    return UncertainModel(model, [RealScalar(name, 1, ParameterRange(time, spread, "s"), origin=origin)])


def delay_block(delay: float, spread: float, pade: int, name: str, origin: str = "") -> UncertainModel:
    r"""Return a cover :math:`P + w \Delta` of all delays from ``delay - spread`` (at least 0) to ``delay + spread``."""
    if not 0 < delay < np.inf or not 0 <= spread < np.inf:
        raise InputError("delay_block", f"{delay:g} s +- {spread:g} s", "a positive delay, a spread of 0 s or more")
    n = checked_order(pade, "delay_block", 1)
    # With a spread the error's slope changes from 1 to 2 n + 1: a weight of lower order fits better.
    made = covering(delay, spread, n, n + 1 if spread else min(n + 2, 2 * n + 1))
    return UncertainModel(made.M, [FullBlock(name, 1, 1, origin=origin, covers=made.blocks[0].covers)])


def with_signals(
    whole: UncertainModel,
    signals: Sequence[tuple[AttachedEffect, int, float]],
    amplitude: Mapping[str, float],
    width: float,
    pade: int = 0,
) -> UncertainModel:
    """Add uncertain gains of effects (effect, index of signal, level), and with ``pade`` their delays and lags."""
    into, out = ([s for s in signals if s[0].site.kind == kind] for kind in ("input", "output"))
    for e, k, level in [*reversed(into), *out]:  # the effect next to the plant first
        for block in _signal_blocks(e, level, amplitude, width, pade):
            if e.site.kind == "input":
                whole = product(whole, _at_channel(block, whole.inputs, k, e.key))
            else:
                whole = product(_at_channel(block, whole.outputs, k, e.key), whole)
    return whole


def _signal_blocks(
    e: AttachedEffect, level: float, amplitude: Mapping[str, float], width: float, pade: int
) -> list[UncertainModel]:
    """Return the blocks of an effect in its signal: an uncertain gain, a delay, a lag."""
    found: list[UncertainModel] = []
    gain, seen = e.gain(level, amplitude), e.sector(amplitude, ("input", "output"))
    reach = width * e.scale_std if seen is None else 0.5 * (seen.gain_upper - seen.gain_lower)
    if reach:
        words = f"{e.in_words}" + ("" if seen is None else " as a sector") + f"; {e.values_in_words}"
        block = RealScalar(e.key, 1, ParameterRange(gain, reach), origin=words)
        found.append(UncertainModel(StateSpaceModel([], [], [], [[0.0, reach], [1.0, gain]]), [block]))
    elif gain != 1.0:
        found.append(UncertainModel(StateSpaceModel([], [], [], [[gain]]), []))
    if e.delay and pade:
        spread = width * e.std.get(e.effect.delay, 0.0)
        words = f"{e.in_words}, {e.delay:.6g} s +- {spread:.3g} s, as Padé of order {pade} and a weight proved to cover"
        words = f"{words} what that misses; {e.values_in_words}"
        found.append(delay_block(e.delay, spread, pade, e.key, words))
    if e.time_constant and pade:
        spread = width * e.std.get(e.effect.time_constant, 0.0)
        words = f"{e.in_words}, {e.time_constant:.6g} s +- {spread:.3g} s; {e.values_in_words}"
        found.append(_lag_block(e.time_constant, spread, e.key, words))
    return found


def _at_channel(block: UncertainModel, signals: Sequence[Signal], k: int, name: str) -> UncertainModel:
    """Return the block of this name in signal k, with identity in all others."""
    g, (q, p), n = block.M, block.delta_shape, len(signals)
    into, out = np.zeros((q + 1, q + n)), np.zeros((p + n, p + 1))
    into[:q, :q], into[q, q + k] = np.eye(q), 1.0
    out[:p, :p], out[p + k, p] = np.eye(p), 1.0
    passed = np.zeros((p + n, q + n))
    passed[p:, q:] = np.diag(np.arange(n) != k)
    model = StateSpaceModel(
        g.A, g.B @ into, out @ g.C, out @ g.D @ into + passed, 0.0,
        [*(f"w_{name}" for _ in range(q)), *signals], [*(f"z_{name}" for _ in range(p)), *signals],
        [f"{name} {i + 1}" for i in range(g.n_states)], where="effect_blocks",
    )  # fmt: skip
    return UncertainModel(model, block.blocks)
