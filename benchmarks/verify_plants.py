"""Faults planted into the checker, so that a campaign of `verify_attack` that finds nothing is known to be able to.

Each is what a slip of the pen would be: a test left out, a square forgotten, a radius not added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from flint import arb

from robustlab.verification import (
    axis,
    balls,
    boxes,
    checker,
    delay_weights,
    delays,
    forms,
    iqc,
    members,
    models,
    mu,
    multipliers,
    norms,
    parameters,
    sets,
    stability,
)
from robustlab.verification.balls import Definite, exact
from robustlab.verification.claim import PROVED, Claim, refuted


def gaps() -> None:
    """Gaps between intervals are not seen."""

    def covering(claim: Claim, dt: float) -> list[tuple[int, float, float]]:
        low, high = claim.numbers["low"], claim.numbers["high"]
        return [(i, float(a), float(b)) for i, (a, b) in enumerate(zip(low, high, strict=True))]

    mu.covering = covering


def last_interval() -> None:
    """The form of the last interval is not looked at."""
    covering = mu.covering
    mu.covering = lambda claim, dt: covering(claim, dt)[:-1]


def g_structure() -> None:
    """G may be anything."""
    check = forms.check_scalings
    forms.check_scalings = lambda blocks, D_w, D_z, G: check(blocks, D_w, D_z, 0 * G)


def level_not_squared() -> None:
    """The level counts once and not twice."""
    form = forms.scaled_form

    def scaled(blocks: Sequence[Any], *others: Any) -> Any:
        return form([replace(b, level=math.sqrt(b.level)) for b in blocks], *others)

    mu.scaled_form = boxes.scaled_form = scaled


def d_positive() -> None:
    """D_w > 0 is not asked."""

    def scaled(blocks: Sequence[Any], D_w: Any, D_z: Any, G: Any, work: Any) -> forms.Form:
        forms.check_scalings(blocks, D_w, D_z, G)
        L = balls.diagonal([arb(b.level) for b in blocks for _ in range(b.w.start, b.w.stop)])
        return forms.Form(L * exact(D_w) * L, exact(D_z), exact(G) if G.any() else None)

    mu.scaled_form = boxes.scaled_form = scaled


def p_positive() -> None:
    """P > 0 is not asked."""
    definite, seen = norms.definite, [None]

    def remembered(X: Any) -> Any:
        seen[0] = exact(X)
        return seen[0]

    norms.exact = remembered
    norms.definite = lambda F: Definite(True, 1.0) if F is seen[0] else definite(F)
    stability.has_lyapunov = lambda G, P, work: definite(stability.lyapunov_form(G, P)).proved


def undecided() -> None:
    """A comparison of balls that is not decided counts as true."""

    def dominant(Y: Sequence[Any]) -> bool:
        rows = range(Y[0].nrows())
        for i in rows:
            rest = sum((abs(X[i, j]) for k, X in enumerate(Y) for j in rows if k or i != j), arb(0))
            if Y[0][i, i].real <= rest:
                return False
        return True

    balls._dominant = dominant


def real_line() -> None:
    """Real eigenvalues are not looked for."""
    axis._apart = lambda a, b, r: arb(1e300)


def middle() -> None:
    """A box of frequency is judged by its middle."""
    axis.regular_within = lambda H, r: True


def infinity() -> None:
    """High frequencies are not looked at."""
    every = axis._boxes
    axis._boxes = lambda chart, a, b, form, work: PROVED if a < 0 else every(chart, a, b, form, work)


def nyquist() -> None:
    """Intervals of a discrete model may end anywhere."""
    mu.beyond_nyquist = boxes.beyond_nyquist = lambda w, dt: dt > 0


def performance() -> None:
    """The performance block is a thousandth of what it should be."""
    known = checker.as_performance

    def forgotten(claim: Claim) -> Claim:
        made = known(claim)
        level = made.numbers["level"].copy()
        level[-1] *= 1e3
        return Claim(made.kind, {**made.numbers, "level": level})

    checker.as_performance = forgotten


def nominal_stability() -> None:
    """The nominal model is taken for stable."""
    mu.stable = boxes.stable = lambda G, P, work: PROVED


def delta_norm() -> None:
    """The norm of a Delta is not looked at."""
    members.within = lambda *others: True


def delta_structure() -> None:
    """The structure of a Delta is not looked at."""
    members.check_delta = lambda blocks, delta: None


def existence() -> None:
    """That a singular Delta lies next to the given one is believed."""
    members.zero_within = lambda K, directions, work: [arb(0)] * len(directions)


def box_covering() -> None:
    """Boxes may leave out what they like."""
    boxes.uncovered = lambda root, regions, work: None


def box_width() -> None:
    """A box counts as one percent narrower."""
    inside = boxes.within_box

    def narrower(G: Any, blocks: Sequence[Any], sides: Any) -> Any:
        return inside(G, blocks, [(a + 0.005 * (b - a), b - 0.005 * (b - a)) for a, b in sides])

    boxes.within_box = narrower


def controller_sign() -> None:
    """u = -K y."""
    loop = models.loop

    def negative(claim: Claim) -> Any:
        flipped = {name: -np.asarray(claim.numbers[name]) for name in ("K_C", "K_D") if name in claim.numbers}
        return loop(Claim(claim.kind, {**claim.numbers, **flipped}))

    checker.loop = models.loop = negative


def h2_square() -> None:
    """The square of an H2 norm is compared with the norm."""
    scalar = norms.scalar

    def root(claim: Claim, name: str, *, zero: bool = False) -> float:
        value = scalar(claim, name, zero=zero)
        return math.sqrt(value) if name == "value" else value

    norms.scalar = root


def perturbed_end() -> None:
    """A set is compared with the nominal model only."""
    sets.refuted = lambda where: PROVED if "1 differs" in where else refuted(where)


def refutation() -> None:
    """A gain a little below the level refutes it."""
    exceeds = models.gain_exceeds
    norms.gain_exceeds = lambda G, w, gamma: exceeds(G, w, gamma * 0.999)


def hidden_zero() -> None:
    """A ball around zero counts as zero."""
    norms.all = lambda *others: True  # pyright: ignore[reportAttributeAccessIssue]


def stray_band() -> None:
    """A band limits any claim over the axis."""
    known = checker.as_performance

    def limited(claim: Claim) -> Claim:
        kept = {name: x for name, x in claim.numbers.items() if name != "band"}
        made = known(Claim(claim.kind, kept))
        return Claim(made.kind, {**made.numbers, **{x: v for x, v in claim.numbers.items() if x == "band"}})

    checker.as_performance = limited


def stray_model() -> None:
    """A counterexample is sought in a model that lies beside the loop."""
    members.model_of = models.stored


def difference_sign() -> None:
    """Two models are added."""
    difference = models.difference

    def added(claim: Claim) -> Any:
        flipped = {name: -np.asarray(claim.numbers[name]) for name in ("C2", "D2") if name in claim.numbers}
        return difference(Claim(claim.kind, {**claim.numbers, **flipped}))

    checker.difference = models.difference = added


def late_rest() -> None:
    """The rest of the series of a loop with delays counts as zero."""
    delays.neumann = lambda N, X: exact(np.zeros((X.nrows(), X.ncols())))


def uncounted_roots() -> None:
    """Roots right of the axis are not counted."""
    delays.refuted = lambda where: PROVED if "root" in where else refuted(where)


def opposite() -> None:
    """Only the ends of a range of delays are looked at."""
    delay_weights._no_opposite = lambda *others: PROVED


def far_end() -> None:
    """High frequencies of a weight are not looked at."""
    delay_weights.axis = lambda *others: PROVED


def between_points() -> None:
    """Moving parameters are looked at in the points of their grid alone."""
    of_cell = parameters._coefficients

    def ends(cell: Any, models_: Any, squares: Any, varies: Any, *others: Any) -> Any:
        plain = parameters.product
        parameters.product = lambda *sets_, **more: plain(*((0, 2) if s == (0, 1, 2) else s for s in sets_), **more)
        try:
            yield from of_cell(cell, models_, squares, varies, *others)
        finally:
            parameters.product = plain

    parameters._coefficients = ends


def parameters_at_rest() -> None:
    """Moving parameters rest."""
    of_cell = parameters._coefficients
    parameters._coefficients = lambda cell, m, P, varies, rates, *others: of_cell(
        cell, m, P, varies, [0.0] * len(rates), *others
    )


def deviation() -> None:
    """What a model deviates by between the points of its grid is not looked at."""
    parameters._shifts = lambda bound: [None]


def multiplier_class() -> None:
    """Multipliers need not be positive."""
    known = multipliers.definite
    multipliers.definite = lambda X: Definite(True, known(X).least)


def kernel_norm() -> None:
    """The kernels of Zames and Falb may be as large as they like."""
    multipliers.bool = lambda x: True  # pyright: ignore[reportAttributeAccessIssue]


def steadiness() -> None:
    """Laws that change with time are taken for steady ones."""
    read = iqc.read_natures
    iqc.read_natures = lambda claim, blocks: [replace(n, steady=True) for n in read(claim, blocks)]


def oddness() -> None:
    """Laws are taken for odd ones."""
    read = iqc.read_natures
    iqc.read_natures = lambda claim, blocks: [replace(n, odd=True) for n in read(claim, blocks)]


def rate() -> None:
    """A number changes half as fast."""
    read = iqc.read_natures
    iqc.read_natures = lambda claim, blocks: [replace(n, rate=0.5 * n.rate) for n in read(claim, blocks)]


def slope() -> None:
    """Slopes of a law are a little less steep."""
    read = iqc.read_natures
    iqc.read_natures = lambda claim, blocks: [
        replace(n, slope=(min(0.97 * n.slope[0], n.range[0]), max(0.97 * n.slope[1], n.range[1])))
        for n in read(claim, blocks)
    ]


PLANTS: dict[str, Callable[[], None]] = {
    f.__name__.replace("_", "-"): f
    for f in (
        gaps, last_interval, g_structure, level_not_squared, d_positive, p_positive, undecided, real_line,
        middle, infinity, nyquist, performance, nominal_stability, delta_norm, delta_structure, existence, box_covering,
        hidden_zero, stray_band, stray_model, box_width, controller_sign, h2_square, perturbed_end, refutation,
        difference_sign,
        late_rest, uncounted_roots, opposite, far_end, between_points, parameters_at_rest, deviation, multiplier_class,
        kernel_norm, steadiness, oddness, rate, slope,
    )
}  # fmt: skip

__all__ = ["PLANTS"]
