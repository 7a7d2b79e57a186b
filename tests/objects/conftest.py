"""A car's stereo rig on a known path, and what it measures of points at rest or in motion."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.triangulation import project_stereo, stereo_covariance, triangulate_stereo
from ovmot.tracks import TrackTable
from ovmot.types import PointLabel, PoseWindow, ScenePoints

FRAME_NS = 100_000_000


@pytest.fixture(scope="session")
def rig() -> StereoRig:
    """640x280, 408 px, 0.475 m; the cameras' axes are neither the IMU's nor each other's."""
    left = Camera.make((640, 280), (408.0, 406.0), (304.0, 131.0))
    right = Camera.make((640, 280), (407.0, 404.0), (307.0, 125.0))
    R_imu_cam = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tilt = so3.exp(np.array([0.02, -0.03, 0.01]))
    T_imu_cam0 = se3.make(R_imu_cam @ tilt, np.array([1.7, 0.2, 0.1]))
    turn = so3.exp(np.array([-0.003, 0.005, 0.009]))
    T_cam0_cam1 = se3.make(turn, np.array([0.475, 0.001, -0.002]))
    return StereoRig(left, right, T_imu_cam0, T_imu_cam0 @ T_cam0_cam1)


@pytest.fixture(scope="session")
def drive() -> Callable[..., FloatArray]:
    """Poses T_world_imu (K, 4, 4) at 10 Hz: speed (m/s) along x, turn (rad/s) to the left."""

    def poses(n: int, speed: float = 6.0, turn: float = 0.1) -> FloatArray:
        t = 0.1 * np.arange(n)
        R = so3.exp(np.stack([0.0 * t, 0.01 * t, turn * t], axis=1))
        p = np.stack([speed * t, 0.5 * speed * turn * t**2, 0.05 * t], axis=1)
        return se3.make(R, p)

    return poses


@pytest.fixture(scope="session")
def measure() -> Callable[..., FloatArray]:
    """Plane coordinates (K, N, 4) of world points (N, 3), or (K, N, 3) if they move, with noise.

    `sigma_px` is the standard deviation of each pixel coordinate.
    """

    def normalized(
        rig: StereoRig, T_world_imu: FloatArray, p_world: FloatArray, sigma_px: float,
        rng: np.random.Generator,
    ) -> FloatArray:  # fmt: skip
        T_cam0_world = se3.inverse(T_world_imu @ rig.T_imu_cam0)
        p = np.broadcast_to(p_world, (len(T_world_imu), *p_world.shape[-2:]))
        seen, _ = project_stereo(se3.apply(T_cam0_world[:, None], p), rig.T_cam1_cam0)
        f = np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])
        out: FloatArray = seen + rng.normal(0.0, 1.0, seen.shape) * sigma_px / f
        return out

    return normalized


@pytest.fixture(scope="session")
def window_of() -> Callable[..., PoseWindow]:
    """A `PoseWindow` at 10 Hz of poses (K, 4, 4) and, if given, their covariance (6K, 6K)."""

    def window(T_world_imu: FloatArray, covariance: FloatArray | None = None) -> PoseWindow:
        stamps: IntArray = FRAME_NS * np.arange(1, len(T_world_imu) + 1, dtype=np.int64)
        if covariance is None:
            covariance = np.diag(np.tile([1e-8] * 3 + [1e-6] * 3, len(T_world_imu)))
        return PoseWindow(stamps, T_world_imu, covariance)

    return window


@pytest.fixture(scope="session")
def in_view() -> Callable[..., FloatArray]:
    """World points (N, 3) that the last pose's left camera sees, `depth` metres ahead."""

    def points(
        rig: StereoRig, T_world_imu: FloatArray, n: int, depth: tuple[float, float],
        rng: np.random.Generator,
    ) -> FloatArray:  # fmt: skip
        z = rng.uniform(*depth, n)
        p = np.column_stack([rng.uniform(-0.6, 0.6, n) * z, rng.uniform(-0.2, 0.2, n) * z, z])
        return se3.apply(T_world_imu[-1] @ rig.T_imu_cam0, p)

    return points


Scene = tuple[TrackTable, ScenePoints, PoseWindow]


@pytest.fixture(scope="session")
def scene_of(
    measure: Callable[..., FloatArray], window_of: Callable[..., PoseWindow]
) -> Callable[..., Scene]:
    """Table, points (all dynamic) and window of world points (K, N, 3) seen from poses (K, 4, 4).

    Every feature has been followed since the first frame; noise is white.
    """

    def scene(
        rig: StereoRig, T_world_imu: FloatArray, p_world: FloatArray, sigma_px: float,
        rng: np.random.Generator,
    ) -> Scene:  # fmt: skip
        n_frames, n = p_world.shape[:2]
        normalized = measure(rig, T_world_imu, p_world, sigma_px, rng)
        f0, f1 = rig.cam0.intrinsics, rig.cam1.intrinsics
        focal, centre = np.r_[f0[:2], f1[:2]], np.r_[f0[2:4], f1[2:4]]
        pixels = normalized * focal + centre
        window = window_of(T_world_imu)
        feature_id = np.arange(100, 100 + n)
        no = np.zeros(n, dtype=np.bool_)
        table = TrackTable(
            window.timestamp_ns, window.timestamp_ns, feature_id, pixels, normalized,
            np.full(n, n_frames - 1), np.zeros((n_frames, n), dtype=np.bool_), no, no,
        )  # fmt: skip
        p_cam0 = triangulate_stereo(normalized[-1], rig.T_cam1_cam0)
        unknown = np.full(n, np.nan)
        points = ScenePoints(
            feature_id=feature_id,
            pixels=pixels[-1],
            p_cam0=p_cam0,
            cov_cam0=stereo_covariance(p_cam0, rig.T_cam1_cam0, sigma_px / focal),
            label=np.full(n, int(PointLabel.DYNAMIC)),
            track_id=np.full(n, -1),
            previous=np.full((n, 2), np.nan),
            predicted=np.full((n, 2), np.nan),
            distance_m=unknown,
            reprojection_px=unknown,
            two_view_inlier=no,
        )
        return table, points, window

    return scene


@pytest.fixture(scope="session")
def body() -> Callable[..., FloatArray]:
    """Points (K, N, 3) of a body at 10 Hz whose centre is at `centre` (3,) in the last frame.

    It has a constant twist: `velocity` (3,) of that centre in the last frame, `yaw_rate`.
    """

    def points(
        n_frames: int, n: int, centre: FloatArray, velocity: FloatArray, yaw_rate: float,
        rng: np.random.Generator, size: tuple[float, float, float] = (4.0, 1.8, 1.4),
    ) -> FloatArray:  # fmt: skip
        local = rng.uniform(-0.5, 0.5, (n, 3)) * np.array(size)
        age = 0.1 * np.arange(n_frames - 1, -1, -1)
        twist = np.r_[0.0, 0.0, yaw_rate, velocity]
        return se3.apply(se3.exp(-age[:, None] * twist)[:, None], local) + centre

    return points
