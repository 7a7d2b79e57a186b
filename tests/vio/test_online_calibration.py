"""The calibration in the error state: every Jacobian is the derivative of what it is of."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import linearize

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.physics import LENS_SIGMA_PX
from ovmot.settings import CalibrationSettings
from ovmot.sim.imu import perfect_imu
from ovmot.types import ImuNoise
from ovmot.vio.integrators import INTEGRATORS
from ovmot.vio.msckf_features import calibration_jacobians
from ovmot.vio.online_calibration import (
    MOUNT,
    OnlineCalibration,
    calibrated_rig,
    calibration_estimate,
    correct_imu,
    imu_intrinsics,
    imu_sensitivity,
    make_calibration,
)
from ovmot.vio.propagation import propagate_imu
from ovmot.vio.state import N_BASE, ImuState, State, box_plus

Derivative = Callable[..., FloatArray]
ALL = CalibrationSettings(extrinsics=True, intrinsics=True, imu_intrinsics=True, g_sensitivity=True)
BIAS = (np.array([0.02, -0.01, 0.03]), np.array([0.1, 0.2, -0.1]))


def deviating(rig: StereoRig, settings: CalibrationSettings = ALL) -> OnlineCalibration:
    calibration, variance = make_calibration(rig, settings)
    deviation = np.sqrt(variance) * np.random.default_rng(4).normal(0.0, 1.0, len(variance))
    return replace(calibration, deviation=deviation)


def test_only_what_is_switched_on_is_estimated(rig: StereoRig) -> None:
    nothing, _ = make_calibration(rig, CalibrationSettings(lens_sigma_px=0.0))
    assert len(nothing) == 0
    assert calibrated_rig(rig, nothing) is rig
    assert imu_intrinsics(nothing) is None
    everything, variance = make_calibration(rig, ALL)
    assert len(everything) == len(variance) == 12 + 2 * 8 + 9 + 6 + 9
    assert (variance > 0.0).all()
    starts = [part.columns.start for part in everything.parts]
    assert starts == sorted(set(starts))
    again = calibrated_rig(rig, everything)
    np.testing.assert_allclose(again.T_imu_cam1, rig.T_imu_cam1, atol=1e-15)
    np.testing.assert_array_equal(again.cam0.intrinsics, rig.cam0.intrinsics)


def test_lenses_that_are_not_estimated_are_considered(rig: StereoRig) -> None:
    """Their image centres, last, with the stated sigma; they are no part of what is reported."""
    for settings in (CalibrationSettings(), CalibrationSettings(imu_intrinsics=True)):
        calibration, variance = make_calibration(rig, settings)
        n = len(calibration) - 4
        assert (calibration.n_estimated, calibration.n_considered) == (n, 4)
        np.testing.assert_array_equal(variance[n:], LENS_SIGMA_PX**2)
        assert len(calibration.names()) == n
        if n:
            estimate = calibration_estimate(rig, calibration, np.diag(variance))
            assert estimate.names == calibration.names()
            np.testing.assert_array_equal(estimate.std, np.sqrt(variance[:n]))
        else:
            assert calibrated_rig(rig, calibration) is rig
    for settings in (CalibrationSettings(extrinsics=True), CalibrationSettings(intrinsics=True)):
        assert make_calibration(rig, settings)[0].n_considered == 0


def test_visual_jacobians_of_considered_centers(
    rig: StereoRig, make_state: Callable[..., State], central_differences: Derivative
) -> None:
    calibration, _ = make_calibration(rig, CalibrationSettings())
    state = replace(make_state(np.random.default_rng(3), 2), calibration=calibration)
    points = se3.apply(state.clones.T_world_imu[0], np.array([[6.0, 1.0, 0.4], [9.0, -2.0, 1.0]]))
    pixels = np.random.default_rng(6).uniform(100.0, 500.0, (2, 2, 4))
    found = linearize(state, rig, pixels, points, 0.7).H[..., :4]

    def residual(error: FloatArray) -> FloatArray:
        cameras = []
        for side, camera in enumerate(rig.cameras):
            intrinsics = camera.intrinsics.copy()
            intrinsics[2:4] += error[2 * side : 2 * side + 2]
            cameras.append(replace(camera, intrinsics=intrinsics))
        moved = replace(rig, cam0=cameras[0], cam1=cameras[1])
        return linearize(state, moved, pixels, points, 0.7).residual.ravel()

    expected = -central_differences(residual, np.zeros(4))
    np.testing.assert_allclose(found.reshape(-1, 4), expected, atol=1e-6)
    by_kernel = calibration_jacobians(state.clones, rig, points, calibration)
    np.testing.assert_array_equal(by_kernel, np.broadcast_to(np.eye(4), by_kernel.shape))


@pytest.mark.parametrize("lens", ["radtan", "equidistant", "none"])
def test_visual_jacobians(
    lens: str, make_rig: Callable[[str], StereoRig], make_state: Callable[..., State],
    central_differences: Derivative,
) -> None:  # fmt: skip
    rig = make_rig(lens)
    state = replace(make_state(np.random.default_rng(3), 3), calibration=deviating(rig))
    points = se3.apply(
        state.clones.T_world_imu[0], np.array([[6.0, 1.0, 0.4], [9.0, -2.0, 1.0], [7.0, 0.0, 0.5]])
    )
    pixels = np.random.default_rng(6).uniform(100.0, 500.0, (3, 3, 4))
    system = linearize(state, calibrated_rig(rig, state.calibration), pixels, points, 0.7)

    def residual(error: FloatArray) -> FloatArray:
        moved = box_plus(state, np.concatenate([np.zeros(N_BASE), error]))
        now = calibrated_rig(rig, moved.calibration)
        return linearize(moved, now, pixels, points, 0.7).residual.ravel()

    n = system.H.shape[2]
    expected = -central_differences(residual, np.zeros(n))
    assert np.abs(expected[:, : len(state.calibration)]).max() > 10.0
    np.testing.assert_allclose(
        system.H.reshape(-1, n), expected, atol=2e-6 * np.abs(expected).max()
    )


def test_imu_sensitivity(rig: StereoRig, central_differences: Derivative) -> None:
    calibration = deviating(rig)
    rng = np.random.default_rng(8)
    gyro, accel = rng.normal(0.0, 1.0, (4, 3)), rng.normal(0.0, 6.0, (4, 3))

    def corrected(x: FloatArray) -> FloatArray:
        moved = calibration.plus(x[6:])
        bias = (BIAS[0] + x[:3], BIAS[1] + x[3:6])
        return np.stack(correct_imu(gyro, accel, bias, imu_intrinsics(moved)))

    expected = central_differences(corrected, np.zeros(6 + len(calibration)))
    rate, force = imu_sensitivity(gyro, accel, BIAS, calibration)
    np.testing.assert_allclose(rate, expected[0], atol=1e-7)
    np.testing.assert_allclose(force, expected[1], atol=1e-7)
    ideal = imu_sensitivity(gyro, accel, BIAS, OnlineCalibration())
    np.testing.assert_array_equal(ideal[0][:, :, :3], np.broadcast_to(-np.eye(3), (4, 3, 3)))


def test_errors_of_the_imu_are_taken_out(rig: StereoRig) -> None:
    calibration = deviating(rig)
    known = imu_intrinsics(calibration)
    assert known is not None
    rng = np.random.default_rng(9)
    rate, force = rng.normal(0.0, 1.0, (5, 3)), rng.normal(0.0, 6.0, (5, 3))
    read_force = force @ np.linalg.inv(known.accel_matrix).T + BIAS[1]
    read_rate = rate @ np.linalg.inv(known.gyro_matrix).T + force @ known.g_sensitivity.T + BIAS[0]
    found = correct_imu(read_rate, read_force, BIAS, known)
    np.testing.assert_allclose(found[0], rate, atol=1e-12)
    np.testing.assert_allclose(found[1], force, atol=1e-12)


@pytest.mark.parametrize("name", ["rk4", "analytic"])
def test_propagation_by_the_calibration(
    name: str, rig: StereoRig, curvy_path: PoseSpline, start_ns: int, noise: ImuNoise,
    central_differences: Derivative,
) -> None:  # fmt: skip
    stamps = start_ns + 2_500_000 * np.arange(41)
    samples = perfect_imu(curvy_path, stamps)
    T = curvy_path.pose(start_ns)
    imu = ImuState(T[:3, :3], T[:3, 3], curvy_path.velocity(start_ns), *BIAS)
    calibration = deviating(rig)

    def end(deviation: FloatArray) -> ImuState:
        moved = calibration.plus(deviation)
        result = propagate_imu(
            imu, imu, samples, noise, 9.81, INTEGRATORS[name], None, moved
        )  # fmt: skip
        return result.imu

    result = propagate_imu(imu, imu, samples, noise, 9.81, INTEGRATORS[name], None, calibration)
    reference = end(np.zeros(len(calibration)))
    assert result.transition.shape == (15, N_BASE + len(calibration))

    def error(deviation: FloatArray) -> FloatArray:
        e = end(deviation)
        turned = so3.log(reference.R_world_imu.T @ e.R_world_imu)
        return np.concatenate([turned, e.position - reference.position,
                               e.velocity - reference.velocity])  # fmt: skip

    expected = central_differences(error, np.zeros(len(calibration)), 1e-5)
    assert np.abs(expected).max() > 0.05
    for rows in (slice(0, 3), slice(3, 6), slice(6, 9)):
        np.testing.assert_allclose(
            result.transition[rows, N_BASE:], expected[rows],
            atol=3e-3 * np.abs(expected[rows]).max(),
        )  # fmt: skip


EXTRINSICS = CalibrationSettings(extrinsics=True, intrinsics=True)


def test_the_right_camera_moves_with_the_mount(rig: StereoRig) -> None:
    calibration, _ = make_calibration(rig, EXTRINSICS)
    mount = calibration.columns(MOUNT)
    assert mount is not None
    deviation = np.zeros(len(calibration))
    deviation[mount] = [0.01, -0.02, 0.005, 0.01, 0.02, -0.01]
    moved = calibrated_rig(rig, calibration.plus(deviation))
    assert np.abs(moved.T_imu_cam1 - rig.T_imu_cam1).max() > 0.01
    np.testing.assert_allclose(moved.T_cam1_cam0, rig.T_cam1_cam0, atol=1e-14)


def test_the_stereo_pose_leaves_the_left_camera(rig: StereoRig) -> None:
    """And its coordinate `length` is that of the baseline."""
    calibration, _ = make_calibration(rig, EXTRINSICS)
    deviation = np.zeros(len(calibration))
    deviation[calibration.names().index("stereo_length")] = 0.004
    moved = calibrated_rig(rig, calibration.plus(deviation))
    np.testing.assert_array_equal(moved.T_imu_cam0, rig.T_imu_cam0)
    assert moved.baseline == pytest.approx(rig.baseline + 0.004)
    axes = calibration.baseline_axes
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)


def test_the_baseline_is_known_best(rig: StereoRig) -> None:
    calibration, variance = make_calibration(rig, EXTRINSICS)
    sigma = dict(zip(calibration.names(), np.sqrt(variance), strict=True))
    assert sigma["stereo_length"] == pytest.approx(1e-3 * rig.baseline)
    assert sigma["stereo_length"] < sigma["stereo_down"] < sigma["cam0_pose_x"]
    assert sigma["stereo_rx"] < sigma["cam0_pose_rx"]


def test_the_estimate_has_the_right_camera_on_the_imu(
    rig: StereoRig, central_differences: Derivative
) -> None:
    calibration = deviating(rig)
    n = len(calibration)
    L = 1e-3 * np.random.default_rng(7).normal(0.0, 1.0, (n, n))
    found = calibration_estimate(rig, calibration, L @ L.T)
    right = [f"cam1_pose_{label}" for label in ("rx", "ry", "rz", "x", "y", "z")]
    assert list(found.names[6:12]) == right
    assert found.names[-1] == "stereo_forward"
    assert sorted(found.names) == sorted([*calibration.names(), *right])
    value = dict(zip(found.names, found.deviation, strict=True))
    own = [value[name] for name in calibration.names()]
    np.testing.assert_array_equal(own, calibration.deviation)

    def pose(error: FloatArray) -> FloatArray:
        T = calibrated_rig(rig, calibration.plus(error)).T_imu_cam1
        turn = so3.log(rig.T_imu_cam1[:3, :3].T @ T[:3, :3])
        return np.concatenate([turn, T[:3, 3] - rig.T_imu_cam1[:3, 3]])

    np.testing.assert_allclose([value[name] for name in right], pose(np.zeros(n)))
    J = central_differences(pose, np.zeros(n))
    sigma = dict(zip(found.names, found.std, strict=True))
    expected = np.sqrt(np.diag(J @ L @ L.T @ J.T))
    np.testing.assert_allclose([sigma[name] for name in right], expected, rtol=1e-5)
