"""The compiled MSCKF measurement against its plain twin, which projects by QR."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import ConsistentUpdate, plain_consistent_features

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.settings import CalibrationSettings, FilterSettings
from ovmot.vio import msckf_kernel
from ovmot.vio.msckf_features import ConsistentFeatures, consistent_features
from ovmot.vio.online_calibration import calibrated_rig, make_calibration
from ovmot.vio.state import N_BASE, VELOCITY, Clones, State, box_minus
from ovmot.vio.update import ekf_update, moved

MakeRig = Callable[[str], StereoRig]
Scene = Callable[..., tuple[State, StereoRig, FloatArray, FloatArray]]
ALL = CalibrationSettings(extrinsics=True, intrinsics=True, imu_intrinsics=True, g_sensitivity=True)
N_CLONES = 7
SETTINGS = FilterSettings()


@pytest.fixture
def scene(
    make_state: Callable[..., State], curvy_path: PoseSpline, start_ns: int, make_rig: MakeRig
) -> Scene:
    """A function (lens, calibrated) to a state, its rig, pixels (24, K, 4) and points (24, 3)."""

    def make(lens: str, *, calibrated: bool) -> tuple[State, StereoRig, FloatArray, FloatArray]:
        rng, rig = np.random.default_rng(5), make_rig(lens)
        stamps = start_ns + 100_000_000 * np.arange(N_CLONES)
        T = curvy_path.pose(stamps)
        clones = Clones(stamps, T, T @ se3.exp(rng.normal(0.0, 2e-3, (N_CLONES, 6))))
        state = replace(make_state(rng, N_CLONES), clones=clones)
        if calibrated:
            calibration, variance = make_calibration(rig, ALL)
            deviation = 0.1 * np.sqrt(variance) * rng.normal(size=len(variance))
            state = replace(state, calibration=replace(calibration, deviation=deviation))
        n = state.first_landmark
        A = rng.normal(size=(n, n))
        state = replace(state, covariance=1e-7 * (A @ A.T) + 1e-7 * np.eye(n))
        depth = rng.uniform(5.0, 30.0, 24)
        across = rng.uniform(-0.4, 0.4, (24, 2)) * depth[:, None]
        points = se3.apply(T[0], np.column_stack([depth, across]))
        pixels = per_clone(state, calibrated_rig(rig, state.calibration), points)
        pixels += SETTINGS.pixel_sigma * rng.normal(size=pixels.shape)
        pixels[rng.random((24, N_CLONES)) < 0.3] = np.nan
        pixels[rng.random((24, N_CLONES)) < 0.3, 2:] = np.nan
        pixels[0, 1:] = np.nan  # one view
        pixels[1] = np.nan
        return state, calibrated_rig(rig, state.calibration), pixels, points

    return make


def per_clone(state: State, rig: StereoRig, points: FloatArray) -> FloatArray:
    """Noiseless pixels (F, K, 4)."""
    out = []
    for camera, T_imu_cam in zip(rig.cameras, (rig.T_imu_cam0, rig.T_imu_cam1), strict=True):
        T_cam_world = se3.inverse(state.clones.T_world_imu @ T_imu_cam)
        out.append(camera.project(se3.apply(T_cam_world[None], points[:, None])))
    return np.concatenate(out, axis=-1)


def assert_same_update(state: State, ours: ConsistentFeatures, plain: ConsistentUpdate) -> None:
    np.testing.assert_allclose(ours.weight, plain.weight, atol=1e-9)
    columns = np.arange(N_BASE, state.first_landmark)
    variance = np.ones(len(plain.residual))
    expected = ekf_update(state, plain.H, columns, plain.residual, variance)
    deviation = np.sqrt(np.diag(expected.covariance))
    scale = np.outer(deviation, deviation)
    np.testing.assert_allclose(ours.covariance / scale, expected.covariance / scale, atol=1e-7)
    found = moved(state, ours.error, ours.covariance)
    np.testing.assert_allclose(box_minus(found, expected) / deviation, 0.0, atol=1e-6)
    assert np.abs(ours.error / np.sqrt(np.diag(state.covariance))).max() > 0.1


@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize("lens", ["radtan", "equidistant", "none"])
def test_the_update_is_that_of_the_plain_twin(lens: str, calibrated: bool, scene: Scene) -> None:
    state, rig, pixels, points = scene(lens, calibrated=calibrated)
    pixels[2:6] += 3.0 * np.random.default_rng(6).normal(size=pixels[2:6].shape)
    settings = FilterSettings(chi2_multiplier=3.0)
    ours = consistent_features(state, rig, pixels, points, settings)
    projected, plain = plain_consistent_features(state, rig, pixels, points, settings)
    assert plain is not None
    assert_same_update(state, ours, plain)
    assert (ours.weight == 0.0).sum() > 2
    assert ((ours.weight > 0.0) & (ours.weight < 1.0)).any()
    # the rows that determine a point may differ by a rotation
    for f in np.flatnonzero(ours.weight):
        a, b = ours.points, projected.points
        for x, y in ((a.R, b.R), (a.E, b.E)):
            product = b.R[f].T @ y[f]
            np.testing.assert_allclose(a.R[f].T @ x[f], product, atol=1e-9 * np.abs(product).max())


def test_views_outside_the_picture_do_not_count(scene: Scene) -> None:
    """Linearized by its first estimates a point is beside the picture, or behind the camera."""
    state, rig, pixels, points = scene("radtan", calibrated=False)
    points[4] = se3.apply(state.clones.T_world_imu[0], np.array([2.0, 9.0, 0.0]))
    points[5] = se3.apply(state.clones.T_world_imu[0], np.array([-3.0, 0.0, 0.0]))
    ours = consistent_features(state, rig, pixels, points, SETTINGS)
    _, plain = plain_consistent_features(state, rig, pixels, points, SETTINGS)
    assert plain is not None
    assert not ours.weight[4:6].any()
    assert_same_update(state, ours, plain)


@pytest.mark.parametrize("unsure", [1e-3, 30.0])
def test_a_majority_that_asks_for_another_velocity_is_left_out(scene: Scene, unsure: float) -> None:
    """What two thirds of the features show moves at 20 m/s; each by itself passes a wide gate.

    Where the poses are `unsure`, the nearest features by their distances are others than by the
    bounds of these that are enough for a weight.
    """
    state, rig, pixels, points = scene("radtan", calibrated=False)
    span_s = 0.1 * np.arange(N_CLONES)
    by_velocity = np.zeros((len(state.covariance), 3))  # known to 0.1 m/s, it moves the clones
    by_velocity[VELOCITY] = 0.1 * np.eye(3)
    for k in range(N_CLONES):
        by_velocity[state.clone_columns(k)][3:] = 0.1 * span_s[k] * np.eye(3)
    P = unsure * state.covariance + by_velocity @ by_velocity.T
    state = replace(state, covariance=P)
    for f in range(8, 24):
        moved = points[f] + span_s[:, None] * np.array([0.0, 20.0, 0.0])
        there = np.stack([per_clone(state, rig, p[None])[0, k] for k, p in enumerate(moved)])
        pixels[f] = np.where(np.isfinite(pixels[f]), there, np.nan)
    settings = FilterSettings(chi2_multiplier=1e6)
    ours = consistent_features(state, rig, pixels, points, settings)
    _, plain = plain_consistent_features(state, rig, pixels, points, settings)
    assert plain is not None
    assert_same_update(state, ours, plain)
    assert 3 <= (ours.weight > 0.0).sum() <= 11


def test_compressed_rows_keep_the_information() -> None:
    """Also of directions that no row sees, and of units far apart."""
    rng = np.random.default_rng(8)
    rows = rng.normal(size=(60, 13)) * 10.0 ** np.linspace(-3.0, 3.0, 13)
    rows[:, 4], rows[:, 9] = 2.0 * rows[:, 2] - rows[:, 3], 0.0
    G = rows.T @ rows
    H, residual = msckf_kernel.compressed(np.tril(G))
    assert len(H) == len(residual) == 10
    scale = np.sqrt(np.maximum(np.diag(G), 1e-300))
    product = np.column_stack([H, residual]).T @ np.column_stack([H, residual])
    expected = G / np.outer(scale, scale)
    found = product / np.outer(scale, scale)
    np.testing.assert_allclose(found[:-1, :-1], expected[:-1, :-1], atol=1e-12)
    np.testing.assert_allclose(found[-1, :-1], expected[-1, :-1], atol=1e-12)
