"""A small stereo rig, a curvy path, points beside it, and frames as a tracker gives them."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.config import CalibrationSettings
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.msckf.calibration import make_calibration
from ovmot.msckf.start_window import StartWindow
from ovmot.msckf.state import CLONE_SIZE, N_BASE, Clones, ImuState, State
from ovmot.sim.imu import perfect_imu
from ovmot.types import FrontendFrame, ImuNoise

START_NS = 1_500_000_000_000_000_000
"""An epoch stamp: a double holds it only to 256 ns."""

_DISTORTION = {
    "none": [],
    "radtan": [-0.2, 0.05, 1e-3, -5e-4],
    "equidistant": [0.02, -0.01, 0.004, -0.001],
}
_R_IMU_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@pytest.fixture(scope="session")
def start_ns() -> int:
    """The first moment of `curvy_path` that a test may use; 7 s follow it."""
    return START_NS


@pytest.fixture(scope="session")
def noise() -> ImuNoise:
    """A consumer IMU."""
    return ImuNoise(gyro=1e-3, gyro_walk=1e-4, accel=1e-2, accel_walk=1e-3)


@pytest.fixture(scope="session")
def make_rig() -> Callable[[str], StereoRig]:
    """From a lens's name: two cameras that look along the IMU's x axis, the right one turned."""

    def make(lens: str) -> StereoRig:
        left = Camera.make((640, 480), (400.0, 405.0), (321.0, 238.0), lens, _DISTORTION[lens])
        right = Camera.make((640, 480), (398.0, 402.0), (318.0, 241.0), lens, _DISTORTION[lens])
        turn = so3.exp(np.array([0.02, -0.03, 0.1]))
        return StereoRig(
            left,
            right,
            se3.make(_R_IMU_CAM, np.array([0.1, 0.15, 0.05])),
            se3.make(_R_IMU_CAM @ turn, np.array([0.12, -0.16, 0.06])),
        )

    return make


@pytest.fixture(scope="session")
def rig(make_rig: Callable[[str], StereoRig]) -> StereoRig:
    """The rig with radial-tangential lenses."""
    return make_rig("radtan")


@pytest.fixture(scope="session")
def curvy_path() -> PoseSpline:
    """3 m/s on average, with accelerations and turns about every axis; 8 s from START_NS - 1 s."""
    t = np.arange(-1.0, 8.0, 0.05)
    p = np.stack([3.0 * t + 0.8 * np.sin(1.3 * t), np.sin(1.1 * t), 0.4 * np.sin(1.7 * t)], axis=1)
    yaw, pitch, roll = 0.3 * np.sin(0.8 * t), 0.1 * np.sin(1.2 * t), 0.15 * np.cos(t)
    R = so3.exp(yaw[:, None] * np.array([0.0, 0.0, 1.0]))
    R = R @ so3.exp(pitch[:, None] * np.array([0.0, 1.0, 0.0]))
    R = R @ so3.exp(roll[:, None] * np.array([1.0, 0.0, 0.0]))
    stamps = START_NS + np.round(1e9 * t).astype(np.int64)
    return PoseSpline.through(stamps, se3.make(R, p))


@pytest.fixture(scope="session")
def landmarks() -> FloatArray:
    """400 points (N, 3) in world, around the path and ahead of it."""
    rng = np.random.default_rng(11)
    return rng.uniform([3.0, -12.0, -3.0], [50.0, 12.0, 5.0], (400, 3))


@pytest.fixture(scope="session")
def observe() -> Callable[..., FrontendFrame]:
    """A function from a rig, its pose and points (N, 3) to the frame seen, with pixel noise.

    A point's id is its index. Points outside the left image are left out; outside the right one,
    the right half is NaN.
    """

    def frame(
        rig: StereoRig,
        T_world_imu: FloatArray,
        points: FloatArray,
        stamp: int,
        sigma_px: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> FrontendFrame:
        pixels, normalized = [], []
        for camera, T_imu_cam in zip(rig.cameras, (rig.T_imu_cam0, rig.T_imu_cam1), strict=True):
            p_cam = se3.apply(se3.inverse(T_world_imu @ T_imu_cam), points)
            uv = camera.project(p_cam)
            if rng is not None:
                uv = uv + rng.normal(0.0, sigma_px, uv.shape)
            xy = camera.normalize(uv)
            with np.errstate(invalid="ignore"):
                seen = camera.inside(uv) & (p_cam[:, 2] > 0.3) & np.isfinite(xy).all(axis=1)
            pixels.append(np.where(seen[:, None], uv, np.nan))
            normalized.append(np.where(seen[:, None], xy, np.nan))
        kept = np.flatnonzero(np.isfinite(pixels[0][:, 0])).astype(np.int64)
        return FrontendFrame(
            timestamp_ns=stamp,
            feature_id=kept,
            pixels=np.concatenate(pixels, axis=1)[kept],
            normalized=np.concatenate(normalized, axis=1)[kept],
            hops=np.zeros(len(kept), dtype=np.int64),
            two_view_inlier=np.ones(len(kept), dtype=np.bool_),
        )

    return frame


@pytest.fixture(scope="session")
def make_state() -> Callable[..., State]:
    """A function (rng, n_clones) to a random state whose clones lie near each other."""

    def make(rng: np.random.Generator, n_clones: int = 3) -> State:
        imu = ImuState(
            so3.exp(rng.normal(0.0, 1.0, 3)),
            rng.normal(0.0, 2.0, 3),
            rng.normal(0.0, 3.0, 3),
            rng.normal(0.0, 0.02, 3),
            rng.normal(0.0, 0.2, 3),
        )
        twists = rng.normal(0.0, 0.2, (n_clones, 6))
        T = se3.make(imu.R_world_imu, imu.position) @ se3.exp(twists)
        n = N_BASE + CLONE_SIZE * n_clones
        A = 1e-2 * rng.normal(size=(n, n))
        stamps = START_NS + 100_000_000 * np.arange(n_clones)
        return State(
            START_NS, imu, imu, 0.003, Clones(stamps, T, T), A @ A.T + 1e-5 * np.eye(n)
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def start_error() -> Callable[[ImuState, ImuState], FloatArray]:
    """A function (truth, estimate) to the error (15,) of a start, whose heading is arbitrary."""

    def error(truth: ImuState, estimate: ImuState) -> FloatArray:
        E = truth.R_world_imu @ estimate.R_world_imu.T
        yaw = np.arctan2(E[1, 0] - E[0, 1], E[0, 0] + E[1, 1])
        turn = so3.exp(np.array([0.0, 0.0, -yaw]))
        return np.concatenate(
            [
                so3.log(estimate.R_world_imu.T @ turn @ truth.R_world_imu),
                -estimate.position,  # the world begins at the rig
                turn @ truth.velocity - estimate.velocity,
                truth.gyro_bias - estimate.gyro_bias,
                truth.accel_bias - estimate.accel_bias,
            ]
        )

    return error


@pytest.fixture(scope="session")
def make_window(
    rig: StereoRig, curvy_path: PoseSpline, start_ns: int
) -> Callable[..., StartWindow]:
    """A function (n instants, settings of the calibration) to the true window, 0.1 s apart."""

    def make(n: int, settings: CalibrationSettings | None = None) -> StartWindow:
        stamps = start_ns + 100_000_000 * np.arange(n)
        zero = np.zeros(3)
        imu = perfect_imu(curvy_path, stamps)
        calibration, _ = make_calibration(rig, settings or CalibrationSettings())
        return StartWindow(
            stamps, curvy_path.pose(stamps), curvy_path.velocity(stamps), imu.gyro, zero, zero,
            0.0, calibration,
        )  # fmt: skip

    return make
