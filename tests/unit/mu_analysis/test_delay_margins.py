"""Loops with exact delays: verdicts against closed forms, proved margins and gains against the exact responses."""

import numpy as np
import pytest

import robustlab as rl
from robustlab.result import Status

LAG = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
INTEGRATOR = rl.StateSpaceModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])


def verdict(model):
    found = rl.robust_stability(model)
    assert found.status is (Status.INCONCLUSIVE if found.stable is None else Status.CERTIFIED)
    return found.stable


@pytest.mark.parametrize("k", [0.4, 1.0, 7.0])
def test_the_longest_delay_of_an_integrator(k):
    limit = np.pi / (2 * k)
    assert verdict((k * INTEGRATOR @ rl.delay(0.98 * limit)).feedback()) is True
    assert verdict((k * INTEGRATOR @ rl.delay(1.02 * limit)).feedback()) is False


def test_a_delay_stabilises_a_loop_and_a_longer_one_destabilises_it():
    # x'' + x = 0.2 x(t - tau): unstable without delay (no damping), damped by a delay with sin(w tau) < 0
    oscillator = rl.StateSpaceModel([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    spring = {tau: (0.2 * oscillator @ rl.delay(tau)).feedback(sign=1) for tau in (2.0, 4.5)}
    # at small gain k the root moves by -k sin(tau) / 2 from j
    assert verdict(spring[2.0]) is True
    assert verdict(spring[4.5]) is False


@pytest.mark.slow
def test_a_neutral_loop_is_stable_only_with_a_proof():
    through = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]]))
    assert verdict(through.feedback(0.9 * rl.delay(1.0))) is True
    assert not verdict(through.feedback(1.5 * rl.delay(1.0)))  # a root at log(1.5)
    # 1 + 0.6 z + 0.5 z^2 has its zeros outside the unit circle, but not with delays of 1 and 1.9 s: their moduli add up
    # to more than one.
    assert verdict(through.feedback(0.6 * rl.delay(1.0) + 0.5 * rl.delay(2.0))) is None


# --- proofs for a set that contains the loop ------------------------------------------------------------------------


PAIR = rl.with_delays(
    rl.StateSpaceModel(-np.diag([1.0, 2.0]), [[1, 0.3], [-0.2, 1]], np.eye(2), np.zeros((2, 2))),
    inputs={0: 0.3, 1: 0.1},
)
THROUGH = rl.with_delays(rl.StateSpaceModel([], [], [], [[1.0]]))
MODE = rl.StateSpaceModel([[0, 1], [-100.0, -1.0]], [[0], [1]], [[30.0, 0]], [[0]])
SPRING = rl.StateSpaceModel([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])


@pytest.mark.parametrize(
    ("loop", "peak"),
    [  # by bounds of the exact response between points, 0.1 % apart
        ((1.9 * LAG @ rl.delay(1.0)).feedback(), 5.587176058519991),
        ((INTEGRATOR @ rl.delay(1.2)).feedback(), 4.071642726234871),
        ((2.0 * rl.with_delays(LAG, inputs={0: 0.3}, outputs={0: 0.1})).feedback(), 0.9886052311827209),
        ((INTEGRATOR @ (0.5 * rl.delay(0.5) + 0.5 * rl.delay(1.5))).feedback(), 1.6566022279478148),
        ((0.2 * SPRING @ rl.delay(2.0)).feedback(sign=1), 1.165073366630222),
        (((0.2 * MODE + 0.5 * LAG) @ rl.delay(0.1)).feedback(), 1.3579521679106243),
        (LAG - LAG @ rl.delay(1.0), 0.7618344970155185),
        (THROUGH.feedback(0.9 * rl.delay(1.0)), 10.0),  # 1 / (1 - 0.9)
    ],
)
def test_the_bracket_contains_the_exact_gain(loop, peak):
    found = rl.peak_gain(loop)
    assert found.status is Status.CERTIFIED
    assert found.lower <= peak * (1 + 1e-9)
    assert peak <= found.upper * (1 + 1e-9) <= peak * (1 + 1.1e-3)


def test_the_disk_margins_of_a_pair_of_loops_contain_the_exact_ones():
    found = rl.disk_margin(PAIR, rl.StateSpaceModel([], [], [], 2.0 * np.eye(2)))
    bounds = {"y1": (0.8827878367700096, 0.8871984545816933), "y2": (1.5000387666719412, 1.5075148318631346)}
    for name, (lower, upper) in bounds.items():
        assert found.channels[name].upper == pytest.approx(upper, rel=1e-6)
        assert lower <= found.channels[name].lower <= upper
    assert found.simultaneous.upper == pytest.approx(0.8627549947803579, rel=1e-6)
    assert 0.8585473874026984 <= found.simultaneous.lower <= 0.8627549947803579


@pytest.mark.parametrize(("skew", "sign"), [(0.0, -1), (1.0, -1), (-1.0, -1), (0.0, 1)])
def test_the_disk_margin_of_a_loop_is_bracketed(skew, sign):
    s = 1j * np.linspace(1e-6, 60, 600_001)
    gain = 2.0 if sign < 0 else -2.0
    loop = gain * LAG @ rl.delay(0.5)
    exact = 1 / np.abs(1 / (1 + 2 * np.exp(-0.5 * s) / (s + 1)) + (skew - 1) / 2).max()
    found = rl.disk_margin(loop, skew=skew, sign=sign)
    assert found.status is Status.CERTIFIED
    assert 0.99 * exact <= found.lower <= exact <= found.upper * (1 + 1e-8)
    assert found.upper == pytest.approx(exact, rel=1e-7)
    if skew == 0.0:  # the guaranteed gain does not destabilise
        assert rl.robust_stability((0.999 * found.gain_margin[1] * abs(gain) * LAG @ rl.delay(0.5)).feedback()).stable


def test_an_uncertain_plant_with_a_delay():
    plant = rl.parametric([["-1/T"]], [["k/T"]], [[1]], [[0]], {"k": (2.0, 0.1), "T": (1.0, 0.2)})
    loop = (plant @ rl.delay(0.5).uncertain(3)).feedback()
    proved = rl.robust_stability(loop)
    assert proved.status is Status.CERTIFIED
    assert proved.lower > 1.0
    # mu of the loop with its exact delay, at points: not above the proved bound of the set
    channels = [s.name for s in plant.M.inputs[:-1]], [s.name for s in plant.M.outputs[:-1]]
    exact = rl.with_delays(plant.M, inputs={"u1": 0.5})
    omega = np.geomspace(0.1, 20, 60)
    m = rl.frequency_response(exact, omega)
    n = len(channels[0])
    closed = m[:, :n, :n] - m[:, :n, n:] @ m[:, n:, :n] / (1 + m[:, n:, n:])
    assert (rl.mu(closed, plant.blocks).upper <= 1 / proved.lower).all()


def rightmost_of_discretised(A, parts, delays, order):
    """Rightmost eigenvalue of the infinitesimal generator on Chebyshev points (Breda, Maset, Vermiglio 2005)."""
    n, longest = len(A), max(delays)
    x = np.cos(np.pi * np.arange(order + 1) / order)
    c = np.hstack([2.0, np.ones(order - 1), 2.0]) * (-1.0) ** np.arange(order + 1)
    apart = x[:, None] - x[None, :] + np.eye(order + 1)
    D = np.outer(c, 1 / c) / apart
    D = 2.0 / longest * (D - np.diag(D.sum(axis=1)))
    made = np.kron(D, np.eye(n))
    made[:n] = 0.0
    made[:n, :n] = A
    weights = np.hstack([0.5, np.ones(order - 1), 0.5]) * (-1.0) ** np.arange(order + 1)
    for part, tau in zip(parts, delays, strict=True):
        off = -tau - longest * (x - 1.0) / 2.0
        at = (np.abs(off) < 1e-14).astype(float) if np.abs(off).min() < 1e-14 else weights / off
        made[:n] += np.kron(at / at.sum(), part)
    return np.linalg.eigvals(made).real.max()


@pytest.mark.parametrize("seed", range(40))
def test_loops_of_several_delays_against_a_discretised_generator(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(-0.2, 0.5)) * np.eye(n)
    B, C = rng.normal(size=(n, m)), rng.uniform(0.1, 2.0) * rng.normal(size=(m, n))
    delays = 10.0 ** rng.uniform(-2.0, 0.4, size=m)
    plant = rl.StateSpaceModel(A, B, C, np.zeros((m, m)), inputs=[f"u{k}" for k in range(m)])
    loop = rl.with_delays(plant, inputs={f"u{k}": float(tau) for k, tau in enumerate(delays)}).feedback(np.eye(m))
    root = rightmost_of_discretised(A, [-np.outer(B[:, k], C[k]) for k in range(m)], delays, 60)
    assert rl.robust_stability(loop).stable is bool(root < 0)


@pytest.mark.parametrize(("den", "pole"), [([1, 0], 0j), ([1, -1], 1 + 0j), ([1, 0, 1], 1j)])
def test_a_pole_that_no_delay_feeds_back_makes_the_gain_infinite(den, pole):
    """As without the delay: a delay in series moves no pole."""
    G = rl.tf([1], den)
    for found in (rl.peak_gain(G), rl.peak_gain(G @ rl.delay(1.0)), rl.peak_gain(rl.delay(0.5) @ G @ rl.delay(1.0))):
        assert (found.status, found.lower, found.upper) == (rl.Status.CERTIFIED, np.inf, np.inf)
    known = rl.robust_stability(G @ rl.delay(1.0))
    assert known.stable is False
    assert abs(known.root.real - pole.real) + abs(abs(known.root.imag) - pole.imag) < 1e-12


# --- margins of loops with exact delays -------------------------------------------------------------------------------


K2 = rl.StateSpaceModel(-0.5 * np.eye(2), np.eye(2), np.eye(2), [[1.0, 0.2], [-0.1, 0.8]])


def two_by_two(late=(0.3, 0.1)):
    A = [[-1.0, 0.4, 0.0], [-0.3, -2.0, 1.0], [0.0, -1.0, -0.5]]
    G = rl.StateSpaceModel(
        A, [[1.0, 0.0], [0.3, 1.0], [0.0, 0.5]], [[1.0, 0.0, 0.5], [0.0, 1.0, -0.3]], np.zeros((2, 2))
    )
    return rl.with_delays(G, inputs={0: late[0]}, outputs={1: late[1]})


def test_an_integrator_with_a_delay_has_its_closed_forms():
    for tau in (0.1, 0.5, 1.2):
        margin = rl.classical_margins(INTEGRATOR @ rl.delay(tau)).channels["y1"]
        assert margin.gain_margin == (0.0, pytest.approx(np.pi / 2 / tau, rel=1e-9))
        assert margin.phase_margin == pytest.approx(np.pi / 2 - tau, rel=1e-9)
        assert margin.delay_margin == pytest.approx(np.pi / 2 - tau, rel=1e-9)
        assert margin.status is rl.Status.CONVERGED


@pytest.mark.slow
def test_all_of_many_crossings_are_found():
    # a lightly damped mode after a long delay: L crosses the unit circle and the real axis many times
    mode = rl.StateSpaceModel([[0, 1], [-100.0, -0.1]], [[0], [1]], [[30.0, 0]], [[0]])
    L = (mode + 0.5 * LAG) @ rl.delay(2.0)
    S = rl.classical_margins(L).channels["y1"]
    omega = np.linspace(1e-3, 60.0, 2_000_001)
    G = rl.frequency_response(L, omega)[:, 0, 0]
    gains = omega[:-1][np.diff(np.sign(abs(G) - 1)) != 0]
    assert [c.frequency for c in S.gain_crossings] == pytest.approx(gains.tolist(), abs=1e-4)
    turns = (np.diff(np.sign(G.imag)) != 0) & (G.real[:-1] < 0) & (omega[:-1] < 40.0)
    factors = sorted(-1 / G.real[:-1][turns])
    least = min((f for f in factors if f >= 1), default=np.inf)
    wanted = [f for f in factors if f <= least * (1 + 1e-3)]
    assert sorted(c.factor for c in S.phase_crossings) == pytest.approx(wanted, rel=2e-3)
    assert S.status is rl.Status.CONVERGED


def test_closed_loops_at_the_margins_have_the_stated_stability():
    P = two_by_two()
    loop = rl.classical_margins(P, K2)
    for i, (name, margin) in enumerate(loop.channels.items()):
        assert margin.status is rl.Status.CONVERGED
        for factor, stable in ((0.97, True), (1.03, False)):
            change = np.eye(2)
            change[i, i] = margin.gain_margin[1] * factor
            closed = (rl.StateSpaceModel([], [], [], change) @ P @ K2).feedback(np.eye(2))
            assert rl.robust_stability(closed).stable is stable, name
        late = [0.0, 0.0]
        late[i] = 1.05 * margin.delay_margin
        assert (
            rl.robust_stability((rl.with_delays(P, outputs=dict(enumerate(late))) @ K2).feedback(np.eye(2))).stable
            is False
        )


@pytest.mark.slow
def test_disk_margins_of_several_loops():
    P = two_by_two()
    for at in ("output", "input", "both"):
        found = rl.disk_margin(P, K2, at=at)
        grid = rl.disk_margin(P, K2, frequency=np.geomspace(1e-2, 30.0, 400), at=at)
        assert found.status is rl.Status.CERTIFIED
        assert found.simultaneous.lower <= found.simultaneous.upper <= 1.0101 * found.simultaneous.lower
        assert found.simultaneous.lower <= grid.upper * (1 + 1e-9)
        assert found.simultaneous.upper == pytest.approx(grid.upper, rel=5e-3)
        for name, margin in found.channels.items():
            assert margin.upper == pytest.approx(grid.channels[name].upper, rel=5e-3)


def test_an_integrator_in_the_loop_is_no_pole_of_it():
    """1 / (s e^(s/2) + 1): the open loop has a pole at frequency zero."""
    loop = (INTEGRATOR @ rl.delay(0.5)).feedback()
    with pytest.raises(rl.NoTrustworthyNumber, match=r"^frequency_response: 0 rad/s hits a pole exactly"):
        rl.frequency_response(INTEGRATOR @ rl.delay(1.0), [1.0, 0.0])
    omega = np.array([0.0, 1e-12, 1e-6, 0.3, 2.0])
    s = 1j * omega
    assert rl.frequency_response(loop, omega)[:, 0, 0] == pytest.approx(1 / (s * np.exp(0.5 * s) + 1), rel=1e-14)
    found = rl.peak_gain(loop)
    grid = np.linspace(0.0, 20.0, 4001)
    assert found.lower <= found.upper
    assert np.abs(1 / (1j * grid * np.exp(0.5j * grid) + 1)).max() <= found.upper <= 1.01
    P = rl.StateSpaceModel([[0.0]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))
    closed = rl.with_delays(P, inputs={1: 0.5}).close(rl.StateSpaceModel([], [], [], [[-1.0]]))
    assert rl.peak_gain(closed).status is rl.Status.CERTIFIED
    # Terms added to and subtracted from the integrator's output, where a near pole would cost digits
    near = rl.frequency_response(closed, [1e-9, 1e-7])[:, 0, 0]
    exact = [1 / (1j * w + np.exp(-0.5j * w)) for w in (1e-9, 1e-7)]
    assert near == pytest.approx(exact, rel=1e-13)
