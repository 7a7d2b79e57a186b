"""The stereo rig: epipolar geometry of a rig whose lines are far from horizontal; bad rigs."""

from typing import Any

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import CalibrationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

CAM0 = Camera.make((640, 480), (400.0, 410.0), (320.0, 240.0), "radtan", [-0.2, 0.05, 1e-3, -1e-3])
CAM1 = Camera.make((640, 480), (380.0, 390.0), (310.0, 250.0), "equidistant", [0.01, 0, 0, 0])
T_IMU_CAM0 = se3.exp(np.array([0.5, -1.0, 0.7, 0.05, -0.02, 0.1]))
# the right camera is turned by 25 degrees about its axis and stands lower than the left one
T_CAM0_CAM1 = se3.make(so3.exp(np.deg2rad([3.0, -4.0, 25.0])), np.array([0.3, 0.12, 0.02]))


def tilted_rig() -> StereoRig:
    return StereoRig(CAM0, CAM1, T_IMU_CAM0, T_IMU_CAM0 @ T_CAM0_CAM1)


def points_cam0() -> FloatArray:
    return np.random.default_rng(1).uniform([-1, -1, 3], [1, 1, 20], size=(40, 3))


def homogeneous(xy: FloatArray) -> FloatArray:
    return np.column_stack([xy, np.ones(len(xy))])


def test_T_cam1_cam0_maps_left_points_into_the_right_camera() -> None:
    rig, p_cam0 = tilted_rig(), points_cam0()
    p_imu = se3.apply(rig.T_imu_cam0, p_cam0)
    p_cam1 = se3.apply(rig.T_cam1_cam0, p_cam0)
    np.testing.assert_allclose(se3.apply(rig.T_imu_cam1, p_cam1), p_imu, atol=1e-12)
    np.testing.assert_allclose(rig.T_cam1_cam0, se3.inverse(T_CAM0_CAM1), atol=1e-12)


def test_essential_matrix_is_zero_for_the_two_views_of_a_point() -> None:
    rig, p_cam0 = tilted_rig(), points_cam0()
    pixels0 = rig.cam0.project(p_cam0)
    pixels1 = rig.cam1.project(se3.apply(rig.T_cam1_cam0, p_cam0))
    x0 = homogeneous(rig.cam0.normalize(pixels0))
    x1 = homogeneous(rig.cam1.normalize(pixels1))
    residual = np.einsum("ni,ij,nj->n", x1, rig.essential, x0)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    # and not for the views of different points
    assert np.abs(np.einsum("ni,ij,nj->n", x1[::-1], rig.essential, x0)).max() > 1e-2


def test_baseline_is_the_distance_of_the_centres() -> None:
    assert tilted_rig().baseline == pytest.approx(np.sqrt(0.3**2 + 0.12**2 + 0.02**2))
    assert tilted_rig().cameras == (CAM0, CAM1)


def test_pixels_and_their_noise_in_normalized_coordinates() -> None:
    rig, p_cam0 = tilted_rig(), points_cam0()
    p_cam1 = se3.apply(rig.T_cam1_cam0, p_cam0)
    pixels = np.concatenate([rig.cam0.project(p_cam0), rig.cam1.project(p_cam1)], axis=1)
    pixels[3, 2:] = np.nan
    normalized = rig.normalize(pixels)
    np.testing.assert_allclose(normalized[:, :2], p_cam0[:, :2] / p_cam0[:, 2:], atol=1e-9)
    right = p_cam1[:, :2] / p_cam1[:, 2:]
    right[3] = np.nan
    np.testing.assert_allclose(normalized[:, 2:], right, atol=1e-9)
    sigma = rig.normalized_sigma(0.5)
    np.testing.assert_allclose(sigma, [0.5 / 400.0, 0.5 / 410.0, 0.5 / 380.0, 0.5 / 390.0])


def test_rounded_rotations_are_cleaned() -> None:
    rig = tilted_rig()
    rounded = StereoRig(CAM0, CAM1, rig.T_imu_cam0.round(4), rig.T_imu_cam1.round(4))
    clean = rounded.with_orthonormal_rotations()
    for T, T_rounded in (
        (clean.T_imu_cam0, rounded.T_imu_cam0),
        (clean.T_imu_cam1, rounded.T_imu_cam1),
    ):
        R = T[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(T, T_rounded, atol=2e-4)
    assert clean.time_offset_s == rounded.time_offset_s


def scaled(T: FloatArray) -> FloatArray:
    return np.vstack([np.column_stack([1.01 * T[:3, :3], T[:3, 3]]), T[3]])


MIRRORED = T_IMU_CAM0 @ np.diag([1.0, 1.0, -1.0, 1.0])
TRANSPOSED = np.ascontiguousarray(T_IMU_CAM0.T)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"T_imu_cam0": scaled(T_IMU_CAM0)}, "T_imu_cam0 does not hold a rotation"),
        ({"T_imu_cam0": MIRRORED}, "T_imu_cam0 does not hold a rotation"),
        ({"T_imu_cam0": TRANSPOSED}, "last row of T_imu_cam0"),
        ({"T_imu_cam1": np.full((4, 4), np.nan)}, "T_imu_cam1 must be a finite 4x4"),
        ({"T_imu_cam1": T_IMU_CAM0[:3]}, "T_imu_cam1 must be a finite 4x4"),
        ({"T_imu_cam1": np.zeros(4)}, "T_imu_cam1 must be a finite 4x4"),
        ({"T_imu_cam1": T_IMU_CAM0}, "same place"),
        ({"time_offset_s": np.nan}, "time offset"),
    ],
)
def test_impossible_rigs_are_refused(change: dict[str, Any], word: str) -> None:
    good = {"T_imu_cam0": T_IMU_CAM0, "T_imu_cam1": T_IMU_CAM0 @ T_CAM0_CAM1}
    with pytest.raises(CalibrationError, match=word):
        StereoRig(CAM0, CAM1, **(good | change))


def test_a_rig_of_rounded_lists_has_rotations() -> None:
    rig = tilted_rig()
    left, right = (np.round(T, 4) for T in (rig.T_imu_cam0, rig.T_imu_cam1))
    made = StereoRig.make(*rig.cameras, left.tolist(), right, 0.01)
    assert made.time_offset_s == 0.01
    for T, given in ((made.T_imu_cam0, left), (made.T_imu_cam1, right)):
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(T, given, atol=2e-4)
    right[0, 3] = 7.0  # the rig has its own copy
    assert made.T_imu_cam1[0, 3] != 7.0
    with pytest.raises(CalibrationError, match="must be a finite 4x4 matrix"):
        StereoRig.make(*rig.cameras, np.eye(3), right)
