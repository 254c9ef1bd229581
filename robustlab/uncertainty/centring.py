r"""The same set about the middle of its ranges.

A real block whose range is wider on one side fills :math:`[-\rho m, m]` in Delta at level m. Methods that need an
interval around zero get it by an affine change of Delta, which is an LFT:

.. math:: \Delta = C + R \, \Delta', \qquad c = \tfrac{m}{2} (1 - \rho), \quad r = \tfrac{m}{2} (1 + \rho)
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robustlab.errors import InputError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.algebra import upper
from robustlab.uncertainty.blocks import Block, ParameterRange, RealScalar, block_slices
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["centred"]


def centred(uncertain: UncertainModel, level: float = 1.0) -> UncertainModel:
    """The set scaled by ``level``, with every real range symmetric about its own middle.

    Members are the same, their deltas are not: a range [0.75, 1.5] around 1 becomes 1.125 +- 0.375. Block names, full
    and complex blocks stay (the latter scaled by ``level``). The new nominal model is the member at the middles.

    Parameters
    ----------
    level
        Positive: 2 takes each end twice as far from the nominal value.

    Raises
    ------
    InputError
        A level that is not positive and finite.
    NoTrustworthyNumber
        The member at the middles is not well posed.

    Examples
    --------
    >>> from robustlab.uncertainty.parametric import parametric
    >>> lag = parametric([["-1/tau"]], [["1/tau"]], [[1]], [[0]], {"tau": (1.0, 0.75, 1.5)})
    >>> middle = centred(lag)
    >>> middle.blocks[0].parameter
    ParameterRange(nominal=1.125, radius=0.375, unit='', below=None)
    >>> [float(m.evaluate({"tau": -1.0}).A[0, 0].round(12)) for m in (lag, middle)]
    [-1.333333333333, -1.333333333333]
    """
    if isinstance(level, bool) or not isinstance(level, (int, float)) or not 0 < level < np.inf:
        raise InputError("centred", f"level {level!r}", "a positive finite number")
    q, p = uncertain.delta_shape
    centre, scale = np.zeros((q, p)), np.eye(q) * level
    blocks: list[Block] = []
    for block, (w, z) in zip(uncertain.blocks, block_slices(uncertain.blocks), strict=True):
        if not isinstance(block, RealScalar):
            blocks.append(block)
            continue
        middle, half = 0.5 * level * (1.0 - block.ratio), 0.5 * level * (1.0 + block.ratio)
        centre[w, z] = middle * np.eye(block.repeats)
        scale[w, w] = half * np.eye(block.repeats)
        span = block.parameter
        if span is not None:
            span = ParameterRange(span.nominal + span.radius * middle, span.radius * half, span.unit, sign=span.sign)
        blocks.append(dataclasses.replace(block, parameter=span))
    # [z'; w] = [0 I; R C] [w'; z]: Delta' on the outside, the set's channels on the inside
    change = np.block([[np.zeros((p, q)), np.eye(p)], [scale, centre]])
    inside = UncertainModel(StateSpaceModel([], [], [], change), blocks)
    return upper(uncertain.M, inside)
