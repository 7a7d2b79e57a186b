"""The filter's initializer: static, else dynamic initialization, then bundle adjustment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError, InitializationError
from ovmot.feature_table import FeatureTable, append_frame, empty_table, mark_used
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.initialization.bundle_adjustment import AdjustedWindow, bundle_adjust, keyframe_pixels
from ovmot.initialization.clock_offset import SEARCH_S, ClockOffset, find_clock_offset
from ovmot.initialization.dynamic import InitializationPrior, dynamic_initialization
from ovmot.initialization.factors import (
    Factor,
    ImuIntervals,
    imu_factor,
    preintegrate,
    prior_factor,
    zero_velocity_factor,
)
from ovmot.initialization.monocular import monocular_initialization
from ovmot.initialization.static import static_initialization
from ovmot.initialization.stereo_path import StereoPath, stereo_path
from ovmot.initialization.window import KeyframeWindow, filter_state, scale_sigma
from ovmot.physics import FRAME_JITTER
from ovmot.settings import Settings
from ovmot.types import FrontendFrame, ImuNoise
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.integrators import INTEGRATORS
from ovmot.vio.landmarks import no_landmarks
from ovmot.vio.online_calibration import make_calibration
from ovmot.vio.state import ACCEL_BIAS, GYRO_BIAS, ImuState

_MIN_STATIC_FRAMES = 3
_MIN_DYNAMIC_FRAMES = 5
_MAX_RMS = 3.0  # of the adjusted window's whitened residuals; beyond, it is refused


def has_stereo(rig: StereoRig, settings: Settings) -> bool:
    """Does the front end match left and right features?"""
    return rig.n_cameras == 2 and settings.tracker.cameras == "stereo"


def motion_window_s(rig: StereoRig, settings: Settings) -> float:
    """The length that a start in motion solves over."""
    start = settings.initialization
    return start.motion_window_s if has_stereo(rig, settings) else start.mono_window_s


@dataclass(frozen=True, slots=True)
class InitialGuess:
    """A closed-form solution, for the bundle adjustment to begin with.

    `first`: the state at the first of K keyframes; `T_world_imu` (K, 4, 4): poses at all; `imu_ns`
    (K,): their times on the IMU's clock, of which the last ones are those of `frames`;
    `feature_id`: features of the world; `stationary`: by static initialization.
    """

    first: ImuState
    T_world_imu: FloatArray
    imu_ns: IntArray
    frames: Sequence[FrontendFrame]
    feature_id: IntArray
    stationary: bool


@dataclass(frozen=True, slots=True)
class FilterInitializer:
    """Initializes a filter at the last of the frames seen so far.

    `rig`: that of the calibration files; `noise`: of the IMU.
    """

    rig: StereoRig
    noise: ImuNoise
    settings: Settings

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock, by the calibration's time offset."""
        return self._by_calibration.imu_time_ns(frame_ns)

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that must be reached before this frame can be used: as far beyond it as
        another time offset is sought."""
        reach_s = SEARCH_S if self.settings.filter.estimate_time_offset else 0.0
        return self.imu_time_ns(frame_ns) + round(1e9 * reach_s)

    @property
    def _by_calibration(self) -> "_Start":
        settings = self.settings.filter
        sigma_s = settings.time_offset_sigma_s if settings.estimate_time_offset else 0.0
        known = ClockOffset(self.rig.time_offset_s, sigma_s)
        return _Start(self.rig, self.noise, self.settings, known)

    def __call__(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[MsckfFilter, FeatureTable] | str:
        """A filter whose state is at the last frame's time, with the keyframes as clones, and the
        table of what they saw; or why there is none yet."""
        start, reasons = self._by_calibration, list[str]()
        for name, begin in (("static", start.from_rest), ("dynamic", start.from_motion)):
            try:
                return begin(frames, imu)
            except (InitializationError, DatasetError, np.linalg.LinAlgError) as error:
                reasons.append(f"{name} initialization: {error}")
        return "; ".join(reasons)


@dataclass(frozen=True, slots=True)
class _Start:
    """A start by the time offset `clock`; what else it has is that of the initializer."""

    rig: StereoRig
    noise: ImuNoise
    settings: Settings
    clock: ClockOffset

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock."""
        return frame_ns + round(self.clock.value_s * 1e9)

    def from_rest(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[MsckfFilter, FeatureTable]:
        """Static initialization; raises `InitializationError` where the rig is not at rest."""
        return self._adjusted_filter(self._static(frames, imu), imu)

    def from_motion(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[MsckfFilter, FeatureTable]:
        """Dynamic initialization, by the time offset that fits; raises `InitializationError` where
        images and IMU do not agree."""
        start, path = self._with_clock(frames, imu)
        return start._adjusted_filter(start._dynamic(frames, imu, path), imu)

    def _with_clock(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple["_Start", StereoPath | None]:
        """The start by the time offset that the turns of the window show, if they show another, and
        the path by its offset, where there is one already."""
        span_s = (frames[-1].timestamp_ns - frames[0].timestamp_ns) * 1e-9
        short = span_s < self.settings.initialization.motion_window_s
        if short or self.clock.sigma_s == 0.0 or not has_stereo(self.rig, self.settings):
            return self, None
        stamps = [self.imu_time_ns(f.timestamp_ns) for f in frames]
        try:
            intervals = [imu.between(a, b) for a, b in pairwise(stamps)]
            path = stereo_path(frames, intervals, self.rig)
        except (InitializationError, DatasetError):
            return self, None
        clock = find_clock_offset(path, np.array(stamps), imu, self.clock)
        return (self, path) if clock == self.clock else (replace(self, clock=clock), None)

    def _static(self, frames: Sequence[FrontendFrame], imu: ImuBuffer) -> InitialGuess:
        """The guess that the rig is stationary over the window."""
        settings = self.settings.initialization
        now = self.imu_time_ns(frames[-1].timestamp_ns)
        first = imu.first_ns
        begin = now - round(1e9 * settings.window_s)
        if len(frames) < _MIN_STATIC_FRAMES or first is None or first > begin:
            raise InitializationError(
                f"fewer than {_MIN_STATIC_FRAMES} frames over {settings.window_s:g} s of IMU"
            )
        begin = min(begin, self.imu_time_ns(frames[0].timestamp_ns))
        samples = imu.between(begin, now)
        gravity = self.settings.filter.gravity_mps2
        # without stereo nothing tells traffic around a stationary rig from a world that passes by
        rest = self.settings.zero_velocity
        least_share = None if has_stereo(self.rig, self.settings) else rest.still_share
        solution = static_initialization(
            frames, samples, self.rig, settings, gravity, rest.pixel, least_share
        )
        state = solution.state
        keyframes = [frames[k] for k in self._keyframes(frames)]
        stamps = [self.imu_time_ns(f.timestamp_ns) for f in keyframes]
        if begin < stamps[0]:
            stamps = [begin, *stamps]  # the rig is stationary before the first frame too
        T = np.broadcast_to(se3.make(state.R_world_imu, state.position), (len(stamps), 4, 4))
        return InitialGuess(
            state, T, np.array(stamps), keyframes, solution.feature_id, stationary=True
        )

    def _dynamic(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer, path: StereoPath | None
    ) -> InitialGuess:
        """The guess by images in motion and IMU over the window; `path`: see `_with_clock`."""
        settings, window_s = self.settings, motion_window_s(self.rig, self.settings)
        span_s = (frames[-1].timestamp_ns - frames[0].timestamp_ns) * 1e-9
        if span_s < window_s:
            raise InitializationError(f"{span_s:.2f} s of frames (needs {window_s:g} s)")
        if len(frames) < _MIN_DYNAMIC_FRAMES:
            raise InitializationError(f"only {len(frames)} frames (at least {_MIN_DYNAMIC_FRAMES})")
        stamps = [self.imu_time_ns(f.timestamp_ns) for f in frames]
        intervals = [imu.between(a, b) for a, b in pairwise(stamps)]
        prior = InitializationPrior(
            settings.filter.gravity_mps2, settings.initialization.accel_bias_sigma_mps2
        )
        given = frames, intervals, self.rig, self.noise, prior
        if has_stereo(self.rig, settings):
            solution = dynamic_initialization(*given, path=path)
        else:
            solution = monocular_initialization(*given)
        index = self._keyframes(frames)
        return InitialGuess(
            solution.first, solution.T_world_imu[index], np.array(stamps)[index],
            [frames[k] for k in index], solution.feature_id, stationary=False,
        )  # fmt: skip

    def _adjusted_filter(
        self, guess: InitialGuess, imu: ImuBuffer
    ) -> tuple[MsckfFilter, FeatureTable]:
        """The filter after bundle adjustment, and the table with used observations marked."""
        for_filter = self._features_for_filter(guess)
        adjusted = self._bundle_adjusted(guess, np.setdiff1d(guess.feature_id, for_filter), imu)
        if max(adjusted.factor_rms, adjusted.pixel_rms) > _MAX_RMS:
            raise InitializationError(
                f"IMU and images of the window are off by {adjusted.factor_rms:.1f} and"
                f" {adjusted.pixel_rms:.1f} sigma (at most {_MAX_RMS:g})"
            )
        if not (guess.stationary or has_stereo(self.rig, self.settings)):
            self._check_scale(adjusted)
        frames = guess.frames
        n_without_frame = len(guess.imu_ns) - len(frames)
        kept = np.arange(len(frames))[-self.settings.filter.max_clones :]
        clone_ns = np.array([frames[k].timestamp_ns for k in kept])
        state = filter_state(
            adjusted.window, adjusted.covariance, n_without_frame + kept, clone_ns,
            self.clock.value_s,
        )  # fmt: skip
        state = replace(
            state,
            covariance=state.covariance + self._bias_walk(guess, len(state.covariance)),
            landmarks=no_landmarks(self.settings.filter.landmark_representation),
        )
        source = MsckfFilter(
            state, self.rig, self.noise, self.settings, guess.stationary, frames[-1].timestamp_ns
        )
        return source, _feature_table(frames, clone_ns, for_filter)

    def _check_scale(self, adjusted: AdjustedWindow) -> None:
        """Raise `InitializationError` where one camera and the IMU do not tell how far the window's
        path goes: without accelerations any scale fits both."""
        greatest = self.settings.initialization.mono_scale_sigma
        sigma = scale_sigma(adjusted.window, adjusted.covariance)
        if not sigma < greatest:
            raise InitializationError(
                f"one camera, and too little acceleration: the scale is known to"
                f" {100 * sigma:.0f} % (needs {100 * greatest:g} %)"
            )

    def _bias_walk(self, guess: InitialGuess, size: int) -> FloatArray:
        """Covariance (size, size) of the biases' random walk over the window, in which they were
        taken as constant."""
        span_s = (guess.imu_ns[-1] - guess.imu_ns[0]) * 1e-9
        variance = np.zeros(size)
        variance[GYRO_BIAS] = self.noise.gyro_walk**2 * span_s
        variance[ACCEL_BIAS] = self.noise.accel_walk**2 * span_s
        return np.diag(variance)

    def _bundle_adjusted(
        self, guess: InitialGuess, feature_id: IntArray, imu: ImuBuffer
    ) -> AdjustedWindow:
        """The guess adjusted to the IMU and to what its frames saw of these features."""
        settings = self.settings
        gravity, sigma_s = settings.filter.gravity_mps2, self.clock.sigma_s
        accel_bias_sigma = settings.initialization.accel_bias_sigma_mps2
        samples = [imu.between(int(a), int(b)) for a, b in pairwise(guess.imu_ns)]
        in_gap = [imu.spacing_s(s) > settings.imu.max_gap_s for s in samples]
        intervals = ImuIntervals(
            samples, in_gap, self.noise, INTEGRATORS[settings.filter.integration]
        )
        calibration, variance = make_calibration(self.rig, settings.calibration)
        gyro = np.array([samples[0].gyro[0], *(s.gyro[-1] for s in samples)])
        window = KeyframeWindow(
            guess.imu_ns, guess.T_world_imu, np.zeros((len(gyro), 3)), gyro,
            guess.first.gyro_bias, guess.first.accel_bias, 0.0, calibration,
        )  # fmt: skip
        window = _with_velocities(window, guess.first.velocity, intervals, gravity)

        def factors(at: KeyframeWindow) -> list[Factor]:
            out = [
                imu_factor(at, intervals, gravity),
                prior_factor(at, accel_bias_sigma, sigma_s, variance),
            ]
            if guess.stationary:
                out.append(zero_velocity_factor(at))
            return out

        pixels = keyframe_pixels(guess.frames, feature_id)
        no_frame = np.full((len(pixels), len(gyro) - len(guess.frames), 4), np.nan)
        return bundle_adjust(
            window, factors, np.concatenate([no_frame, pixels], axis=1), self.rig, settings.filter,
            offset_is_free=sigma_s > 0.0, considered=variance[calibration.n_estimated :],
        )  # fmt: skip

    def _features_for_filter(self, guess: InitialGuess) -> IntArray:
        """Features left to the filter: the longest tracks of those still seen, later SLAM features,
        worth more unused; of a stationary rig all, as images add nothing to its zero velocity."""
        frames = guess.frames
        if guess.stationary:
            return np.unique(np.concatenate([f.feature_id for f in frames]))
        seen_now = frames[-1].feature_id
        n_views = np.sum([np.isin(seen_now, f.feature_id) for f in frames], axis=0)
        longest = np.argsort(-n_views, kind="stable")[: self.settings.filter.max_landmarks]
        return np.asarray(seen_now[longest])

    def _keyframes(self, frames: Sequence[FrontendFrame]) -> list[int]:
        """The first and the last frame, and those between that are `clone_spacing_s` apart."""
        spacing_ns = (1.0 - FRAME_JITTER) * 1e9 * self.settings.filter.clone_spacing_s
        last = len(frames) - 1
        out = [0]
        for k in range(1, last):
            to_previous = frames[k].timestamp_ns - frames[out[-1]].timestamp_ns
            to_last = frames[last].timestamp_ns - frames[k].timestamp_ns
            if min(to_previous, to_last) >= spacing_ns:
                out.append(k)
        return [*out, last]


def _with_velocities(
    window: KeyframeWindow, first: FloatArray, intervals: ImuIntervals, gravity: float
) -> KeyframeWindow:
    """The window with velocities (K, 3) propagated by the IMU from that of the first keyframe."""
    velocity = [first]
    preintegrated = preintegrate(window, intervals)
    for R, motion, span_ns in zip(
        window.T_world_imu[:-1, :3, :3], preintegrated, np.diff(window.imu_ns), strict=True
    ):
        delta_v = R @ motion.imu.velocity - np.array([0.0, 0.0, gravity * 1e-9 * span_ns])
        velocity.append(velocity[-1] + delta_v)
    return replace(window, velocity=np.array(velocity))


def _feature_table(
    frames: Sequence[FrontendFrame], clone_ns: IntArray, for_filter: IntArray
) -> FeatureTable:
    """The table of the frames that are clones, with the observations marked that the bundle
    adjustment has used: all of features seen twice or more, but for those left to the filter."""
    table = empty_table()
    for frame in frames:
        if frame.timestamp_ns in clone_ns:
            table = append_frame(table, frame)
    used = (table.seen.sum(axis=0) > 1) & ~np.isin(table.feature_id, for_filter)
    return mark_used(table, table.seen & used)
