"""The calibration that a user gives in place of the data's own: `--calibration FILE`."""

from pathlib import Path

from ovmot.datasets.calibration import Calibration, load_calibration_yaml
from ovmot.datasets.kalibr import read_kalibr
from ovmot.datasets.vins import is_vins, read_vins


def read_calibration(
    path: Path, left: str | None = None, right: str | None = None, need_imu_pose: bool = True
) -> Calibration:
    """A Kalibr chain (a file, or a folder with one) or a rig's file of VINS.

    `left` and `right` name cameras of the chain, `need_imu_pose` says whether it must place them on
    the IMU: see `kalibr.read_kalibr_cameras`. Raises `CalibrationError` with file, key and remedy.
    """
    if not path.is_dir() and is_vins(load_calibration_yaml(path).data):
        return read_vins(path)
    return read_kalibr(path, left, right, need_imu_pose)
