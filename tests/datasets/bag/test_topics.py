"""Which topics of a bag are the cameras and the IMU."""

from pathlib import Path

import pytest
from bag_fixtures import (
    COMPRESSED,
    IMAGE,
    IMU,
)

from ovmot.datasets.bag.topics import BagTopics, find_topics, without_imu
from ovmot.errors import InputError


@pytest.mark.parametrize(
    ("images", "asked", "expected"),
    [
        (["/b/left", "/a/right"], {"left": "/b/left"}, ("/b/left", "/a/right")),
        (["/cam1/raw", "/cam0/raw"], {}, ("/cam0/raw", "/cam1/raw")),
        (["/r/left/x", "/r/right/x"], {}, ("/r/left/x", "/r/right/x")),
        (["/a", "/b", "/c"], {"left": "/c", "right": "a"}, ("/c", "/a")),
        (["/a", "/a/compressed", "/b", "/b/compressed"], {}, ("/a", "/b")),
        (
            ["/a", "/a/compressed", "/b", "/b/compressed"],
            {"left": "/a/compressed", "right": "/b/compressed"},
            ("/a/compressed", "/b/compressed"),
        ),
        (["/a/compressed", "/b/compressed"], {}, ("/a/compressed", "/b/compressed")),
    ],
)
def test_cameras_are_found_by_type(
    images: list[str], asked: dict[str, str], expected: tuple[str, str]
) -> None:
    types = {t: COMPRESSED if t.endswith("compressed") else IMAGE for t in images}
    found = find_topics(Path("x.bag"), {**types, "/imu": IMU, "/x": "y/Z"}, BagTopics(**asked))
    assert (found.left, found.right, found.imu) == (*expected, "/imu")


@pytest.mark.parametrize(
    ("types", "asked", "complaint"),
    [
        (
            {"/a": IMAGE, "/b": IMAGE, "/c": IMAGE},
            {},
            "x.bag: holds 3 image topics: /a, /b, /c; choose with --left TOPIC --right TOPIC",
        ),
        (
            {"/a": IMAGE, "/b": IMAGE, "/c": IMAGE},
            {"left": "/b"},
            "x.bag: holds 3 image topics: /a, /b, /c; choose with --right TOPIC",
        ),
        ({"/a": IMAGE}, {"right": "/a"}, "x.bag: holds 1 image topics: /a; two cameras are needed"),
        ({"/imu": IMU}, {}, "x.bag: holds no image topics"),
        (
            {"/a": IMAGE, "/b": IMAGE},
            {"right": "/d"},
            "x.bag: no image topic /d (--right); there are: /a, /b",
        ),
        ({"/a": IMAGE, "/b": IMAGE}, {"left": "/a", "right": "/a"}, "left and right are both /a"),
        (
            {"/a": IMAGE, "/b": IMAGE, "/i": IMU, "/j": IMU},
            {},
            "x.bag: holds 2 IMU topics: /i, /j; choose with --imu TOPIC",
        ),
        ({"/a": IMAGE, "/b": IMAGE}, {"imu": "/i"}, "no IMU topic /i (--imu); it has no IMU"),
    ],
)
def test_what_is_not_clear_is_asked(
    types: dict[str, str], asked: dict[str, str], complaint: str
) -> None:
    with pytest.raises(InputError) as found:
        find_topics(Path("x.bag"), types, BagTopics(**asked))
    assert complaint in str(found.value)


def test_the_topics_of_a_bag_without_imu_are_listed() -> None:
    types = {f"/topic{k}": "sensor_msgs/Image" for k in range(14)}
    told = without_imu(types)
    assert "only /topic0 (sensor_msgs/Image), /topic1" in told
    assert "2 more: record the IMU, or give the ego motion by --ego poses FILE" in told
    assert "/topic12" not in told
