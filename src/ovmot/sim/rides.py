"""How the rig goes through a scene: on a vehicle, in a person's hands, or along recorded poses."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.pose_files import read_tum
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.paths import MARGIN_S, drive_path, standing_path
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.recorded_paths import placement_at, recorded_path
from ovmot.sim.rigs import R_AHEAD, held, looking_along
from ovmot.sim.scene_file import DrivePart
from ovmot.sim.walk import stroll, walk_path

CAMERA_HEIGHT_M = 1.5
_LOWEST_CAMERA_M = 0.2
_VEHICLE_SIZE = np.array([4.6, 1.9, 1.6])
_PERSON_SIZE = np.array([0.8, 0.8, 1.8])
_T_VEHICLE_IMU = se3.make(np.eye(3), np.array([-0.07, 0.0, 1.7]))
_T_PERSON_IMU = se3.make(np.eye(3), np.array([0.35, 0.0, CAMERA_HEIGHT_M]))
_SPEED_STEP_S = 0.5
_LEAST_HEADING = 0.2
"""Share of the motion that must have one direction in the IMU's frame to be called ahead."""


@dataclass(frozen=True, slots=True)
class Ride:
    """A rig on its path T_world_imu(t), and the carrier, `carrier_size` (3,) m, around it.

    `speed` is the carrier's, in m/s over seconds since the origin.
    """

    rig: StereoRig
    path: PoseSpline
    T_vehicle_imu: FloatArray
    carrier_size: FloatArray
    speed: SmoothSteps


RideMaker = Callable[[StereoRig, Road, DrivePart, int, float, np.random.Generator], Ride]


def planned(
    rig: StereoRig, road: Road, drive: DrivePart, origin_ns: int, duration_s: float,
    rng: np.random.Generator,
) -> Ride:  # fmt: skip
    """The vehicle drives as the scene says."""
    return _driven(rig, road, drive, SmoothSteps.make(*drive.speed), origin_ns, duration_s, rng)


def random_drive(
    rig: StereoRig, road: Road, drive: DrivePart, origin_ns: int, duration_s: float,
    rng: np.random.Generator,
) -> Ride:  # fmt: skip
    """The vehicle follows the scene's road with the random speeds and stops of `city_drive`."""
    speeds, shakes = rng.spawn(2)
    _, speed = city_drive(duration_s, speeds)
    return _driven(rig, road, drive, speed, origin_ns, duration_s, shakes)


def standing(
    rig: StereoRig, road: Road, drive: DrivePart, origin_ns: int, duration_s: float,
    rng: np.random.Generator,
) -> Ride:  # fmt: skip
    """The vehicle stands where the scene's drive begins."""
    xy, yaw = road.at(np.array(drive.start_m), drive.offset_m)
    T_world_imu = se3.make(so3.rotation_z(yaw), np.array([*xy, 0.0])) @ _T_VEHICLE_IMU
    path = standing_path(T_world_imu, origin_ns, duration_s)
    return Ride(rig, path, _T_VEHICLE_IMU, _VEHICLE_SIZE, SmoothSteps.make((0.0, 0.0)))


def walk(
    rig: StereoRig, road: Road, drive: DrivePart, origin_ns: int, duration_s: float,
    rng: np.random.Generator,
) -> Ride:  # fmt: skip
    """A person carries the cameras along the vehicle's lane, with the paces of `stroll`."""
    paces, steps = rng.spawn(2)
    _, speed = stroll(duration_s, paces)
    path = walk_path(
        road, speed, origin_ns, duration_s, steps,
        T_walker_body=_T_PERSON_IMU, start_m=drive.start_m, offset_m=drive.offset_m,
    )  # fmt: skip
    return Ride(held(rig, R_AHEAD), path, _T_PERSON_IMU, _PERSON_SIZE, speed)


def recorded(file: Path, *, whole: bool) -> RideMaker:
    """The cameras follow a TUM file's IMU poses, from the start of the scene's drive.

    The file tells how the IMU moved, not how a camera sat on it. So the cameras are mounted anew:
    upright on average, and looking along the mean direction of motion in the IMU's frame; where
    the recorded motion prefers no direction, along the IMU axis that is most level. The path is
    turned about the vertical until the left camera first looks along the road, and lifted until it
    is `CAMERA_HEIGHT_M` above the ground. With `whole` a recording that is shorter than the
    duration gives a shorter ride. Raises `InputError` for a bad file or one that leaves the scene
    through the ground.
    """

    def ride(
        rig: StereoRig, road: Road, drive: DrivePart, origin_ns: int, duration_s: float,
        rng: np.random.Generator,
    ) -> Ride:  # fmt: skip
        length_s: float | None = duration_s
        if whole:
            stamps = read_tum(file).timestamp_ns
            recorded_s = 1e-9 * float(stamps[-1] - stamps[0]) - 2.0 * MARGIN_S
            length_s = None if recorded_s <= duration_s else duration_s
        raw = recorded_path(file, origin_ns, duration_s=length_s)
        mounted = held(rig, _mount(raw))
        xy, yaw = road.at(np.array(drive.start_m), drive.offset_m)
        axis = mounted.T_imu_cam0[:3, 2]
        placement = placement_at(raw, origin_ns, (float(xy[0]), float(xy[1])), float(yaw), axis)
        p_cam = (placement @ raw.pose(origin_ns) @ mounted.T_imu_cam0)[:3, 3]
        placement[2, 3] += CAMERA_HEIGHT_M - p_cam[2]
        path = recorded_path(
            file, origin_ns, duration_s=length_s, T_scene_recorded=placement
        )  # fmt: skip
        _refuse_ground(file, path, mounted)
        return Ride(mounted, path, np.eye(4), _PERSON_SIZE, _speed_along(path, origin_ns))

    return ride


def _driven(
    rig: StereoRig, road: Road, drive: DrivePart, speed: SmoothSteps, origin_ns: int,
    duration_s: float, rng: np.random.Generator,
) -> Ride:  # fmt: skip
    path = drive_path(
        road, speed, origin_ns, duration_s, rng,
        T_vehicle_body=_T_VEHICLE_IMU, start_m=drive.start_m, offset_m=drive.offset_m,
    )  # fmt: skip
    return Ride(rig, path, _T_VEHICLE_IMU, _VEHICLE_SIZE, speed)


def _sampled(path: PoseSpline, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seconds since the path's start (N,), poses (N, 4, 4) and velocities (N, 3)."""
    times = np.arange(path.start_ns, path.end_ns, round(1e9 * step_s), dtype=np.int64)
    return np.asarray(1e-9 * (times - path.start_ns)), path.pose(times), path.velocity(times)


def _mount(path: PoseSpline) -> FloatArray:
    """R_imu_cam (3, 3): upright, ahead along the path's mean motion in the IMU's frame."""
    _, T, velocity = _sampled(path, 0.1)
    up = np.mean(T[:, 2, :3], axis=0)
    motion = np.mean(np.einsum("nji,nj->ni", T[:, :3, :3], velocity), axis=0)
    motion = motion - (motion @ up) / (up @ up) * up
    if np.linalg.norm(motion) < _LEAST_HEADING * np.mean(np.linalg.norm(velocity, axis=-1)):
        motion = np.eye(3)[int(np.argmin(np.abs(up)))]
    return looking_along(motion, up)


def _speed_along(path: PoseSpline, origin_ns: int) -> SmoothSteps:
    seconds, _, velocity = _sampled(path, _SPEED_STEP_S)
    since = seconds + 1e-9 * (path.start_ns - origin_ns)
    return SmoothSteps(since, np.linalg.norm(velocity[:, :2], axis=-1))


def _refuse_ground(file: Path, path: PoseSpline, rig: StereoRig) -> None:
    _, T, _ = _sampled(path, 0.1)
    lowest = float((T @ rig.T_imu_cam0)[:, 2, 3].min())
    if lowest < _LOWEST_CAMERA_M:
        problem = f"the camera, {CAMERA_HEIGHT_M:g} m above the ground at first, sinks to"
        remedy = "a scene's ground is flat; choose another recording or a shorter piece"
        raise InputError.at(file, f"{problem} {lowest:.1f} m", remedy)


_START_S, _CHANGE_S = 1.5, 4.0
_CRUISE_MPS, _CRUISE_S, _STAND_S = (6.0, 12.0), (3.0, 10.0), (2.0, 5.0)
_TURN_MPS, _TURN_CURVATURE = 4.0, 1.0 / 8.0
_TURN_M = 0.5 * np.pi / (0.75 * _TURN_CURVATURE)
"""Length of a turn by 90 degrees whose curvature rises and falls over a quarter of it each."""


def city_drive(
    duration_s: float, rng: np.random.Generator, *, stop_share: float = 0.5
) -> tuple[Road, SmoothSteps]:
    """A way and a speed for `drive_path`: it stands 1.5 s and then drives from leg to leg.

    A leg speeds up to 6 to 12 m/s and ends at a stop of 2 to 5 s, with probability `stop_share`,
    or in a turn by 90 degrees to either side at 4 m/s. The road may cross itself.
    """
    knots, bends = [(_START_S, 0.0)], [(0.0, 0.0)]
    time, arc, pace = _START_S, 0.0, 0.0
    while time < duration_s:
        cruise, stretch = rng.uniform(*_CRUISE_MPS), rng.uniform(*_CRUISE_S)
        knots += [(time + _CHANGE_S, cruise), (time + _CHANGE_S + stretch, cruise)]
        arc += 0.5 * (pace + cruise) * _CHANGE_S + cruise * stretch
        time += stretch + 2.0 * _CHANGE_S
        pace = 0.0 if rng.uniform() < stop_share else _TURN_MPS
        arc += 0.5 * (cruise + pace) * _CHANGE_S
        knots.append((time, pace))
        if pace > 0.0:
            curvature = float(rng.choice([-1.0, 1.0])) * _TURN_CURVATURE
            corner = ((0.0, 0.0), (0.25, curvature), (0.75, curvature), (1.0, 0.0))
            bends += [(arc + share * _TURN_M, value) for share, value in corner]
            arc += _TURN_M
            time += _TURN_M / _TURN_MPS
        else:
            time += rng.uniform(*_STAND_S)
        knots.append((time, pace))
    return Road(SmoothSteps.make(*bends), arc), SmoothSteps.make(*knots)
