"""The odometry of a feature-level simulation starts at the truth."""

from dataclasses import replace

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.known_state import InitialSigmas
from ovmot.settings import Settings
from ovmot.sim.feature_odometry import feature_odometry, known_state_initializer
from ovmot.sim.features import FeatureOptions, FeatureRecording, FeatureSimulation
from ovmot.sim.handheld import EUROC_NOISE, ORIGIN_NS, handheld_rig
from ovmot.sim.simulation import ImuModel


def straight() -> FeatureRecording:
    """Half a second at 2 m/s along x."""
    t = np.arange(-1.0, 2.0, 0.05)
    p = np.stack([2.0 * t, 0.0 * t, 0.0 * t], axis=-1)
    poses = se3.make(np.broadcast_to(np.eye(3), (len(t), 3, 3)), p)
    path = PoseSpline.through(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), poses)
    return FeatureRecording(
        FeatureSimulation(
            handheld_rig(), path, ORIGIN_NS + 100_000_000 * np.arange(5, dtype=np.int64),
            ImuModel(200.0, EUROC_NOISE, np.full(3, 2e-3), np.full(3, 3e-2)),
            FeatureOptions(n_features=60, pixel_sigma=0.3),
        ),
        1,
    )  # fmt: skip


def test_every_frame_has_a_result_near_the_truth() -> None:
    recording = straight()
    odometry = feature_odometry(recording, Settings())
    results = [result for event in recording.events() for result in odometry.add(event)]
    assert [result.timestamp_ns for result in results] == recording.truth().timestamp_ns.tolist()
    poses = np.array([result.T_world_imu[:3, 3] for result in results])
    np.testing.assert_allclose(poses, recording.truth().T_world_imu[:, :3, 3], atol=0.02)


def test_a_wrong_clock_starts_at_the_truth_of_its_time() -> None:
    """With 10 ms more, the first frame is where the rig is 10 ms later: 2 cm ahead."""
    recording = straight()
    right = handheld_rig()
    late = replace(right, time_offset_s=0.01)
    a, b = (
        known_state_initializer(recording, Settings(), InitialSigmas(), rig)
        for rig in (right, late)
    )
    np.testing.assert_allclose(b.imu.position - a.imu.position, [0.02, 0.0, 0.0], atol=1e-6)
    assert a.timestamp_ns == b.timestamp_ns
