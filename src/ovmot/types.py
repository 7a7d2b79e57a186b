"""Every value that crosses a folder's border.

Frozen dataclasses over NumPy arrays: a function that changes one returns a new one. Time is in
integer nanoseconds, everything else in SI units. `T_a_b` maps points of frame b into frame a.
"""

from dataclasses import dataclass
from enum import IntEnum, StrEnum

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One IMU reading: angular velocity (3,) in rad/s and specific force (3,) in m/s²."""

    timestamp_ns: int
    gyro: FloatArray
    accel: FloatArray


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """One stereo pair of grey images (height, width), both exposed at `timestamp_ns`.

    From pixels where a mask (height, width) is not zero, nothing is taken.
    """

    timestamp_ns: int
    left: Image
    right: Image
    left_mask: Image | None = None
    right_mask: Image | None = None


@dataclass(frozen=True, slots=True)
class FeatureFrame:
    """Features with ids in place of the images of one stereo pair: what another tracker saw.

    `pixels` (N, 4): u, v in the left and u, v in the right image, the right half NaN where there is
    no match, the left half for a feature of the right camera alone. The matches have not been
    checked.
    """

    timestamp_ns: int
    feature_id: IntArray
    pixels: FloatArray


def tracked_pixels(pixels: FloatArray) -> FloatArray:
    """Positions (..., 2) of features (..., 4) in the camera that follows them.

    That is the left one, but for features that the right camera follows by itself.
    """
    return np.where(np.isnan(pixels[..., :2]), pixels[..., 2:], pixels[..., :2])


Event = ImuSample | StereoFrame | FeatureFrame


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Continuous-time noise densities of an IMU.

    gyro rad/s/√Hz, gyro_walk rad/s²/√Hz, accel m/s²/√Hz, accel_walk m/s³/√Hz.
    """

    gyro: float
    gyro_walk: float
    accel: float
    accel_walk: float


@dataclass(frozen=True, slots=True)
class ImuData:
    """A run of IMU samples: times (N,) in ns, gyro (N, 3) in rad/s, accel (N, 3) in m/s²."""

    timestamp_ns: IntArray
    gyro: FloatArray
    accel: FloatArray

    def __len__(self) -> int:
        return len(self.timestamp_ns)


@dataclass(frozen=True, slots=True)
class PixelNoise:
    """Noise of tracked features in the image, standard deviations.

    `sigma_px`: white noise of each pixel coordinate of a stereo pair. A tracked patch drifts on its
    surface: `drift_per_frame_px` from one frame to the next, as a random walk, and further
    `drift_per_flow` of its way through the image, as its view changes.
    """

    sigma_px: float
    drift_per_frame_px: float
    drift_per_flow: float

    def drift_sigma_px(self, n_frames: IntArray) -> FloatArray:
        """Standard deviation (L,) of the drift over numbers of frames (L,), pixels."""
        return np.asarray(self.drift_per_frame_px * np.sqrt(n_frames))


@dataclass(frozen=True, slots=True)
class FrontendFrame:
    """What the front end saw in one stereo frame: N features, tracked ones and new ones.

    `pixels` (N, 4) is u, v in the left and u, v in the right image, the right half NaN where no
    accepted stereo match exists, the left half where the right camera follows the feature by
    itself; `normalized` (N, 4) is the same in undistorted plane coordinates.
    `track_length` (N,) counts the frames through which KLT has carried the feature (0: new here);
    `two_view_inlier` (N,) is the verdict of the robust test between the last frame and this one.
    """

    timestamp_ns: int
    feature_id: IntArray
    pixels: FloatArray
    normalized: FloatArray
    track_length: IntArray
    two_view_inlier: BoolArray

    def __len__(self) -> int:
        return len(self.feature_id)


@dataclass(frozen=True, slots=True)
class StereoMatches:
    """Every stereo match tested in a frame by the epipolar gate, accepted or not.

    `pixels` (N, 4): left and right position; `distance_px` (N,): distance of the right point to
    its epipolar line; `line` (N, 3): that line a, b, c in the right camera's undistorted plane.
    """

    feature_id: IntArray
    pixels: FloatArray
    distance_px: FloatArray
    accepted: BoolArray
    line: FloatArray


class PointLabel(IntEnum):
    """Does a point of the scene move?"""

    UNKNOWN = 0
    STATIC = 1
    DYNAMIC = 2


@dataclass(frozen=True, slots=True)
class ScenePoints:
    """The split's verdict on the N features of a frame, with what it was decided from.

    `p_cam0` (N, 3): position in the left camera from stereo alone, metres, NaN without a match;
    `cov_cam0` (N, 3, 3): its covariance. `label` (N,) holds `PointLabel`, `track_id` (N,) the
    object or -1. `previous` and `predicted` (N, 2): left pixels at the earlier time compared and
    where a static point would be now. `distance_m` and `reprojection_px` (N,): the two distances
    of that comparison. `two_view_inlier` (N,): the verdict of the front end's robust test.
    """

    feature_id: IntArray
    pixels: FloatArray
    p_cam0: FloatArray
    cov_cam0: FloatArray
    label: IntArray
    track_id: IntArray
    previous: FloatArray
    predicted: FloatArray
    distance_m: FloatArray
    reprojection_px: FloatArray
    two_view_inlier: BoolArray


class Health(StrEnum):
    """How far the ego motion can be trusted: seen, from the IMU alone for a while, or no more."""

    TRACKING = "tracking"
    DEGRADED = "degraded"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class CalibrationEstimate:
    """The calibration estimated online: C coordinates by name, as deviations from the files'.

    `deviation`, `std` (C,): extrinsics as rotation vectors (rad) and positions (m) of cameras on
    the IMU, lenses in pixels and coefficients, matrices of the IMU by row.
    """

    names: tuple[str, ...]
    deviation: FloatArray
    std: FloatArray


@dataclass(frozen=True, slots=True)
class EgoEstimate:
    """Where the rig is at one frame: the IMU's state and its covariance.

    `covariance` (15, 15) is over rotation (right perturbation, rad), position, velocity, gyro
    bias, accelerometer bias. Quantities an ego source can not know (a pose file has no biases)
    are NaN, with NaN in the covariance.
    """

    timestamp_ns: int
    T_world_imu: FloatArray
    velocity: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    covariance: FloatArray
    T_imu_cam0: FloatArray
    T_imu_cam1: FloatArray
    time_offset_s: float
    time_offset_std_s: float
    standing: bool
    health: Health = Health.TRACKING
    calibration: CalibrationEstimate | None = None


@dataclass(frozen=True, slots=True)
class ObjectTrack:
    """One moving rigid body at one frame; the row of `tracks.csv` (world frame, SI)."""

    track_id: int
    state: str
    position: FloatArray
    velocity: FloatArray
    yaw: float
    yaw_rate: float
    size: FloatArray
    box_px: FloatArray
    n_points: int
    std_position: FloatArray
    std_velocity: FloatArray


@dataclass(frozen=True, slots=True)
class FrameResult:
    """Everything the pipeline says about one stereo frame; `milliseconds` is time per stage.

    `segment` counts the resets before: between segments the position may jump.
    """

    frame: StereoFrame | FeatureFrame
    ego: EgoEstimate
    points: ScenePoints
    matches: StereoMatches
    tracks: tuple[ObjectTrack, ...]
    milliseconds: dict[str, float]
    segment: int = 0

    @property
    def timestamp_ns(self) -> int:
        return self.frame.timestamp_ns


@dataclass(frozen=True, slots=True)
class PoseWindow:
    """The poses that the split and the front end reason with: K clones, newest last.

    `timestamp_ns` (K,), `T_world_imu` (K, 4, 4), `covariance` (6K, 6K) over rotation (right
    perturbation, rad) and position (m) of each clone.
    """

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    covariance: FloatArray
