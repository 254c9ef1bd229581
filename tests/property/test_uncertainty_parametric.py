"""Parametric models: the LFT gives the matrices back, with few repetitions; what is no rational function is named."""

import ast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import ParameterRange, parametric
from robustlab.errors import InputError, NoTrustworthyNumber

SETTINGS = settings(max_examples=25)


def repeats(model):
    return {b.name: b.repeats for b in model.blocks}


def gain(rows, parameters):
    return parametric([], [], [], rows, parameters)


def tolerance(**nominal):
    return {name: (value, 0.2) for name, value in nominal.items()}


# --- published and textbook models ------------------------------------------------------------------------------------

SPRING = ([[0, 1], ["-k/m", "-c/m"]], [[0], ["1/m"]], [[1, 0]], [[0]])
TWO_MASS = (
    [[0, 0, 1, 0], [0, 0, 0, 1], ["-k/m1", "k/m1", "-c/m1", "c/m1"], ["k/m2", "-k/m2", "c/m2", "-c/m2"]],
    [[0], [0], ["1/m1"], [0]], [[0, 1, 0, 0]], [[0]],
)  # fmt: skip
MOTOR = ([["-R/L", "-K/L"], ["K/J", "-b/J"]], [["1/L"], [0]], [[0, 1]], [[0]])


@pytest.mark.parametrize(
    ("matrices", "parameters", "expected"),
    [
        # Gu, Petkov, Konstantinov: Robust Control Design with MATLAB, section 8.1
        (SPRING, {"m": (3.0, 0.4), "c": (1.0, 0.2), "k": (2.0, 0.3)}, {"m": 1, "c": 1, "k": 1}),
        # Wie and Bernstein's benchmark, with damping
        (TWO_MASS, tolerance(m1=1.0, m2=1.0, k=1.0, c=0.1), {"m1": 1, "m2": 1, "k": 1, "c": 1}),
        # K occurs in two rows and two columns: a matrix coefficient of rank 2 needs it twice
        (MOTOR, tolerance(R=2.0, L=0.5, K=0.1, J=0.02, b=0.1), {"R": 1, "L": 1, "K": 2, "J": 1, "b": 1}),
    ],
)
def test_published_models_have_minimal_repetitions(matrices, parameters, expected):
    assert repeats(parametric(*matrices, parameters)) == expected


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([["a**3 + a**2 + a + 1"]], {"a": 3}),  # degree 3 in one variable: 3 is the least
        ([["a", "a**2"], ["a**2", "a**3"]], {"a": 3}),
        ([["a*b", "a"], ["b", 1]], {"a": 1, "b": 1}),  # rank one: [a; 1] [b, 1]
        ([["(a + b)*(c + d)"]], {"a": 1, "b": 1, "c": 1, "d": 1}),
        ([["c*(1 + 2*a)/b**2"]], {"a": 1, "b": 2, "c": 1}),
        ([["1/(1 + 1/a)"]], {"a": 1}),
        ([["a*b/(a + b)"]], {"a": 1, "b": 1}),  # springs in series
        ([["(a + b)/(a + 2*b)"]], {"a": 1, "b": 1}),
        ([["(a*b + a*c)/(b + c)"]], {"a": 1}),  # divides
        ([["(a**2 - b**2)/(a + b)"]], {"a": 1, "b": 1}),
        ([["a - a", 0]], {}),
        ([["a/a"]], {}),
        ([["a", "2*a"], ["3*a", "6*a"]], {"a": 1}),
        ([["a", 0], [0, "a"]], {"a": 2}),
        ([[1.5]], {}),
    ],
)
def test_repetitions_of_small_expressions(rows, expected):
    assert repeats(gain(rows, tolerance(a=2.0, b=3.0, c=4.0, d=5.0))) == expected


# --- the LFT is the expression ----------------------------------------------------------------------------------------


@st.composite
def expressions(draw, depth=3):
    if depth == 0 or draw(st.integers(0, 3)) == 0:
        return draw(st.sampled_from(["a", "b", "c", "2", "0.3", "-1.5", "a", "b"]))
    left, right = draw(expressions(depth=depth - 1)), draw(expressions(depth=depth - 1))
    shape = draw(st.sampled_from(["({} + {})", "({} - {})", "({} * {})", "({} / {})", "({})**2", "({})**-1"]))
    return shape.format(left, right)


def value_of(text, values):
    """Python's own arithmetic."""
    return eval(compile(ast.parse(text, mode="eval"), "<test>", "eval"), {"__builtins__": {}}, dict(values))


@SETTINGS
@given(st.lists(st.lists(expressions(), min_size=2, max_size=2), min_size=1, max_size=2), st.integers(0, 1000))
def test_the_lft_is_the_expression(rows, seed):
    parameters = {"a": (2.0, 1.8, 2.4), "b": ParameterRange(3.0, 0.3), "c": 0.7}
    try:
        model = gain(rows, parameters)
    except NoTrustworthyNumber:
        return  # a denominator that vanishes; the cases below check those
    except InputError as error:
        assert "division by zero" in str(error)
        return
    known = {b.name for b in model.blocks}
    rng = np.random.default_rng(seed)
    for da, db in [*rng.uniform(-1, 1, (3, 2)), (1.0, -1.0), (-1.0, 1.0)]:
        values = {"a": 2.0 + (0.4 if da >= 0 else 0.2) * da, "b": 3.0 + 0.3 * db, "c": 0.7}
        wanted = np.array([[value_of(entry, values) for entry in row] for row in rows], dtype=float)
        found = model.evaluate({k: v for k, v in (("a", float(da)), ("b", float(db))) if k in known}).D
        np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(
    "rows",
    [
        [["1/0.3 - 1e12/(a*b)", 0, 0], [-1.5e-4, 0, "(2 + b)/b"], ["(b/0.3)**2/(0.3*(1e6 + b))", "0.09 + c*a", 0.3]],
        [["1e6*(a - 2*b)", "1/(a + 2.3 + d)"], ["d**2", "1e12*(-1.5e-4*c - 2/c)"], ["b", 0]],
        [[0, "(c**2 - (b + a))/-1.5e-4", "(b/1e6/a**2)**2"], ["1/d", "d**2 + 1e6", "a*c**2"]],
    ],
)
def test_entries_of_very_different_size_are_each_exact(rows):
    """Found by random expressions: a reduction that mixed entries of 1e14 with entries of 1e-10 lost the small ones."""
    nominal = {"a": 2.0, "b": 3e-3, "c": 1.0, "d": 4e4}
    model = gain(rows, {name: (value, 0.2) for name, value in nominal.items()})
    rng = np.random.default_rng(1)
    for delta in rng.uniform(-1, 1, (5, 4)):
        values = {name: value * (1 + 0.2 * d) for (name, value), d in zip(nominal.items(), delta, strict=True)}
        wanted = np.array([[value_of(str(entry), values) for entry in row] for row in rows], dtype=float)
        known = {b.name for b in model.blocks}
        found = model.evaluate({n: float(d) for n, d in zip(nominal, delta, strict=True) if n in known}).D
        np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-30)


def test_signals_ranges_and_physical_values():
    ranges = {"m": ParameterRange(3.0, 1.2, "kg"), "c": (1.0, 0.2), "k": (2.0, 1.5, 3.0)}
    model = rl.parametric(*SPRING, ranges, inputs=[("F", "N")], outputs=[("x", "m")], states=["x", "v"])
    assert (model.inputs, model.outputs) == ((("F", "N"),), (("x", "m"),))
    assert model.M.state_names == ("x", "v")
    assert model.physical({"m": 1.0, "k": -1.0}) == {"m": (4.2, "kg"), "c": (1.0, ""), "k": (1.5, "")}
    member = model.evaluate({"m": 1.0, "k": -1.0})
    np.testing.assert_allclose(member.A, [[0, 1], [-1.5 / 4.2, -1 / 4.2]], atol=1e-15)
    again = rl.parametric(*SPRING, {**ranges, "m": 3.0})  # a number is exact
    assert repeats(again) == {"c": 1, "k": 1}
    assert repeats(rl.parametric(*SPRING, {"m": (3.0, 0.0), "c": 1, "k": (2.0, 2.0, 2.0)})) == {}


# --- denominators -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "parameters", "match"),
    [
        ("1/a", {"a": (1.0, -1.0, 2.0)}, "vanishes at a = 0, inside its range -1 .. 2"),
        ("1/(a - b)", {"a": (2.0, 0.5), "b": (1.5, 0.1)}, r"denominator .* vanishes at a = 1\.[0-9]*, b = 1\."),
        ("1/(a*b - 1)", {"a": (2.0, 0.5), "b": (1.0, 0.5)}, "vanishes at a = "),
        ("1/(a - 1)", {"a": (1.0, 0.5)}, "vanishes at a = 1"),
        ("1/(1 + 1/(a - 2))", {"a": (5.0, 1.5, 6.0)}, "vanishes at a = 2"),
        ("1/(a**2 - 2*a + 1)", {"a": (1.2, 0.3)}, "a zero of the denominator .* cannot be excluded near a = (1|0.99)"),
    ],
)
def test_denominators_that_vanish_are_named(text, parameters, match):
    with pytest.raises(NoTrustworthyNumber, match=match):
        gain([[text]], parameters)


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "match"),
    [
        ("sin(a)", r"sin\(...\) is no rational function"),
        ("__import__('os').system('true')", "no rational function"),
        ("a^2", r"a power is written x\*\*2"),
        ("a**b", "an exponent that is no whole number"),
        ("a**31", "an exponent above 30"),
        ("d", "no parameter 'd'"),
        ("", "cannot be read"),
        ("a" * 10_001, "10001 characters"),
        ("-" * 400 + "a", "nested too deeply"),
        ("-" * 9000 + "a", r"cannot be read \(nested too deeply\)"),
        ("a*" + "9" * 5000, r"cannot be read \(a number too long\)"),
        ("(" * 300 + "a" + ")" * 300, "cannot be read"),
        ("(a + b + 1/a + 1/b + a*b)**30", "terms when multiplied out"),
        ("1e400", "inf"),
        ("1" + "0" * 400, "huge number"),
        ("a/(b - b)", "division by zero"),
        ("a // b", "an operator that is none"),
        ("1j*a", "no rational function"),
        (np.nan, "nan"),
        (1j, "a real number, or a text"),
        (None, "a real number, or a text"),
        (True, "a real number, or a text"),
    ],
)
def test_entries_that_are_none(entry, match):
    with pytest.raises(InputError, match=match) as caught:
        gain([["a", entry]], {"a": (2.0, 0.1), "b": (3.0, 0.1)})
    assert "D[0,1]" in str(caught.value)


RANGES = [
    ((1.0, 2.0, 3.0), "low < nominal < high"),
    ((1.0, 0.5, 0.7), "low < nominal < high"),
    ((1.0, -0.1), "relative tolerance -0.1"),
    ((0.0, 0.1), "relative tolerance 0.1 of 0"),
    ((1.0, np.nan), "finite numbers"),
    ((1.0, 0.1, 0.2, 0.3), "4 numbers"),
    ("1 +- 10 %", "a ParameterRange"),
    (True, "a ParameterRange"),
    (ParameterRange(np.inf, 1.0), "finite numbers"),
    (ParameterRange(1.0, -1.0), "not negative"),
]


@pytest.mark.parametrize(
    ("matrices", "given_range", "match"),
    [
        *((([], [], [], [["a"]]), given_range, match) for given_range, match in RANGES),
        (([["a"]], [[1]], [[1, 2]], [[0]]), (1.0, 0.1), "C is 1 x 2, expected 1 x 1"),
        (([["a", 1]], [[1]], [[1]], [[0]]), (1.0, 0.1), "A is 1 x 2"),
        (([["a"], [1, 2]], [[1]], [[1]], [[0]]), (1.0, 0.1), "A is 2 x 1/2"),
        (([["a"]], [], [[1]], [[0]]), (1.0, 0.1), "B is 0 x 0"),
        (("a", [[1]], [[1]], [[0]]), (1.0, 0.1), "A is str"),
        (([["a"]], [[1]], [[1]], [0]), (1.0, 0.1), "D is list"),
        (([], [], [], [["(1e200*a)**3"]]), (1.0, 0.1), "overflow"),
    ],
)
def test_ranges_and_shapes_that_are_none(matrices, given_range, match):
    with pytest.raises(InputError, match=match):
        parametric(*matrices, {"a": given_range})
