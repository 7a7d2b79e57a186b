"""Writes a sequence as a 4Seasons recording with its calibration in it, and its truth beside it.

Layout: P. Wenzel et al., "4Seasons: A cross-season dataset for multi-weather SLAM in autonomous
driving", GCPR 2020. Images are undistorted and rectified, whatever the rig's camera models are.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig, rectified
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.datasets.writing import (
    SequenceToWrite,
    by_stamp,
    make_folders,
    writable,
    write_frames,
    write_imu_truth,
    write_rows,
    write_true_poses,
)
from ovmot.geometry import se3, so3

_LEFT, _RIGHT = "undistorted_images/cam0", "undistorted_images/cam1"


def write_four_seasons(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write the recording, as `write_asl`.

    Raises `InputError` where the folder is not empty or not writable.
    """
    with writable(folder):
        yield from _write(folder, sequence, rectified(sequence.rig))


def _write(folder: Path, sequence: SequenceToWrite, rig: StereoRig) -> Iterator[int]:
    make_folders(folder, (_LEFT, _RIGHT, "calibration"))
    rows = (f"{t} {ns_to_seconds(t)} 5.0\n" for t in sequence.camera_ns.tolist())
    (folder / "times.txt").write_text("".join(rows))
    imu = sequence.imu
    values = np.concatenate([imu.data.gyro, imu.data.accel], axis=1)
    write_rows(folder / "imu.txt", imu.data.timestamp_ns, values, separator=" ")
    _write_calibration(folder, rig)
    write_imu_truth(folder, imu)
    write_true_poses(folder, sequence)
    save = by_stamp(folder / _LEFT, folder / _RIGHT)
    yield from write_frames(folder, sequence, rig, save)


def _write_calibration(folder: Path, rig: StereoRig) -> None:
    for i, camera in enumerate(rig.cameras):
        fx, fy, cx, cy, _ = camera.intrinsics.tolist()
        size = f"{camera.width} {camera.height}"
        (folder / f"calibration/undistorted_calib_{i}.txt").write_text(
            f"Pinhole {fx!r} {fy!r} {cx!r} {cy!r} 0\n{size}\ncrop\n{size}\n"
        )
    rows = (" ".join(repr(x) for x in row) for row in rig.T_cam1_cam0.tolist())
    (folder / "calibration/undistorted_calib_stereo.txt").write_text("\n".join([*rows, ""]))
    T = se3.inverse(rig.T_imu_cam0)
    pose = ",".join(repr(float(x)) for x in (*T[:3, 3], *so3.to_quaternion(T[:3, :3])))
    (folder / "Transformations.txt").write_text(
        f"# TS_cam_imu: translation vector, rotation quaternion\n{pose}\n"
    )
