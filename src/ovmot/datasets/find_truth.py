"""The truth of any data set: one door to the files of all formats."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ovmot.datasets.bag.file import bag_at
from ovmot.datasets.bag.truth import bag_truth
from ovmot.datasets.four_seasons.truth import four_seasons_truth
from ovmot.datasets.kaist.truth import kaist_truth
from ovmot.datasets.kitti.truth import kitti_objects, kitti_truth
from ovmot.datasets.kitti_raw.reader import kitti_raw_truth
from ovmot.datasets.registry import open_sequence, recognise
from ovmot.datasets.truth import (
    EgoTruth,
    ObjectTruth,
    read_ego_truth,
    read_object_truth,
    truth_file,
)
from ovmot.datasets.uzh_fpv.truth import uzh_fpv_truth
from ovmot.datasets.viode.truth import viode_truth
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuData

TRUTHS: dict[str, Callable[[Path, str | None], EgoTruth | None]] = {
    "kaist": kaist_truth,
    "kitti": kitti_truth,
    "kitti_raw": kitti_raw_truth,
    "viode": viode_truth,
    "uzh_fpv": uzh_fpv_truth,
    "4seasons": four_seasons_truth,
}
"""True poses of the formats that have them in a form of their own, beside `truth.TRUTH_FILES`."""

_ANY_WORLD = ("viode", "4seasons")
"""Formats whose world need not have z up: there the accelerometer tells where up is."""
_PLAINLY_DEG = 10.0


def find_ego_truth(data: Path, sequence: str | None = None) -> EgoTruth:
    """The true poses of a data set's folder, of a bag with an odometry, or of a file.

    `sequence`: which one, where a folder holds several. Raises `InputError` where there are none,
    or a row of them cannot be used.
    """
    bag = bag_at(data)
    if bag is not None:
        return bag_truth(bag)
    if not data.is_dir() or truth_file(data) is not None:
        return read_ego_truth(data)
    folder = data / sequence if sequence and not recognise(data) else data
    for kind in recognise(folder):
        read = TRUTHS.get(kind)
        found = None if read is None else read(folder, None if folder != data else sequence)
        if found is not None and kind in _ANY_WORLD:
            return upright(found, open_sequence(folder, kind).imu)
        if found is not None:
            return found
    return read_ego_truth(folder)


def find_object_truth(data: Path, sequence: str | None, ego: EgoTruth) -> ObjectTruth | None:
    """The true objects of a data set's folder in the world of `ego`, None where it has none."""
    if not data.is_dir():
        return None
    found = read_object_truth(data)
    if found is not None or "kitti" not in recognise(data):
        return found
    return kitti_objects(data, sequence, ego)


def upright(truth: EgoTruth, imu: ImuData | None) -> EgoTruth:
    """The truth in a world with z up, where by the accelerometer another direction is up.

    What a resting accelerometer measures points up; over a whole run accelerations cancel but for
    the change of velocity, so that only a world that is plainly another is turned: from the nearest
    axis, or, where none is near, from what was measured.
    """
    if imu is None:
        return truth
    inside = (truth.timestamp_ns >= imu.timestamp_ns[0]) & (
        truth.timestamp_ns <= imu.timestamp_ns[-1]
    )
    if not np.any(inside):
        return truth
    at, known = truth.timestamp_ns[inside] - imu.timestamp_ns[0], imu.timestamp_ns
    force = np.stack([np.interp(at, known - known[0], imu.accel[:, i]) for i in range(3)], -1)
    mean = np.einsum("nij,nj->ni", truth.T_world_imu[inside, :3, :3], force).mean(axis=0)
    up = mean / np.linalg.norm(mean)
    limit = np.cos(np.radians(_PLAINLY_DEG))
    if up[2] >= limit:
        return truth
    axis = np.zeros(3)
    axis[np.argmax(np.abs(up))] = np.sign(up[np.argmax(np.abs(up))])
    if axis @ up < limit:
        axis = up
    T = se3.make(_turn_to_z(axis), np.zeros(3))
    velocity = None if truth.velocity is None else truth.velocity @ T[:3, :3].T
    return replace(truth, T_world_imu=T @ truth.T_world_imu, velocity=velocity)


def _turn_to_z(axis: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3) that takes a unit vector to z; about x where it is -z."""
    around = np.cross(axis, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(around)
    if sine < 1e-9:
        return np.diag([1.0, np.sign(axis[2]), np.sign(axis[2])])
    return so3.exp(around / sine * np.arctan2(sine, axis[2]))
