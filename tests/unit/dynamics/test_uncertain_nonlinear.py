"""Uncertain models of nonlinear plants at a trim, against linear models of the plant rebuilt and trimmed again."""

from pathlib import Path

import complex_step_plant as plants
import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber

MODELS = Path(__file__).parents[3] / "models" / "plants"


def off(left, right) -> float:
    worst = 0.0
    for name in "ABCD":
        a, b = getattr(left, name), getattr(right, name)
        row = np.abs(b).max(axis=1, keepdims=True)
        worst = max(worst, float((np.abs(a - b) / np.where(row > 0, row, 1.0)).max()))
    return worst


def rebuilt(plant, uncertain, delta, **where):
    """Return the plant with other parameters and its equilibrium by hand."""
    other = plant.with_parameters(**{name: value for name, (value, _) in uncertain.physical(delta).items()})
    return rl.linearise(other, at=other.equilibrium(**where))


def drawn(uncertain, seed, corner=False):
    rng = np.random.default_rng(seed)
    known = [b for b in uncertain.blocks if b.parameter is not None]
    values = rng.choice([-1.0, 1.0], len(known)) if corner else rng.uniform(-1, 1, len(known))
    return {b.name: float(v) for b, v in zip(known, values, strict=True)}


@pytest.mark.parametrize(
    ("name", "held"),
    [
        ("cart_pole", "held: x, v, a, w; what follows: F"),
        ("arm", "held: q1, q2, w1, w2; what follows: i, t1, u2"),
    ],
)
def test_mechanisms_are_exact(name, held):
    plant = getattr(plants, name)()
    uncertain = plant.uncertain()
    assert uncertain.sampled == ()
    assert uncertain.remarks == ()
    assert [b.name for b in uncertain.blocks] == list(plant.parameters)
    assert all(b.origin.startswith("exact: ") and b.origin.endswith(held) for b in uncertain.blocks)
    for seed in range(12):
        delta = drawn(uncertain, seed, corner=seed % 2 == 0)
        assert off(uncertain.evaluate(delta), rebuilt(plant, uncertain, delta)) < 1e-11


def test_repetitions_of_an_affine_form_are_ranks():
    """The mass of the pole is in a 2 x 2 matrix m [1 l; l l^2] and in m g l: rank 2; all else is one number."""
    plant = plants.cart_pole().with_parameters(l=(0.5, 0.0))
    repeats = {b.name: b.repeats for b in plant.uncertain().blocks}
    assert repeats == {"M": 1, "m": 2, "J": 1, "b": 1, "d": 1}
    assert "repeated as often as its rank asks" in plant.uncertain().blocks[0].origin


def test_the_input_is_held_if_no_input_holds_the_states():
    """By hand: h1' = -c^2 g/(q A) h1 + q/A: at a held inflow rational in all parameters."""
    plant = plants.tank()
    uncertain = plant.uncertain()
    assert all(b.origin.endswith("held: q; what follows: h1, h2") for b in uncertain.blocks)
    assert uncertain.sampled == ()
    inflow = float(plant.equilibrium().u[0])
    for seed in range(6):
        delta = drawn(uncertain, seed)
        p = {name: value for name, (value, _) in uncertain.physical(delta).items()}
        s1, s2 = plants.G * p["c"] ** 2 / inflow, plants.G * p["e"] ** 2 / inflow
        member = uncertain.evaluate(delta)
        np.testing.assert_allclose(member.A, [[-s1 / p["A"], 0], [s1 / p["B"], -s2 / p["B"]]], rtol=1e-11, atol=1e-15)
        np.testing.assert_allclose(member.B, [[1 / p["A"]], [0]], rtol=1e-12)


class TestSampled:
    plant = plants.rotor()
    uncertain = plant.uncertain()

    def test_the_origin_states_it(self):
        # slope of the thrust at rest: 8 k s / m with s = sqrt(m g / 4 k)
        assert self.uncertain.sampled == ("m", "k", "remainder")
        origins = {b.name: b.origin for b in self.uncertain.blocks}
        assert origins["T"].startswith("exact: the descriptor form is affine in it")
        assert origins["remainder"].startswith("sampled: proved on the hull of 265 linear models only; 264 fresh ones")
        assert origins["m"].endswith("held: z, v; what follows: s, u")

    @pytest.mark.parametrize("seed", [101, 102, 103, 104, 105, 106])
    def test_fresh_models_are_members(self, seed):
        """The only entry that differs: A[1, 2] of the member, rank one in the remainder."""
        delta = drawn(self.uncertain, seed, corner=seed % 2 == 0)
        wanted = rebuilt(self.plant, self.uncertain, delta)
        first = self.uncertain.evaluate({**delta, "remainder": [[0.0]]})
        full = self.uncertain.evaluate({**delta, "remainder": [[1.0]]})
        value = (wanted.A[1, 2] - first.A[1, 2]) / (full.A[1, 2] - first.A[1, 2])
        assert abs(value) <= 1
        assert off(self.uncertain.evaluate({**delta, "remainder": [[value]]}), wanted) < 1e-11


def test_margin_is_where_the_true_plant_loses_stability():
    """The proved margin of the set against poles of the nonlinear plant's own linear models, rebuilt and trimmed."""
    plant = plants.cart_pole()
    uncertain = plant.uncertain()
    state = np.array([[-1.0, -2.4, -38.0, -9.0]])  # u = -K x, all states seen
    seen = rl.UncertainModel(*with_states(uncertain))
    loop = seen.close(rl.StateSpaceModel([], [], [], -state))
    assert loop.nominal.spectral_abscissa() < 0
    found = rl.robust_stability(loop)
    assert found.status.trustworthy
    assert found.lower > 1

    def abscissa(delta):
        model = rebuilt(plant, uncertain, delta)
        return float(np.linalg.eigvals(model.A - model.B @ state).real.max())

    critical = {name: float(np.real(v)) for name, v in found.delta.items()}
    assert (
        abscissa({n: 0.99 * v for n, v in critical.items()}) < 0 < abscissa({n: 1.01 * v for n, v in critical.items()})
    )
    worst = max(abscissa(drawn(uncertain, seed, corner=True)) for seed in range(64))
    assert worst < 0


def with_states(uncertain):
    """M with all states as outputs."""
    m, p = uncertain.M, uncertain.delta_shape[1]
    c = np.vstack([m.C[:p], np.eye(m.n_states)])
    d = np.vstack([m.D[:p], np.zeros((m.n_states, m.n_inputs))])
    return rl.StateSpaceModel(m.A, m.B, c, d), uncertain.blocks


@pytest.mark.parametrize(
    ("slope", "exact"),
    [
        (lambda c: 1 + c + c**2 - c**3, True),
        (lambda c: 1 / c, True),  # a free row is multiplied by c
        (lambda c: 1 / (3 + c), False),
        (lambda c: 1 + 1e-7 * np.sin(3 * c), False),
        (np.sqrt, False),
        (lambda c: abs(c - 1.02), False),
        (lambda c: np.exp(0.1 * c), False),
    ],
)
def test_polynomials_are_detected(slope, exact):
    plant = plants.made(
        "lag", {"c": (1.0, 0.1)}, "q", "h", "h", lambda x, u, f, p: [slope(p["c"]) * (u[0] - 2 * x[0])],
        lambda x, u, p: [x[0]], lambda p: (np.array([0.5]), np.array([1.0])),
    )  # fmt: skip
    uncertain = plant.uncertain()
    assert (uncertain.sampled == ()) is exact
    for value in (0.9, 0.97, 1.1):
        known = {"c": (value - 1) / 0.1}
        if exact:
            np.testing.assert_allclose(uncertain.evaluate(known).A, [[-2 * slope(value)]], rtol=1e-12)


class TestBadInput:
    def test_no_equilibrium(self):
        with pytest.raises(NoTrustworthyNumber) as caught:
            plants.tank().uncertain(hold=["h1", "h2"])
        assert "no rest with what is held: h2 moves (c = 0.0009)" in str(caught.value)
        assert "hold other states or inputs" in (caught.value.hint or "")

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"hold": ["h3"]}, "no state or input 'h3'"),
            ({"ranges": {"z": (1, 2)}}, "no such parameter"),
            ({"ranges": {"c": (2e-3, 3e-3)}}, "finite low < nominal < high"),
            ({"at": rl.plant("stewart-platform").equilibrium()}, "a trim of stewart-platform"),
        ],
    )
    def test_bad_options(self, options, words):
        with pytest.raises(InputError, match=words):
            plants.tank().uncertain(**options)


@pytest.mark.parametrize(
    ("name", "more", "at", "held"),
    [
        ("cart_pole", {"l": 0.1}, {"theta": 0.0}, {"theta": 0.0}),
        ("cart_pole", {"l": 0.1, "g": 0.01}, {"theta": np.pi}, {"theta": np.pi}),
        ("two_link_arm", {"c_2": 0.1, "l_1": 0.05}, {"q_1": 0.4, "q_2": 0.7}, {"q_1": 0.4, "q_2": 0.7}),
        ("water_tank", {}, {"level": 6.0}, {"u": None}),
    ],
)
def test_plant_files_are_exact(name, more, at, held):
    """Compare with the trim and linear model of the plant with other parameters and the same held signals."""
    pytest.importorskip("casadi")
    plant = rl.plant(f"{MODELS / name}.py:{name}")
    plant = plant.with_parameters(**{key: (plant.values[key], share) for key, share in more.items()})
    trim = plant.equilibrium(**at)
    uncertain = plant.uncertain(at=trim)
    assert uncertain.sampled == ()
    held = {key: float(trim.u[0]) if value is None else value for key, value in held.items()}
    for seed in range(6):
        delta = drawn(uncertain, seed, corner=seed % 2 == 0)
        other = plant.with_parameters(**{key: value for key, (value, _) in uncertain.physical(delta).items()})
        again = other.equilibrium(**held, **({"start": (trim.x, trim.u)} if name == "water_tank" else {}))
        assert off(uncertain.evaluate(delta), rl.linearise(other, at=again)) < 1e-9
