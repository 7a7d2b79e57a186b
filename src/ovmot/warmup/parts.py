"""The kernels in parts: each calls those of some stages on a second of made-up data.

A kernel is compiled when it is first called, and kept on disk (`kernels.cache`). As few as can be
of a part's kernels are another part's.
"""

import gc
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.frontend.given_features import GivenFeatures
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.interfaces import no_feedback
from ovmot.odometry import Odometry
from ovmot.physics import MEMS_NOISE
from ovmot.settings import Settings
from ovmot.sim.feature_odometry import feature_odometry
from ovmot.sim.features import FeatureBody, FeatureOptions, FeatureRecording, FeatureSimulation
from ovmot.sim.render import camera_rays, render_image
from ovmot.sim.scene import Box, Scene, Texture
from ovmot.sim.simulation import ImuModel
from ovmot.types import ImuNoise, StereoFrame
from ovmot.vio.given_poses import GivenPoses, GivenPosesInitializer

_ORIGIN_NS = 1_000_000_000
_N_FRAMES = 30
_STEP_M = 0.3
_HIDDEN = range(15, 19)  # frames


def call(name: str) -> None:
    """Call a part, in a process of its own."""
    gc.disable()  # a compiler makes many small objects, and few cycles
    PARTS[name]()


def call_front_end() -> None:
    """Corners, patches and flow, in three images of a wall that moves."""
    rig = _rig()
    noise = np.random.default_rng(0).standard_normal((320, 480)).astype(np.float32)
    grey = cv2.GaussianBlur(noise, (0, 0), 2.0)
    wall = np.clip(128.0 + 45.0 * grey / grey.std(), 0.0, 255.0).astype(np.uint8)
    settings = Settings()
    tracker = StereoTracker(rig, settings.tracker, settings.epipolar)
    for k, shift in enumerate((0, 2, 40)):  # the last one is lost at first
        left, right = (
            wall[40:280, 100 - shift : 420 - shift],
            wall[40:280, 94 - shift : 414 - shift],
        )
        frame = StereoFrame(k, np.ascontiguousarray(left), np.ascontiguousarray(right))
        tracker.track(frame, np.eye(4), no_feedback(rig))
    tracker.close()


def call_filter() -> None:
    """Propagation, updates and zero velocity, from features of points at rest."""
    recording = FeatureRecording(_simulation(), 0)
    settings = Settings(
        segmentation={"enabled": False}, objects={"enabled": False}, filter={"max_landmarks": 0}
    )
    odometry = feature_odometry(recording, settings)
    for event in recording.events():
        odometry.add(event)
    odometry.finish()


def call_start_and_landmarks() -> None:
    """A start from motion, and SLAM features for so long that they are anchored anew."""
    simulation = _simulation(n_frames=60)
    settings = Settings(segmentation={"enabled": False}, objects={"enabled": False})
    odometry = Odometry(
        simulation.rig,
        simulation.imu.noise,
        settings,
        frontend=GivenFeatures(simulation.rig, settings.tracker, settings.epipolar),
    )
    for event in FeatureRecording(simulation, 0).events():
        odometry.add(event)
    odometry.finish()


def call_objects() -> None:
    """Segmentation and objects, from features at rest and of a moving body, by given poses.

    Something hides the body for a while, so that its track is lost and found again.
    """
    t = np.linspace(-1.0, 0.1 * _N_FRAMES + 1.0, 60)
    body = np.eye(3), np.stack([8.0 + _STEP_M / 0.1 * t, 3.0 - 0.5 * t, 0.0 * t], axis=-1)
    path = PoseSpline.through(_stamps(t), se3.make(np.broadcast_to(body[0], (60, 3, 3)), body[1]))
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (30, 3))
    simulation = _simulation(FeatureBody(1, path, points))
    poses = simulation.path.pose(simulation.camera_ns)
    settings = Settings()
    odometry = Odometry(
        simulation.rig,
        settings=settings,
        initializer=GivenPosesInitializer(
            GivenPoses(simulation.camera_ns, poses, simulation.rig, settings.given_ego)
        ),
        frontend=GivenFeatures(simulation.rig, settings.tracker, settings.epipolar),
    )
    for k, observed in enumerate(FeatureRecording(simulation, 1).frames()):
        seen = observed.object_id == 0 if k in _HIDDEN else slice(None)
        frame = observed.frame
        odometry.add(replace(frame, feature_id=frame.feature_id[seen], pixels=frame.pixels[seen]))
    odometry.finish()


def call_simulator() -> None:
    """A picture of a box."""
    rig, texture = _rig(), Texture(mean=120.0, contrast=40.0, cell_m=0.5, seed=0)
    box = Box(se3.make(np.eye(3), np.array([8.0, 0.0, 0.0])), np.ones(3), texture)
    scene = Scene((box,), (), texture, texture, np.array([0.0, 0.0, 1.0]))
    render_image(scene, camera_rays(rig.cam0), rig.T_imu_cam0, _ORIGIN_NS)


PARTS: dict[str, Callable[[], None]] = {
    "objects": call_objects,
    "filter": call_filter,
    "front end": call_front_end,
    "start and SLAM features": call_start_and_landmarks,
    "simulator": call_simulator,
}
"""In the order in which they begin: what takes longest first, SLAM features after the filter."""


def _rig() -> StereoRig:
    """Two cameras 0.3 m apart that look along x of the IMU."""
    camera = Camera.make(
        (320, 240), (250.0, 250.0), (160.0, 120.0), "radtan", [-0.01, 0.001, 0.0, 0.0]
    )
    R_imu_cam = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    T_imu_cam0 = se3.make(R_imu_cam, np.zeros(3))
    return StereoRig(camera, camera, T_imu_cam0, T_imu_cam0 @ _aside())


def _aside() -> FloatArray:
    return se3.make(np.eye(3), np.array([0.3, 0.0, 0.0]))


def _stamps(t: FloatArray) -> IntArray:
    return _ORIGIN_NS + np.round(1e9 * t).astype(np.int64)


def _simulation(*bodies: FeatureBody, n_frames: int = _N_FRAMES) -> FeatureSimulation:
    """The rig goes straight on, faster and slower."""
    t = np.linspace(-1.0, 0.1 * n_frames + 1.0, 2 * n_frames)
    position = np.stack([_STEP_M / 0.1 * t + 0.1 * np.sin(2.0 * t), 0.0 * t, 0.0 * t], axis=-1)
    path = PoseSpline.through(
        _stamps(t), se3.make(np.broadcast_to(np.eye(3), (len(t), 3, 3)), position)
    )
    imu = ImuModel(200.0, ImuNoise(*MEMS_NOISE), np.zeros(3), np.zeros(3))
    options = FeatureOptions(n_features=120, pixel_sigma=0.3, depth_m=(4.0, 20.0))
    return FeatureSimulation(
        _rig(), path, _stamps(np.arange(0.0, 0.1 * n_frames, 0.1)), imu, options, bodies
    )
