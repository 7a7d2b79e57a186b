"""A frame result with everything in it, made by hand."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.types import (
    EgoEstimate,
    FrameResult,
    ObjectTrack,
    PointLabel,
    ScenePoints,
    StereoFrame,
    StereoMatches,
)

STAMP_NS = 1_700_000_000_123_456_789


def make_ego(T_world_imu: np.ndarray, velocity: np.ndarray) -> EgoEstimate:
    root = np.random.default_rng(3).normal(size=(15, 15))
    return EgoEstimate(
        timestamp_ns=STAMP_NS,
        T_world_imu=T_world_imu,
        velocity=velocity,
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        covariance=1e-4 * root @ root.T,
        T_imu_cam0=se3.make(so3.exp(np.array([-1.2, 1.1, -1.2])), np.array([0.1, 0.2, 0.3])),
        T_imu_cam1=se3.make(so3.exp(np.array([-1.2, 1.1, -1.2])), np.array([0.1, -0.2, 0.3])),
        time_offset_s=0.0,
        time_offset_std_s=0.001,
        standing=False,
    )


def make_track(track_id: int, state: str) -> ObjectTrack:
    return ObjectTrack(
        track_id=track_id,
        state=state,
        position=np.array([10.0, 2.0 + track_id, 0.5]),
        velocity=np.array([3.0, 4.0, 0.0]),
        yaw=0.3,
        yaw_rate=float("nan"),
        size=np.array([4.0, 1.8, 1.5]),
        box_px=np.array([10.0, 20.0, 50.0, 60.0]),
        n_points=12,
        std_position=np.array([0.1, 0.2, 0.3]),
        std_velocity=np.array([0.4, 0.5, 0.6]),
    )


@pytest.fixture
def result() -> FrameResult:
    labels = (PointLabel.STATIC, PointLabel.DYNAMIC, PointLabel.UNKNOWN, PointLabel.STATIC)
    n = len(labels)
    p_cam0 = np.array([[0.0, 0.0, 5.0], [1.0, 0.5, 8.0], [2.0, 1.0, 9.0], [np.nan] * 3])
    image = np.zeros((40, 60), dtype=np.uint8)
    return FrameResult(
        frame=StereoFrame(STAMP_NS, image, image),
        ego=make_ego(
            se3.make(so3.exp(np.array([0.1, -0.2, 0.7])), np.array([1.0, 2.0, 3.0])),
            np.array([5.0, 1.0, -0.2]),
        ),
        points=ScenePoints(
            feature_id=np.arange(100, 100 + n),
            pixels=np.full((n, 4), 10.0),
            p_cam0=p_cam0,
            cov_cam0=np.full((n, 3, 3), 0.01),
            label=np.array(labels, dtype=np.int64),
            track_id=np.array([-1, 7, -1, -1]),
            previous=np.zeros((n, 2)),
            predicted=np.zeros((n, 2)),
            distance_m=np.zeros(n),
            reprojection_px=np.zeros(n),
            two_view_inlier=np.ones(n, dtype=bool),
        ),
        matches=StereoMatches(
            feature_id=np.arange(0),
            pixels=np.zeros((0, 4)),
            distance_px=np.zeros(0),
            accepted=np.zeros(0, dtype=bool),
            line=np.zeros((0, 3)),
        ),
        tracks=(make_track(7, "confirmed"), make_track(8, "coasting"), make_track(9, "tentative")),
        milliseconds={},
    )


@pytest.fixture
def rig_of_result(result: FrameResult) -> StereoRig:
    """The rig that the result was made with; nothing of it is estimated."""
    camera = Camera.make((60, 40), (50.0, 50.0), (30.0, 20.0), "none", [])
    return StereoRig(camera, camera, result.ego.T_imu_cam0, result.ego.T_imu_cam1)
