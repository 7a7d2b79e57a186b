"""Visual measurements: Jacobians by finite differences, null-space projection, gate."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from plain_msckf import (
    FeatureSystem,
    chi2_gate,
    innovation_distances,
    linearize,
    project_nullspace,
)
from scipy.linalg import null_space
from scipy.linalg import qr as scipy_qr

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.types import FrontendFrame
from ovmot.vio import msckf_features
from ovmot.vio.msckf_features import reproject, triangulate_features
from ovmot.vio.state import (
    CLONE_SIZE,
    N_BASE,
    Clones,
    State,
    box_plus,
)

Derivative = Callable[..., FloatArray]
MakeRig = Callable[[str], StereoRig]
Observe = Callable[..., FrontendFrame]
lenses = pytest.mark.parametrize("lens", ["radtan", "equidistant"])

POINTS = np.array([[9.0, 1.0, 0.5], [6.0, -1.5, 1.0], [14.0, 3.0, -1.0], [7.5, 0.2, 0.0]])
SIGMA_PX = 0.8


@pytest.fixture
def state(make_state: Callable[..., State], curvy_path: PoseSpline, start_ns: int) -> State:
    """Four clones on the path, 0.2 s apart."""
    stamps = start_ns + 200_000_000 * np.arange(4)
    T = curvy_path.pose(stamps)
    return replace(make_state(np.random.default_rng(0), 4), clones=Clones(stamps, T, T))


def gate(
    state: State, H: FloatArray, residual: FloatArray, dof: IntArray, multiplier: float
) -> BoolArray:
    distance = innovation_distances(state.clone_covariance, H, residual)
    return chi2_gate(distance, dof, multiplier)


def per_clone(state: State, rig: StereoRig, points: FloatArray, field: str) -> FloatArray:
    """Noiseless pixels, or normalized coordinates, (F, K, 4)."""
    out = []
    for camera, T_imu_cam in zip(rig.cameras, (rig.T_imu_cam0, rig.T_imu_cam1), strict=True):
        T_cam_world = se3.inverse(state.clones.T_world_imu @ T_imu_cam)
        p = se3.apply(T_cam_world[None], points[:, None])
        out.append(camera.project(p) if field == "pixels" else p[..., :2] / p[..., 2:])
    return np.concatenate(out, axis=-1)


def some_observations(state: State, rig: StereoRig) -> FloatArray:
    """Pixels (4, K, 4) a little off: stereo, mono, a mix, and with a frame that saw nothing."""
    pixels = per_clone(state, rig, POINTS, "pixels")
    pixels = pixels + np.random.default_rng(1).normal(0.0, 1.0, pixels.shape)
    pixels[1, :, 2:] = np.nan
    pixels[2, ::2, 2:] = np.nan
    pixels[3, 1] = np.nan
    return pixels


@lenses
def test_jacobians_are_the_derivatives_of_the_residual(
    lens: str, state: State, make_rig: MakeRig, central_differences: Derivative
) -> None:
    rig = make_rig(lens)
    pixels = some_observations(state, rig)
    system = linearize(state, rig, pixels, POINTS, SIGMA_PX)

    def by_state(error: FloatArray) -> FloatArray:
        full = np.concatenate([np.zeros(N_BASE), error])
        return linearize(box_plus(state, full), rig, pixels, POINTS, SIGMA_PX).residual.ravel()

    def by_points(points: FloatArray) -> FloatArray:
        return linearize(state, rig, pixels, points.reshape(-1, 3), SIGMA_PX).residual.ravel()

    n_features, m, n = system.H.shape
    H_pose = -central_differences(by_state, np.zeros(n))
    np.testing.assert_allclose(system.H.reshape(-1, n), H_pose, atol=2e-5)
    H_point = -central_differences(by_points, POINTS.ravel()).reshape(n_features, m, n_features, 3)
    for i in range(n_features):
        np.testing.assert_allclose(system.H_point[i], H_point[i, :, i], atol=2e-5)
    assert np.abs(system.H).max() > 100.0
    np.testing.assert_array_equal(system.n_rows, [16, 8, 12, 12])


def test_unseen_views_give_zero_rows(state: State, rig: StereoRig) -> None:
    pixels = some_observations(state, rig)
    system = linearize(state, rig, pixels, POINTS, SIGMA_PX)
    unseen = ~np.isfinite(pixels.reshape(len(POINTS), -1))
    assert not system.H[unseen].any()
    assert not system.H_point[unseen].any()
    assert not system.residual[unseen].any()
    assert (np.abs(system.H[~unseen]).max(axis=1) > 1.0).all()


def test_residual_takes_latest_and_jacobian_first_estimates(state: State, rig: StereoRig) -> None:
    error = np.random.default_rng(2).normal(0.0, 0.02, len(state.covariance))
    moved = box_plus(state, error)
    all_moved = replace(
        moved, clones=replace(moved.clones, T_world_imu_first=moved.clones.T_world_imu)
    )
    pixels = some_observations(state, rig)
    at_first = linearize(state, rig, pixels, POINTS, SIGMA_PX)
    at_latest = linearize(all_moved, rig, pixels, POINTS, SIGMA_PX)
    mixed = linearize(moved, rig, pixels, POINTS, SIGMA_PX)
    np.testing.assert_array_equal(mixed.H, at_first.H)
    np.testing.assert_array_equal(mixed.H_point, at_first.H_point)
    np.testing.assert_array_equal(mixed.residual, at_latest.residual)
    assert not np.allclose(at_first.H, at_latest.H, rtol=1e-3)
    assert not np.allclose(at_first.residual, at_latest.residual, rtol=1e-3)


def test_a_point_behind_a_camera_gives_no_rows(state: State, rig: StereoRig) -> None:
    pixels = per_clone(state, rig, POINTS, "pixels")
    behind = POINTS.copy()
    behind[0] = [-9.0, 0.0, 0.0]
    system = linearize(state, rig, pixels, behind, SIGMA_PX)
    assert system.n_rows[0] == 0
    assert not system.H[0].any()
    np.testing.assert_array_equal(system.n_rows[1:], 16)


def test_views_are_linearised_in_the_picture_only(state: State, rig: StereoRig) -> None:
    """A first estimate far to the side is seen nowhere, though the latest one is where it is."""
    pixels = per_clone(state, rig, POINTS, "pixels")
    beside = POINTS.copy()
    beside[0] += [-POINTS[0, 0] + 1.5, 14.0, -6.0]
    beside[1] += 0.05  # still seen
    seen = reproject(state.clones, rig, pixels, (POINTS, beside), SIGMA_PX, state.calibration)
    assert not seen.seen[0].any()
    assert not seen.by_pose[0].any()
    assert seen.seen[1:].all()


def test_features_are_triangulated_in_world(
    state: State, rig: StereoRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    normalized = per_clone(state, rig, POINTS, "normalized")
    normalized[1, :, 2:] = np.nan
    points, valid = triangulate_features(state, rig, normalized, 1.0)
    assert valid.all()
    np.testing.assert_allclose(points, POINTS, atol=1e-5)
    monkeypatch.setattr(msckf_features, "DEPTH_RANGE_M", (0.1, 5.0))
    assert not triangulate_features(state, rig, normalized, 1.0)[1].any()


def random_system(rng: np.random.Generator, n_features: int, m: int, k: int) -> FeatureSystem:
    """A system whose rows are partly zero, some of them at the top."""
    H_pose, H_point = rng.normal(size=(n_features, m, k)), rng.normal(size=(n_features, m, 3))
    residual = rng.normal(size=(n_features, m))
    zero = rng.random((n_features, m)) < 0.3
    zero[::3, :3] = True
    zero[:, 3:8] = False
    H_pose[zero], H_point[zero], residual[zero] = 0.0, 0.0, 0.0
    return FeatureSystem(H_pose, H_point, residual, (~zero).sum(axis=1))


def test_projection_takes_the_point_out() -> None:
    system = random_system(np.random.default_rng(3), 20, 16, 6)
    instead = replace(system, H=system.H_point, residual=system.H_point @ [1.0, -2.0, 3.0])
    free = project_nullspace(instead)
    H, residual = free.H, free.residual
    assert H.shape == (20, 13, 3)
    np.testing.assert_allclose(H, 0.0, atol=1e-13)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)


def test_projection_keeps_the_information_of_a_null_space() -> None:
    system = random_system(np.random.default_rng(4), 20, 16, 6)
    free = project_nullspace(system)
    H, r = free.H, free.residual
    for i in range(20):
        N = null_space(system.H_point[i].T)
        H_known, r_known = N.T @ system.H[i], N.T @ system.residual[i]
        np.testing.assert_allclose(H[i].T @ H[i], H_known.T @ H_known, atol=1e-11)
        np.testing.assert_allclose(H[i].T @ r[i], H_known.T @ r_known, atol=1e-11)
        assert r[i] @ r[i] == pytest.approx(r_known @ r_known, rel=1e-10)
        # Zero rows carry nothing: the same without them, by a QR of the real rows.
        real = np.abs(system.H_point[i]).max(axis=1) > 0.0
        Q = scipy_qr(system.H_point[i][real])[0][:, 3:]
        H_real = Q.T @ system.H[i][real]
        assert len(H_real) == system.n_rows[i] - 3
        np.testing.assert_allclose(H[i].T @ H[i], H_real.T @ H_real, atol=1e-11)


def test_projection_leaves_its_argument_alone() -> None:
    system = random_system(np.random.default_rng(5), 3, 8, 6)
    copies = system.H.copy(), system.H_point.copy(), system.residual.copy()
    project_nullspace(system)
    np.testing.assert_array_equal(system.H, copies[0])
    np.testing.assert_array_equal(system.H_point, copies[1])
    np.testing.assert_array_equal(system.residual, copies[2])


def test_gate_passes_95_percent_of_consistent_features_and_no_others(
    make_state: Callable[..., State],
) -> None:
    rng = np.random.default_rng(6)
    n_features, k = 4000, 2 * CLONE_SIZE
    state = make_state(rng, 2)
    P = 100.0 * state.covariance
    state = replace(state, covariance=P)
    system = random_system(rng, n_features, 12, k)
    real = np.abs(system.H_point).max(axis=2) > 0.0
    L = np.linalg.cholesky(P[N_BASE:, N_BASE:])
    error = rng.normal(size=(n_features, k)) @ L.T
    point = rng.normal(0.0, 10.0, (n_features, 3))
    residual = (
        np.einsum("fmk,fk->fm", system.H, error)
        + np.einsum("fmi,fi->fm", system.H_point, point)
        + np.where(real, rng.normal(size=real.shape), 0.0)
    )
    dof = system.n_rows - 3
    free = project_nullspace(replace(system, residual=residual))
    H, r = free.H, free.residual
    rate = gate(state, H, r, dof, 1.0).mean()
    assert rate == pytest.approx(0.95, abs=0.012)
    # the state's own uncertainty is part of the bound
    certain = replace(state, covariance=1e-12 * P)
    assert gate(certain, H, r, dof, 1.0).mean() < 0.8
    wrong = np.where(real, residual + 200.0 * rng.normal(size=real.shape), 0.0)
    free = project_nullspace(replace(system, residual=wrong))
    H, r = free.H, free.residual
    assert gate(state, H, r, dof, 1.0).mean() < 0.01
    # a wider multiplier lets more through
    free = project_nullspace(replace(system, residual=1.5 * residual))
    H, r = free.H, free.residual
    narrow, wide = (gate(state, H, r, dof, x).mean() for x in (1.0, 3.0))
    assert narrow < 0.8 < wide


def test_gate_refuses_features_without_enough_rows(make_state: Callable[..., State]) -> None:
    state = make_state(np.random.default_rng(7), 1)
    H, r = np.zeros((2, 5, 6)), np.zeros((2, 5))
    passed = gate(state, H, r, np.array([0, 2]), 1.0)
    np.testing.assert_array_equal(passed, [False, True])
