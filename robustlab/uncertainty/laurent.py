"""Rational expressions of named parameters in an exact normal form: Laurent polynomials, safely read from text."""

# Coefficients are exact rational numbers (a float is read as its shortest decimal form, so 0.1 is 1/10). A variable is
# a parameter, or a denominator of several terms, which has negative exponents only.

from __future__ import annotations

import ast
import operator
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import reduce
from itertools import product
from typing import Any

import numpy as np

from robustlab.errors import InputError, did_you_mean

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
            raise InputError("expression", f"more than {MAX_WORK} products of terms in all", "shorter expressions")

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
    return (
        tuple((n, e) for n, e in least.items() if e),
        lead,
        b._times(tuple((n, -e) for n, e in least.items()), 1 / lead),
    )


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


# --- reading ---------------------------------------------------------------------------------------------------------


def walk(
    entry: Any,
    constant: Callable[[Fraction], Any],
    variable: Callable[[str], Any],
    names: Iterable[str],
    where: str,
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
                given = tuple(known.values())
                expected = f"one of {', '.join(given) or 'none'}"
                raise InputError(where, f"{quoted}: no parameter {node.id!r}", expected, did_you_mean(node.id, given))
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
