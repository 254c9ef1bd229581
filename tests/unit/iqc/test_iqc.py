"""Integral quadratic constraints: each class against closed forms, mu, simulations; proofs that can fail."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.iqc import Filtered, posed
from robustlab.iqc import inequality as inequality_module
from robustlab.result import Status


def lure(num, den):
    """G(s) with negative feedback of a law from y to u; d at the same place."""
    n = len(den) - 1
    A = np.vstack([np.hstack([np.zeros((n - 1, 1)), np.eye(n - 1)]), -np.array(den[:0:-1], float) / den[0]])
    b = np.zeros((n, 1))
    b[-1] = 1.0
    c = np.zeros((1, n))
    c[0, : len(num)] = num[::-1]
    return rl.StateSpaceModel(A, np.hstack([-b, b]), c, np.zeros((1, 2)), 0.0, ["u", "d"], ["y"])


def proved(model, law, order=2, pole=None):
    """Whether stability is proved for the law as given, without the search for a margin."""
    problem, budget = posed("iqc_stability", model, {("y", "u"): law}, order, pole, None, 1.0)
    return problem.proved_stable(1.0, budget) is not None


CUBE = lure([1.0], [1.0, 3.0, 3.0, 1.0])  # 1 / (s + 1)^3
O_SHEA = lure([1.0, -0.2, -0.1], [1.0, 2.0, 1.0, 1.0])
MIRRORED = lure([-1.0, 0.2, 0.1], [1.0, 2.0, 1.0, 1.0])


def largest_linear_gain(model):
    """The smallest k > 0 at which A - b k c has a pole on the axis, by bisection."""
    low, high = 0.0, 100.0
    for _ in range(60):
        k = 0.5 * (low + high)
        stable = np.linalg.eigvals(model.A + k * model.B[:, :1] @ model.C).real.max() < 0
        low, high = (k, high) if stable else (low, k)
    return low


# --- closed forms -----------------------------------------------------------------------------------------------------


def test_the_circle_criterion_is_tight():
    # min Re 1 / (1 + jw)^3 = -1/4 at w = 1: sector [0, k] of a law that varies needs k < 4.
    assert proved(CUBE, rl.Nonlinearity((0.0, 3.999), steady=False))
    assert not proved(CUBE, rl.Nonlinearity((0.0, 4.001), steady=False))


def test_popovs_criterion_is_tight():
    # Re (1 + jw) / (1 + jw)^3 >= -1/8, and k = 8 is Hurwitz' limit.
    assert proved(CUBE, rl.Nonlinearity((0.0, 7.99)))
    with pytest.raises(NoTrustworthyNumber, match="unstable with all blocks at their middles"):
        proved(CUBE, rl.Nonlinearity((0.0, 16.1)))
    assert not proved(CUBE, rl.Nonlinearity((0.0, 8.01)))


@pytest.mark.parametrize(("model", "published"), [(O_SHEA, 4.5894), (MIRRORED, 1.0894)])
def test_zames_falb_reaches_kalmans_limit_of_third_order(model, published):
    # Kalman's conjecture holds for three states (Barabanov 1988): the largest slope is the largest linear gain.
    limit = largest_linear_gain(model)
    assert limit == pytest.approx(published, abs=1e-4)
    law = rl.Nonlinearity((0.0, 0.999 * limit), (0.0, 0.999 * limit), odd=True)
    assert proved(model, law)
    assert not proved(model, rl.Nonlinearity((0.0, 1.001 * limit), (0.0, 1.001 * limit), odd=True))


def test_a_parameter_that_varies_has_the_radius_of_the_small_gain_theorem():
    # x'' + c x' + (k + r delta(t)) x = 0 is quadratically stable iff r |1 / (s^2 + c s + k)|_inf < 1.
    k, c, r = 2.0, 0.3, 0.1
    spring = rl.parametric([[0, 1], ["-k", -c]], [[0], [1]], [[1, 0]], [[0]], {"k": (k, k - r, k + r)})
    radius = c * math.sqrt(k - c**2 / 4)
    found = rl.robust_stability(spring, block_types={"k": rl.Varying()})
    assert found.lower == pytest.approx(radius / r, rel=2e-3)
    assert found.lower <= radius / r
    assert found.status is Status.CERTIFIED


# --- against mu -------------------------------------------------------------------------------------------------------


def random_set(seed, blocks, n=5, direct=0.0):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.4) * np.eye(n)
    rows, cols = sum(b.rows for b in blocks), sum(b.cols for b in blocks)
    B, C = rng.normal(size=(n, rows + 1)), rng.normal(size=(cols + 1, n))
    D = direct * rng.normal(size=(cols + 1, rows + 1))
    return rl.UncertainModel(rl.StateSpaceModel(A, 0.3 * B, 0.3 * C, D), blocks)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_real_blocks_agree_with_mu_and_rates_lie_between(seed):
    uncertain = random_set(seed, [rl.RealScalar("a", 2), rl.RealScalar("b")])
    mu = rl.robust_stability(uncertain)
    margins = [
        rl.robust_stability(uncertain, block_types=block_type, order=2).lower
        for block_type in ({"a": rl.Varying(), "b": rl.Varying()}, {"a": rl.Varying(0.3)}, {})
    ]
    assert margins[-1] <= mu.upper * (1 + 1e-6)
    assert margins[-1] >= 0.9 * mu.lower
    assert all(a <= b * (1 + 2e-3) for a, b in pairwise(margins))
    assert margins[0] < margins[-1]


LAWS = {
    "saturation": (lambda z: np.clip(z, -0.7, 0.7), True),
    "dead zone": (lambda z: z - np.clip(z, -0.7, 0.7), True),
    "one-sided": (lambda z: np.maximum(z, 0.0), False),
}


# --- attacks: no simulated loop has more than the proved gain ---------------------------------------------------------


def simulated_gains(model, law, d, dt):
    """|y|_2 / |d|_2 of a Lur'e loop for inputs d (n, k), held, by Runge and Kutta."""
    b, e, c = model.B[:, :1], model.B[:, 1:], model.C

    def rate(x, value):
        return model.A @ x + b * law(c @ x) + e * value

    x, y = np.zeros((model.n_states, d.shape[1])), np.empty(d.shape)
    for i, value in enumerate(d):
        y[i] = (c @ x)[0]
        k1 = rate(x, value)
        k2 = rate(x + 0.5 * dt * k1, value)
        k3 = rate(x + 0.5 * dt * k2, value)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + dt * k3, value))
    return np.linalg.norm(y, axis=0) / np.linalg.norm(d, axis=0)


@pytest.mark.parametrize("name", LAWS)
def test_no_input_reaches_more_than_the_proved_gain(name):
    function, odd = LAWS[name]
    stiff = 3.0
    law = rl.Nonlinearity((0.0, stiff), (0.0, stiff), odd=odd)
    found = rl.peak_gain(CUBE, block_types={("y", "u"): law}, order=3)
    assert found.status is Status.CERTIFIED
    rng, dt = np.random.default_rng(0), 0.03
    t = np.arange(0.0, 60.0, dt)
    waves = np.array([np.sin(w * t) for w in (0.02, 0.3, 0.7, 1.0, 1.2, 1.4, 1.6, 2.0)]).T
    shapes = np.hstack([waves, np.sign(waves), waves + 0.5 * rng.normal(size=waves.shape)]) * (t < 50)[:, None]
    inputs = np.hstack([size * shapes for size in (0.3, 1.0, 5.0, 30.0)])
    worst = simulated_gains(CUBE, lambda z: stiff * function(z), inputs, dt).max()
    assert 0.3 * found.upper <= worst <= found.upper  # the inputs are close to the worst case
    assert found.lower <= found.upper


def test_no_varying_spring_reaches_more_than_the_proved_gain():
    spring = rl.parametric([[0, 1], ["-k", -0.3]], [[0], [1]], [[1, 0]], [[0]], {"k": (2.0, 1.8, 2.2)})
    rate = 0.2
    found = rl.peak_gain(spring, block_types={"k": rl.Varying(rate)})
    dt = 0.01
    t = np.arange(0.0, 150.0, dt)
    worst = 0.0
    for w in (1.2, 1.35, 1.42, 1.5):
        d = np.sin(w * t) * (t < 140)
        for phase in np.linspace(0, np.pi, 4):
            # a triangle of slope 0.2 and height 0.2 about 2: the fastest that the bound allows
            k = 2.0 + 0.2 * (2 / np.pi) * np.arcsin(np.sin(np.pi / 2 * rate / 0.2 * t + phase))
            x, y = np.zeros(2), np.empty(len(t))
            for i in range(len(t)):
                y[i] = x[0]
                v = x[1] + dt * (d[i] - k[i] * x[0] - 0.3 * x[1])
                x = np.array([x[0] + dt * v, v])
            worst = max(worst, np.linalg.norm(y) / np.linalg.norm(d))
    assert 0.6 * found.upper <= worst <= found.upper


# --- the proof --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slip", ["A", "B", "C"])
def test_a_wrongly_assembled_model_proves_nothing(monkeypatch, slip):
    """An error once doubled a direct term of the inequality; the claim is about the given model."""
    made = Filtered.__init__

    def slipped(self, A, B, C, D, *sizes):
        given = {"A": A, "B": B, "C": C}
        given[slip] = given[slip] * (1.1 if slip == "A" else 0.5)
        made(self, *given.values(), D, *sizes)

    monkeypatch.setattr(Filtered, "__init__", slipped)
    found = rl.peak_gain(CUBE, block_types={("y", "u"): rl.Nonlinearity((0.0, 3.0), (0.0, 3.0), odd=True)}, order=3)
    assert (found.status, found.upper) == (Status.INCONCLUSIVE, math.inf)


def test_a_wrong_solver_proves_nothing(monkeypatch):
    rng = np.random.default_rng(0)

    def wrong(cost, *given, **options):
        return SimpleNamespace(iterations=1, status="Solved", x=np.abs(rng.normal(size=len(cost))) + 0.1)

    monkeypatch.setattr(inequality_module, "solve", wrong)
    found = rl.peak_gain(CUBE, block_types={("y", "u"): rl.Nonlinearity((0.0, 3.0))})
    assert (found.status, found.upper, found.proof) == (Status.INCONCLUSIVE, math.inf, None)


# --- errors and reports -----------------------------------------------------------------------------------------------


def test_an_unstable_member_is_reported():
    found = rl.peak_gain(CUBE, block_types={("y", "u"): rl.Nonlinearity((0.0, 9.0))})
    assert (found.status, found.lower, found.upper) == (Status.INFEASIBLE, math.inf, math.inf)
    assert found.delta == {"y:u": 1.0}
    assert "unstable" in found.summary()


@pytest.mark.parametrize("odd", [False, True])
def test_a_slope_restricts_the_sector(odd):
    """Of w = law(5 / (s + 1) w) each law with slopes above 0.5 is unstable; proved "stable" from the law zero, which is
    of the sector [-1, 1] alone, and so no start of the homotopy."""
    law = rl.Nonlinearity((-1.0, 1.0), (0.5, 1.5), odd=odd)
    assert law.sector == (0.5, 1.0)
    model = rl.StateSpaceModel([[-1.0]], [[5.0]], [[1.0]], [[0.0]], 0, ["w"], ["z"])
    with pytest.raises(NoTrustworthyNumber, match="unstable with all blocks at their middles"):
        rl.robust_stability(model, block_types={("z", "w"): law})
    with pytest.raises(InputError, match="meets the sector"):
        rl.Nonlinearity((0.0, 1.0), (1.0, 2.0))


def test_an_algebraic_loop_uses_slopes_only():
    direct = rl.StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[-1.0]], [[-0.5, 0.0]], 0.0, ["u", "d"], ["y"])
    found = rl.peak_gain(direct, block_types={("y", "u"): rl.Nonlinearity.saturation()})
    assert found.status is Status.CERTIFIED
    assert found.proof.constraints["y:u"] == "Zames-Falb"
    with pytest.raises(InputError, match="algebraic loop"):
        rl.peak_gain(direct, block_types={("y", "u"): rl.Nonlinearity((0.0, 1.0))})


def stability(block, block_types):
    return rl.robust_stability(random_set(1, [block]), block_types=block_types)


@pytest.mark.parametrize(
    ("ask", "text"),
    [
        (lambda: rl.Nonlinearity((0.0, math.inf)), "two finite numbers"),
        (lambda: rl.Nonlinearity(5.0), "two finite numbers"),
        (lambda: rl.peak_gain(CUBE, block_types="saturation"), "block -> what it is"),
        (
            lambda: rl.peak_gain(random_set(1, [rl.RealScalar("f")]), block_types={}, inputs=["nope"]),
            r"expected one of \w+$",
        ),
        (lambda: rl.Nonlinearity.friction(2.0), "no stick_speed"),
        (lambda: rl.Nonlinearity((0.0, 1.0), (2.0, 3.0)), "meets the sector"),
        (lambda: rl.Varying(0.0), "a positive number"),
        (lambda: rl.peak_gain(CUBE, block_types={("y", "v"): rl.Nonlinearity.saturation()}), "no input 'v'"),
        (lambda: rl.peak_gain(CUBE, block_types={("y", "u"): rl.Varying()}), "a Nonlinearity"),
        (lambda: rl.peak_gain(CUBE, block_types={}), "no block at all"),
        (lambda: rl.peak_gain(CUBE, block_types={("y", "u"): rl.Nonlinearity.saturation()}, order=9), "from 0 to 8"),
        (lambda: stability(rl.FullBlock("f", 1, 1), {"f": rl.Varying(1.0)}), "a rate of 1"),
        (lambda: stability(rl.RealScalar("f"), {"g": rl.Varying(1.0)}), "no such block"),
        (lambda: stability(rl.RealScalar("f"), {"f": rl.Nonlinearity((0, 1))}), "own range"),
        (lambda: rl.robust_stability(_discrete(), block_types={}), "a discrete model"),
        (lambda: gain_of(FRICTION), r"sector \[0, inf\): no strict inequality holds"),
        (lambda: gain_of(FRICTION, stick_speed={"q": 0.01}), "no Coulomb friction there"),
        (lambda: rl.peak_gain(AXIS, K), "controller: given for a model, expected it for a plant with effects"),
    ],
)  # fmt: skip
def test_invalid_input_is_rejected_in_one_line(ask, text):
    with pytest.raises(InputError, match=text) as error:
        ask()
    assert "\n" not in error.value.line


def _discrete():
    M = rl.StateSpaceModel([[0.5]], [[1.0]], [[0.1]], [[0.0]], 0.1)
    return rl.UncertainModel(M, [rl.RealScalar("a")])


# --- loops with effects of the catalogue against simulations with the effects themselves ------------------------------


K = rl.StateSpaceModel([[-300.0]], [[1.0]], [[-90000.0]], [[320.0]])
AXIS = rl.plant("servo-axis")
FRICTION = {"coulomb-friction": {"Fc": 20.0}}


def gain_of(effects, **options):
    return rl.peak_gain(rl.with_effects(AXIS, effects), K, outputs=["q"], **options)


def simulated(d, dt, u_max=np.inf, friction=None):
    """q for disturbances d (n, k) of the command: the axis and the controller by small steps, the laws themselves."""
    M, Fv, gain = (AXIS.parameters[name].value for name in ("M", "Fv", "gain"))
    q, v, x = np.zeros((3, d.shape[1]))
    found, largest = np.empty(d.shape), 0.0
    for i, value in enumerate(d):
        found[i] = q
        e = value - (K.C[0, 0] * x + K.D[0, 0] * q)
        largest = max(largest, np.abs(e).max())
        force = gain * np.clip(e, -u_max, u_max)
        if friction is not None:
            level, slow = friction
            force = force - level * np.clip(v / slow, -1, 1)
        x = x + dt * (K.A[0, 0] * x + q)
        v = v + dt * (force - Fv * v) / M
        q = q + dt * v
    return found, largest


def attacks(t):
    waves = np.array([np.sin(w * t) for w in (0.3, 1.0, 2.0, 4.0, 7.0, 10.0, 14.0, 20.0)]).T
    return np.hstack([waves, np.sign(waves)]) * (t < 0.7 * t[-1])[:, None]


@pytest.mark.slow
def test_no_input_of_a_saturated_axis_reaches_more():
    found = gain_of({"input-saturation": {"u_max": 10.0}}, amplitude={"u": 40.0})
    assert found.status is Status.CERTIFIED
    assert "odd nonlinearity, sector [0.25, 1], slope [0, 1]" in found.summary()
    assert found.conditions == ("input-saturation@u: while the signal stays within 40",)
    dt = 1e-3
    t = np.arange(0.0, 20.0, dt)
    worst = 0.0
    for size in (3.0, 9.0, 14.0, 25.0):
        d = size * attacks(t)
        q, largest = simulated(d, dt, u_max=10.0)
        if largest <= 40.0:  # the condition of the proof
            worst = max(worst, (np.linalg.norm(q, axis=0) / np.linalg.norm(d, axis=0)).max())
    assert 0.3 * found.upper <= worst <= found.upper


@pytest.mark.slow
def test_friction_with_a_stick_speed_is_a_monotone_law():
    found = gain_of(FRICTION, stick_speed={"v": 0.01})
    assert found.status is Status.CERTIFIED
    (text,) = found.block_types.values()
    assert text == "odd nonlinearity, sector [0, 2000], slope [0, 2000]"
    assert found.conditions == ("coulomb-friction@v: sticking as creep below 0.01",)
    dt = 2e-4
    t = np.arange(0.0, 8.0, dt)
    for size in (0.5, 3.0, 30.0):
        d = size * attacks(t)
        q, _ = simulated(d, dt, friction=(20.0, 0.01))
        assert (np.linalg.norm(q, axis=0) / np.linalg.norm(d, axis=0)).max() <= found.upper


def test_any_other_sector_may_vary_arbitrarily_fast():
    found = gain_of({"quadratic-drag": {"c": 100.0}}, amplitude={"v": 1.0})
    assert list(found.block_types.values()) == ["varies arbitrarily fast"]
    assert found.conditions == ("quadratic-drag@v: while its signal stays within 1",)
    assert found.status is Status.CERTIFIED


def test_an_integrating_loop_has_no_gain_where_the_input_may_vanish():
    found = gain_of({"input-dead-zone": {"d": 0.5}}, amplitude={"u": 40.0})
    assert found.status is Status.INFEASIBLE
    assert "a member is unstable" in found.summary()
