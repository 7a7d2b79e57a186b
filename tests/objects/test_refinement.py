"""The refinement's derivatives, its optimum and its covariance."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import triangulate_stereo
from ovmot.objects.body_views_kernel import BodyViews
from ovmot.objects.refinement import refine_bodies
from ovmot.settings import ObjectSettings
from ovmot.types import PixelNoise

SETTINGS = ObjectSettings()
NOISE = PixelNoise(0.3, 0.3, 0.0, 0.0)
TURN = np.ones(2, dtype=np.bool_)
TWIST = np.array([[0.0, 0.0, 0.2, 4.0, -1.0, 0.1], [0.02, -0.01, -0.3, -8.0, 0.5, 0.0]])


@pytest.fixture(scope="module")
def views(
    rig: StereoRig, drive: Callable[..., FloatArray], body: Callable[..., FloatArray],
    measure: Callable[..., FloatArray],
) -> Callable[..., BodyViews]:  # fmt: skip
    """Two bodies of 10 points each, seen 0.4 s and 0.2 s ago and now; the twists to start from."""

    def make(sigma: float, seed: int, start: FloatArray = TWIST) -> BodyViews:
        rng = np.random.default_rng(seed)
        T = drive(5)
        centre = se3.apply(T[-1], np.array([[15.0, 2.0, 0.0], [22.0, -3.0, 0.5]]))
        p = np.concatenate(
            [
                se3.apply(
                    se3.exp(-0.1 * np.arange(4, -1, -1)[:, None] * xi)[:, None],
                    rng.uniform(-1.5, 1.5, (10, 3)),
                )
                + c
                for xi, c in zip(TWIST, centre, strict=True)
            ],
            axis=1,
        )
        seen = measure(rig, T, p, sigma, rng)[[0, 2, 4]]
        T_world_cam0 = np.repeat((T @ rig.T_imu_cam0)[[0, 2, 4], None], 2, axis=1)
        span = np.repeat(np.array([[0.4], [0.2], [0.0]]), 2, axis=1)
        p_cam0 = triangulate_stereo(seen[-1], rig.T_cam1_cam0)
        return BodyViews(
            seen, p_cam0, np.repeat([0, 1], 10), T_world_cam0, span, 10.0 * span, centre, start
        )

    return make


def test_without_noise_the_motion_and_the_points_are_exact(
    rig: StereoRig, views: Callable[..., BodyViews]
) -> None:
    weak = SETTINGS.model_copy(update={"yaw_rate_sigma_rps": 1e4, "tilt_rate_sigma_rps": 1e4})
    given = views(0.0, 2, TWIST + np.array([0.0, 0.0, 0.1, 0.5, -0.5, 0.2]))
    off = given._replace(p_cam0=given.p_cam0 * 1.02)
    refined = refine_bodies(off, TURN, rig, weak, NOISE)
    np.testing.assert_allclose(refined.twist, TWIST, atol=1e-4)
    p_world = se3.apply(given.T_world_cam0[-1, 0], given.p_cam0)
    np.testing.assert_allclose(refined.p_world, p_world, atol=1e-4)
    assert refined.inlier.all()


def test_refined_velocities_beat_stereo_alone_and_know_their_errors(
    rig: StereoRig, views: Callable[..., BodyViews]
) -> None:
    errors, naive, nees = [], [], []
    for seed in range(40):
        given = views(0.3, 10 + seed)
        p = triangulate_stereo(given.seen, rig.T_cam1_cam0)
        weak = SETTINGS.model_copy(update={"yaw_rate_sigma_rps": 5.0, "tilt_rate_sigma_rps": 5.0})
        refined = refine_bodies(given, TURN, rig, weak, NOISE)
        e = refined.twist[:, 3:] - TWIST[:, 3:]
        errors.append(np.linalg.norm(e, axis=1))
        nees.append(np.einsum("bi,bij,bj->b", e, np.linalg.inv(refined.covariance[:, 3:, 3:]), e))
        world = se3.apply(given.T_world_cam0[:, 0][:, None], p)
        for b in range(2):
            own = given.body == b
            v = (world[-1, own] - world[0, own]).mean(0) / 0.4
            chord = se3.log(se3.exp(0.4 * TWIST[b]))[3:] / 0.4
            naive.append(np.linalg.norm(v - chord))
    assert np.mean(errors) < 0.8 * np.mean(naive)
    assert 2.0 < np.mean(nees) < 4.2


def test_bodies_that_may_not_turn_keep_to_the_translation(
    rig: StereoRig, views: Callable[..., BodyViews]
) -> None:
    given = views(0.3, 6, np.concatenate([np.zeros((2, 3)), TWIST[:, 3:]], axis=1))
    refined = refine_bodies(given, np.array([True, False]), rig, SETTINGS, NOISE)
    sigma = np.sqrt(refined.covariance[:, 2, 2])
    assert abs(refined.twist[0, 2] - TWIST[0, 2]) < 0.15
    assert sigma[1] < SETTINGS.tilt_rate_sigma_rps
    assert abs(refined.twist[1, 2]) < 0.7 * abs(TWIST[1, 2])


def test_a_wrong_match_is_left_out(rig: StereoRig, views: Callable[..., BodyViews]) -> None:
    given = views(0.3, 3)
    given.seen[0, 4] += np.array([0.05, 0.02, 0.05, 0.02])
    refined = refine_bodies(given, TURN, rig, SETTINGS, NOISE)
    assert not refined.inlier[4]
    assert refined.inlier.sum() >= 18
    assert np.linalg.norm(refined.twist[0, 3:] - TWIST[0, 3:]) < 0.6
