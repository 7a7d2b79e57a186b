"""How the left camera turns from frame to frame, by its stereo matches."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.doctor.observe import LEAST_POINTS, FrameMatches, rotation_of_rays
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import StereoMotion, solve_stereo_motion
from ovmot.geometry.triangulation import triangulate_stereo

_PIXEL_SIGMA = 0.5
_ROTATION_SIGMAS = (0.004, 0.02)  # rad: how far the rays mislead, by and large and at most


@dataclass(frozen=True, slots=True)
class CameraRotations:
    """Rotations of the left camera between N pairs of consecutive frames.

    `start_ns`, `end_ns` (N,): stamps of the two frames; `rotation` (N, 3): rotation vector in rad
    of the camera in its own axes, `translation` (N, 3), m: where it goes, in its axes at the start;
    NaN where the images do not tell them.
    """

    start_ns: IntArray
    end_ns: IntArray
    rotation: FloatArray
    translation: FloatArray

    def rows(self, index: IntArray) -> "CameraRotations":
        """Those of the pairs `index`."""
        return CameraRotations(
            self.start_ns[index], self.end_ns[index], self.rotation[index], self.translation[index]
        )


def camera_rotations(
    stretches: Sequence[Sequence[FrameMatches]], rig: StereoRig
) -> CameraRotations:
    """The turns within each stretch, the matches taken by this rig."""
    pairs = [pair for stretch in stretches for pair in pairwise(stretch)]
    motions = np.array([camera_motion(*pair, rig) for pair in pairs]).reshape(-1, 6)
    return CameraRotations(
        np.array([before.timestamp_ns for before, _ in pairs], dtype=np.int64),
        np.array([now.timestamp_ns for _, now in pairs], dtype=np.int64),
        motions[:, :3],
        motions[:, 3:],
    )


def camera_motion(before: FrameMatches, now: FrameMatches, rig: StereoRig) -> FloatArray:
    """Rotation vector, rad, and translation, m, (6,) of the left camera in its axes before.

    NaN where unknown.

    The far half of the points gives the rotation roughly, all of them together with the
    translation give it well.
    """
    _, i, j = np.intersect1d(before.feature_id, now.feature_id, return_indices=True)
    old, new = (rig.normalize(pixels) for pixels in (before.pixels[i], now.pixels[j]))
    depth = triangulate_stereo(old, rig.T_cam1_cam0)[:, 2]
    usable = np.isfinite(depth) & np.isfinite(new).all(axis=1)
    if usable.sum() < LEAST_POINTS:
        return np.full(6, np.nan)
    old, new, depth = old[usable], new[usable], depth[usable]
    far = depth >= np.median(depth)
    rough = rotation_of_rays(old[far, :2], new[far, :2])
    sigma = rig.normalized_sigma(_PIXEL_SIGMA)
    best: StereoMotion | None = None
    # a wide gate lets a passing body in, a narrow one may leave the scene out
    for rotation_sigma in _ROTATION_SIGMAS:
        motion = solve_stereo_motion(old, new, rig.T_cam1_cam0, rough, sigma, rotation_sigma)
        if motion is not None and (best is None or motion.inlier.sum() > best.inlier.sum()):
            best = motion
        if best is not None and best.inlier.sum() > 0.5 * len(old):
            break
    if best is None:
        return np.full(6, np.nan)
    T_before_now = se3.inverse(best.T_now_before)
    return np.concatenate([so3.log(T_before_now[:3, :3]), T_before_now[:3, 3]])
