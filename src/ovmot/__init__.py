"""ovmot: stereo-inertial odometry and moving-object tracks, without learned models.

    import ovmot
    sequence = ovmot.open("MH_01_easy")
    odometry = ovmot.Odometry(sequence.rig, sequence.imu_noise, sequence.settings())
    for event in sequence:
        for frame in odometry.add(event): print(frame.T_world_imu, frame.tracks)

The names below are the public API. They are loaded when they are first used: `import ovmot` itself
loads none of the libraries that they need.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ovmot.runtime import limit_blas_threads

limit_blas_threads()

__version__ = "0.1.0"

if TYPE_CHECKING:
    from ovmot.cameras.camera import Camera
    from ovmot.cameras.models import CAMERA_MODELS
    from ovmot.cameras.rig import StereoRig
    from ovmot.datasets.bag.topics import BagTopics
    from ovmot.datasets.calibration_export import WrittenCalibration, write_calibration
    from ovmot.datasets.openvins_config import RunConfig, load_run_config
    from ovmot.datasets.registry import DATASETS, PRESETS, WRITERS
    from ovmot.datasets.registry import open_recording as open
    from ovmot.datasets.sequence import RecordedSequence
    from ovmot.errors import CalibrationError, DatasetError, InputError, OvmotError
    from ovmot.frontend.given_features import GivenFeatures
    from ovmot.odometry import Odometry
    from ovmot.outputs.finished_run import Run
    from ovmot.outputs.rerun_output import RerunOutput
    from ovmot.outputs.run_json import RunSummary
    from ovmot.outputs.run_writer import Output, RunContext
    from ovmot.outputs.views import View
    from ovmot.report.report import write_report
    from ovmot.run import RunOptions, poses_from_file, run_sequence
    from ovmot.run_evaluation import Evaluation, evaluate, metrics_table, write_metrics, write_plots
    from ovmot.runtime import prepare_process
    from ovmot.settings import Settings, describe_settings
    from ovmot.settings_file import dump_settings, load_settings
    from ovmot.sim.scene_file import SCENES
    from ovmot.sim.simulate import SimulatedSequence, simulate
    from ovmot.types import (
        EgoEstimate,
        Event,
        FeatureFrame,
        FrameResult,
        Health,
        ImuNoise,
        ImuSample,
        ObjectTrack,
        PointLabel,
        ScenePoints,
        StereoFrame,
        StereoMatches,
    )
    from ovmot.warmup.processes import warm_up

__all__ = [
    "CAMERA_MODELS",
    "DATASETS",
    "PRESETS",
    "SCENES",
    "WRITERS",
    "BagTopics",
    "CalibrationError",
    "Camera",
    "DatasetError",
    "EgoEstimate",
    "Evaluation",
    "Event",
    "FeatureFrame",
    "FrameResult",
    "GivenFeatures",
    "Health",
    "ImuNoise",
    "ImuSample",
    "InputError",
    "ObjectTrack",
    "Odometry",
    "Output",
    "OvmotError",
    "PointLabel",
    "RecordedSequence",
    "RerunOutput",
    "Run",
    "RunConfig",
    "RunContext",
    "RunOptions",
    "RunSummary",
    "ScenePoints",
    "Settings",
    "SimulatedSequence",
    "StereoFrame",
    "StereoMatches",
    "StereoRig",
    "View",
    "WrittenCalibration",
    "describe_settings",
    "dump_settings",
    "evaluate",
    "load_run_config",
    "load_settings",
    "metrics_table",
    "open",
    "poses_from_file",
    "prepare_process",
    "run_sequence",
    "simulate",
    "warm_up",
    "write_calibration",
    "write_metrics",
    "write_plots",
    "write_report",
]

_HOMES = {
    "cameras.camera": "Camera",
    "cameras.models": "CAMERA_MODELS",
    "cameras.rig": "StereoRig",
    "datasets.bag.topics": "BagTopics",
    "datasets.calibration_export": "WrittenCalibration write_calibration",
    "datasets.openvins_config": "RunConfig load_run_config",
    "datasets.registry": "DATASETS PRESETS WRITERS open_recording",
    "datasets.sequence": "RecordedSequence",
    "errors": "CalibrationError DatasetError InputError OvmotError",
    "frontend.given_features": "GivenFeatures",
    "odometry": "Odometry",
    "outputs.finished_run": "Run",
    "outputs.rerun_output": "RerunOutput",
    "outputs.run_json": "RunSummary",
    "outputs.run_writer": "Output RunContext",
    "outputs.views": "View",
    "report.report": "write_report",
    "run": "RunOptions poses_from_file run_sequence",
    "run_evaluation": "Evaluation evaluate metrics_table write_metrics write_plots",
    "runtime": "prepare_process",
    "settings": "Settings describe_settings",
    "settings_file": "dump_settings load_settings",
    "sim.scene_file": "SCENES",
    "sim.simulate": "SimulatedSequence simulate",
    "types": "EgoEstimate Event FeatureFrame FrameResult Health ImuNoise ImuSample ObjectTrack"
    " PointLabel ScenePoints StereoFrame StereoMatches",
    "warmup.processes": "warm_up",
}
"""The names above by the module that defines them; a test holds the three lists together."""

_HOME_OF = {name: home for home, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """A public name, from its module when it is first used (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'ovmot' has no attribute {name!r}")
    there = "open_recording" if name == "open" else name
    found = getattr(import_module(f"ovmot.{_HOME_OF[there]}"), there)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
