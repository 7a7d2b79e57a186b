"""The program: IMU samples and stereo frames in, one `FrameResult` a frame out."""

from collections import Counter, deque

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError, OvmotError
from ovmot.feature_table import FeatureTable, append_frame, empty_table, mark_dynamic, mark_outliers
from ovmot.frontend.epipolar import match_sigma
from ovmot.frontend.front_ends import FRONT_ENDS
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.interfaces import FrontEnd, Initializer, OdometrySource
from ovmot.objects.exclusion import excluded_features
from ovmot.objects.measurement import measure_objects
from ovmot.objects.tracker import ObjectTracker
from ovmot.segmentation.segmentation import Segmentation, segment_points
from ovmot.settings import Settings
from ovmot.timing import Stopwatch
from ovmot.types import (
    EgoEstimate,
    Event,
    FeatureFrame,
    FrameResult,
    FrontendFrame,
    Health,
    ImuSample,
    ObjectTrack,
    PointLabel,
    PoseWindow,
    ScenePoints,
    StereoFrame,
    StereoMatches,
)
from ovmot.vio.imu_buffer import ImuBuffer, integrated_rotation

_NOISE_GAIN = 0.1  # of a frame, in the noise of matches
_IMU_KEPT_NS = 1_000_000_000  # behind the newest frame, on the IMU's clock

STAGES = ("start", "predict", "match", "split", "correct", "objects", "forget")


class Odometry:
    """Keeps the front end, the IMU buffer, the ego source and the table of what was seen."""

    def __init__(
        self,
        rig: StereoRig,
        settings: Settings,
        start: Initializer,
        frontend: FrontEnd | None = None,
    ) -> None:
        self._rig = rig
        self._settings = settings
        self._start = start
        self._frontend: FrontEnd = frontend or FRONT_ENDS[settings.tracker.cameras](
            rig, settings.tracker, settings.epipolar
        )
        self._objects: ObjectTracker | None = None
        if settings.objects.enabled:
            self._objects = ObjectTracker(rig, settings.object_tracks)
        self._rng = np.random.default_rng(settings.objects.seed)
        self._object_settings = settings.objects
        self._noise_px = float("nan")
        self._excluded = np.empty(0, dtype=np.int64)
        self._imu = ImuBuffer()
        self._ego: OdometrySource | None = None
        self._table = empty_table()
        self._waiting: deque[StereoFrame | FeatureFrame] = deque()
        self._pending: deque[FrontendFrame] = deque()
        self._last_frame_ns: int | None = None
        self._resume_at: FloatArray | None = None
        self.not_started_because: str | None = None
        self.dropped = 0
        self.counts: Counter[str] = Counter(
            resets=0, frames_split_unsure=0, frames_degraded=0, frames_lost=0
        )

    def feed(self, event: Event) -> list[FrameResult]:
        """Take one IMU sample or frame; give the results that it made possible.

        A frame is held until the IMU covers its time. Raises `DatasetError` where the stamps of a
        kind do not rise, `OvmotError` with the frame's stamp where the numbers break down.
        """
        if isinstance(event, ImuSample):
            self._imu.append(event)
        else:
            self._check_order(event)
            self._waiting.append(event)
        results: list[FrameResult] = []
        while self._waiting and self._is_covered(self._waiting[0].timestamp_ns):
            result = self._step_or_say(self._waiting.popleft())
            if result is not None:
                results.append(result)
        return results

    def step(self, frame: StereoFrame | FeatureFrame) -> FrameResult | None:
        """One frame through all stages; None while there is no start."""
        watch = Stopwatch()
        # 0 before: look for a start, and go through the frames it was found in
        if self._ego is None:
            return self._before(frame, watch)
        # 1 predict: propagate to the frame's time and clone the pose
        with watch.stage("predict"):
            ego = self._ego.predict(frame.timestamp_ns, self._imu)
        # 2 match: follow, match left to right, check every pair by the extrinsics
        with watch.stage("match"):
            rig = ego.calibrated_rig()
            self._frontend.calibrate(rig)
            seen, matches = self._frontend.track(frame, camera_motion(ego.window(), rig))
            self._note_noise(matches)
        # 3 split: what the predicted motion does not explain leaves the filter with its history
        with watch.stage("split"):
            table, split = self._split(append_frame(self._table, seen), seen, ego)
        # 4 correct: zero velocity, ended features
        with watch.stage("correct"):
            ego, table = ego.correct(table)
        # 5 objects: group, fit rigid motions, refine, and track, by the corrected motion
        with watch.stage("objects"):
            tracks, points = self._track_objects(table, split.points, ego)
            # 6 focus: look closer where something moves, or may
            self._frontend.focus(*self._where_to_look(points, split.outlier))
        # 7 forget: the oldest pose leaves, or the newest when standing
        with watch.stage("forget"):
            self._ego, self._table = ego.marginalize(table)
            self._drop_imu(self._ego.imu_time_ns(frame.timestamp_ns))
        result = FrameResult(
            frame=frame,
            ego=self._ego.estimate(frame.timestamp_ns),
            points=points,
            matches=matches,
            tracks=tracks,
            milliseconds=watch.milliseconds,
            segment=self.counts["resets"],
        )
        self._watch_health(result.ego)
        return result

    @property
    def started(self) -> bool:
        """Is there an ego source that runs?"""
        return self._ego is not None

    def latest(self) -> EgoEstimate | None:
        """The state carried to the newest IMU sample, between frames; None without a start."""
        newest = self._imu.last_ns
        if self._ego is None or newest is None:
            return None
        return self._ego.estimate_at(newest, self._imu)

    def _note_noise(self, matches: StereoMatches) -> None:
        """Take the noise of stereo pairs, as these matches show it, into the settings in use."""
        sigma = match_sigma(matches)
        if self._settings.objects.noise == "told" or not np.isfinite(sigma):
            return
        before = self._noise_px if np.isfinite(self._noise_px) else sigma
        self._noise_px = before + _NOISE_GAIN * (sigma - before)
        self._object_settings = self._settings.objects.model_copy(
            update={"pixel_sigma": self._noise_px}
        )

    def _track_objects(
        self, table: FeatureTable, points: ScenePoints, ego: OdometrySource
    ) -> tuple[tuple[ObjectTrack, ...], ScenePoints]:
        """The tracks of this frame, and the points with the ids of their tracks."""
        if self._objects is None:
            return (), points
        window, rig = ego.window(), ego.calibrated_rig()
        points = self._objects.owned(points)
        measurements = measure_objects(table, points, window, rig, self._object_settings, self._rng)
        T_world_cam0 = window.T_world_imu[-1] @ rig.T_imu_cam0
        now_ns = int(table.frame_ns[-1])
        tracks, points = self._objects.step(now_ns, measurements, points, T_world_cam0)
        self._excluded = excluded_features(points, self._object_settings.max_excluded_share)
        ids, velocity = self._objects.expected(points)
        self._frontend.expect(ids, velocity @ T_world_cam0[:3, :3])
        return tracks, points

    def _where_to_look(
        self, points: ScenePoints, outlier: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Left pixels (N, 2) of points that move or do not look at rest, and radii (N,) around."""
        if self._objects is None:
            return np.empty((0, 2)), np.empty(0)
        depth = points.p_cam0[:, 2]
        moving = (points.label == int(PointLabel.DYNAMIC)) | (points.track_id >= 0)
        chosen = np.flatnonzero((moving | outlier) & np.isfinite(depth))
        half_width = 0.5 * self._settings.tracker.focus_width_m
        radius = half_width * self._rig.cam0.fx / np.maximum(depth[chosen], 1.0)
        return points.pixels[chosen, :2], radius

    def close(self) -> None:
        """Stop worker threads and count the frames that the IMU never covered."""
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._frontend.close()

    def _split(
        self, table: FeatureTable, seen: FrontendFrame, ego: OdometrySource
    ) -> tuple[FeatureTable, Segmentation]:
        """The table with dynamic features barred and suspects marked, and the split itself."""
        rig = ego.calibrated_rig()
        split = segment_points(table, seen, ego.window(), rig, self._settings.split)
        points = split.points
        if split.trusted:
            dynamic = points.label == int(PointLabel.DYNAMIC)
            table = mark_dynamic(table, points.feature_id[dynamic])
        else:
            self.counts["frames_split_unsure"] += 1
        outlier = split.outlier | np.isin(points.feature_id, self._excluded)
        return mark_outliers(table, points.feature_id, outlier), split

    def _before(self, frame: StereoFrame | FeatureFrame, watch: Stopwatch) -> FrameResult | None:
        """Track by the gyroscope's rotation, try to start; on success catch up with this frame."""
        with watch.stage("match"):
            seen, matches = self._frontend.track(frame, self._rotation_before_start(frame))
        self._pending.append(seen)
        self._drop_old_pending()
        with watch.stage("start"):
            started = self._start(tuple(self._pending), self._imu)
            if isinstance(started, str):
                self.not_started_because = started
                self.counts["frames_before_start"] += 1
                return None
            ego, table = started
            if self._resume_at is not None:
                ego = ego.placed(self._resume_at)
            ego, self._table, split = self._caught_up(ego, table)
            self._ego = ego
        return FrameResult(
            frame=frame,
            ego=ego.estimate(frame.timestamp_ns),
            points=split.points,
            matches=matches,
            tracks=(),
            milliseconds=watch.milliseconds,
            segment=self.counts["resets"],
        )

    def _caught_up(
        self, ego: OdometrySource, table: FeatureTable
    ) -> tuple[OdometrySource, FeatureTable, Segmentation]:
        """A source that has just started, its table and the split, at the newest pending frame."""
        newest = self._pending[-1]
        if newest.timestamp_ns in table.frame_ns:  # the start has used them all
            table, split = self._split(table, newest, ego)
            ego, table = ego.marginalize(table)
        else:
            for seen in self._pending:
                ego = ego.predict(seen.timestamp_ns, self._imu)
                table, split = self._split(append_frame(table, seen), seen, ego)
                ego, table = ego.correct(table)
                ego, table = ego.marginalize(table)
        self._pending.clear()
        return ego, table, split

    def _watch_health(self, ego: EgoEstimate) -> None:
        """Count what is not well; where the motion is lost, start again at the last pose."""
        if ego.health != Health.TRACKING:
            self.counts[f"frames_{ego.health}"] += 1
        if ego.health == Health.LOST and self._settings.health.reset:
            self.counts["resets"] += 1
            self._resume_at = ego.T_world_imu
            self._ego, self._table = None, empty_table()
            self._pending.clear()

    def _drop_old_pending(self) -> None:
        """Keep the frames that a start looks at, none older than the IMU, and their samples."""
        initialization = self._settings.initialization
        span_ns = round(1.2e9 * initialization.motion_window_s)
        first_ns = self._imu.first_ns
        newest = self._pending[-1].timestamp_ns
        while len(self._pending) > 1 and (
            newest - self._pending[0].timestamp_ns > span_ns
            or (
                first_ns is not None
                and self._start.imu_time_ns(self._pending[0].timestamp_ns) < first_ns
            )
        ):
            self._pending.popleft()
        oldest_ns = self._start.imu_time_ns(self._pending[0].timestamp_ns)
        self._drop_imu(oldest_ns - round(1e9 * initialization.window_s))

    def _drop_imu(self, needed_ns: int) -> None:
        self._imu.drop_before(needed_ns - _IMU_KEPT_NS)

    def _rotation_before_start(self, frame: StereoFrame | FeatureFrame) -> FloatArray:
        """Left camera's rotation since the last frame by the gyroscope alone, as T_now_before."""
        T = np.eye(4)
        if not self._pending:
            return T
        try:
            samples = self._imu.between(
                self._start.imu_time_ns(self._pending[-1].timestamp_ns),
                self._start.imu_time_ns(frame.timestamp_ns),
            )
        except DatasetError:
            return T  # no IMU there: start at the old positions
        R_cam_imu = self._rig.T_imu_cam0[:3, :3].T
        T[:3, :3] = R_cam_imu @ integrated_rotation(samples).T @ R_cam_imu.T
        return T

    def _step_or_say(self, frame: StereoFrame | FeatureFrame) -> FrameResult | None:
        """A step whose numerical failure (a matrix not positive, a NaN) names the frame."""
        try:
            return self.step(frame)
        except (ValueError, ArithmeticError) as error:  # LinAlgError is a ValueError
            stamp = frame.timestamp_ns
            raise OvmotError(f"the estimate broke down at frame {stamp} ns: {error}") from error

    def _check_order(self, frame: StereoFrame | FeatureFrame) -> None:
        if self._last_frame_ns is not None and frame.timestamp_ns <= self._last_frame_ns:
            raise DatasetError(
                f"frame stamp {frame.timestamp_ns} does not follow {self._last_frame_ns}:"
                " frames must be in time order"
            )
        self._last_frame_ns = frame.timestamp_ns

    def _is_covered(self, frame_ns: int) -> bool:
        source = self._start if self._ego is None else self._ego
        needed = source.imu_needed_until(frame_ns)
        last = self._imu.last_ns
        return needed is None or (last is not None and last >= needed)


def camera_motion(window: PoseWindow, rig: StereoRig) -> FloatArray:
    """T_now_before (4, 4) of the left camera between the two newest poses of a window."""
    if len(window.timestamp_ns) < 2:
        return np.eye(4)
    T_world_cam0 = window.T_world_imu[-2:] @ rig.T_imu_cam0
    T_now_before: FloatArray = se3.inverse(T_world_cam0[1]) @ T_world_cam0[0]
    return T_now_before
