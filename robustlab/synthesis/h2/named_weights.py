"""Weights and noises by the names of signals, as a person states them: the matrices of `rl.lqi` and `rl.kalman`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.checks import number
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.synthesis.problem.partition import signal_positions

__all__ = ["diagonal_weight", "integral_weights", "process_noise"]


def diagonal_weight(sizes: Mapping[str, float], known: Sequence[str], where: str) -> AnyArray:
    """Diagonal matrix with a size for each known name, zero for those that are not given.

    Raises
    ------
    InputError
        A name that is not known, or a size that is negative or not finite.
    """
    diagonal = np.zeros(len(known))
    for at, (name, size) in zip(signal_positions(list(sizes), known, where), sizes.items(), strict=True):
        number(f"{where} {name!r}", size, "a number that is not negative", at_least=0)
        diagonal[at] = size
    return np.diag(diagonal)


def process_noise(model: StateSpaceModel, sizes: Mapping[str, float], where: str) -> AnyArray:
    r"""Intensity W of the noise on the states: given for states, and for inputs, which it enters through B.

    .. math:: W = \mathrm{diag}(w_x) + B \, \mathrm{diag}(w_u) B^T

    Raises
    ------
    InputError
        As `diagonal_weight`; a name that a state and an input share.
    """
    states, inputs = model.state_names, model.input_names
    both = [name for name in sizes if name in states and name in inputs]
    if both:
        raise InputError(f"{where} {both[0]!r}", "a state and an input of that name", "names that differ")
    all_sizes = np.diag(diagonal_weight(sizes, [*states, *inputs], where))
    at_states, at_inputs = all_sizes[: len(states)], all_sizes[len(states) :]
    return np.diag(at_states) + model.B * at_inputs @ model.B.T


def integral_weights(
    model: StateSpaceModel, followed: Mapping[str, float], states: Mapping[str, float], controls: Mapping[str, float]
) -> tuple[AnyArray, AnyArray]:
    """Q and R of `rl.lqi`: on the states, then on the integrals of the followed outputs; 1 on controls left out."""
    of_states = np.diag(diagonal_weight(states, model.state_names, "weight on state"))
    of_outputs = np.diag(diagonal_weight(followed, list(followed), "weight on output"))
    every = dict.fromkeys(model.input_names, 1.0) | dict(controls)
    return np.diag([*of_states, *of_outputs]), diagonal_weight(every, model.input_names, "weight on control")
