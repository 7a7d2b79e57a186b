"""Writes a sequence as a TUM-VI folder (`mav0` and `dso`), with its truth beside it.

Layout: D. Schubert et al., "The TUM VI benchmark for evaluating visual-inertial odometry", IROS
2018. Images are PNGs of 16 bits. Camera models are the rig's own; the data set's are equidistant.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ovmot.datasets.asl import write_asl_imu, write_listed
from ovmot.datasets.kalibr import check_rig, write_chain, write_noise
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.datasets.writing import (
    FrameToWrite,
    SequenceToWrite,
    make_folders,
    writable,
    write_frames,
    write_imu_truth,
    write_png,
    write_rows,
    write_true_poses,
)

_CAMERAS = ("cam0", "cam1")


def write_tum_vi(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write the sequence, as `write_asl`; the time offset is in `camchain.yaml`.

    Raises `InputError` where the folder is not empty or not writable, or for cameras with skew.
    """
    check_rig(folder, sequence.rig)
    with writable(folder):
        yield from _write(folder, sequence)


def _write(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    mav, dso = folder / "mav0", folder / "dso"
    names = [f"mav0/{camera}/data" for camera in _CAMERAS] + [f"dso/{c}" for c in _CAMERAS]
    make_folders(folder, (*names, "mav0/imu0"))
    imu = sequence.imu
    write_asl_imu(mav / "imu0/data.csv", imu)
    write_chain(dso / "camchain.yaml", sequence.rig)
    write_noise(dso / "imu_config.yaml", imu.noise, imu.rate_hz)
    for camera in _CAMERAS:
        write_listed(mav / camera, sequence.camera_ns)
        rows = "".join(f"{t} {ns_to_seconds(t)} 5.0\n" for t in sequence.camera_ns)
        (dso / camera / "times.txt").write_text(f"# name time[s] exposure[ms]\n{rows}")
        (dso / camera / "images").symlink_to(Path("../../mav0") / camera / "data")
    values = np.concatenate([imu.data.gyro, imu.data.accel], axis=1)
    header = "# timestamp[ns] w_x w_y w_z a_x a_y a_z"
    write_rows(dso / "imu.txt", imu.data.timestamp_ns, values, header, separator=" ")
    write_imu_truth(folder, imu)
    write_true_poses(folder, sequence)

    def save(frame: FrameToWrite) -> None:
        for camera, image in zip(_CAMERAS, frame.frame.pair, strict=True):
            path = mav / camera / "data" / f"{frame.frame.timestamp_ns}.png"
            write_png(path, image.astype(np.uint16) * 257)  # the full range of 16 bits

    yield from write_frames(folder, sequence, sequence.rig, save)
