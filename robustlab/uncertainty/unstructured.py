r"""Unstructured uncertainty: one full block between two weights, in six places of the loop.

With :math:`E = W_1 \Delta W_2` and :math:`\bar\sigma(\Delta) \le 1` the members of the set are

================================  ======================================  ============================================
form                              member                                  M (Delta channels first; no weights)
================================  ======================================  ============================================
``additive``                      :math:`G + E`                           :math:`[0, I;\; I, G]`
``input-multiplicative``          :math:`G (I + E)`                       :math:`[0, I;\; G, G]`
``output-multiplicative``         :math:`(I + E) G`                       :math:`[0, G;\; I, G]`
``inverse-additive``              :math:`(G^{-1} + E)^{-1}`               :math:`[-G, G;\; -G, G]`
``inverse-input-multiplicative``  :math:`G (I + E)^{-1}`                  :math:`[-I, I;\; -G, G]`
``inverse-output-multiplicative`` :math:`(I + E)^{-1} G`                  :math:`[-I, G;\; -I, G]`
================================  ======================================  ============================================

The inverse additive member is :math:`(I + G E)^{-1} G`, which needs no inverse of G and holds for any shape.
Březina 2010, sections 4.2.1, 4.2.3. The thesis gives the M of the inverse input form for the formula
:math:`G_p^{-1} = G^{-1} (I + \Delta)`, which is the inverse output form; here each has its own M.
Zhou, Doyle, Glover, *Robust and Optimal Control* (1996), table 9.1.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np

from robustlab.checks import choice
from robustlab.errors import InputError, error_context
from robustlab.linear_analysis.matrices import of_system_matrix
from robustlab.statespace import Signal, StateSpaceModel, append, as_model
from robustlab.uncertainty.blocks import FullBlock
from robustlab.uncertainty.lft import UncertainModel, as_uncertain

Form = Literal[
    "additive",
    "input-multiplicative",
    "output-multiplicative",
    "inverse-additive",
    "inverse-input-multiplicative",
    "inverse-output-multiplicative",
]
FORMS: tuple[Form, ...] = get_args(Form)
AT_INPUT = ("input-multiplicative", "inverse-input-multiplicative", "inverse-additive")  # where E acts before G


@error_context("unstructured")
def unstructured(
    G: Any, W2: Any = 1.0, form: Form = "additive", *, W1: Any = None, name: str = "unmodelled"
) -> UncertainModel:
    r"""Return the set of all models near G in one of six forms, with one full block.

    Parameters
    ----------
    G
        Nominal model (p outputs, m inputs), stable or not, continuous or discrete; need not be square.
    W2
        Weight at the right of Delta, whose inputs are those of E: m for the additive and the input forms, p for the
        inverse additive and the output forms. A number or a scalar model is the weight of all channels, a list of such
        a diagonal weight, a larger model a matrix weight. Stable; it bounds ``|E|`` at each frequency.
    form
        See the table of this module.
    W1
        Weight at the left of Delta, whose outputs are those of E: p for the additive and the output forms, m for the
        inverse additive and the input forms; 1 by default.
    name
        Name of the block.

    Returns
    -------
    UncertainModel
        Its states are those of G, W1, W2, each once; its block has as many rows as W1 has inputs and as many columns as
        W2 has outputs.

    Raises
    ------
    InputError
        An unstable weight, sizes or sample times that do not fit, an unknown form.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> member = unstructured(lag, 0.2, "input-multiplicative").evaluate({"unmodelled": 1.0})
    >>> float(member.dc_gain()[0, 0])
    1.2
    """
    g = as_model(G, "unstructured: G")
    choice("unstructured: form", form, FORMS)
    from_input = form in ("additive", "input-multiplicative", "inverse-input-multiplicative")
    size_out, size_in = (g.n_inputs if side else g.n_outputs for side in (form in AT_INPUT, from_input))
    left = _weight(1.0 if W1 is None else W1, size_out, "outputs", "unstructured: W1")
    right = _weight(W2, size_in, "inputs", "unstructured: W2")
    times = {m.dt for m in (g, left, right) if m.n_states or m.dt}
    if len(times) > 1:
        raise InputError("unstructured", f"sample times {sorted(times)} s (0: continuous)", "one for G and weights")
    M = _interconnection(g, left, right, form, times.pop() if times else 0.0, name)
    return UncertainModel(M, [FullBlock(name, left.n_inputs, right.n_outputs)], g.operating_point)


def _weight(given: Any, size: int, side: Literal["inputs", "outputs"], where: str) -> StateSpaceModel:
    """Return the weight as a stable model with ``size`` inputs (or outputs)."""
    several = isinstance(given, (list, tuple))
    read = [(f"{where}[{i}]", part) for i, part in enumerate(given)] if several else [(where, given)]
    parts = [as_uncertain(part, name).nominal for name, part in read]
    single = all(part.D.shape == (1, 1) for part in parts)
    if several and len(parts) != size:
        raise InputError(where, f"{len(parts)} channels", f"{size}, or one weight for all")
    if several and not single:
        raise InputError(where, "a weight of several channels in a list", "one input and one output each")
    if single and not several:
        parts *= size
    weight = append(*(part.renamed([f"u{i}"], [f"y{i}"]) for i, part in enumerate(parts))) if single else parts[0]
    if len(getattr(weight, side)) != size:
        raise InputError(where, f"a weight of {weight.n_outputs} x {weight.n_inputs}", f"{size} {side}")
    if not weight.is_stable():
        poles = weight.poles()
        worst = poles[np.abs(poles).argmax() if weight.is_discrete else poles.real.argmax()]
        raise InputError(where, f"unstable weight (pole {worst.real:.6g}{worst.imag:+.6g}j)", "a stable weight")
    return weight


def _interconnection(
    g: StateSpaceModel, left: StateSpaceModel, right: StateSpaceModel, form: Form, dt: float, name: str
) -> StateSpaceModel:
    """Return M from (w, u) to (z, y), each signal as a matrix on (states of G, W1, W2; w; u)."""
    ends = np.cumsum([0, g.n_states, left.n_states, right.n_states, left.n_inputs, g.n_inputs])
    n, unit = ends[3], np.eye(ends[-1])
    x_g, x_1, x_2, w, u = (unit[first:last] for first, last in itertools.pairwise(ends))
    e = (-1.0 if form.startswith("inverse") else 1.0) * (left.C @ x_1 + left.D @ w)
    at_input = form in AT_INPUT
    v = u + e if at_input else u
    through = g.C @ x_g + g.D @ v
    y = through if at_input else through + e
    # Input of Delta: the signal before the point where E acts, for inverse forms after it.
    after = {"output": through, "inverse-additive": y, "inverse-input": v, "inverse-output": y}
    seen = after.get(form.removesuffix("-multiplicative"), u)
    rates = np.vstack([g.A @ x_g + g.B @ v, left.A @ x_1 + left.B @ w, right.A @ x_2 + right.B @ seen])
    outputs = np.vstack([right.C @ x_2 + right.D @ seen, y])
    inputs = [*_channels(f"{name}.w", left.n_inputs, g.input_names), *g.inputs]
    shown = [*_channels(f"{name}.z", right.n_outputs, g.output_names), *g.outputs]
    states = [*g.states, *(Signal(f"{name}.x{i + 1}") for i in range(n - g.n_states))]
    return of_system_matrix(np.vstack([rates, outputs]), int(n), dt, inputs, shown, states, "unstructured")


def _channels(prefix: str, count: int, taken: Sequence[str]) -> list[Signal]:
    names = [f"{prefix}{i + 1}" for i in range(count)]
    clash = sorted(set(names) & set(taken))
    if clash:
        raise InputError("unstructured", f"signal name {clash[0]!r} is used twice", "another name for the block")
    return [Signal(text) for text in names]
