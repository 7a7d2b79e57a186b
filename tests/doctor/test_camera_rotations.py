"""How the camera turns between frames."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.doctor.camera_rotations import camera_rotations
from ovmot.doctor.observe import FrameMatches
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray


def seen(rig: StereoRig, p: FloatArray, stamp_ns: int) -> FrameMatches:
    right = rig.cam1.project(se3.apply(rig.T_cam1_cam0, p))
    pixels = np.concatenate([rig.cam0.project(p), right], axis=1)
    return FrameMatches(stamp_ns, np.arange(len(p)), pixels)


def test_turns_are_those_of_the_camera(painted_rig: StereoRig) -> None:
    """The camera turns about its own axes while it drives on; the last pair shares no feature."""
    rng = np.random.default_rng(1)
    depth = rng.uniform(4.0, 40.0, (150, 1))
    p = np.concatenate([rng.uniform(-0.5, 0.5, (150, 2)), np.ones((150, 1))], axis=1) * depth
    rotation = np.array([0.01, 0.04, -0.02])
    T_before_now = se3.make(so3.exp(rotation), np.array([0.05, 0.0, 0.8]))
    q = se3.apply(se3.inverse(T_before_now), p)
    first, second = seen(painted_rig, p, 0), seen(painted_rig, q, 10**8)
    others = FrameMatches(2 * 10**8, second.feature_id + 1000, second.pixels)
    turns = camera_rotations([[first, second, others]], painted_rig)
    np.testing.assert_allclose(turns.rotation[0], rotation, atol=1e-4)
    np.testing.assert_allclose(turns.translation[0], [0.05, 0.0, 0.8], atol=1e-3)
    assert np.isnan(turns.rotation[1]).all()
    assert np.isnan(turns.translation[1]).all()
    assert turns.end_ns.tolist() == [10**8, 2 * 10**8]
