"""The smallest set of real parameters, of a chosen form, that contains every model of a set."""

# S_i = S_0 + sum_j delta_ij E_j, |delta_ij| <= 1, S = [A B; C D]. "elements": the interval hull, each differing entry
# is a parameter. "pca": the E_j are the principal components of the models, scaled to their extent, and S_0 is the
# middle of that box.

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from robustlab.arrays import Array
from robustlab.checks import number, whole
from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import ParameterRange, RealScalar
from robustlab.uncertainty.covering.unstructured_cover import model_of, system_matrices
from robustlab.uncertainty.elementwise import elementwise, entry_scale
from robustlab.uncertainty.lft import UncertainModel

ParametricForm = Literal["elements", "pca"]
PARAMETRIC_FORMS: tuple[ParametricForm, ...] = get_args(ParametricForm)

ROUNDING = 1e-13  # relative difference of equal entries, from the rounding of a linearisation


Made = tuple[UncertainModel, tuple[dict[str, float], ...], tuple[float, ...]]  # the set, deltas of the models, spread


def parametric_cover(
    models: tuple[StateSpaceModel, ...],
    form: ParametricForm,
    nominal: StateSpaceModel | None = None,
    tolerance: float = 1e-9,
    directions: int | None = None,
) -> Made:
    """Return the cover of models with the same states, the parameter values of each, and their principal extents."""
    number("cover: tolerance", tolerance, "a number in [0, 1)", at_least=0, below=1)
    if directions is not None:
        whole("cover: directions", directions, 1)
    if form == "elements":
        if directions is not None:
            raise InputError("cover: directions", f"{directions} with form elements", "form pca")
        return _hull(models, nominal, tolerance)
    if nominal is not None:
        raise InputError("cover: nominal", f"a nominal model for form {form}", "none: it is the middle of the box")
    return _directions(models, tolerance, directions)


def _hull(models: tuple[StateSpaceModel, ...], nominal: StateSpaceModel | None, tolerance: float) -> Made:
    stack = system_matrices(models)
    low, high = stack.min(axis=0), stack.max(axis=0)
    allowance = max(tolerance, ROUNDING) * entry_scale(np.abs(stack).max(axis=0), models[0].n_states)
    still = high - low <= allowance
    if nominal is None:
        middle, above = 0.5 * (low + high), 0.5 * (high - low)
        below = above
    else:
        (middle,) = system_matrices([nominal])
        inside = (low < middle) & (middle < high)
        furthest = np.maximum(np.abs(high - middle), np.abs(middle - low))
        above, below = np.where(inside, high - middle, furthest), np.where(inside, middle - low, furthest)
        still &= furthest <= allowance
    above, below = np.where(still, 0.0, above), np.where(still, 0.0, below)
    first = models[0] if nominal is None else nominal
    centre = model_of(middle, first)
    made = elementwise(centre, model_of(middle + above, first), "elements")
    at = _entries(middle + above - middle, first.n_states)
    blocks = [
        RealScalar(b.name, b.rows, ParameterRange(float(middle[i, j]), float(above[i, j]), "", float(below[i, j])))
        for b, (i, j) in zip(made.blocks, at, strict=True)
    ]
    whole = UncertainModel(made.M, blocks, made.operating_point)
    deltas = tuple(
        {
            b.name: float(np.clip(b.parameter.delta(float(s[i, j])), -1.0, 1.0))
            for b, (i, j) in zip(blocks, at, strict=True)
            if b.parameter is not None
        }
        for s in stack
    )
    return whole, deltas, ()


def _entries(e: Array, n: int) -> list[tuple[int, int]]:
    """Return the non-zero entries in the order of the blocks of `elementwise`: those of A, of B, of C, of D."""
    parts = ((0, 0, e[:n, :n]), (0, n, e[:n, n:]), (n, 0, e[n:, :n]), (n, n, e[n:, n:]))
    return [(int(i) + row, int(j) + col) for row, col, part in parts for i, j in np.argwhere(part)]


def _directions(models: tuple[StateSpaceModel, ...], tolerance: float, directions: int | None) -> Made:
    stack = system_matrices(models)
    scale = entry_scale(np.abs(stack).max(axis=0), models[0].n_states)
    scale[scale == 0] = 1.0
    middle = stack.mean(axis=0)
    cloud = ((stack - middle) / scale).reshape(len(models), -1)
    cloud[:, np.ptp(cloud, axis=0) <= ROUNDING] = 0.0
    _, _, axes = np.linalg.svd(cloud, full_matrices=False)
    coordinates = cloud @ axes.T
    count = _needed(cloud, axes, max(tolerance, ROUNDING)) if directions is None else min(directions, len(axes))
    reach = 0.5 * np.ptp(coordinates, axis=0)
    kept = axes[:count]
    along = cloud @ kept.T
    centre, half = 0.5 * (along.max(axis=0) + along.min(axis=0)), 0.5 * np.ptp(along, axis=0)
    order = np.argsort(-half, kind="stable")
    order = order[half[order] > ROUNDING]
    kept, along, centre, half = kept[order], along[:, order], centre[order], half[order]
    nominal = model_of(middle + scale * (centre @ kept).reshape(scale.shape), models[0])
    (start,) = system_matrices([nominal])
    names = [f"direction{j + 1}" for j in range(len(half))]
    ends = {
        name: model_of(start + scale * (half[j] * kept[j]).reshape(scale.shape), models[0])
        for j, name in enumerate(names)
    }
    made = elementwise(nominal, ends) if ends else UncertainModel(nominal, [])
    share = np.clip((along - centre) / half, -1.0, 1.0)
    deltas = tuple({name: float(share[i, j]) for j, name in enumerate(names)} for i in range(len(models)))
    spread = (*half.tolist(), *(r for r in reach[count:].tolist() if r > ROUNDING))
    return made, deltas, spread


def _needed(cloud: Array, axes: Array, tolerance: float) -> int:
    """Return the fewest principal components that represent every entry of every model within the tolerance."""
    rest = cloud.copy()
    for count in range(len(axes)):
        if np.abs(rest).max(initial=0.0) <= tolerance:
            return count
        rest = rest - np.outer(rest @ axes[count], axes[count])
    return len(axes)
