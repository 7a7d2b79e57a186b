"""Writes a sequence as a UZH-FPV folder with its calibration in it, and its truth beside it.

Layout: J. Delmerico et al., "Are we ready for autonomous drone racing? The UZH-FPV drone racing
dataset", ICRA 2019.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

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
    write_true_poses,
)

_CALIBRATION = "simulated_calib_snapdragon"


def write_uzh_fpv(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write the sequence, as `write_asl`; the time offset is in the Kalibr chain.

    Raises `InputError` where the folder is not empty or not writable, or for cameras with skew.
    """
    check_rig(folder, sequence.rig)
    with writable(folder):
        yield from _write(folder, sequence)


def _write(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    imu = sequence.imu
    make_folders(folder, ("img", _CALIBRATION))
    write_chain(folder / _CALIBRATION / "camchain-imucam-simulated.yaml", sequence.rig)
    write_noise(folder / _CALIBRATION / "imu.yaml", imu.noise, imu.rate_hz)
    stamps = sequence.camera_ns.tolist()
    for i, side in enumerate(("left", "right")):
        rows = (f"{n} {ns_to_seconds(t)} img/image_{i}_{n}.png\n" for n, t in enumerate(stamps))
        (folder / f"{side}_images.txt").write_text("# id timestamp image_name\n" + "".join(rows))
    values = np.concatenate([imu.data.gyro, imu.data.accel], axis=1)
    with (folder / "imu.txt").open("w", encoding="utf-8") as file:
        file.write("# timestamp ang_vel_x ang_vel_y ang_vel_z lin_acc_x lin_acc_y lin_acc_z\n")
        samples = zip(imu.data.timestamp_ns.tolist(), values.tolist(), strict=True)
        for n, (t, row) in enumerate(samples):
            file.write(f"{n} {ns_to_seconds(t)} {' '.join(f'{x:.9f}' for x in row)}\n")
    write_imu_truth(folder, imu)
    write_true_poses(folder, sequence)
    number = {t: n for n, t in enumerate(stamps)}

    def save(frame: FrameToWrite) -> None:
        n = number[frame.frame.timestamp_ns]
        write_png(folder / "img" / f"image_0_{n}.png", frame.frame.left)
        write_png(folder / "img" / f"image_1_{n}.png", frame.frame.pair[1])

    yield from write_frames(folder, sequence, sequence.rig, save)
