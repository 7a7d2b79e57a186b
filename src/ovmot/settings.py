"""Settings: each declared once, with its type, its default and, below it, its help.

`settings_file.load_settings` reads what differs from these defaults; `ovmot settings` prints this
page.
"""

from collections.abc import Iterator
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator


class Section(BaseModel):
    """A part of a settings file: frozen, no unknown keys, no infinities, no `yes` for a number."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False
    )

    @field_validator("*", mode="before")
    @classmethod
    def _truth_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        field = cls.model_fields[info.field_name or ""]
        if isinstance(value, bool) and field.annotation is not bool:
            raise ValueError("must not be true or false (yes, no, on, off)")
        return value


class TrackerSettings(Section):
    """Front end: corners, optical flow, stereo matching."""

    max_features: int = Field(250, ge=20, le=5000)
    """Static features kept alive in the left image, in both where each camera is by itself."""
    fast_threshold: int = Field(15, ge=1, le=255)
    """Contrast in grey levels that FAST asks of a corner."""
    equalization: Literal["histogram", "linear", "clahe", "none"] = "linear"
    """Contrast correction before matching: one gain, the histogram, local (CLAHE), or none."""
    klt_window_px: int = Field(11, ge=5, le=51)
    """Side of the patch that optical flow compares."""
    klt_levels: int = Field(5, ge=1, le=8)
    """Levels of the image pyramid; near a predicted place the two coarsest are left out."""
    fine_columns: int = Field(32, ge=4, le=256)
    """Columns of fine cells over the image, by which features are spread."""
    fine_features: int = Field(1000, ge=0, le=5000)
    """Further ones, one in each fine cell without any, to see small bodies; with objects only."""
    focus_features: int = Field(300, ge=0, le=2000)
    """Further features where something seems to move, beside those above; with objects only."""
    cameras: Literal["stereo", "left", "each"] = "stereo"
    """Match both cameras, use the left one alone, or each by itself; unmatched, nothing moves."""
    stereo_search: Literal["scan", "flow"] = "scan"
    """Stereo matches of features without a depth: along epipolar curves, or by optical flow."""
    two_view_threshold_px: float = Field(1.0, gt=0.0)
    """Epipolar distance that the robust test between consecutive images tolerates."""


class EpipolarSettings(Section):
    """Check of stereo matches by the stereo extrinsics."""

    threshold_px: float = Field(1.5, gt=0.0)
    """A stereo match farther than this from its epipolar line is refused."""
    scale: Literal["angle", "fy"] = "angle"
    """How pixels become plane units: along the line's normal, or by 1/fy."""


class NoiseSettings(Section):
    """Noise of features in the image, for all stages after the front end."""

    pixel_sigma: float | None = Field(None, gt=0.0)
    """Standard deviation of a stereo match's pixels; left out, epipolar distances measure it."""
    drift_per_frame_px: float = Field(0.15, ge=0.0)
    """How far a tracked patch drifts from one frame to the next, standard deviation."""
    drift_per_flow: float = Field(0.01, ge=0.0)
    """Further drift, as a share of its way through the image."""


class FilterSettings(Section):
    """The sliding-window filter (MSCKF)."""

    max_clones: int = Field(15, ge=4, le=60)
    """Past IMU poses kept in the state."""
    clone_spacing_s: float = Field(0.1, ge=0.0)
    """Faster frames are followed, but their clones leave so that the window spans more time."""
    integration: Literal["discrete", "rk4", "analytic"] = "rk4"
    """IMU integration: one step of mean rates, Runge-Kutta of 4th order, or in closed form."""
    pixel_sigma: float = Field(0.7, gt=0.0)
    """Standard deviation of a feature's position in the image, pixels, slid patches included."""
    chi2_multiplier: float = Field(1.0, gt=0.0)
    """Factor on the 95 % chi-squared bound of a feature's innovation."""
    max_features_per_update: int = Field(60, ge=1)
    """Features used in one update; those seen longest come first."""
    max_landmarks: int = Field(25, ge=0, le=500)
    """Features kept in the state as landmarks, those that outlive the window; 0 for none."""
    landmark_pixel_sigma: float = Field(1.5, gt=0.0)
    """The same of a landmark, pixels: a patch that slid stays so, its errors do not average out."""
    landmark_representation: Literal[
        "global_xyz", "global_inverse_depth", "anchored_xyz", "anchored_inverse_depth",
        "anchored_msckf_inverse_depth", "anchored_single_inverse_depth",
    ] = "anchored_msckf_inverse_depth"  # fmt: skip
    """How landmarks are written in the state."""
    gravity_mps2: float = Field(9.81, gt=0.0)
    """Magnitude of gravity."""
    estimate_time_offset: bool = True
    """Estimate the time offset between camera and IMU online."""
    time_offset_sigma_s: float = Field(0.005, ge=0.0)
    """Standard deviation of the time offset at the start, seconds."""


class CalibrationSettings(Section):
    """Which parts of the calibration are estimated online, and how far they may be off."""

    extrinsics: bool = False
    """Pose of the left camera on the IMU, and of the right camera on the left one."""
    intrinsics: bool = False
    """Focal lengths, centres and distortion of both lenses."""
    imu_intrinsics: bool = False
    """Scale and misalignment of gyroscope and accelerometer."""
    g_sensitivity: bool = False
    """What acceleration does to the gyroscope."""
    rotation_sigma_rad: float = Field(0.01, gt=0.0)
    """Standard deviation of the left camera's rotation on the IMU at the start."""
    position_sigma_m: float = Field(0.01, gt=0.0)
    """Standard deviation of the left camera's position on the IMU at the start."""
    stereo_rotation_sigma_rad: float = Field(1e-3, gt=0.0)
    """Standard deviation of the right camera's rotation on the left one at the start."""
    stereo_position_sigma_m: float = Field(2e-3, gt=0.0)
    """Standard deviation of the right camera's position across the baseline at the start."""
    baseline_sigma: float = Field(1e-3, gt=0.0)
    """Standard deviation of the baseline's length at the start, as a share of it."""
    focal_sigma_px: float = Field(3.0, gt=0.0)
    """Standard deviation of focal lengths and image centres at the start."""
    lens_sigma_px: float | None = Field(None, ge=0.0)
    """Standard deviation of the image centres where cameras are not calibrated online; left out:
    0.25, as good calibrations leave; 0: exact, as in simulations."""

    @property
    def any(self) -> bool:
        """Whether any part is estimated."""
        return self.extrinsics or self.intrinsics or self.imu_intrinsics or self.g_sensitivity


class MaskSettings(Section):
    """Parts of the pictures that nothing is taken from, beside the folder of --masks."""

    segmentation_ids: tuple[int, ...] = ()
    """Ids in the data's segmentation pictures (VIODE) whose pixels are masked."""


class ImuSettings(Section):
    """Noise of the IMU; densities left out are the data's, else a MEMS unit's."""

    gyro_noise: float | None = Field(None, gt=0.0, lt=100.0)
    """Gyroscope white noise density, rad/s/sqrt(Hz)."""
    gyro_walk: float | None = Field(None, gt=0.0, lt=100.0)
    """Gyroscope bias random walk, rad/s^2/sqrt(Hz)."""
    accel_noise: float | None = Field(None, gt=0.0, lt=100.0)
    """Accelerometer white noise density, m/s^2/sqrt(Hz)."""
    accel_walk: float | None = Field(None, gt=0.0, lt=100.0)
    """Accelerometer bias random walk, m/s^3/sqrt(Hz)."""
    max_gap_s: float = Field(0.1, gt=0.0)
    """A hole in the IMU stream longer than this is reported, and trusted as little as it should."""


class InitializationSettings(Section):
    """How the filter starts."""

    window_s: float = Field(0.5, gt=0.1)
    """Length of IMU and images that a start at rest looks at."""
    motion_window_s: float = Field(1.2, gt=0.3)
    """Length of stereo motion that a start in motion solves over."""
    mono_window_s: float = Field(2.0, gt=0.3)
    """The same without stereo matches: the scale is in the accelerations alone."""
    mono_scale_sigma: float = Field(0.1, gt=0.0)
    """Such a start waits until the standard deviation of the scale is below this share of it."""
    accel_bias_sigma_mps2: float = Field(0.05, gt=0.0)
    """Standard deviation of the accelerometer bias that a start expects."""
    rest_gyro_rps: float = Field(0.02, gt=0.0)
    """At rest, the gyroscope's standard deviation is below this."""
    rest_accel_mps2: float = Field(0.15, gt=0.0)
    """At rest, the accelerometer's standard deviation is below this."""
    rest_share: float = Field(0.2, gt=0.0, le=1.0)
    """At rest, at least this share of the points stands still."""


class HealthSettings(Section):
    """When the filter is not to be trusted any more."""

    degraded_after_s: float = Field(0.5, gt=0.0)
    """Without a visual update or a standstill for this long, the ego motion is called degraded."""
    lost_after_s: float = Field(5.0, gt=0.0)
    """After this long it is called lost."""
    lost_velocity_sigma_mps: float = Field(3.0, gt=0.0)
    """It is called lost as well where the velocity is less sure than this."""
    lost_after_gap_s: float = Field(0.3, gt=0.0)
    """And where for this long there was neither IMU nor frame: the clock may have been set."""
    reset: bool = True
    """Start again where the ego motion is lost; a new segment begins."""


class GivenEgoSettings(Section):
    """Ego motion from a pose file: how far each pose is trusted."""

    rotation_sigma_rad: float = Field(1e-3, gt=0.0)
    """Standard deviation of each pose's rotation."""
    position_sigma_m: float = Field(0.03, gt=0.0)
    """Standard deviation of each pose's position."""
    window: int = Field(11, ge=2)
    """Past poses kept for the segmentation."""


class ZeroVelocitySettings(Section):
    """Recognition of standing still, by IMU and image together."""

    enabled: bool = True
    """Use zero-velocity updates."""
    pixel: float = Field(0.4, gt=0.0)
    """A point is stationary when it moves less than this in half a second, or a start's window."""
    still_share: float = Field(0.5, gt=0.0, le=1.0)
    """Share of the static points that must be still."""


class SegmentationSettings(Section):
    """Dynamic points: which points the ego motion does not explain."""

    enabled: bool = True
    """Segment the points; off, every point is taken as static."""
    candidates: Literal["tracked", "ransac"] = "tracked"
    """Test all tracked stereo points, or only those that the two-view test rejected."""
    test: Literal["covariance", "fixed"] = "covariance"
    """Decide by each point's own covariance, or by the fixed thresholds below."""
    look_back_s: tuple[float, ...] = (1.5, 1.0, 0.7, 0.4, 0.2, 0.1)
    """Earlier times at which positions are compared with those of now; the last frame always is."""
    max_range_m: float = Field(60.0, gt=0.0)
    """Points farther than this are not judged, and belong to no object."""
    distance_threshold_m: float = Field(0.25, gt=0.0)
    """Fixed test: distance between predicted and observed position."""
    depth_weight: float = Field(0.3, ge=0.0, le=1.0)
    """Fixed test: weight of the depth component in that distance."""
    reprojection_threshold_px: float = Field(3.0, gt=0.0)
    """Fixed test: reprojection error of the prediction, the worse of both cameras."""
    combine: Literal["any", "all"] = "any"
    """Fixed test: one threshold passed is enough, or both must be."""
    false_alarm: float = Field(1e-4, gt=0.0, lt=0.5)
    """Covariance tests: probability that a static point, or object, is called dynamic."""
    forgiven_speed_mps: float = Field(0.15, ge=0.0)
    """Covariance test: standard deviation of the drift forgiven to points at rest."""


class ObjectSettings(Section):
    """Moving rigid bodies: from dynamic points to one measurement a body."""

    enabled: bool = True
    """Look for bodies and track them."""
    seed: int = Field(0, ge=0)
    """Seed of the random samples."""
    min_points: int = Field(3, ge=3)
    """Bodies with fewer points are left out."""
    max_excluded_share: float = Field(0.5, ge=0.0, le=1.0)
    """Share of all points that bodies may take away from the ego filter."""
    accel_sigma_mps2: float = Field(1.0, ge=0.0)
    """Standard deviation of a body's acceleration, which one velocity over the span leaves out."""
    yaw_rate_sigma_rps: float = Field(0.4, gt=0.0)
    """Standard deviation of yaw rates: decides where the points do not tell."""
    tilt_rate_sigma_rps: float = Field(0.03, gt=0.0)
    """The same of pitch and roll rates."""
    min_speed_mps: float = Field(0.5, ge=0.0)
    """Bodies slower than this are not measured."""
    static_test: Literal["covariance", "fixed"] = "covariance"
    """Refuse static motions by the velocity's covariance, or by the fixed thresholds below."""
    alpha_m: float = Field(0.1, ge=0.0)
    """Fixed test: mean displacement over the span that a body must show, depth weighted down."""
    beta_m: float = Field(0.5, ge=0.0)
    """Fixed test: further displacement, divided by the number of points."""
    gamma_px_m: float = Field(20.0, ge=0.0)
    """Fixed test: mean displacement in the image, divided by the mean depth."""
    delta_px: float = Field(3.0, ge=0.0)
    """Fixed test: further displacement in the image, divided by the number of points."""


class ObjectTrackSettings(Section):
    """Tracks of moving bodies: how they move, and when they begin and end."""

    false_alarm: float = Field(5e-3, gt=0.0, lt=0.5)
    """Probability that a body at rest is confirmed: the sequential test's α."""
    miss: float = Field(1e-3, gt=0.0, lt=0.5)
    """Probability that a moving body is dropped, taken to rest: the test's β."""
    coast_s: float = Field(2.0, ge=0.0)
    """How long a confirmed track lives unseen."""
    smoothing_s: float = Field(0.5, ge=0.0)
    """Time constant by which the reported centre follows the corrections of the estimated one."""


class RecordingSettings(Section):
    """How folders and bags are read, and what is corrected in them (`ovmot doctor --fix`)."""

    pair_tolerance_s: float = Field(0.005, ge=0.0, le=0.1)
    """Left and right image are a pair when their stamps differ by no more than this."""
    exchange_cameras: bool = False
    """Take the left images as the right camera's and the right ones as the left camera's."""
    gyro_scale: float = Field(1.0, gt=-1e4, lt=1e4)
    """The data's angular rates are multiplied by this: pi/180 for degrees a second."""
    accel_scale: float = Field(1.0, gt=-1e4, lt=1e4)
    """The data's specific forces are multiplied by this: 9.80665 for g, -1 for negated ones."""
    time_offset_s: float | None = Field(None, gt=-100.0, lt=100.0)
    """t_imu = t_camera + this, in place of the calibration's."""

    @field_validator("gyro_scale", "accel_scale")
    @classmethod
    def _is_a_factor(cls, value: float) -> float:
        if value == 0.0:
            raise ValueError("must not be 0")
        return value


class LiveSettings(Section):
    """Topics, frames and queues of the live node (`ovmot ros`)."""

    left: str = "/cam0/image_raw"
    """Topic of the left images; one that ends in /compressed is taken as such."""
    right: str = "/cam1/image_raw"
    """Topic of the right images."""
    imu: str = "/imu0"
    """Topic of the IMU."""
    pair_tolerance_s: float = Field(0.005, ge=0.0)
    """Left and right image are a pair when their stamps differ by no more than this."""
    queue_frames: int = Field(20, ge=1)
    """Frames that may wait, as many as a start takes at 20 Hz; of more, the oldest is dropped."""
    hold_s: float = Field(3.0, gt=0.0)
    """A hole in the IMU up to this long is gone through, its frames held; after more, a restart."""
    frames: tuple[str, str, str, str] = ("world", "imu", "cam0", "cam1")
    """Names in messages of the world, the IMU, the left and the right camera."""
    publish_tf: bool = True
    """Publish world -> IMU -> cameras on /tf."""


class Settings(Section):
    """All settings of a run."""

    tracker: TrackerSettings = TrackerSettings()
    epipolar: EpipolarSettings = EpipolarSettings()
    noise: NoiseSettings = NoiseSettings()
    masks: MaskSettings = MaskSettings()
    filter: FilterSettings = FilterSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    imu: ImuSettings = ImuSettings()
    initialization: InitializationSettings = InitializationSettings()
    zero_velocity: ZeroVelocitySettings = ZeroVelocitySettings()
    health: HealthSettings = HealthSettings()
    given_ego: GivenEgoSettings = GivenEgoSettings()
    segmentation: SegmentationSettings = SegmentationSettings()
    objects: ObjectSettings = ObjectSettings()
    object_tracks: ObjectTrackSettings = ObjectTrackSettings()
    recording: RecordingSettings = RecordingSettings()
    live: LiveSettings = LiveSettings()


def describe_settings() -> Iterator[tuple[str, str, str, str]]:
    """Rows of (key, type, default, help) of every setting, in order of declaration."""
    for section_name, section_field in Settings.model_fields.items():
        section = section_field.annotation
        if not (isinstance(section, type) and issubclass(section, BaseModel)):
            continue
        for name, field in section.model_fields.items():
            kind = str(field.annotation).replace("typing.", "")
            if isinstance(field.annotation, type):
                kind = field.annotation.__name__
            yield f"{section_name}.{name}", kind, str(field.default), field.description or ""
