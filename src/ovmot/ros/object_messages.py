"""The moving objects of a frame: a typed array for programs, markers for RViz and Foxglove."""

from collections.abc import Sequence

import numpy as np

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.palette import color_of
from ovmot.ros.values import Message, Value, header, point, pose, vector
from ovmot.types import ObjectTrack

STATES = {"tentative": 0, "confirmed": 1, "coasting": 2}
"""States of a track and their constants in `msg/Object.msg`."""

_CUBE, _ARROW, _TEXT, _ADD, _DELETE_ALL = 1, 0, 9, 0, 3
_OPACITY = {"tentative": 0.2, "confirmed": 0.6, "coasting": 0.3}
_LEAST_SIZE_M = 0.05  # RViz does not draw a box without an extent
_TEXT_HEIGHT_M = 0.6
_SHAFT_M, _HEAD_M = 0.12, 0.3
_LEAST_ARROW_MPS = 0.1  # a shorter arrow has no direction


def object_array(timestamp_ns: int, frame: str, tracks: Sequence[ObjectTrack]) -> Message:
    """`ovmot_msgs/ObjectArray`: every track, the tentative ones included."""
    return Message(
        "ovmot_msgs/ObjectArray",
        {
            "header": header(timestamp_ns, frame),
            "objects": tuple(_object(track) for track in tracks),
        },
    )


def _object(track: ObjectTrack) -> Message:
    return Message(
        "ovmot_msgs/Object",
        {
            "id": track.track_id,
            "state": STATES[track.state],
            "pose": pose(_pose(track)),
            "size": vector(track.size),
            "velocity": vector(track.velocity),
            "yaw": float(track.yaw),
            "yaw_rate": float(track.yaw_rate),
            "std_position": vector(track.std_position),
            "std_velocity": vector(track.std_velocity),
            "box_px": track.box_px.astype(np.float64),
            "n_points": track.n_points,
        },
    )


def markers(timestamp_ns: int, frame: str, tracks: Sequence[ObjectTrack]) -> Message:
    """`visualization_msgs/MarkerArray`: a box, a velocity arrow (1 s long), id and speed of each.

    The first marker deletes those of the frame before.
    """
    at = header(timestamp_ns, frame)
    drawn = [Message("visualization_msgs/Marker", {"header": at, "action": _DELETE_ALL})]
    for track in tracks:
        drawn += [_box(at, track), _label(at, track)]
        if np.linalg.norm(track.velocity) >= _LEAST_ARROW_MPS:
            drawn.append(_arrow(at, track))
    return Message("visualization_msgs/MarkerArray", {"markers": tuple(drawn)})


def _box(at: Message, track: ObjectTrack) -> Message:
    size = np.maximum(np.nan_to_num(track.size), _LEAST_SIZE_M)
    shape: dict[str, Value] = {"type": _CUBE, "pose": pose(_pose(track)), "scale": vector(size)}
    return _marker(at, track, "boxes", shape)


def _arrow(at: Message, track: ObjectTrack) -> Message:
    ends = (point(track.position), point(track.position + track.velocity))
    scale = vector(np.array([_SHAFT_M, _HEAD_M, 0.0]))
    shape: dict[str, Value] = {
        "type": _ARROW,
        "points": ends,
        "pose": pose(np.eye(4)),
        "scale": scale,
    }
    return _marker(at, track, "velocities", shape)


def _label(at: Message, track: ObjectTrack) -> Message:
    T = se3.make(np.eye(3), track.position)
    T[2, 3] += 0.5 * float(np.nan_to_num(track.size[2])) + _TEXT_HEIGHT_M
    speed = float(np.linalg.norm(track.velocity))
    scale = vector(np.array([0.0, 0.0, _TEXT_HEIGHT_M]))
    shape: dict[str, Value] = {
        "type": _TEXT,
        "pose": pose(T),
        "scale": scale,
        "text": f"{track.track_id}: {speed:.1f} m/s",
    }
    return _marker(at, track, "ids", shape)


def _marker(at: Message, track: ObjectTrack, namespace: str, shape: dict[str, Value]) -> Message:
    blue, green, red = (channel / 255.0 for channel in color_of(track.track_id))
    opacity = _OPACITY[track.state] if namespace == "boxes" else 1.0
    color = Message("std_msgs/ColorRGBA", {"r": red, "g": green, "b": blue, "a": opacity})
    fields: dict[str, Value] = {
        "header": at,
        "ns": namespace,
        "id": track.track_id,
        "action": _ADD,
        "color": color,
        **shape,
    }
    return Message("visualization_msgs/Marker", fields)


def _pose(track: ObjectTrack) -> FloatArray:
    """The box in the world (4, 4), turned about z by the yaw; by 0 where the yaw is unknown."""
    yaw = float(np.nan_to_num(track.yaw))
    cos, sin = np.cos(yaw), np.sin(yaw)
    R = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return se3.make(R, track.position)
