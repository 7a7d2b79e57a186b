"""A run for Rerun's viewer (the extra `rerun`): poses, frustums, points, objects, images, plots.

The SDK is imported when the first output is made. Documentation: https://rerun.io/docs.
"""

import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError, OvmotError
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.outputs import palette
from ovmot.outputs import rerun_blueprint as entities
from ovmot.outputs.objects_overlay import ego_speed, left_image, track_words
from ovmot.outputs.trails import Trails
from ovmot.types import FrameResult, Health, ObjectTrack, PointLabel

VIEWER = "viewer"
"""In place of a file: the viewer on this machine."""
_HOST, _PORT = "127.0.0.1", 9876  # the viewer's own port
_START_S = 20.0
_QUALITY = 80
_FRUSTUM_M = 0.6


class RerunOutput:
    """The results of a run as a recording of Rerun: a file, or to a viewer on 127.0.0.1."""

    def __init__(self, target: Path | str, rig: StereoRig, *, replace: bool = False) -> None:
        """Start the recording: a `.rrd` file, or `VIEWER`, which is started where none is there.

        Raises `InputError` without the SDK, for a file of another name or one that is there
        (unless `replace`) or cannot be written, and where no viewer starts.
        """
        self._rr: Any = _sdk()
        self._rig = rig
        self._trails = Trails()
        self._last: FloatArray | None = None
        self._health: Health | None = None
        self._path: Path | None = None if str(target) == VIEWER else Path(target)
        stream = self._rr.RecordingStream("ovmot")
        self._stream = stream
        if self._path is None:
            _start_viewer()
            stream.connect_grpc(
                f"rerun+http://{_HOST}:{_PORT}/proxy",
                default_blueprint=entities.run_blueprint(),
            )
        else:
            _check_file(self._path, replace)
            stream.save(self._path, default_blueprint=entities.run_blueprint())
        self._log_fixed()

    def write(self, result: FrameResult) -> None:
        """Log one frame."""
        restarted = self._trails.segment != result.segment
        self._trails = self._trails.extended(result)
        self._stream.set_time(entities.TIMELINE, duration=self._trails.seconds(result.timestamp_ns))
        self._stream.set_time("stamp", timestamp=np.datetime64(result.timestamp_ns, "ns"))
        self._log_rig(result, restarted)
        self._log_points(result)
        self._log_objects(result)
        self._log_plots(result)

    def close(self) -> None:
        """Write what waits; a second call does nothing. Raises `OvmotError` where it cannot."""
        try:
            self._stream.flush()
            self._stream.disconnect()
        except RuntimeError as error:
            raise OvmotError(f"{self._path or VIEWER}: cannot write any further: {error}") from None

    def _log_fixed(self) -> None:
        rr, log = self._rr, self._stream.log
        log(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for entity, camera in zip((entities.CAM0, entities.CAM1), self._rig.cameras, strict=False):
            log(entity, _pinhole(rr, camera), static=True)
        log(f"{entities.SPEED}/rig", rr.SeriesLines(names="rig", widths=2.5), static=True)
        for axis in "xyz":
            log(f"{entities.SIGMA}/{axis}", rr.SeriesLines(names=axis), static=True)

    def _log_rig(self, result: FrameResult, restarted: bool) -> None:
        rr, log, ego = self._rr, self._stream.log, result.ego
        position = ego.T_world_imu[:3, 3]
        log(entities.RIG, _transform(rr, ego.T_world_imu))
        for entity, T_imu_cam in zip(
            (entities.CAM0, entities.CAM1)[: self._rig.n_cameras],
            (ego.T_imu_cam0, ego.T_imu_cam1), strict=False,
        ):  # fmt: skip
            log(entity, _transform(rr, T_imu_cam))
        if self._last is not None and not restarted:
            step = np.stack([self._last, position])
            log(entities.PATH, rr.LineStrips3D([step], colors=[_rgb(palette.SKY_BLUE)]))
        self._last = position
        left = left_image(result)
        if left is not None:
            _, data = cv2.imencode(".jpg", left, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
            image = rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")
            log(f"{entities.CAM0}/image", image)

    def _log_points(self, result: FrameResult) -> None:
        rr, points = self._rr, result.points
        known = np.all(np.isfinite(points.p_cam0), axis=1)
        T = result.ego.T_world_imu @ result.ego.T_imu_cam0
        dynamic = known & (points.label == PointLabel.DYNAMIC)

        def cloud(which: BoolArray, colors: list[tuple[int, int, int]]) -> Any:
            p = se3.apply(T, points.p_cam0[which])
            return rr.Points3D(p, colors=colors, radii=rr.Radius.ui_points(2.5))

        static = known & (points.label == PointLabel.STATIC)
        self._stream.log(entities.STATIC, cloud(static, [_rgb(palette.GREY)]))
        colors = [_track_color(track_id) for track_id in points.track_id[dynamic].tolist()]
        self._stream.log(entities.DYNAMIC, cloud(dynamic, colors or [_rgb(palette.WHITE)]))

    def _log_objects(self, result: FrameResult) -> None:
        rr = self._rr
        shown = [track for track in result.tracks if track.state == "confirmed"]
        colors = [_track_color(track.track_id) for track in shown]
        boxes = rr.Boxes3D(
            centers=np.array([track.position for track in shown]).reshape(-1, 3),
            half_sizes=np.array([0.5 * track.size for track in shown]).reshape(-1, 3),
            quaternions=np.array([_heading(track) for track in shown]).reshape(-1, 4),
            colors=colors, labels=[track_words(track) for track in shown],
        )  # fmt: skip
        self._stream.log(entities.BOXES, boxes)
        trails = [self._trails.of(track.track_id) for track in shown]
        self._stream.log(entities.TRAILS, rr.LineStrips3D(trails, colors=colors))

    def _log_plots(self, result: FrameResult) -> None:
        rr, log, ego = self._rr, self._stream.log, result.ego
        log(f"{entities.SPEED}/rig", rr.Scalars(ego_speed(ego)))
        for track in result.tracks:
            if track.state == "confirmed":
                speed = float(np.linalg.norm(track.velocity))
                log(f"{entities.SPEED}/object_{track.track_id}", rr.Scalars(speed))
        with np.errstate(invalid="ignore"):
            sigma = np.sqrt(np.diag(ego.covariance)[3:6])
        for axis, value in zip("xyz", sigma.tolist(), strict=True):
            log(f"{entities.SIGMA}/{axis}", rr.Scalars(value))
        for stage, spent in result.milliseconds.items():
            log(f"{entities.STAGES}/{stage}", rr.Scalars(spent))
        if ego.health != self._health:
            self._health = ego.health
            level = "INFO" if ego.health == Health.TRACKING else "WARN"
            log(entities.LOG, rr.TextLog(f"health: {ego.health}", level=level))


def _sdk() -> Any:
    try:
        import rerun
    except ImportError:
        raise InputError("--rerun needs Rerun's SDK: pip install 'ovmot[rerun]'") from None
    return rerun


def _check_file(path: Path, replace: bool) -> None:
    if path.suffix != ".rrd":
        raise InputError.at(path, "is no name of a Rerun recording", "write FILE.rrd, or 'viewer'")
    if path.exists() and not replace:
        raise InputError.at(path, "is there already", "choose another name, or use --force")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    except OSError as error:
        raise InputError.at(
            path, f"cannot be written: {error.strerror}", "choose another"
        ) from None


def _start_viewer() -> None:
    """Start the viewer, for this machine alone, where none listens yet; raises `InputError`."""
    if _listens():
        return
    process = subprocess.Popen(
        [sys.executable, "-m", "rerun", "--bind", _HOST, "--port", str(_PORT)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    began = time.monotonic()
    while time.monotonic() - began < _START_S and process.poll() is None:
        if _listens():
            return
        time.sleep(0.1)
    process.terminate()
    raise InputError("Rerun's viewer does not start here (no display?): give --rerun FILE.rrd")


def _listens() -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex((_HOST, _PORT)) == 0


def _pinhole(rr: Any, camera: Camera) -> Any:
    """The frustum of a camera; Rerun knows no distortion."""
    matrix = camera.matrix.copy()
    matrix[0, 0], matrix[1, 1] = camera.fx, camera.fy
    return rr.Pinhole(
        image_from_camera=matrix, resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=_FRUSTUM_M,
    )  # fmt: skip


def _transform(rr: Any, T: FloatArray) -> Any:
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def _heading(track: ObjectTrack) -> list[float]:
    """A turn about z as a quaternion, x y z w."""
    return [0.0, 0.0, float(np.sin(0.5 * track.yaw)), float(np.cos(0.5 * track.yaw))]


def _track_color(track_id: int) -> tuple[int, int, int]:
    return _rgb(palette.WHITE if track_id < 0 else palette.color_of(track_id))


def _rgb(color: palette.Color) -> tuple[int, int, int]:
    blue, green, red = color
    return red, green, blue
