"""Every value that crosses a folder's border.

Frozen dataclasses over NumPy arrays: a function that changes one returns a new one. Time is in
integer nanoseconds, everything else in SI units. `T_a_b` maps points of frame b into frame a.
"""

from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

import numpy as np

from ovmot.errors import OvmotError
from ovmot.geometry.arrays import BoolArray, FloatArray, Image, IntArray


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One IMU reading, in the IMU's axes.

    Attributes
    ----------
    timestamp_ns
        Time on the IMU's clock, integer ns.
    gyro
        Angular velocity (3,), rad/s.
    accel
        Specific force (3,), m/s²; at rest it is +9.81 along the axis that points up.
    """

    timestamp_ns: int
    gyro: FloatArray
    accel: FloatArray


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """One stereo pair, both images exposed at the same time; or the image of the one camera.

    Attributes
    ----------
    timestamp_ns
        Middle of the exposure on the cameras' clock, integer ns.
    left, right
        Grey images (height, width) of `cam0` and `cam1`, uint8, as they come: not undistorted, not
        rectified. A monocular rig has no `right` one.
    left_mask, right_mask
        Images (height, width); from pixels where they are not zero, nothing is taken.
    missing
        Cameras, 0 left and 1 right, that gave no picture: a black image stands in its place.
    """

    timestamp_ns: int
    left: Image
    right: Image | None = None
    left_mask: Image | None = None
    right_mask: Image | None = None
    missing: tuple[int, ...] = ()

    @property
    def pair(self) -> tuple[Image, Image]:
        """Both images; raises `OvmotError` where there is only one."""
        if self.right is None:
            raise OvmotError(f"frame {self.timestamp_ns}: one image where two were expected")
        return self.left, self.right


class Picture(StrEnum):
    """What a camera gave: a picture, or one that is not matched since it shows nothing of now.

    `missing`: none; `flat`: without contrast, black or white all over; `repeated`: the last one
    once more, though the rig moved; `torn`: rows of the last one in it.
    """

    FINE = "fine"
    MISSING = "missing"
    FLAT = "flat"
    REPEATED = "repeated"
    TORN = "torn"


@dataclass(frozen=True, slots=True)
class FeatureFrame:
    """Features with ids in place of the images of one stereo pair: what another tracker saw.

    The odometry takes them with the front end `GivenFeatures`.

    Attributes
    ----------
    timestamp_ns
        Middle of the exposure on the cameras' clock, integer ns.
    feature_id
        Ids (N,), the same from frame to frame, each once.
    pixels
        Pixels (N, 4): u, v in the left and u, v in the right image; the right half is NaN where
        there is no match, the left half for a feature of the right camera alone. The matches have
        not been checked.
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
    """Continuous-time noise densities of an IMU, as Kalibr and OpenVINS give them.

    Attributes
    ----------
    gyro, accel
        White noise: rad/s/√Hz and m/s²/√Hz.
    gyro_walk, accel_walk
        Random walk of the biases: rad/s²/√Hz and m/s³/√Hz.
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

    `sigma_px`: white noise of each pixel coordinate of a stereo pair, as many points show it.
    `single_px`: the same for a judgement on one point, whose patch may lie at a slant or at a depth
    edge: such errors go along the epipolar line. A tracked patch drifts on its
    surface: `drift_per_frame_px` from one frame to the next, as a random walk, and further
    `drift_per_flow` of its way through the image, as its view changes.
    """

    sigma_px: float
    single_px: float
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
    `pictures`: what the left and the right camera gave.
    """

    timestamp_ns: int
    feature_id: IntArray
    pixels: FloatArray
    normalized: FloatArray
    track_length: IntArray
    two_view_inlier: BoolArray
    pictures: tuple[Picture, Picture] = (Picture.FINE, Picture.FINE)

    def __len__(self) -> int:
        return len(self.feature_id)


def no_features(timestamp_ns: int) -> FrontendFrame:
    """A frame in which nothing is seen."""
    ids, nothing = np.empty(0, dtype=np.int64), np.empty((0, 4))
    return FrontendFrame(timestamp_ns, ids, nothing, nothing, ids, ids > 0)


@dataclass(frozen=True, slots=True)
class StereoMatches:
    """The N stereo matches of a frame that the epipolar gate has tested.

    Attributes
    ----------
    feature_id
        Ids (N,) of the features.
    pixels
        Pixels (N, 4): u, v in the left and u, v in the right image.
    distance_px
        Distance (N,) of the right point to its epipolar line, pixels.
    accepted
        Which matches (N,) passed.
    line
        Epipolar lines (N, 3): a x + b y + c = 0 in the right camera's normalized coordinates.
    """

    feature_id: IntArray
    pixels: FloatArray
    distance_px: FloatArray
    accepted: BoolArray
    line: FloatArray


class PointLabel(IntEnum):
    """Does a point of the scene move? Unknown where there was nothing to compare it with."""

    UNKNOWN = 0
    STATIC = 1
    DYNAMIC = 2


@dataclass(frozen=True, slots=True)
class ScenePoints:
    """The N features of a frame: where they are, whether they move, and how that was decided.

    Attributes
    ----------
    feature_id
        Ids (N,), the same from frame to frame.
    pixels
        Pixels (N, 4): u, v in the left and u, v in the right image, NaN where not seen.
    p_cam0
        Positions (N, 3) in the left camera's frame from this stereo pair alone, m; NaN without a
        match.
    cov_cam0
        Covariance (N, 3, 3) of `p_cam0`, m².
    label
        `PointLabel` (N,) as integers.
    track_id
        The object (N,) that the feature belongs to, -1 for none.
    previous
        Left pixels (N, 2) at the earlier frame of the comparison.
    predicted
        Left pixels (N, 2) where a static point would be now.
    distance_m
        Distance (N,) between predicted and observed position, depth weighted down, m.
    reprojection_px
        Reprojection error (N,) of the prediction, the worse of both cameras, pixels.
    two_view_inlier
        Which features (N,) passed the front end's RANSAC between the last frame and this one.
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

    Attributes
    ----------
    names
        The coordinates' names, as in `calibration.csv`.
    deviation, std
        Value and 1-sigma (C,): extrinsics as rotation vectors (rad) and positions (m) of the
        cameras in the IMU's frame, intrinsics in pixels, distortion coefficients, the IMU's
        matrices by row.
    """

    names: tuple[str, ...]
    deviation: FloatArray
    std: FloatArray


@dataclass(frozen=True, slots=True)
class EgoEstimate:
    """The rig's state at one frame and its covariance.

    Quantities that an odometry source cannot know (a pose file has no biases) are NaN, with NaN in
    the covariance.

    Attributes
    ----------
    timestamp_ns
        Stamp of the frame on the cameras' clock, ns.
    T_world_imu
        Pose (4, 4) of the IMU: maps points of its frame into the world (z up), m.
    velocity
        Velocity (3,) of the IMU in the world, m/s.
    gyro_bias, accel_bias
        Biases (3,) in the IMU's axes, rad/s and m/s².
    covariance
        (15, 15) over rotation (right perturbation, rad), position, velocity, gyro bias,
        accelerometer bias, in the units above squared.
    T_imu_cam0, T_imu_cam1
        Poses (4, 4) of the cameras in the IMU's frame, as calibrated now, m.
    time_offset_s, time_offset_std_s
        t_imu - t_cam and its 1-sigma, s.
    standing
        Whether the rig is stationary: a zero-velocity update was made.
    health
        How far the pose can be trusted.
    calibration
        What is estimated of the calibration, None where nothing is.
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
    """One moving rigid object at one frame; a row of `tracks.csv`.

    Attributes
    ----------
    track_id
        The object's number; it is used once in a run.
    state
        "tentative": new, often false; "confirmed"; "coasting": predicted, not seen in this frame.
    position
        Centre (3,) of its box in the world, m.
    velocity
        Velocity (3,) in the world, m/s.
    yaw, yaw_rate
        Heading about the world's z axis from its x axis, rad, and its rate, rad/s.
    size
        Length, width, height (3,) of the box, m: of what was seen of it so far, or, where a side of
        a vehicle was not seen, the usual one.
    box_px
        u_min, v_min, u_max, v_max (4,) in the left image, pixels; NaN where it is not in view.
    n_points
        Features seen of it in this frame.
    std_position, std_velocity
        1-sigma (3,) of position and velocity, m and m/s.
    class_probability
        Probability (3,) that it moves as a walker, a cyclist, a vehicle; NaN where not known.
    std_size
        1-sigma (3,) of length, width and height, m.
    std_yaw, std_yaw_rate
        1-sigma of the heading, rad, and of its rate, rad/s.
    """

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
    class_probability: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    std_size: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    std_yaw: float = float("nan")
    std_yaw_rate: float = float("nan")


@dataclass(frozen=True, slots=True)
class FrameResult:
    """What the odometry gives for one stereo frame.

    The parts asked for most are properties: `timestamp_ns`, `T_world_imu`, `velocity`,
    `covariance`, `health`.

    Attributes
    ----------
    frame
        The frame itself.
    ego
        The rig's state, its covariance and the calibration in use.
    points
        The frame's features: positions and static, dynamic or unknown.
    matches
        Every stereo match that was tested.
    tracks
        The moving objects, confirmed or not.
    milliseconds
        Time of each stage, ms.
    segment
        How often the motion was lost before; between segments the pose may jump.
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
        """Stamp of the frame on the cameras' clock, integer ns."""
        return self.frame.timestamp_ns

    @property
    def T_world_imu(self) -> FloatArray:
        """Pose (4, 4) of the IMU: maps points of its frame into the world (z up), m."""
        return self.ego.T_world_imu

    @property
    def velocity(self) -> FloatArray:
        """Velocity (3,) of the IMU in the world, m/s."""
        return self.ego.velocity

    @property
    def covariance(self) -> FloatArray:
        """Covariance (15, 15) of the state: see `EgoEstimate.covariance`."""
        return self.ego.covariance

    @property
    def health(self) -> Health:
        """How far the pose can be trusted."""
        return self.ego.health


@dataclass(frozen=True, slots=True)
class PoseWindow:
    """The poses that segmentation and front end reason with: K clones, newest last.

    `timestamp_ns` (K,), `T_world_imu` (K, 4, 4), `covariance` (6K, 6K) over rotation (right
    perturbation, rad) and position (m) of each clone.
    """

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    covariance: FloatArray
