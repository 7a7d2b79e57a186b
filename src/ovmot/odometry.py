"""The program: IMU samples and stereo frames in, one `FrameResult` a frame out."""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError, OvmotError
from ovmot.feature_table import (
    FeatureTable,
    StereoHistory,
    append_frame,
    empty_table,
    mark_dynamic,
    mark_outliers,
)
from ovmot.frame_jobs import FrameJobs, Known, Step
from ovmot.frontend import FRONT_ENDS
from ovmot.frontend.epipolar import match_sigma
from ovmot.frontend.here import FrontEndHere
from ovmot.frontend.remote import RemoteFrontEnd
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.id_sets import contained
from ovmot.initialization.frame_buffer import FrameBuffer, predicted_rotation
from ovmot.initialization.initializer import FilterInitializer, has_stereo, motion_window_s
from ovmot.interfaces import (
    FrontEnd,
    FrontEndRunner,
    Initializer,
    OdometrySource,
    Tracked,
    check_event,
    no_feedback,
)
from ovmot.kernels.cache import load_kept
from ovmot.objects.moving_objects import MovingObjects
from ovmot.physics import MEMS_NOISE, PIXEL_SIGMA
from ovmot.runtime import Stopwatch, prepare_process
from ovmot.segmentation.rig_body import (
    counted,
    no_rig_body,
    standing_features,
    without_rig_body,
)
from ovmot.segmentation.segmentation import Segmentation, segment_points
from ovmot.segmentation.stereo_history import stereo_history
from ovmot.settings import ImuSettings, Settings
from ovmot.types import (
    EgoEstimate,
    Event,
    FeatureFrame,
    FrameResult,
    FrontendFrame,
    Health,
    ImuNoise,
    ImuSample,
    Picture,
    PixelNoise,
    PointLabel,
    StereoFrame,
)
from ovmot.vio.imu_buffer import ImuBuffer

IMU_KEPT_NS = 1_000_000_000
"""IMU samples kept behind the newest frame, on the IMU's clock."""

_NOISE_GAIN = 0.1  # of a new frame, in the averaged noise of matches

_LATER_STAGES = ("kernels", "geometry", "vio", "segmentation", "objects")  # folders of kernels

STAGES = ("initialize", "propagate", "track", "segment", "update", "objects", "marginalize")


class Odometry:
    """Stereo-inertial odometry with moving-object tracks, fed one event at a time.

    It prepares its process (`prepare_process`): one thread for OpenCV and for BLAS.

    The front end of a frame runs on what is known two frames before it, so that with two threads it
    runs beside the later stages of the frame before. The results are the same bit for bit.

    Parameters
    ----------
    rig
        Both cameras, their poses on the IMU and the time offset.
    imu_noise
        Noise densities of the IMU; None for those of the settings.
    settings
        What differs from the defaults.
    initializer
        Where the odometry source comes from: by default the filter, initialized statically or
        dynamically; `GivenPosesInitializer` for poses from elsewhere.
    frontend
        Another front end than the one that `tracker.cameras` names.
    threads
        1: everything in the calling thread. 2: the front end runs beside the later stages, each in
        a thread; that of the settings in a process of its own.
    on_result
        Called with each `FrameResult` as soon as it is there, by the thread that made it.

    Raises
    ------
    InputError
        By `add`, for events out of order, and where a frame is not what the front end takes.
    OvmotError
        By `add`, with the frame's stamp, where the estimate breaks down numerically.
    """

    def __init__(
        self,
        rig: StereoRig,
        imu_noise: ImuNoise | None = None,
        settings: Settings | None = None,
        *,
        initializer: Initializer | None = None,
        frontend: FrontEnd | None = None,
        threads: int = 1,
        on_result: Callable[[FrameResult], None] | None = None,
    ) -> None:
        prepare_process()
        settings = settings_in_use(settings or Settings(), rig)
        self._settings = settings
        self._initializer: Initializer = initializer or FilterInitializer(
            rig, noise_in_use(imu_noise, settings.imu), settings
        )
        self._frontend: FrontEndRunner = (
            _front_end(rig, settings, threads) if frontend is None else FrontEndHere(frontend)
        )
        self._rig = rig
        self._objects = MovingObjects(rig, settings)
        # the calling thread's: events, and the frames that are worked on
        self._imu = ImuBuffer()
        self._waiting: deque[StereoFrame | FeatureFrame] = deque()
        self._last_frame_ns: int | None = None  # added
        self._begun_ns: int | None = None  # the last frame that is worked on
        self._jobs = FrameJobs(threads, Known(None, no_feedback(rig), None))
        self._jobs.prepare(partial(load_kept, _LATER_STAGES))
        self._on_result = on_result
        self.dropped = 0
        # the later stages'
        self._source: OdometrySource | None = None
        self._table = empty_table()
        self._feedback = no_feedback(rig)
        self._before_start = FrameBuffer(
            self._initializer, settings.initialization, motion_window_s(rig, settings)
        )
        self.rig_body = no_rig_body(rig)
        self._resume_at: FloatArray | None = None
        self.not_started_because: str | None = None
        self.counts: Counter[str] = Counter(
            resets=0, frames_split_unsure=0, frames_degraded=0, frames_lost=0
        )

    def add(self, event: Event) -> list[FrameResult]:
        """Take one IMU sample or frame; return the results that are ready, in order.

        A frame is held until the IMU covers its time. Raises `DatasetError` where the stamps of a
        kind do not rise or an event is malformed (`check_event`), `OvmotError` with the frame's
        stamp where the numbers break down.
        """
        check_event(event, self._rig)
        if isinstance(event, ImuSample):
            self._imu.append(event)
        else:
            self._check_order(event)
            self._waiting.append(event)
        while self._waiting and self._is_covered(self._waiting[0].timestamp_ns):
            self._begin(self._waiting.popleft())
        return self.ready()

    def ready(self) -> list[FrameResult]:
        """The results that are ready, in order, without waiting. Raises what `add` raises."""
        return self._jobs.ready()

    def finish(self) -> list[FrameResult]:
        """Wait for the results that are still awaited, in order, and stop the threads.

        Frames that the IMU never covered have none; `dropped` counts them. A second call does
        nothing. Raises what `add` raises.
        """
        try:
            return self._jobs.rest()
        finally:
            self.close()

    def close(self) -> None:
        """Stop the threads; what is still awaited is given up."""
        self.dropped += len(self._waiting)
        self._waiting.clear()
        self._jobs.close()
        self._frontend.close()

    def _begin(self, frame: StereoFrame | FeatureFrame) -> None:
        """Let the front end and then the later stages work on a frame.

        The front end has what was known after the frame before the last one.
        """
        known = self._jobs.known()
        if known.imu_needed_from_ns is not None:
            self._imu.drop_before(known.imu_needed_from_ns - IMU_KEPT_NS)
        imu = self._imu.snapshot()
        T_now_before = self._predicted_motion(known, frame.timestamp_ns, imu)
        self._jobs.begin(
            self._frontend.begin(frame, T_now_before, known.feedback),
            lambda tracked: self._step_or_say(frame, tracked, imu),
        )

    def _predicted_motion(self, known: Known, frame_ns: int, imu: ImuBuffer) -> FloatArray:
        """T_now_before (4, 4) of the left camera since the last frame; of a source that runs, or by
        the gyroscope alone, the identity where neither reaches so far."""
        before_ns, self._begun_ns = self._begun_ns, frame_ns
        if before_ns is None:
            return np.eye(4)
        if known.source is not None:
            with suppress(DatasetError):
                return known.source.predicted_motion(before_ns, frame_ns, imu)
        clock = self._clock(known)
        times_ns = clock.imu_time_ns(before_ns), clock.imu_time_ns(frame_ns)
        return predicted_rotation(*times_ns, imu, known.feedback.rig)

    def step(
        self, frame: StereoFrame | FeatureFrame, tracked: Callable[[], Tracked], imu: ImuBuffer
    ) -> FrameResult | None:
        """One frame through all stages; None while there is no initial state.

        `tracked` waits for the front end; `imu` covers the frame.
        """
        feedback = self._feedback
        # 0 initialize: static or dynamic, and go through the frames that were used for it
        if self._source is None:
            return self._initialize(frame, tracked(), imu)
        # 1 propagate: IMU to the frame's time, clone the pose
        watch = Stopwatch()
        with watch.stage("propagate"):
            source = self._source.propagate(frame.timestamp_ns, imu)
        # 2 track: temporal and stereo matching from predicted places, epipolar gate on every pair
        seen, matches, track_ms = tracked()
        self._count_pictures(seen)
        pixel_sigma = _averaged(feedback.pixel_sigma, match_sigma(matches))
        # 3 segment: what the predicted motion does not explain leaves the filter for good
        with watch.stage("segment"):
            table, history, segmentation = self._segment(
                append_frame(self._table, seen), seen, source, self._noise_in_use(pixel_sigma)
            )
        # 4 update: zero velocity, SLAM features in view, ended MSCKF features
        with watch.stage("update"):
            source, table = source.update(table, history)
        # 5 objects: cluster, rigid motions, tracks, by the updated motion
        with watch.stage("objects"):
            objects = self._objects.step(
                history, seen.timestamp_ns, segmentation, source.window(), source.calibrated_rig()
            )
        # 6 marginalize: the oldest clone, or the newest one when stationary
        with watch.stage("marginalize"):
            self._source, self._table = source.marginalize(table)
        self._feedback = objects.feedback(
            self._source.calibrated_rig(), pixel_sigma, self._table.feature_id[self._table.dynamic]
        )
        result = FrameResult(
            frame=frame,
            ego=self._source.estimate(frame.timestamp_ns),
            points=objects.points,
            matches=matches,
            tracks=objects.tracks,
            milliseconds={"track": track_ms} | watch.milliseconds,
            segment=self.counts["resets"],
        )
        self._watch_health(result.ego)
        return result

    @property
    def rig(self) -> StereoRig:
        """The rig as it was given; what is estimated of it is in each result's `ego`."""
        return self._rig

    @property
    def started(self) -> bool:
        """Is there an odometry source that runs?"""
        return self._source is not None

    def _noise_in_use(self, measured: float) -> PixelNoise:
        """The features' noise: as the settings give it, else as measured, else as is usual."""
        noise = self._settings.noise
        known = PIXEL_SIGMA if np.isnan(measured) else measured
        return PixelNoise(
            noise.pixel_sigma or known,
            noise.pixel_sigma or max(known, PIXEL_SIGMA),
            noise.drift_per_frame_px,
            noise.drift_per_flow,
        )

    def latest(self) -> EgoEstimate | None:
        """The state propagated to the newest IMU sample; None before initialization."""
        newest = self._imu.last_ns
        if self._source is None or newest is None:
            return None
        return self._source.estimate_at(newest, self._imu)

    def _initialize(
        self, frame: StereoFrame | FeatureFrame, tracked: Tracked, imu: ImuBuffer
    ) -> FrameResult | None:
        """Look for an initial state; on success go through the frames up to this one."""
        seen, matches, track_ms = tracked
        self._count_pictures(seen)
        if _interrupts_start(seen, self._before_start.frames):
            self.not_started_because = f"pictures: {' and '.join(seen.pictures)}"
            self.counts["frames_before_start"] += 1
            return None
        self._before_start.append(seen, imu)
        watch = Stopwatch()
        with watch.stage("initialize"):
            started = self._initializer(self._before_start.frames, imu)
            if isinstance(started, str):
                self.not_started_because = started
                self.counts["frames_before_start"] += 1
                return None
            source, table = started
            if self._resume_at is not None:
                source = source.placed(self._resume_at)
            self._source, self._table, segmentation = self._caught_up(source, table, imu)
        return FrameResult(
            frame=frame,
            ego=self._source.estimate(frame.timestamp_ns),
            points=segmentation.points,
            matches=matches,
            tracks=(),
            milliseconds={"track": track_ms} | watch.milliseconds,
            segment=self.counts["resets"],
        )

    def _caught_up(
        self, source: OdometrySource, table: FeatureTable, imu: ImuBuffer
    ) -> tuple[OdometrySource, FeatureTable, Segmentation]:
        """A source just initialized, its table and the segmentation, at the newest frame."""
        frames = self._before_start.frames
        newest, noise = frames[-1], self._noise_in_use(self._feedback.pixel_sigma)
        if newest.timestamp_ns in table.frame_ns:  # the initializer has used them all
            table, _, segmentation = self._segment(table, newest, source, noise)
            source, table = source.marginalize(table)
        else:
            for seen in frames:
                source = source.propagate(seen.timestamp_ns, imu)
                table, history, segmentation = self._segment(
                    append_frame(table, seen), seen, source, noise
                )
                source, table = source.update(table, history)
                source, table = source.marginalize(table)
        self._before_start.clear()
        return source, table, segmentation

    def _segment(
        self, table: FeatureTable, seen: FrontendFrame, source: OdometrySource, noise: PixelNoise
    ) -> tuple[FeatureTable, StereoHistory, Segmentation]:
        """The frame's history and segmentation; the table with dynamic features and outliers."""
        rig, window, settings = (
            source.calibrated_rig(),
            source.window(),
            self._settings.segmentation,
        )
        history = stereo_history(
            table, seen.feature_id, window.timestamp_ns, rig, settings.look_back_s, noise
        )
        stands, moves = standing_features(history, window, rig)
        self.rig_body = counted(self.rig_body, stands, moves, seen.pixels, rig)
        segmentation = without_rig_body(
            segment_points(table, history, seen, window, rig, settings),
            stands | self.rig_body.shows(seen.pixels, rig),
        )
        points = segmentation.points
        if segmentation.trusted:
            dynamic = points.label == int(PointLabel.DYNAMIC)
            table = mark_dynamic(table, points.feature_id[dynamic])
        else:
            self.counts["frames_split_unsure"] += 1
        held = contained(points.feature_id, np.sort(self._feedback.held_id))
        outlier = segmentation.outlier | held
        return mark_outliers(table, points.feature_id, outlier), history, segmentation

    def _count_pictures(self, seen: FrontendFrame) -> None:
        """Count the pictures that were not matched, by camera and reason."""
        for side, picture in zip(("left", "right"), seen.pictures, strict=True):
            if picture != Picture.FINE:
                self.counts[f"{side}_{picture}"] += 1

    def _watch_health(self, ego: EgoEstimate) -> None:
        """Count what is not well; where the motion is lost, initialize again at the last pose."""
        if ego.health != Health.TRACKING:
            self.counts[f"frames_{ego.health}"] += 1
        if ego.health == Health.LOST and self._settings.health.reset:
            self.counts["resets"] += 1
            self._resume_at = ego.T_world_imu
            self._source, self._table = None, empty_table()
            self._before_start.clear()

    def _step_or_say(
        self, frame: StereoFrame | FeatureFrame, tracked: Callable[[], Tracked], imu: ImuBuffer
    ) -> Step:
        """A step and what is known after it; a numerical failure (a matrix not positive, a NaN)
        names the frame."""
        result, stamp = None, frame.timestamp_ns
        try:
            result = self.step(frame, tracked, imu)
        except (ValueError, ArithmeticError) as error:  # LinAlgError is a ValueError
            wrong = OvmotError(f"the estimate broke down at frame {stamp} ns: {error}")
            wrong.__cause__ = error
            return Step(None, wrong, self._known_now(stamp))
        except OvmotError as error:
            return Step(None, error, self._known_now(stamp))
        if result is not None and self._on_result is not None:
            self._on_result(result)
        return Step(result, None, self._known_now(stamp))

    def _known_now(self, frame_ns: int) -> Known:
        """What is known after the newest frame."""
        if self._source is None:
            return Known(None, self._feedback, self._before_start.imu_needed_from_ns)
        return Known(self._source, self._feedback, self._source.imu_time_ns(frame_ns))

    def _check_order(self, frame: StereoFrame | FeatureFrame) -> None:
        if self._last_frame_ns is not None and frame.timestamp_ns <= self._last_frame_ns:
            raise DatasetError(
                f"frame stamp {frame.timestamp_ns} does not follow {self._last_frame_ns}:"
                " frames must be in time order"
            )
        self._last_frame_ns = frame.timestamp_ns

    def _is_covered(self, frame_ns: int) -> bool:
        needed = self._clock(self._jobs.known()).imu_needed_until(frame_ns)
        last = self._imu.last_ns
        return needed is None or (last is not None and last >= needed)

    def _clock(self, known: Known) -> Initializer | OdometrySource:
        """What knows the clocks: the source, or the initializer before there is one."""
        return self._initializer if known.source is None else known.source


def _interrupts_start(seen: FrontendFrame, before: Sequence[FrontendFrame]) -> bool:
    """Is a frame without what a start needs better left out of its window? Not where the right
    camera has given nothing so far: a start at rest does without it."""
    left, right = seen.pictures
    in_stereo = any(bool(np.isfinite(f.pixels[:, 2]).any()) for f in before)
    return left != Picture.FINE or (right != Picture.FINE and in_stereo)


def _front_end(rig: StereoRig, settings: Settings, threads: int) -> FrontEndRunner:
    """The front end that the settings name, without the features that only objects need."""
    tracker = settings.tracker
    if not settings.objects.enabled:
        tracker = tracker.model_copy(update={"fine_features": 0, "focus_features": 0})
    if threads > 1:
        return RemoteFrontEnd(rig, tracker, settings.epipolar)
    return FrontEndHere(FRONT_ENDS[tracker.cameras](rig, tracker, settings.epipolar, 1))


NO_OBJECTS = "objects are off: without stereo matches the depth of what moves is not known"


def settings_in_use(settings: Settings, rig: StereoRig) -> Settings:
    """The settings without what needs more than the rig has.

    One camera is followed by itself. Without stereo matches there are no objects (`NO_OBJECTS`).
    """
    if rig.n_cameras == 1:
        tracker = settings.tracker.model_copy(update={"cameras": "left"})
        settings = settings.model_copy(update={"tracker": tracker})
    if not has_stereo(rig, settings):
        objects = settings.objects.model_copy(update={"enabled": False})
        settings = settings.model_copy(update={"objects": objects})
    return settings


def noise_in_use(calibrated: ImuNoise | None, settings: ImuSettings) -> ImuNoise:
    """Noise densities: the settings' where given, else the data's, else a MEMS unit's."""
    known = calibrated or ImuNoise(*MEMS_NOISE)
    return ImuNoise(
        gyro=settings.gyro_noise or known.gyro,
        gyro_walk=settings.gyro_walk or known.gyro_walk,
        accel=settings.accel_noise or known.accel,
        accel_walk=settings.accel_walk or known.accel_walk,
    )


def _averaged(before: float, now: float) -> float:
    """The noise of matches, averaged over frames (first-order low pass); NaN where never seen."""
    if not np.isfinite(now):
        return before
    return now if not np.isfinite(before) else before + _NOISE_GAIN * (now - before)
