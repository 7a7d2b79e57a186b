"""The tables of a run: poses, state, its covariance, points, stereo matches, object tracks, timing.

Lengths are in metres, speeds in m/s, angles in rad. A field without a value (NaN) is empty.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.rows import RowFile, format_rows
from ovmot.types import EgoEstimate, FrameResult, PointLabel

_LABELS = {int(label): label.name.lower() for label in PointLabel}
_NAV_STATE = ("rx", "ry", "rz", "x", "y", "z", "vx", "vy", "vz")


class TrajectoryTable:
    """`trajectory.tum`: stamp in seconds, position and quaternion of the IMU in the world."""

    def __init__(self, path: Path) -> None:
        self._file = RowFile(path)

    def write(self, result: FrameResult) -> None:
        pose = _position_quaternion(result.ego.T_world_imu)
        fields = (ns_to_seconds(result.timestamp_ns), *pose)
        self._file.append(format_rows("%s" + " %.9f" * 7, [fields]))

    def close(self) -> None:
        self._file.close()


class StateTable:
    """`state.csv`: the filter's state at every frame and the standard deviation of each part.

    `T_imu_cam0` and `T_imu_cam1` are written as position and quaternion, the second one only for a
    rig of two cameras; the deviation of the rotation is that of its right perturbation, in rad.
    """

    columns = (
        "timestamp_ns,x,y,z,qx,qy,qz,qw,vx,vy,vz,"
        "gyro_bias_x,gyro_bias_y,gyro_bias_z,accel_bias_x,accel_bias_y,accel_bias_z,"
        "time_offset_s,"
        "imu_cam0_x,imu_cam0_y,imu_cam0_z,imu_cam0_qx,imu_cam0_qy,imu_cam0_qz,imu_cam0_qw,"
        "imu_cam1_x,imu_cam1_y,imu_cam1_z,imu_cam1_qx,imu_cam1_qy,imu_cam1_qz,imu_cam1_qw,"
        "standing,std_rotation_x,std_rotation_y,std_rotation_z,"
        "std_x,std_y,std_z,std_vx,std_vy,std_vz,"
        "std_gyro_bias_x,std_gyro_bias_y,std_gyro_bias_z,"
        "std_accel_bias_x,std_accel_bias_y,std_accel_bias_z,std_time_offset_s,"
        "segment,health"
    )
    _row = "%d" + ",%.9f" * 31 + ",%d" + ",%.9f" * 16 + ",%d,%s"

    def __init__(self, path: Path, n_cameras: int = 2) -> None:
        self._file = RowFile(path, self.columns + "\n")
        self._n_cameras = n_cameras

    def write(self, result: FrameResult) -> None:
        ego = result.ego
        if self._n_cameras == 1:  # its pose is a placeholder
            ego = replace(ego, T_imu_cam1=np.full((4, 4), np.nan))
        fields = (result.timestamp_ns, *_state_fields(ego), result.segment, ego.health.value)
        self._file.append(format_rows(self._row, [fields]))

    def close(self) -> None:
        self._file.close()


class CovarianceTable:
    """`covariance.csv`: the covariance of rotation, position and velocity at every frame.

    The upper triangle, row by row, of the 9x9 matrix over rotation (right perturbation, rad; rx,
    ry, rz), position (m, in the world; x, y, z) and velocity (m/s; vx, vy, vz). Consistency (NEES)
    needs the correlations, which the deviations in `state.csv` leave out.
    """

    columns = ",".join(
        ("timestamp_ns", *(f"cov_{a}_{b}" for a, b in combinations_with_replacement(_NAV_STATE, 2)))
    )
    _row = "%d" + ",%.9e" * 45
    _upper = np.triu_indices(len(_NAV_STATE))

    def __init__(self, path: Path) -> None:
        self._file = RowFile(path, self.columns + "\n")

    def write(self, result: FrameResult) -> None:
        fields = (result.timestamp_ns, *result.ego.covariance[:9, :9][self._upper].tolist())
        self._file.append(format_rows(self._row, [fields]))

    def close(self) -> None:
        self._file.close()


class CalibrationTable:
    """`calibration.csv`: the calibration estimated online, each coordinate with its 1-sigma.

    Deviations from the calibration files; there is no row where nothing is estimated.
    """

    def __init__(self, path: Path) -> None:
        self._file = RowFile(path, "")
        self._names: tuple[str, ...] = ()

    def write(self, result: FrameResult) -> None:
        found = result.ego.calibration
        if found is None:
            return
        if not self._names:
            self._names = found.names
            columns = ("timestamp_ns", *found.names, *(f"std_{name}" for name in found.names))
            self._file.append(",".join(columns) + "\n")
        fields = (result.timestamp_ns, *found.deviation.tolist(), *found.std.tolist())
        self._file.append(format_rows("%d" + ",%.9g" * (len(fields) - 1), [fields]))

    def close(self) -> None:
        self._file.close()


class PointsTable:
    """`points.csv`: every feature of every frame with its label.

    Features that only the right camera tracks are left out: they have no position in the left
    image.
    """

    columns = "timestamp_ns,feature_id,u,v,u_right,v_right,x_cam,y_cam,z_cam,label,track_id"
    _row = "%d,%d,%.3f,%.3f,%.3f,%.3f,%.4f,%.4f,%.4f,%s,%s"

    def __init__(self, path: Path) -> None:
        self._file = RowFile(path, self.columns + "\n")

    def write(self, result: FrameResult) -> None:
        points = result.points
        in_left = np.isfinite(points.pixels[:, 0])
        rows = zip(
            [result.timestamp_ns] * int(in_left.sum()),
            points.feature_id[in_left].tolist(),
            *points.pixels[in_left].T.tolist(),
            *points.p_cam0[in_left].T.tolist(),
            [_LABELS[label] for label in points.label[in_left].tolist()],
            ["" if track < 0 else str(track) for track in points.track_id[in_left].tolist()],
            strict=True,
        )
        self._file.append(format_rows(self._row, rows))

    def close(self) -> None:
        self._file.close()


class StereoTable:
    """`stereo.csv`: every stereo match that the epipolar gate tested; `accepted` is 1 or 0."""

    columns = "timestamp_ns,feature_id,u,v,u_right,v_right,distance_px,accepted"
    _row = "%d,%d,%.3f,%.3f,%.3f,%.3f,%.4f,%d"

    def __init__(self, path: Path) -> None:
        self._file = RowFile(path, self.columns + "\n")

    def write(self, result: FrameResult) -> None:
        matches = result.matches
        rows = zip(
            [result.timestamp_ns] * len(matches.feature_id),
            matches.feature_id.tolist(),
            *matches.pixels.T.tolist(),
            matches.distance_px.tolist(),
            matches.accepted.tolist(),
            strict=True,
        )
        self._file.append(format_rows(self._row, rows))

    def close(self) -> None:
        self._file.close()


class TracksTable:
    """`tracks.csv`: a row per moving object and frame."""

    columns = (
        "timestamp_ns,track_id,state,x,y,z,vx,vy,vz,yaw,yaw_rate,length,width,height,"
        "u_min,v_min,u_max,v_max,n_points,std_x,std_y,std_z,std_vx,std_vy,std_vz,"
        "p_walker,p_cyclist,p_vehicle,std_length,std_width,std_height,std_yaw,std_yaw_rate"
    )
    _row = (
        "%d,%d,%s" + ",%.4f" * 6 + ",%.6f" * 2 + ",%.4f" * 3 + ",%.2f" * 4 + ",%d" + ",%.4f" * 6
        + ",%.4f" * 6 + ",%.6f" * 2
    )  # fmt: skip

    def __init__(self, path: Path) -> None:
        self._file = RowFile(path, self.columns + "\n")

    def write(self, result: FrameResult) -> None:
        rows = [
            (
                result.timestamp_ns, track.track_id, track.state, *track.position, *track.velocity,
                track.yaw, track.yaw_rate, *track.size, *track.box_px, track.n_points,
                *track.std_position, *track.std_velocity, *track.class_probability,
                *track.std_size, track.std_yaw, track.std_yaw_rate,
            )
            for track in result.tracks
        ]  # fmt: skip
        self._file.append(format_rows(self._row, rows))

    def close(self) -> None:
        self._file.close()


TIMING_COLUMNS = {
    "initialize": "start",
    "propagate": "predict",
    "track": "match",
    "segment": "split",
    "update": "correct",
    "marginalize": "forget",
}
"""Stages whose column in `timing.csv` keeps its name of version 0.1."""


class TimingTable:
    """`timing.csv`: milliseconds of each stage, each frame.

    Columns are `stages`, or the stages of the first frame where none are named; a stage that a
    frame did not run is empty, and stages without a column are added up in `other`.
    """

    def __init__(self, path: Path, stages: Sequence[str] = ()) -> None:
        self._file = RowFile(path)
        self._stages: tuple[str, ...] = ()
        if stages:
            self._start(stages)

    def write(self, result: FrameResult) -> None:
        if not self._stages:
            self._start(tuple(result.milliseconds))
        spent = dict(result.milliseconds)
        fields = [spent.pop(name, float("nan")) for name in self._stages]
        row = (result.timestamp_ns, *fields, sum(spent.values()))
        self._file.append(format_rows("%d" + ",%.3f" * (len(fields) + 1), [row]))

    def close(self) -> None:
        self._file.close()

    def _start(self, stages: Sequence[str]) -> None:
        columns = (TIMING_COLUMNS.get(stage, stage) for stage in stages)
        self._file.append(",".join(("timestamp_ns", *columns, "other")) + "\n")
        self._stages = tuple(stages)


def _state_fields(ego: EgoEstimate) -> tuple[float, ...]:
    """All fields of a row of `state.csv` but the stamp."""
    with np.errstate(invalid="ignore"):  # a negative variance is no deviation: empty field
        std = np.sqrt(np.diag(ego.covariance))
    return (
        *_position_quaternion(ego.T_world_imu), *ego.velocity, *ego.gyro_bias, *ego.accel_bias,
        ego.time_offset_s,
        *_position_quaternion(ego.T_imu_cam0), *_position_quaternion(ego.T_imu_cam1),
        ego.standing, *std, ego.time_offset_std_s,
    )  # fmt: skip


def _position_quaternion(T_a_b: FloatArray) -> tuple[float, ...]:
    """x, y, z, qx, qy, qz, qw (w >= 0) of a pose (4, 4); NaN for one that is not known."""
    if not np.all(np.isfinite(T_a_b)):
        return (float("nan"),) * 7
    quaternion = so3.to_quaternion(T_a_b[:3, :3]) + 0.0  # turns -0 into 0
    return (*T_a_b[:3, 3], *quaternion)
