r"""A set of perturbed coprime factors that holds every model of a set, whatever its unstable poles and zeros.

With the normalised left coprime factors :math:`G_i = \tilde M_i^{-1} \tilde N_i` of every model, all of them stable,

.. math:: G_i = (\tilde M + \Delta_M)^{-1} (\tilde N + \Delta_N), \qquad [\Delta_N\; \Delta_M] = [\tilde N_i\; \tilde
   M_i] - [\tilde N\; \tilde M] = w \Delta_i, \qquad \|\Delta_i\|_\infty \le 1

is an additive error of stable models, and is covered as such: proved over all frequencies. Neither the number of
unstable poles nor that of zeros in the right half plane need be the same.

References
----------
Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), section 9.2 and table 9.1; McFarlane, Glover, *Robust
Controller Design Using Normalized Coprime Factor Plant Descriptions* (1990).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robustlab.errors import InputError
from robustlab.signals import Signal
from robustlab.statespace import StateSpaceModel, append
from robustlab.uncertainty.blocks import FullBlock
from robustlab.uncertainty.covering.overbound import anonymous
from robustlab.uncertainty.covering.unstructured_cover import UnstructuredCover, unstructured_cover
from robustlab.uncertainty.distances.coprime import coprime_factors
from robustlab.uncertainty.lft import UncertainModel

NAME = "coprime"


def coprime_cover(
    models: tuple[StateSpaceModel, ...], nominal: StateSpaceModel | None, order: int, tolerance: float
) -> UnstructuredCover:
    """The cover of continuous models with the same signals; parameters and result as of `unstructured_cover`.

    Raises InputError: discrete models; NoTrustworthyNumber: an unstable mode of a model is hidden from its inputs or
    its outputs.
    """
    given = (*models, *([] if nominal is None else [nominal]))
    factors = tuple(factors_of(m, i) for i, m in enumerate(given))
    centre = None if nominal is None else factors[-1]
    made = unstructured_cover(factors[: len(models)], "additive", centre, order, tolerance)
    number = made.nominal
    chosen = nominal if number is None else models[number - 1]
    assert chosen is not None
    left = factors[-1] if number is None else factors[number - 1]
    return dataclasses.replace(made, model=_perturbed(chosen, left, made.fit.weight))


def factors_of(model: StateSpaceModel, number: int = 0) -> StateSpaceModel:
    """``[N~, M~]`` from (u, y), normalised; its states are named after the model.

    Raises InputError: a discrete model.
    """
    if model.is_discrete:
        hint = "rl.d2c gives the continuous models of held ones"
        raise InputError("cover: form coprime", f"discrete models, dt = {model.dt:g} s", "continuous ones", hint)
    left = coprime_factors(model).left
    ins = [f"u{k}" for k in range(model.n_inputs)] + [f"y{k}" for k in range(model.n_outputs)]
    outs, states = [f"e{k}" for k in range(model.n_outputs)], [f"m{number}.x{k}" for k in range(left.n_states)]
    return StateSpaceModel(left.A, left.B, left.C, left.D, 0.0, ins, outs, states)


def _perturbed(model: StateSpaceModel, left: StateSpaceModel, weight: StateSpaceModel) -> UncertainModel:
    """``y = M~^-1 (N~ u + e)``, ``e = w Delta [u; -y]``, in the states of the factors, then those of the weights."""
    m, p, n = model.n_inputs, model.n_outputs, left.n_states
    bank = anonymous(append(*(weight.renamed([f"u{k}"], [f"y{k}"]) for k in range(p))))
    B_u, B_y, D_u, D_y = left.B[:, :m], left.B[:, m:], left.D[:, :m], left.D[:, m:]
    root = np.linalg.inv(D_y)
    # rows on (x, weights, w, u): e, then y, then the rates
    e = np.hstack([np.zeros((p, n)), bank.C, bank.D, np.zeros((p, m))])
    on_u = np.hstack([np.zeros((m, n + bank.n_states + p)), np.eye(m)])
    on_x = np.hstack([left.C, np.zeros((p, bank.n_states + p + m))])
    y = root @ (on_x + D_u @ on_u + e)
    own = np.hstack([left.A, np.zeros((n, bank.n_states + p + m))])
    rates = np.vstack(
        [
            own + B_u @ on_u - B_y @ y,
            np.hstack([np.zeros((bank.n_states, n)), bank.A, bank.B, np.zeros((bank.n_states, m))]),
        ]
    )
    outputs = np.vstack([on_u, -y, y])
    k = n + bank.n_states
    names = [f"{NAME}.w{i + 1}" for i in range(p)], [f"{NAME}.z{i + 1}" for i in range(m + p)]
    states = [*(Signal(f"{NAME}.f{i + 1}") for i in range(n)), *(Signal(f"{NAME}.x{i + 1}") for i in range(k - n))]
    M = StateSpaceModel(
        rates[:, :k], rates[:, k:], outputs[:, :k], outputs[:, k:], 0.0,
        [*names[0], *model.inputs], [*names[1], *model.outputs], states, where="cover: form coprime",
    )  # fmt: skip
    return UncertainModel(M, [FullBlock(NAME, p, m + p)], model.operating_point)
