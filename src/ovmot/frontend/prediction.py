"""Predicted positions of features in the image: where optical flow starts."""

from typing import NamedTuple

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.lens_kernel import packed_camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.prediction_kernel import (
    median_flow_compiled,
    predict_matches_compiled,
    predict_tracks_compiled,
)
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray


class Predicted(NamedTuple):
    """Where N features will be seen: pixels (N, 2) if they are at rest, and where to search first;
    depths (N,), metres, NaN where unknown; which of them move on their own (N,)."""

    static_uv: FloatArray
    start: FloatArray
    depth: FloatArray
    moves: BoolArray


def predict_tracks(
    uv: FloatArray,
    xy: FloatArray,
    p_before: FloatArray,
    p_predicted: FloatArray,
    extra_flow: FloatArray,
    T_now_before: FloatArray,
    camera: Camera,
) -> Predicted:
    """Features with pixels `uv` and normalized coordinates `xy` (N, 2) in the next image.

    `p_before`, `p_predicted` (N, 3): positions in the camera's frame of before, metres, NaN where
    unknown, then and now; where they differ, the feature moves on its own. One that does not is
    sought `extra_flow` (N, 2) pixels beyond where it would be at rest. Without a position it is
    taken at the depth of those around it, else as infinitely far, so that the rotation alone moves
    it. NaN for pixels outside the camera model.
    """
    return Predicted(
        *predict_tracks_compiled(
            uv, xy, p_before, p_predicted, extra_flow,
            np.ascontiguousarray(T_now_before), *packed_camera(camera),
        )
    )  # fmt: skip


def unexplained_flow(
    found: FloatArray, static_uv: FloatArray, explained: BoolArray, most_px: float
) -> FloatArray:
    """Image motion (N, 2) in pixels beyond that of a static point, predicted for the next image.

    `found`, `static_uv` (N, 2): where the points are, and where static ones would be. Zero for
    points that the two-view test explains (N,), and beyond `most_px`: a mismatch.
    """
    extra = found - static_uv
    size = np.linalg.norm(extra, axis=1)
    predicted = ~explained & np.isfinite(size) & (size < most_px)
    return np.where(predicted[:, None], extra, 0.0)


def predict_right(
    uv_left: FloatArray, xy_left: FloatArray, depth: FloatArray, default: float, rig: StereoRig
) -> FloatArray:
    """Right pixels (N, 2) of left pixels and normalized coordinates (N, 2) at depths (N,), metres.

    An unknown depth is the median of those of the nearest pixels, `default` where too few are
    known.
    """
    start: FloatArray = predict_matches_compiled(
        uv_left, xy_left, depth, default, rig.T_cam1_cam0, *packed_camera(rig.cam1)
    )
    return start


def motion_of_right(T_now_before: FloatArray, rig: StereoRig) -> FloatArray:
    """The motion (4, 4) of the right camera, by that of the left one."""
    motion: FloatArray = rig.T_cam1_cam0 @ T_now_before @ se3.inverse(rig.T_cam1_cam0)
    return motion


def median_flow_px(
    xy: FloatArray, p_before: FloatArray, T_now_before: FloatArray, camera: Camera
) -> float:
    """How far static points move in the image, pixels, in the median; 0 of none.

    `xy` (N, 2): normalized coordinates; `p_before` (N, 3): positions in the camera of before,
    metres, NaN where unknown: those are moved by the rotation alone.
    """
    T = np.ascontiguousarray(T_now_before)
    return float(camera.fx * median_flow_compiled(xy, p_before, T))
