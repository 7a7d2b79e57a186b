"""TUM-VI folders: fisheye stereo in the ASL layout (`mav0`) or in that of DSO (`dso`).

D. Schubert et al., "The TUM VI benchmark for evaluating visual-inertial odometry", IROS 2018. The
calibration is `dso/camchain.yaml` (Kalibr, equidistant) with `dso/imu_config.yaml`. Images are PNGs
of 8 or 16 bits; those of 16 are scaled to 8.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from ovmot.datasets.asl import asl_imu, asl_listing
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings, note_no_imu, note_no_imu_noise, refuse_choice
from ovmot.datasets.frames import (
    ReadingLimits,
    StereoListing,
    camera_images,
    checked_stamps,
    note_missing_images,
    pair_images,
    present_images,
)
from ovmot.datasets.images import read_grey
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.kalibr import read_kalibr_cameras, read_kalibr_noise
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.text_tables import read_stamped_list, read_stamped_text
from ovmot.errors import InputError
from ovmot.types import ImuData

_IMU_COLUMNS = 7  # ns, gyro xyz, accel xyz
_CHAIN = "camchain.yaml"


class TumViReader:
    """Reads the folder that holds `mav0` and `dso`, or `dso` alone."""

    needs = (
        "dso/camchain.yaml, dso/imu_config.yaml and the data in mav0 (as EuRoC) or in dso"
        " (cam0|cam1/images, cam0|cam1/times.txt, imu.txt)"
    )

    def recognise(self, root: Path) -> bool:
        return _dso(root) is not None

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        dso = _dso(root)
        if dso is None:
            raise InputError.at(root, "not a TUM-VI folder", f"it needs {self.needs}")
        refuse_choice(root, sequence)
        findings = Findings()
        mav = dso.parent / "mav0"
        if (mav / "cam0").is_dir():
            listing = asl_listing(mav, findings, limits)
            imu = asl_imu(mav, limits.imu_max_gap_s, findings)
        else:
            listing = _dso_listing(dso, findings, limits)
            imu = _dso_imu(dso / "imu.txt", limits.imu_max_gap_s, findings)
        return assemble(
            kind="tum_vi",
            name=dso.resolve().parent.name,
            root=root,
            listing=listing,
            imu=imu,
            calibration=calibration or _calibration(dso, limits, findings),
            decode=read_grey,
            findings=findings,
        )


def _dso(root: Path) -> Path | None:
    """The folder with the calibration: below the sequence's, beside `mav0`, or `root` itself."""
    for folder in (root / "dso", root.parent / "dso" if root.name == "mav0" else root):
        if folder.name == "dso" and (folder / _CHAIN).is_file():
            return folder
    return None


def _dso_listing(dso: Path, findings: Findings, limits: ReadingLimits) -> StereoListing:
    """Pairs by `times.txt`, whose rows begin with the stamp in ns: the name of the image."""
    stamps: set[int] = set()
    images: list[dict[int, Path]] = []
    for camera in ("cam0", "cam1"):
        listed = dso / camera / "times.txt"
        rows = checked_stamps(read_stamped_list(listed), findings)
        bare = dict.fromkeys(rows, "")  # what follows the stamp is no name
        stamps |= rows.keys()
        read = partial(present_images, bare, dso / camera / "images", listed)
        images.append(camera_images(read, limits, findings))
    left, right = images
    note_missing_images(stamps, left.keys() | right.keys(), dso / "cam0" / "times.txt", findings)
    return pair_images(left, right, dso, findings, limits)


def _dso_imu(path: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    if not path.exists():
        note_no_imu(path, findings)
        return None
    return checked_imu(read_stamped_text(path, _IMU_COLUMNS), 0, 3, max_gap_s, findings)


def _calibration(dso: Path, limits: ReadingLimits, findings: Findings) -> Calibration:
    noise = dso / "imu_config.yaml"
    if not noise.exists():
        note_no_imu_noise(noise, findings)
    found = read_kalibr_cameras(dso / _CHAIN, limits.need_imu_pose)
    return replace(found, imu_noise=read_kalibr_noise(noise) if noise.exists() else None)
