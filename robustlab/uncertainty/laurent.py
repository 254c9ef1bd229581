"""Rational expressions of named parameters in an exact normal form: Laurent polynomials, safely read from text."""

# Coefficients are exact rational numbers (a float counts as the shortest decimal number that is written like it, so
# that 0.1 is 1/10). A variable is a parameter, or a denominator of several terms, which occurs with negative
# exponents only.

from __future__ import annotations

import ast
import operator
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
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
MAX_WORK = 2_000_000  # pairs of terms that are multiplied in all; a text of a page could ask for billions


@dataclass(frozen=True)
class Laurent:
    """A sum of terms: monomial (sorted pairs of variable and exponent, none of them zero) -> coefficient, not zero."""

    terms: Mapping[Monomial, Fraction]

    def __add__(self, other: Laurent) -> Laurent:
        total = dict(self.terms)
        for monomial, c in other.terms.items():
            total[monomial] = total.get(monomial, Fraction(0)) + c
        return Laurent({m: c for m, c in total.items() if c})

    def __neg__(self) -> Laurent:
        return Laurent({m: -c for m, c in self.terms.items()})

    def __sub__(self, other: Laurent) -> Laurent:
        return self + (-other)

    def __mul__(self, other: Laurent) -> Laurent:
        if len(self.terms) * len(other.terms) > 100 * MAX_TERMS:
            raise InputError("expression", "too many terms when multiplied out", f"at most {MAX_TERMS}")
        total: dict[Monomial, Fraction] = {}
        for m1, c1 in self.terms.items():
            for m2, c2 in other.terms.items():
                m = times(m1, m2)
                total[m] = total.get(m, Fraction(0)) + c1 * c2
        if len(total) > MAX_TERMS:
            raise InputError("expression", f"{len(total)} terms when multiplied out", f"at most {MAX_TERMS}")
        if any(c.numerator.bit_length() + c.denominator.bit_length() > MAX_BITS for c in total.values()):
            raise InputError("expression", "a coefficient of thousands of digits", "numbers of a usual size")
        return Laurent({m: c for m, c in total.items() if c})

    @property
    def variables(self) -> set[str]:
        """All variables that occur."""
        return {name for m in self.terms for name, _ in m}

    def __str__(self) -> str:
        return " + ".join(_term_text(m, c) for m, c in sorted(self.terms.items())) or "0"


def times(first: Monomial, second: Monomial) -> Monomial:
    """Product of two monomials."""
    exponents = dict(first)
    for name, e in second:
        exponents[name] = exponents.get(name, 0) + e
    return tuple(sorted((name, e) for name, e in exponents.items() if e))


def constant(value: Fraction | int) -> Laurent:
    """A number as an expression."""
    return Laurent({(): Fraction(value)} if value else {})


@dataclass
class Algebra:
    """Expressions over given parameters; collects the denominators of several terms that occur."""

    parameters: tuple[str, ...]  # names that may occur
    exact: Mapping[str, Fraction] = field(default_factory=dict)  # those that have one value only: it takes their place
    nonzero: frozenset[str] = frozenset()  # those that are never zero in their range: a division by them is safe
    # Name of a denominator (its text in parentheses) -> the denominator.
    denominators: dict[str, Laurent] = field(default_factory=dict)
    work: int = 0  # pairs of terms multiplied so far

    def variable(self, name: str) -> Laurent:
        """A parameter as an expression."""
        if name in self.exact:
            return constant(self.exact[name])
        return Laurent({((name, 1),): Fraction(1)})

    def multiply(self, a: Laurent, b: Laurent) -> Laurent:
        """``a * b``, counted."""
        self._count(len(a.terms) * len(b.terms))
        return a * b

    def _count(self, pairs: int) -> None:
        self.work += pairs
        if self.work > MAX_WORK:
            raise InputError("expression", f"more than {MAX_WORK} products of terms in all", "shorter expressions")

    def divide(self, a: Laurent, b: Laurent) -> Laurent:
        """``a / b``; monomials and common factors of b are taken out, the rest becomes a denominator of its own."""
        if not b.terms:
            raise InputError("expression", "a division by zero")
        self._count(len(a.terms) * (len(a.terms) + len(b.terms)))
        factor, rest = _content(b)
        quotient = a * Laurent({tuple((n, -e) for n, e in factor[0]): 1 / factor[1]})
        if len(rest.terms) == 1:
            return quotient
        exact = _exact_quotient(quotient, rest)
        if exact is not None:
            return exact
        quotient, rest = self._into_denominator(quotient, rest)
        name = f"({rest})"
        self.denominators[name] = rest
        return quotient * Laurent({((name, -1),): Fraction(1)})

    def _into_denominator(self, a: Laurent, b: Laurent) -> tuple[Laurent, Laurent]:
        """``a / b`` with common factors of a moved into b where that leaves fewer: 1/(1/x + 1/y) for xy/(x + y)."""
        common, _ = _content(a) if a.terms else (((), Fraction(1)), a)
        down = tuple((name, -e) for name, e in common[0] if e > 0 and name in self.nonzero and name in b.variables)
        turned = Laurent({times(m, down): c for m, c in b.terms.items()})
        moved = len(a.terms) * sum(-e for _, e in down)
        if not down or _factors(turned) >= _factors(b) + moved:
            return a, b
        lead = turned.terms[min(turned.terms)]
        return (
            Laurent({times(m, down): c / lead for m, c in a.terms.items()}),
            Laurent({m: c / lead for m, c in turned.terms.items()}),
        )

    def power(self, a: Laurent, exponent: int) -> Laurent:
        """``a ** exponent`` for a whole exponent."""
        if abs(exponent) > MAX_EXPONENT:
            raise InputError("expression", f"exponent {exponent}", f"at most {MAX_EXPONENT}")
        result = constant(1)
        for _ in range(abs(exponent)):
            result = self.multiply(result, a)
        if exponent >= 0:
            return result
        if len(a.terms) > 1:  # 1/(a+b)^2 is (1/(a+b))^2: one denominator for every power
            return self.power(self.divide(constant(1), a), -exponent)
        return self.divide(constant(1), result)


def _factors(a: Laurent) -> int:
    """Number of factors in all terms."""
    return sum(abs(e) for m in a.terms for _, e in m)


def _content(b: Laurent) -> tuple[tuple[Monomial, Fraction], Laurent]:
    """A common factor of all terms (monomial, coefficient) and what is left, whose first coefficient is one."""
    # Only variables whose exponents have one sign in all terms: 1/(1 + 1/m) is not 1/m times something.
    common: list[tuple[str, int]] = []
    for name in sorted(b.variables):
        exponents = [dict(m).get(name, 0) for m in b.terms]
        e = min(exponents) if min(exponents) > 0 else max(exponents) if max(exponents) < 0 else 0
        if e:
            common.append((name, e))
    inverse = tuple((name, -e) for name, e in common)
    lead = b.terms[min(b.terms)]
    rest = Laurent({times(m, inverse): c / lead for m, c in b.terms.items()})
    return (tuple(common), lead), rest


def _exact_quotient(a: Laurent, b: Laurent) -> Laurent | None:
    """``a / b`` where b divides a (as polynomials, in lexicographic order of the monomials), else None."""
    names = sorted(a.variables | b.variables)
    shift = {n: min([0, *(dict(m).get(n, 0) for m in [*a.terms, *b.terms])]) for n in names}
    if any(n.startswith("(") for n in b.variables) or any(shift[n] < 0 for n in b.variables):
        return None  # only plain polynomials are divided

    def key(m: Monomial) -> tuple[int, ...]:
        exponents = dict(m)
        return tuple(exponents.get(n, 0) for n in names)

    lead = max(b.terms, key=key)
    down = tuple((n, -e) for n, e in lead)
    rest, quotient = a, constant(0)
    for _ in range(MAX_TERMS):
        if not rest.terms:
            return quotient
        top = max(rest.terms, key=key)
        step = times(top, down)
        if any(e < shift[n] for n, e in step):
            return None
        part = Laurent({step: rest.terms[top] / b.terms[lead]})
        quotient, rest = quotient + part, rest - part * b
    return None


# --- reading ---------------------------------------------------------------------------------------------------------


def parsed(entry: Any, algebra: Algebra, where: str) -> Laurent:
    """One matrix entry, a number or a text, in normal form."""
    one = algebra.variable
    try:
        return walk(
            entry,
            _Arithmetic(constant, one, algebra.multiply, algebra.divide, algebra.power),
            algebra.parameters,
            where,
        )
    except InputError as error:
        if error.where == "expression":
            raise InputError(where, f"{_short(entry)}: {error.found}", error.expected, error.hint) from None
        raise


@dataclass(frozen=True)
class _Arithmetic:
    """What the walk through an expression needs of its numbers."""

    constant: Callable[[Fraction], Any]
    variable: Callable[[str], Any]
    multiply: Callable[[Any, Any], Any]
    divide: Callable[[Any, Any], Any]
    power: Callable[[Any, int], Any]


def number_arithmetic(values: Mapping[str, float]) -> _Arithmetic:
    """Arithmetic of plain floats at given parameter values: a second way through the same text."""
    return _Arithmetic(float, values.__getitem__, operator.mul, operator.truediv, lambda a, n: a**n)


def walk(entry: Any, arithmetic: _Arithmetic, names: Iterable[str], where: str) -> Any:
    """The value of an entry in some arithmetic; nothing is ever executed."""
    if isinstance(entry, (int, float, np.integer, np.floating)) and not isinstance(entry, bool):
        return arithmetic.constant(_exact(entry, where))
    if not isinstance(entry, str):
        raise InputError(where, f"{_short(entry)}", "a real number, or a text such as '-k/m'")
    if len(entry) > MAX_TEXT:
        raise InputError(where, f"an expression of {len(entry)} characters", f"at most {MAX_TEXT}")
    try:
        tree = ast.parse(entry.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = str(error) if isinstance(error, ValueError) else "nested too deeply"
        if isinstance(error, SyntaxError):  # a whole number of thousands of digits brings advice about Python's limits
            reason = "a number too long" if "integer string conversion" in error.msg else error.msg
        raise InputError(where, f"{_short(entry)} cannot be read ({reason})", "an expression such as '-k/m'") from None
    known = {unicodedata.normalize("NFKC", name): name for name in names}  # as Python reads identifiers
    return _Walk(arithmetic, known, entry, where).value(tree.body, 0)


@dataclass(frozen=True)
class _Walk:
    arithmetic: _Arithmetic
    known: Mapping[str, str]
    text: str
    where: str

    def value(self, node: ast.expr, depth: int) -> Any:
        if depth > MAX_DEPTH:
            raise InputError(self.where, f"{_short(self.text)} is nested too deeply", f"at most {MAX_DEPTH} levels")
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return self.arithmetic.constant(_exact(node.value, self.where))
        if isinstance(node, ast.Name):
            return self._variable(node.id)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            value = self.value(node.operand, depth + 1)
            return -value if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.BinOp):
            return self._operation(node, depth)
        word = f"{node.func.id}(...)" if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else "that"
        found = f"{_short(self.text)}: {word} is no rational function"
        raise InputError(
            self.where, found, "numbers, parameters, + - * / **", "give sin(x), sqrt(x), ... a parameter of its own"
        )

    def _variable(self, name: str) -> Any:
        if name not in self.known:
            names = tuple(self.known.values())
            raise InputError(
                self.where,
                f"{_short(self.text)}: no parameter {name!r}",
                f"one of {', '.join(names) or 'none'}",
                did_you_mean(name, names),
            )
        return self.arithmetic.variable(self.known[name])

    def _operation(self, node: ast.BinOp, depth: int) -> Any:
        if isinstance(node.op, ast.Pow):
            return self.arithmetic.power(self.value(node.left, depth + 1), self._exponent(node.right))
        if not isinstance(node.op, (ast.Add, ast.Sub, ast.Mult, ast.Div)):
            hint = "a power is written x**2" if isinstance(node.op, ast.BitXor) else None
            raise InputError(self.where, f"{_short(self.text)}: an operator that is none", "+ - * / **", hint)
        left, right = self.value(node.left, depth + 1), self.value(node.right, depth + 1)
        if isinstance(node.op, ast.Add):
            return left + right
        if isinstance(node.op, ast.Sub):
            return left - right
        return (self.arithmetic.multiply if isinstance(node.op, ast.Mult) else self.arithmetic.divide)(left, right)

    def _exponent(self, node: ast.expr) -> int:
        sign = 1
        while isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
            sign = -sign if isinstance(node.op, ast.USub) else sign
            node = node.operand
        value = node.value if isinstance(node, ast.Constant) else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value % 1 != 0:
            raise InputError(
                self.where, f"{_short(self.text)}: an exponent that is no whole number", "x**2, x**-1, ..."
            )
        if value > MAX_EXPONENT:
            raise InputError(self.where, f"{_short(self.text)}: an exponent above {MAX_EXPONENT}", "a smaller one")
        return sign * int(value)


def _exact(value: Any, where: str) -> Fraction:
    number = int(value) if isinstance(value, (int, np.integer)) else float(value)
    if not abs(number) <= LARGEST:
        word = "a huge number" if isinstance(number, int) else f"{number}"
        raise InputError(where, word, f"a finite number of at most {LARGEST:g}")
    return Fraction(number) if isinstance(number, int) else Fraction(repr(number))


def _term_text(monomial: Monomial, coefficient: Fraction) -> str:
    factors = [name if e == 1 else f"{name}**{e}" for name, e in monomial]
    if coefficient == 1 and factors:
        return "*".join(factors)
    return "*".join([*factors, str(coefficient)])


def _short(entry: Any) -> str:
    text = repr(entry)
    return text if len(text) <= 80 else f"{text[:77]}..."
