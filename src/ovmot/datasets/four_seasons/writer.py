"""Writes a simulation as a 4Seasons recording with its calibration in it, and its truth beside it.

Layout: P. Wenzel et al., "4Seasons: A cross-season dataset for multi-weather SLAM in autonomous
driving", GCPR 2020. Pictures are undistorted and rectified, whatever the rig's lenses are.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig, rectified
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.sim.sequence_files import (
    by_stamp,
    generators,
    imu_samples,
    make_folders,
    write_frames,
    write_imu_truth,
    write_rows,
    write_true_poses,
)
from ovmot.sim.simulation import Simulation

_LEFT, _RIGHT = "undistorted_images/cam0", "undistorted_images/cam1"


def write_four_seasons(folder: Path, simulation: Simulation, seed: int) -> Iterator[int]:
    """Render and write the recording, as `write_asl`.

    Raises `InputError` where the folder is not empty or not writable.
    """
    try:
        yield from _write(folder, replace(simulation, rig=rectified(simulation.rig)), seed)
    except OSError as error:
        raise InputError.at(folder, f"cannot be written: {error.strerror}") from error


def _write(folder: Path, simulation: Simulation, seed: int) -> Iterator[int]:
    picture_rng, imu_rng = generators(seed)
    make_folders(folder, (_LEFT, _RIGHT, "calibration"))
    rows = (f"{t} {ns_to_seconds(t)} 5.0\n" for t in simulation.camera_ns.tolist())
    (folder / "times.txt").write_text("".join(rows))
    imu = imu_samples(simulation, imu_rng)
    values = np.concatenate([imu.data.gyro, imu.data.accel], axis=1)
    write_rows(folder / "imu.txt", imu.data.timestamp_ns, values, separator=" ")
    _write_calibration(folder, simulation.rig)
    write_imu_truth(folder, simulation, imu)
    write_true_poses(folder, simulation)
    save = by_stamp(folder / _LEFT, folder / _RIGHT)
    yield from write_frames(folder, simulation, save, picture_rng)


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
