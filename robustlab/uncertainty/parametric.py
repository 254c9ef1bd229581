"""Uncertain models from matrices that are rational functions of named parameters (Březina 2010, section 4.4)."""

from __future__ import annotations

import ast
import itertools
import operator
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from itertools import product
from typing import Any

import numpy as np

from robustlab.arrays import Array
from robustlab.errors import InputError, NoTrustworthyNumber, error_context, unknown_name
from robustlab.statespace import SignalLike, StateSpaceModel
from robustlab.uncertainty.blocks import ParameterRange, RealScalar
from robustlab.uncertainty.lft import UncertainModel, with_channels
from robustlab.uncertainty.reduction import ConstantLft, MatrixPolynomial, decomposition, reduction

# Boxes and vertices in the search for a zero of a denominator: with fewer, more valid ranges are rejected.
DENOMINATOR_BOXES = 4000
DENOMINATOR_VERTICES = 4096
EXACT = 1e-9  # allowed error of an entry at random parameter values, relative to its largest value there
SEARCH = 10  # pairs of terms that cost as much as one factor and variable in the search of a decomposition


@error_context("parametric")
def parametric(
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    parameters: Mapping[str, Any],
    dt: float = 0.0,
    inputs: Iterable[SignalLike] | None = None,
    outputs: Iterable[SignalLike] | None = None,
    states: Iterable[SignalLike] | None = None,
) -> UncertainModel:
    r"""Return the models whose matrices are rational functions of uncertain parameters, as an exact LFT of low order.

    .. math:: \dot x = A(p) x + B(p) u, \qquad y = C(p) x + D(p) u, \qquad p_{low} \le p \le p_{high}

    Every parameter in the matrices becomes one real block of its name. Its number of repetitions results from a tree
    decomposition that shares equal sub-expressions, followed by an n-dimensional Kalman reduction.

    Parameters
    ----------
    A, B, C, D
        Lists of rows, shapes (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u); an entry is a number or a text with
        numbers, parameter names, ``+ - * / **`` and parentheses. Texts are read, never executed. ``A = B = C = []`` for
        a gain.
    parameters
        Name -> ParameterRange, ``(nominal, relative tolerance)``, ``(nominal, low, high)``, or a number (exact).
    dt, inputs, outputs, states
        As in `StateSpaceModel`.

    Returns
    -------
    UncertainModel
        Checked against the expressions themselves at random parameter values and at vertices of the ranges.

    Raises
    ------
    InputError
        Shapes that do not fit, texts that are no rational function, unknown parameters, invalid ranges.
    NoTrustworthyNumber
        A denominator vanishes inside the ranges (at parameter values in the message), or a zero cannot be excluded; the
        LFT does not reproduce the entries.

    Examples
    --------
    >>> model = parametric(
    ...     [[0, 1], ["-k/m", "-c/m"]], [[0], ["1/m"]], [[1, 0]], [[0]],
    ...     {"m": (3.0, 0.4), "c": (1.0, 0.2), "k": (2.0, 1.4, 3.0)},
    ... )
    >>> [(b.name, b.repeats) for b in model.blocks]
    [('m', 1), ('c', 1), ('k', 1)]
    >>> float(model.evaluate({"k": 1.0}).A[1, 0]) == -3.0 / 3.0
    True
    """
    ranges, exact = _ranges(parameters)
    algebra = Algebra(
        (*ranges, *exact), {name: Fraction(repr(value)) for name, value in exact.items()},
        frozenset(name for name, r in ranges.items() if not r.low <= 0 <= r.high),
    )  # fmt: skip
    (table, n), missed = _entries(A, B, C, D), np.inf
    try:
        expressions = [[algebra.read(entry, where) for where, entry in row] for row in table]
        _check_size(expressions, algebra)
        _check_denominators(expressions, algebra, ranges)
        lft = _lft(expressions, algebra, ranges)
        d22, order = lft.d22, [k for name in ranges for k, owner in enumerate(lft.names) if owner == name]
        blocks = [RealScalar(name, lft.names.count(name), r) for name, r in ranges.items() if name in lft.names]
        plain = StateSpaceModel(d22[:n, :n], d22[:n, n:], d22[n:, :n], d22[n:, n:], dt, inputs, outputs, states)
        model = with_channels(plain, blocks, lft.d21[:, order], lft.d12[order], lft.d11[np.ix_(order, order)])
        # A reduction mixes entries of different units: where small ones are lost, the unreduced LFT is taken.
        for candidate in (reduction(model).model, model):
            missed = _missed(candidate, table, ranges, exact)
            if missed <= EXACT:
                return candidate
    except OverflowError:
        raise InputError("parametric", "numbers that overflow", "values and coefficients of a usual size") from None
    raise NoTrustworthyNumber("parametric", f"the LFT misses the expressions by {missed:.2g} of an entry's size")


def as_range(name: str, given: Any) -> ParameterRange | float:
    """Return a parameter's range in the user's notation; a plain number, or a range without width, is exact."""
    where = f"parameter {name!r}"
    if isinstance(given, ParameterRange):
        if not (np.isfinite(given.nominal) and np.isfinite(given.radius) and given.radius >= 0):
            raise InputError(where, f"{given.nominal} +- {given.radius}", "finite numbers, the radius not negative")
        return given if given.radius > 0 else float(given.nominal)
    numbers = list(given) if isinstance(given, (tuple, list, np.ndarray)) else [given]
    if any(isinstance(v, bool) or not isinstance(v, (int, float, np.integer, np.floating)) for v in numbers):
        expected = "a ParameterRange, (nominal, relative tolerance), (nominal, low, high) or a number"
        raise InputError(where, f"{given!r}", expected)
    values = [float(v) for v in numbers]
    if not np.isfinite(values).all():
        raise InputError(where, f"{given!r}", "finite numbers")
    if len(values) == 1:
        return values[0]
    if len(values) == 3:
        nominal, low, high = values
        return nominal if low == nominal == high else ParameterRange.between(low, high, nominal)
    if len(values) != 2:
        raise InputError(where, f"{len(values)} numbers", "(nominal, relative tolerance) or (nominal, low, high)")
    nominal, tolerance = values
    if tolerance < 0 or (nominal == 0 and tolerance):
        expected = "a share of the nominal value, 0.1 for 10 %, not negative"
        found = f"relative tolerance {tolerance:g} of {nominal:g}"
        raise InputError(where, found, expected, "give (nominal, low, high)")
    return ParameterRange(nominal, abs(nominal) * tolerance) if tolerance else nominal


def _ranges(parameters: Mapping[str, Any]) -> tuple[dict[str, ParameterRange], dict[str, float]]:
    if not isinstance(parameters, Mapping):
        raise InputError("parametric", f"parameters are a {type(parameters).__name__}", "a dictionary of ranges")
    for name in parameters:
        if not isinstance(name, str) or not name.isidentifier():
            expected = "letters, digits and _, not beginning with a digit"
            raise InputError("parametric", f"parameter name {name!r}", expected)
    read = {name: as_range(name, given) for name, given in parameters.items()}
    ranges = {name: value for name, value in read.items() if isinstance(value, ParameterRange)}
    return ranges, {name: value for name, value in read.items() if not isinstance(value, ParameterRange)}


Table = list[list[tuple[str, Any]]]
Values = Mapping[str, float]


def _entries(A: Any, B: Any, C: Any, D: Any) -> tuple[Table, int]:
    """Return ``[A B; C D]`` with the name of every entry, and the number of states."""
    rows = {name: _rows(name, given) for name, given in zip("ABCD", (A, B, C, D), strict=True)}
    n, n_y = len(rows["A"]), len(rows["D"])
    n_u = len(rows["D"][0]) if n_y else (len(rows["B"][0]) if rows["B"] else 0)
    if n == 0 and not rows["C"]:
        rows["C"] = [[] for _ in range(n_y)]
    for name, height, width in (("A", n, n), ("B", n, n_u), ("C", n_y, n), ("D", n_y, n_u)):
        given = rows[name]
        widths = {len(row) for row in given}
        if len(given) != height or widths - {width}:
            found = f"{name} is {len(given)} x {'/'.join(map(str, sorted(widths))) or 0}"
            raise InputError("parametric", found, f"{height} x {width} to match A and D")
    A, B, C, D = (
        [[(f"{name}[{i},{j}]", entry) for j, entry in enumerate(row)] for i, row in enumerate(given)]
        for name, given in rows.items()
    )
    return [left + right for left, right in zip(A + C, B + D, strict=True)], n


def _rows(name: str, given: Any) -> list[list[Any]]:
    rows = given.tolist() if isinstance(given, np.ndarray) else given
    if not isinstance(rows, (list, tuple)) or not all(isinstance(row, (list, tuple)) for row in rows):
        found = f"{name} is {type(given).__name__}"
        raise InputError("parametric", found, "a list of rows", "write [[...]] for one row")
    return [list(row) for row in rows]


def _check_size(expressions: Sequence[Sequence[Laurent]], algebra: Algebra) -> None:
    """Count the search of a decomposition, which visits every factor for every variable, as work."""
    every = [*(entry for row in expressions for entry in row), *algebra.denominators.values()]
    variables = len(set().union(*(entry.variables for entry in every)))
    algebra.count(SEARCH * variables * sum(len(entry.terms) + entry.factors for entry in every))


def _check_denominators(
    expressions: Sequence[Sequence[Laurent]], algebra: Algebra, ranges: Mapping[str, ParameterRange]
) -> None:
    """Check that no denominator vanishes in the ranges; inner ones come first in the algebra."""
    inside = {name: {name} for name in ranges}  # the parameters of each variable
    every = [*algebra.denominators.items(), *(("", entry) for row in expressions for entry in row)]
    for name, expression in every:
        for v, e in sorted({pair for monomial in expression.terms for pair in monomial}):
            if e < 0 and v in ranges and ranges[v].low <= 0 <= ranges[v].high:
                found = f"{v} = 0, inside its range {ranges[v].low:g} .. {ranges[v].high:g} {ranges[v].unit}".rstrip()
                raise NoTrustworthyNumber("parametric", f"a denominator vanishes at {found}")
        inside[name] = set[str]().union(*(inside[v] for v in expression.variables))
        if name:
            _exclude_zero(name, algebra, {v: ranges[v] for v in sorted(inside[name])})


def _exclude_zero(name: str, algebra: Algebra, ranges: Mapping[str, ParameterRange]) -> None:
    """Exclude a zero of a denominator by interval arithmetic over ever smaller boxes, after the signs at vertices."""
    expression = algebra.denominators[name]
    low, high, nominal = (np.array([getattr(r, end) for r in ranges.values()]) for end in ("low", "high", "nominal"))

    def bounds(lower: Array, upper: Array) -> tuple[float, float]:
        return _interval(expression, dict(zip(ranges, zip(lower, upper, strict=True), strict=True)), algebra)

    def text(point: Array) -> str:
        return ", ".join(f"{v} = {x:.6g}" for v, x in zip(ranges, point.tolist(), strict=True))

    start = bounds(nominal, nominal)[0]
    vertices = itertools.islice(itertools.product(*zip(low, high, strict=True)), DENOMINATOR_VERTICES)
    for corner in (nominal, *map(np.array, vertices)):
        if start * bounds(corner, corner)[0] <= 0:
            inside, outside = nominal, corner
            for _ in range(60):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if start * bounds(middle, middle)[0] > 0 else (inside, middle)
            raise NoTrustworthyNumber("parametric", f"denominator {name} vanishes at {text(outside)}")
    boxes = [(low, high)]
    for _ in range(DENOMINATOR_BOXES):
        if not boxes:
            return
        lower, upper = boxes.pop()
        if np.prod(bounds(lower, upper)) > 0:
            continue
        k = int(np.argmax((upper - lower) / (high - low)))
        left, right = upper.copy(), lower.copy()
        left[k] = right[k] = 0.5 * (lower[k] + upper[k])
        boxes += [(lower, left), (right, upper)]
    near = text(min((0.5 * (lower + upper) for lower, upper in boxes), key=lambda at: abs(bounds(at, at)[0])))
    raise NoTrustworthyNumber("parametric", f"a zero of the denominator {name} cannot be excluded near {near}")


def _interval(expression: Laurent, box: Mapping[str, tuple[float, float]], algebra: Algebra) -> tuple[float, float]:
    """Bound an expression over a box; (-inf, inf) where one of its own denominators may vanish there."""
    from flint import arb

    def ball(name: str) -> arb:
        low, high = box[name] if name in box else _interval(algebra.denominators[name], box, algebra)
        return arb(low) if low == high else arb(low).union(arb(high))

    balls = {name: ball(name) for name in expression.variables}
    total = arb(0)
    for monomial, c in expression.terms.items():
        term = arb(c.numerator) / c.denominator
        for name, e in monomial:
            for _ in range(abs(e)):  # the power of a ball that holds zero is NaN
                term = term * balls[name] if e > 0 else term / balls[name]
        total += term
    low, high = float(total.lower()), float(total.upper())
    return (low, high) if np.isfinite([low, high]).all() else (-np.inf, np.inf)


def _lft(
    expressions: Sequence[Sequence[Laurent]], algebra: Algebra, ranges: Mapping[str, ParameterRange]
) -> ConstantLft:
    """Return the LFT of a matrix in the parameters; a variable and its inverse are taken out each by itself."""
    from flint import fmpq

    entries = [((i, j), entry) for i, row in enumerate(expressions) for j, entry in enumerate(row)]
    names = sorted({(name, e < 0) for _, entry in entries for monomial in entry.terms for name, e in monomial})
    none = np.full((len(expressions), len(expressions[0]) if expressions else 0), fmpq(0))
    terms = {(0,) * len(names): none.copy()}
    for place, entry in entries:
        for monomial, c in entry.terms.items():
            powers = {(name, e < 0): abs(e) for name, e in monomial}
            key = tuple(powers.get(name, 0) for name in names)
            terms.setdefault(key, none.copy())[place] = fmpq(c.numerator, c.denominator)
    gains: dict[tuple[str, bool], ConstantLft] = {}
    one = np.ones((1, 1))
    for name, inverted in names:
        if name in ranges:
            base = ConstantLft((name,), 0 * one, one, ranges[name].radius * one, ranges[name].nominal * one)
        else:
            base = _lft([[algebra.denominators[name]]], algebra, ranges)
        gains[name, inverted] = base.inverse() if inverted else base
    polynomial = MatrixPolynomial(tuple(names), terms)
    return decomposition(polynomial, 0.0, lambda name: len(gains[name].names)).closed(gains)


def _missed(model: UncertainModel, table: Table, ranges: Mapping[str, ParameterRange], exact: Values) -> float:
    """Return the largest error of an entry against the texts at random values and at vertices, relative to its size."""
    rng, k, known = np.random.default_rng(0), len(ranges), {b.name for b in model.blocks}
    deltas = [np.zeros(k), np.ones(k), -np.ones(k), *rng.uniform(-1, 1, (4, k)), *rng.choice([-1.0, 1.0], (2, k))]
    wanted, off = [], []
    for delta in (dict(zip(ranges, row.tolist(), strict=True)) for row in deltas):
        values = {**exact, **{name: ranges[name].value(d) for name, d in delta.items()}}
        try:
            rows = [[walk(entry, float, values.__getitem__, values, where) for where, entry in row] for row in table]
            member = model.evaluate({name: d for name, d in delta.items() if name in known})
        except ZeroDivisionError:  # a factor that cancels, as in a/a at a = 0
            continue
        except NoTrustworthyNumber:
            return np.inf
        found = np.block([[member.A, member.B], [member.C, member.D]])
        wanted.append(np.array(rows, dtype=float).reshape(found.shape))
        off.append(np.abs(found - wanted[-1]))
    if not wanted or not wanted[0].size:
        return 0.0
    size = np.abs(wanted).max(axis=0)
    outer = np.minimum(size.max(axis=1, keepdims=True), size.max(axis=0, keepdims=True))
    size = np.maximum(size, 1e-6 * np.where(size > 0, 0.0, outer))
    return float((np.max(off, axis=0) / np.where(size > 0, size, 1.0)).max())


# Coefficients are exact rational numbers (a float is read as its shortest decimal form, so 0.1 is 1/10). A variable is
# a parameter, or a denominator of several terms, which has negative exponents only.

Monomial = tuple[tuple[str, int], ...]

MAX_TEXT = 10_000
MAX_DEPTH = 150
MAX_EXPONENT = 30
MAX_TERMS = 1000
LARGEST = 1e300
MAX_BITS = 8000
MAX_WORK = 2_000_000  # pairs of terms multiplied in all; a page of text could require billions
OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip


@dataclass
class Algebra:
    """Expressions over given parameters; collects the denominators of several terms."""

    parameters: tuple[str, ...]
    exact: Mapping[str, Fraction]  # parameters with one value, which replaces them
    nonzero: frozenset[str]  # parameters that are never zero in their range
    denominators: dict[str, Laurent] = field(default_factory=dict)  # by their text in parentheses
    work: int = 0  # pairs of terms multiplied so far

    def constant(self, value: Fraction | int) -> Laurent:
        return Laurent({(): Fraction(value)} if value else {}, self)

    def variable(self, name: str) -> Laurent:
        return self.constant(self.exact[name]) if name in self.exact else Laurent({((name, 1),): Fraction(1)}, self)

    def count(self, pairs: int) -> None:
        self.work += pairs
        if self.work > MAX_WORK:
            hint = "give a sum that occurs often a parameter of its own"
            raise InputError("parametric", f"more than {MAX_WORK} products of terms", "shorter expressions", hint)

    def read(self, entry: Any, where: str) -> Laurent:
        """Return the normal form of a matrix entry, a number or a text."""
        try:
            return walk(entry, self.constant, self.variable, self.parameters, where)
        except InputError as error:
            found = f"{short(entry)}: {error.found}" if error.where == "expression" else error.found
            raise InputError(where, found, error.expected, error.hint) from None


@dataclass(frozen=True)
class Laurent:
    """A sum of terms: monomial (sorted pairs of variable and exponent, none of them zero) -> coefficient, not zero."""

    terms: Mapping[Monomial, Fraction]
    algebra: Algebra = field(repr=False, compare=False)

    def _sum(self, terms: Iterable[tuple[Monomial, Fraction]]) -> Laurent:
        total: dict[Monomial, Fraction] = {}
        for monomial, c in terms:
            total[monomial] = total.get(monomial, Fraction(0)) + c
            if len(total) > MAX_TERMS:
                raise InputError("expression", "too many terms when multiplied out", f"at most {MAX_TERMS}")
        if any(c.numerator.bit_length() + c.denominator.bit_length() > MAX_BITS for c in total.values()):
            raise InputError("expression", "a coefficient of thousands of digits", "numbers of a usual size")
        return Laurent({m: c for m, c in total.items() if c}, self.algebra)

    def __add__(self, other: Laurent) -> Laurent:
        return self._sum([*self.terms.items(), *other.terms.items()])

    def __neg__(self) -> Laurent:
        return self._times((), Fraction(-1))

    def __sub__(self, other: Laurent) -> Laurent:
        return self + (-other)

    def __mul__(self, other: Laurent) -> Laurent:
        self.algebra.count(len(self.terms) * len(other.terms))
        pairs = product(self.terms.items(), other.terms.items())
        return self._sum((times(m1, m2), c1 * c2) for (m1, c1), (m2, c2) in pairs)

    def __truediv__(self, b: Laurent) -> Laurent:
        """Divide by the monomials and common factors of b; the rest becomes a new denominator."""
        if not b.terms:
            raise InputError("expression", "a division by zero")
        self.algebra.count(len(self.terms) * (len(self.terms) + len(b.terms)))
        common, lead, rest = _content(b)
        quotient = self._times(tuple((n, -e) for n, e in common), 1 / lead)
        if len(rest.terms) == 1:
            return quotient
        exact = _exact_quotient(quotient, rest)
        if exact is not None:
            return exact
        quotient, rest = _into_denominator(quotient, rest)
        name = f"({rest})"
        self.algebra.denominators[name] = rest
        return quotient._times(((name, -1),), Fraction(1))

    def __pow__(self, exponent: int) -> Laurent:
        if abs(exponent) > MAX_EXPONENT:
            raise InputError("expression", f"exponent {exponent}", f"at most {MAX_EXPONENT}")
        one = self.algebra.constant(1)
        if exponent < 0 and len(self.terms) > 1:  # 1/(a+b)^2 is (1/(a+b))^2: one denominator for every power
            return (one / self) ** -exponent
        result = reduce(operator.mul, [self] * abs(exponent), one)
        return result if exponent >= 0 else one / result

    def _times(self, monomial: Monomial, c: Fraction) -> Laurent:
        return Laurent({times(m, monomial): c * own for m, own in self.terms.items()}, self.algebra)

    @property
    def variables(self) -> set[str]:
        return {name for m in self.terms for name, _ in m}

    @property
    def factors(self) -> int:
        return sum(abs(e) for m in self.terms for _, e in m)

    def __str__(self) -> str:
        texts = []
        for monomial, c in sorted(self.terms.items()):
            factors = [name if e == 1 else f"{name}**{e}" for name, e in monomial]
            texts.append("*".join(factors if factors and c == 1 else [*factors, str(c)]))
        return " + ".join(texts) or "0"


def times(first: Monomial, second: Monomial) -> Monomial:
    exponents = dict(first)
    for name, e in second:
        exponents[name] = exponents.get(name, 0) + e
    return tuple(sorted((name, e) for name, e in exponents.items() if e))


def _content(b: Laurent) -> tuple[Monomial, Fraction, Laurent]:
    """Return the common factor of all terms, the first coefficient, and the rest, whose first coefficient is one."""
    # Only variables whose exponents have one sign in all terms: 1/(1 + 1/m) is not 1/m times something.
    exponents = {name: [dict(m).get(name, 0) for m in b.terms] for name in sorted(b.variables)}
    least = {name: max(min(e), 0) or min(max(e), 0) for name, e in exponents.items()}
    lead = b.terms[min(b.terms)]
    rest = b._times(tuple((n, -e) for n, e in least.items()), 1 / lead)
    return tuple((n, e) for n, e in least.items() if e), lead, rest


def _into_denominator(a: Laurent, b: Laurent) -> tuple[Laurent, Laurent]:
    """Return ``a / b`` with common factors of a moved into b if that reduces their number: 1/(1/x + 1/y)."""
    common = _content(a)[0] if a.terms else ()
    nonzero = a.algebra.nonzero
    down = tuple((name, -e) for name, e in common if e > 0 and name in nonzero and name in b.variables)
    turned = b._times(down, Fraction(1))
    if not down or turned.factors >= b.factors + len(a.terms) * sum(-e for _, e in down):
        return a, b
    lead = turned.terms[min(turned.terms)]
    return a._times(down, 1 / lead), turned._times((), 1 / lead)


def _exact_quotient(a: Laurent, b: Laurent) -> Laurent | None:
    """Return ``a / b`` where b divides a (as polynomials, in lexicographic order of the monomials), else None."""
    names = sorted(a.variables | b.variables)
    own = [e for m in (*a.terms, *b.terms) for n, e in m if n in b.variables]
    if min(own, default=0) < 0 or any(n.startswith("(") for n in b.variables):
        return None  # only plain polynomials are divided
    key = lambda m: [dict(m).get(n, 0) for n in names]  # noqa: E731
    lead = max(b.terms, key=key)
    rest, quotient = a, a.algebra.constant(0)
    for _ in range(MAX_TERMS):
        if not rest.terms:
            return quotient
        top = max(rest.terms, key=key)
        step = times(top, tuple((n, -e) for n, e in lead))
        if any(e < 0 for n, e in step if n in b.variables):
            return None
        share = rest.terms[top] / b.terms[lead]
        quotient, rest = quotient + Laurent({step: share}, a.algebra), rest - b._times(step, share)
    return None


def walk(
    entry: Any, constant: Callable[[Fraction], Any], variable: Callable[[str], Any], names: Iterable[str], where: str
) -> Any:
    """Evaluate an entry in the arithmetic of these constants and variables, without executing code."""
    if isinstance(entry, (int, float, np.integer, np.floating)) and not isinstance(entry, bool):
        return constant(_exact(entry, where))
    if not isinstance(entry, str):
        raise InputError(where, f"{short(entry)}", "a real number, or a text such as '-k/m'")
    if len(entry) > MAX_TEXT:
        raise InputError(where, f"an expression of {len(entry)} characters", f"at most {MAX_TEXT}")
    try:
        tree = ast.parse(entry.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = str(error) if isinstance(error, ValueError) else "nested too deeply"
        if isinstance(error, SyntaxError):  # Python's message on a number too long advises on its limits
            reason = "a number too long" if "integer string conversion" in error.msg else error.msg
        raise InputError(where, f"{short(entry)} cannot be read ({reason})", "an expression such as '-k/m'") from None
    known = {unicodedata.normalize("NFKC", name): name for name in names}  # as Python reads identifiers
    quoted = short(entry)

    def value(node: ast.expr, depth: int) -> Any:
        if depth > MAX_DEPTH:
            raise InputError(where, f"{quoted} is nested too deeply", f"at most {MAX_DEPTH} levels")
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return constant(_exact(node.value, where))
        if isinstance(node, ast.Name):
            if node.id not in known:
                raise unknown_name(where, f"{quoted}: no parameter {node.id!r}", node.id, known.values())
            return variable(known[node.id])
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            inner = value(node.operand, depth + 1)
            return -inner if isinstance(node.op, ast.USub) else inner
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            return value(node.left, depth + 1) ** _exponent(node.right, where, quoted)
        if isinstance(node, ast.BinOp):
            if type(node.op) not in OPERATORS:
                hint = "a power is written x**2" if isinstance(node.op, ast.BitXor) else None
                raise InputError(where, f"{quoted}: an operator that is none", "+ - * / **", hint)
            return OPERATORS[type(node.op)](value(node.left, depth + 1), value(node.right, depth + 1))
        word = f"{node.func.id}(...)" if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else "that"
        hint = "give sin(x), sqrt(x), ... a parameter of its own"
        raise InputError(where, f"{quoted}: {word} is no rational function", "numbers, parameters, + - * / **", hint)

    return value(tree.body, 0)


def _exponent(node: ast.expr, where: str, quoted: str) -> int:
    try:
        value = ast.literal_eval(node)
    except ValueError:
        value = None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value % 1 != 0:
        raise InputError(where, f"{quoted}: an exponent that is no whole number", "x**2, x**-1, ...")
    if abs(value) > MAX_EXPONENT:
        raise InputError(where, f"{quoted}: an exponent above {MAX_EXPONENT}", "a smaller one")
    return int(value)


def _exact(value: Any, where: str) -> Fraction:
    number = int(value) if isinstance(value, (int, np.integer)) else float(value)
    if not abs(number) <= LARGEST:
        word = "a huge number" if isinstance(number, int) else f"{number}"
        raise InputError(where, word, f"a finite number of at most {LARGEST:g}")
    return Fraction(number) if isinstance(number, int) else Fraction(repr(number))


def short(entry: Any) -> str:
    text = repr(entry)
    return text if len(text) <= 80 else f"{text[:77]}..."
