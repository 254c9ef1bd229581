"""Every operation on sets, evaluated at a Delta, is the same operation on the two members, in the frequency domain."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab import ComplexScalar, FullBlock, ParameterRange, RealScalar, UncertainModel, frequency_response
from robustlab.errors import InputError, NoTrustworthyNumber, UnitMismatch
from robustlab.statespace import StateSpaceModel

SETTINGS = settings(max_examples=20)
OMEGA = np.array([0.0, 0.7, 20.0])
SHARED = RealScalar("k", 1, ParameterRange(1.0, 0.5, "N/m", below=0.25))
seeds = st.integers(0, 100_000)
few = st.integers(0, 2)


def random_set(seed, n, n_y, n_u, own, dt=0.0, states=True):
    """A set with the shared parameter k (repeated), a complex scalar and a full block of its own."""
    rng = np.random.default_rng(seed)
    blocks = [RealScalar("k", int(rng.integers(1, 3)), SHARED.parameter), ComplexScalar(f"c{own}")]
    blocks += [FullBlock(f"f{own}", 1, 2)] if seed % 2 else []
    blocks = [blocks[i] for i in rng.permutation(len(blocks))]
    q, p = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    m = StateSpaceModel(
        rng.standard_normal((n, n)) - 3 * np.eye(n),
        rng.standard_normal((n, q + n_u)),
        rng.standard_normal((p + n_y, n)),
        0.15 * rng.standard_normal((p + n_y, q + n_u)),
        dt,
    )
    return UncertainModel(m, blocks)


def values_for(seed, *sets):
    rng = np.random.default_rng(seed)
    values = {}
    for b in {b.name: b for s in sets for b in s.blocks}.values():
        if isinstance(b, RealScalar):
            values[b.name] = float(rng.uniform(-1, 1))
        elif isinstance(b, ComplexScalar):
            values[b.name] = complex(*rng.uniform(-0.7, 0.7, 2))
        else:
            part = rng.standard_normal((b.rows, b.cols)) + 1j * rng.standard_normal((b.rows, b.cols))
            values[b.name] = part / np.linalg.norm(part, 2)
    return values


def at(model, values):
    known = {b.name for b in model.blocks}
    return model.response(OMEGA, {name: v for name, v in values.items() if name in known})


def assert_same(found, wanted):
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10 * max(1.0, np.abs(wanted).max(initial=0.0)))


@SETTINGS
@given(seeds, few, few, st.integers(1, 3), st.integers(1, 3), st.integers(1, 2), st.sampled_from([0.0, 0.1]))
def test_product_sum_and_concatenation(seed, n1, n2, size, middle, width, dt):
    f = random_set(seed, n1, middle, width, "1", dt)
    g = random_set(seed + 1, n2, size, middle, "2", dt)
    h = random_set(seed + 2, n2, middle, width, "3", dt)
    values = values_for(seed, f, g, h)
    F, G, H = (at(x, values) for x in (f, g, h))
    assert_same(at(g @ f, values), G @ F)
    assert_same(at(f + h, values), F + H)
    assert_same(at(f - h, values), F - H)
    assert_same(at(-f, values), -F)
    assert_same(at(2.5 * f, values), 2.5 * F)
    gain = np.random.default_rng(seed).standard_normal((2, middle))
    assert_same(at(gain @ f, values), gain @ F)
    assert_same(at(f + np.ones((middle, width)), values), F + 1)
    assert_same(at(np.ones((middle, width)) - f, values), 1 - F)
    assert_same(at(f / 2, values), F / 2)
    assert_same(at(f[:, 0], values), F[:, :, :1])
    assert_same(at(f[[0], :], values), F[:, :1])
    for result in (g @ f, f + h):
        names = [b.name for b in result.blocks]
        assert len(set(names)) == len(names)
        assert {b.name for s in (f, g) for b in s.blocks if s is f} <= set(names)


@SETTINGS
@given(seeds, few, few, st.integers(1, 2), st.integers(1, 2), st.sampled_from([1, -1]))
def test_feedback_and_inverse(seed, n1, n2, n_y, n_u, sign):
    g, h = random_set(seed, n1, n_y, n_u, "1"), random_set(seed + 1, n2, n_u, n_y, "2")
    values = values_for(seed, g, h)
    G, H = at(g, values), at(h, values)
    loop = np.eye(n_y) - sign * G @ H
    assume(np.linalg.cond(loop).max() < 1e3)
    assert_same(at(g.feedback(h, sign), values), np.linalg.solve(loop, G))
    if n_y == n_u:
        assume(np.linalg.cond(g.nominal.D) < 1e3)
        assume(np.linalg.cond(G).max() < 1e3)
        assert_same(at(g.inverse(), values), np.linalg.inv(G))
        assert_same(at(g**-1, values), np.linalg.inv(G))
        assert_same(at(g**0, values), np.broadcast_to(np.eye(n_y), G.shape))
        assert g.inverse().inputs == g.outputs
        if not any(isinstance(b, FullBlock) for b in g.blocks):  # a full block occurs once only
            unit = at(g.inverse() @ g, values)
            assert_same(unit, np.broadcast_to(np.eye(n_y), unit.shape))


@SETTINGS
@given(seeds, few, few, st.integers(0, 2), st.integers(0, 2), st.integers(0, 2), st.integers(0, 2))
def test_star_product_and_both_lfts(seed, n1, n2, over, back, extra1, extra2):
    f = random_set(seed, n1, extra1 + over, extra2 + back, "1")
    g = random_set(seed + 1, n2, back + 1, over + 1, "2")
    values = values_for(seed, f, g)
    F, G = at(f, values), at(g, values)
    f11, f12 = F[:, :extra1, :extra2], F[:, :extra1, extra2:]
    f21, f22 = F[:, extra1:, :extra2], F[:, extra1:, extra2:]
    g11, g12, g21, g22 = G[:, :back, :over], G[:, :back, over:], G[:, back:, :over], G[:, back:, over:]
    # y1 = f21 u1 + f22 x, x = g11 y1 + g12 v
    loop = np.eye(over) - f22 @ g11
    assume(loop.size == 0 or np.linalg.cond(loop).max() < 1e3)
    y_u, y_v = np.linalg.solve(loop, f21), np.linalg.solve(loop, f22 @ g12)
    wanted = np.block([[f11 + f12 @ g11 @ y_u, f12 @ (g12 + g11 @ y_v)], [g21 @ y_u, g22 + g21 @ y_v]])
    assert_same(at(rl.lft(f, g, over, back), values), wanted)
    inner = random_set(seed + 2, n2, back, over, "3")
    values = values_for(seed, f, g, inner)
    F, G, K = (at(x, values) for x in (f, g, inner))
    f11, f12, f21, f22 = F[:, :extra1, :extra2], F[:, :extra1, extra2:], F[:, extra1:, :extra2], F[:, extra1:, extra2:]
    loop = np.eye(over) - f22 @ K
    assume(loop.size == 0 or np.linalg.cond(loop).max() < 1e3)
    assert_same(at(rl.lft(f, inner, over, back), values), f11 + f12 @ K @ np.linalg.solve(loop, f21))
    k = random_set(seed + 3, n1, over, back, "4")  # an upper LFT: the inner one closes the first channels
    values = values_for(seed, g, k)
    G, K = at(g, values), at(k, values)
    g11, g12, g21, g22 = G[:, :back, :over], G[:, :back, over:], G[:, back:, :over], G[:, back:, over:]
    loop = np.eye(back) - g11 @ K
    assume(loop.size == 0 or np.linalg.cond(loop).max() < 1e3)
    assert_same(at(rl.lft(k, g, over, back), values), g22 + g21 @ K @ np.linalg.solve(loop, g12))


def gain_of(name, value=1.0, radius=0.5, **names):
    """1 x 1: value + radius * delta."""
    m = StateSpaceModel([], [], [], [[0.0, radius], [1.0, value]], inputs=["w", "u"], outputs=["z", "y"])
    return UncertainModel(m, [RealScalar(name, 1, ParameterRange(value, radius, **names))])


def test_the_same_name_is_the_same_parameter():
    k = gain_of("k")
    assert pytest.approx(0.0, abs=1e-15) == (k - k).evaluate({"k": 0.7}).D
    assert (k + k).blocks[0].repeats == 1  # one repetition carries 2 k
    square = k @ k
    assert square.blocks[0].repeats == 2
    assert pytest.approx(1.3**2) == (k**2).evaluate({"k": 0.6}).D
    assert pytest.approx(1.3**2) == square.evaluate({"k": 0.6}).D
    same = k.inverse() @ k
    assert [b.name for b in same.blocks] == ["k"]  # without effect, but still known
    assert pytest.approx(1.0) == same.evaluate({"k": 0.4}).D


def test_a_full_block_of_one_entry_is_a_scalar_that_may_repeat():
    small = UncertainModel(StateSpaceModel([], [], [], [[0.0, 1.0], [1.0, 1.0]]), [FullBlock("d", 1, 1)])
    twice = small @ small
    assert twice.blocks == (ComplexScalar("d", 2),)
    assert twice.response([1.0], {"d": 0.5j})[0, 0, 0] == pytest.approx((1 + 0.5j) ** 2)


def test_signals_are_named():
    f = UncertainModel(
        StateSpaceModel([[-1.0]], [[1.0, 2.0]], [[1.0], [1.0]], np.zeros((2, 2)), inputs=["w", ("u", "V")],
                        outputs=["z", ("y", "m")], states=["x"]), [RealScalar("k")])  # fmt: skip
    assert [s.name for s in (f + f).M.states] == ["x", "x_2"]
    assert (np.eye(1) @ f).inputs == f.inputs
    assert (2 * f).outputs == f.outputs
    assert (f * 2).inputs == f.inputs
    assert (f + 0.0).outputs == f.outputs
    assert (0.0 + f).outputs == f.outputs
    with pytest.raises(UnitMismatch, match=r"y \[m\] meets u \[V\]"):
        f @ f
    named = StateSpaceModel([], [], [], [[1.0]], inputs=["w:k"], outputs=["z:k"])
    assert (named @ gain_of("k")).outputs == named.outputs  # a signal called like a channel


def test_mixed_operands_and_edge_sizes():
    k = gain_of("k")
    lag = StateSpaceModel([[-2.0]], [[1.0]], [[1.0]], [[0.0]])
    assert (lag @ k).evaluate({"k": 1.0}).dc_gain() == pytest.approx(0.75)
    assert (k @ lag).M.n_states == 1
    assert (lag + k).evaluate({"k": -1.0}).dc_gain() == pytest.approx(1.0)
    empty = StateSpaceModel([], [], [], np.zeros((1, 0)))
    assert (k @ empty).evaluate({"k": 1.0}).D.shape == (1, 0)
    nothing = UncertainModel(
        StateSpaceModel(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0))), ()
    )
    assert nothing.inverse().delta_shape == (0, 0)


LAG = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
DIGITAL = StateSpaceModel([[0.1]], [[1.0]], [[1.0]], [[0.0]], 0.1)
K, FORCE = gain_of("k"), gain_of("k", unit="N")
FULL = UncertainModel(StateSpaceModel([], [], [], np.ones((3, 3))), [FullBlock("d", 2, 2)])
DYNAMIC = UncertainModel(StateSpaceModel([], [], [], [[0.5, 1.0], [1.0, 1.0]]), [ComplexScalar("c")])
OPERANDS = [
    (lambda: K + UncertainModel(K.M, [ComplexScalar("k")]), r"'k'.*RealScalar in one operand and a ComplexScalar"),
    (lambda: K + gain_of("k", 1.0, 0.4), r"'k'.*in one operand and"),
    (lambda: K @ UncertainModel(K.M, [RealScalar("k")]), r"'k'.*in one operand and"),
    (lambda: FULL + FULL, r"'d'.*full block in several operands"),
    (lambda: K @ np.ones((2, 1)), "2 outputs into 1 inputs"),
    (lambda: K + np.eye(2), "equal sizes"),
    (lambda: [[1.0], [1.0]] @ K + 1.0, "numpy.eye"),
    (lambda: K.feedback(K, 0), "sign: 0"),
    (lambda: K.feedback(np.eye(2)), "2 x 2, expected 1 x 1"),
    (lambda: ([[1.0], [1.0]] @ K).feedback(1.0), "the number 1.0"),
    (([[1.0], [1.0]] @ K).inverse, "a square model"),
    (lambda: rl.lft(K, K, 2), "n_to_second: 2, expected a whole number from 0 to 1"),
    (lambda: K @ [[np.nan]], "NaN"),
    (lambda: K @ [[1j]], "complex"),
    (lambda: K @ DIGITAL @ LAG, "sample times"),
    (lambda: UncertainModel(DYNAMIC.M, [RealScalar("c")]).evaluate({"c": LAG}), "a dynamic value for a real block"),
    (lambda: DYNAMIC.evaluate({"d": LAG}), "no such block"),
    (lambda: DYNAMIC.evaluate({"c": [[1.0], [1.0]] @ LAG}), "a model of 2 x 1, expected 1 x 1"),
    (lambda: (DYNAMIC @ LAG).evaluate({"c": DIGITAL}), "sample times"),
]
ILL_POSED = [
    (lambda: FORCE.feedback(1.0, sign=1), "not well posed at Delta = 0"),
    ((FORCE - 1.0).inverse, "D is singular at Delta = 0"),
    # I - 1.25 (1 + 0.5 delta) = 0 at delta = -0.4
    (lambda: FORCE.feedback(1.25, sign=1).evaluate({"k": -0.4}), r"ill-posed \(Delta: k = -0.4: 0.8 N\)"),
    (lambda: DYNAMIC.evaluate({"c": LAG + 2.0}), r"ill-posed.*c = a model"),
]


@pytest.mark.parametrize(
    ("operation", "error", "text"),
    [*((o, InputError, t) for o, t in OPERANDS), *((o, NoTrustworthyNumber, t) for o, t in ILL_POSED)],
)
def test_operands_that_do_not_fit(operation, error, text):
    with pytest.raises(error, match=text):
        operation()


# --- dynamic blocks ---------------------------------------------------------------------------------------------------


@SETTINGS
@given(seeds, st.integers(0, 2))
def test_a_dynamic_delta_is_closed_in(seed, n):
    rng = np.random.default_rng(seed)
    blocks = [FullBlock("f", 2, 1), ComplexScalar("c", 2), RealScalar("r", 1, ParameterRange(1.0, 0.5, below=0.25))]
    m = StateSpaceModel(rng.standard_normal((2, 2)) - 3 * np.eye(2), rng.standard_normal((2, 6)),
                        rng.standard_normal((5, 2)), 0.15 * rng.standard_normal((5, 6)))  # fmt: skip
    model = UncertainModel(m, blocks)
    full = StateSpaceModel(-np.eye(n), rng.standard_normal((n, 1)), rng.standard_normal((2, n)), [[0.1], [-0.2]])
    allpass = StateSpaceModel([[-3.0]], [[1.0]], [[-6.0]], [[1.0]])  # (s - 3) / (s + 3)
    values = {"f": full, "c": allpass, "r": -0.8}
    member = model.evaluate(values)
    assert member.n_states == 2 + n + 2
    F, c = frequency_response(full, OMEGA), frequency_response(allpass, OMEGA)[:, 0, 0]
    wanted = [model.response([w], {"f": F[k], "c": c[k], "r": -0.8})[0] for k, w in enumerate(OMEGA)]
    assert_same(frequency_response(member, OMEGA), np.array(wanted))
    assert_same(model.response(OMEGA, values), np.array(wanted))
    assert (member.inputs, member.outputs) == (model.inputs, model.outputs)


# --- centring -----------------------------------------------------------------------------------------------------


@SETTINGS
@given(seeds, st.floats(0.1, 1.5), few)
def test_the_centred_set_has_the_same_members(seed, level, n):
    model = random_set(seed, n, 1, 2, "1")
    middle = model.centred(level)
    values = values_for(seed, model)
    span = next(b.parameter for b in middle.blocks if isinstance(b, RealScalar))
    assert (span.below, span.low) == (None, pytest.approx(1.0 - 0.25 * level))
    assert span.high == pytest.approx(1.0 + 0.5 * level)
    inside = {name: level * v for name, v in values.items()}
    inside["k"] = SHARED.parameter.delta(span.value(values["k"]))
    assert_same(at(middle, values), at(model, inside))


# --- connect ---------------------------------------------------------------------------------------------------------


DELTA = {"a": 0.8, "b": -0.5}


def wiring(rng):
    """Parts with random inputs out of all signals, sums over some, and what comes from outside."""
    outside = ["r1", "r2", "r3"]
    counts = [(int(rng.integers(1, 3)), int(rng.integers(1, 4))) for _ in range(int(rng.integers(1, 5)))]
    made = [[f"y{k}.{j}" for j in range(n_y)] for k, (n_y, _) in enumerate(counts)]
    summed = [f"s{k}" for k in range(int(rng.integers(0, 4)))]
    known = [*outside, *(name for names in made for name in names), *summed]
    sums = []
    for name in summed:
        terms = rng.choice(known, int(rng.integers(1, 4)), replace=False)
        signs = rng.choice(["+", "-"], len(terms))
        sums.append((name, list(zip(signs, map(str, terms), strict=True))))
    parts = []
    for (_, n_u), outputs in zip(counts, made, strict=True):
        inputs = [str(name) for name in rng.choice(known, n_u, replace=False)]
        parts.append(random_part(rng, inputs, outputs))
    fed = {s.name for part in parts for s in part.inputs} | {t for _, terms in sums for _, t in terms}
    inputs = [name for name in outside if name in fed]
    outputs = [name for name in known if name in fed or name not in outside]
    rng.shuffle(outputs)
    return parts, sums, inputs, outputs


def random_part(rng, inputs, outputs):
    n, blocks = int(rng.integers(0, 3)), [[], [rl.RealScalar("a")], [rl.RealScalar("b"), rl.RealScalar("a")]]
    own = blocks[int(rng.integers(0, 3))]
    q = len(own)
    d = 0.4 * rng.standard_normal((q + len(outputs), q + len(inputs))) * (rng.random() < 0.7)
    names = ([f"w{k}" for k in range(q)] + inputs, [f"z{k}" for k in range(q)] + outputs)
    m = rl.StateSpaceModel(
        rng.standard_normal((n, n)) - 3 * np.eye(n), rng.standard_normal((n, q + len(inputs))),
        rng.standard_normal((q + len(outputs), n)), d, 0.0, *names,
    )  # fmt: skip
    return rl.UncertainModel(m, own) if q else m


def response_of(part):
    if isinstance(part, rl.UncertainModel):
        return part.response(OMEGA, {b.name: DELTA[b.name] for b in part.blocks})
    return rl.frequency_response(part, OMEGA)


@settings(max_examples=60)
@given(st.integers(0, 1_000_000))
def test_a_connected_model_solves_the_equations_of_its_signals(seed):
    parts, sums, inputs, outputs = wiring(np.random.default_rng(seed))
    texts = [f"{name} = " + " ".join(f"{sign} {term}" for sign, term in terms) for name, terms in sums]
    signals = sorted({*inputs, *outputs})
    place = {name: k for k, name in enumerate(signals)}
    # (I - T) signals = S inputs, at each frequency; no word of the implementation's wiring
    equations = np.tile(np.eye(len(signals), dtype=complex), (len(OMEGA), 1, 1))
    for part in parts:
        rows, columns = ([place[s.name] for s in side] for side in (part.outputs, part.inputs))
        equations[np.ix_(range(len(OMEGA)), rows, columns)] -= response_of(part)
    for name, terms in sums:
        for sign, term in terms:
            equations[:, place[name], place[term]] -= 1.0 if sign == "+" else -1.0
    assume(np.linalg.cond(equations).max() < 1e6)
    right = np.zeros((len(signals), len(inputs)))
    right[[place[name] for name in inputs], range(len(inputs))] = 1.0
    truth = np.linalg.solve(equations, right)[:, [place[name] for name in outputs]]
    try:
        found = rl.connect(*parts, inputs=inputs, outputs=outputs, sums=texts)
    except NoTrustworthyNumber:  # well posed at these members and frequencies, not at infinity or Delta = 0
        assume(False)
    if isinstance(found, rl.UncertainModel):
        got = found.response(OMEGA, {b.name: DELTA[b.name] for b in found.blocks})
    else:
        got = rl.frequency_response(found, OMEGA)
    assert np.abs(got - truth).max(initial=0.0) <= 1e-7 * (1 + np.abs(truth).max(initial=0.0))
