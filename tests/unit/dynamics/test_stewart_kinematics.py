"""Kinematics of the Stewart platform: published points and lengths, closed forms, derivatives, direct kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import robustlab as rl
from robustlab.dynamics import stewart

MACHINE = rl.plant("stewart-platform")
G = MACHINE.geometry
RNG = np.random.default_rng(5)
POSES = G.home + RNG.uniform(-1, 1, (12, 6)) * [0.008, 0.008, 0.008, 0.05, 0.05, 0.08]


def at(z):
    return np.array([0.0, 0.0, z, 0.0, 0.0, 0.0])


def test_points_of_appendix_b():
    # Březina 2010, App. B, with b6 y = -114.5 and m2, m3 x = 16.33 (misprints corrected)
    table = [[165.3, -57.4], [32.9, 171.9], [-32.9, 171.9], [-165.3, -57.4], [-132.4, -114.5], [132.4, -114.5]]
    np.testing.assert_allclose(1e3 * G.base[:, :2], table, atol=0.06)
    np.testing.assert_allclose(1e3 * G.platform[:4, 1], [75.85, 112.94, 112.94, 75.85], atol=0.006)
    np.testing.assert_allclose(1e3 * G.bearing[1:3], [[16.33, 175.35, 16.9], [-16.33, 175.35, 16.9]], atol=0.06)
    np.testing.assert_allclose(np.hypot(*G.bearing[:, :2].T), 0.17611, rtol=1e-12)


@pytest.mark.parametrize(
    ("z", "shifted", "simple"), [(0.1062, 160.71, 170.66), (0.1262, 173.78, 183.77), (0.1462, 188.06, 198.04)]
)
def test_published_lengths(z, shifted, simple):
    np.testing.assert_allclose(1e3 * stewart.inverse_kinematics(G, at(z)), shifted, atol=0.006)
    plain = np.linalg.norm(at(z)[:3] + G.platform - G.base, axis=1)  # of a joint whose axes meet
    np.testing.assert_allclose(1e3 * plain, simple, atol=0.006)


def test_shifted_joint_closes_the_chain():
    """b + c y + L K reaches the platform point, y and K being perpendicular to the second joint axis."""
    for pose in POSES:
        points = pose[:3] + G.platform @ Rotation.from_euler("xyz", pose[3:]).as_matrix().T
        lengths = stewart.inverse_kinematics(G, pose)
        for i in range(6):
            w, x = points[i] - G.base[i], G.axis[i]
            z = np.cross(x, w) / np.linalg.norm(np.cross(x, w))
            d = G.base[i] + G.c * np.cross(z, x)
            assert np.linalg.norm(points[i] - d) == pytest.approx(lengths[i], rel=1e-14)


def test_the_jacobian_is_the_derivative_of_the_lengths():
    h = 2e-3
    for pose in POSES[:5]:
        rate = RNG.normal(size=6) * [0.1, 0.1, 0.1, 1, 1, 1]
        f = {k: stewart.inverse_kinematics(G, pose + k * h * rate) for k in range(-3, 4)}
        first = (45 * (f[1] - f[-1]) - 9 * (f[2] - f[-2]) + (f[3] - f[-3])) / (60 * h)
        _, ay, az = pose[3:]
        turn = [
            [np.cos(az) * np.cos(ay), -np.sin(az), 0],
            [np.sin(az) * np.cos(ay), np.cos(az), 0],
            [-np.sin(ay), 0, 1],
        ]
        V = [*rate[:3], *(np.array(turn) @ rate[3:])]
        np.testing.assert_allclose(stewart.velocity_jacobian(G, pose) @ V, first, rtol=0, atol=1e-11)


def test_direct_kinematics_is_certified_over_the_workspace():
    axes = [np.linspace(-width, width, 8) for width in (0.024, 0.024, 0.02, 0.14, 0.14, 0.10)]
    box = G.home + np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 6)
    grid = box[stewart.inside(G, box)]
    assert len(grid) > 1000
    found = stewart.direct_kinematics(G, stewart.inverse_kinematics(G, grid))
    assert found.status is rl.Status.CERTIFIED
    error = np.abs(found.poses - grid)
    error[:, 3:] *= G.radius
    # the certificate's radius must cover the true error
    assert (np.linalg.norm(error, axis=1) <= found.radius + 1e-15).all()
    assert found.radius.max() < 1e-12
    assert found.h.max() < 1e-9


def test_no_certificate_without_a_pose():
    lengths = G.home_lengths.copy()
    lengths[0] = 0.5  # longer than the platform allows
    found = stewart.direct_kinematics(G, lengths)
    assert not found.proved.any()
    assert found.status is rl.Status.INCONCLUSIVE


def test_singularity_and_workspace():
    # the neutral axis: the vertical motion of a symmetric platform moves all legs alike, J e_z = K_z
    smallest, largest = stewart.singularity(G, G.home)
    assert 0 < smallest < largest
    # a yaw of 90 degrees makes a Stewart platform of this kind singular (Fichter)
    yaw = np.tile(G.home, (181, 1))
    yaw[:, 5] = np.linspace(0, np.pi, 181)
    assert stewart.singularity(G, yaw)[:, 0].min() < 0.02 * smallest
    heights = np.vstack([at(0.1062), at(0.1462), at(0.15), at(0.10)])
    assert stewart.inside(G, heights).tolist() == [True, True, False, False]
