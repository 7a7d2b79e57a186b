"""Predicted positions of features in the image: where optical flow starts."""

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.neighbour_kernel import NEAREST, nearest_medians_compiled
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray


def predict_pixels(
    xy_before: FloatArray, p_before: FloatArray, T_now_before: FloatArray, camera: Camera
) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) now of static points, and their depth (N,) in metres, NaN where unknown.

    `xy_before` (N, 2): normalized coordinates; `p_before` (N, 3): positions in the camera's frame
    of before, metres. A point without one is taken as infinitely far, so that the rotation alone
    moves it. NaN for pixels outside the camera model.
    """
    ray = np.concatenate([xy_before, np.ones((len(xy_before), 1))], axis=1)
    far = ray @ T_now_before[:3, :3].T
    near = se3.apply(T_now_before, p_before)
    usable = np.isfinite(near[:, 2]) & (near[:, 2] > 0.2)
    point = np.where(usable[:, None], near, far)
    return camera.project(point), np.where(usable, near[:, 2], np.nan)


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


def flow_nearby(
    uv: FloatArray, static_uv: FloatArray, found: FloatArray, ok: BoolArray, least_px: float
) -> FloatArray:
    """Where lost points would be, had they moved as the movers around them: (N, 2), else NaN.

    `found` (N, 2) of the points `uv` (N, 2) that are `ok` (N,), against `static_uv` (N, 2), all in
    pixels. Movers are those that are more than `least_px` from where they would be if static.
    """
    start = np.full(uv.shape, np.nan)
    extra = found - static_uv
    with np.errstate(invalid="ignore"):
        moves = np.flatnonzero(ok & (np.linalg.norm(extra, axis=1) > least_px))
    lost = np.flatnonzero(~ok)
    if len(moves) < NEAREST or len(lost) == 0:
        return start
    start[lost] = static_uv[lost] + nearest_medians_compiled(uv[moves], extra[moves], uv[lost])
    return start


def fill_depths(uv: FloatArray, depth: FloatArray, default: float) -> FloatArray:
    """Depths (N,), metres, with unknown ones taken from the median of the nearest known pixels.

    `default` where too few are known.
    """
    known = np.flatnonzero(np.isfinite(depth))
    unknown = np.flatnonzero(~np.isfinite(depth))
    if len(unknown) == 0:
        return depth
    out = depth.copy()
    if len(known) < NEAREST:
        out[unknown] = default
        return out
    medians = nearest_medians_compiled(uv[known], depth[known, None], uv[unknown])
    out[unknown] = medians[:, 0]
    return out


def at_depths_nearby(uv: FloatArray, xy: FloatArray, p_cam: FloatArray) -> FloatArray:
    """The points (N, 3), metres, with unknown ones on their rays at the depths around them.

    `uv` (N, 2) pixels, `xy` (N, 2) normalized coordinates. Still NaN where too few are known.
    """
    depth = fill_depths(uv, p_cam[:, 2], np.nan)
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    return np.where(np.isfinite(p_cam), p_cam, ray * depth[:, None])


def predict_right(xy_left: FloatArray, depth: FloatArray, rig: StereoRig) -> FloatArray:
    """Right pixels (N, 2) of left normalized coordinates (N, 2) at given depths (N,), metres."""
    ray = np.concatenate([xy_left, np.ones((len(xy_left), 1))], axis=1)
    return rig.cam1.project(se3.apply(rig.T_cam1_cam0, ray * depth[:, None]))


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
    ray = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    known = np.isfinite(p_before[:, 2:])
    now = np.where(known, se3.apply(T_now_before, p_before), ray @ T_now_before[:3, :3].T)
    in_front = now[:, 2] > 0.0
    if not in_front.any():
        return 0.0
    way = now[in_front, :2] / now[in_front, 2:] - xy[in_front]
    return float(camera.fx * np.median(np.hypot(way[:, 0], way[:, 1])))
