"""The compiled ray caster equals its plain NumPy twin: brute force over boxes, no tiles."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.sim import render_kernel as kernel
from ovmot.sim.render import camera_rays, scene_view
from ovmot.sim.scene import Scene, Texture, box_at


def cell(ix: IntArray, iy: IntArray, seed: np.ndarray) -> FloatArray:
    h = ix.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    h = h ^ (iy.astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)) ^ seed
    h = (h ^ (h >> np.uint64(31))) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    return np.asarray((h >> np.uint64(40)) / 2.0**23 - 1.0)


def texture(uv: FloatArray, pixel: FloatArray, look: FloatArray, seed: np.ndarray) -> FloatArray:
    """Grey (N,) of surface points (N, 2) whose pixels cover (N, 2) metres; look (N, 5)."""
    grey = look[:, 0].copy()
    for octave in range(int(look[:, 4].max())):
        size = look[:, 2] / 2.0**octave
        width = kernel.EDGE_PIXELS * pixel / size[:, None]
        fade = np.clip(2.0 - 2.0 * width.max(axis=1), 0.0, 1.0) * (octave < look[:, 4])
        soft = np.clip(np.maximum(width, look[:, 3:4]), kernel.SHARPEST, 1.0)
        x = uv / size[:, None] + kernel.OCTAVE_SHIFT * octave
        i = np.floor(x).astype(np.int64)
        s = np.clip((x - i - 0.5) / soft + 0.5, 0.0, 1.0)
        mixed = seed + np.uint64(octave * 7919)
        corner = [[cell(i[:, 0] + a, i[:, 1] + b, mixed) for a in (0, 1)] for b in (0, 1)]
        low, high = ((1.0 - s[:, 0]) * c[0] + s[:, 0] * c[1] for c in corner)
        noise = (1.0 - s[:, 1]) * low + s[:, 1] * high
        grey += fade * look[:, 1] * kernel.PERSISTENCE**octave * noise
    return grey


def cast(rays: FloatArray, view: kernel.View) -> tuple[IntArray, FloatArray]:
    """Surface (N,) and depth (N,) of rays (N, 3)."""
    down = rays @ view.rotation[0, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(down < 0.0, -view.origin[0, 2] / down, np.inf)
    surface = np.where(down < 0.0, kernel.GROUND, kernel.SKY)
    for b in range(len(view.near)):
        with np.errstate(divide="ignore"):
            d, o, half = rays @ view.rotation[b + 1].T, view.origin[b + 1], view.half[b]
            one, two = (-half - o) / d, (half - o) / d
        axis = np.minimum(one, two).argmax(axis=1)
        enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        hit = (enter > 0.0) & (enter < leave) & (enter < t)
        side = np.take_along_axis(one > two, axis[:, None], axis=1)[:, 0]
        surface = np.where(hit, kernel.FIRST_BOX + 6 * b + 2 * axis + side, surface)
        t = np.where(hit, enter, t)
    return surface, t


def shade(
    rays: FloatArray, steps: FloatArray, surface: IntArray, t: FloatArray, view: kernel.View
) -> FloatArray:
    """Grey (N,) where rays (N, 3) with pixel steps (N, 2, 3) meet surfaces (N,) at depth (N,)."""
    box, face = np.divmod(np.maximum(surface - kernel.FIRST_BOX, 0), 6)
    on_box = surface >= kernel.FIRST_BOX
    frame = np.where(on_box, box + 1, 0)
    n = np.where(on_box, face // 2, 2)
    light = np.where(on_box, view.shade[box, face], 1.0)
    row = np.where(surface == kernel.SKY, 0, frame + 1)
    seed = view.seed[row] + np.where(on_box, face * 104729, 0).astype(np.uint64)
    R, o = view.rotation[frame], view.origin[frame]
    d = np.einsum("nij,nj->ni", R, rays)
    e = np.einsum("nij,nsj->nsi", R, steps)
    pq = (n[:, None] + [1, 2]) % 3
    pick = np.arange(len(n))
    slope = e[pick, :, n] / d[pick, n][:, None]
    spans = np.abs(e - d[:, None] * slope[..., None]).max(axis=1)
    with np.errstate(invalid="ignore"):
        point = o + t[:, None] * d
        pixel = t[:, None] * np.take_along_axis(spans, pq, axis=1)
    uv = np.take_along_axis(point, pq, axis=1)
    length = np.linalg.norm(d, axis=1)
    scale = 1.0 / (np.maximum(d[:, 2] / length, 0.0) + kernel.HORIZON)
    sky_pixel = scale**2 * np.maximum(abs(steps[:, 0, 0]), abs(steps[:, 1, 1])) / length
    sky = (surface == kernel.SKY)[:, None]
    uv = np.where(sky, (scale / length)[:, None] * d[:, :2], uv)
    pixel = np.where(sky, sky_pixel[:, None], pixel)
    return light * texture(uv, pixel, view.look[row], seed)


def render_twin(rays: FloatArray, view: kernel.View) -> tuple[FloatArray, IntArray, FloatArray]:
    shape = rays.shape[:2]
    right, below = np.empty_like(rays), np.empty_like(rays)
    right[:, :-1], below[:-1] = np.diff(rays, axis=1), np.diff(rays, axis=0)
    right[:, -1], below[-1] = right[:, -2], below[-2]
    flat, steps = rays.reshape(-1, 3), np.stack([right, below], axis=2).reshape(-1, 2, 3)
    surface, t = cast(flat, view)
    grey = shade(flat, steps, surface, t, view)
    s = np.pad(surface.reshape(shape), 1, mode="edge")
    middle = s[1:-1, 1:-1]
    others = (s[:-2, 1:-1], s[2:, 1:-1], s[1:-1, :-2], s[1:-1, 2:])
    edge = np.any([other != middle for other in others], axis=0).ravel()
    total = np.zeros(edge.sum())
    for du, dv in kernel.SAMPLES:
        moved = flat[edge] + du * steps[edge, 0] + dv * steps[edge, 1]
        seen, at = cast(moved, view)
        total += shade(moved, steps[edge], seen, at, view)
    grey[edge] = total / len(kernel.SAMPLES)
    return grey.reshape(shape), surface.reshape(shape), t.reshape(shape)


def crowd(seed: int) -> Scene:
    """Boxes everywhere: behind, around, before and across the camera's plane."""
    rng = np.random.default_rng(seed)
    boxes = [
        box_at(
            tuple(rng.uniform([-6, -9, 0], [25, 9, 4])),
            tuple(rng.uniform(0.3, 3.0, 3)),
            Texture(rng.uniform(60, 180), 40.0, rng.uniform(0.5, 3.0), int(rng.integers(1 << 40))),
            rng.uniform(-3, 3),
        )
        for _ in range(40)
    ]
    ground, sky = Texture(100.0, 30.0, 3.0, 5, 0.2), Texture(200.0, 10.0, 1.0, 6, 1.0, 3)
    return Scene(tuple(boxes), (), ground, sky, np.array([0.3, -0.5, 0.8]))


CAMERAS = {
    "radtan": Camera.make(
        (97, 61), (70.0, 71.0), (47.0, 30.5), "radtan", [-0.1, 0.05, 0.001, -0.002, 0.01]
    ),
    "fisheye": Camera.make(
        (90, 80), (38.0, 38.0), (45.0, 39.0), "equidistant", [0.01, -0.002, 0.001, 0.0]
    ),
}


@pytest.mark.parametrize("model", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kernel_equals_its_twin(model: str, seed: int) -> None:
    scene = crowd(seed)
    rays = camera_rays(CAMERAS[model])
    forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turn = so3.exp(np.random.default_rng(seed).normal(0.0, 0.2, 3))
    view, _ = scene_view(
        scene, list(scene.boxes), se3.make(turn @ forward, np.array([0.0, 0, 1.8]))
    )
    shape = rays.shape[:2]
    grey, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    surface = np.empty(shape, np.int32)
    kernel.render_view(rays, view, grey, surface, depth)
    grey_twin, surface_twin, depth_twin = render_twin(rays, view)
    np.testing.assert_array_equal(surface, surface_twin)
    np.testing.assert_allclose(depth, depth_twin, rtol=1e-6)
    np.testing.assert_allclose(grey, grey_twin, atol=1e-3)
    assert len(np.unique(surface)) > 20


def test_pixels_without_a_ray_are_black_and_have_no_depth() -> None:
    rays = camera_rays(CAMERAS["radtan"]).copy()
    rays[:20, :30] = np.nan
    scene = crowd(0)
    pose = se3.make(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.0, 0, 1.8]))
    view, _ = scene_view(scene, list(scene.boxes), pose)
    shape = rays.shape[:2]
    grey, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    surface = np.empty(shape, np.int32)
    kernel.render_view(rays, view, grey, surface, depth)
    assert np.all(grey[:20, :30] == 0.0)
    assert np.all(np.isnan(depth[:20, :30]))
    assert np.all(np.isfinite(grey[21:, 31:]))
