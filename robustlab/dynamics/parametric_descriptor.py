"""The linear models of a trimmed plant over the ranges of its parameters, as one uncertain model."""
# Cockburn, Morton, "Linear fractional representations of uncertain systems", Automatica 33 (1997); Carroll, "A
# polynomial in each variable separately is a polynomial", Amer. Math. Monthly 68 (1961).

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement, product
from typing import Any, NamedTuple, cast

import numpy as np

from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.dynamics.descriptor_elimination import closed_descriptor, solved, with_outputs
from robustlab.errors import InputError, NoTrustworthyNumber, RobustlabError
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import SAMPLED, FullBlock, ParameterRange, RealScalar
from robustlab.uncertainty.elementwise import natural_magnitude
from robustlab.uncertainty.lft import UncertainModel
from robustlab.uncertainty.reduction import Exponents, MatrixPolynomial, polynomial_lft

# A parameter is exact if the descriptor form is a polynomial of it over this share of its value to both sides
# (for a value of 0, over so many half widths). Larger: non-polynomials are detected more reliably, but more plants
# have no linear model that far away.
FAMILY_REACH = 0.5
FAMILY_ZERO = 30.0
# Chebyshev nodes along a parameter, highest degree, and number of highest coefficients that estimate the rounding.
NODES = np.polynomial.chebyshev.chebpts1(13)
FAMILY_DEGREE = 3
FAMILY_TOP = 4
# Largest number of parameter products in a descriptor form.
FAMILY_MONOMIALS = 600
# Random values at which a form, and then the model, are checked against the plant.
FAMILY_CHECKS = 12
# Sampled parameters: largest number of corners of the box, and log2 of the number of inner points.
FAMILY_CORNERS = 64
FAMILY_SOBOL = 8
# A higher degree (up to the second number) is used where more than this share of the effect remains.
FAMILY_SHARE = 0.25
FAMILY_COVER_DEGREE = 3
# Factor by which the remainder block exceeds the samples, and largest number of times that fresh samples widen it.
FAMILY_ROOM = 1.1
FAMILY_ROUNDS = 5

Values = Mapping[str, float]

# Shares of an entry's natural magnitude: allowed difference of two evaluations, zero, least rounding. A Chebyshev
# coefficient counts if it is CLEAR times larger than the highest ones.
SAME, ZERO, ROUNDING, CLEAR = 1e-10, 1e-12, 1e-14, 30.0
# Allowed difference between the uncertain model and the plant's linear models, relative to the row's largest entry.
EXACT = 1e-8
REMAINDER = "remainder"


class TrimmedDescriptor(NamedTuple):
    """Descriptor form of a plant at an operating point, as a function of its parameters."""

    matrices: Callable[[Values], Array]  # values of all parameters -> N (n_x + n_y, 2 n_x + n_u)
    held: str  # description of the signals that are fixed and free when the parameters change
    free: tuple[int, ...] = ()  # rows of N that may be multiplied by a function of the parameters


@one_thread()
def uncertain_family(
    where: str,
    nominal: StateSpaceModel,
    trimmed: TrimmedDescriptor,
    values: Values,
    ranges: Mapping[str, ParameterRange],
    outputs: Sequence[str] | None = None,
) -> UncertainModel:
    """Return the uncertain model of all linear models with parameters in their ranges."""
    if not ranges:
        return UncertainModel(nominal, [], nominal.operating_point)
    if REMAINDER in ranges:
        raise InputError(where, f"a parameter called {REMAINDER!r}", "another name: a block has this one")
    family = _Family(where, trimmed.matrices, values, tuple(ranges), tuple(ranges.values()))
    family, scans = _with_row_factors(family, trimmed.free)
    scale = _scale(family.at({}), [scan for scan in scans.values() if scan is not None])
    degrees = {name: None if scan is None else _degree(scan / scale) for name, scan in scans.items()}
    # the reach of a value of 0 is arbitrary: a weak function is easily mistaken for a polynomial
    degrees = {name: None if not ranges[name].nominal and (d or 0) > 2 else d for name, d in degrees.items()}
    polynomial = _exact_part(family, degrees, scale)
    polynomial, remainder, powers = _sampled_part(family, degrees, polynomial, scale)
    whole, affine = _closed(family, nominal, polynomial, remainder, scale), polynomial.is_affine
    off = _off(family, whole, polynomial, remainder)
    if not off <= EXACT:
        found = f"the set is off the plant's linear models by {off:.2g} of an entry's row"
        raise NoTrustworthyNumber(where, found, None, "narrower tolerances, or fewer at once")
    origins = [
        _of_the_remainder(remainder, affine)
        if block.name == REMAINDER and remainder is not None
        else _of_a_parameter(degrees[block.name], powers, remainder is not None, affine, off) + trimmed.held
        for block in whole.blocks
    ]
    named = [replace(cast("Any", block), origin=text) for block, text in zip(whole.blocks, origins, strict=True)]
    made = with_outputs(UncertainModel(whole.M, named, nominal.operating_point), outputs)
    # an affine form already has the fewest repetitions
    return made if affine else made.reduce()


def _of_the_remainder(rest: _Remainder, affine: bool) -> str:
    proved = f"proved on the hull of {rest.samples}" if affine else f"proved for {rest.samples}"
    fresh = f"{rest.fresh} fresh ones need {rest.fresh_size:.2f} of it"
    return f"{SAMPLED}: {proved} linear models only; {fresh}; complex and dynamic members come in"


def _of_a_parameter(degree: int | None, powers: int, more: bool, affine: bool, off: float) -> str:
    """Return the origin of a parameter's block in words; ``off``: error of the set against the plant's models."""
    if degree is None:
        power = "first-order effect" if powers == 1 else f"effect up to order {powers}"
        left = f"the rest is in {REMAINDER}" if more else "nothing is left at the samples"
        return f"{SAMPLED}: its {power}, {left}; "
    kind = "affine" if degree == 1 else f"of degree {degree}"
    least = ", repeated as often as its rank asks" if affine else ""
    return f"exact: the descriptor form is {kind} in it{least}; the plant's own models met to {off:.1e}; "


def _scale(centre: Array, scans: Sequence[Array]) -> Array:
    """Return the natural magnitude of each entry of N, an outer product scaled by the rows that vary."""
    every = np.concatenate([centre[None], *scans])
    size, changing = np.abs(every).max(axis=0), np.ptp(every, axis=0).any(axis=1)
    if not changing.any():
        return natural_magnitude(size)
    natural = natural_magnitude(size[changing])
    columns, rows = natural[0], np.ones(len(size))
    rows[changing] = natural[:, 0] / natural[0, 0]
    largest = (size / columns).max(axis=1)
    fixed = ~changing & (largest > 0)
    rows[fixed] = np.exp2(np.rint(np.log2(largest[fixed])))
    return rows[:, None] * columns


@dataclass(frozen=True, eq=False)
class _Family:
    """N(p) over the ranges of the named parameters."""

    where: str
    matrices: Callable[[Values], Array]
    values: Values
    names: tuple[str, ...]
    ranges: tuple[ParameterRange, ...]
    factors: tuple[tuple[int, str], ...] = ()  # rows that are multiplied by a parameter

    def raw(self, point: Mapping[str, float]) -> Array:
        """Return N at these parameter values, the others nominal."""
        values = ", ".join(f"{name} = {value:.6g}" for name, value in point.items())
        try:
            found = self.matrices({**self.values, **point})
        except NoTrustworthyNumber as error:
            raise NoTrustworthyNumber(error.where, f"{error.found} ({values})", error.expected, error.hint) from None
        if not np.isfinite(found).all():
            raise NoTrustworthyNumber(self.where, f"no finite linear model at {values}")
        return found

    def at(self, point: Mapping[str, float]) -> Array:
        """Return `raw` with each row multiplied by its factors."""
        found, values = self.raw(point), {**self.values, **point}
        for row, by in self.factors:
            found[row] *= values[by]
        return found

    def inside(self, s: Array) -> Array:
        return np.array([self.at(self.point(row)) for row in s])

    def point(self, s: Array) -> dict[str, float]:
        return {n: r.value(float(v)) for n, r, v in zip(self.names, self.ranges, s, strict=True)}

    def entries(self, s: Array) -> Array:
        """Return the entries of Delta at normalised values; a range may be asymmetric."""
        return np.where(s < 0, s * np.array([r.ratio for r in self.ranges]), s)

    def reach(self, name: str) -> tuple[float, float]:
        """Return a wider interval around the range of a parameter, within its sign."""
        r = self.ranges[self.names.index(name)]
        far = max(FAMILY_REACH * abs(r.nominal), 0.0 if r.nominal else FAMILY_ZERO * r.radius)
        return min(r.low, r.nominal - far), max(r.high, r.nominal + far)


def _with_row_factors(family: _Family, free: Sequence[int]) -> tuple[_Family, dict[str, Array | None]]:
    """Return the family with its simplest row factors, and N along each parameter (None without a linear model)."""
    base = {n: 0.62 * r.nominal + 0.38 * family.reach(n)[1] for n, r in zip(family.names, family.ranges, strict=True)}
    try:
        family.raw(base)
    except RobustlabError:
        base = {}
    scans: dict[str, Array | None] = {}
    nodes: dict[str, Array] = {}
    for name in family.names:
        low, high = family.reach(name)
        nodes[name] = 0.5 * (low + high) + 0.5 * (high - low) * NODES
        try:
            scans[name] = np.array([family.raw({**base, name: float(v)}) for v in nodes[name]])
        except RobustlabError:
            scans[name] = None
    known = {name: scan for name, scan in scans.items() if scan is not None}
    factors: list[tuple[int, str]] = []
    values = {**family.values, **base}
    for row in free if known else ():
        rows = {name: scan[:, row] for name, scan in known.items()}
        best = _complexity(rows)
        while best[0]:
            tries = [
                {n: each * (nodes[n][:, None] if n == by else values[by]) for n, each in rows.items()} for by in known
            ]
            least, k = min((_complexity(made), k) for k, made in enumerate(tries))
            if least >= best:
                break
            best, rows = least, tries[k]
            factors.append((row, list(known)[k]))
        for name, scan in known.items():
            scan[:, row] = rows[name]
    return replace(family, factors=tuple(factors)), scans


def _complexity(rows: Mapping[str, Array]) -> tuple[int, int]:
    """Return the number of parameters in which a row is no polynomial, and the sum of its degrees in the others."""
    size = np.max([np.abs(row).max(axis=0) for row in rows.values()], axis=0)
    size = np.where(size > 0, size, 1.0)
    degrees = [_degree(row / size) for row in rows.values()]
    return degrees.count(None), sum(d for d in degrees if d is not None)


def _degree(scan: Array) -> int | None:
    """Return the degree of the polynomial through values (nodes, ...) of magnitude one at Chebyshev nodes, or None."""
    basis = np.polynomial.chebyshev.chebvander(NODES, len(NODES) - 1)
    sizes = np.abs(basis.T @ scan.reshape(len(scan), -1)) * (2.0 / len(scan))
    rounding = np.maximum(CLEAR * sizes[-FAMILY_TOP:].max(axis=0), ROUNDING)
    degree = int(np.flatnonzero((sizes > rounding).any(axis=1)).max(initial=0))
    return degree if degree <= FAMILY_DEGREE and rounding.max() <= SAME else None


def _exact_part(family: _Family, degrees: Mapping[str, int | None], scale: Array) -> MatrixPolynomial:
    """Return N as a polynomial of the exact parameters' entries of Delta, checked at independent points."""
    names = family.names
    exact = [k for k, name in enumerate(names) if degrees[name]]
    zero: Exponents = (0,) * len(names)
    centre = family.at({})
    if not exact:
        return MatrixPolynomial(names, {zero: centre})
    rng = np.random.default_rng(0)
    spans = np.array([family.reach(names[k]) for k in exact])
    nominal = np.array([family.ranges[k].nominal for k in exact])
    half = np.abs(spans - nominal[:, None]).max(axis=1)

    def at(points: Array) -> Array:
        return np.array([family.at({names[k]: float(v) for k, v in zip(exact, p, strict=True)}) for p in points])

    monomials = _monomials([degrees[names[k]] or 0 for k in exact], _meetings(at, nominal, spans, scale))
    if len(monomials) > FAMILY_MONOMIALS:
        found = f"{len(monomials)} products of {len(exact)} parameters"
        raise InputError(family.where, found, f"at most {FAMILY_MONOMIALS}", "fewer tolerances at once")
    points = rng.uniform(spans[:, 0], spans[:, 1], (2 * len(monomials) + FAMILY_CHECKS, len(exact)))
    t = (points - nominal) / half
    basis = np.array([np.prod(t**e, axis=1) for e in monomials]).T
    off = (at(points) - centre) / scale
    fit, check = slice(FAMILY_CHECKS, None), slice(0, FAMILY_CHECKS)
    flat = off.reshape(len(off), -1)
    coefficients = np.linalg.lstsq(basis[fit], flat[fit], rcond=None)[0]
    miss = float(np.abs(basis[check] @ coefficients - flat[check]).max())
    if miss > SAME:
        found = f"the linear models are off their polynomial by {miss:.2g}"
        raise NoTrustworthyNumber(family.where, found, None, "narrower tolerances, or fewer at once")
    coefficients[np.abs(coefficients) <= ZERO] = 0.0
    radius = np.array([family.ranges[k].radius for k in exact])
    terms: dict[Exponents, Array] = {zero: centre}
    for e, part in zip(monomials, coefficients, strict=True):
        if part.any():
            powers = dict(zip(exact, e, strict=True))
            key = tuple(powers.get(k, 0) for k in range(len(names)))
            terms[key] = part.reshape(scale.shape) * scale * float(np.prod((radius / half) ** np.array(e)))
    return MatrixPolynomial(names, terms)


def _meetings(at: Callable[[Array], Array], nominal: Array, spans: Array, scale: Array) -> set[tuple[int, int]]:
    """Return the pairs of parameters whose effects are not additive."""
    count = len(nominal)
    start, end = nominal + 0.37 * (spans[:, 1] - nominal), spans[:, 0] + 0.11 * (nominal - spans[:, 0])
    shift = np.diag(end - start)
    alone, both = at(start + shift) / scale, at(start[None])[0] / scale
    pairs = list(combinations(range(count), 2))
    if not pairs:
        return set()
    together = at(np.array([start + shift[i] + shift[j] for i, j in pairs])) / scale
    return {
        (i, j)
        for (i, j), there in zip(pairs, together, strict=True)
        if np.abs(there - alone[i] - alone[j] + both).max() > ZERO
    }


def _monomials(degrees: Sequence[int], meetings: set[tuple[int, int]]) -> list[Exponents]:
    """Return all products of powers up to the degrees of interacting parameters, without the constant."""

    def cliques(start: int, chosen: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        for k in range(start, len(degrees)):
            if all((j, k) in meetings for j in chosen):
                yield (*chosen, k)
                yield from cliques(k + 1, (*chosen, k))

    found: list[Exponents] = []
    for clique in cliques(0, ()):
        for powers in product(*(range(1, degrees[k] + 1) for k in clique)):
            by_place = dict(zip(clique, powers, strict=True))
            found.append(tuple(by_place.get(k, 0) for k in range(len(degrees))))
            if len(found) > FAMILY_MONOMIALS:
                return found
    return found


class _Remainder(NamedTuple):
    """``left Delta right`` of the full block; numbers of samples and fresh samples, largest Delta of the latter."""

    left: Array
    right: Array
    samples: int
    fresh: int
    fresh_size: float

    def delta(self, rest: Array) -> Array:
        """Return Delta (k, rows, cols) for remainders (k, m, n) of the polynomial."""
        return np.linalg.pinv(self.left) @ rest @ np.linalg.pinv(self.right)


def _sampled_part(
    family: _Family, degrees: Mapping[str, int | None], exact: MatrixPolynomial, scale: Array
) -> tuple[MatrixPolynomial, _Remainder | None, int]:
    """Add powers of the sampled parameters; return the polynomial, the remainder block and the highest power."""
    sampled = [k for k, name in enumerate(family.names) if degrees[name] is None]
    if not sampled:
        return exact, None, 0
    moving = [k for k, name in enumerate(family.names) if degrees[name] != 0]
    s = _box(family, moving, 0)
    off = (family.inside(s) - exact(family.entries(s))) / scale
    flat, t = off.reshape(len(off), -1), family.entries(s)
    whole = float(np.abs(flat).max())
    found: tuple[int, list[Exponents], Array, Array] | None = None
    monomials: list[Exponents] = []
    for degree in range(1, FAMILY_COVER_DEGREE + 1):
        products = [c for c in combinations_with_replacement(moving, degree) if set(c) & set(sampled)]
        monomials = [*monomials, *(tuple(c.count(k) for k in range(len(family.names))) for c in products)]
        if 3 * len(monomials) > len(s):
            break
        basis = np.array([np.prod(t**e, axis=1) for e in monomials]).T
        coefficients = np.linalg.lstsq(basis, flat, rcond=None)[0]
        coefficients[np.abs(coefficients) <= ZERO] = 0.0
        found = degree, monomials, coefficients, flat - basis @ coefficients
        if np.abs(found[3]).max() <= FAMILY_SHARE * whole:
            break
    if found is None:
        raise InputError(family.where, f"{len(moving)} tolerances to be sampled", "fewer at once")
    degree, monomials, coefficients, rest = found
    terms = dict(exact.terms)
    for e, part in zip(monomials, coefficients, strict=True):
        if part.any():
            terms[e] = terms.get(e, 0.0) + part.reshape(scale.shape) * scale
    polynomial = MatrixPolynomial(family.names, terms)
    return polynomial, _bounded(family, moving, polynomial, rest.reshape(off.shape), scale), degree


def _box(family: _Family, moving: Sequence[int], seed: int) -> Array:
    """Return normalised values (k, names): centre of the box, corners (all or a random selection), Sobol sequence."""
    from scipy.stats import qmc

    count = len(moving)
    rng = np.random.default_rng(seed)
    if 2**count <= FAMILY_CORNERS:
        corners = np.array(list(product((-1.0, 1.0), repeat=count)))
    else:
        corners = rng.choice([-1.0, 1.0], (FAMILY_CORNERS, count))
    # The oldest supported scipy names this argument "seed", the newest "rng".
    settings: dict[str, Any] = {"seed": rng}
    inner = 2.0 * qmc.Sobol(count, **settings).random_base2(FAMILY_SOBOL) - 1.0
    s = np.zeros((len(corners) + len(inner) + 1, len(family.names)))
    s[1:, list(moving)] = np.vstack([corners, inner])
    return s


def _bounded(
    family: _Family, moving: Sequence[int], polynomial: MatrixPolynomial, rest: Array, scale: Array
) -> _Remainder | None:
    """Return the block for the remainder of the polynomial, wide enough for fresh samples."""
    size = np.abs(rest).max(axis=0)
    size[size <= ZERO] = 0.0
    rows, columns = np.flatnonzero(size.any(axis=1)), np.flatnonzero(size.any(axis=0))
    if not len(rows):
        return None
    natural = natural_magnitude(size[rows[:, None], columns])
    left, right = np.zeros((len(size), len(rows))), np.zeros((len(columns), size.shape[1]))
    left[rows, range(len(rows))] = natural[:, 0]
    right[range(len(columns)), columns] = natural[0] / natural[0, 0]
    first, across = scale[:, :1] / scale[0, 0], scale[:1]
    made = _Remainder(first * left, right * across, len(rest), 0, 0.0)
    largest = float(np.linalg.norm(made.delta(rest * scale), 2, axis=(1, 2)).max())
    count = len(rest)
    for attempt in range(1, FAMILY_ROUNDS + 1):
        bound = FAMILY_ROOM * largest
        s = _box(family, moving, attempt)[1:]
        off = family.inside(s) - polynomial(family.entries(s))
        size_there = float(np.linalg.norm(made.delta(off), 2, axis=(1, 2)).max())
        if size_there <= bound:
            return made._replace(left=bound * made.left, samples=count, fresh=len(s), fresh_size=size_there / bound)
        largest, count = size_there, count + len(s)
    found = f"fresh samples still left the cover of {count} after {FAMILY_ROUNDS} rounds"
    raise NoTrustworthyNumber(family.where, found, None, "narrower tolerances, or fewer at once")


def _closed(
    family: _Family, nominal: StateSpaceModel, polynomial: MatrixPolynomial, remainder: _Remainder | None, scale: Array
) -> UncertainModel:
    """Return the uncertain model of the polynomial and its remainder."""
    lft = polynomial_lft(polynomial, scale, ZERO)
    order = [k for name in family.names for k, owner in enumerate(lft.names) if owner == name]
    left, right, inner = lft.d21[:, order], lft.d12[order], lft.d11[np.ix_(order, order)]
    counts = [(name, lft.names.count(name), r) for name, r in zip(family.names, family.ranges, strict=True)]
    blocks: list[RealScalar | FullBlock] = [RealScalar(name, count, r) for name, count, r in counts if count]
    if remainder is not None:
        q, p = remainder.left.shape[1], remainder.right.shape[0]
        left, right = np.hstack([left, remainder.left]), np.vstack([right, remainder.right])
        inner = np.pad(inner, ((0, p), (0, q)))
        blocks.append(FullBlock(REMAINDER, q, p))
    n = nominal.n_states
    e = -family.at({})[:n, n + nominal.n_inputs :]
    return closed_descriptor(nominal, e, left, right, inner, blocks, family.where)


def _off(family: _Family, model: UncertainModel, polynomial: MatrixPolynomial, remainder: _Remainder | None) -> float:
    """Return the largest difference of a member from the plant's model, relative to the entry's row."""
    n, n_u = model.M.n_states, len(model.inputs)
    rng = np.random.default_rng(1)
    worst = 0.0
    known = {b.name for b in model.blocks}
    for s in rng.uniform(-1.0, 1.0, (FAMILY_CHECKS, len(family.names))):
        there = family.at(family.point(s))
        delta = {name: float(v) for name, v in zip(family.names, s, strict=True) if name in known}
        if remainder is not None:
            delta |= {REMAINDER: remainder.delta(there[None] - polynomial(family.entries(s[None])))[0]}
        member = model.evaluate(delta)
        e, rest = -there[:n, n + n_u :], there[:n, : n + n_u]
        rates = solved(e, rest, family.where)
        for reached, wanted in (
            (np.hstack([member.A, member.B]), rates),
            (np.hstack([member.C, member.D]), there[n:, : n + n_u]),
        ):
            row = np.abs(wanted).max(axis=1, keepdims=True)
            worst = max(worst, float((np.abs(reached - wanted) / np.where(row > 0, row, 1.0)).max(initial=0.0)))
    return worst
