"""What calibration files have in common: checked numbers, errors that name the key."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.datasets.calibration import CalibrationNode, make_rig, read_imu_noise
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

FILE = Path("rig.yaml")


def node(**data: object) -> CalibrationNode:
    return CalibrationNode(FILE, "cam0", data)


def test_numbers_come_nested_flat_or_as_opencv_writes_them() -> None:
    expected = np.arange(6.0).reshape(2, 3)
    matrix = {"rows": 2, "cols": 3, "data": [*range(6)]}
    for value in (expected.tolist(), expected.ravel().tolist(), matrix):
        np.testing.assert_array_equal(node(K=value).numbers("K", (2, 3)), expected)
    assert node(f="2e-3").number("f") == 2e-3  # YAML takes it for text


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1, 2], "expected 3 numbers, found"),
        ([1, 2, "x"], "expected 3 numbers"),
        ([1, 2, "nan"], "not finite"),
        (None, "this key is missing; add it"),
    ],
)
def test_an_error_names_file_and_key(value: object, message: str) -> None:
    with pytest.raises(CalibrationError, match=rf"rig\.yaml: 'cam0\.p': .*{message}"):
        node(p=value).numbers("p", (3,))


def test_a_transform_is_a_rigid_motion() -> None:
    T = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
    rounded = np.round(T, 6)
    np.testing.assert_allclose(node(T=rounded.tolist()).transform("T"), T, atol=1e-6)
    flipped = np.diag([1.0, 1.0, -1.0, 1.0])
    for wrong in (flipped, T + np.diag([0.0, 0.0, 0.0, 1.0])):
        with pytest.raises(CalibrationError, match=r"'cam0\.T'"):
            node(T=wrong.tolist()).transform("T")


@pytest.mark.parametrize("name", ["radtan", "radial-tangential", "plumb_bob", " RadTan "])
def test_camera_models_have_several_names(name: str) -> None:
    assert node(model=name).camera_model("model") == "radtan"
    with pytest.raises(CalibrationError, match="unknown camera model 'omni'; known: radtan"):
        node(model="omni").camera_model("model")


def test_noise_densities_are_positive() -> None:
    keys = ("gyroscope_noise_density", "gyroscope_random_walk", "accelerometer_noise_density",
            "accelerometer_random_walk")  # fmt: skip
    noise = read_imu_noise(node(**dict.fromkeys(keys, 0.01)))
    assert (noise.gyro, noise.accel_walk) == (0.01, 0.01)
    with pytest.raises(CalibrationError, match="is not a noise density"):
        read_imu_noise(node(**{**dict.fromkeys(keys, 0.01), keys[1]: 0.0}))


def test_a_rig_that_sees_nothing_is_refused() -> None:
    T_right = se3.make(np.eye(3), np.array([0.1, 0.0, 0.0]))
    good = Camera.make((640, 480), (400.0, 400.0), (320.0, 240.0))
    assert make_rig(FILE, (good, good), (np.eye(4), T_right), 0.01).time_offset_s == 0.01
    narrow = Camera.make((640, 480), (1e9, 1e9), (320.0, 240.0))
    with pytest.raises(CalibrationError, match=r"rig\.yaml: cam1: no camera makes an image"):
        make_rig(FILE, (good, narrow), (np.eye(4), T_right))
    with pytest.raises(CalibrationError, match=r"rig\.yaml: the two cameras .* same place"):
        make_rig(FILE, (good, good), (np.eye(4), np.eye(4)))
