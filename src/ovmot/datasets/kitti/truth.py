"""Truth of KITTI tracking and odometry: the rig's poses, and the labels of objects.

Poses are OXTS packets (`oxts/<sequence>.txt` of tracking), else matrices T_world_cam of the left
camera, a row a frame (`poses/<sequence>.txt`). Labels: A. Geiger et al., "Are we ready for
autonomous driving? The KITTI vision benchmark suite", CVPR 2012, and the tracking benchmark's
development kit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.datasets.images import image_size
from ovmot.datasets.kitti.calibration import (
    read_keyed_numbers,
    read_kitti_calibration,
    rectified_camera,
)
from ovmot.datasets.kitti.reader import Layout, frame_stamps, layout_of
from ovmot.datasets.kitti_raw.oxts import read_rows, true_poses
from ovmot.datasets.pose_files import (
    R_WORLD_CAMERA_AXES,
    Trajectory,
    interpolate_poses,
    read_kitti_poses,
)
from ovmot.datasets.truth import EgoTruth, ImageRules, ObjectTruth, TrueObjects
from ovmot.errors import DatasetError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.text_files import read_text

EVALUATED = ("Car", "Pedestrian")
"""The classes that the benchmark evaluates; what else moves is neither hit nor miss."""
MAX_OCCLUSION, MAX_TRUNCATION, MIN_HEIGHT_PX = 2, 0, 25.0
"""Of its development kit: beyond, an object need not be found; smaller tracks are not counted."""

_DONT_CARE = "DontCare"
_COLUMNS = 17
_HALF_WINDOW = 5  # frames, half a second: over it a label's velocity is a line's slope


def kitti_truth(root: Path, sequence: str | None) -> EgoTruth | None:
    """The IMU's poses (that of the calibration) at the frames, None where there are none."""
    layout = layout_of(root, sequence)
    packets = layout.folder / "oxts" / f"{layout.name}.txt"
    if packets.is_file():
        values = read_rows(packets)
        return true_poses(packets, frame_stamps(layout, np.arange(len(values))), values)
    folders = (layout.folder, *layout.folder.resolve().parents[:2])
    found = (folder / "poses" / f"{layout.name}.txt" for folder in folders)
    path = next((file for file in found if file.is_file()), None)
    if path is None:
        return None
    T_turn = se3.make(R_WORLD_CAMERA_AXES, np.zeros(3))
    T_world_cam0 = T_turn @ read_kitti_poses(path)
    T_imu_cam0 = _calibration(layout)
    stamps = frame_stamps(layout, np.arange(len(T_world_cam0)))
    return EgoTruth(path, stamps, T_world_cam0 @ se3.inverse(T_imu_cam0))


@dataclass(frozen=True, slots=True)
class _Labels:
    """The L labels of a sequence: frame, track, class, how far cut off and hidden; the box in the
    left image (L, 4), and in space: size (L, 3) as length, width, height, the middle of its bottom
    (L, 3) and the turn about the vertical (L,) in rectified camera 0."""

    frame: IntArray
    track: IntArray
    category: tuple[str, ...]
    truncation: IntArray
    occlusion: IntArray
    box: FloatArray
    size: FloatArray
    bottom: FloatArray
    turn: FloatArray


def kitti_objects(root: Path, sequence: str | None, ego: EgoTruth) -> ObjectTruth | None:
    """The labelled objects in the world of `ego`; None where the sequence has no labels.

    Velocities and yaw rates are slopes over a second of labels; an object of one label has none
    (NaN). Raises `DatasetError` with the row for what is no label.
    """
    layout = layout_of(root, sequence)
    path = layout.folder / "label_02" / f"{layout.name}.txt"
    if not path.is_file():
        return None
    labels = _read_labels(path)
    size = image_size(next(iter(sorted(layout.images[0].iterdir()))))
    calibration = read_kitti_calibration(layout.calibration, layout.left, size)
    T_imu_cam0 = calibration.rig.T_imu_cam0
    _, T_rect_cam0 = rectified_camera(read_keyed_numbers(layout.calibration), "P2", size)
    frames = np.unique(labels.frame)
    stamps = dict(zip(frames.tolist(), frame_stamps(layout, frames).tolist(), strict=True))
    regions = {
        stamp: labels.box[(labels.frame == frame) & _of(labels, (_DONT_CARE,))]
        for frame, stamp in stamps.items()
    }
    rules = ImageRules(calibration.rig.cam0, se3.inverse(T_imu_cam0), MIN_HEIGHT_PX, regions)
    T_imu_rect = T_imu_cam0 @ se3.inverse(T_rect_cam0)
    return ObjectTruth(path.parent, _true_objects(labels, stamps, ego, T_imu_rect), False, rules)


def _true_objects(
    labels: _Labels, stamps: dict[int, int], ego: EgoTruth, T_imu_rect: FloatArray
) -> dict[int, TrueObjects]:
    """The objects of each frame for which there is a pose, by its stamp."""
    label_ns = np.array([stamps[frame] for frame in labels.frame.tolist()], dtype=np.int64)
    poses = interpolate_poses(Trajectory(ego.timestamp_ns, ego.T_world_imu), label_ns)
    T_world_rect = poses @ T_imu_rect
    middle = labels.bottom - 0.5 * labels.size[:, 2:] * [0.0, 1.0, 0.0]
    center = np.einsum("nij,nj->ni", T_world_rect[:, :3, :3], middle) + T_world_rect[:, :3, 3]
    ahead = np.stack([np.cos(labels.turn), np.zeros(len(labels.turn)), -np.sin(labels.turn)], -1)
    forward = np.einsum("nij,nj->ni", T_world_rect[:, :3, :3], ahead)
    yaw = np.arctan2(forward[:, 1], forward[:, 0])
    real = ~_of(labels, (_DONT_CARE,)) & np.isfinite(center).all(axis=1)
    velocity, yaw_rate = np.full((len(yaw), 3), np.nan), np.full(len(yaw), np.nan)
    for track in np.unique(labels.track[real]).tolist():
        rows = np.flatnonzero(real & (labels.track == track))
        columns = np.column_stack([center[rows], np.unwrap(yaw[rows])])
        slopes = _slopes(label_ns[rows], labels.frame[rows], columns)
        velocity[rows], yaw_rate[rows] = slopes[:, :3], slopes[:, 3]
    counts = _of(labels, EVALUATED) & (labels.occlusion <= MAX_OCCLUSION)
    counts &= labels.truncation <= MAX_TRUNCATION
    area = np.prod(labels.box[:, 2:] - labels.box[:, :2], axis=1)
    out = {}
    for frame, stamp in stamps.items():
        rows = np.flatnonzero(real & (labels.frame == frame))
        out[stamp] = TrueObjects(
            stamp, labels.track[rows], center[rows], yaw[rows], labels.size[rows], velocity[rows],
            yaw_rate[rows], area[rows].astype(np.int64),
            tuple(labels.category[row] for row in rows), counts[rows],
        )  # fmt: skip
    return out


def _slopes(label_ns: IntArray, frame: IntArray, columns: FloatArray) -> FloatArray:
    """Slopes (N, K) of columns (N, K) of one object over the frames around each label."""
    out = np.full(columns.shape, np.nan)
    for i, now in enumerate(frame.tolist()):
        near = np.abs(frame - now) <= _HALF_WINDOW
        if near.sum() < 2:
            continue
        t = (label_ns[near] - label_ns[i]) * 1e-9
        t = t - t.mean()
        out[i] = t @ (columns[near] - columns[near].mean(axis=0)) / (t @ t)
    return out


def _of(labels: _Labels, categories: Sequence[str]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.array([category in categories for category in labels.category], dtype=np.bool_)


def _read_labels(path: Path) -> _Labels:
    """Rows of 17 columns: frame, track, class, and 14 numbers."""
    rows: list[list[str]] = []
    remedy = "copy the file again"
    for number, line in enumerate(read_text(path, DatasetError).splitlines(), start=1):
        fields = line.split()
        if not fields:
            continue
        if len(fields) < _COLUMNS:
            problem = f"{len(fields)} columns where {_COLUMNS} are expected"
            raise DatasetError.at(path, problem, remedy, row=number)
        rows.append(fields[:_COLUMNS])
    try:
        numbers = np.array([row[:2] + row[3:] for row in rows], dtype=np.float64)
    except ValueError as error:
        raise DatasetError.at(path, f"cannot be read: {error}", remedy) from None
    numbers = numbers.reshape(-1, _COLUMNS - 1)
    if not np.all(np.isfinite(numbers)):
        raise DatasetError.at(path, "holds a number that is not finite", remedy)
    whole = numbers[:, :4].astype(np.int64)
    return _Labels(
        whole[:, 0], whole[:, 1], tuple(row[2] for row in rows), whole[:, 2], whole[:, 3],
        numbers[:, 5:9], numbers[:, [11, 10, 9]], numbers[:, 12:15], numbers[:, 15],
    )  # fmt: skip


def _calibration(layout: Layout) -> FloatArray:
    """T_imu_cam0 (4, 4) of the sequence's left camera."""
    size = image_size(next(iter(sorted(layout.images[0].iterdir()))))
    return read_kitti_calibration(layout.calibration, layout.left, size).rig.T_imu_cam0
