"""`objects_kitti.txt`: the tracks in the format of KITTI's tracking benchmark.

A row is frame, track id, type, truncated, occluded, alpha, box in the left image (left, top, right,
bottom; pixels), height, width, length (m), x, y, z (m), rotation_y (rad), score. x, y, z is the
middle of the body's bottom in the left camera's coordinates (x right, y down, z forward);
rotation_y turns about the camera's y axis, 0 along x; alpha is rotation_y less the direction in
which the body is seen (A. Geiger et al., "Are we ready for autonomous driving?", CVPR 2012).
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.rows import RowFile, format_rows
from ovmot.types import FrameResult, ObjectTrack

_TYPES = ("Pedestrian", "Cyclist", "Car")  # of walkers, cyclists, vehicles

Row = tuple[int | float | str, ...]


class KittiTracks:
    """Confirmed tracks, one row per track and frame; a track without a measurement is left out.

    Truncated and occluded are -1: the geometry does not give them. The type is that of the most
    probable class of motion, `Pedestrian`, `Cyclist` or `Car`, else `Misc`; the score is the number
    of points seen of the body.
    """

    _row = "%d %d %s -1 -1 %.6f" + " %.2f" * 4 + " %.4f" * 6 + " %.6f %d"

    def __init__(self, path: Path, camera: Camera, frame_number: Mapping[int, int]) -> None:
        """`camera` is the left one; `frame_number` has every stamp (ns) that will be written."""
        self._file = RowFile(path)
        self._camera = camera
        self._frame_number = frame_number

    def write(self, result: FrameResult) -> None:
        ego = result.ego
        T_cam0_world = se3.inverse(ego.T_world_imu @ ego.T_imu_cam0)
        shown = [track for track in result.tracks if track.state == "confirmed"]
        rows = [kitti_row(track, T_cam0_world, self._camera) for track in shown]
        number = self._frame_number[result.timestamp_ns] if shown else -1
        self._file.append(format_rows(self._row, [(number, *row) for row in rows if row]))

    def close(self) -> None:
        self._file.close()


def kitti_row(track: ObjectTrack, T_cam0_world: FloatArray, camera: Camera) -> Row | None:
    """The fields of a track but the frame, truncated and occluded; None for one out of the image.

    `T_cam0_world` (4, 4) maps the world, z up, into the left camera.
    """
    edge = np.array([camera.width, camera.height] * 2) - 0.5
    box = np.clip(track.box_px, -0.5, edge)
    if not np.all(box[2:] > box[:2]):  # also where it is NaN
        return None
    length, width, height = track.size.tolist()
    bottom = se3.apply(T_cam0_world, track.position - np.array([0.0, 0.0, 0.5 * height]))
    along = T_cam0_world[:3, :3] @ np.array([np.cos(track.yaw), np.sin(track.yaw), 0.0])
    rotation_y = float(np.arctan2(-along[2], along[0]))
    alpha = rotation_y - float(np.arctan2(bottom[0], bottom[2]))
    alpha = float(np.arctan2(np.sin(alpha), np.cos(alpha)))
    return (
        track.track_id, _kind(track), alpha, *box.tolist(), height, width, length,
        *bottom.tolist(), rotation_y, track.n_points,
    )  # fmt: skip


def _kind(track: ObjectTrack) -> str:
    """The type of the most probable class of motion."""
    probability = track.class_probability
    return _TYPES[int(np.argmax(probability))] if np.all(np.isfinite(probability)) else "Misc"
