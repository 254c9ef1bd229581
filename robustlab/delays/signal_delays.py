"""Delays of a model's inputs and outputs: exact ones, and sets that hold all delays within a range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.checks import whole
from robustlab.delays.approximation import SHORTEST
from robustlab.delays.model import DelayedModel, as_delayed, covering
from robustlab.errors import InputError, error_context
from robustlab.signals import Signal, real_array
from robustlab.statespace import StateSpaceModel, append, as_model, series
from robustlab.uncertainty.lft import UncertainModel, Wiring, as_uncertain, interconnected, product, unique_names

# Samples of delay of a discrete model; each is a state.
MOST_SAMPLES = 2000
# How far from a whole number of samples a discrete delay may be, relative to one sample.
WHOLE = 1e-9


@error_context("delay")
def delay(tau: ArrayLike, n: int = 1, dt: float = 0.0) -> DelayedModel | StateSpaceModel:
    r"""A pure delay :math:`e^{-s \tau}` in each of n channels.

    Parameters
    ----------
    tau
        In s, 0 or more; one number, or one for each channel.
    n
        Number of channels, where tau is one number.
    dt
        Sample time in s of a discrete delay; 0 means continuous time.

    Returns
    -------
    DelayedModel or StateSpaceModel
        Exact; a discrete one is a model with a state for each sample of delay.

    Raises
    ------
    InputError
        A delay that is negative or not finite, or in discrete time no whole number of samples.

    Examples
    --------
    >>> delay(2.0)(0.25j)[0, 0].round(4)
    np.complex128(0.8776-0.4794j)
    >>> delay(0.03, dt=0.01)
    StateSpaceModel(3 states, [u1] -> [y1], dt=0.01 s)
    """
    whole("delay: n", n, 1)
    given: Any = [tau] * n if np.ndim(tau) == 0 else tau
    lengths = real_array("tau", given, 1, "delay")
    gain = StateSpaceModel([], [], [], np.eye(len(lengths)), dt)
    found: Any = with_delays(gain, inputs=dict(enumerate(lengths.tolist())))  # numbers, not ranges: no set
    return found


@error_context("with_delays")
def with_delays(
    G: Any,
    inputs: Mapping[Any, float | Sequence[float]] | None = None,
    outputs: Mapping[Any, float | Sequence[float]] | None = None,
    order: int = 3,
) -> DelayedModel | StateSpaceModel | UncertainModel:
    r"""The model with exact delays of some of its inputs and outputs; with delays within ranges, a set that holds it.

    A proof for the set holds for the model with every such delay; see `DelayedModel.uncertain`. Delays in a range vary
    independently.

    Parameters
    ----------
    G
        A StateSpaceModel, a plant, a python-control object, a DelayedModel or an UncertainModel.
    inputs, outputs
        Name or number of a signal -> its delay in s, 0 or more, or its shortest and its longest delay.
    order
        Of a set: order of the approximations; see `DelayedModel.uncertain`.

    Returns
    -------
    DelayedModel, StateSpaceModel or UncertainModel
        For a discrete G a model with a state :math:`z^{-1}` for each sample of delay, else a DelayedModel. Where G is
        uncertain or a delay is a range, a set with the blocks of G and those of the delays.

    Raises
    ------
    InputError
        No such signal; a delay that is negative or not finite, a range that ends before it begins; for a discrete G no
        whole number of samples, or a range.

    Examples
    --------
    >>> motor = StateSpaceModel([[-2.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["omega"])
    >>> with_delays(motor, inputs={"u": 0.01}, outputs={"omega": 0.02})
    DelayedModel(1 state, delays of 0.01, 0.02 s, [u] -> [omega])
    >>> [b.name for b in with_delays(motor, inputs={"u": (0.1, 0.3)}).blocks]
    ['u: spread 1 of 0.2 s +- 0.1 s']
    """
    model = G if isinstance(G, DelayedModel | UncertainModel) else as_model(G, "with_delays")
    before, after = _ranges("input", inputs, model.inputs), _ranges("output", outputs, model.outputs)
    ranges = any(np.ndim(length) for side in (inputs, outputs) for length in (side or {}).values())
    exact = not ranges and not isinstance(model, UncertainModel)
    if exact and isinstance(model, StateSpaceModel) and model.is_discrete:
        whole = series(series(_shifts(before, model.dt), model), _shifts(after, model.dt))
        return whole.renamed(model.inputs, model.outputs)
    if exact:
        return _bank(after, model.outputs) @ as_delayed(model) @ _bank(before, model.inputs)
    if model.dt:
        raise InputError("with_delays", f"a discrete model, dt = {model.dt:g} s", "a continuous one")
    held = model.uncertain(order) if isinstance(model, DelayedModel) else as_uncertain(model, "with_delays")
    first, last = _held_bank(before, model.inputs, order), _held_bank(after, model.outputs, order)
    held = product(last, product(held, first))
    return UncertainModel(held.M, held.blocks)


# --- ranges and banks -------------------------------------------------------------------------------------------------


def _ranges(side: str, given: Mapping[Any, Any] | None, signals: Sequence[Signal]) -> list[tuple[float, float]]:
    """Return the shortest and longest delay of each signal; zero where none is given."""
    names, found = [s.name for s in signals], [(0.0, 0.0)] * len(signals)
    for key, value in (given or {}).items():
        number = isinstance(key, (int, np.integer)) and not isinstance(key, bool)
        if not (key in names or (number and 0 <= int(key) < len(names))):
            raise InputError(f"with_delays: {side} {key!r}", "no such signal", f"one of {', '.join(names)}")
        ends = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
        real = all(isinstance(v, (int, float, np.number)) and not isinstance(v, bool) for v in ends)
        if not real or len(ends) != 2 or not 0 <= ends[0] <= ends[1] <= 1 / SHORTEST:
            raise InputError(f"with_delays: {side} {key!r}", f"{value!r}", "a delay of 0 s or more, or a range of such")
        found[int(key) if number else names.index(str(key))] = float(ends[0]), float(ends[1])
    return found


def _bank(delays: list[tuple[float, float]], signals: Sequence[Signal]) -> DelayedModel:
    """Return a diagonal model of exact delays, one for each signal."""
    n, eye = len(delays), np.eye(len(delays))
    ins, outs = (unique_names([*signals, *(Signal(f"{side}{k + 1}") for k in range(n))]) for side in "wz")
    D = np.block([[np.zeros((n, n)), eye], [eye, np.zeros((n, n))]])
    H = StateSpaceModel([], [], [], D, 0.0, ins[n:] + ins[:n], outs[n:] + outs[:n])
    return DelayedModel(H, [length for length, _ in delays])


def _held_bank(delays: list[tuple[float, float]], signals: Sequence[Signal], order: int) -> UncertainModel:
    """Return a diagonal set that holds the delays of each signal; to 12 digits, which the weights cover."""
    parts = [
        covering(float(f"{(a + b) / 2:.12g}"), float(f"{(b - a) / 2:.12g}"), order, 3, f"{s.name}: ")
        if b
        else as_uncertain(1.0)
        for (a, b), s in zip(delays, signals, strict=True)
    ]
    n = len(parts)
    return interconnected(parts, Wiring(np.zeros((n, n)), np.eye(n), np.eye(n)), signals, signals, "with_delays")


def _shifts(delays: list[tuple[float, float]], dt: float) -> StateSpaceModel:
    """Return a diagonal model of chains of z^-1, one for each channel."""
    parts: list[StateSpaceModel] = []
    for i, (length, _) in enumerate(delays):
        samples = length / dt
        text = f"{length:g} s is {samples:.6g} samples of {dt:g} s"
        if not samples < MOST_SAMPLES + 0.5:
            raise InputError("with_delays", text, f"at most {MOST_SAMPLES}")
        count = round(samples)
        if abs(samples - count) > WHOLE * max(count, 1):
            raise InputError("with_delays", text, "a whole number of samples", "delay the continuous model")
        b, c = np.eye(count, 1), np.eye(1, count, count - 1) if count else np.zeros((1, 0))
        names = [f"delay{i + 1}.{k + 1}" for k in range(count)]
        parts.append(StateSpaceModel(np.eye(count, k=-1), b, c, [[float(not count)]], dt, [f"i{i}"], [f"o{i}"], names))
    return append(*parts)
