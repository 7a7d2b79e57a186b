"""4Seasons recordings: undistorted stereo images, an IMU, and a folder with the calibration.

P. Wenzel et al., "4Seasons: A cross-season dataset for multi-weather SLAM in autonomous driving",
GCPR 2020. `times.txt` has rows of the stamp in ns (the image's name), the time in s and the
exposure; `imu.txt` rows of ns, gyro and accel. The undistorted cameras are pinholes, the right one
placed by `undistorted_calib_stereo.txt` (T_cam1_cam0), the IMU by `TS_cam_imu` in the recording's
`Transformations.txt`, else by `T_cam_imu` of `camchain.yaml`.
"""

from pathlib import Path

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import Calibration, load_calibration_yaml, make_rig
from ovmot.datasets.findings import Findings, note_no_imu, note_no_imu_noise, refuse_choice
from ovmot.datasets.frames import (
    ReadingLimits,
    StereoListing,
    pair_listed,
)
from ovmot.datasets.images import read_grey
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.kalibr import read_kalibr_noise
from ovmot.datasets.sequence import FolderSequence, assemble
from ovmot.datasets.text_tables import read_lines, read_stamped_list, read_stamped_text
from ovmot.errors import CalibrationError, InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.text_files import read_text
from ovmot.types import ImuData

_IMAGES = "undistorted_images"
_IMU_COLUMNS = 7  # ns, gyro xyz, accel xyz
_NOISE_FILES = ("imu_config.yaml", "imu.yaml")


class FourSeasonsReader:
    """Reads one recording's folder; the calibration stands in it or beside it."""

    needs = (
        "undistorted_images/cam0, cam1, times.txt, imu.txt, Transformations.txt;"
        " calibration/undistorted_calib_0.txt, _1.txt, _stereo.txt there or one folder up"
    )

    def recognise(self, root: Path) -> bool:
        return (root / _IMAGES / "cam0").is_dir()

    def read(
        self,
        root: Path,
        sequence: str | None,
        calibration: Calibration | None,
        limits: ReadingLimits,
    ) -> FolderSequence:
        """Describe the sequence; raises `InputError` and its children for what is wrong."""
        if not self.recognise(root):
            raise InputError.at(root, "not a 4Seasons recording", f"it needs {self.needs}")
        refuse_choice(root, sequence)
        findings = Findings()
        return assemble(
            kind="4seasons",
            name=root.resolve().name,
            root=root,
            listing=_listing(root, findings, limits),
            imu=_imu(root / "imu.txt", limits.imu_max_gap_s, findings),
            calibration=calibration or _calibration(root, findings),
            decode=read_grey,
            findings=findings,
        )


def _listing(root: Path, findings: Findings, limits: ReadingLimits) -> StereoListing:
    folders = root / _IMAGES / "cam0", root / _IMAGES / "cam1"
    return pair_listed(folders, root / "times.txt", read_stamped_list, root, findings, limits)


def _imu(path: Path, max_gap_s: float, findings: Findings) -> ImuData | None:
    if not path.exists():
        note_no_imu(path, findings)
        return None
    return checked_imu(read_stamped_text(path, _IMU_COLUMNS), 0, 3, max_gap_s, findings)


def _calibration_folder(root: Path) -> Path:
    parent = root.resolve().parent
    places = [p / name for p in (root, parent) for name in ("calibration", "Calibration")]
    return next((p for p in places if p.is_dir()), places[0])


def cam_from_imu(root: Path) -> FloatArray:
    """T_cam0_imu (4, 4) of a recording; raises `CalibrationError`."""
    return _cam_from_imu(root / "Transformations.txt", _calibration_folder(root) / "camchain.yaml")


def _calibration(root: Path, findings: Findings) -> Calibration:
    folder = _calibration_folder(root)
    cameras = (
        _camera(folder / "undistorted_calib_0.txt"),
        _camera(folder / "undistorted_calib_1.txt"),
    )
    stereo = folder / "undistorted_calib_stereo.txt"
    T_cam1_cam0 = _rigid(stereo, _numbers(stereo))
    T_imu_cam0 = se3.inverse(cam_from_imu(root))
    rig = make_rig(stereo, cameras, (T_imu_cam0, T_imu_cam0 @ se3.inverse(T_cam1_cam0)))
    noise = next((folder / n for n in _NOISE_FILES if (folder / n).exists()), None)
    if noise is None:
        note_no_imu_noise(folder / _NOISE_FILES[0], findings)
    return Calibration(rig, None if noise is None else read_kalibr_noise(noise))


def _camera(path: Path) -> Camera:
    """A pinhole: `Pinhole fx fy cx cy 0`, then width and height; what follows is left out."""
    lines = read_lines(path, CalibrationError).text
    # `read_lines` takes a first line that begins with a letter for column names
    first = read_text(path, CalibrationError).split("\n", 1)[0].split()
    if len(first) < 5 or first[0].lower() != "pinhole" or not lines:
        raise CalibrationError.at(path, "no pinhole", "write 'Pinhole fx fy cx cy 0'", row=1)
    try:
        fx, fy, cx, cy = (float(x) for x in first[1:5])
        width, height = (int(x) for x in lines[0].split()[:2])
        return Camera.make((width, height), (fx, fy), (cx, cy))
    except (ValueError, CalibrationError) as error:
        remedy = "row 1: Pinhole fx fy cx cy 0, row 2: width height"
        raise CalibrationError.at(path, str(error), remedy) from None


def _cam_from_imu(transformations: Path, chain: Path) -> FloatArray:
    """T_cam0_imu of the recording's transforms, else of the Kalibr chain."""
    if not transformations.exists():
        return load_calibration_yaml(chain).child("cam0").transform("T_cam_imu")
    lines = read_text(transformations, CalibrationError).splitlines()
    for row, line in enumerate(lines, start=1):
        if not line.startswith("# TS_cam_imu"):
            continue
        text = next((below for below in lines[row:] if below.strip()), "")
        try:
            values = np.array(text.split(","), dtype=np.float64)
            unit = values.shape == (7,) and abs(np.linalg.norm(values[3:]) - 1.0) < 0.02
            if not (unit and np.all(np.isfinite(values))):
                raise ValueError
        except ValueError:
            problem = "no translation and unit quaternion x y z w below this row"
            raise CalibrationError.at(transformations, problem, "copy it again", row=row) from None
        return se3.make(so3.from_quaternion(values[3:] / np.linalg.norm(values[3:])), values[:3])
    raise CalibrationError.at(transformations, "no row '# TS_cam_imu'", "copy the file again")


def _numbers(path: Path) -> FloatArray:
    """A matrix (4, 4) of a text file."""
    return read_lines(path, CalibrationError).parse(np.dtype(np.float64), 4, None)


def _rigid(path: Path, T: FloatArray) -> FloatArray:
    if T.shape != (4, 4) or np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3:
        raise CalibrationError.at(path, "no rigid 4x4 matrix", "copy the file again")
    return se3.make(so3.project_to_rotation(T[:3, :3]), T[:3, 3])
