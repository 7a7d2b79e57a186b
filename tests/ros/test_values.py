"""Values of messages: stamps, poses, images, clouds of points."""

import numpy as np

from ovmot.geometry import se3
from ovmot.ros.values import Message, image, point_cloud, pose, transform

STAMP_NS = 1_700_000_000_123_456_789


def test_a_pose_is_a_point_and_a_unit_quaternion() -> None:
    T = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
    made = pose(T)
    place, turn = made.fields["position"], made.fields["orientation"]
    assert isinstance(place, Message) and isinstance(turn, Message)
    assert [place.fields[c] for c in "xyz"] == T[:3, 3].tolist()
    xyzw = np.array([turn.fields[c] for c in "xyzw"])
    assert np.linalg.norm(xyzw) - 1.0 < 1e-12
    edge = transform(STAMP_NS, "world", "imu", T)
    assert edge.fields["child_frame_id"] == "imu"


def test_images_keep_their_bytes() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    made = image(STAMP_NS, "cam0", grey[:, ::-1])
    assert (made.fields["height"], made.fields["width"], made.fields["step"]) == (3, 4, 4)
    assert made.fields["encoding"] == "mono8"
    np.testing.assert_array_equal(made.fields["data"], grey[:, ::-1].ravel())
    colour = image(STAMP_NS, "cam0", np.zeros((3, 4, 3), dtype=np.uint8))
    assert (colour.fields["encoding"], colour.fields["step"]) == ("bgr8", 12)


def test_a_cloud_names_its_fields() -> None:
    points = np.zeros(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("id", "<u4")])
    made = point_cloud(STAMP_NS, "world", points)
    fields = made.fields["fields"]
    assert isinstance(fields, tuple)
    assert [f.fields["name"] for f in fields if isinstance(f, Message)] == ["x", "y", "z", "id"]
    assert (made.fields["width"], made.fields["point_step"]) == (5, 16)
