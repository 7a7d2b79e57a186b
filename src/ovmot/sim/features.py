"""Feature-level simulation: points along a path, seen as pixels with ids, and IMU samples.

No images: the output of a perfect tracker, with pixel noise and wrong stereo matches as asked for.
Points are made where the rig comes to see too few of them and stay where they are, as in OpenVINS's
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
from ovmot.sim.point_map import PointMap
from ovmot.sim.simulation import ImuModel
from ovmot.types import Event, FeatureFrame, ImuSample

_IMU_MARGIN_S = 0.3
_NEAR_M = 0.1


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
        """IMU samples and frames for the odometry, in order of time on the IMU's clock."""
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
    """The points made so far, and the ids of those that were seen in the last frame.

    A point's index is its place in the map; those of bodies count down from -1.
    """

    def __init__(
        self,
        simulation: FeatureSimulation,
        map_rng: np.random.Generator,
        noise_rng: np.random.Generator,
    ) -> None:
        self._simulation = simulation
        self._map_rng = map_rng
        self._noise_rng = noise_rng
        self._map = PointMap(simulation.options.depth_m[1] * _longest_ray(simulation.rig.cam0))
        self._seen_index = np.empty(0, dtype=np.int64)  # rising
        self._seen_id = np.empty(0, dtype=np.int64)
        self._next_id = 0

    def observe(self, time_ns: int) -> ObservedFrame:
        """What is seen at one time; a point that was lost from view gets a new id."""
        simulation, options = self._simulation, self._simulation.options
        T_world_cam0 = simulation.path.pose(time_ns) @ simulation.rig.T_imu_cam0
        index, resting = self._visible(T_world_cam0)
        if len(index) < options.n_features:
            self._map.add(self._new_points(T_world_cam0, options.n_features - len(index)))
            index, resting = self._visible(T_world_cam0)
        followed_first = np.argsort(~np.isin(index, self._seen_index), kind="stable")
        kept = followed_first[: options.n_features]  # as a tracker keeps what it has
        body_points, body_ids = self._bodies(time_ns)
        moving = np.flatnonzero(_seen(simulation.rig.cam0, T_world_cam0, body_points, np.inf))
        index = np.concatenate([index[kept], -1 - moving])
        feature_id, swapped = self._tracks(index)
        p_world = np.concatenate([resting[kept], body_points[moving]])
        object_id = np.concatenate([np.zeros(len(kept), np.int64), body_ids[moving]])
        pixels, wrong = self._pixels(time_ns, p_world)
        inside = simulation.rig.cam0.inside(pixels[:, :2])
        frame = FeatureFrame(time_ns, feature_id[inside], pixels[inside])
        return ObservedFrame(frame, object_id[inside], wrong[inside], swapped[inside])

    def _visible(self, T_world_cam0: FloatArray) -> tuple[IntArray, FloatArray]:
        """Indices and positions of the resting points that the left camera sees."""
        index, points = self._map.near(T_world_cam0[:3, 3])
        reach = self._simulation.options.depth_m[1]
        seen = _seen(self._simulation.rig.cam0, T_world_cam0, points, reach)
        return index[seen], points[seen]

    def _new_points(self, T_world_cam0: FloatArray, count: int) -> FloatArray:
        """Points at random depths behind random pixels of the left camera."""
        camera = self._simulation.rig.cam0
        uv = self._map_rng.uniform((0.0, 0.0), (camera.width - 1, camera.height - 1), (count, 2))
        depth = self._map_rng.uniform(*self._simulation.options.depth_m, count)
        xy = camera.normalize(uv)
        known = np.isfinite(xy).all(axis=1)
        rays = np.concatenate([xy, np.ones((count, 1))], axis=1)
        return se3.apply(T_world_cam0, (depth[:, None] * rays)[known])

    def _tracks(self, index: IntArray) -> tuple[IntArray, BoolArray]:
        """Ids of the points seen (N,), kept where seen before, else new; and which were swapped."""
        _, now, then = np.intersect1d(
            index, self._seen_index, assume_unique=True, return_indices=True
        )
        track = np.full(len(index), -1, dtype=np.int64)
        track[now] = self._seen_id[then]
        share = self._simulation.options.swapped_track_share
        swapped = (self._noise_rng.random(len(index)) < share) & (track >= 0) & (index >= 0)
        if swapped.sum() < 2:
            swapped[:] = False
        among = self._noise_rng.permutation(np.flatnonzero(swapped))
        track[among] = np.roll(track[among], 1)
        fresh = np.flatnonzero(track < 0)
        track[fresh] = self._next_id + np.arange(len(fresh))
        self._next_id += len(fresh)
        order = np.argsort(index)
        self._seen_index, self._seen_id = index[order], track[order]
        return track, swapped

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
    """Which points (N, 3) lie before a camera, near enough and inside its image."""
    uv, depth = _projected(camera, T_world_cam, p_world)
    return np.asarray(camera.inside(uv) & (depth <= max_depth))


def _projected(
    camera: Camera, T_world_cam: FloatArray, p_world: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) of points (N, 3), NaN for what the camera can not see, and depths (N,).

    It can not see what is behind it, far outside its image, or past the reach of its camera model,
    which folds over there.
    """
    p_cam = se3.apply(se3.inverse(T_world_cam), p_world)
    depth = p_cam[:, 2]
    with np.errstate(all="ignore"):
        uv = camera.project(p_cam)
        off_center = np.abs(uv - 0.5 * np.array([camera.width, camera.height]))
        near_image = np.all(off_center < 0.6 * max(camera.width, camera.height), axis=1)
        maybe = np.flatnonzero(near_image & (depth > _NEAR_M))
        off = camera.normalize(uv[maybe]) - p_cam[maybe, :2] / depth[maybe, None]
    seen = maybe[np.abs(off).max(axis=1, initial=0.0) < 1e-6]
    out = np.full_like(uv, np.nan)
    out[seen] = uv[seen]
    return out, depth


def _longest_ray(camera: Camera) -> float:
    """Length of the longest ray to a pixel, in units of its depth, with a margin."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 65), np.linspace(0, camera.height - 1, 65))
    with np.errstate(all="ignore"):
        xy = camera.normalize(np.stack([u.ravel(), v.ravel()], axis=-1))
    return 1.1 * float(np.sqrt(1.0 + np.nanmax(np.sum(xy**2, axis=1), initial=0.0)))


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
