"""The uncertain platform at parameter values is the linear model of the platform built with them, at the same pose."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unit.dynamics.test_uncertain_nonlinear import off

import robustlab as rl

QUICK = settings(max_examples=25)
POSES = {"home": None, "tilted": [0.004, -0.003, 0.13, 0.02, -0.03, 0.05]}
# inertias that move alone within these keep to the triangle inequality
MASSES = {
    "platform_mass": 0.2, "link_mass": 0.1, "nut_mass": 0.1, "screw_mass": 0.15, "motor_mass": 0.1,
    "link_K": 0.1, "nut_K": 0.1,
}  # fmt: skip
MOTORS = {"R": 0.1, "L": 0.2, "Km": 0.05, "Kb": 0.05, "Kf": 0.35}


@cache
def machine(preset: str, motors: bool, pose: str, more: tuple[tuple[str, float], ...] = ()):
    plant = rl.plant("stewart-platform", preset=preset, motors=motors)
    tolerances = MASSES | (MOTORS if motors else {}) | ({"rotor_J": 0.1} if preset == "physical" else {}) | dict(more)
    plant = plant.with_parameters(**{name: (plant.values[name], share) for name, share in tolerances.items()})
    return plant, plant.uncertain(at=POSES[pose])


def rebuilt(plant, uncertain, delta, pose):
    values = {name: value for name, (value, _) in uncertain.physical(delta).items()}
    return rl.linearise(plant.with_parameters(**values), at=POSES[pose])


@pytest.mark.parametrize("pose", list(POSES))
@pytest.mark.parametrize(("preset", "motors"), [("thesis", False), ("thesis", True), ("physical", True)])
@QUICK
@given(data=st.data())
def test_a_member_is_the_platform_rebuilt(preset, motors, pose, data):
    plant, uncertain = machine(preset, motors, pose)
    assert uncertain.sampled == ()
    delta = {b.name: data.draw(st.floats(-1.0, 1.0, allow_subnormal=False)) for b in uncertain.blocks}
    assert off(uncertain.evaluate(delta), rebuilt(plant, uncertain, delta, pose)) < 1e-12


@pytest.mark.parametrize("corner", [-1.0, 1.0])
def test_the_corners_too_and_the_nominal_exactly(corner):
    plant, uncertain = machine("thesis", True, "tilted")
    delta = {b.name: corner for b in uncertain.blocks}
    assert off(uncertain.evaluate(delta), rebuilt(plant, uncertain, delta, "tilted")) < 1e-12
    np.testing.assert_array_equal(uncertain.nominal.A, rl.linearise(plant, at=POSES["tilted"]).A)
    assert uncertain.operating_point is not None
    np.testing.assert_array_equal(uncertain.operating_point.u, rl.trim(plant, pose=POSES["tilted"]).u)


@pytest.mark.parametrize("pose", list(POSES))
def test_repetitions_are_the_ranks_of_the_coefficients_of_a_mass(pose):
    """The rank of [dM dK] by differences of linear models: M = k B^-1, K = M A at rest; fewer no LFT of it has."""
    plant, uncertain = machine("thesis", False, pose)

    def mass_and_stiffness(**change):
        model = rl.linearise(plant.with_parameters(**change), at=POSES[pose])
        mass = plant.values["ratio"] * np.linalg.inv(model.B[6:])
        return np.hstack([mass, mass @ model.A[6:, :6]])

    nominal = mass_and_stiffness()
    columns = np.abs(nominal).max(axis=0)
    ranks = {}
    for name in MASSES:
        change = (mass_and_stiffness(**{name: 1.4 * plant.values[name]}) - nominal) / columns
        sizes = np.linalg.svd(change, compute_uv=False)
        ranks[name] = int((sizes > 1e-11).sum())
    assert {b.name: b.repeats for b in uncertain.blocks} == {name: ranks[name] for name in MASSES}


@pytest.mark.slow
@QUICK
@given(data=st.data())
def test_places_gravity_and_gear_are_polynomials(data):
    """Centres of gravity, gravity times masses, the ratio squared: exact, too, though not affine."""
    more = (("link_cg", 0.05), ("motor_x", 0.2), ("gravity", 0.01), ("ratio", 0.02))
    plant, uncertain = machine("physical", True, "tilted", more)
    assert uncertain.sampled == ()
    delta = {b.name: data.draw(st.floats(-1.0, 1.0, allow_subnormal=False)) for b in uncertain.blocks}
    assert off(uncertain.evaluate(delta), rebuilt(plant, uncertain, delta, "tilted")) < 1e-11


def test_geometry_is_covered_with_a_remark():
    plant = rl.plant("stewart-platform", platform_mass=(3.167, 0.1), r_b=(0.17502, 0.002), alpha_p=(0.1129, 0.005))
    uncertain = plant.uncertain(at=POSES["tilted"])
    assert uncertain.sampled == ("r_b", "alpha_p", "remainder")
    origins = {b.name: b.origin for b in uncertain.blocks}
    assert origins["platform_mass"].startswith("exact: the descriptor form is affine in it")
    assert origins["remainder"].startswith("sampled: proved on the hull of 265 linear models only")
    # legs built anew: the rest is a value of the remainder's block, of norm at most one, found here from M alone
    rng = np.random.default_rng(77)
    known = [b for b in uncertain.blocks if b.parameter is not None]
    for s in rng.uniform(-1, 1, (8, len(known))):
        delta = {b.name: float(v) for b, v in zip(known, s, strict=True)}
        wanted = rebuilt(plant, uncertain, delta, "tilted")
        assert off(uncertain.evaluate(delta), wanted) < 2e-3  # first order alone
        value = explaining(uncertain, delta, wanted)
        assert np.linalg.norm(value, 2) <= 1
        assert off(uncertain.evaluate({**delta, "remainder": value}), wanted) < 1e-9


def explaining(uncertain, delta, wanted):
    """The remainder's value at which the member has the wanted A and B, by least squares from the model's M."""
    m, n = uncertain.M, uncertain.M.n_states
    member_of = uncertain.evaluate
    block = next(b for b in uncertain.blocks if b.name == "remainder")
    # w = Delta z with z, w of the wanted model: close the known blocks first
    rest = rl.UncertainModel(m, uncertain.blocks)
    known = member_of(delta)
    q = sum(b.rows for b in rest.blocks if b.name != "remainder")
    p = sum(b.cols for b in rest.blocks if b.name != "remainder")
    d = np.concatenate([np.full(b.rows, delta[b.name]) for b in rest.blocks if b.name != "remainder"])
    inner = np.linalg.solve(np.eye(q) - np.diag(d) @ m.D[:p, :q], np.diag(d))
    b_w = m.B[:, q : q + block.rows] + m.B[:, :q] @ inner @ m.D[:p, q : q + block.rows]
    c_z = m.C[p : p + block.cols] + m.D[p : p + block.cols, :q] @ inner @ m.C[:p]
    d_zu = m.D[p : p + block.cols, q + block.rows :] + m.D[p : p + block.cols, :q] @ inner @ m.D[:p, q + block.rows :]
    d_zw = m.D[p : p + block.cols, q : q + block.rows] + m.D[p : p + block.cols, :q] @ inner @ m.D[
        :p, q : q + block.rows
    ]  # fmt: skip
    change = np.hstack([wanted.A - known.A, wanted.B - known.B])  # = b_w W, W = Delta Z, Z = [c_z d_zu] + d_zw W
    w = np.linalg.lstsq(b_w, change, rcond=None)[0]
    z = np.hstack([c_z, d_zu]) + d_zw @ w
    assert w.shape[1] == n + len(uncertain.inputs)
    return w @ np.linalg.pinv(z)
