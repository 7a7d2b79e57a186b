"""Stereo images of a scene, with depth and object ids as truth, through any camera model."""

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import AnyArray, FloatArray, Image, IntArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim import render_kernel as kernel
from ovmot.sim.optics import defocused, exposure_gains, sub_exposures
from ovmot.sim.scene import Box, Scene, Texture
from ovmot.sim.simulation import Optics
from ovmot.types import StereoFrame

_AMBIENT = 0.72
_FACE_NORMALS = np.array(
    [[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], dtype=np.float64
)
_NEAR_M = 0.05
_CORNER_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
_EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])


@dataclass(frozen=True, slots=True)
class RenderedImage:
    """One camera's view: grey (H, W) in 0..255 as float32, not yet rounded.

    `object_id` (H, W) uint8 is 0 where no mover is seen; `depth` (H, W) float32 is the distance
    along the camera's z axis in m, infinite for the sky, NaN where the camera model has no ray;
    both belong to the pixel's middle. `surface` (H, W) int32 tells the faces of all bodies apart.
    """

    grey: AnyArray
    object_id: Image
    depth: AnyArray
    surface: AnyArray


@dataclass(frozen=True, slots=True)
class RenderedFrame:
    """A stereo pair as a camera would give it, and the truth behind it."""

    frame: StereoFrame
    left: RenderedImage
    right: RenderedImage


def camera_rays(camera: Camera) -> FloatArray:
    """Rays (H, W, 3) with z = 1 through the middles of all pixels; NaN where the model has none."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xy = camera.normalize(np.stack([u, v], axis=-1).astype(np.float64))
    return np.ascontiguousarray(np.concatenate([xy, np.ones((*u.shape, 1))], axis=-1))


def render_image(
    scene: Scene, rays: FloatArray, T_world_cam: FloatArray, timestamp_ns: int
) -> RenderedImage:
    """What a camera with these rays (H, W, 3) sees of the scene at one time, without noise."""
    boxes, object_id = scene.placed_boxes(timestamp_ns)
    view, order = scene_view(scene, boxes, T_world_cam)
    grey = np.empty(rays.shape[:2], dtype=np.float32)
    depth = np.empty_like(grey)
    surface = np.empty(rays.shape[:2], dtype=np.int32)
    kernel.render_view(rays, view, grey, surface, depth)
    ids = np.concatenate([[0], np.asarray(object_id, dtype=np.uint8)[order]]).astype(np.uint8)
    seen = np.where(surface >= kernel.FIRST_BOX, (surface - kernel.FIRST_BOX) // 6 + 1, 0)
    return RenderedImage(np.clip(np.nan_to_num(grey), 0.0, 255.0), ids[seen], depth, surface)


def render_exposure(
    scene: Scene, rays: FloatArray, path: PoseSpline, T_imu_cam: FloatArray, timestamp_ns: int,
    exposure_s: float,
) -> RenderedImage:  # fmt: skip
    """The mean of sub-exposures around the stamp; all but `grey` is the truth at the stamp."""
    times = sub_exposures(timestamp_ns, exposure_s)
    images = [render_image(scene, rays, path.pose(t) @ T_imu_cam, t) for t in times]
    if len(images) == 1:
        return images[0]
    grey = np.mean([image.grey for image in images], axis=0, dtype=np.float32)
    return replace(images[len(images) // 2], grey=np.asarray(grey))


def expose(image: RenderedImage, optics: Optics, gain: float, rng: np.random.Generator) -> Image:
    """The image as 8-bit grey (H, W): blurred by the lens, brightened by `gain`, with noise."""
    grey = np.float32(gain) * defocused(image.grey, optics.defocus_px)
    noise = optics.noise_grey * rng.standard_normal(grey.shape, dtype=np.float32)
    return np.asarray(np.clip(np.round(grey + noise), 0, 255), dtype=np.uint8)


def render_stereo(
    scene: Scene,
    rig: StereoRig,
    path: PoseSpline,
    timestamp_ns: IntArray,
    optics: Optics,
    rng: np.random.Generator,
) -> Iterator[RenderedFrame]:
    """Stereo frames along T_world_imu(t) at camera times (N,), rendered ahead in two threads."""
    rays = [camera_rays(camera) for camera in rig.cameras]
    mounts = (rig.T_imu_cam0, rig.T_imu_cam1)
    gains = exposure_gains(timestamp_ns, optics.exposure_drift, rng.spawn(1)[0])
    with ThreadPoolExecutor(max_workers=2) as pool:

        def start(time_ns: int) -> list[Future[RenderedImage]]:
            return [
                pool.submit(render_exposure, scene, r, path, T, time_ns, optics.exposure_s)
                for r, T in zip(rays, mounts, strict=True)
            ]

        times = [int(t) for t in timestamp_ns]
        ahead = start(times[0]) if times else []
        for i, time_ns in enumerate(times):
            left, right = (job.result() for job in ahead)
            ahead = start(times[i + 1]) if i + 1 < len(times) else []
            exposed = [
                expose(image, optics, float(gain), rng)
                for image, gain in zip((left, right), gains[i], strict=True)
            ]
            yield RenderedFrame(StereoFrame(time_ns, exposed[0], exposed[1]), left, right)


def scene_view(
    scene: Scene, boxes: list[Box], T_world_cam: FloatArray
) -> tuple[kernel.View, IntArray]:
    """The kernel's arrays, boxes ordered by nearness, and that order (B,)."""
    T_world_box = np.array([box.T_body_box for box in boxes]).reshape(-1, 4, 4)
    half = 0.5 * np.array([box.size for box in boxes]).reshape(-1, 3)
    T_box_cam = se3.inverse(T_world_box) @ T_world_cam
    bounds, near = _outlines(se3.inverse(T_box_cam), half)
    normals = np.einsum("bij,fj->bfi", T_world_box[:, :3, :3], _FACE_NORMALS)
    light = np.maximum(normals @ (scene.sun / np.linalg.norm(scene.sun)), 0.0)
    order = np.argsort(near, kind="stable")
    order = order[np.isfinite(near[order])]
    textures = [scene.sky, scene.ground, *(boxes[i].texture for i in order)]
    view = kernel.View(
        rotation=np.concatenate([T_world_cam[None, :3, :3], T_box_cam[order, :3, :3]]),
        origin=np.concatenate([T_world_cam[None, :3, 3], T_box_cam[order, :3, 3]]),
        half=half[order],
        bounds=bounds[order],
        near=near[order],
        shade=(_AMBIENT + (1.0 - _AMBIENT) * light)[order],
        look=np.array([_look(texture) for texture in textures]),
        seed=np.array([texture.seed for texture in textures], dtype=np.uint64),
    )
    return view, order


def _outlines(T_cam_box: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (B, 4) in the plane z = 1 and least depths (B,) of what is before the camera.

    The part of a box beyond the near plane is convex: its corners are the box's own there and those
    where edges pass the plane. Depth is infinite for a box wholly behind it.
    """
    corners = se3.apply(T_cam_box[:, None], half[:, None] * _CORNER_SIGNS)
    start, end = corners[:, _EDGES[:, 0]], corners[:, _EDGES[:, 1]]
    drop = end[..., 2] - start[..., 2]
    share = (_NEAR_M - start[..., 2]) / np.where(drop == 0.0, np.inf, drop)
    cut = start + share[..., None] * (end - start)
    cut[..., 2] = _NEAR_M
    points = np.concatenate([corners, cut], axis=1)
    passes = (drop != 0.0) & (share >= 0.0) & (share <= 1.0)
    valid = np.concatenate([corners[..., 2] >= _NEAR_M, passes], axis=1)
    xy = points[..., :2] / np.where(valid, points[..., 2], 1.0)[..., None]
    least = np.where(valid[..., None], xy, np.inf).min(axis=1)
    greatest = np.where(valid[..., None], xy, -np.inf).max(axis=1)
    near = np.where(valid, points[..., 2], np.inf).min(axis=1)
    return np.concatenate([least, greatest], axis=-1), near


def _look(texture: Texture) -> tuple[float, ...]:
    return texture.mean, texture.contrast, texture.cell_m, texture.softness, texture.octaves
