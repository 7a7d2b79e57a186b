"""Kalibr and EuRoC calibration files, good ones and broken ones."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.datasets.kalibr import read_kalibr
from ovmot.errors import CalibrationError

CHAIN = """\
%YAML:1.0 # need to specify the file type at the top!

cam0:
  T_imu_cam:
    - [0.0, 0.0, 1.0, 0.1]
    - [-1.0, 0.0, 0.0, 0.05]
    - [0.0, -1.0, 0.0, 0.0]
    - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.01, 1.0e-3, 2e-4]
  distortion_model: radtan
  intrinsics: [458.6, 457.2, 367.2, 248.3]
  resolution: [752, 480]
  timeshift_cam_imu: 0.005
cam1:
  T_cn_cnm1:
    - [1.0, 0.0, 0.0, -0.11]
    - [0.0, 1.0, 0.0, 0.0]
    - [0.0, 0.0, 1.0, 0.0]
    - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [457.5, 456.1, 379.9, 255.2]
  resolution: [752, 480]
"""
IMU = """\
%YAML:1.0
imu0:
  T_i_b:
    - [1.0, 0.0, 0.0, 0.0]
    - [0.0, 1.0, 0.0, 0.0]
    - [0.0, 0.0, 1.0, 0.0]
    - [0.0, 0.0, 0.0, 1.0]
  accelerometer_noise_density: 2e-3
  accelerometer_random_walk: 3.0000e-3
  gyroscope_noise_density: 1.6968e-04
  gyroscope_random_walk: 1.9393e-05
  update_rate: 200.0
"""


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    path = tmp_path / "kalibr_imucam_chain.yaml"
    path.write_text(CHAIN)
    return path


def test_chain_with_all_its_parts(chain: Path) -> None:
    (chain.parent / "kalibr_imu_chain.yaml").write_text(IMU)
    found = read_kalibr(chain.parent)
    rig = found.rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [0.1, 0.05, 0.0])
    np.testing.assert_allclose(rig.T_cam1_cam0[:3, 3], [-0.11, 0.0, 0.0], atol=1e-12)
    # the right camera stands to the right: towards -y of an IMU with x forward, y left
    np.testing.assert_allclose(rig.T_imu_cam1[:3, 3], [0.1, -0.06, 0.0], atol=1e-12)
    assert (rig.cam0.model.name, rig.cam1.model.name) == ("radtan", "equidistant")
    np.testing.assert_array_equal(rig.cam0.distortion, [-0.1, 0.01, 1e-3, 2e-4])
    assert (rig.cam0.width, rig.cam0.height) == (752, 480)
    assert rig.time_offset_s == 0.005
    assert found.imu_noise is not None
    assert (found.imu_noise.gyro, found.imu_noise.accel) == (1.6968e-4, 2e-3)


def test_pose_given_the_other_way_round(chain: Path) -> None:
    """Kalibr's T_cam_imu is the inverse of T_imu_cam; no IMU file means no noise."""
    inverse = (
        "T_cam_imu: [0.0, -1.0, 0.0, 0.05, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, -0.1, 0, 0, 0, 1]\n"
    )
    before, _, rest = CHAIN.partition("T_imu_cam:")
    _, _, after = rest.partition("    - [0.0, 0.0, 0.0, 1.0]\n")
    expected = read_kalibr(chain).rig.T_imu_cam0
    chain.write_text(before + inverse + after)
    found = read_kalibr(chain)
    np.testing.assert_allclose(found.rig.T_imu_cam0, expected, atol=1e-12)
    assert found.imu_noise is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  intrinsics: [458.6, 457.2, 367.2, 248.3]\n", "", "'cam0.intrinsics': this key is miss"),
        ("458.6, 457.2", "458.6", "expected 4 numbers"),
        ("458.6", ".nan", "'cam0.intrinsics': holds a number that is not finite"),
        ("458.6", "wide", "expected 4 numbers"),
        ("458.6", "0.0", "not positive"),
        ("model: radtan", "model: glass", "'cam0.distortion_model': unknown camera model 'glass'"),
        ("[-0.1, 0.01, 1.0e-3, 2e-4]", "[-0.1, 0.01]", "'cam0.distortion_coeffs': .*takes 4 or 5"),
        ("resolution: [752, 480]\n  timeshift", f"resolution: [{'9' * 25}, 480]\n  timeshift",
         "impossible camera: 1[0-9]+x480 pixels"),
        ("resolution: [752, 480]\n  timeshift", "resolution: [0, 480]\n  timeshift", "no image is"),
        ("[-1.0, 0.0, 0.0, 0.05]", "[-1.0, 0.5, 0.0, 0.05]", "'cam0.T_imu_cam': .*not a rotation"),
        ("[-1.0, 0.0, 0.0, 0.05]", "[1.0, 0.0, 0.0, 0.05]", "not a rotation"),
        ("[-1.0, 0.0, 0.0, 0.05]", "[-1.0, 0.0, 0.05]", "expected 4x4 numbers"),
        ("cam_overlaps: [1]\n  camera_model: pinhole", "camera_model: pin", "'pin' is not known"),
        ("cam_overlaps: [1]\n  camera_model: pinhole", "camera_model: omni", "expected 5 numbers"),
        ("cam_overlaps: [1]\n  camera_model: pinhole", "camera_model: ds", "expected 6 numbers"),
        ("T_cn_cnm1", "T_other", "'cam1.T_cn_cnm1': the pose .* is missing; add it"),
        ("-0.11]", "0.0]", "same place"),
        ("-0.11]", "-110.0]", "110 m apart .translations are in metres"),
        ("timeshift_cam_imu: 0.005", "timeshift_cam_imu: 1e300", "no clock is 1e.300 s off"),
        ("458.6, 457.2", "1e-9, 457.2", "cam0: no camera makes an image of 752x480 pixels"),
        ("458.6, 457.2", "1e12, 457.2", "cam0: no camera makes an image of 752x480 pixels"),
        ("[-0.1, 0.01, 1.0e-3", "[1e9, 0.01, 1.0e-3", "cam0: no camera makes an image"),
        ("timeshift_cam_imu: 0.005", "resolution: [752, 480]", "found 'resolution' twice"),
        ("camera_model: pinhole\n", "camera_model: [pinhole\n", "not valid YAML"),
        ("cam1:", "cam7:", "'cam1': this key is missing"),
        ("distortion_model: equidistant", "distortion_model: equidistant\n  timeshift_cam_imu: 1.0",
         "exposed together"),
    ],
)  # fmt: skip
def test_broken_chain_is_one_clear_line(chain: Path, old: str, new: str, message: str) -> None:
    assert old in CHAIN
    chain.write_text(CHAIN.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_kalibr(chain)
    assert str(chain) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_empty_chain(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no such calibration file"):
        read_kalibr(tmp_path)
    (tmp_path / "list.yaml").write_text("- 1\n- 2\n")
    with pytest.raises(CalibrationError, match="holds no keys"):
        read_kalibr(tmp_path / "list.yaml")


@pytest.mark.parametrize("value", ["0.0", "-1e-3", "1e20", ".inf", "loud"])
def test_impossible_noise_is_refused(chain: Path, value: str) -> None:
    (chain.parent / "kalibr_imu_chain.yaml").write_text(IMU.replace("2e-3", value))
    with pytest.raises(CalibrationError, match=r"imu0\.accelerometer_noise_density"):
        read_kalibr(chain)


def test_yaml_that_would_run_code_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "evil.yaml"
    path.write_text("cam0: !!python/object/apply:os.getcwd []\n")
    with pytest.raises(CalibrationError, match="not valid YAML"):
        read_kalibr(path)


def posed(chain: str, own: str) -> str:
    """The chain with a pose on the IMU for cam1 beside T_cn_cnm1, which it need not agree with."""
    return chain.replace("cam1:\n", f"cam1:\n  T_imu_cam: {own}\n")


# cam1 by T_cn_cnm1: 0.11 m to the right of cam0
AGREES = "[0,0,1,0.1, -1,0,0,-0.06, 0,-1,0,0.0003, 0,0,0,1]"
TURNED = "[0.0296,0,0.99956,0.1, -0.99956,0,0.0296,-0.032, 0,-1,0,0, 0,0,0,1]"


def test_two_poses_that_agree_are_none_to_speak_of(chain: Path) -> None:
    chain.write_text(posed(CHAIN, AGREES))
    found = read_kalibr(chain)
    assert found.notes == ()
    np.testing.assert_allclose(found.rig.T_imu_cam1[:3, 3], [0.1, -0.06, 0.0003], atol=1e-12)


def test_two_poses_that_contradict_each_other(chain: Path) -> None:
    """As in a published chain: 28 mm and 1.7 degrees; on its pictures T_cn_cnm1 was right."""
    chain.write_text(posed(CHAIN, TURNED))
    found = read_kalibr(chain)
    np.testing.assert_allclose(found.rig.T_cam1_cam0[:3, 3], [-0.11, 0.0, 0.0], atol=1e-12)
    (note,) = found.notes
    assert note.startswith(f"{chain}: cam1.T_imu_cam and cam1.T_cn_cnm1 differ by 28 mm and 1.7 d")
    assert "T_cn_cnm1 is used" in note


def without_imu(chain: str) -> str:
    before, _, rest = chain.partition("  T_imu_cam:")
    return before + rest.partition("    - [0.0, 0.0, 0.0, 1.0]\n")[2]


def test_a_chain_without_imu_serves_for_given_poses(chain: Path) -> None:
    chain.write_text(without_imu(CHAIN))
    with pytest.raises(
        CalibrationError, match=r"cam0\.T_cam_imu.*kalibr_calibrate_imu.*--ego poses"
    ):
        read_kalibr(chain)
    found = read_kalibr(chain, need_imu_pose=False)
    np.testing.assert_array_equal(found.rig.T_imu_cam0, np.eye(4))
    np.testing.assert_allclose(found.rig.T_cam1_cam0[:3, 3], [-0.11, 0.0, 0.0], atol=1e-12)
    assert "poses are those of the left camera" in found.notes[0]
    own = without_imu(CHAIN).replace("T_cn_cnm1", "T_imu_cam")
    chain.write_text(own)  # of which the left camera's place does not follow
    with pytest.raises(CalibrationError, match=r"'cam1\.T_cn_cnm1': this key is missing"):
        read_kalibr(chain, need_imu_pose=False)


def test_notes_are_warnings_of_the_sequence(chain: Path, euroc: Path) -> None:
    small = CHAIN.replace("[752, 480]", "[32, 24]")
    for old in ("458.6, 457.2, 367.2, 248.3", "457.5, 456.1, 379.9, 255.2"):
        small = small.replace(old, "20, 21, 16, 12")
    chain.write_text(posed(small, TURNED))
    assert "T_cn_cnm1 is used" in open_sequence(euroc, calibration=chain).warnings[0]


@pytest.mark.parametrize(
    ("key", "value"),
    [("gyroscope_noise_density: 1.6968e-04", "1.0"), ("accelerometer_random_walk: 3.0000e-3", "9")],
)
def test_noise_beyond_any_sensor_is_refused(chain: Path, key: str, value: str) -> None:
    name = key.partition(":")[0]
    assert key in IMU
    (chain.parent / "kalibr_imu_chain.yaml").write_text(IMU.replace(key, f"{name}: {value}"))
    with pytest.raises(CalibrationError, match=rf"imu0\.{name}': {value[0]}.* is not a noise dens"):
        read_kalibr(chain)


def test_a_principal_point_outside_the_image_is_refused(chain: Path) -> None:
    chain.write_text(CHAIN.replace("367.2, 248.3", "367.2, 648.3"))
    with pytest.raises(CalibrationError, match=r"cam0: the principal point .* outside the image"):
        read_kalibr(chain)


def test_a_translation_in_millimetres_is_refused(chain: Path) -> None:
    chain.write_text(CHAIN.replace("0.0, 1.0, 0.1]", "0.0, 1.0, 1710.0]"))
    with pytest.raises(CalibrationError) as found:
        read_kalibr(chain)
    told = "the left camera stands 1710 m from the IMU; translations are in metres"
    assert str(found.value) == f"{chain}: 'cam0.T_imu_cam': {told}"
    read_kalibr(chain, need_imu_pose=False)


def test_a_camera_file_of_ros_is_told_from_a_chain(chain: Path) -> None:
    chain.write_text("image_width: 640\ncamera_matrix: {rows: 3, cols: 3, data: [1, 0, 0]}\n")
    with pytest.raises(CalibrationError) as found:
        read_kalibr(chain)
    assert "is a ROS camera file of one camera; write both cameras into a chain" in str(found.value)
