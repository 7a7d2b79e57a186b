"""Runs of feature-level simulations, and their evaluation against the simulation itself."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import InputError
from ovmot.evaluation.calibration import calibration_errors
from ovmot.evaluation.ego import evaluate_ego
from ovmot.initialization.known_state import InitialSigmas
from ovmot.outputs.run_json import InputIdentity, RunSummary
from ovmot.outputs.run_reader import read_calibration, read_ego_run
from ovmot.run import RunInput, RunOptions, run_into_folder
from ovmot.run_evaluation import Evaluation
from ovmot.settings import Settings
from ovmot.sim.feature_odometry import feature_odometry
from ovmot.sim.features import FeatureRecording


def run_features(
    recording: FeatureRecording,
    settings: Settings,
    options: RunOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    initial_sigmas: InitialSigmas = InitialSigmas(),  # noqa: B008 - frozen
    initial_rig: StereoRig | None = None,
) -> RunSummary:
    """Run a feature-level simulation, started at its truth; as `run_sequence` otherwise.

    `initial_sigmas` are the prior standard deviations of that start, `initial_rig` the
    calibration that it is given in place of the true one. Raises `InputError` for what
    needs images or frame numbers: an overlay, poses from a file, a first or last frame.
    """
    if options.video or options.ego_poses is not None or options.first or options.last is not None:
        raise InputError("a feature-level simulation has no images and runs from end to end")
    simulation = recording.simulation
    source = RunInput(
        name="feature simulation",
        odometry=feature_odometry(recording, settings, initial_sigmas, initial_rig),
        stream=recording.events(),
        imu_noise=simulation.imu.noise,
        identity=InputIdentity(
            path="",
            kind="features",
            n_frames=len(simulation.camera_ns),
            n_imu_samples=len(recording.imu.data),
            first_timestamp_ns=int(simulation.camera_ns[0]),
            last_timestamp_ns=int(simulation.camera_ns[-1]),
        ),
        frame_number={int(t): i for i, t in enumerate(simulation.camera_ns)},
        counts=Counter(seed=recording.seed),
        warnings=Counter(),
        start="truth",
    )
    return run_into_folder(source, settings, options, on_frame)


def evaluate_features(
    run: Path, recording: FeatureRecording, initial_rig: StereoRig | None = None
) -> Evaluation:
    """Measure the run of a feature-level simulation against the simulation itself.

    `initial_rig`: the calibration that the run was given, where that is not the true one.
    """
    truth, rig = recording.truth(), recording.simulation.rig
    ego_truth = EgoTruth(
        run, truth.timestamp_ns, truth.T_world_imu, truth.velocity, truth.gyro_bias,
        truth.accel_bias,
    )  # fmt: skip
    return Evaluation(
        evaluate_ego(read_ego_run(run), ego_truth),
        calibration=calibration_errors(read_calibration(run), initial_rig or rig, rig),
    )
