"""Rigs keep their rays when their images get another size, and look where they are asked to."""

import numpy as np
import pytest

from ovmot.cameras.rig import rectified, without_distortion
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.sim.rigs import fisheye_rig, held, looking_along, resized, street_rig


def test_a_resized_camera_sees_the_same_rays_at_the_same_places() -> None:
    rig = street_rig()
    half = resized(rig, (320, 140))
    fine = np.array([[0.0, 0.0], [100.0, 50.0], [638.0, 278.0]]) + 0.5  # corners of four pixels
    coarse = (fine + 0.5) / 2.0 - 0.5
    for a, b in zip(rig.cameras, half.cameras, strict=True):
        assert (b.width, b.height) == (320, 140)
        np.testing.assert_allclose(b.normalize(coarse), a.normalize(fine), atol=1e-9)
    np.testing.assert_array_equal(half.T_imu_cam1, rig.T_imu_cam1)


@pytest.mark.parametrize("size", [(640, 480), (320, 141), (0, 0), (-640, -280)])
def test_another_aspect_ratio_is_refused(size: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="640x280; choose a size of the same aspect ratio"):
        resized(street_rig(), size)


def test_a_size_that_no_memory_holds_is_refused() -> None:
    with pytest.raises(InputError, match="size 64000x28000: choose at most 8192 pixels a side"):
        resized(street_rig(), (64_000, 28_000))


def test_the_fisheye_sees_150_degrees() -> None:
    for camera in fisheye_rig().cameras:
        ends = camera.normalize(np.array([[0.0, 256.0], [511.0, 256.0]]))
        across = np.degrees(np.arctan(np.linalg.norm(ends, axis=-1))).sum()
        assert 148.0 < across < 156.0


def test_a_held_rig_looks_along_and_keeps_its_baseline() -> None:
    rig = street_rig()
    ahead, up = np.array([0.2, -1.0, 0.7]), np.array([0.1, 0.3, 0.95])
    R = looking_along(ahead, up)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[:, 2] @ up == pytest.approx(0.0, abs=1e-12)  # level
    assert R[:, 1] @ up < -0.99 * np.linalg.norm(up)  # upright
    assert R[:, 2] @ ahead > 0.0
    small = held(rig, R)
    np.testing.assert_allclose(
        se3.inverse(small.T_imu_cam0) @ small.T_imu_cam1,
        se3.inverse(rig.T_imu_cam0) @ rig.T_imu_cam1, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(small.T_imu_cam0[:3, 3], -small.T_imu_cam1[:3, 3], atol=1e-12)


def test_a_camera_can_not_look_up_and_stay_upright() -> None:
    with pytest.raises(ValueError, match="vertical"):
        looking_along(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.0]))


def test_rectified_cameras_see_a_point_in_one_row_and_stand_where_they_stood() -> None:
    rig = street_rig()
    level = rectified(rig)
    points_imu = np.array([[12.0, 3.0, 1.0], [30.0, -4.0, 0.5], [8.0, 0.0, -1.0]])
    left, right = (
        camera.project(se3.apply(se3.inverse(T), points_imu))
        for camera, T in ((level.cam0, level.T_imu_cam0), (level.cam1, level.T_imu_cam1))
    )
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    assert np.all(left[:, 0] > right[:, 0])
    np.testing.assert_array_equal(level.T_imu_cam0[:3, 3], rig.T_imu_cam0[:3, 3])
    np.testing.assert_array_equal(level.T_imu_cam1[:3, 3], rig.T_imu_cam1[:3, 3])
    assert level.T_imu_cam0[:3, 2] @ rig.T_imu_cam0[:3, 2] > 0.99
    assert level.cam0.model.name == level.cam1.model.name == "none"


def test_cameras_without_distortion_look_the_same_way() -> None:
    rig = street_rig()
    plain = without_distortion(rig)
    xy = np.array([[0.3, -0.1]])
    expected = xy * [rig.cam1.fx, rig.cam1.fy] + rig.cam1.intrinsics[2:4]
    np.testing.assert_allclose(plain.cam1.denormalize(xy), expected, atol=1e-9)
    np.testing.assert_array_equal(plain.T_imu_cam1, rig.T_imu_cam1)
