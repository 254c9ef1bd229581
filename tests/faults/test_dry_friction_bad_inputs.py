"""Dry friction: what is refused, and with which words."""

from __future__ import annotations

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics.dry_friction import DryFriction, simulate_with_friction

T = np.linspace(0, 1, 11)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"coulomb": -1.0}, "no negative force"),
        ({"coulomb": float("nan")}, "coulomb"),
        ({"coulomb": 2.0, "static": 1.0}, "static >= coulomb"),
        ({"coulomb": 1.0, "inertia": 0.0}, "a positive number"),
    ],
)
def test_friction_that_is_none(given, words):
    with pytest.raises(rl.InputError, match=words):
        DryFriction("v", **given)


def run(plant, friction, **given):
    return simulate_with_friction(plant, friction, T, np.zeros(11), **given)


def test_what_does_not_fit_the_plant():
    axis = rl.plant("servo-axis")
    with pytest.raises(rl.InputError, match="no such state"):
        run(axis, DryFriction("w", 1.0))
    with pytest.raises(rl.InputError, match="two on one velocity"):
        run(axis, [DryFriction("v", 1.0), DryFriction("v", 2.0)])
    with pytest.raises(rl.InputError, match="no inertia"):
        run(axis.state_space(), DryFriction("v", 1.0))
    with pytest.raises(rl.InputError, match="'zoh' or 'foh'"):
        run(axis, DryFriction("v", 1.0), hold="spline")
    with pytest.raises(rl.InputError, match="x0 has 3 entries"):
        run(axis, DryFriction("v", 1.0), x0=[0, 0, 0])
    with pytest.raises(rl.InputError, match="a discrete model"):
        run(rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], dt=0.1, states=["v"]), DryFriction("v", 1.0))
    with pytest.raises(rl.InputError, match="finer samples"):
        simulate_with_friction(rl.plant("dc-motor", L=1e-8), DryFriction("omega", 0.01), T, np.zeros(11))


def test_a_bare_model_with_inertia_is_the_plant():
    axis, t = rl.plant("servo-axis"), np.linspace(0, 1, 101)
    u = np.sin(9 * t)
    one = simulate_with_friction(axis, DryFriction("v", 20.0), t, u)
    model = axis.state_space()
    other = simulate_with_friction(model, DryFriction("v", 20.0, inertia=axis.values["M"]), t, u)
    np.testing.assert_array_equal(one.x, other.x)
    assert len(one.events) > 2


def test_an_unstable_plant_is_told():
    model = rl.StateSpaceModel([[0, 1], [1e4, 0]], [[0], [1]], [[1, 0]], [[0]], states=["q", "v"])
    t = np.linspace(0, 20, 2001)
    with pytest.raises(rl.NoTrustworthyNumber, match="outgrows double precision"):
        simulate_with_friction(model, DryFriction("v", 0.1, inertia=1.0), t, np.zeros(2001), x0=[1.0, 0.0])
