"""SLAM features: their Jacobians, delayed initialization and changes of anchor."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import FeatureSystem, linearize, project_nullspace
from scipy.linalg import block_diag

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.settings import CalibrationSettings
from ovmot.vio.landmarks import NO_ANCHOR, REPRESENTATIONS, Landmarks, no_landmarks
from ovmot.vio.online_calibration import calibrated_rig, make_calibration
from ovmot.vio.slam_features import (
    change_anchor,
    delayed_initialization,
    landmark_points,
    landmark_system,
    update_slam_features,
)
from ovmot.vio.state import N_BASE, State, box_minus, box_plus
from ovmot.vio.update import ekf_update

Derivative = Callable[..., FloatArray]
MakeState = Callable[..., State]
every_representation = pytest.mark.parametrize("name", list(REPRESENTATIONS))
SIGMA_PX = 0.8
AHEAD = np.array([[6.0, 1.0, 0.4], [9.0, -2.0, 1.0], [14.0, 3.0, -0.6], [5.0, 0.3, 0.2]])
"""Points in the frame of an IMU that looks along x."""
ALL = CalibrationSettings(extrinsics=True, intrinsics=True, imu_intrinsics=True, g_sensitivity=True)


@pytest.fixture
def scene(
    make_state: MakeState, make_rig: Callable[[str], StereoRig]
) -> Callable[..., tuple[State, StereoRig]]:
    """A function (representation, calibrated) to a state with four landmarks ahead, and its rig."""

    def make(name: str, *, calibrated: bool = False, n_clones: int = 4) -> tuple[State, StereoRig]:
        rng = np.random.default_rng(7)
        state, rig = make_state(rng, n_clones), make_rig("radtan")
        twists = rng.normal(0.0, 0.02, (n_clones, 6))
        poses = state.clones.T_world_imu[0] @ se3.exp(twists)
        state = replace(
            state, clones=replace(state.clones, T_world_imu=poses, T_world_imu_first=poses)
        )
        if calibrated:
            calibration, variance = make_calibration(rig, ALL)
            deviation = np.sqrt(variance) * rng.normal(0.0, 0.3, len(variance))
            state = replace(state, calibration=replace(calibration, deviation=deviation))
        landmarks = placed(no_landmarks(name), state, rig, poses[0])
        state = replace(state, landmarks=landmarks)
        n = state.first_landmark + landmarks.size * len(landmarks)
        A = 1e-3 * rng.normal(size=(n, n))
        return replace(state, covariance=A @ A.T + 1e-8 * np.eye(n)), rig

    return make


def placed(none: Landmarks, state: State, rig: StereoRig, T_world_imu: FloatArray) -> Landmarks:
    """Landmarks at the points ahead, those with anchors at the first and the second clone."""
    p_world = se3.apply(T_world_imu, AHEAD)
    anchored, coordinates = none.representation.anchored, none.representation.coordinates
    index = np.array([0, 1, 0, 1])
    if anchored:
        T = state.clones.T_world_imu[index] @ rig.T_imu_cam0
        p_world = se3.apply(se3.inverse(T), p_world[:, None])[:, 0]
    anchor = state.clones.timestamp_ns[index] if anchored else np.full(4, NO_ANCHOR)
    value = coordinates.from_point(p_world)
    ids = np.arange(4, dtype=np.int64)
    return Landmarks(none.representation, ids, value, value, anchor, np.zeros_like(ids))


def views_of(state: State, rig: StereoRig, points: FloatArray) -> FloatArray:
    """Exact pixels (F, K, 4) of points (F, 3) from all clones, by the calibrated rig."""
    now = calibrated_rig(rig, state.calibration)
    p_imu = se3.apply(se3.inverse(state.clones.T_world_imu)[None], points[:, None])
    return np.concatenate(
        [
            camera.project(se3.apply(se3.inverse(T), p_imu))
            for camera, T in zip(now.cameras, (now.T_imu_cam0, now.T_imu_cam1), strict=True)
        ],
        axis=-1,
    )


def unknown_features(
    name: str, scene: Callable[..., tuple[State, StereoRig]], *, calibrated: bool
) -> tuple[State, StereoRig, FloatArray, FloatArray]:
    """A state without landmarks, its rig, and exact views (4, K, 4) of four points (4, 3)."""
    state, rig = scene(name, calibrated=calibrated)
    points = points_of(state, rig)
    n = state.first_landmark
    state = replace(
        state, landmarks=no_landmarks(name), covariance=state.covariance[:n, :n]
    )  # fmt: skip
    return state, rig, views_of(state, rig, points), points


def initialized(state: State, rig: StereoRig, system: FeatureSystem, points: FloatArray) -> State:
    """The state augmented by all features, by the rows that determine them alone."""
    rows = project_nullspace(system).points
    return delayed_initialization(
        state, rows, np.arange(len(points)), points, rig.T_imu_cam0, np.zeros(len(state.covariance))
    )


def points_of(state: State, rig: StereoRig) -> FloatArray:
    return landmark_points(state.landmarks, state.clones, rig.T_imu_cam0, first=False).p_world


@every_representation
@pytest.mark.parametrize("calibrated", [False, True])
def test_jacobians_of_a_view_are_the_derivatives(
    name: str, calibrated: bool, scene: Callable[..., tuple[State, StereoRig]],
    central_differences: Derivative,
) -> None:  # fmt: skip
    state, rig = scene(name, calibrated=calibrated)
    pixels = views_of(state, rig, points_of(state, rig))[:, -1]
    assert np.isfinite(pixels).all()
    size = state.landmarks.size

    def residual(error: FloatArray) -> FloatArray:
        full = np.concatenate([np.zeros(N_BASE), error])
        moved = box_plus(state, full)
        now = calibrated_rig(rig, moved.calibration)
        as_xyz = points_of(moved, rig)
        p_imu = se3.apply(se3.inverse(moved.clones.T_world_imu[-1]), as_xyz)
        seen = [
            camera.project(se3.apply(se3.inverse(T), p_imu))
            for camera, T in zip(now.cameras, (now.T_imu_cam0, now.T_imu_cam1), strict=True)
        ]
        return np.asarray((pixels - np.concatenate(seen, axis=-1)) / SIGMA_PX).ravel()

    n = len(state.covariance) - N_BASE
    expected = -central_differences(residual, np.zeros(n)).reshape(len(pixels), 4, n)
    now = calibrated_rig(rig, state.calibration)
    H, r, rows = landmark_system(state, now, rig.T_imu_cam0, pixels, SIGMA_PX)
    np.testing.assert_allclose(r, 0.0, atol=1e-6)
    scale = np.abs(expected).max()
    if size == 3:
        np.testing.assert_array_equal(rows, 4)
        np.testing.assert_allclose(H, expected, atol=1e-6 * scale)
    else:  # the bearing is projected out: the same information is left
        np.testing.assert_array_equal(rows, 2)
        assert np.linalg.norm(H, axis=(1, 2)).min() > 1.0
        for k in range(len(H)):
            # every row of H is a combination of the derivative's rows
            coefficients = np.linalg.lstsq(expected[k].T, H[k].T, rcond=None)[0]
            np.testing.assert_allclose(
                expected[k].T @ coefficients, H[k].T, atol=1e-5 * np.abs(H[k]).max()
            )


@every_representation
def test_box_minus_undoes_box_plus_with_landmarks(
    name: str, scene: Callable[..., tuple[State, StereoRig]]
) -> None:
    state, _ = scene(name, calibrated=True)
    error = np.random.default_rng(2).uniform(-0.01, 0.01, len(state.covariance))
    np.testing.assert_allclose(box_minus(box_plus(state, error), state), error, atol=1e-12)


@every_representation
def test_another_anchor_is_the_same_point_with_the_same_uncertainty(
    name: str, scene: Callable[..., tuple[State, StereoRig]], central_differences: Derivative
) -> None:
    state, rig = scene(name)
    stamps = state.clones.timestamp_ns
    changed = change_anchor(state, int(stamps[0]), int(stamps[-1]), rig.T_imu_cam0)
    np.testing.assert_allclose(points_of(changed, rig), points_of(state, rig), atol=1e-9)
    if not state.landmarks.representation.anchored:
        assert changed is state
        return
    assert stamps[0] not in changed.landmarks.anchor_ns

    def uncertainty(s: State) -> FloatArray:
        n = len(s.covariance)
        J = central_differences(lambda e: points_of(box_plus(s, e), rig).ravel(), np.zeros(n), 1e-5)
        return np.asarray(J @ s.covariance @ J.T)

    before, after = uncertainty(state), uncertainty(changed)
    if state.landmarks.size == 3:
        np.testing.assert_allclose(after, before, atol=1e-4 * np.abs(before).max())
    np.testing.assert_allclose(changed.covariance, changed.covariance.T, atol=1e-15)
    kept = slice(0, state.first_landmark)
    np.testing.assert_array_equal(changed.covariance[kept, kept], state.covariance[kept, kept])


@every_representation
@pytest.mark.parametrize("calibrated", [False, True])
def test_delayed_initialization_follows_the_state_as_the_best_fit_does(
    name: str, calibrated: bool, scene: Callable[..., tuple[State, StereoRig]],
    central_differences: Derivative,
) -> None:  # fmt: skip
    """The correlation with the rest of the state is the derivative of the fit to all views."""
    state, rig, pixels, points = unknown_features(name, scene, calibrated=calibrated)
    system = linearize(state, calibrated_rig(rig, state.calibration), pixels, points, SIGMA_PX)
    augmented = initialized(state, rig, system, points)
    n = len(state.covariance)

    def refitted(error: FloatArray) -> FloatArray:
        """Values that fit the views best when the state has moved, by Gauss-Newton."""
        moved = box_plus(state, error)

        def residual(value: FloatArray) -> FloatArray:
            landmarks = replace(augmented.landmarks, value=value)
            p = landmark_points(landmarks, moved.clones, rig.T_imu_cam0, first=False).p_world
            return (pixels - views_of(moved, rig, p)).reshape(len(p), -1)

        value = augmented.landmarks.value
        # a landmark is seen in its own views alone: all of them move at once
        J = central_differences(lambda step: residual(value + step), np.zeros(3))
        by_residual = np.linalg.pinv(J)
        for _ in range(2):
            value = value - (by_residual @ residual(value)[..., None])[..., 0]
        return np.ravel(value[:, 3 - augmented.landmarks.size :])

    expected = central_differences(refitted, np.zeros(n), 1e-5)
    P = state.covariance
    following = np.linalg.solve(P, augmented.covariance[:n, n:]).T
    np.testing.assert_allclose(following, expected, atol=2e-4 * np.abs(expected).max())


@every_representation
def test_delayed_initialization_updates_as_the_features_alone_would(
    name: str, scene: Callable[..., tuple[State, StereoRig]]
) -> None:
    """Initialized by their first rows, landmarks and state are updated by the other rows."""
    state, rig, pixels, points = unknown_features(name, scene, calibrated=True)
    pixels = pixels + np.random.default_rng(3).normal(0.0, 0.3, pixels.shape)
    system = linearize(state, calibrated_rig(rig, state.calibration), pixels, points, SIGMA_PX)
    augmented = initialized(state, rig, system, points)
    assert np.linalg.eigvalsh(augmented.covariance).min() > 0.0
    n = len(state.covariance)
    np.testing.assert_array_equal(augmented.covariance[:n, :n], state.covariance)
    # the information of all rows on the state and on points without a prior
    k = np.arange(4)
    H = np.zeros((*system.H.shape[:2], n + 12))
    H[..., N_BASE:n] = system.H
    by_point = H[..., n:].reshape(4, -1, 4, 3)  # a view
    by_point[k, :, k] = system.H_point
    H = H.reshape(-1, n + 12)
    information = block_diag(np.linalg.inv(state.covariance), np.zeros((12, 12))) + H.T @ H
    covariance = np.linalg.inv(information)
    moved = box_plus(state, (covariance @ H.T @ system.residual.ravel())[:n])

    projected = project_nullspace(system)
    ours = ekf_update(
        augmented, projected.H.reshape(-1, n - N_BASE), np.arange(N_BASE, n),
        projected.residual.ravel(),        np.ones(projected.residual.size),
    )  # fmt: skip
    expected = covariance[:n, :n]
    np.testing.assert_allclose(
        ours.covariance[:n, :n], expected, atol=1e-8 * np.abs(expected).max()
    )
    alone = replace(ours, landmarks=state.landmarks, covariance=expected)
    np.testing.assert_allclose(box_minus(alone, moved), 0.0, atol=1e-7)


def test_a_feature_whose_rows_leave_a_direction_undetermined_is_left_out(
    scene: Callable[..., tuple[State, StereoRig]],
) -> None:
    state, rig, pixels, points = unknown_features("global_xyz", scene, calibrated=False)
    pixels[1, 1:] = np.nan
    pixels[1, :, 2:] = np.nan  # one camera, one view: no depth
    augmented = initialized(state, rig, linearize(state, rig, pixels, points, SIGMA_PX), points)
    assert augmented.landmarks.feature_id.tolist() == [0, 2, 3]
    assert len(augmented.covariance) == len(state.covariance) + 9


@every_representation
def test_views_reduce_the_variance_of_landmarks_and_a_wrong_one_is_rejected(
    name: str, scene: Callable[..., tuple[State, StereoRig]]
) -> None:
    state, rig = scene(name)
    pixels = views_of(state, rig, points_of(state, rig))[:, -1]
    pixels[3] += 40.0
    pixels[2, 2:] = np.nan
    seen = update_slam_features(state, rig, rig.T_imu_cam0, pixels, SIGMA_PX, 1.0)
    assert seen.landmarks.rejections.tolist() == [0, 0, 0, 1]
    start = state.first_landmark
    before, after = np.diag(state.covariance)[start:], np.diag(seen.covariance)[start:]
    assert after.sum() < before.sum()
    unseen = update_slam_features(
        state, rig, rig.T_imu_cam0, np.full((4, 4), np.nan), SIGMA_PX, 1.0
    )
    assert unseen is state


def test_a_landmark_that_is_beside_the_image_by_its_first_estimate_waits(
    scene: Callable[..., tuple[State, StereoRig]],
) -> None:
    """Four times as near as it is, it would be passed by now."""
    state, rig = scene("anchored_msckf_inverse_depth")
    pixels = views_of(state, rig, points_of(state, rig))[:, -1]
    first = state.landmarks.first.copy()
    first[0] = [-8.0, -3.0, 0.7]
    state = replace(state, landmarks=replace(state.landmarks, first=first))
    seen = update_slam_features(state, rig, rig.T_imu_cam0, pixels, SIGMA_PX, 1.0)
    unseen = pixels.copy()
    unseen[0] = np.nan
    without = update_slam_features(state, rig, rig.T_imu_cam0, unseen, SIGMA_PX, 1.0)
    scale = np.abs(without.covariance).max()
    np.testing.assert_allclose(seen.covariance, without.covariance, rtol=0, atol=1e-12 * scale)
    assert np.trace(seen.covariance) < np.trace(state.covariance)


def test_first_estimates_stay_where_they_were(
    scene: Callable[..., tuple[State, StereoRig]],
) -> None:
    """The Jacobian after an update is that before it, though landmark and poses have moved."""
    state, rig = scene("anchored_msckf_inverse_depth")
    pixels = views_of(state, rig, points_of(state, rig))[:, -1]
    error = np.random.default_rng(5).normal(0.0, 3e-3, len(state.covariance))
    moved = box_plus(state, error)
    before, _, _ = landmark_system(state, rig, rig.T_imu_cam0, pixels, SIGMA_PX)
    after, r, _ = landmark_system(moved, rig, rig.T_imu_cam0, pixels, SIGMA_PX)
    np.testing.assert_array_equal(after, before)
    assert np.abs(r).max() > 0.5
