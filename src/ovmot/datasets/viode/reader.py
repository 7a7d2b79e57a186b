"""VIODE folders: an ASL folder with segmentation images, unpacked from the data set's bags.

K. Minoda et al., "VIODE: A simulated dataset to address the challenges of visual-inertial odometry
in dynamic environments", RA-L 2021. The bags are accepted as such a folder:

    mav0/cam0/data/<ns>.png             mav0/cam1/data/<ns>.png          colour or grey
    mav0/cam0/segmentation/<ns>.png     mav0/cam1/segmentation/<ns>.png  colours of rgb_ids.txt
    mav0/imu0/data.csv                  as EuRoC
    calibration_files/calibration.yaml, cam0_pinhole.yaml, cam1_pinhole.yaml, or sensor.yaml files
    segmentation/rgb_ids.txt            id,r,g,b

The calibration and the table of colours may also stand in the sequence's folder, or in the one
above it, as one copy serves all sequences.
"""

from pathlib import Path

from ovmot.datasets.asl import (
    asl_imu,
    asl_listing,
    mav_folder,
    sensor_calibration,
    sequence_folder,
)
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings, note_no_imu_noise, refuse_choice
from ovmot.datasets.frames import ReadingLimits
from ovmot.datasets.images import read_grey
from ovmot.datasets.instance_masks import find_instance_images
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.viode.calibration import read_vins
from ovmot.errors import InputError

_SEGMENTATION = "segmentation"
_CALIBRATION = ("calibration_files/calibration.yaml", "calibration.yaml")
_COLOURS = ("segmentation/rgb_ids.txt", "rgb_ids.txt", "calibration_files/rgb_ids.txt")


class ViodeReader:
    """Reads the folder that holds `mav0`, or `mav0` itself."""

    needs = "mav0 as EuRoC with cam0/segmentation, cam1/segmentation; calibration_files"

    def recognise(self, root: Path) -> bool:
        mav = mav_folder(root)
        return mav is not None and (mav / "cam0" / _SEGMENTATION).is_dir()

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
            raise InputError.at(root, "not a VIODE folder", f"it needs {self.needs}")
        refuse_choice(root, sequence)
        findings = Findings()
        folder = sequence_folder(mav)
        images = mav / "cam0" / _SEGMENTATION, mav / "cam1" / _SEGMENTATION
        return assemble(
            kind="viode",
            name=folder.name,
            root=root,
            listing=asl_listing(mav, findings, limits),
            imu=asl_imu(mav, limits.imu_max_gap_s, findings),
            calibration=calibration or _calibration(mav, folder, findings),
            decode=read_grey,
            findings=findings,
            instances=find_instance_images(images, _near(folder, _COLOURS), findings),
        )


def _calibration(mav: Path, folder: Path, findings: Findings) -> Calibration:
    file = _near(folder, _CALIBRATION)
    if file is None or (mav / "cam0" / "sensor.yaml").exists():
        return sensor_calibration(mav, findings)
    # its noise parameters are those of one discrete solver, not densities
    note_no_imu_noise(mav / "imu0" / "sensor.yaml", findings)
    return read_vins(file)


def _near(folder: Path, names: tuple[str, ...]) -> Path | None:
    """The first of these files, in the sequence's folder or the one above."""
    places = (place / name for place in (folder, folder.parent) for name in names)
    return next((path for path in places if path.is_file()), None)
