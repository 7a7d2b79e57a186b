"""The odometry of a feature-level simulation: started at its truth, fed with its features."""

from ovmot.cameras.rig import StereoRig
from ovmot.frontend.given_features import GivenFeatures
from ovmot.initialization.known_state import InitialSigmas, KnownStateInitializer
from ovmot.odometry import Odometry
from ovmot.settings import Settings
from ovmot.sim.features import FeatureRecording
from ovmot.vio.state import ImuState


def feature_odometry(
    recording: FeatureRecording,
    settings: Settings,
    initial_sigmas: InitialSigmas = InitialSigmas(),  # noqa: B008 - frozen
    initial_rig: StereoRig | None = None,
) -> Odometry:
    """Odometry that takes the recording's events and starts at its true state.

    `initial_sigmas` are the prior standard deviations of that start, `initial_rig` the calibration
    that it is given in place of the true one. The image centres of the true one are exact, unless
    the settings say otherwise.
    """
    if initial_rig is None and settings.calibration.lens_sigma_px is None:
        exact = settings.calibration.model_copy(update={"lens_sigma_px": 0.0})
        settings = settings.model_copy(update={"calibration": exact})
    rig = initial_rig or recording.simulation.rig
    return Odometry(
        rig,
        recording.simulation.imu.noise,
        settings,
        initializer=known_state_initializer(recording, settings, initial_sigmas, rig),
        frontend=GivenFeatures(rig, settings.tracker, settings.epipolar),
    )


def known_state_initializer(
    recording: FeatureRecording, settings: Settings, sigmas: InitialSigmas, rig: StereoRig
) -> KnownStateInitializer:
    """The filter's start at the truth of a simulation's first frame, exact biases included.

    With a rig whose time offset is wrong, that frame has another time on the IMU's clock: the truth
    is that of this time.
    """
    simulation, truth = recording.simulation, recording.truth()
    first_ns = int(truth.timestamp_ns[0])
    then_ns = first_ns + round(1e9 * (rig.time_offset_s - simulation.rig.time_offset_s))
    T, velocity = simulation.path.pose(then_ns), simulation.path.velocity(then_ns)
    state = ImuState(T[:3, :3], T[:3, 3], velocity, truth.gyro_bias[0], truth.accel_bias[0])
    return KnownStateInitializer(first_ns, state, sigmas, rig, simulation.imu.noise, settings)
