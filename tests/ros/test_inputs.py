"""The topics of a live node, and what is said of one where nothing comes."""

from pathlib import Path

import pytest

from ovmot.errors import InputError
from ovmot.ros.inputs import InputTopic, input_topics, live_calibration, why_silent
from ovmot.settings import LiveSettings

LEFT = InputTopic("/left", "sensor_msgs/Image")


def test_topics_have_full_names_and_the_types_that_their_names_tell() -> None:
    live = LiveSettings(left="left/compressed", right="right", imu="imu")
    topics = input_topics(live, lambda name: f"/car/{name}")
    assert topics == {
        "left": InputTopic("/car/left/compressed", "sensor_msgs/CompressedImage"),
        "right": InputTopic("/car/right", "sensor_msgs/Image"),
        "imu": InputTopic("/car/imu", "sensor_msgs/Imu"),
    }
    assert topics["left"].is_compressed and not topics["right"].is_compressed


@pytest.mark.parametrize(
    ("published", "said"),
    [
        ({"/left": "sensor_msgs/Image"}, "it is published, but nothing comes"),
        ({"/left": "std_msgs/String"}, "it is a std_msgs/String, expected is sensor_msgs/Image"),
        ({"/imu": "sensor_msgs/Imu"}, "nobody publishes it, nor any other sensor_msgs/Image"),
        (
            {
                "/b": "sensor_msgs/Image",
                "/ovmot/overlay": "sensor_msgs/Image",
                "/a": "sensor_msgs/Image",
                "/c": "sensor_msgs/CompressedImage",
            },
            "nobody publishes it; topics of sensor_msgs/Image: /a, /b",
        ),
    ],
)
def test_why_nothing_comes(published: dict[str, str], said: str) -> None:
    assert why_silent(LEFT, published) == said


def test_no_calibration_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--calibration FILE"):
        live_calibration(None)
    with pytest.raises(InputError, match="no such calibration file"):
        live_calibration(tmp_path / "chain.yaml")


def test_a_folder_of_data_is_a_calibration(painted_euroc: Path) -> None:
    assert live_calibration(painted_euroc).rig.cam0.width > 0


def test_a_calibration_of_one_camera_is_refused(tmp_path: Path) -> None:
    (tmp_path / "chain.yaml").write_text(
        "cam0:\n  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
        "  camera_model: ds\n  intrinsics: [-0.2, 0.6, 150.0, 150.0, 255.0, 255.0]\n"
        "  resolution: [512, 512]\n"
    )
    with pytest.raises(InputError, match="has one camera, a live node needs two"):
        live_calibration(tmp_path / "chain.yaml")
