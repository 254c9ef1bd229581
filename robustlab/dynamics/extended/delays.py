"""Delays that come with their signals' effects: rational ones, and a block for what these miss; lags of first order."""
# Wang, Lundström, Skogestad, "Representation of uncertain time delays in the H-infinity framework", Int. J. Control 59
# (1994).

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robustlab.arrays import Array
from robustlab.delays.channels import covering
from robustlab.delays.pade import checked_order
from robustlab.delays.pade import pade as rational_delay
from robustlab.errors import InputError
from robustlab.statespace import OperatingPoint, StateSpaceModel, append, series
from robustlab.uncertainty.blocks import FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel

# The order of a model's rational delays: more states than that say nothing new.
HIGHEST_PADE = 8


def delayed(model: StateSpaceModel, delays: Mapping[str, list[float]], order: int) -> StateSpaceModel:
    """The model with the delays of its inputs and outputs as rational ones."""
    before, after = (_bank(delays[side], order) for side in ("input", "output"))
    whole = series(series(before, model), after)
    names = [
        (f"delay_{side}_{s.name}_{i + 1}", "")
        for side, signals in (("input", model.inputs), ("output", model.outputs))
        for s, delay in zip(signals, delays[side], strict=True)
        for i in range(order if delay else 0)
    ]
    first = before.n_states
    states = [*names[:first], *model.states, *names[first:]]
    point = model.operating_point
    assert point is not None
    settled = [_settled(bank, levels) for bank, levels in ((before, point.u), (after, point.y))]
    x = np.concatenate([settled[0], point.x, settled[1]])
    return StateSpaceModel(
        whole.A, whole.B, whole.C, whole.D, 0.0, model.inputs, model.outputs, states,
        OperatingPoint(x, point.u, point.y), "delays",
    )  # fmt: skip


def _bank(delays: list[float], order: int) -> StateSpaceModel:
    unit = StateSpaceModel([], [], [], [[1.0]])
    channels = [rational_delay(delay, order) if delay else unit for delay in delays]
    return append(*(m.renamed([f"u{k}"], [f"y{k}"]) for k, m in enumerate(channels)))


def _settled(bank: StateSpaceModel, levels: Array) -> Array:
    """States of the bank at constant inputs."""
    return np.asarray(-np.linalg.solve(bank.A, bank.B @ levels), dtype=np.float64)


def lagged(model: StateSpaceModel, lags: Mapping[int, float]) -> StateSpaceModel:
    """The model behind first-order lags of some of its inputs: number of the input -> time constant in s."""
    unit = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1)
    channels = [
        StateSpaceModel([[-1.0 / lags[k]]], [[1.0 / lags[k]]], [[1.0]], [[0.0]])
        if k in lags
        else StateSpaceModel(*unit)
        for k in range(model.n_inputs)
    ]
    bank = append(*(m.renamed([f"u{k}"], [f"y{k}"]) for k, m in enumerate(channels)))
    whole, point = series(bank, model), model.operating_point
    assert point is not None
    states = [*((f"lag_{model.inputs[k].name}", model.inputs[k].unit) for k in sorted(lags)), *model.states]
    x = np.concatenate([point.u[sorted(lags)], point.x])
    return StateSpaceModel(
        whole.A, whole.B, whole.C, whole.D, 0.0, model.inputs, model.outputs, states,
        OperatingPoint(x, point.u, point.y), "lags",
    )  # fmt: skip


def lag_block(time: float, spread: float, name: str) -> UncertainModel:
    """All lags :math:`1 / (1 + s T)` with T within ``spread`` of ``time``, in s, exactly."""
    if not 0.0 <= spread < time:
        raise InputError(f"lag {name}", f"{time:g} s +- {spread:g} s", "a time constant that stays positive")
    a = -1.0 / time
    if not spread:
        return UncertainModel(StateSpaceModel([[a]], [[-a]], [[1.0]], [[0.0]]), [])
    model = StateSpaceModel([[a]], [[a * spread, -a]], [[a], [1.0]], [[a * spread, -a], [0.0, 0.0]])
    return UncertainModel(model, [RealScalar(name, 1, ParameterRange(time, spread, "s"))])


def delay_block(delay: float, spread: float, pade: int, name: str, origin: str = "") -> UncertainModel:
    r"""All delays from ``delay - spread`` (at least 0) to ``delay + spread`` as :math:`P + w \Delta`."""
    if not 0 < delay < np.inf or not 0 <= spread < np.inf:
        raise InputError("delay_block", f"{delay:g} s +- {spread:g} s", "a positive delay, a spread of 0 s or more")
    n = checked_order(pade, "delay_block", 1)
    # The slope of what is missed changes from 1 to 2 n + 1 where there is a spread: a lower order follows that better.
    made = covering(delay, spread, n, n + 1 if spread else min(n + 2, 2 * n + 1))
    return UncertainModel(made.M, [FullBlock(name, 1, 1, origin=origin, covers=made.blocks[0].covers)])
