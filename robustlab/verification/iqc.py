r"""Gain and stability of loops with blocks that vary or are nonlinear: one matrix inequality for all frequencies.

The loop is w = Delta(z), from the model's first inputs and outputs; the others, u and y, are the performance. A real
block is :math:`c z + s h\, \delta(z)`, c and h middle and half width of its range, s the ``size``; other blocks are
s times a unit one. So the unit blocks close the model of `boxes.within_box` with its columns times s.

Theorem (Megretski, Rantzer 1997). Let A be stable with all blocks at their middles. Let the signals
:math:`v_i = C_i x + D_i q` of the model with stable filters, :math:`\dot x = A x + B q`, x(0) = 0, q = (w, u, r), be
those of the constraints in `multipliers`. If for some symmetric P, of either sign,

.. math:: \gamma^2 \begin{bmatrix} 0 & E \end{bmatrix}^T \begin{bmatrix} 0 & E \end{bmatrix}
    - \begin{bmatrix} A^T P + P A & P B \\ B^T P & 0 \end{bmatrix} - \sum_i [C_i\ D_i]^T M_i [C_i\ D_i]
    - [C_y\ D_y]^T [C_y\ D_y] > 0,

E taking u out of q, then :math:`\|y\|_2 \le \gamma \|u\|_2` for every well-posed loop, and the loop is stable. At
:math:`x = (j\omega - A)^{-1} B q` the part with P is zero: this is the strict inequality in the frequency domain. With
each block tau times it is of its class, for tau from 0 to 1, and at tau = 0 the loop is the stable model.

Well posed: let z = C x + D w, w = Delta(t, z) at an instant. A law whose z has no row in D is a function of the state.
For the others only constraints are used that hold for differences of two signals (of a law Zames and Falb's, never the
sector's or Popov's), and the inequality at x = 0 makes the map w - Delta(D w + e) one-to-one with a Lipschitz inverse,
hence onto (invariance of domain). Of laws without a bound of their slope it is assumed that solutions exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flint import arb

from robustlab.errors import InputError
from robustlab.verification.balls import definite, exact, identity, part, stack, zeros
from robustlab.verification.boxes import within_box
from robustlab.verification.claim import PROVED, Claim, Verdict, Work, not_proved, real, scalar, symmetric, whole
from robustlab.verification.forms import FULL, Block, placed, read_shapes
from robustlab.verification.models import Model, model_of
from robustlab.verification.multipliers import (
    SECTOR,
    SLOPE,
    VARYING,
    Filtered,
    Multipliers,
    Nature,
    law,
    linear,
    read_natures,
)
from robustlab.verification.norms import climb
from robustlab.verification.stability import stable

HIGHEST = 8  # power of a filter


def prove_multipliers(claim: Claim, work: Work, gain: bool) -> Verdict:
    """Prove by the theorem that the ``gain`` of the set is at most ``gamma``, or that it is stable at ``size``.

    The model of datasets ``A .. D`` (or a loop) has the channels of ``blocks`` first. ``pole`` is a, ``order`` nu;
    ``multipliers`` holds the numbers of each block's constraints in the order of the text, triangles row by row; ``P``
    belongs to the states of the model, then those of the filters of each block, of z (q) before those of w (p).
    """
    given, table = model_of(claim), read_shapes(claim)
    rows, cols = (sum(row[k] for row in table) for k in (1, 2))
    if given.dt or rows > given.m or cols > given.p or (not gain and (rows, cols) != (given.m, given.p)):
        raise InputError("A .. D", f"{given.p} x {given.m}, dt {given.dt}", f"continuous, with {rows} w and {cols} z")
    blocks = placed(table, [1.0] * len(table))
    natures, order, pole = read_natures(claim, blocks), int(whole(claim, "order", ())), scalar(claim, "pole")
    if not 0 <= order <= HIGHEST:
        raise InputError("order", f"{order}", f"0 to {HIGHEST}")
    size, gamma = (1.0, scalar(claim, "gamma")) if gain else (scalar(claim, "size"), 0.0)
    orders = [nature.order(order) for nature in natures]
    rated = [n.kind == VARYING and k > 0 for n, k in zip(natures, orders, strict=True)]
    kz, kw = ([s.stop - s.start for s in side] for side in ([b.z for b in blocks], [b.w for b in blocks]))
    filters = sum(k * (i + j) for k, i, j in zip(orders, kz, kw, strict=True))
    extra = sum(k * i for k, i, r in zip(orders, kz, rated, strict=True) if r)
    n = given.n + filters
    P, values = symmetric(claim, "P", n), real(claim, "multipliers", (None,))

    def attempt() -> Verdict:
        free = [_free(model_of(claim), block.z, rows) for block in blocks]
        G = _about_the_middles(model_of(claim), blocks, natures, rows, size)
        if G is None:
            return not_proved("the set's middle was not proved to be well posed")
        verdict = stable(G, work)
        if not verdict.proved:
            return verdict
        F, x = Filtered(G, filters, extra), Multipliers(values, work)
        S = zeros(F.width, F.width)
        for i, (block, nature) in enumerate(zip(blocks, natures, strict=True)):
            rho = arb(nature.rate) * 2 / (arb(nature.range[1]) - arb(nature.range[0])) / arb(size) if rated[i] else None
            if nature.kind in (SECTOR, SLOPE):
                S = S + law(F, block, nature, orders[i], pole, free[i], x)
            else:
                S = S + linear(F, block, orders[i], pole, rho, x)
        if x.at != len(values):
            raise InputError("multipliers", f"{len(values)} numbers", f"{x.at}")
        if not x.positive:
            return not_proved("a multiplier was not proved to be one of its class")
        motion = F.units(0, n).transpose() * exact(P) * stack([[rate] for rate in F.rates])
        y, u = F.output(slice(cols, G.p)), F.input(slice(rows, G.m))
        work.spend(F.width)
        form = u.transpose() * u * arb(gamma) ** 2 - motion - motion.transpose() - S - y.transpose() * y
        answer = definite(form)
        if answer.proved:
            return PROVED
        return not_proved(f"the inequality's smallest eigenvalue is {answer.least:.3g} of its size")

    return climb(attempt)


def _free(G: Model, z: slice, w: int) -> tuple[bool, bool]:
    """Test whether the rows z of D are exactly zero: those from the first w inputs, and all."""
    entries = [[x == 0 for x in line] for line in part(G.D, z, slice(None)).tolist()]
    return all(all(line[:w]) for line in entries), all(all(line) for line in entries)


def _about_the_middles(
    G: Model, blocks: Sequence[Block], natures: Sequence[Nature], w: int, size: float
) -> Model | None:
    """Return the model in feedback with the w unit blocks; None where it was not proved to be well posed."""
    z = blocks[-1].z.stop if blocks else 0
    rest = Block(FULL, slice(w, G.m), slice(z, G.p), 1.0)
    inside = within_box(G, [*blocks, rest], [*(n.range for n in natures), (-1.0, 1.0)])
    if inside is None:
        return None
    scale = identity(G.m)
    for i in range(w):
        scale[i, i] = arb(size)
    return replace(inside, B=inside.B * scale, D=inside.D * scale)
