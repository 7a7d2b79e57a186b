"""The result of a frame as ROS messages: pure functions, for bags and live nodes.

    path = PathSoFar()
    for result in odometry.add(event):
        path = path.extended(result)
        for published in frame_messages(result, path, rig): ...  # its topic and message

Frames and units are those of docs/conventions.md, which are also ROS's (REP 103, REP 105).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.ros.object_messages import markers, object_array
from ovmot.ros.values import (
    Message,
    Published,
    header,
    jpeg,
    point_cloud,
    pose,
    transform,
    vector,
)
from ovmot.types import EgoEstimate, FrameResult, PointLabel

ODOMETRY, PATH = "/ovmot/odometry", "/ovmot/path"
TF, TF_STATIC = "/tf", "/tf_static"
STATIC_POINTS, DYNAMIC_POINTS = "/ovmot/points/static", "/ovmot/points/dynamic"
OBJECTS, MARKERS = "/ovmot/objects", "/ovmot/objects/markers"
OVERLAY = "/ovmot/overlay/compressed"
"""As image_transport calls the compressed form of `/ovmot/overlay`."""

TOPICS = {
    ODOMETRY: "nav_msgs/Odometry",
    PATH: "nav_msgs/Path",
    TF: "tf2_msgs/TFMessage",
    TF_STATIC: "tf2_msgs/TFMessage",
    STATIC_POINTS: "sensor_msgs/PointCloud2",
    DYNAMIC_POINTS: "sensor_msgs/PointCloud2",
    OBJECTS: "ovmot_msgs/ObjectArray",
    MARKERS: "visualization_msgs/MarkerArray",
    OVERLAY: "sensor_msgs/CompressedImage",
}
"""Every topic and its type."""

LATCHED = (TF_STATIC,)
"""Topics whose last message is for those, too, who listen later."""

UNKNOWN_VARIANCE = 1e6
"""Of what is not estimated: ROS has no word for it, and NaN stops its tools."""

_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("id", "<i4"), ("track_id", "<i4")])


@dataclass(frozen=True, slots=True)
class FrameNames:
    """What the coordinate frames are called in messages."""

    world: str = "world"
    imu: str = "imu"
    cam0: str = "cam0"
    cam1: str = "cam1"


@dataclass(frozen=True, slots=True)
class PathSoFar:
    """The path of the IMU in one segment, at most `MOST` poses: times (ns) and poses (4, 4).

    Poses nearer than `spacing_m` to the last one kept are left out; when there are too many, every
    second one goes and the spacing doubles. So the whole way stays, and no message grows for ever.
    """

    MOST = 1000

    segment: int = 0
    spacing_m: float = 0.1
    poses: tuple[tuple[int, FloatArray], ...] = ()

    def extended(self, result: FrameResult) -> "PathSoFar":
        """The path with a further frame; a new one after a restart of the filter."""
        new = (result.timestamp_ns, result.ego.T_world_imu)
        if result.segment != self.segment or not self.poses:
            return PathSoFar(result.segment, poses=(new,))
        step_m = float(np.linalg.norm(new[1][:3, 3] - self.poses[-1][1][:3, 3]))
        if step_m < self.spacing_m:
            return self
        if len(self.poses) < self.MOST:
            return PathSoFar(self.segment, self.spacing_m, (*self.poses, new))
        return PathSoFar(self.segment, 2.0 * self.spacing_m, (*self.poses[::2], new))


def frame_messages(
    result: FrameResult,
    path: PathSoFar,
    rig: StereoRig,
    names: FrameNames = FrameNames(),
) -> list[Published]:
    """All messages of one frame but the overlay; `path` has been extended by `result`.

    `rig`: that of the calibration files. The cameras' transforms are latched with the first frame
    of a segment where they are the rig's; where they are estimated, `/tf` has them each time.
    """
    stamp, world = result.timestamp_ns, names.world
    shown = [track for track in result.tracks if track.state != "tentative"]
    fixed = cameras_are_fixed(result.ego, rig)
    begins = path.poses[0][0] == stamp
    made = {TF_STATIC: fixed_transforms(result.ego, names)} if fixed and begins else {}
    made |= {
        ODOMETRY: odometry(result.ego, names),
        PATH: path_message(stamp, path, names),
        TF: transforms(result.ego, names, with_cameras=not fixed),
        STATIC_POINTS: points(result, (PointLabel.STATIC,), names),
        DYNAMIC_POINTS: points(result, (PointLabel.DYNAMIC,), names),
        OBJECTS: object_array(stamp, world, result.tracks),
        MARKERS: markers(stamp, world, shown),
    }
    return [Published(topic, message) for topic, message in made.items()]


def overlay_message(
    timestamp_ns: int,
    overlay: Image,
    names: FrameNames = FrameNames(),
) -> Published:
    """The overlay (height, width, 3), blue-green-red."""
    return Published(OVERLAY, jpeg(timestamp_ns, names.cam0, overlay))


def odometry(ego: EgoEstimate, names: FrameNames) -> Message:
    """Pose of the IMU in the world; velocity in the IMU's axes, as ROS wants a twist.

    The covariances are ROS's: position before rotation, the rotation about the axes of the
    world. The filter does not estimate the angular velocity: 0 with `UNKNOWN_VARIANCE`.
    """
    velocity = ego.T_world_imu[:3, :3].T @ ego.velocity
    known = np.all(np.isfinite(velocity))
    linear = vector(velocity if known else np.zeros(3))
    twist = Message("geometry_msgs/Twist", {"linear": linear, "angular": vector(np.zeros(3))})
    of_pose, of_twist = (
        _finite(covariance).reshape(36)
        for covariance in (pose_covariance(ego), twist_covariance(ego))
    )
    return Message(
        "nav_msgs/Odometry",
        {
            "header": header(ego.timestamp_ns, names.world),
            "child_frame_id": names.imu,
            "pose": Message(
                "geometry_msgs/PoseWithCovariance",
                {"pose": pose(ego.T_world_imu), "covariance": of_pose},
            ),
            "twist": Message(
                "geometry_msgs/TwistWithCovariance", {"twist": twist, "covariance": of_twist}
            ),
        },
    )


def pose_covariance(ego: EgoEstimate) -> FloatArray:
    """(6, 6) over position and rotation in the world's axes; NaN where it is not known.

    exp(φ) R = R exp(δθ) for φ = R δθ: the filter's right perturbation turned into the world.
    """
    to_ros = np.zeros((6, 6))
    to_ros[:3, 3:] = np.eye(3)
    to_ros[3:, :3] = ego.T_world_imu[:3, :3]
    return np.asarray(to_ros @ ego.covariance[:6, :6] @ to_ros.T)


def twist_covariance(ego: EgoEstimate) -> FloatArray:
    """(6, 6) over velocity in the IMU's axes and angular velocity, NaN where it is not known.

    v_imu = Rᵀ v, so δv_imu = Rᵀ δv + [v_imu]x δθ for a right perturbation δθ of R.
    """
    R = ego.T_world_imu[:3, :3]
    jacobian = np.hstack([so3.hat(R.T @ ego.velocity), np.zeros((3, 3)), R.T])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = jacobian @ ego.covariance[:9, :9] @ jacobian.T
    covariance[3:, 3:] = np.diag([np.nan] * 3)
    return covariance


def path_message(timestamp_ns: int, path: PathSoFar, names: FrameNames) -> Message:
    poses = tuple(
        Message(
            "geometry_msgs/PoseStamped",
            {"header": header(stamp, names.world), "pose": pose(T_world_imu)},
        )
        for stamp, T_world_imu in path.poses
    )
    return Message("nav_msgs/Path", {"header": header(timestamp_ns, names.world), "poses": poses})


def cameras_are_fixed(ego: EgoEstimate, rig: StereoRig) -> bool:
    """Are the cameras where the calibration files have them: are they not estimated?"""
    left = np.array_equal(ego.T_imu_cam0, rig.T_imu_cam0)
    return bool(left and np.array_equal(ego.T_imu_cam1, rig.T_imu_cam1))


def transforms(ego: EgoEstimate, names: FrameNames, *, with_cameras: bool) -> Message:
    """world -> imu and, where they are estimated, imu -> cam0, cam1."""
    imu = transform(ego.timestamp_ns, names.world, names.imu, ego.T_world_imu)
    cameras = _camera_transforms(ego, names) if with_cameras else ()
    return Message("tf2_msgs/TFMessage", {"transforms": (imu, *cameras)})


def fixed_transforms(ego: EgoEstimate, names: FrameNames) -> Message:
    """imu -> cam0, cam1."""
    return Message("tf2_msgs/TFMessage", {"transforms": _camera_transforms(ego, names)})


def _camera_transforms(ego: EgoEstimate, names: FrameNames) -> tuple[Message, ...]:
    return (
        transform(ego.timestamp_ns, names.imu, names.cam0, ego.T_imu_cam0),
        transform(ego.timestamp_ns, names.imu, names.cam1, ego.T_imu_cam1),
    )


def points(result: FrameResult, labels: Iterable[PointLabel], names: FrameNames) -> Message:
    """The frame's stereo points with one of these labels, in the world: x, y, z, id, track_id."""
    seen, ego = result.points, result.ego
    chosen = np.isin(seen.label, list(labels)) & np.all(np.isfinite(seen.p_cam0), axis=1)
    p_world = se3.apply(ego.T_world_imu @ ego.T_imu_cam0, seen.p_cam0[chosen])
    packed = np.zeros(len(p_world), dtype=_POINT)
    packed["x"], packed["y"], packed["z"] = p_world.T
    packed["id"] = seen.feature_id[chosen]
    packed["track_id"] = seen.track_id[chosen]
    return point_cloud(result.timestamp_ns, names.world, packed)


def _finite(covariance: FloatArray) -> FloatArray:
    """The matrix; a coordinate with anything unknown gets `UNKNOWN_VARIANCE` and no correlation."""
    unknown = ~np.isfinite(np.diag(covariance))
    out = np.where(unknown[:, None] | unknown[None, :], 0.0, covariance)
    out[unknown, unknown] = UNKNOWN_VARIANCE
    return out
