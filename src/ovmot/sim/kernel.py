"""The compiled ray caster: one ray a pixel against ground and boxes, four at surfaces' edges.

Alone in its file with all it calls; tests/sim/test_kernel.py holds its plain NumPy twin. It keeps
no compiled code on disk: it compiles once a process, in some seconds, and holds no Python lock.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit

from ovmot.geometry.arrays import AnyArray, FloatArray, IntArray

SKY, GROUND, FIRST_BOX = 0, 1, 2
OCTAVES = 6
PERSISTENCE = 0.75
EDGE_PIXELS = 1.3
"""Width of a lattice edge in the picture, in pixels."""
SHARPEST = 0.02
HORIZON = 0.12
SAMPLES = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
_TILE = 16
_PIXEL_SLACK = 1.5


_F = TypeVar("_F", bound=Callable[..., Any])


def _compiled(function: _F) -> _F:
    """numba's `njit`, which has no types of its own, with the function's type kept."""
    return cast(_F, njit(nogil=True, error_model="numpy")(function))


class View(NamedTuple):
    """A scene as one camera sees it. B boxes, the nearest first; camera rays have z = 1.

    `rotation` (B, 3, 3) turns camera directions into the box's frame, `origin` (B, 3) is the camera
    there, `half` (B, 3) half the sides. A cone about each: `axis` (B, 3) in the camera, `spread`
    (B,) rad, `near` (B,) m. `shade` (B, 6): light on the faces -x, +x, -y, +y, -z, +z. `look`
    (B+2, 4): mean, contrast, cell, softness, and `seed` (B+2,) uint64, of sky, ground, boxes.
    """

    R_world_cam: FloatArray
    p_world_cam: FloatArray
    rotation: FloatArray
    origin: FloatArray
    half: FloatArray
    axis: FloatArray
    spread: FloatArray
    near: FloatArray
    shade: FloatArray
    look: FloatArray
    seed: AnyArray


@_compiled
def _cell(ix: int, iy: int, seed: int) -> float:
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
    return min(max((f - 0.5) / width + 0.5, 0.0), 1.0)


@_compiled
def _noise(x: float, y: float, width_x: float, width_y: float, seed: int) -> float:
    """Value noise at lattice coordinates, its edges as wide as told (1: bilinear)."""
    fx, fy = math.floor(x), math.floor(y)
    ix, iy = np.int64(fx), np.int64(fy)
    sx, sy = _ramp(x - fx, width_x), _ramp(y - fy, width_y)
    if sx in (0.0, 1.0) and sy in (0.0, 1.0):
        return _cell(ix + np.int64(sx), iy + np.int64(sy), seed)
    low = (1.0 - sx) * _cell(ix, iy, seed) + sx * _cell(ix + 1, iy, seed)
    high = (1.0 - sx) * _cell(ix, iy + 1, seed) + sx * _cell(ix + 1, iy + 1, seed)
    return (1.0 - sy) * low + sy * high


@_compiled
def _texture(
    u: float, v: float, pixel_u: float, pixel_v: float, look: FloatArray, seed: int
) -> float:
    """Grey at a surface point (m) that a pixel covers by pixel_u x pixel_v metres.

    An octave fades out before its cells are as small as the pixel, so that it can not alias.
    """
    grey = look[0]
    size, amplitude = look[2], look[1]
    for octave in range(OCTAVES):
        width_u, width_v = EDGE_PIXELS * pixel_u / size, EDGE_PIXELS * pixel_v / size
        fade = min(2.0 - 2.0 * max(width_u, width_v), 1.0)
        if fade <= 0.0:
            break
        soft_u = min(max(width_u, look[3], SHARPEST), 1.0)
        soft_v = min(max(width_v, look[3], SHARPEST), 1.0)
        shift = 0.37 * octave
        mixed = seed + np.uint64(octave * 7919)
        n = _noise(u / size + shift, v / size + shift, soft_u, soft_v, mixed)
        grey += fade * amplitude * n
        size *= 0.5
        amplitude *= PERSISTENCE
    return grey


@_compiled
def _turn(R: FloatArray, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@_compiled
def _hit_box(o: FloatArray, dx: float, dy: float, dz: float, half: FloatArray) -> tuple[float, int]:
    """Distance along the ray to the box and the face met; (-1, 0) for a miss (slab method)."""
    enter, leave, face = 0.0, math.inf, -1
    for k in range(3):
        d = dx if k == 0 else (dy if k == 1 else dz)
        if d == 0.0:
            if abs(o[k]) > half[k]:
                return -1.0, 0
            continue
        first, last = (-half[k] - o[k]) / d, (half[k] - o[k]) / d
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
    x: float, y: float, z: float, view: View, candidates: IntArray, count: int
) -> tuple[int, float]:
    """The first surface that a camera ray meets, and the ray's length there in units of itself."""
    length = math.sqrt(x * x + y * y + z * z)
    surface, t = SKY, math.inf
    _, _, down = _turn(view.R_world_cam, x, y, z)
    if down < 0.0:
        surface, t = GROUND, -view.p_world_cam[2] / down
    for i in range(count):
        b = candidates[i]
        if view.near[b] > t * length:
            break
        dx, dy, dz = _turn(view.rotation[b], x, y, z)
        hit, face = _hit_box(view.origin[b], dx, dy, dz, view.half[b])
        if 0.0 < hit < t:
            surface, t = FIRST_BOX + 6 * b + face, hit
    return surface, t


@_compiled
def _spans(
    d: tuple[float, float, float],
    e: tuple[float, float, float],
    g: tuple[float, float, float],
    t: float,
    n: int,
) -> tuple[float, float]:
    """Metres that a pixel covers along the two axes of a plane square to axis n.

    d is the ray, e and g its steps to the next pixels; ray differentials of H. Igehy, SIGGRAPH 1999.
    """
    p, q = (n + 1) % 3, (n + 2) % 3
    slope_e, slope_g = e[n] / d[n], g[n] / d[n]
    return (
        t * max(abs(e[p] - d[p] * slope_e), abs(g[p] - d[p] * slope_g)),
        t * max(abs(e[q] - d[q] * slope_e), abs(g[q] - d[q] * slope_g)),
    )


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
        x, y, z = _turn(view.R_world_cam, ray[0], ray[1], ray[2])
        scale = 1.0 / (max(z, 0.0) / math.sqrt(x * x + y * y + z * z) + HORIZON)
        norm = math.sqrt(x * x + y * y + z * z)
        pixel = scale * scale * max(abs(step_u[0]), abs(step_v[1])) / norm
        return _texture(
            scale * x / norm, scale * y / norm, pixel, pixel, view.look[0], view.seed[0]
        )
    if surface == GROUND:
        R, o = view.R_world_cam, view.p_world_cam
        n, look, seed, light = 2, view.look[1], view.seed[1], 1.0
    else:
        b, face = (surface - FIRST_BOX) // 6, (surface - FIRST_BOX) % 6
        R, o = view.rotation[b], view.origin[b]
        n, look, light = face // 2, view.look[b + 2], view.shade[b, face]
        seed = view.seed[b + 2] + np.uint64(face * 104729)
    d = _turn(R, ray[0], ray[1], ray[2])
    e = _turn(R, step_u[0], step_u[1], step_u[2])
    g = _turn(R, step_v[0], step_v[1], step_v[2])
    p, q = (n + 1) % 3, (n + 2) % 3
    pixel_p, pixel_q = _spans(d, e, g, t, n)
    return light * _texture(o[p] + t * d[p], o[q] + t * d[q], pixel_p, pixel_q, look, seed)


@_compiled
def _candidates(
    rays: FloatArray, v0: int, v1: int, u0: int, u1: int, view: View, out: IntArray
) -> int:
    """Boxes whose cones touch that of a tile of the image, in their order; their count."""
    c = rays[(v0 + v1) // 2, (u0 + u1) // 2]
    norm = math.sqrt(c[0] ** 2 + c[1] ** 2 + c[2] ** 2)
    reach = 1.0
    for v in (v0, v1 - 1):
        for u in (u0, u1 - 1):
            r = rays[v, u]
            cosine = (r[0] * c[0] + r[1] * c[1] + r[2] * c[2]) / (
                norm * math.sqrt(r[0] ** 2 + r[1] ** 2 + r[2] ** 2)
            )
            reach = min(reach, cosine) if cosine == cosine else -1.0
    angle = math.acos(max(reach, -1.0)) * (1.0 + _PIXEL_SLACK / _TILE)
    count = 0
    for b in range(len(view.near)):
        a = view.axis[b]
        cosine = (a[0] * c[0] + a[1] * c[1] + a[2] * c[2]) / norm
        if not math.acos(min(max(cosine, -1.0), 1.0)) > angle + view.spread[b]:
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
        x = r[0] + du * e[0] + dv * g[0]
        y = r[1] + du * e[1] + dv * g[1]
        z = r[2] + du * e[2] + dv * g[2]
        surface, t = _cast(x, y, z, view, candidates, count)
        total += _shade((x, y, z), e, g, surface, t, view)
    return total / len(SAMPLES)


@_compiled
def render_view(
    rays: FloatArray, view: View, grey: AnyArray, surface: AnyArray, depth: AnyArray
) -> None:
    """Fill grey (float32), surface (int32) and depth (float32, m along z), each (H, W).

    `rays` (H, W, 3) are camera rays with z = 1, NaN where the lens has none (grey 0, depth NaN).
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
                        if r[0] != r[0]:
                            grey[v, u], surface[v, u], depth[v, u] = 0.0, SKY, np.nan
                        elif pass_number == 0:
                            s, t = _cast(r[0], r[1], r[2], view, boxes, count)
                            surface[v, u], depth[v, u] = s, t
                            e, g = _step(rays, v, u, 0, 1), _step(rays, v, u, 1, 0)
                            grey[v, u] = _shade((r[0], r[1], r[2]), e, g, s, t, view)
                        elif _on_edge(surface, v, u):
                            grey[v, u] = _refine(rays, v, u, view, boxes, count)
