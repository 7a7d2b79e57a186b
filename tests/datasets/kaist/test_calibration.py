"""KAIST calibration files, good ones and broken ones."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.kaist.calibration import read_kaist_calibration
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

Edit = Callable[[Path, str, str], None]


def test_kaist_rig(kaist: Path) -> None:
    rig = read_kaist_calibration(kaist / "calibration").rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [1.71, 0.24, -0.12], atol=1e-12)
    np.testing.assert_allclose(rig.T_cam1_cam0[:3, 3], [-0.48, 0.0, 0.0], atol=1e-12)
    assert rig.cam0.intrinsics.tolist() == [20.0, 21.0, 16.0, 12.0, 0.5]


def test_kaist_imu_file_replaces_the_default(kaist: Path) -> None:
    (kaist / "calibration" / "Vehicle2IMU.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0.64 0 0\n")
    rig = read_kaist_calibration(kaist / "calibration").rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [1.0, 0.24, 1.58], atol=1e-12)


def test_kaist_right_camera_follows_from_rectification(kaist: Path, edit: Edit) -> None:
    """A point seen by both raw cameras lands on one row, 9.6 / z apart, after rectification."""
    folder = kaist / "calibration"
    a, b = 0.1, -0.05
    R_left = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    R_right = np.array([[np.cos(b), 0, np.sin(b)], [0, 1.0, 0], [-np.sin(b), 0, np.cos(b)]])
    for name, R in (("left", R_left), ("right", R_right)):
        numbers = ", ".join(repr(float(x)) for x in R.ravel())
        edit(
            folder / f"{name}.yaml",
            "1., 0., 0., 0., 1., 0., 0., 0., 1. ]\nproj",
            f"{numbers} ]\nproj",
        )
    rig = read_kaist_calibration(folder).rig
    p_cam0 = np.array([0.7, -0.4, 5.0])
    p_rect0 = R_left @ p_cam0
    p_rect1 = R_right @ se3.apply(rig.T_cam1_cam0, p_cam0)
    np.testing.assert_allclose(p_rect1 - p_rect0, [-9.6 / 20.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("left.yaml", ("image_width: 32", "image_width: 0"), "image_width"),
        ("left.yaml", ("data: [ 20., 0.5", "data: [ 0., 0.5"), "camera_matrix"),
        ("left.yaml", ("plumb_bob", "barrel"), "unknown camera model"),
        ("right.yaml", ("rectification_matrix", "rectification"), "rectification_matrix.*missing"),
        ("right.yaml", ("0., 0., 1. ]\nproj", "0., 0., 3. ]\nproj"), "not a rotation"),
        ("right.yaml", ("-9.6", "0."), "same place"),
        ("right.yaml", ("-9.6", ".nan"), "not finite"),
        ("Vehicle2Stereo.txt", ("T: 1.64 0.24", "T: 1.64"), "'T': expected 3 numbers"),
        ("Vehicle2Stereo.txt", ("R: 0 0 1", "Q: 0 0 1"), "'R': this key is missing"),
    ],
)
def test_broken_kaist_files(
    kaist: Path, edit: Edit, name: str, change: tuple[str, str], message: str
) -> None:
    edit(kaist / "calibration" / name, *change)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_kaist_calibration(kaist / "calibration")
    assert str(kaist / "calibration" / name) in str(caught.value)


def test_missing_kaist_file(kaist: Path) -> None:
    (kaist / "calibration" / "Vehicle2Stereo.txt").unlink()
    with pytest.raises(CalibrationError, match=r"Vehicle2Stereo\.txt: no such"):
        read_kaist_calibration(kaist / "calibration")


def test_real_kaist_files(data_root: Path) -> None:
    folder = data_root / "kaist_sample" / "calibration"
    if not folder.is_dir():
        pytest.skip(f"{folder} is missing")
    rig = read_kaist_calibration(folder).rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [1.712, 0.247, -0.116], atol=5e-4)
    assert rig.baseline == pytest.approx(0.4751, abs=5e-5)
    assert rig.cam0.intrinsics[4] == pytest.approx(0.505, abs=1e-3)
