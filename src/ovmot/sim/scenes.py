"""Ready-made simulations: a street that a rig drives through, with traffic."""

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.sim.paths import drive_path, straight_path, traffic_path
from ovmot.sim.profiles import Road, SmoothSteps
from ovmot.sim.scene import Box, Mover, Scene, Texture, box_at, car_boxes, walker_boxes
from ovmot.sim.simulation import ImuModel, Optics, Simulation
from ovmot.types import ImuNoise

ORIGIN_NS = 1_500_000_000_000_000_000
_CAR = np.array([4.4, 1.8, 1.45])
_WALKER = np.array([0.4, 0.6, 1.75])
_LANE_M = 3.4
_KERB_M = 5.6
_FACADE_M = 9.5


def street_rig() -> StereoRig:
    """A 640x280 rig on a car: 0.475 m baseline, 5-term lenses, the right camera turned a little."""
    R_imu_cam = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tilt0 = so3.exp(np.array([0.007, -0.012, 0.005]))
    turn = so3.exp(np.array([-0.0026, 0.0045, 0.0085]))
    left = Camera.make(
        (640, 280), (408.45, 405.78), (304.0, 131.5), "radtan",
        [-0.0561, 0.1395, -0.0012, -0.00097, -0.0809],
    )  # fmt: skip
    right = Camera.make(
        (640, 280), (406.89, 404.26), (306.7, 124.5), "radtan",
        [-0.0549, 0.1424, 0.000075, -0.00068, -0.0857],
    )  # fmt: skip
    T_imu_cam0 = se3.make(R_imu_cam @ tilt0, np.array([1.71, 0.24, 0.11]))
    T_cam0_cam1 = se3.make(turn, np.array([0.475, 0.001, -0.002]))
    return StereoRig(left, right, T_imu_cam0, T_imu_cam0 @ T_cam0_cam1)


def demo_simulation(seed: int = 0, duration_s: float = 8.0, rate_hz: float = 10.0) -> Simulation:
    """A street: the rig stands 1.5 s, drives behind a car round a gentle bend, stops, drives on.

    Oncoming cars pass, a walker crosses before the standing rig; parked cars, poles and facades
    line the road.
    """
    rng = np.random.default_rng(seed)
    road = Road(SmoothSteps.make((0.0, 0.0), (10.0, 0.0), (20.0, 0.012), (60.0, 0.012)), 160.0)
    speed = SmoothSteps.make((1.5, 0.0), (3.6, 6.5), (4.4, 6.5), (6.0, 0.0), (6.7, 0.0), (9.0, 6.0))
    T_vehicle_imu = se3.make(np.eye(3), np.array([-0.07, 0.0, 1.7]))
    path = drive_path(
        road, speed, ORIGIN_NS, duration_s, rng,
        T_vehicle_body=T_vehicle_imu, start_m=5.0, offset_m=-0.5 * _LANE_M,
    )  # fmt: skip
    count = round(duration_s * rate_hz)
    scene = Scene(
        boxes=(*_facades(road, rng), *_parked_cars(road, rng), *_poles(road, rng)),
        movers=_demo_traffic(road, duration_s),
        ground=Texture(95.0, 22.0, 3.0, seed=11, softness=0.15),
        sky=Texture(205.0, 10.0, 1.0, seed=12, softness=1.0, octaves=3),
        sun=np.array([-0.3, 0.5, 0.8]),
    )
    return Simulation(
        scene, street_rig(), path,
        ORIGIN_NS + np.round(1e9 / rate_hz * np.arange(count)).astype(np.int64),
        T_vehicle_imu,
        ImuModel(
            100.0, ImuNoise(1.7e-4, 2e-5, 2e-3, 3e-4),
            rng.normal(0.0, 3e-3, 3), rng.normal(0.0, 3e-2, 3),
        ),
        Optics(noise_grey=2.0),
    )  # fmt: skip


def _demo_traffic(road: Road, duration_s: float) -> tuple[Mover, ...]:
    """A lead car that also stops, two oncoming cars, and a walker across the road."""
    lane = 0.5 * _LANE_M

    def car(number: int, grey: float, speed: SmoothSteps, start: float, oncoming: bool) -> Mover:
        path = traffic_path(
            road, speed, ORIGIN_NS, duration_s,
            start_m=start, offset_m=lane if oncoming else -lane, oncoming=oncoming,
        )  # fmt: skip
        return Mover(number, "car", _CAR, car_boxes(_CAR, _paint(grey, 100 * number)), path)

    lead = SmoothSteps.make((1.0, 0.0), (3.2, 7.0), (4.5, 7.0), (6.0, 1.5), (8.0, 6.5))
    at, yaw = road.at(np.array(32.0), -4.3)
    walker = straight_path(
        (float(at[0]), float(at[1])), float(yaw) + 0.5 * np.pi,
        SmoothSteps.make((3.7, 0.0), (4.2, 1.5)), ORIGIN_NS, duration_s,
    )  # fmt: skip
    return (
        car(1, 165.0, lead, 19.0, False),
        car(2, 90.0, SmoothSteps.make((0.0, 7.0)), 62.0, True),
        car(3, 140.0, SmoothSteps.make((0.0, 8.0)), 85.0, True),
        Mover(4, "pedestrian", _WALKER, walker_boxes(_WALKER, _paint(150.0, 400, 0.3)), walker),
    )


def _paint(mean: float, seed: int, cell_m: float = 0.7) -> Texture:
    return Texture(mean, 42.0, cell_m, seed)


def _along(road: Road, arc: float, offset: float) -> tuple[float, float, float]:
    xy, yaw = road.at(np.array(arc), offset)
    return float(xy[0]), float(xy[1]), float(yaw)


def _facades(road: Road, rng: np.random.Generator) -> list[Box]:
    """Houses wall to wall on both sides, each of its own depth, height and grey."""
    boxes = []
    for side in (-1.0, 1.0):
        arc = -15.0
        while arc < road.length_m + 40.0:
            width, height, back = rng.uniform(7.0, 13.0), rng.uniform(6.0, 14.0), rng.uniform(0, 2)
            x, y, yaw = _along(road, arc + 0.5 * width, side * (_FACADE_M + back + 4.0))
            texture = Texture(rng.uniform(95, 165), 38.0, 2.4, int(rng.integers(1 << 30)))
            boxes.append(box_at((x, y, 0.5 * height), (width, 8.0, height), texture, yaw))
            arc += width + rng.uniform(0.0, 1.5)
    return boxes


def _parked_cars(road: Road, rng: np.random.Generator) -> list[Box]:
    boxes: list[Box] = []
    for side in (-1.0, 1.0):
        for arc in np.arange(14.0, road.length_m, 17.0) + rng.uniform(-4.0, 4.0):
            x, y, yaw = _along(road, float(arc), side * _KERB_M)
            T_world_car = box_at((x, y, 0.0), (1.0, 1.0, 1.0), _paint(0.0, 0), yaw).T_body_box
            paint = _paint(rng.uniform(80, 170), int(rng.integers(1 << 30)))
            boxes += [
                Box(T_world_car @ part.T_body_box, part.size, part.texture)
                for part in car_boxes(_CAR, paint)
            ]
    return boxes


def _poles(road: Road, rng: np.random.Generator) -> list[Box]:
    boxes = []
    for side in (-1.0, 1.0):
        for arc in np.arange(8.0, road.length_m, 23.0) + rng.uniform(-5.0, 5.0):
            x, y, yaw = _along(road, float(arc), side * (_KERB_M + 1.8))
            texture = Texture(rng.uniform(60, 130), 30.0, 0.5, int(rng.integers(1 << 30)))
            boxes.append(box_at((x, y, 2.5), (0.18, 0.18, 5.0), texture, yaw))
    return boxes
