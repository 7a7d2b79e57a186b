"""Kalibr chains: wide-angle cameras read and written, chains of one camera and of more than two."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.kalibr import read_kalibr, read_kalibr_cameras, read_kalibr_rig, write_chain
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

_BASE = """
  resolution: [640, 480]
  T_cam_imu: [[1, 0, 0, {x}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
OMNI = """\
  camera_model: omni
  intrinsics: [1.2, 500.0, 510.0, 320.0, 240.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.02, 0.001, -0.002]
"""
EUCM = """\
  camera_model: eucm
  intrinsics: [0.6, 1.1, 230.0, 231.0, 320.0, 240.0]
  distortion_model: none
  distortion_coeffs: []
"""
DS = """\
  camera_model: ds
  intrinsics: [-0.2, 0.6, 230.0, 231.0, 320.0, 240.0]
  distortion_model: none
  distortion_coeffs: []
"""


def write(path: Path, *cameras: str) -> Path:
    parts = [f"cam{k}:\n{c}{_BASE.format(x=-0.1 * k)}" for k, c in enumerate(cameras)]
    path.write_text("\n".join(parts))
    return path


@pytest.mark.parametrize(
    ("text", "model", "focal", "coefficients"),
    [
        (OMNI, "omni", (500.0, 510.0), [1.2, -0.1, 0.02, 0.001, -0.002]),
        (OMNI.replace("radtan", "none"), "omni", (500.0, 510.0), [1.2]),
        (EUCM, "eucm", (230.0, 231.0), [0.6, 1.1]),
        (DS, "ds", (230.0, 231.0), [-0.2, 0.6]),
    ],
)
def test_wide_angle_cameras(
    tmp_path: Path, text: str, model: str, focal: tuple[float, float], coefficients: list[float]
) -> None:
    rig = read_kalibr(write(tmp_path / "chain.yaml", text, text)).rig
    for camera in rig.cameras:
        assert camera.model.name == model
        np.testing.assert_array_equal(camera.intrinsics[:4], [*focal, 320.0, 240.0])
        np.testing.assert_array_equal(camera.distortion, coefficients)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("radtan", [-0.1, 0.01, 1e-3, 2e-4]),
        ("equidistant", [0.01, 0.0, 0.0, 0.0]),
        ("none", []),
        ("omni", [0.9, -0.1, 0.01, 1e-3, 2e-4]),
        ("omni", [0.9]),
        ("eucm", [0.55, 1.2]),
        ("ds", [-0.15, 0.58]),
    ],
)
def test_every_camera_comes_back_as_it_was_written(
    tmp_path: Path, model: str, coefficients: list[float]
) -> None:
    camera = Camera.make((640, 480), (400.0, 401.0), (320.0, 241.0), model, coefficients)
    beside = se3.make(np.eye(3), np.array([0.1, 0.0, 0.0]))
    write_chain(tmp_path / "chain.yaml", StereoRig(camera, camera, np.eye(4), beside))
    found = read_kalibr_rig(tmp_path / "chain.yaml").cam1
    assert found.model.name == model
    np.testing.assert_array_equal(found.intrinsics, camera.intrinsics)
    np.testing.assert_array_equal(found.distortion, camera.distortion)


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (OMNI, "[1.2,", "[-0.2,", "'cam0.intrinsics': xi of 'omni' is -0.2 .at least 0"),
        (EUCM, "[0.6,", "[1.6,", "alpha of 'eucm' is 1.6 .0 to 1"),
        (DS, "[-0.2,", "[-1.2,", "xi of 'ds' is -1.2"),
        (OMNI, "radtan", "equidistant", "'omni' with 'equidistant' is not known"),
        (DS, "none", "radtan", "'ds' with 'radtan' is not known; calibrate with 'ds-none'"),
    ],
)
def test_numbers_that_a_model_cannot_have(
    tmp_path: Path, text: str, old: str, new: str, message: str
) -> None:
    path = write(tmp_path / "chain.yaml", text.replace(old, new), text)
    with pytest.raises(CalibrationError, match=message):
        read_kalibr(path)


def test_a_chain_of_one_camera_is_a_rig_of_one(tmp_path: Path) -> None:
    found = read_kalibr(write(tmp_path / "chain.yaml", DS))
    assert found.rig.n_cameras == 1
    assert found.cameras == ("cam0",)
    assert found.notes == ()
    np.testing.assert_array_equal(found.rig.T_imu_cam0, np.eye(4))


def test_of_four_cameras_the_first_pair_or_the_named_one(tmp_path: Path) -> None:
    four = [DS, EUCM + "  rostopic: /eye/left\n", DS, EUCM + "  cam_overlaps: [3, 0]\n"]
    path = write(tmp_path / "chain.yaml", *four)
    found = read_kalibr_cameras(path)
    assert found.cameras == ("cam0", "cam1")
    (note,) = found.notes
    assert "4 cameras, of which cam0 is taken as the left and cam1 as the right" in note
    assert read_kalibr_cameras(path, "cam2", "cam1").cameras == ("cam2", "cam1")
    assert read_kalibr_cameras(path, "cam2").cameras == ("cam2", "cam3")
    assert read_kalibr_cameras(path, right="cam0").cameras == ("cam1", "cam0")
    assert read_kalibr_cameras(path, "/eye/left").cameras == ("cam1", "cam2")
    assert read_kalibr_cameras(path, "cam3").cameras == ("cam3", "cam0")
    assert read_kalibr_cameras(path, "cam2", "cam1").rig.baseline == pytest.approx(0.1)
    with pytest.raises(CalibrationError, match="both left and right"):
        read_kalibr_cameras(path, "cam2", "cam2")
    with pytest.raises(CalibrationError, match="'cam7': this key is missing"):
        read_kalibr_cameras(path, "cam7")


def test_a_camera_far_down_a_chain_is_placed_through_those_before_it(tmp_path: Path) -> None:
    path = write(tmp_path / "chain.yaml", DS, DS, DS)
    for k in (1, 2):
        text = path.read_text().replace(
            f"T_cam_imu: [[1, 0, 0, {-0.1 * k}]", "T_cn_cnm1: [[1, 0, 0, -0.3]"
        )
        path.write_text(text)
    found = read_kalibr_cameras(path, "cam0", "cam2").rig
    np.testing.assert_allclose(found.T_imu_cam1[:3, 3], [0.6, 0.0, 0.0], atol=1e-12)
