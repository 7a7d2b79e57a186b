"""EuRoC/ASL folders: `mav0/cam0`, `mav0/cam1`, `mav0/imu0`."""

from pathlib import Path

from ovmot.datasets.asl import (
    asl_imu,
    asl_listing,
    mav_folder,
    sensor_calibration,
    sequence_folder,
)
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings, refuse_choice
from ovmot.datasets.frames import ReadingLimits
from ovmot.datasets.images import read_grey
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.tum_vi.reader import TumViReader
from ovmot.datasets.viode.reader import ViodeReader
from ovmot.errors import InputError

_VARIANTS = (TumViReader(), ViodeReader())


class EurocReader:
    """Reads the folder that holds `mav0`, or `mav0` itself."""

    needs = "mav0/cam0, mav0/cam1 (sensor.yaml, data/*.png, data.csv), mav0/imu0"

    def recognise(self, root: Path) -> bool:
        return mav_folder(root) is not None and not any(v.recognise(root) for v in _VARIANTS)

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        mav = mav_folder(root)
        if mav is None:
            raise InputError.at(root, "not a EuRoC folder", f"it needs {self.needs}")
        refuse_choice(root, sequence)
        findings = Findings()
        return assemble(
            kind="euroc",
            name=sequence_folder(mav).name,
            root=root,
            listing=asl_listing(mav, findings, limits),
            imu=asl_imu(mav, limits.imu_max_gap_s, findings),
            calibration=calibration or sensor_calibration(mav, findings),
            decode=read_grey,
            findings=findings,
        )
