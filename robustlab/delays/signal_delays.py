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
from robustlab.uncertainty.interconnection import Wiring, unique_names
from robustlab.uncertainty.lft import UncertainModel, as_uncertain, interconnected, product

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
    order: int | None = None,
    weight_order: int | None = None,
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
    order, weight_order
        Of a set: orders of the approximations and of the weights of their error, 3 by default; see
        `DelayedModel.uncertain`.

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
    ranges = any(np.ndim(length) for side in (inputs, outputs) for length in (side or {}).values())
    if ranges or isinstance(G, UncertainModel):
        orders = {"order": order, "weight_order": weight_order}
        return uncertain_delays(G, inputs, outputs, **{key: n for key, n in orders.items() if n is not None})
    if order is not None or weight_order is not None:
        found = "given with exact delays"
        raise InputError(f"with_delays: {'weight_order' if order is None else 'order'}", found, "a range of delays")
    model = G if isinstance(G, DelayedModel) else as_model(G, "with_delays")
    before, _ = _ranges("input", inputs, model.input_names, "with_delays")
    after, _ = _ranges("output", outputs, model.output_names, "with_delays")
    if isinstance(model, StateSpaceModel) and model.is_discrete:
        whole = series(series(_shifts(before, model.dt), model), _shifts(after, model.dt))
        return whole.renamed(model.inputs, model.outputs)
    return _bank(after, model.outputs) @ as_delayed(model) @ _bank(before, model.inputs)


def uncertain_delays(
    G: Any,
    inputs: Mapping[Any, float | Sequence[float]] | None = None,
    outputs: Mapping[Any, float | Sequence[float]] | None = None,
    order: int = 3,
    weight_order: int = 3,
) -> UncertainModel:
    """A set that holds the model with its delays, exact or within a range; see `with_delays`."""
    model = (
        G.uncertain(order, weight_order=weight_order) if isinstance(G, DelayedModel) else as_uncertain(G, "with_delays")
    )
    if model.dt:
        raise InputError("with_delays", f"a discrete model, dt = {model.dt:g} s", "a continuous one")
    banks: list[UncertainModel] = []
    for side, given, signals in (("input", inputs, model.inputs), ("output", outputs, model.outputs)):
        low, high = _ranges(side, given, tuple(s.name for s in signals))
        parts = [
            covering(_rounded(0.5 * (a + b)), _rounded(0.5 * (b - a)), order, weight_order, name=f"{s.name}: ")
            if b
            else as_uncertain(1.0)
            for a, b, s in zip(low, high, signals, strict=True)
        ]
        n = len(parts)
        wiring = Wiring(np.zeros((n, n)), np.eye(n), np.eye(n))
        banks.append(interconnected(parts, wiring, signals, signals, "with_delays"))
    whole = product(banks[1], product(model, banks[0]))
    return UncertainModel(whole.M, whole.blocks)


# --- ranges and banks -------------------------------------------------------------------------------------------------


def _ranges(
    side: str, given: Mapping[Any, Any] | None, names: tuple[str, ...], where: str = "with_delays"
) -> tuple[list[float], list[float]]:
    """Shortest and longest delay of each signal; zero where none is given."""
    low, high = [0.0] * len(names), [0.0] * len(names)
    for key, value in (given or {}).items():
        number = isinstance(key, (int, np.integer)) and not isinstance(key, bool)
        if not (key in names or (number and 0 <= int(key) < len(names))):
            raise InputError(f"{where}: {side} {key!r}", "no such signal", f"one of {', '.join(names)}")
        ends = tuple(value) if isinstance(value, (tuple, list)) else (value, value)
        real = all(isinstance(v, (int, float, np.number)) and not isinstance(v, bool) for v in ends)
        if not real or len(ends) != 2 or not 0 <= ends[0] <= ends[1] <= 1 / SHORTEST:
            raise InputError(f"{where}: {side} {key!r}", f"{value!r}", "a delay of 0 s or more, or a range of such")
        place = int(key) if number else names.index(str(key))
        low[place], high[place] = float(ends[0]), float(ends[1])
    return low, high


def _rounded(length: float) -> float:
    """Round to 12 digits, which the weights cover."""
    return float(f"{length:.12g}")


def _bank(lengths: list[float], signals: Sequence[Signal]) -> DelayedModel:
    """Return a diagonal model of delays, one for each signal."""
    n, eye = len(lengths), np.eye(len(lengths))
    ins, outs = (unique_names([*signals, *(Signal(f"{side}{k + 1}") for k in range(n))]) for side in "wz")
    D = np.block([[np.zeros((n, n)), eye], [eye, np.zeros((n, n))]])
    return DelayedModel(StateSpaceModel([], [], [], D, 0.0, ins[n:] + ins[:n], outs[n:] + outs[:n]), lengths)


def _shifts(lengths: list[float], dt: float) -> StateSpaceModel:
    """Return a diagonal model of chains of z^-1, one for each channel."""
    parts: list[StateSpaceModel] = []
    for i, length in enumerate(lengths):
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
