"""Messages of a frame: values, frames and covariances, and that both ROS versions take them."""

from dataclasses import replace
from typing import Any

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.ros import messages
from ovmot.ros.messages import FrameNames, PathSoFar, frame_messages
from ovmot.ros.typestore import filled, rosbags_name, typestore
from ovmot.ros.values import Message
from ovmot.types import FrameResult, PointLabel


def by_topic(result: FrameResult, rig: StereoRig) -> dict[str, Message]:
    made = frame_messages(result, PathSoFar().extended(result), rig)
    return {published.topic: published.message for published in made}


def through(version: int, message: Message) -> Any:
    """The message written and read again by the wire format of one ROS version."""
    store, name = typestore(version), rosbags_name(message.type_name)
    if version == 1:
        return store.deserialize_ros1(store.serialize_ros1(filled(store, message), name), name)
    return store.deserialize_cdr(store.serialize_cdr(filled(store, message), name), name)


def test_pose_covariance_is_that_of_errors_in_the_world(result: FrameResult) -> None:
    ego = result.ego
    R = ego.T_world_imu[:3, :3]

    def ros_error(delta: np.ndarray) -> np.ndarray:
        rotation = so3.log(R @ so3.exp(delta[:3]) @ R.T)
        return np.concatenate([delta[3:6], rotation])

    jacobian = finite_differences(ros_error, 6)
    expected = jacobian @ ego.covariance[:6, :6] @ jacobian.T
    assert np.allclose(messages.pose_covariance(ego), expected, rtol=1e-5, atol=1e-9)


def test_twist_covariance_is_that_of_the_velocity_in_the_imu(result: FrameResult) -> None:
    ego = result.ego
    R = ego.T_world_imu[:3, :3]

    def velocity(delta: np.ndarray) -> np.ndarray:
        return np.asarray((R @ so3.exp(delta[:3])).T @ (ego.velocity + delta[6:9]))

    jacobian = finite_differences(velocity, 9)
    expected = jacobian @ ego.covariance[:9, :9] @ jacobian.T
    assert np.allclose(messages.twist_covariance(ego)[:3, :3], expected, rtol=1e-5, atol=1e-9)


def finite_differences(function: Any, size: int, step: float = 1e-6) -> np.ndarray:
    columns = [
        (function(step * unit) - function(-step * unit)) / (2 * step) for unit in np.eye(size)
    ]
    return np.array(columns).T


def test_what_is_not_known_has_a_large_variance_and_no_nan(result: FrameResult) -> None:
    nan = np.full(3, np.nan)
    ego = replace(result.ego, velocity=nan, covariance=np.full((15, 15), np.nan))
    odometry = through(2, messages.odometry(ego, FrameNames()))
    expected = np.diag([messages.UNKNOWN_VARIANCE] * 6)
    assert np.array_equal(odometry.twist.covariance.reshape(6, 6), expected)
    assert np.array_equal(odometry.pose.covariance.reshape(6, 6), expected)
    assert odometry.twist.twist.linear.x == 0.0


def test_transforms_lead_from_the_world_to_the_cameras(result: FrameResult) -> None:
    edges = through(2, messages.transforms(result.ego, FrameNames(), with_cameras=True)).transforms
    assert [(e.header.frame_id, e.child_frame_id) for e in edges] == [
        ("world", "imu"),
        ("imu", "cam0"),
        ("imu", "cam1"),
    ]
    q, t = edges[1].transform.rotation, edges[1].transform.translation
    R = so3.from_quaternion(np.array([q.x, q.y, q.z, q.w]))
    assert np.allclose(se3.make(R, np.array([t.x, t.y, t.z])), result.ego.T_imu_cam0)


def test_points_are_in_the_world_and_apart_by_label(result: FrameResult) -> None:
    cloud = through(1, messages.points(result, (PointLabel.DYNAMIC,), FrameNames()))
    assert (cloud.width, cloud.point_step, [f.name for f in cloud.fields]) == (
        1,
        20,
        ["x", "y", "z", "id", "track_id"],
    )
    xyz = np.frombuffer(cloud.data[:12].tobytes(), dtype="<f4")
    T_world_cam0 = result.ego.T_world_imu @ result.ego.T_imu_cam0
    assert np.allclose(xyz, se3.apply(T_world_cam0, result.points.p_cam0[1]), atol=1e-5)
    assert np.frombuffer(cloud.data[12:].tobytes(), dtype="<i4").tolist() == [101, 7]
    static = through(1, messages.points(result, (PointLabel.STATIC,), FrameNames()))
    assert static.width == 1  # the second static point has no depth


def test_the_path_stays_whole_and_bounded(result: FrameResult) -> None:
    path = PathSoFar()
    steps = 3 * PathSoFar.MOST
    for i in range(steps):
        T = se3.make(np.eye(3), np.array([0.2 * i, 0.0, 0.0]))
        ego = replace(result.ego, T_world_imu=T)
        path = path.extended(replace(result, ego=ego))
    assert PathSoFar.MOST / 2 < len(path.poses) <= PathSoFar.MOST + 1
    along = [T[0, 3] for _, T in path.poses]
    assert along[0] == 0.0 and along[-1] > 0.2 * steps - 1.0
    assert len(path.extended(replace(result, segment=1)).poses) == 1


def test_cameras_that_are_not_estimated_are_latched_at_the_start_of_a_segment(
    result: FrameResult, rig_of_result: StereoRig
) -> None:
    path = PathSoFar().extended(result)
    first = by_topic(result, rig_of_result)
    latched = [edge.fields["child_frame_id"] for edge in edges_of(first[messages.TF_STATIC])]
    assert latched == ["cam0", "cam1"] and len(edges_of(first[messages.TF])) == 1
    assert messages.TF_STATIC in messages.LATCHED
    ego = replace(result.ego, timestamp_ns=result.timestamp_ns + 1)
    later = replace(result, frame=replace(result.frame, timestamp_ns=ego.timestamp_ns), ego=ego)
    topics = {p.topic for p in frame_messages(later, path.extended(later), rig_of_result)}
    assert messages.TF in topics and messages.TF_STATIC not in topics


def test_cameras_that_are_estimated_come_with_each_frame(
    result: FrameResult, rig_of_result: StereoRig
) -> None:
    shifted = rig_of_result.T_imu_cam1.copy()
    shifted[0, 3] += 1e-4
    made = by_topic(result, replace(rig_of_result, T_imu_cam1=shifted))
    assert messages.TF_STATIC not in made and len(edges_of(made[messages.TF])) == 3


def edges_of(message: Message) -> Any:
    return message.fields["transforms"]
