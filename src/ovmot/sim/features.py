"""Feature-level simulation: points along a path, seen as pixels with ids, and IMU samples.

No images: what a perfect tracker would give, with noise and wrong stereo matches as asked. Points
are made where the rig comes to see too few of them and stay where they are, as in OpenVINS's
simulator (P. Geneva et al., "OpenVINS", ICRA 2020).
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.imu import SimulatedImu, simulated_imu
from ovmot.sim.simulation import ImuModel
from ovmot.types import Event, FeatureFrame, ImuSample

_IMU_MARGIN_S = 0.3
_NEAR_M = 0.1
_CULL_M = 2.0
"""The list of points near enough to be seen is made anew after this much motion."""


@dataclass(frozen=True, slots=True)
class FeatureOptions:
    """How many features a camera sees and how well.

    `depth_m`: range of depths at which points are made; none is seen from farther than its upper
    end. `pixel_sigma`: white noise of each coordinate. `wrong_match_share`: how many right pixels
    are replaced by a random one. `swapped_track_share`: how many tracks go on, from one frame to
    the next, on another point at rest. `stereo`: whether the right camera sees anything. Raises
    `InputError` for values that mean nothing.
    """

    n_features: int = 250
    pixel_sigma: float = 1.0
    depth_m: tuple[float, float] = (5.0, 7.0)
    wrong_match_share: float = 0.0
    swapped_track_share: float = 0.0
    stereo: bool = True

    def __post_init__(self) -> None:
        near, far = self.depth_m
        shares = (self.wrong_match_share, self.swapped_track_share)
        for wrong, remedy in (
            (not self.n_features >= 1, "n_features must be at least 1"),
            (not 0.0 <= self.pixel_sigma < np.inf, "pixel_sigma must be a number of pixels"),
            (not _NEAR_M < near <= far < np.inf, f"depth_m must rise from above {_NEAR_M} m"),
            (not all(0.0 <= share <= 1.0 for share in shares), "shares must lie in 0 ... 1"),
        ):
            if wrong:
                raise InputError(f"feature-level simulation: {remedy}")


@dataclass(frozen=True, slots=True)
class FeatureBody:
    """A rigid body that moves along `path`, with points (M, 3) in its own frame."""

    object_id: int
    path: PoseSpline
    points: FloatArray


@dataclass(frozen=True, slots=True)
class FeatureSimulation:
    """All of a feature-level sequence but its random numbers.

    `path` is T_world_imu(t) in camera time, `camera_ns` (N,) the exposures.
    """

    rig: StereoRig
    path: PoseSpline
    camera_ns: IntArray
    imu: ImuModel
    options: FeatureOptions = FeatureOptions()
    bodies: tuple[FeatureBody, ...] = ()


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """A frame and the truth of its N features.

    `object_id` (N,): the body, 0 for a point at rest; `wrong_match` (N,): the right pixel is not
    the feature's; `swapped` (N,): the id was on another point in the frame before.
    """

    frame: FeatureFrame
    object_id: IntArray
    wrong_match: BoolArray
    swapped: BoolArray


@dataclass(frozen=True, slots=True)
class MotionTruth:
    """The rig's true motion at N stamps: T_world_imu (N, 4, 4), velocity and biases (N, 3)."""

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    velocity: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray


@dataclass(frozen=True)
class FeatureRecording:
    """One drawing of a simulation: the same seed gives the same events."""

    simulation: FeatureSimulation
    seed: int

    @cached_property
    def imu(self) -> SimulatedImu:
        """The IMU's samples, from before the first frame to after the last."""
        simulation = self.simulation
        stamps = _imu_stamps(simulation)
        offset_s = simulation.rig.time_offset_s
        return simulated_imu(
            simulation.path, stamps, simulation.imu, self._generator(0), time_offset_s=offset_s
        )

    def frames(self) -> Iterator[ObservedFrame]:
        """The frames with their truth, in order of time."""
        world = _World(self.simulation, self._generator(1), self._generator(2))
        for time_ns in self.simulation.camera_ns.tolist():
            yield world.observe(time_ns)

    def events(self) -> Generator[Event, None, None]:
        """IMU samples and frames as the pipeline takes them, by their time on the IMU's clock."""
        data = self.imu.data
        offset_ns = round(1e9 * self.simulation.rig.time_offset_s)
        i = 0
        for observed in self.frames():
            end = int(np.searchsorted(data.timestamp_ns, observed.frame.timestamp_ns + offset_ns))
            yield from _samples(self.imu, i, end)
            i = end
            yield observed.frame
        yield from _samples(self.imu, i, len(data))

    def truth(self) -> MotionTruth:
        """The rig's motion at the frames; biases by interpolation between samples."""
        simulation = self.simulation
        times = simulation.camera_ns
        on_imu = times + round(1e9 * simulation.rig.time_offset_s)
        stamps = self.imu.data.timestamp_ns

        def at_frames(bias: FloatArray) -> FloatArray:
            since = 1e-9 * (on_imu - stamps[0])
            columns = [np.interp(since, 1e-9 * (stamps - stamps[0]), b) for b in bias.T]
            return np.stack(columns, axis=-1)

        return MotionTruth(
            times, simulation.path.pose(times), simulation.path.velocity(times),
            at_frames(self.imu.gyro_bias), at_frames(self.imu.accel_bias),
        )  # fmt: skip

    def _generator(self, stream: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, stream])


class _World:
    """The points made so far, and which of them are being tracked under which id."""

    def __init__(
        self,
        simulation: FeatureSimulation,
        map_rng: np.random.Generator,
        noise_rng: np.random.Generator,
    ) -> None:
        self._simulation = simulation
        self._map_rng = map_rng
        self._noise_rng = noise_rng
        self._points = np.empty((0, 3))
        self._near = np.empty(0, dtype=np.int64)
        self._near_center = np.full(3, np.inf)
        body_points = sum(len(body.points) for body in simulation.bodies)
        self._track = np.empty(0, dtype=np.int64)
        self._body_track = np.full(body_points, -1, dtype=np.int64)
        self._next_id = 0

    def observe(self, time_ns: int) -> ObservedFrame:
        """What is seen at one time; a point that was lost from view gets a new id."""
        simulation, options = self._simulation, self._simulation.options
        T_world_cam0 = simulation.path.pose(time_ns) @ simulation.rig.T_imu_cam0
        resting = self._visible(T_world_cam0)
        if len(resting) < options.n_features:
            self._make_points(T_world_cam0, options.n_features - len(resting))
            resting = self._visible(T_world_cam0)
        resting = self._followed_first(resting)[: options.n_features]
        body_points, body_ids = self._bodies(time_ns)
        moving = np.flatnonzero(_seen(simulation.rig.cam0, T_world_cam0, body_points, np.inf))
        swapped = np.zeros(len(resting) + len(moving), np.bool_)
        swapped[: len(resting)] = self._swap_tracks(resting)
        self._track = self._renamed(self._track, resting)
        self._body_track = self._renamed(self._body_track, moving)
        p_world = np.concatenate([self._points[resting], body_points[moving]])
        feature_id = np.concatenate([self._track[resting], self._body_track[moving]])
        object_id = np.concatenate([np.zeros(len(resting), np.int64), body_ids[moving]])
        pixels, wrong = self._pixels(time_ns, p_world)
        inside = simulation.rig.cam0.inside(pixels[:, :2])
        frame = FeatureFrame(time_ns, feature_id[inside], pixels[inside])
        return ObservedFrame(frame, object_id[inside], wrong[inside], swapped[inside])

    def _visible(self, T_world_cam0: FloatArray) -> IntArray:
        """Indices of the resting points that the left camera sees."""
        center = T_world_cam0[:3, 3]
        reach = self._simulation.options.depth_m[1]
        if not np.linalg.norm(center - self._near_center) < _CULL_M:
            # a pixel's ray is at most some times longer than its depth
            distance = np.linalg.norm(self._points - center, axis=1)
            self._near = np.flatnonzero(distance < 2.5 * reach + _CULL_M)
            self._near_center = center
        seen = _seen(self._simulation.rig.cam0, T_world_cam0, self._points[self._near], reach)
        return self._near[seen]

    def _make_points(self, T_world_cam0: FloatArray, count: int) -> None:
        """Adds points at random depths behind random pixels of the left camera."""
        camera = self._simulation.rig.cam0
        uv = self._map_rng.uniform((0.0, 0.0), (camera.width - 1, camera.height - 1), (count, 2))
        depth = self._map_rng.uniform(*self._simulation.options.depth_m, count)
        xy = camera.normalize(uv)
        known = np.isfinite(xy).all(axis=1)
        rays = np.concatenate([xy, np.ones((count, 1))], axis=1)
        made = se3.apply(T_world_cam0, (depth[:, None] * rays)[known])
        first = len(self._points)
        self._points = np.concatenate([self._points, made])
        self._track = np.concatenate([self._track, np.full(len(made), -1, dtype=np.int64)])
        self._near = np.concatenate([self._near, first + np.arange(len(made))])

    def _followed_first(self, index: IntArray) -> IntArray:
        """Points already tracked before those that come into view: as a tracker keeps them."""
        return index[np.argsort(self._track[index] < 0, kind="stable")]

    def _swap_tracks(self, seen: IntArray) -> BoolArray:
        """Gives some of the followed points one another's tracks; which of those seen (N,)."""
        share = self._simulation.options.swapped_track_share
        chosen = (self._noise_rng.random(len(seen)) < share) & (self._track[seen] >= 0)
        if chosen.sum() < 2:
            return np.zeros_like(chosen)
        index = self._noise_rng.permutation(seen[chosen])
        self._track[index] = np.roll(self._track[index], 1)
        return chosen

    def _renamed(self, track: IntArray, seen: IntArray) -> IntArray:
        """Track ids of all points: kept where seen again, new where seen anew, else none."""
        out = np.full_like(track, -1)
        out[seen] = track[seen]
        fresh = seen[track[seen] < 0]
        out[fresh] = self._next_id + np.arange(len(fresh))
        self._next_id += len(fresh)
        return out

    def _bodies(self, time_ns: int) -> tuple[FloatArray, IntArray]:
        """Points of all bodies in the world and the body of each."""
        bodies = self._simulation.bodies
        points = [se3.apply(body.path.pose(time_ns), body.points) for body in bodies]
        ids = [np.full(len(body.points), body.object_id, dtype=np.int64) for body in bodies]
        if not bodies:
            return np.empty((0, 3)), np.empty(0, dtype=np.int64)
        return np.concatenate(points), np.concatenate(ids)

    def _pixels(self, time_ns: int, p_world: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Noisy pixels (N, 4) and which right halves are wrong."""
        rig, options, rng = self._simulation.rig, self._simulation.options, self._noise_rng
        T_world_imu = self._simulation.path.pose(time_ns)
        pixels = np.empty((len(p_world), 4))
        for side, (camera, T_imu_cam) in enumerate(
            zip(rig.cameras, (rig.T_imu_cam0, rig.T_imu_cam1), strict=True)
        ):
            exact, _ = _projected(camera, T_world_imu @ T_imu_cam, p_world)
            pixels[:, 2 * side : 2 * side + 2] = exact
        pixels += rng.normal(0.0, options.pixel_sigma, pixels.shape)
        wrong = rng.random(len(p_world)) < options.wrong_match_share
        stray = rng.uniform((0.0, 0.0), (rig.cam1.width - 1, rig.cam1.height - 1), (len(wrong), 2))
        right = np.where(wrong[:, None], stray, pixels[:, 2:])
        with np.errstate(invalid="ignore", over="ignore"):
            seen = rig.cam1.inside(right) & np.isfinite(rig.cam1.normalize(right)).all(axis=1)
        pixels[:, 2:] = np.where(seen[:, None] & options.stereo, right, np.nan)
        return pixels, wrong & np.isfinite(pixels[:, 2])


def _seen(
    camera: Camera, T_world_cam: FloatArray, p_world: FloatArray, max_depth: float
) -> BoolArray:
    """Which points (N, 3) lie before a camera, near enough and inside its picture."""
    uv, depth = _projected(camera, T_world_cam, p_world)
    return np.asarray(camera.inside(uv) & (depth <= max_depth))


def _projected(
    camera: Camera, T_world_cam: FloatArray, p_world: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) of points (N, 3), NaN for what the camera can not see, and depths (N,).

    It can not see what is behind it, or past the reach of its lens model, which folds over there.
    """
    p_cam = se3.apply(se3.inverse(T_world_cam), p_world)
    depth = p_cam[:, 2]
    with np.errstate(all="ignore"):
        uv = camera.project(p_cam)
        off = np.abs(camera.normalize(uv) - p_cam[:, :2] / depth[:, None]).max(axis=1, initial=0.0)
    uv[~((off < 1e-6) & (depth > _NEAR_M))] = np.nan
    return uv, depth


def _samples(imu: SimulatedImu, begin: int, end: int) -> Iterator[ImuSample]:
    data = imu.data
    for i in range(begin, end):
        yield ImuSample(int(data.timestamp_ns[i]), data.gyro[i], data.accel[i])


def _imu_stamps(simulation: FeatureSimulation) -> IntArray:
    """IMU stamps (N,) in ns around all frames, one of them on the first frame."""
    offset_ns = round(1e9 * simulation.rig.time_offset_s)
    first, last = (int(simulation.camera_ns[i]) + offset_ns for i in (0, -1))
    period_ns = round(1e9 / simulation.imu.rate_hz)
    margin = int(_IMU_MARGIN_S * simulation.imu.rate_hz)
    count = margin + (last - first) // period_ns + margin + 1
    return first + period_ns * (np.arange(count, dtype=np.int64) - margin)
