"""Images agree with their own depth, with each other and with the movers' truth."""

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray
from ovmot.sim.paths import standing_path, straight_path
from ovmot.sim.profiles import SmoothSteps
from ovmot.sim.render import RenderedFrame, RenderedImage, camera_rays, render_image, render_stereo
from ovmot.sim.scene import Mover, Scene, Texture, box_at, car_boxes
from ovmot.sim.simulation import Optics

ORIGIN = 1_500_000_000_000_000_000
CAR = np.array([4.4, 1.8, 1.45])
R_IMU_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
LEFT = Camera.make((200, 120), (130.0, 131.0), (98.0, 61.0), "radtan", [-0.05, 0.1, 1e-3, -1e-3])
RIGHT = Camera.make((200, 120), (129.0, 130.0), (103.0, 57.0), "radtan", [-0.06, 0.1, 0.0, 1e-3])
RIG = StereoRig(
    LEFT, RIGHT,
    se3.make(R_IMU_CAM, np.array([0.0, 0.24, 0.0])),
    se3.make(R_IMU_CAM @ so3.exp(np.array([0.01, 0.02, 0.06])), np.array([0.0, -0.24, 0.01])),
)  # fmt: skip
T_WORLD_IMU = se3.make(so3.exp(np.array([0.02, -0.03, 0.1])), np.array([0.0, 0.0, 1.7]))


def small_scene(movers: tuple[Mover, ...] = ()) -> Scene:
    wall = [
        box_at((9.0 + 6.0 * i, side * 6.0, 3.0), (5.0, 2.0, 6.0), Texture(120.0, 40.0, 2.0, seed))
        for seed, (i, side) in enumerate([(0, -1), (1, -1), (2, -1), (0, 1), (1, 1), (2, 1)])
    ]
    end = box_at((35.0, 0.0, 4.0), (2.0, 30.0, 8.0), Texture(140.0, 40.0, 3.0, 77))
    return Scene(
        (*wall, end), movers, Texture(100.0, 20.0, 3.0, 11, 0.1), Texture(205.0, 10.0, 1.0, 12, 1),
        np.array([-0.3, 0.5, 0.8]),
    )  # fmt: skip


def car(number: int, speed: float = 5.0) -> Mover:
    path = straight_path((12.0, -2.5), 0.9, SmoothSteps.make((0.0, speed)), ORIGIN, 1.0)
    return Mover(number, "car", CAR, car_boxes(CAR, Texture(150.0, 40.0, 0.8, 5)), path)


def stereo(scene: Scene, seed: int = 0, noise: float = 0.0, frames: int = 1) -> list[RenderedFrame]:
    path = standing_path(T_WORLD_IMU, ORIGIN, 1.0)
    times = ORIGIN + 100_000_000 * np.arange(frames)
    return list(render_stereo(scene, RIG, path, times, Optics(noise), np.random.default_rng(seed)))


def carry(
    source: RenderedImage,
    camera: Camera,
    rays: FloatArray,
    T_b_a: FloatArray,
    target: RenderedImage,
) -> tuple[BoolArray, BoolArray, AnyArray, AnyArray]:
    """Carry each pixel by its depth into another image: who lands, where, and at what depth."""
    depth = source.depth.astype(np.float64)
    solid = np.isfinite(depth)
    points = se3.apply(T_b_a, rays * np.where(solid, depth, 1.0)[..., None])
    pixels = camera.project(points)
    landed = solid & camera.inside(np.nan_to_num(pixels, nan=-9.0), 2.0)
    ui, vi = (np.where(landed, np.round(np.nan_to_num(p)), 0).astype(int) for p in
              (pixels[..., 0], pixels[..., 1]))  # fmt: skip
    same: BoolArray = landed & (
        np.abs(target.depth[vi, ui] - points[..., 2]) < 0.04 * points[..., 2]
    )
    u, v = np.nan_to_num(pixels[..., 0]), np.nan_to_num(pixels[..., 1])
    looked_up = cv2.remap(target.grey, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    return landed, same, looked_up, target.object_id[vi, ui]


def test_left_depth_meets_the_right_view() -> None:
    scene = small_scene((car(3),))
    frame = stereo(scene)[0]
    landed, same, grey, ids = carry(
        frame.left, RIGHT, camera_rays(LEFT), RIG.T_cam1_cam0, frame.right
    )
    assert landed.mean() > 0.5
    assert same[landed].mean() > 0.93  # the rest is hidden from the right camera
    assert (ids == frame.left.object_id)[same].mean() > 0.99
    difference = np.abs(grey - frame.left.grey)[same]
    assert np.median(difference) < 3.0
    assert difference.mean() < 0.35 * frame.left.grey[same].std()


def test_depth_equals_triangulation_of_both_rays() -> None:
    frame = stereo(small_scene())[0]
    rng = np.random.default_rng(0)
    v, u = rng.integers(5, 115, 300), rng.integers(5, 195, 300)
    depth = frame.left.depth[v, u].astype(np.float64)
    keep = depth < 30.0
    rays = camera_rays(LEFT)[v, u][keep]
    points = rays * depth[keep][:, None]
    uv = RIGHT.project(se3.apply(RIG.T_cam1_cam0, points))
    ray1 = np.concatenate([RIGHT.normalize(uv), np.ones((len(uv), 1))], axis=1)
    T = RIG.T_cam1_cam0
    for x0, x1, z in zip(rays, ray1, depth[keep], strict=True):
        A = np.stack([T[:3, :3] @ x0, -x1], axis=1)
        solved = np.linalg.lstsq(A, -T[:3, 3], rcond=None)[0]
        assert solved[0] == pytest.approx(z, rel=1e-6)


def test_a_static_scene_looks_the_same_from_two_poses() -> None:
    scene, rays = small_scene(), camera_rays(LEFT)
    poses = [T_WORLD_IMU @ RIG.T_imu_cam0]
    poses.append(
        poses[0] @ se3.make(so3.exp(np.array([0.01, 0.05, 0.0])), np.array([0.2, 0.0, 1.0]))
    )
    one, two = (render_image(scene, rays, T, ORIGIN) for T in poses)
    landed, same, grey, _ = carry(one, LEFT, rays, se3.inverse(poses[1]) @ poses[0], two)
    assert same[landed].mean() > 0.9
    assert np.median(np.abs(grey - one.grey)[same]) < 4.0


def test_texture_sticks_to_a_moving_body() -> None:
    """Carried by the body's own motion, its pixels keep their grey; left in place, not."""
    mover = car(3)
    scene, rays = small_scene((mover,)), camera_rays(LEFT)
    T_world_cam = T_WORLD_IMU @ RIG.T_imu_cam0
    later = ORIGIN + 200_000_000
    one, two = (render_image(scene, rays, T_world_cam, t) for t in (ORIGIN, later))
    motion = mover.path.pose(later) @ se3.inverse(mover.path.pose(ORIGIN))
    on_car = one.object_id == 3
    carried = se3.inverse(T_world_cam) @ motion @ T_world_cam
    landed, same, grey, ids = carry(one, LEFT, rays, carried, two)
    assert same[on_car & landed].mean() > 0.9
    assert (ids == 3)[on_car & same].mean() > 0.97
    moved = np.abs(grey - one.grey)[on_car & same].mean()
    static = np.abs(two.grey - one.grey)[on_car].mean()
    assert moved < 0.4 * static


def test_object_ids_fill_the_projected_box() -> None:
    mover = car(3)
    frame = stereo(small_scene((mover,)))[0]
    state = mover.state(ORIGIN)
    signs = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    R = so3.exp(np.array([0.0, 0.0, state.yaw]))
    T_cam_world = se3.inverse(T_WORLD_IMU @ RIG.T_imu_cam0)
    outline = LEFT.project(se3.apply(T_cam_world, state.center + (signs * state.size) @ R.T))
    hull = cv2.convexHull(np.round(outline).astype(np.int32))
    mask = cv2.fillConvexPoly(np.zeros((120, 200), np.uint8), hull, 1).astype(bool)
    seen = frame.left.object_id == 3
    assert set(np.unique(frame.left.object_id)) == {0, 3}
    assert seen.sum() > 300
    grown = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    assert not np.any(seen & ~grown)
    assert seen.sum() > 0.7 * mask.sum()


def test_nearer_bodies_hide_farther_ones() -> None:
    hidden = small_scene((car(3),))
    wall = box_at((6.0, 0.0, 3.0), (0.5, 14.0, 6.0), Texture(120.0, 40.0, 1.0, 8))
    scene = Scene((*hidden.boxes, wall), hidden.movers, hidden.ground, hidden.sky, hidden.sun)
    assert not stereo(scene)[0].left.object_id.any()


def test_noise_comes_from_the_seed_alone() -> None:
    scene = small_scene((car(3),))
    first, again, other = (stereo(scene, seed, 2.0, frames=3) for seed in (1, 1, 2))
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.frame.left, b.frame.left)
        np.testing.assert_array_equal(a.frame.right, b.frame.right)
        assert np.any(a.frame.left != c.frame.left)
        noise = a.frame.left.astype(float) - a.left.grey
        inner = (a.left.grey > 10.0) & (a.left.grey < 245.0)
        assert noise[inner].std() == pytest.approx(np.sqrt(4.0 + 1.0 / 12.0), rel=0.05)


@pytest.mark.parametrize("distance", [4.0, 12.0, 40.0])
def test_corners_are_found_at_every_distance(distance: float) -> None:
    wall = box_at((distance + 1.0, 0.0, 0.0), (2.0, 200.0, 200.0), Texture(120.0, 38.0, 2.4, 4))
    scene = Scene(
        (wall,), (), Texture(95.0, 22.0, 3.0, 1), Texture(205.0, 10.0, 1.0, 2), np.ones(3)
    )
    grey = stereo(scene, noise=1.0)[0].frame.left
    corners = cv2.FastFeatureDetector.create(15).detect(grey)
    assert len(corners) > 60
