"""Overlay of the stereo gate: which matches the extrinsics accept, and their epipolar lines."""

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.outputs import drawing, palette
from ovmot.types import StereoFrame, StereoMatches

_OUTLIER_REACH_PX = 60.0
_INLIER_REACH_PX = 15.0
_SAMPLES = 13  # along a line, which the distortion bends into a curve


def draw_stereo(
    frame: StereoFrame, matches: StereoMatches, rig: StereoRig, seconds: float, scale: float = 1.0
) -> Image:
    """Left and right image side by side with every stereo match tested (BGR); the left one alone
    where there is no other.

    Accepted points are blue, refused ones red, in both images. In the right one each point has
    its epipolar line in red (full and bright for the refused, short and dark for the accepted)
    and its distance to that line, pixels, in green, where there is room for it: first those of the
    refused. `seconds` is the frame's time since the start. Pixels are enlarged by `scale`.
    """
    left = drawing.backdrop(frame.left, scale)
    if frame.right is None:
        drawing.caption(left, [(f"{seconds:.1f} s", palette.WHITE)])
        return left
    right = drawing.backdrop(frame.right, scale)
    p_left, p_right = matches.pixels[:, :2], matches.pixels[:, 2:]
    good, bad = matches.accepted, ~matches.accepted
    for which, reach, color in (
        (good, _INLIER_REACH_PX, palette.DARK_RED),
        (bad, _OUTLIER_REACH_PX, palette.RED),
    ):
        curves = epipolar_curves(p_right[which], matches.line[which], rig.cam1, reach)
        drawing.curves(right, curves, color, scale)
    for which, color in ((good, palette.BLUE), (bad, palette.RED)):
        drawing.dots(left, p_left[which], color, scale)
        drawing.dots(right, p_right[which], color, scale)
    farthest = np.argsort(-np.nan_to_num(matches.distance_px))  # these get the room there is
    words = ["" if np.isnan(d) else f"{d:.1f}" for d in matches.distance_px[farthest].tolist()]
    drawing.texts(right, p_right[farthest], words, palette.GREEN, scale, reach=0)
    drawing.caption(
        left,
        [
            (f"{seconds:.1f} s", palette.WHITE),
            (f"{np.count_nonzero(good)} accepted", palette.BLUE),
            (f"{np.count_nonzero(bad)} refused", palette.RED),
        ],
    )
    drawing.caption(right, [("line", palette.RED), ("distance px", palette.GREEN)])
    return np.hstack([left, right])


def epipolar_curves(
    pixels: FloatArray, line: FloatArray, camera: Camera, reach_px: float
) -> FloatArray:
    """The stretch of each epipolar line nearest to its point, as pixels (N, K, 2) of the image.

    `pixels` (N, 2) are the matched points, `line` (N, 3) holds a, b, c with a·x + b·y + c = 0 in
    the camera's undistorted plane; the stretch goes `reach_px` (in units of the focal length) to
    both sides of the point's foot on the line. NaN where a pixel has no undistorted position.
    """
    xy = camera.normalize(pixels)
    length = np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    normal = line[:, :2] / np.where(length > 0.0, length, np.nan)
    offset = line[:, 2:] / np.where(length > 0.0, length, np.nan)
    foot = xy - (np.sum(normal * xy, axis=1, keepdims=True) + offset) * normal
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    steps = np.linspace(-reach_px, reach_px, _SAMPLES) / camera.fx
    return camera.denormalize(foot[:, None, :] + steps[None, :, None] * along[:, None, :])
