"""A rig whose right camera is rolled, and results of frames made by hand."""

import resource
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.types import (
    CalibrationEstimate,
    EgoEstimate,
    FrameResult,
    Health,
    ObjectTrack,
    PointLabel,
    ScenePoints,
    StereoFrame,
    StereoMatches,
)

NAN = float("nan")
WIDTH, HEIGHT = 240, 160


@pytest.fixture
def rig() -> StereoRig:
    """Barrel-distorted cameras, 0.3 m apart, the right one rolled by 30 degrees."""
    camera = Camera.make(
        (WIDTH, HEIGHT), (150.0, 155.0), (121.0, 79.0), "radtan", [-0.2, 0.05, 1e-3, -5e-4]
    )
    roll = so3.exp(np.array([0.0, 0.0, np.pi / 6]))
    return StereoRig(
        camera, camera, np.eye(4), se3.make(roll, np.array([0.3, 0.02, 0.0]))
    )  # fmt: skip


@pytest.fixture
def make_result() -> Callable[[int], FrameResult]:
    """A function from a stamp (ns) to a result: four points, two matches, one track."""
    return _result


@pytest.fixture
def full_disk() -> Callable[[int], AbstractContextManager[None]]:
    """A context in which no file may grow beyond so many bytes, as if the disk were full."""
    return _full_disk


@contextmanager
def _full_disk(n_bytes: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def _result(timestamp_ns: int) -> FrameResult:
    grey = np.full((HEIGHT, WIDTH), 40, dtype=np.uint8)
    frame = StereoFrame(timestamp_ns, grey, grey)
    return FrameResult(
        frame, _ego(timestamp_ns), _points(), _matches(), (_track(),), {"match": 1.25, "split": 2.0}
    )


def _ego(timestamp_ns: int) -> EgoEstimate:
    turn = so3.exp(np.array([0.0, 0.0, 1.5 * np.pi]))  # beyond pi: w would be negative
    return EgoEstimate(
        timestamp_ns=timestamp_ns,
        T_world_imu=se3.make(turn, np.array([1.0, -2.5, 0.125])),
        velocity=np.array([3.0, 0.0, -1.0]),
        gyro_bias=np.array([0.001, 0.002, 0.003]),
        accel_bias=np.array([NAN, NAN, NAN]),
        covariance=np.diag([*(k * 0.01**2 for k in (1.0, 4.0, 9.0)), *([0.04] * 9), *([NAN] * 3)]),
        T_imu_cam0=se3.make(np.eye(3), np.array([0.1, 0.2, 0.3])),
        T_imu_cam1=se3.make(np.eye(3), np.array([0.4, 0.5, 0.6])),
        time_offset_s=-0.0015,
        time_offset_std_s=0.0005,
        standing=True,
        health=Health.DEGRADED,
        calibration=CalibrationEstimate(
            ("cam0_pose_rx", "cam0_lens_fx"), np.array([0.01, -2.5]), np.array([0.001, 0.5])
        ),
    )


def _points() -> ScenePoints:
    """A dynamic point, a static one that RANSAC rejected, a static one, an unknown one."""
    return ScenePoints(
        feature_id=np.array([7, 8, 9, 10]),
        pixels=np.array([[60.0, 60, 50.0625, 60], [60, 120, 55, 120], [180, 60, 170, 60],
                         [180.1234, 120, NAN, NAN]]),
        p_cam0=np.array([[1.0, 2.0, 3.5], [0.0, 1.0, 9.0], [-1.0, 0.25, 20.0], [NAN, NAN, NAN]]),
        cov_cam0=np.zeros((4, 3, 3)),
        label=np.array(
            [PointLabel.DYNAMIC, PointLabel.STATIC, PointLabel.STATIC, PointLabel.UNKNOWN]
        ),
        track_id=np.array([3, -1, -1, -1]),
        previous=np.array([[40.0, 70], [40, 130], [179, 61], [NAN, NAN]]),
        predicted=np.array([[70.0, 75], [66, 130], [180, 60], [NAN, NAN]]),
        distance_m=np.array([0.52, 0.04, 0.01, NAN]),
        reprojection_px=np.array([8.1, 1.2, 0.1, NAN]),
        two_view_inlier=np.array([False, False, True, True]),
    )  # fmt: skip


def _matches() -> StereoMatches:
    """One accepted and one refused match, with horizontal lines near their right points."""
    return StereoMatches(
        feature_id=np.array([7, 11]),
        pixels=np.array([[60.0, 60.0, 100.0, 70.0], [200.0, 130.0, 120.0, 120.0]]),
        distance_px=np.array([0.25, 4.5]),
        accepted=np.array([True, False]),
        line=np.array([[0.0, 1.0, 0.06], [0.0, 2.0, -0.6]]),
    )


def _track() -> ObjectTrack:
    return ObjectTrack(
        track_id=3, state="confirmed", position=np.array([10.0, 1.5, 0.5]),
        velocity=np.array([-4.0, 0.25, 0.0]), yaw=0.1, yaw_rate=NAN,
        size=np.array([4.0, 1.75, 1.5]), box_px=np.array([50.0, 40.0, 90.5, 80.0]), n_points=12,
        std_position=np.array([0.1, 0.2, 0.3]), std_velocity=np.array([0.4, 0.5, NAN]),
        class_probability=np.array([0.125, 0.25, 0.625]),
    )  # fmt: skip
