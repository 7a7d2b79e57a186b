"""The compiled ray caster: one ray a pixel against ground and boxes, four at surfaces' edges.

Compiling takes some seconds. It holds no Python lock. tests/sim/test_render_kernel.py
holds its plain NumPy twin.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ovmot.geometry.arrays import AnyArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled

SKY, GROUND, FIRST_BOX = 0, 1, 2
PERSISTENCE = 0.75
OCTAVE_SHIFT = 0.37
EDGE_PIXELS = 1.3
"""Width of a lattice edge in the image, in pixels."""
SHARPEST = 0.02
HORIZON = 0.12
SAMPLES = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
_TILE = 16
_SLACK, _LEAST_SLACK = 0.15, 0.01
"""Share of a tile, and of the plane z = 1, by which a tile is widened for bent and extra rays."""


_F = TypeVar("_F", bound=Callable[..., Any])


def _compiled(function: _F) -> _F:
    """A part of `render_view`: compiled into it, with no code of its own on disk."""
    return compiled(function, None)


def _compiled_once(function: _F) -> _F:
    """Compiled, and kept in the user's cache."""
    return compiled(function, code_folder(Path(__file__)))


class View(NamedTuple):
    """A scene as one camera sees it. B boxes, the nearest first; camera rays have z = 1.

    `rotation` (B+1, 3, 3) turns camera directions into the frames of the world and of each box, and
    `origin` (B+1, 3) is the camera there; `half` (B, 3) half the sides. `bounds` (B, 4): least x,
    y, greatest x, y of the box in the plane z = 1; `near` (B,): its least depth, m. `shade` (B, 6):
    light on the faces -x, +x, -y, +y, -z, +z. Of sky, ground, boxes: `look` (B+2, 5) is mean,
    contrast, cell, softness, octaves, and `seed` (B+2,) uint64.
    """

    rotation: FloatArray
    origin: FloatArray
    half: FloatArray
    bounds: FloatArray
    near: FloatArray
    shade: FloatArray
    look: FloatArray
    seed: AnyArray


@_compiled
def _cell(ix: np.int64, iy: np.int64, seed: np.uint64) -> float:
    """A hash of a lattice cell as a number in [-1, 1) (multiply and xor-shift mixing)."""
    h = (
        np.uint64(ix) * np.uint64(0x9E3779B97F4A7C15)
        ^ np.uint64(iy) * np.uint64(0xC2B2AE3D27D4EB4F)
        ^ np.uint64(seed)
    )
    h = (h ^ (h >> np.uint64(31))) * np.uint64(0xD6E8FEB86659FD93)
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    return float(h >> np.uint64(40)) * (2.0 / 16777216.0) - 1.0


@_compiled
def _ramp(f: float, width: float) -> float:
    """From 0 to 1 around f = 1/2; no division where it is flat, which is almost everywhere."""
    rise = f - 0.5
    if rise >= 0.5 * width:
        return 1.0
    if rise <= -0.5 * width:
        return 0.0
    return rise / width + 0.5


@_compiled
def _noise(x: float, y: float, width_x: float, width_y: float, seed: np.uint64) -> float:
    """Value noise at lattice coordinates, with edges of the given width (1: bilinear).

    Cells of no weight are not hashed.
    """
    fx, fy = math.floor(x), math.floor(y)
    ix, iy = np.int64(fx), np.int64(fy)
    sx, sy = _ramp(x - fx, width_x), _ramp(y - fy, width_y)
    one = np.int64(1)
    low = high = 0.0
    if sy < 1.0:
        if sx < 1.0:
            low = (1.0 - sx) * _cell(ix, iy, seed)
        if sx > 0.0:
            low += sx * _cell(ix + one, iy, seed)
    if sy > 0.0:
        if sx < 1.0:
            high = (1.0 - sx) * _cell(ix, iy + one, seed)
        if sx > 0.0:
            high += sx * _cell(ix + one, iy + one, seed)
    return (1.0 - sy) * low + sy * high


@_compiled
def _texture(
    u: float, v: float, pixel_u: float, pixel_v: float, looks: FloatArray, row: int, seed: np.uint64
) -> float:
    """Grey at a surface point (m) that a pixel covers by pixel_u x pixel_v metres.

    An octave fades out before its cells are as small as the pixel, so that it can not alias.
    """
    grey, amplitude, softness = looks[row, 0], looks[row, 1], looks[row, 3]
    per_m = 1.0 / looks[row, 2]
    width_u, width_v = EDGE_PIXELS * pixel_u * per_m, EDGE_PIXELS * pixel_v * per_m
    x, y, shift = u * per_m, v * per_m, 0.0
    for octave in range(int(looks[row, 4])):
        fade = min(2.0 - 2.0 * max(width_u, width_v), 1.0)
        if fade <= 0.0:
            break
        soft_u = min(max(width_u, softness, SHARPEST), 1.0)
        soft_v = min(max(width_v, softness, SHARPEST), 1.0)
        mixed = seed + np.uint64(octave * 7919)
        grey += fade * amplitude * _noise(x + shift, y + shift, soft_u, soft_v, mixed)
        x, y, width_u, width_v = 2.0 * x, 2.0 * y, 2.0 * width_u, 2.0 * width_v
        shift += OCTAVE_SHIFT
        amplitude *= PERSISTENCE
    return float(grey)


@_compiled
def _row(R: FloatArray, i: int, k: int, x: tuple[float, float, float]) -> float:
    """Component k of R_i x."""
    return float(R[i, k, 0] * x[0] + R[i, k, 1] * x[1] + R[i, k, 2] * x[2])


@_compiled
def _hit_box(view: View, b: int, ray: tuple[float, float, float]) -> tuple[float, int]:
    """Depth where the ray enters box b and the face there; (-1, 0) for a miss (slab method)."""
    enter, leave, face = 0.0, math.inf, -1
    for k in range(3):
        d, o, half = _row(view.rotation, b + 1, k, ray), view.origin[b + 1, k], view.half[b, k]
        if d == 0.0:
            if abs(o) > half:
                return -1.0, 0
            continue
        first, last = (-half - o) / d, (half - o) / d
        side = 2 * k
        if first > last:
            first, last = last, first
            side += 1
        if first > enter:
            enter, face = first, side
        leave = min(leave, last)
    if face < 0 or enter >= leave:
        return -1.0, 0
    return enter, face


@_compiled
def _cast(
    ray: tuple[float, float, float], view: View, candidates: IntArray, count: int
) -> tuple[int, float]:
    """The first surface that a camera ray with z = 1 meets, and the depth there."""
    surface, t = SKY, math.inf
    down = _row(view.rotation, 0, 2, ray)
    if down < 0.0:
        surface, t = GROUND, -view.origin[0, 2] / down
    for i in range(count):
        b = candidates[i]
        if view.near[b] > t:
            break
        left, top, right, bottom = view.bounds[b]
        if ray[0] < left or ray[0] > right or ray[1] < top or ray[1] > bottom:
            continue
        hit, face = _hit_box(view, b, ray)
        if 0.0 < hit < t:
            surface, t = FIRST_BOX + 6 * b + face, hit
    return surface, t


@_compiled
def _shade(
    ray: tuple[float, float, float],
    step_u: tuple[float, float, float],
    step_v: tuple[float, float, float],
    surface: int,
    t: float,
    view: View,
) -> float:
    """Grey of the surface where the camera ray meets it."""
    if surface == SKY:
        norm = math.sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2])
        scale = 1.0 / (max(_row(view.rotation, 0, 2, ray) / norm, 0.0) + HORIZON)
        pixel = scale * scale * max(abs(step_u[0]), abs(step_v[1])) / norm
        x = scale * _row(view.rotation, 0, 0, ray) / norm
        y = scale * _row(view.rotation, 0, 1, ray) / norm
        return _texture(x, y, pixel, pixel, view.look, 0, view.seed[0])
    i, n, light = 0, 2, 1.0
    seed = view.seed[1]
    if surface >= FIRST_BOX:
        b, face = (surface - FIRST_BOX) // 6, (surface - FIRST_BOX) % 6
        i, n, light = b + 1, face // 2, view.shade[b, face]
        seed = view.seed[b + 2] + np.uint64(face * 104729)
    p, q = (n + 1) % 3, (n + 2) % 3
    R = view.rotation
    d_n, e_n, g_n = _row(R, i, n, ray), _row(R, i, n, step_u), _row(R, i, n, step_v)
    d_p, e_p, g_p = _row(R, i, p, ray), _row(R, i, p, step_u), _row(R, i, p, step_v)
    d_q, e_q, g_q = _row(R, i, q, ray), _row(R, i, q, step_u), _row(R, i, q, step_v)
    along_u, along_v = e_n / d_n, g_n / d_n  # ray differentials (H. Igehy, SIGGRAPH 1999)
    pixel_p = t * max(abs(e_p - d_p * along_u), abs(g_p - d_p * along_v))
    pixel_q = t * max(abs(e_q - d_q * along_u), abs(g_q - d_q * along_v))
    at_p, at_q = view.origin[i, p] + t * d_p, view.origin[i, q] + t * d_q
    return light * _texture(at_p, at_q, pixel_p, pixel_q, view.look, i + 1, seed)


@_compiled
def _candidates(
    rays: FloatArray, v0: int, v1: int, u0: int, u1: int, view: View, out: IntArray
) -> int:
    """Boxes whose bounds touch those of a tile of the image, in their order; their count."""
    x0 = y0 = math.inf
    x1 = y1 = -math.inf
    for v in (v0, v1 - 1):
        for u in (u0, u1 - 1):
            x, y = rays[v, u, 0], rays[v, u, 1]
            if math.isnan(x):  # a tile that the camera sees in part only: every box may be in it
                x0, x1, y0, y1 = -math.inf, math.inf, -math.inf, math.inf
            x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    slack_x = _SLACK * (x1 - x0) + _LEAST_SLACK
    slack_y = _SLACK * (y1 - y0) + _LEAST_SLACK
    count = 0
    for b in range(len(view.near)):
        left, top, right, bottom = view.bounds[b]
        apart = left > x1 + slack_x or right < x0 - slack_x
        if not (apart or top > y1 + slack_y or bottom < y0 - slack_y):
            out[count] = b
            count += 1
    return count


@_compiled
def _step(rays: FloatArray, v: int, u: int, dv: int, du: int) -> tuple[float, float, float]:
    """By how much the ray changes to the next pixel; towards the middle at the image's edge."""
    height, width = rays.shape[:2]
    sign = -1.0 if (v + dv >= height or u + du >= width) else 1.0
    k = int(sign)
    a, b = rays[v, u], rays[v + k * dv, u + k * du]
    return sign * (b[0] - a[0]), sign * (b[1] - a[1]), sign * (b[2] - a[2])


@_compiled
def _on_edge(surface: IntArray, v: int, u: int) -> bool:
    height, width = surface.shape
    s = surface[v, u]
    return bool(
        (v > 0 and surface[v - 1, u] != s)
        or (v + 1 < height and surface[v + 1, u] != s)
        or (u > 0 and surface[v, u - 1] != s)
        or (u + 1 < width and surface[v, u + 1] != s)
    )


@_compiled
def _refine(
    rays: FloatArray, v: int, u: int, view: View, candidates: IntArray, count: int
) -> float:
    """Mean grey of `SAMPLES` rays within a pixel."""
    r = rays[v, u]
    e, g = _step(rays, v, u, 0, 1), _step(rays, v, u, 1, 0)
    total = 0.0
    for du, dv in SAMPLES:
        ray = (r[0] + du * e[0] + dv * g[0], r[1] + du * e[1] + dv * g[1], 1.0)
        surface, t = _cast(ray, view, candidates, count)
        total += _shade(ray, e, g, surface, t, view)
    return total / len(SAMPLES)


@_compiled_once
def render_view(
    rays: FloatArray, view: View, grey: AnyArray, surface: AnyArray, depth: AnyArray
) -> None:
    """Fill grey (float32), surface (int32) and depth (float32, m along z), each (H, W).

    `rays` (H, W, 3) are camera rays with z = 1, NaN where the model has none (grey 0, depth NaN).
    Surface is `SKY`, `GROUND`, or `FIRST_BOX` + 6 box + face; the sky's depth is infinite.
    """
    height, width = rays.shape[:2]
    boxes = np.empty(len(view.near), dtype=np.int64)
    for pass_number in range(2):
        for v0 in range(0, height, _TILE):
            for u0 in range(0, width, _TILE):
                v1, u1 = min(v0 + _TILE, height), min(u0 + _TILE, width)
                count = _candidates(rays, v0, v1, u0, u1, view, boxes)
                for v in range(v0, v1):
                    for u in range(u0, u1):
                        r = rays[v, u]
                        if math.isnan(r[0]):
                            grey[v, u], surface[v, u], depth[v, u] = 0.0, SKY, np.nan
                        elif pass_number == 0:
                            ray = (r[0], r[1], r[2])
                            s, t = _cast(ray, view, boxes, count)
                            surface[v, u], depth[v, u] = s, t
                            e, g = _step(rays, v, u, 0, 1), _step(rays, v, u, 1, 0)
                            grey[v, u] = _shade(ray, e, g, s, t, view)
                        elif _on_edge(surface, v, u):
                            grey[v, u] = _refine(rays, v, u, view, boxes, count)
