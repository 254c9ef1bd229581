"""Members of the uncertain platform against the linear models of a rigid-body tree with the same masses.

The tree knows nothing of descriptor forms: M is its mass matrix, the stiffness comes by central differences of its
accelerations under the holding torque of its own, perturbed masses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import robustlab as rl

pytest.importorskip("pinocchio")

from oracle import stewart_pinocchio as oracle

POSE = np.array([0.004, -0.003, 0.128, 0.02, -0.03, 0.04])
RATIO = 4.8 * 41 / 21


def tree(values: dict[str, float]):
    """The tree with the masses and inertias of a member of the set."""
    given = oracle.THESIS

    def body(old, name: str):
        inertia = tuple(
            values.get(f"{name}_{axis}", i)
            for axis, i in zip("IJK" if name != "platform" else "xyz", old.inertia, strict=True)
        )
        return replace(old, mass=values.get(f"{name}_mass", old.mass), inertia=inertia)

    names = {"lower_link": "link", "nut": "nut", "ball_screw": "screw", "motor": "motor", "platform": "platform"}
    bodies = {part: body(getattr(given, part), name) for part, name in names.items()}
    return oracle.PinocchioStewart(replace(given, **bodies))


def stiffness(model, step: float = 2e-4) -> np.ndarray:
    """dphidd/dphi (6, 6) with the holding torque kept: fourth-order differences over the pose, turned to nut angles."""
    u, still = model.trim_torque(POSE), np.zeros(6)
    scale = np.array([1.0, 1.0, 1.0, 5.0, 5.0, 5.0]) * step
    rows = []
    for k in range(6):
        at = [POSE + n * scale * np.eye(6)[k] for n in (1, -1, 2, -2)]
        a, p = ([f(pose) for pose in at] for f in (lambda q: model.nut_acceleration(q, still, u), model.nut_angles))
        rows.append([8 * (x[0] - x[1]) - (x[2] - x[3]) for x in (a, p)])
    by_pose, angles = (np.array([row[k] for row in rows]).T for k in (0, 1))
    return by_pose @ np.linalg.inv(angles)


@pytest.fixture(scope="module")
def uncertain():
    names = ("platform_mass", "link_mass", "nut_mass", "screw_mass", "motor_mass", "nut_K", "platform_x")
    plant = rl.plant("stewart-platform")
    plant = plant.with_parameters(**{name: (plant.values[name], 0.2) for name in names})
    return plant.uncertain(at=POSE)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_a_member_is_the_tree_with_its_masses(uncertain, seed):
    rng = np.random.default_rng(seed)
    delta = {b.name: float(rng.choice([-1.0, 1.0]) if seed == 13 else rng.uniform(-1, 1)) for b in uncertain.blocks}
    model = tree({name: value for name, (value, _) in uncertain.physical(delta).items()})
    member = uncertain.evaluate(delta)
    gain = RATIO * np.linalg.inv(model.mass_matrix(POSE))
    np.testing.assert_allclose(member.B[6:], gain, atol=1e-10 * np.abs(gain).max())
    k = stiffness(model)
    np.testing.assert_allclose(member.A[6:, :6], k, atol=1e-6 * np.abs(k).max())
    # the change is what is told: twenty percent of mass move the stiffness by much more than that
    change = np.abs(member.A[6:, :6] - uncertain.nominal.A[6:, :6]).max()
    assert change > 1e-3 * np.abs(k).max()
