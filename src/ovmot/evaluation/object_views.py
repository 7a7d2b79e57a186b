"""What the rig could see of each true object: which of its sides, and whether it was whole in view.

From the truth alone: the objects' boxes, their visible pixels, and the pose of the rig.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.truth import TrueObjects
from ovmot.evaluation.matching import ComparedFrame
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.boxes import UNIT_CORNERS

SIDE_SHARE = 0.25
"""A side is seen that takes at least this share of the body's angle of view."""
WHOLE_SHARE = 0.8
"""Nothing hides a body that shows this share of what it shows at best, of its box's outline."""
_SAME_RAY = 1e-3


def two_sides_seen(
    frames: Sequence[ComparedFrame], in_view: Sequence[BoolArray]
) -> tuple[BoolArray, ...]:
    """Per frame, of which objects (N,) two neighbouring sides have been seen up to then.

    One of them is the front or the rear, the other the left or the right side; they need not be
    seen at the same time. A frame shows sides of those objects that are `in_view` (N,) in it.
    """
    ends: set[int] = set()
    flanks: set[int] = set()
    seen = []
    for frame, shown in zip(frames, in_view, strict=True):
        end, flank = visible_sides(frame.objects, frame.T_true[:2, 3])
        ids = frame.objects.object_id
        ends.update(ids[end & shown].tolist())
        flanks.update(ids[flank & shown].tolist())
        seen.append(np.isin(ids, list(ends & flanks)))
    return tuple(seen)


def visible_sides(objects: TrueObjects, eye: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Whether (N,) the front or the rear, and the left or the right side, face an `eye` (2,) m.

    A side counts that takes `SIDE_SHARE` of the angle under which the eye sees the whole box from
    above; none counts of a box around the eye.
    """
    away = eye - objects.center[:, :2]
    c, s = np.cos(objects.yaw), np.sin(objects.yaw)
    p = np.stack([c * away[:, 0] + s * away[:, 1], -s * away[:, 0] + c * away[:, 1]], axis=1)
    half = 0.5 * objects.size[:, :2]
    near = np.where(p < 0.0, -half, half)  # the corner that both sides before the eye share
    across = _angle(near - p, near * [1.0, -1.0] - p)
    along = _angle(near - p, near * [-1.0, 1.0] - p)
    outside = np.abs(p) > half
    end, flank = np.where(outside, np.stack([across, along], axis=1), 0.0).T
    whole = np.maximum(end + flank, 1e-9)
    return np.asarray(end >= SIDE_SHARE * whole), np.asarray(flank >= SIDE_SHARE * whole)


def whole_in_view(
    frames: Sequence[ComparedFrame], camera: Camera, T_cam0_imu: FloatArray
) -> tuple[BoolArray, ...]:
    """Per frame, which objects (N,) lie wholly in the left image with nothing before them.

    All corners of the box are in the image, and the visible pixels are `WHOLE_SHARE` of what the
    object shows at best, each time as a share of the outline of its box. So a body that something
    hides in all frames alike counts as whole.
    """
    shares = [_shown_share(frame, camera, T_cam0_imu) for frame in frames]
    best: dict[int, float] = {}
    for frame, share in zip(frames, shares, strict=True):
        for object_id, value in zip(frame.objects.object_id.tolist(), share, strict=True):
            best[object_id] = max(best.get(object_id, 0.0), float(value))
    whole = []
    for frame, share in zip(frames, shares, strict=True):
        ids = frame.objects.object_id.tolist()
        least = WHOLE_SHARE * np.array([best[object_id] for object_id in ids])
        whole.append(np.asarray((share > 0.0) & (share >= least)))
    return tuple(whole)


def _shown_share(frame: ComparedFrame, camera: Camera, T_cam0_imu: FloatArray) -> FloatArray:
    """Visible pixels (N,) as a share of the box's outline; 0 for one that the image's edge cuts."""
    objects = frame.objects
    T_cam0_world = T_cam0_imu @ se3.inverse(frame.T_true)
    turn = so3.exp(objects.yaw[:, None] * np.array([0.0, 0.0, 1.0]))
    corners = UNIT_CORNERS * objects.size[:, None, :]
    p_world = np.einsum("nij,nkj->nki", turn, corners) + objects.center[:, None, :]
    p = se3.apply(T_cam0_world, p_world.reshape(-1, 3)).reshape(p_world.shape)
    with np.errstate(all="ignore"):
        uv = camera.project(p)
        ray = p[..., :2] / p[..., 2:]
        same = np.abs(camera.normalize(uv) - ray).max(axis=2) < _SAME_RAY  # else the lens folds
        inside = np.all(camera.inside(uv) & same & (p[..., 2] > 0.0), axis=1)
    share = np.zeros(len(objects.object_id))
    for n in np.flatnonzero(inside):
        outline = cv2.convexHull(uv[n].astype(np.float32))
        share[n] = objects.visible_px[n] / max(cv2.contourArea(outline), 1.0)
    return share


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle (N,) between directions (N, 2), rad."""
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.asarray(np.abs(np.arctan2(cross, np.sum(a * b, axis=1))))
