"""The calibration of any data set as files of Kalibr and OpenVINS."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.kalibr import IMU_FILE, write_chain, write_imu_chain
from ovmot.datasets.sequence import RecordedSequence
from ovmot.errors import InputError
from ovmot.text_files import StrPath
from ovmot.types import ImuData, ImuNoise


@dataclass(frozen=True, slots=True)
class WrittenCalibration:
    """The files that were written, and what a user should know of them."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]


def write_calibration(
    sequence: RecordedSequence, path: StrPath, replace: bool = False
) -> WrittenCalibration:
    """The rig of a sequence as a Kalibr chain, and beside it, where known, the IMU's noise.

    `--calibration` and `ovmot.open(..., calibration=)` read both back. Raises `InputError` where a
    file is there already and is not to be replaced, or cannot be written.
    """
    return write_rig(path, sequence.rig, sequence.imu_noise, _rate_hz(sequence.imu), replace)


def calibration_files(path: StrPath, with_noise: bool, replace: bool) -> tuple[Path, ...]:
    """The chain to write, and the file of the IMU's noise beside it.

    Raises `InputError` where one is there already and is not to be replaced.
    """
    chain = Path(path)
    files = (chain, chain.with_name(IMU_FILE)) if with_noise else (chain,)
    for file in files:
        if file.exists() and not replace:
            raise InputError.at(file, "is there already", "give another name, or --force")
    return files


def write_rig(
    path: StrPath,
    rig: StereoRig,
    noise: ImuNoise | None,
    rate_hz: float,
    replace: bool = False,
    comment: tuple[str, ...] = (),
) -> WrittenCalibration:
    """The same for a rig, with lines of `comment` above; `rate_hz`: of the IMU."""
    chain = Path(path)
    imu = chain.with_name(IMU_FILE)
    files = calibration_files(path, noise is not None, replace)
    notes = _skew_notes(chain, rig)
    if noise is None:
        notes += (f"{chain}: the data does not say the IMU's noise: no {IMU_FILE} beside it",)
        if imu.exists():
            notes += (f"{imu}: belongs to another chain, and is read with this one",)
    try:
        chain.parent.mkdir(parents=True, exist_ok=True)
        write_chain(chain, rig)
        if comment:
            text = "".join(f"# {line}\n" for line in comment)
            chain.write_text(text + chain.read_text(encoding="utf-8"), encoding="utf-8")
        if noise is not None:
            write_imu_chain(imu, noise, rate_hz)
    except OSError as error:
        raise InputError.at(chain, f"cannot be written: {error.strerror}") from None
    return WrittenCalibration(files, notes)


def _rate_hz(imu: ImuData | None) -> float:
    """Samples a second, 0 where there are none."""
    if imu is None or len(imu) < 2:
        return 0.0
    return round(1e9 / float(np.median(np.diff(imu.timestamp_ns))), 3)


def _skew_notes(path: Path, rig: StereoRig) -> tuple[str, ...]:
    """How far pixels lie off at the upper and the lower edge for who does not read `skew`."""
    off_px = 0.0
    for camera in rig.cameras:
        _, fy, _, cy, skew = camera.intrinsics.tolist()
        off_px = max(off_px, abs(skew) / fy * max(cy, camera.height - cy))
    if off_px == 0.0:
        return ()
    text = f"up to {off_px:.2g} px at the upper and the lower edge"
    return (f"{path}: the cameras have a skew, which other programs do not read: {text}",)
