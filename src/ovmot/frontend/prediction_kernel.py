"""Compiled predictions for one image: where features will be seen, and where lost ones may be.

The plain twins are in `tests/frontend/test_prediction_kernel.py`.
"""

import math
from pathlib import Path

import numpy as np

from ovmot.cameras.lens_kernel import to_pixel
from ovmot.frontend.neighbour_kernel import NEAREST, nearest_medians
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.sorting import median

LEAST_DEPTH_M = 0.2
"""Points predicted nearer than this count as passed: their direction alone is used."""


@part
def _fill_depths(uv: FloatArray, depth: FloatArray, default: float) -> None:
    """Replace unknown depths (N,), in place, by the median of the nearest known pixels (N, 2), or
    by the default where too few are known."""
    known, unknown = np.flatnonzero(np.isfinite(depth)), np.flatnonzero(~np.isfinite(depth))
    if len(known) < NEAREST:
        depth[unknown] = default
        return
    if len(unknown):
        values = depth[known].reshape(-1, 1)
        depth[unknown] = nearest_medians(uv[known], values, uv[unknown])[:, 0]


@part
def _see(
    T: FloatArray, lens: int, camera: FloatArray, x: float, y: float, p: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Pixel and depth of a point `p` moved by T (4, 4), the depth NaN where it is unknown or the
    point was passed: then its ray (x, y, 1) is turned."""
    far = 0.0
    q = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    depth = q
    if math.isfinite(q) and q > LEAST_DEPTH_M:
        x, y, far = p[0], p[1], 1.0
        z = p[2]
    else:
        q, depth, z = T[2, 0] * x + T[2, 1] * y + T[2, 2], math.nan, 1.0
    if not q > 0.0:
        return math.nan, math.nan, depth
    a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + far * T[0, 3]
    b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + far * T[1, 3]
    u, v = to_pixel(lens, camera, a / q, b / q)
    return u, v, depth


def predict_tracks(
    uv: FloatArray, xy: FloatArray, p_before: FloatArray, p_predicted: FloatArray,
    extra_flow: FloatArray, T: FloatArray, lens: int, camera: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:  # fmt: skip
    """Pixels (N, 2) of now: if at rest, and where to start the search; depths (N,), metres, NaN
    where unknown; which features move on their own (N,).

    `uv`, `xy` (N, 2): pixels and normalized coordinates before; `p_before`, `p_predicted` (N, 3):
    positions in the camera of then, metres, NaN where unknown, at rest and by the features' own
    motion; `extra_flow` (N, 2): pixels beyond rest in the last interval; T (4, 4): motion of the
    camera, `T_now_before`; `lens`, `camera`: see `lens_kernel.packed_camera`. A feature without a
    position is taken at the depth of those around it, else as infinitely far.
    """
    n = len(uv)
    near = p_before[:, 2].copy()
    _fill_depths(uv, near, math.nan)
    static_uv, start = np.empty((n, 2)), np.empty((n, 2))
    depth, moves = np.empty(n), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        x, y, z = xy[i, 0], xy[i, 1], near[i]
        p = (x * z, y * z, z)
        if math.isfinite(p_before[i, 2]):
            p = (p_before[i, 0], p_before[i, 1], p_before[i, 2])
        static_uv[i, 0], static_uv[i, 1], _ = _see(T, lens, camera, x, y, p)
        p = (p_predicted[i, 0], p_predicted[i, 1], p_predicted[i, 2])
        u, v, depth[i] = _see(T, lens, camera, x, y, p)
        for k in range(3):
            moves[i] |= math.isfinite(p[0]) and p[k] != p_before[i, k]
        if not moves[i]:
            u, v = static_uv[i, 0] + extra_flow[i, 0], static_uv[i, 1] + extra_flow[i, 1]
        start[i, 0], start[i, 1] = u, v
    return static_uv, start, depth, moves


def predict_matches(
    uv: FloatArray, xy: FloatArray, depth: FloatArray, default: float,
    T: FloatArray, lens: int, camera: FloatArray,
) -> FloatArray:  # fmt: skip
    """Pixels (N, 2) in the other camera of features with pixels `uv` and coordinates `xy` (N, 2).

    `depth` (N,), metres, NaN where unknown: then that of the features around, or the default. T
    (4, 4): `T_cam1_cam0`; `lens`, `camera`: of the other camera, see `lens_kernel.packed_camera`.
    """
    filled, start = depth.copy(), np.empty((len(uv), 2))
    _fill_depths(uv, filled, default)
    for i in range(len(uv)):
        x, y, z = xy[i, 0] * filled[i], xy[i, 1] * filled[i], filled[i]
        q = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        start[i, 0], start[i, 1] = math.nan, math.nan
        if q > 0.0:
            start[i, 0], start[i, 1] = to_pixel(lens, camera, a / q, b / q)
    return start


@part
def _flow_nearby(
    uv: FloatArray, static_uv: FloatArray, seen: FloatArray, found: BoolArray, least_px: float
) -> FloatArray:
    """Where lost features would be, had they moved as the movers around them: (N, 2), else NaN.

    `seen` (N, 2) of the features `uv` (N, 2) that are `found` (N,), against `static_uv` (N, 2), all
    in pixels. Movers are those more than `least_px` from where they would be at rest.
    """
    n = len(uv)
    start, moves = np.full((n, 2), math.nan), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        far = math.hypot(seen[i, 0] - static_uv[i, 0], seen[i, 1] - static_uv[i, 1])
        moves[i] = found[i] and far > least_px
    mover, lost = np.flatnonzero(moves), np.flatnonzero(~found)
    if len(mover) >= NEAREST and len(lost):
        extra = nearest_medians(uv[mover], seen[mover] - static_uv[mover], uv[lost])
        start[lost] = static_uv[lost] + extra
    return start


def other_places(
    uv: FloatArray, static_uv: FloatArray, start: FloatArray, seen: FloatArray, found: BoolArray,
    least_px: float,
) -> FloatArray:  # fmt: skip
    """Where else features that are not `found` (N,) may be: (4, N, 2), NaN for nowhere.

    By the movers around them (`_flow_nearby`); at rest, `static_uv` (N, 2), where the first search
    began elsewhere, at `start` (N, 2); a third place, not filled in; and far from where they would
    be at rest, where most features were not found: then the prediction is wrong.
    """
    n, wrong = len(uv), 2 * np.count_nonzero(found) < len(uv)
    out = np.full((4, n, 2), math.nan)
    out[0] = _flow_nearby(uv, static_uv, seen, found, least_px)
    for i in range(n):
        moved = start[i, 0] != static_uv[i, 0] or start[i, 1] != static_uv[i, 1]
        for k in range(2):
            if moved:
                out[1, i, k] = static_uv[i, k]
            if wrong:
                out[3, i, k] = static_uv[i, k]
    return out


def median_flow(xy: FloatArray, p_before: FloatArray, T: FloatArray) -> float:
    """How far points at rest move in the normalized plane, in the median; 0 of none.

    `xy` (N, 2): normalized coordinates before; `p_before` (N, 3): positions in the camera of then,
    metres, NaN where unknown: those are turned alone. T (4, 4): `T_now_before`.
    """
    way, n = np.empty(len(xy)), 0
    for i in range(len(xy)):
        x, y, z, far = xy[i, 0], xy[i, 1], 1.0, 0.0
        if math.isfinite(p_before[i, 2]):
            x, y, z, far = p_before[i, 0], p_before[i, 1], p_before[i, 2], 1.0
        q = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + far * T[2, 3]
        if q > 0.0:
            a = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + far * T[0, 3]
            b = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + far * T[1, 3]
            way[n] = math.hypot(a / q - xy[i, 0], b / q - xy[i, 1])
            n += 1
    return median(way, n) if n else 0.0


_folder = code_folder(Path(__file__))
median_flow_compiled = compiled(median_flow, _folder)
predict_tracks_compiled = compiled(predict_tracks, _folder)
predict_matches_compiled = compiled(predict_matches, _folder)
other_places_compiled = compiled(other_places, _folder)
