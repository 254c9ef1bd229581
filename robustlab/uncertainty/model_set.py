r"""A set of models of the same machine: operating points, units, seeds, or fits to several records.

The models are compared entry by entry of

.. math:: S_i = \begin{bmatrix} A_i & B_i \\ C_i & D_i \end{bmatrix}

which only means something where all have the same states; covers by frequency response ask for the same signals only.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError, RobustlabError
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.elementwise import check_pair

__all__ = ["matrices_miss", "model_set", "system_matrices"]

Array = NDArray[np.float64]


def model_set(models: Iterable[Any], same_states: bool, where: str) -> tuple[StateSpaceModel, ...]:
    """At least two models with the same signals, units and sample time; with ``same_states`` the same states, too.

    Raises
    ------
    InputError
        Fewer than two models, something that is no model, sizes, sample times or signal names that differ.
    UnitMismatch
        A signal carries different units in two of the models.
    """
    if isinstance(models, (StateSpaceModel, str, bytes)) or not isinstance(models, Iterable):
        raise InputError(where, f"{type(models).__name__}", "a list of at least two models")
    found = tuple(as_model(model, f"{where}: model {i + 1}") for i, model in enumerate(models))
    if len(found) < 2:
        raise InputError(where, f"{len(found)} model{'s' * (len(found) != 1)}", "at least two models")
    for i, model in enumerate(found[1:], 2):
        first = found[0] if same_states else _without_states(found[0])
        other = model if same_states else _without_states(model)
        try:
            check_pair(first, other, "model 1", f"model {i}", where)
        except RobustlabError as error:
            same_signals = (model.n_inputs, model.n_outputs) == (first.n_inputs, first.n_outputs)
            if same_states and same_signals and model.n_states != first.n_states:
                hint = "models with different states: cover their frequency responses (form additive, ...)"
                raise InputError(error.where, error.found, error.expected, hint) from None
            raise
    return found


def _without_states(model: StateSpaceModel) -> StateSpaceModel:
    return StateSpaceModel([], [], [], model.D, model.dt, model.inputs, model.outputs)


def system_matrices(models: Iterable[StateSpaceModel]) -> Array:
    """``[A B; C D]`` of each model, shape (n_models, n_x + n_y, n_x + n_u)."""
    return np.array([np.block([[m.A, m.B], [m.C, m.D]]) for m in models])


def matrices_miss(reached: StateSpaceModel, wanted: StateSpaceModel) -> float:
    """Largest difference of an entry, relative to the largest magnitude in its matrix (A, B, C, D) of ``wanted``."""
    worst = 0.0
    for name in "ABCD":
        a, b = getattr(reached, name), getattr(wanted, name)
        miss, size = float(np.abs(a - b).max(initial=0.0)), float(np.abs(b).max(initial=0.0))
        worst = max(worst, 0.0 if miss == 0 else miss / size if size else np.inf)
    return worst
