r"""A small set that contains every element-wise member: one full block for each of A, B, C, D that differ.

With E the differences of one matrix and :math:`|\delta_{ij}| \le 1` for each entry by itself,

.. math:: \|E \circ \delta\| \le \| |E| \| = s, \qquad \text{so } E \circ \delta = s\, \Delta, \quad \|\Delta\| \le 1

on the rows and columns in which the models differ: the norm of a matrix is at most that of its entries' magnitudes.
What is proved for this set holds for ``elementwise(..., "elements")``; it costs two scalings, not dozens. The price is
that members come in which no entries can make, complex and dynamic ones among them: it is small where the models are
close to each other.

References
----------
Horn, Johnson, *Matrix Analysis* (2013), theorem 8.1.18 (norms of entrywise dominated matrices).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.uncertainty.blocks import FullBlock
from robustlab.uncertainty.lft import UncertainModel


def elementwise_cover(nominal: Any, perturbed: Any) -> UncertainModel:
    """The set above, with blocks ``A``, ``B``, ``C``, ``D`` as far as the two models differ there.

    ``nominal``, ``perturbed``: two models of equal sizes, sample time and signals.
    Raises InputError: sizes, sample times or signal names differ.

    Examples
    --------
    >>> B, C, D = [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
    >>> nominal = StateSpaceModel([[-1.0, 2.0], [0.0, -3.0]], B, C, D)
    >>> perturbed = StateSpaceModel([[-1.0, 2.5], [0.0, -3.4]], B, C, D)
    >>> cover = elementwise_cover(nominal, perturbed)
    >>> [(b.name, b.rows, b.cols) for b in cover.blocks], cover.evaluate({"A": [[1.0], [0.0]]}).A[0, 1].round(3)
    ([('A', 2, 1)], np.float64(2.64))
    """
    where = "elementwise_cover"
    first, second = as_model(nominal, f"{where}: nominal"), as_model(perturbed, f"{where}: perturbed")
    for kind in ("A", "D"):
        if getattr(first, kind).shape != getattr(second, kind).shape:
            found = f"{kind} is {getattr(second, kind).shape}"
            raise InputError(f"{where}: perturbed", found, f"{getattr(first, kind).shape}, as in the nominal model")
    names = [(m.input_names, m.output_names, m.state_names, m.dt) for m in (first, second)]
    if names[0] != names[1]:
        raise InputError(
            where, "other signals or another sample time in the perturbed model", "those of the nominal one"
        )
    n, n_u, n_y = first.n_states, first.n_inputs, first.n_outputs
    w_x, w_y, z_x, z_u, blocks = [], [], [], [], []
    for kind, into, out in (("A", "x", "x"), ("B", "x", "u"), ("C", "y", "x"), ("D", "y", "u")):
        size = np.abs(getattr(second, kind) - getattr(first, kind))
        rows, columns = np.flatnonzero(size.any(axis=1)), np.flatnonzero(size.any(axis=0))
        if not len(rows):
            continue
        root = float(np.sqrt(np.linalg.norm(size, 2)))
        left = root * np.eye(n if into == "x" else n_y)[:, rows]
        right = root * np.eye(n if out == "x" else n_u)[columns]
        w_x.append(left if into == "x" else np.zeros((n, len(rows))))
        w_y.append(left if into == "y" else np.zeros((n_y, len(rows))))
        z_x.append(right if out == "x" else np.zeros((len(columns), n)))
        z_u.append(right if out == "u" else np.zeros((len(columns), n_u)))
        blocks.append(FullBlock(kind, len(rows), len(columns)))
    if not blocks:
        return UncertainModel(first, [])
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    M = StateSpaceModel(
        first.A,
        np.hstack([*w_x, first.B]),
        np.vstack([*z_x, first.C]),
        np.block([[np.zeros((p, q)), np.vstack(z_u)], [np.hstack(w_y), first.D]]),
        first.dt,
        [*(f"w_{b.name}_{i + 1}" for b in blocks for i in range(b.rows)), *first.inputs],
        [*(f"z_{b.name}_{i + 1}" for b in blocks for i in range(b.cols)), *first.outputs],
        first.states,
        where=where,
    )
    return UncertainModel(M, blocks)
