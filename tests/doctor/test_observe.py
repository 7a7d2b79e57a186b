"""Which frames are looked at, and how the camera turns between them."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.doctor.observe import STRETCH_FRAMES, FrameMatches, choose_stretches, rotation_of_rays
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuData

FRAME_NS = 100_000_000 * np.arange(900, dtype=np.int64)


def test_a_short_sequence_is_taken_whole() -> None:
    assert choose_stretches(FRAME_NS[:90], None) == [(0, 89)]
    assert choose_stretches(FRAME_NS[:1], None) == [(0, 0)]


def test_each_third_gives_the_stretch_that_turns() -> None:
    ns = 10_000_000 * np.arange(9000, dtype=np.int64)
    gyro = np.zeros((9000, 3))
    gyro[2000:2300, 2] = np.sin(0.1 * np.arange(300))  # frames 200 to 230
    stretches = choose_stretches(FRAME_NS, ImuData(ns, gyro, gyro))
    assert all(last - first + 1 == STRETCH_FRAMES for first, last in stretches)
    assert [first // 300 for first, _ in stretches] == [0, 1, 2]
    assert abs(stretches[0][0] - 200) < 15


def test_rotation_of_rays_bears_outliers() -> None:
    rng = np.random.default_rng(0)
    R = so3.exp(np.array([0.02, -0.05, 0.03]))
    before = rng.uniform(-0.6, 0.6, (200, 2))
    ray = np.concatenate([before, np.ones((200, 1))], axis=1) @ R.T
    now = ray[:, :2] / ray[:, 2:]
    now[:40] += rng.uniform(-0.2, 0.2, (40, 2))
    off = so3.log(rotation_of_rays(before, now) @ R.T)
    assert float(np.linalg.norm(off)) < 2e-3


def seen(rig: StereoRig, p: FloatArray, stamp_ns: int) -> FrameMatches:
    right = rig.cam1.project(se3.apply(rig.T_cam1_cam0, p))
    pixels = np.concatenate([rig.cam0.project(p), right], axis=1)
    return FrameMatches(stamp_ns, np.arange(len(p)), pixels)
