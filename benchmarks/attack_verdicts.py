"""Find false claims of a function about a case, in exact arithmetic.

A claim is a dictionary of plain numbers and arrays, so that a test can falsify it; nothing of robustlab is used here.
Every finding begins with FALSE (a certificate that does not hold) or with note (no false certificate).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import exact_delta as deltas
import exact_loops as loops
import numpy as np
from attack_cases import Case
from exact_delta import NEAR, Part, block_norm, slices
from exact_loops import Model, System, exact, float_or_inf, product, with_precision
from flint import acb_mat, arb

Claim = dict[str, Any]
Findings = Iterator[str]
Response = Callable[[Any], Any]

# Accepted relative errors of: a verified norm of a design, a bracket of a norm, a proved margin or gain (5e-6 stated).
DESIGN, BRACKET, PROVED = 1e-3, 1e-6, 1e-5
# A direct term from w to z below this share of the cancelling terms is rounding of the controller's D (see h2).
CANCELLED = 1e-10


def judge(case: Case, claim: Claim, rng: np.random.Generator) -> list[str]:
    return list(VERDICTS[case.function](case.data, claim, rng))


def _hinf(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    P, K = data["P"], claim["K"]

    def at(omega: Any) -> Any:
        p, k = loops.response(P, omega), loops.response(K, omega)
        P11, P12, P21, P22 = loops.four_parts(p, data["n_meas"], data["n_con"])
        return loops.gain(P11 + product(P12, k, loops.inverse(acb_mat(loops.eye(k.ncols())) - product(P22, k)), P21))

    yield from _norm_of_loop(lambda: loops.closed(loops.system(P), loops.system(K)), at, [P, K], claim)


def _mixsyn(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    G, K = data["G"], claim["K"]
    n_y, n_u = G.D.shape
    weights = [None if data[k] is None else repeated(data[k], n) for k, n in (("W1", n_y), ("W2", n_u), ("W3", n_y))]

    def at(omega: Any) -> Any:
        g, k = loops.response(G, omega), loops.response(K, omega)
        S = loops.inverse(acb_mat(loops.eye(n_y)) + product(g, k))
        terms = [S, product(k, S), product(g, k, S)]
        return loops.gain(
            loops.joined([[product(loops.response(w, omega), t)] for w, t in zip(weights, terms, strict=True) if w])
        )

    def loop() -> System:
        return loops.closed(
            loops.sensitivity_plant(loops.system(G), *(w and loops.system(w) for w in weights)), loops.system(K)
        )

    yield from _norm_of_loop(loop, at, [G, K, *(w for w in weights if w)], claim)


def _ncf(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    G, K, inner = data["G"], claim["K"], claim["K_shaped"]
    n_y, n_u = G.D.shape
    W1 = repeated(data["W1"], n_u) if data["W1"] else None
    W2 = repeated(data["W2"], n_y) if data["W2"] else None

    def shaped() -> System:
        g = loops.system(G) if W1 is None else loops.in_series(loops.system(W1), loops.system(G))
        return g if W2 is None else loops.in_series(g, loops.system(W2))

    def at(omega: Any) -> Any:
        g, k = loops.response(G, omega), loops.response(inner, omega)
        g = g if W1 is None else product(g, loops.response(W1, omega))
        g = g if W2 is None else product(loops.response(W2, omega), g)
        unit = acb_mat(loops.eye(n_u))
        middle = product(loops.inverse(unit - product(k, g)), loops.joined([[k, unit]]))
        return loops.gain(loops.joined([[product(g, middle)], [middle]]))

    everything = [m for m in (G, inner, W1, W2) if m is not None]
    yield from _norm_of_loop(
        lambda: loops.closed(loops.coprime_plant(shaped()), loops.system(inner)), at, everything, claim
    )
    own = with_precision(lambda: _stable(loops.closed(loops.coprime_plant(loops.system(G)), loops.system(K))))
    if own is not True:
        yield from _unstable(claim, "the loop of the plant as given")


def _h2(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    P, K = data["P"], claim["K"]
    loop = lambda: loops.closed(loops.system(P), loops.system(K))  # noqa: E731
    if with_precision(lambda: _stable(loop())) is not True:
        yield from _unstable(claim, "the loop")
        return
    if not claim["trusted"]:
        return
    if not P.dt:
        D11, D12, D21, _ = loops.four_parts(exact(P.D), data["n_meas"], data["n_con"])
        cancels = _largest(D11) + _largest(D12) * _largest(exact(K.D)) * _largest(D21)
        left = with_precision(lambda: _largest(loop().D))
        if left is not None and left > cancels * arb(CANCELLED):
            yield f"FALSE: a direct term of {float_or_inf(left):.3g} is left, so the H2 norm is infinite"
            return
    yield from _h2_differs(claim["gamma"], with_precision(lambda: loops.h2_norm(loop())))


def _h2_differs(value: float, true: arb | None) -> Findings:
    if true is None:
        yield "note: the exact H2 norm was not found"
        return
    ratio = float_or_inf(arb(value) / true) if true > 0 else (1.0 if value == 0 else np.inf)
    if not abs(ratio - 1) <= DESIGN:
        yield f"FALSE: H2 norm {value:.6g} claimed, exact {float_or_inf(true):.6g} (ratio {ratio:.6g})"


def _largest(m: Any) -> arb:
    return max((abs(v).mid() for v in m.entries()), default=arb(0))


def repeated(w: Model, n: int) -> Model:
    """A weight of one channel on each of n; any other as it is."""
    if w.D.shape != (1, 1) or n == 1:
        return w
    A, B, C, D = (np.kron(np.eye(n), m) for m in w[:4])
    return Model(A, B, C, D, w.dt)


def _stable(loop: System) -> bool | None:
    return loops.is_stable(loop.A, loop.discrete)


def _unstable(claim: Claim, what: str) -> Findings:
    text = f"{what} is not stable in exact arithmetic"
    yield f"FALSE: {text}" if claim["trusted"] else f"note: {claim['status']}, and {text}"


def _norm_of_loop(loop: Callable[[], System], at: Response, models: list[Model], claim: Claim) -> Findings:
    """Stability, the norm over all frequencies, and the gains of plant and controller evaluated on their own."""
    if with_precision(lambda: _stable(loop())) is not True:
        yield from _unstable(claim, "the loop")
        return
    if not claim["trusted"] or not np.isfinite(claim["gamma"]):
        return
    limit = (arb(claim["gamma"]) * arb(1 + DESIGN)).mid()
    below = with_precision(lambda: loops.norm_is_below(loop(), limit))
    around = [p for m in models for p in np.linalg.eigvals(m.A).tolist()]
    if not below:
        around += with_precision(lambda: loops.poles(loop().A)) or []
    points, rounds = (8, 0) if below else (40, 40)
    top, omega = loops.peak(at, around, models[0].dt, points, rounds, 0 if below else 6)
    if top > limit:
        excess = float_or_inf(top / arb(claim["gamma"])) - 1
        yield f"FALSE: gamma {claim['gamma']:.6g}, exact gain {float_or_inf(top):.6g} at {omega:.6g} ({excess:+.2%})"
        if below:
            yield "note: THE JUDGE CONTRADICTS ITSELF: the Hamiltonian says that no frequency exceeds it"
    elif below is False:
        yield f"FALSE: gamma {claim['gamma']:.6g} is exceeded by the Hamiltonian; no frequency found by the search"
    elif below is None:
        yield "note: norm attacked at frequencies, not decided for all of them"
    bound = claim.get("lower_bound") or 0.0
    if bound > claim["gamma"] * (1 + DESIGN):
        yield f"FALSE: the claimed lower bound is {bound:.6g}, this controller has {claim['gamma']:.6g}"


def _norm(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    G = data["G"]
    stable = with_precision(lambda: loops.is_stable(exact(G.A), G.dt > 0))
    if claim["trusted"]:
        yield from _hinf_bracket(G, claim, stable)
    if claim["h2_trusted"]:
        yield from _h2_value(G, claim, stable)


def _hinf_bracket(G: Model, claim: Claim, stable: bool | None) -> Findings:
    lower, upper = claim["lower"], claim["upper"]
    if not np.isfinite(upper):
        if stable and np.isinf(lower):
            yield "FALSE: an infinite norm of a stable model"
        return
    if stable is not True:
        yield f"FALSE: norm {upper:.6g} of a model that is not stable in exact arithmetic"
        return
    limit, floor = (arb(upper) * arb(1 + BRACKET)).mid(), (arb(lower) * arb(1 - BRACKET)).mid()
    below = with_precision(lambda: loops.norm_is_below(loops.system(G), limit))
    if below is not True:
        top, omega = loops.peak(lambda w: loops.gain(loops.response(G, w)), np.linalg.eigvals(G.A).tolist(), G.dt)
        if below is False or top > limit:
            yield f"FALSE: upper {upper:.12g}, exact gain {float_or_inf(top):.12g} at {omega:.6g} or beyond"
        else:
            yield "note: norm attacked at frequencies, not decided for all of them"
    attained = with_precision(lambda: loops.gain(loops.response(G, claim["frequency"])))
    if (
        lower > 0
        and (attained is None or attained < floor)
        and with_precision(lambda: loops.norm_is_below(loops.system(G), floor))
    ):
        yield f"FALSE: lower {lower:.12g} at {claim['frequency']:.6g} is above the norm"
    if lower > upper:
        yield f"FALSE: lower {lower!r} above upper {upper!r}"


def _h2_value(G: Model, claim: Claim, stable: bool | None) -> Findings:
    value = claim["h2"]
    finite = stable is True and (G.dt > 0 or not G.D.any())
    if not np.isfinite(value) or not finite:
        if np.isfinite(value) or finite:
            yield f"FALSE: H2 norm {value:.6g}, exact arithmetic says {'finite' if finite else 'infinite'}"
        return
    yield from _h2_differs(value, with_precision(lambda: loops.h2_norm(loops.system(G))))


def _mu(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    M, parts = data["matrix"], data["parts"]
    lower, upper = claim["lower"], claim["upper"]
    if lower > upper:
        yield f"FALSE: lower {lower!r} above upper {upper!r}"
    if 0 < upper < np.inf:
        if not deltas.scalings_fit(parts, claim["D"], claim["D_z"], claim["G"]):
            yield "FALSE: D, G do not have the structure"
        elif not deltas.proves(M, claim["D"], claim["D_z"], claim["G"], upper):
            yield f"FALSE: D, G do not prove the upper bound {upper:.9g}"
    # M of size one, by a power of two, so that no radius overflows. An upper bound of zero states that nothing is
    # singular: a ball as large as sensible is tried.
    exponent = int(np.frexp(np.abs(M).max())[1])
    unit = np.ldexp(M.real, -exponent) + 1j * np.ldexp(M.imag, -exponent)
    top = float(np.ldexp(upper, -exponent))
    radius = min((1 - 1e-7) / top, 1e60) if top > 0 else 1e3
    if np.isfinite(upper) and unit.any() and (found := deltas.singular_inside(unit, parts, radius, rng)):
        yield f"FALSE: a singular Delta of size {found:.9g} times 2^{-exponent}, upper bound {upper:.9g}"
    if lower <= 0:
        if upper > 0:
            yield "note: no Delta found"
        return
    delta = claim["delta"]
    if not np.isfinite(delta).all():
        yield "FALSE: Delta is not finite"
        return
    moved, _ = deltas.distance_to_singular(M, parts, delta)
    if not deltas.structure_holds(parts, delta):
        yield "FALSE: Delta does not have the structure"
    elif abs(block_norm(parts, delta) * lower - 1) > 2 * NEAR:
        yield f"FALSE: Delta has size {block_norm(parts, delta):.9g}, claimed {1 / lower:.9g}"
    elif moved > NEAR and deltas.last_places(M, delta) > 2:
        yield f"FALSE: Delta is not singular to within {NEAR:g} of itself ({moved:.1e}), nor for M to its last places"
    elif moved > NEAR:
        yield "note: singular for M with other last places"


def _margin(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    model, parts = data["M"], data["parts"]
    lower, upper, delta = claim["lower"], claim["upper"], claim["delta"]
    if lower > upper * (1 + NEAR):
        yield f"FALSE: proved margin {lower:.9g} above the attained one {upper:.9g}"
    if lower > 0 and with_precision(lambda: loops.is_stable(exact(model.A), model.dt > 0)) is not True:
        yield "FALSE: the nominal model is not stable in exact arithmetic"
        return
    if lower > 0:
        found = deltas.unstable_inside(model, parts, min(lower * (1 - PROVED), 1e6), rng, delta)
        if found is not None:
            yield f"FALSE: a Delta of size {block_norm(parts, found):.9g} is unstable, proved margin {lower:.9g}"
    if np.isfinite(upper):
        size = block_norm(parts, delta)
        if not deltas.structure_holds(parts, delta) or abs(size / upper - 1) > NEAR:
            yield f"FALSE: the critical Delta has size {size:.9g}, claimed {upper:.9g}, or not the structure"
        elif not deltas.is_on_boundary(model, parts, delta, 1e-7):
            yield f"FALSE: the critical Delta of size {upper:.9g} leaves the model stable"
    if any(p.below != 1 for p in parts):
        return  # the proof is of a shifted model then
    pieces = claim["pieces"]
    for k in rng.permutation(len(pieces))[:8]:
        yield from _piece_holds(model, parts, pieces[k], rng)


def _piece_holds(model: Model, parts: tuple[Part, ...], piece: tuple[Any, ...], rng: np.random.Generator) -> Findings:
    """D and G of an interval prove frequencies in it; of a discrete model those of ``s = (z - 1)/(z + 1)``."""
    members, low, high, beta, Dw, Dz, G = piece
    where = slices(parts)
    chosen = range(len(parts)) if members is None else members
    w = np.concatenate([np.arange(where[i][0].start, where[i][0].stop) for i in chosen])
    z = np.concatenate([np.arange(where[i][1].start, where[i][1].stop) for i in chosen])
    own = Model(model.A, model.B[:, w], model.C[z], model.D[np.ix_(z, w)], model.dt)
    if not deltas.scalings_fit([parts[i] for i in chosen], Dw, Dz, G):
        yield f"FALSE: D, G of the interval {low:.9g} .. {high:.9g} do not have the structure"
        return
    end = high if np.isfinite(high) else 1e6 * max(low, 1.0)
    for omega in [low, high, *rng.uniform(low, end, 2), float(np.sqrt(max(low, 1e-9 * end) * end))]:
        if not deltas.proves(lambda omega=omega: _half_plane(own, omega), Dw, Dz, G, beta):
            yield f"FALSE: D, G do not prove mu <= {beta:.9g} at {omega:.9g} in their interval {low:.9g} .. {high:.9g}"
            return


def _half_plane(model: Model, omega: float) -> acb_mat:
    """The response at s = j omega of the continuous model, or of the bilinear map of a discrete one."""
    if not model.dt:
        return acb_mat(loops.response(model, omega))
    angle = 2 * arb(omega).atan() if np.isfinite(omega) else arb.pi()
    return acb_mat(loops.response(model, angle / arb(model.dt)))


def _gain(data: dict[str, Any], claim: Claim, rng: np.random.Generator) -> Findings:
    model, parts = data["M"], data["parts"]
    lower, upper, delta, omega = claim["lower"], claim["upper"], claim["delta"], claim["frequency"]
    if lower > upper:
        yield f"FALSE: lower {lower!r} above upper {upper!r}"
    if lower > 0 and (not deltas.structure_holds(parts, delta) or block_norm(parts, delta) > 1 + NEAR):
        yield f"FALSE: the worst Delta has size {block_norm(parts, delta):.9g} or not the structure"
    elif np.isinf(lower):
        if not deltas.is_on_boundary(model, parts, delta, 1e-7):
            yield "FALSE: an infinite gain, but its Delta leaves the model stable"
        return
    elif lower > 0 and not _attains(model, delta, lower, omega):
        yield f"FALSE: the gain {lower:.9g} is not that of its Delta at {omega}"
    if not np.isfinite(upper):
        return
    found = deltas.unstable_inside(model, parts, 1 - 1e-9, rng)
    if found is not None:
        yield f"FALSE: gain {upper:.6g} proved, but a Delta of size {block_norm(parts, found):.9g} is unstable"
        return
    at = np.linalg.eigvals(model.A)
    size = np.abs(np.angle(at)) / model.dt if model.dt else np.abs(at)
    size = size[(size > 0) & np.isfinite(size)]
    end = np.pi / model.dt if model.dt else np.inf
    grid = np.concatenate([[0.0, end, omega or 0.0], size, (omega or 0.0) * np.array([0.99, 1.01])])
    if len(size):
        grid = np.append(grid, np.geomspace(size.min() / 3, size.max() * 3, 15))
    _, worst, omega = deltas.gain_inside(model, parts, np.unique(grid[grid <= end]), rng)
    limit = (arb(upper) * arb(1 + PROVED)).mid()
    top, where = loops.peak(
        lambda w: _member_gain(model, worst, w), [1j * omega] if not model.dt else [], model.dt, 12, 20
    )
    for w in (omega, where):
        value = with_precision(lambda w=w: _member_gain(model, worst, w))
        if value is not None and value > limit:
            yield f"FALSE: gain {float_or_inf(value):.9g} of a member at {w:.9g}, proved {upper:.9g}"
            return
    if not np.imag(worst).any():
        below = with_precision(lambda: _member_below(model, np.real(worst), limit))
        if below is False:
            yield f"FALSE: a member exceeds the proved gain {upper:.9g} (met {float_or_inf(top):.9g})"


def _member_gain(model: Model, delta: np.ndarray, omega: Any) -> arb:
    q, p = delta.shape
    M = loops.response(model, omega)
    D11, D12, D21, D22 = loops.four_parts(M, M.nrows() - p, M.ncols() - q)
    d = acb_mat(exact(delta + 0j))
    return loops.gain(D22 + product(D21, d, loops.inverse(acb_mat(loops.eye(p)) - product(D11, d)), D12))


def _member_below(model: Model, delta: np.ndarray, limit: arb) -> bool | None:
    return loops.norm_is_below(loops.upper_closed(loops.system(model), exact(delta)), limit)


def _attains(model: Model, delta: np.ndarray, lower: float, omega: float | None) -> bool:
    floor = (arb(lower) * arb(1 - BRACKET)).mid()
    if omega is not None:
        value = with_precision(lambda: _member_gain(model, delta, omega))
        if value is not None and value >= floor:
            return True
    if np.imag(delta).any() or not deltas.member_is_stable(model, delta):
        return False
    return with_precision(lambda: _member_below(model, np.real(delta), floor)) is not True


VERDICTS: dict[str, Callable[[dict[str, Any], Claim, np.random.Generator], Findings]] = {
    "hinf": _hinf, "mixsyn": _mixsyn, "h2": _h2, "ncf": _ncf, "margin": _margin, "gain": _gain, "mu": _mu,
    "norm": _norm,
}  # fmt: skip
