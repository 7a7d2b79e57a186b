"""How the filter starts: at rest if the rig rests, else in motion; then refined over its window."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError
from ovmot.feature_table import FeatureTable, append_frame, empty_table, mark_used
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.initialization.bundle_adjustment import AdjustedWindow, bundle_adjust, window_pixels
from ovmot.initialization.dynamic import (
    CannotInitialize,
    InitializationPrior,
    dynamic_initialization,
)
from ovmot.initialization.factors import (
    Factor,
    ImuPieces,
    imu_factor,
    preintegrate,
    prior_factor,
    rest_factor,
)
from ovmot.initialization.static import (
    image_restless,
    imu_restless,
    standing_points,
    static_initialization,
)
from ovmot.initialization.window import KeyframeWindow, filter_state
from ovmot.settings import Settings
from ovmot.types import FrontendFrame, ImuData, ImuNoise
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.landmarks import no_landmarks
from ovmot.vio.online_calibration import make_calibration
from ovmot.vio.propagation import INTEGRATORS
from ovmot.vio.state import ACCEL_BIAS, GYRO_BIAS, ImuState

_MIN_REST_FRAMES = 3
_MIN_MOTION_FRAMES = 5
_SPACING_SLACK = 0.95  # frames do not come to the nanosecond
_MAX_FEATURES = 600  # of the refinement, those seen longest first
_MAX_RMS = 3.0  # standard deviations, root mean square


@dataclass(frozen=True, slots=True)
class _InitialGuess:
    """A closed-form start: the state at the first of K instants, poses (K, 4, 4) at all, and the
    features of the world. `imu_ns` (K,); the last instants are those of `frames`."""

    first: ImuState
    T_world_imu: FloatArray
    imu_ns: IntArray
    frames: Sequence[FrontendFrame]
    feature_id: IntArray
    resting: bool


@dataclass(frozen=True, slots=True)
class FilterInitializer:
    """Looks at the frames seen so far and the IMU; gives a filter at the last of them."""

    rig: StereoRig
    noise: ImuNoise
    settings: Settings

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock, by the calibration's time offset."""
        return frame_ns + round(self.rig.time_offset_s * 1e9)

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that must be reached before this frame is looked at."""
        return self.imu_time_ns(frame_ns)

    def __call__(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[MsckfFilter, FeatureTable] | str:
        """A filter whose state is at the last frame's time, with the window's poses as clones and
        the table of what they saw, or why there is none yet."""
        why, kind = "", "at rest"
        try:
            guess = self._at_rest(frames, imu)
            if isinstance(guess, str):
                why, kind = f"not at rest: {guess}; ", "in motion"
                guess = self._in_motion(frames, imu)
            return self._started(guess, imu)
        except (CannotInitialize, DatasetError, np.linalg.LinAlgError) as error:
            return f"{why}{kind}: {error}"

    def _at_rest(self, frames: Sequence[FrontendFrame], imu: ImuBuffer) -> _InitialGuess | str:
        settings = self.settings.initialization
        now = self.imu_time_ns(frames[-1].timestamp_ns)
        first = imu.first_ns
        begin = now - round(1e9 * settings.window_s)
        if len(frames) < _MIN_REST_FRAMES or first is None or first > begin:
            return f"fewer than {_MIN_REST_FRAMES} frames over {settings.window_s:g} s of IMU"
        begin = min(begin, self.imu_time_ns(frames[0].timestamp_ns))
        samples = imu.between(begin, now)
        points = standing_points(frames[0], frames[-1], self.rig, settings.rest_pixel)
        gravity = self.settings.filter.gravity_mps2
        failure = imu_restless(samples, settings, gravity) or image_restless(points, settings)
        if failure is not None:
            return failure
        state = static_initialization(samples)
        nodes = [frames[k] for k in self._spaced(frames)]
        stamps = [self.imu_time_ns(f.timestamp_ns) for f in nodes]
        if begin < stamps[0]:
            stamps = [begin, *stamps]  # the rest before the first frame counts as well
        T = np.broadcast_to(se3.make(state.R_world_imu, state.position), (len(stamps), 4, 4))
        return _InitialGuess(state, T, np.array(stamps), nodes, points.feature_id, resting=True)

    def _in_motion(self, frames: Sequence[FrontendFrame], imu: ImuBuffer) -> _InitialGuess:
        settings = self.settings
        window_s = settings.initialization.motion_window_s
        span_s = (frames[-1].timestamp_ns - frames[0].timestamp_ns) * 1e-9
        if span_s < window_s:
            raise CannotInitialize(f"{span_s:.2f} s of frames (needs {window_s:g} s)")
        if len(frames) < _MIN_MOTION_FRAMES:
            raise CannotInitialize(f"only {len(frames)} frames (at least {_MIN_MOTION_FRAMES})")
        stamps = [self.imu_time_ns(f.timestamp_ns) for f in frames]
        pieces: list[ImuData] = [imu.between(a, b) for a, b in pairwise(stamps)]
        prior = InitializationPrior(
            settings.filter.gravity_mps2, settings.initialization.accel_bias_sigma_mps2
        )
        start = dynamic_initialization(frames, pieces, self.rig, self.noise, prior)
        chosen = self._spaced(frames)
        return _InitialGuess(
            start.first, start.T_world_imu[chosen], np.array(stamps)[chosen],
            [frames[k] for k in chosen], start.feature_id, resting=False,
        )  # fmt: skip

    def _started(self, guess: _InitialGuess, imu: ImuBuffer) -> tuple[MsckfFilter, FeatureTable]:
        """The refined filter, and the table in which what it used is marked."""
        left = self._left_to_filter(guess)
        refined = self._refined(guess, np.setdiff1d(guess.feature_id, left), imu)
        if max(refined.factor_rms, refined.pixel_rms) > _MAX_RMS:
            raise CannotInitialize(
                f"IMU and images of the window are off by {refined.factor_rms:.1f} and"
                f" {refined.pixel_rms:.1f} sigma (at most {_MAX_RMS:g})"
            )
        frames = guess.frames
        blind = len(guess.imu_ns) - len(frames)  # instants before the first frame
        kept = np.arange(len(frames))[-self.settings.filter.max_clones :]
        clone_ns = np.array([frames[k].timestamp_ns for k in kept])
        state = filter_state(
            refined.window, refined.covariance, blind + kept, clone_ns, self.rig.time_offset_s
        )
        state = replace(
            state,
            covariance=state.covariance + self._bias_walk(guess, len(state.covariance)),
            landmarks=no_landmarks(self.settings.filter.landmark_representation),
        )
        ego = MsckfFilter(
            state, self.rig, self.noise, self.settings, guess.resting, frames[-1].timestamp_ns
        )
        return ego, _table_of(frames, clone_ns, left)

    def _bias_walk(self, guess: _InitialGuess, size: int) -> FloatArray:
        """How far the biases, one for the whole window, may have walked at its end (N, N)."""
        span_s = (guess.imu_ns[-1] - guess.imu_ns[0]) * 1e-9
        variance = np.zeros(size)
        variance[GYRO_BIAS] = self.noise.gyro_walk**2 * span_s
        variance[ACCEL_BIAS] = self.noise.accel_walk**2 * span_s
        return np.diag(variance)

    def _refined(
        self, guess: _InitialGuess, feature_id: IntArray, imu: ImuBuffer
    ) -> AdjustedWindow:
        """The guess refined by the IMU and what its frames saw of some features."""
        settings = self.settings
        gravity, sigma_s = settings.filter.gravity_mps2, self._offset_sigma_s()
        accel_bias_sigma = settings.initialization.accel_bias_sigma_mps2
        cuts = [imu.between(int(a), int(b)) for a, b in pairwise(guess.imu_ns)]
        unseen = [imu.spacing_s(c) > settings.imu.max_gap_s for c in cuts]
        pieces = ImuPieces(cuts, unseen, self.noise, INTEGRATORS[settings.filter.integration])
        calibration, variance = make_calibration(self.rig, settings.calibration)
        gyro = np.array([cuts[0].gyro[0], *(c.gyro[-1] for c in cuts)])
        window = KeyframeWindow(
            guess.imu_ns, guess.T_world_imu, np.zeros((len(gyro), 3)), gyro,
            guess.first.gyro_bias, guess.first.accel_bias, 0.0, calibration,
        )  # fmt: skip
        window = _with_velocities(window, guess.first.velocity, pieces, gravity)

        def factors(at: KeyframeWindow) -> list[Factor]:
            known = [
                imu_factor(at, pieces, gravity),
                prior_factor(at, accel_bias_sigma, sigma_s, variance),
            ]
            return [*known, rest_factor(at)] if guess.resting else known

        pixels = window_pixels(guess.frames, feature_id, _MAX_FEATURES)
        blind = np.full((len(pixels), len(gyro) - len(guess.frames), 4), np.nan)
        return bundle_adjust(
            window, factors, np.concatenate([blind, pixels], axis=1), self.rig, settings.filter,
            offset_is_free=sigma_s > 0.0,
        )  # fmt: skip

    def _left_to_filter(self, guess: _InitialGuess) -> IntArray:
        """Features that the refinement does not use, and the filter therefore may.

        Those that will become landmarks: of the features still seen, the ones seen longest. Their
        tracks reach over the end of the window, and are worth more whole. At rest it is all of
        them: images of a rig that stands add nothing to its rest.
        """
        frames = guess.frames
        if guess.resting:
            return np.unique(np.concatenate([f.feature_id for f in frames]))
        alive = frames[-1].feature_id
        views = np.sum([np.isin(alive, f.feature_id) for f in frames], axis=0)
        longest = np.argsort(-views, kind="stable")[: self.settings.filter.max_landmarks]
        return np.asarray(alive[longest])

    def _spaced(self, frames: Sequence[FrontendFrame]) -> list[int]:
        """The first and the last frame, and those between that are `clone_spacing_s` apart."""
        step_ns = _SPACING_SLACK * 1e9 * self.settings.filter.clone_spacing_s
        last = len(frames) - 1
        out = [0]
        for k in range(1, last):
            since = frames[k].timestamp_ns - frames[out[-1]].timestamp_ns
            left = frames[last].timestamp_ns - frames[k].timestamp_ns
            if min(since, left) >= step_ns:
                out.append(k)
        return [*out, last]

    def _offset_sigma_s(self) -> float:
        known = self.settings.filter
        return known.time_offset_sigma_s if known.estimate_time_offset else 0.0


def _with_velocities(
    window: KeyframeWindow, first: FloatArray, pieces: ImuPieces, gravity: float
) -> KeyframeWindow:
    """The window with velocities (K, 3) carried on by the IMU from that of the first instant."""
    velocity = [first]
    motions = preintegrate(window, pieces)
    for R, motion, span_ns in zip(
        window.T_world_imu[:-1, :3, :3], motions, np.diff(window.imu_ns), strict=True
    ):
        gained = R @ motion.imu.velocity - np.array([0.0, 0.0, gravity * 1e-9 * span_ns])
        velocity.append(velocity[-1] + gained)
    return replace(window, velocity=np.array(velocity))


def _table_of(frames: Sequence[FrontendFrame], clone_ns: IntArray, left: IntArray) -> FeatureTable:
    """The table of the frames that are clones. What the refinement has used is marked; of the
    features `left` it used none, and one view alone tells nothing."""
    table = empty_table()
    for frame in frames:
        if frame.timestamp_ns in clone_ns:
            table = append_frame(table, frame)
    spent = (table.seen.sum(axis=0) > 1) & ~np.isin(table.feature_id, left)
    return mark_used(table, table.seen & spent)
