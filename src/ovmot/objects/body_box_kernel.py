"""The compiled box of a body: the hull of its map along its heading, and what was never seen of it.

tests/objects/test_body_box_kernel.py holds the plain NumPy twins.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.objects.body_step_kernel import Body, FeatureMap

_SIDE_M = 1e-3  # shorter vectors have no direction
_TRUSTED = 2  # frames in which a feature of the hull was seen
_ENOUGH = 3  # features that span a hull
_UNLIKELY = 0.01  # probability of a range so short
_BARE = 0.1  # of a body's extent, without texture


class Heading(NamedTuple):
    """Direction of travel in the body's frame, rad, its variance, and which of its sides were ever
    seen: along (that shows its length) and across it (its width)."""

    angle: float
    variance: float
    shown: BoolArray
    drives: bool


class Shown(NamedTuple):
    """Extents (3,) of what was seen of a body, without its shadow, the sigma (3,) of their ends, m,
    and along which axes (3,) its faces were in view."""

    extent: FloatArray
    sigma: FloatArray
    faces: BoolArray


class Box(NamedTuple):
    """Centre (3,) in world, yaw, size (3,): length, width, height, and standard deviations (3,).

    `hull_centre`, `hull_size` (3,): of what was seen of the body, along the same axes. `velocity`
    (3,): of the centre, m/s; `covariance` (6, 6) of its place and velocity, without that of the
    size.
    """

    centre: FloatArray
    yaw: float
    size: FloatArray
    std_size: FloatArray
    hull_centre: FloatArray
    hull_size: FloatArray
    shown: Shown
    is_vehicle: bool
    velocity: FloatArray
    covariance: FloatArray


class Sizes(NamedTuple):
    """Of road users, m: usual ones (C, 3) of the classes of motion, the last of them cars, with
    their spread (C, 3), a share; of lorries (3,), and the greatest (3,). From `vehicle_m` across
    their way they are no walkers; none is smaller than `least`, or than usual by more than `far`
    standard deviations. Up to `shadow` above its lowest
    feature, a body may be its shadow on the road."""

    usual: FloatArray
    spread: FloatArray
    lorry: FloatArray
    greatest: FloatArray
    vehicle_m: float
    far: float
    least: float
    shadow: float


class Headings(NamedTuple):
    """Of a body's heading: how it wanders against the frame, rad/√s, up to which standard
    deviation, rad, a velocity tells it, the sine of the flattest view that shows a side, and from
    which speed, m/s, a body drives."""

    wander: float
    told: float
    grazing: float
    drives_mps: float


def turned_heading(
    heading: Heading, body: Body, centre: FloatArray, camera: FloatArray, whole: bool,
    has_front: bool, dt: float, h: Headings,
) -> Heading:  # fmt: skip
    """The heading after dt seconds, by the body's velocity, and the sides that a `camera` (3,)
    sees of its `centre` (3,) if it is `whole` in view. What `has_front` may reverse."""
    x, P = body.state.x, body.state.P
    speed = math.sqrt(x[4] ** 2 + x[5] ** 2)
    angle, variance = heading.angle, heading.variance + h.wander**2 * dt
    across, along = math.inf, math.inf
    if speed > _SIDE_M:
        c, s = x[4] / speed, x[5] / speed
        across = (s * s * P[4, 4] - 2.0 * s * c * P[4, 5] + c * c * P[5, 5]) / speed**2
        along = math.sqrt(max(c * c * P[4, 4] + 2.0 * s * c * P[4, 5] + s * s * P[5, 5], 0.0))
    if across < h.told**2:
        noise = across * max(1.0 / max(dt, 1e-3), 1.0)  # errors persist for about a second
        off = math.atan2(x[5], x[4]) - x[3] - angle
        off = (off + math.pi) % (2.0 * math.pi) - math.pi
        if has_front and heading.variance < h.told**2 and abs(off) > 0.5 * math.pi:
            off -= math.copysign(math.pi, off)  # it reverses
        gain = variance / (variance + noise)
        angle, variance = angle + gain * off, (1.0 - gain) * variance
    ray_x, ray_y = centre[0] - camera[0], centre[1] - camera[1]
    length = max(math.sqrt(ray_x**2 + ray_y**2), 1e-9)
    cosine = abs(math.cos(x[3] + angle) * ray_x + math.sin(x[3] + angle) * ray_y) / length
    sine = math.sqrt(max(1.0 - cosine**2, 0.0))
    shown = heading.shown.copy()
    shown[0] |= whole and sine > h.grazing
    shown[1] |= whole and cosine > h.grazing
    drives = heading.drives or speed - 2.0 * along > h.drives_mps
    return Heading(angle, variance, shown, drives)


def box_of_body(
    body: Body, kind: int, heading: Heading, least: FloatArray, camera: FloatArray, gap: float,
    sizes: Sizes,
) -> Box:  # fmt: skip
    """The box of a body of a `kind` seen by a `camera` (3,), of at least the size `least` (3,).

    What was not seen of it is as large as is usual, behind what was. What lies beyond a `gap`, m,
    is not of this body.
    """
    x, m, lo, hi = body.state.x, body.map, np.empty(3), np.empty(3)
    c, s = math.cos(x[3] + heading.angle), math.sin(x[3] + heading.angle)
    noise = np.empty(3)
    n_whole = extents(m, outline_above(m, -math.inf), heading.angle, gap, lo, hi, noise)
    hull_size, hull_middle = hi - lo, 0.5 * (lo + hi)
    n_high = without_shadow(m, heading.angle, gap, sizes.shadow, lo, hi, noise)
    vehicle = heading.drives or hi[1] - lo[1] > sizes.vehicle_m
    usual = usual_size(hi - lo, sizes) if kind == len(sizes.usual) - 1 else sizes.usual[kind]
    size, std, middle, local = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    shown = Shown(hi - lo, noise, np.ones(3, np.bool_))
    eye_x, eye_y = camera[0] - x[0], camera[1] - x[1]
    eye = (c * eye_x + s * eye_y, c * eye_y - s * eye_x, camera[2] - x[2])
    for a in range(3):
        n, spread = n_whole if a == 2 else n_high, sizes.spread[kind, a]
        shown.faces[a] = a == 2 or heading.shown[a]
        middle[a], size[a], std[a] = 0.5 * (lo[a] + hi[a]), usual[a], spread * usual[a]
        both = shown.faces[a] and spans(shown.extent[a], n, (1.0 - sizes.far * spread) * usual[a])
        if both:
            size[a], std[a] = size_of(shown.extent[a], n, size[a], std[a])
        size[a] = min(max(size[a], shown.extent[a], least[a], sizes.least), sizes.greatest[a])
        # both faces were seen, or the nearer one, which stays
        if both or a == 2:
            local[a] = middle[a]
        else:
            local[a] = lo[a] + 0.5 * size[a] if eye[a] < middle[a] else hi[a] - 0.5 * size[a]
    centre, hull_centre = np.empty(3), np.empty(3)
    for place, out in ((local, centre), (hull_middle, hull_centre)):
        out[0] = x[0] + c * place[0] - s * place[1]
        out[1] = x[1] + s * place[0] + c * place[1]
        out[2] = x[2] + place[2]
    velocity, covariance = motion_of(body, centre)
    return Box(
        centre, x[3] + heading.angle, size, std, hull_centre, hull_size, shown, vehicle, velocity,
        covariance,
    )  # fmt: skip


@part
def spans(seen: float, n: int, extent: float) -> bool:
    """May n features anywhere along an `extent`, m, have the range that was `seen`? Else a part of
    the body was hidden.

    The distribution of the range is n r^(n - 1) - (n - 1) r^n with r = seen / extent.
    """
    r = min(seen / extent, 1.0)
    return n >= _ENOUGH and n * r ** (n - 1) - (n - 1) * r**n > _UNLIKELY


@part
def size_of(seen: float, n: int, usual: float, sigma: float) -> tuple[float, float]:
    """A body's extent along one axis and its standard deviation, m, by the extent of n features
    anywhere on it, and by the `usual` one of its class with `sigma`.

    The range R of n uniform values has the mean s (n - 1)/(n + 1), so that R (n + 1)/(n - 1) is
    unbiased, with the variance 2 s²/((n - 1)(n + 2)) (H. David & H. Nagaraja, Order Statistics,
    2003, 2.3). Its ends are known no better than bodies have bare edges, a tenth of their extent.
    """
    size = seen * (n + 1.0) / (n - 1.0)
    variance = (2.0 / ((n - 1.0) * (n + 2.0)) + _BARE**2) * max(size, usual) ** 2
    gain = sigma**2 / (sigma**2 + variance)
    return usual + gain * (size - usual), math.sqrt((1.0 - gain) * sigma**2)


@part
def usual_size(seen: FloatArray, sizes: Sizes) -> FloatArray:
    """Size (3,) of a vehicle as wide and high as was `seen` (3,): between a car and a lorry."""
    share, car = 0.0, sizes.usual[-1]
    for a in (1, 2):
        larger = (seen[a] - car[a]) / (sizes.lorry[a] - car[a])
        share = max(share, min(larger, 1.0))
    out = np.empty(3)
    for a in range(3):
        out[a] = car[a] + share * (sizes.lorry[a] - car[a])
    return out


@part
def motion_of(body: Body, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,) of a point (3,) of the body, and the covariance (6, 6) of place and velocity.

    With r from the body's place to it: v + ω x r, and its place turns about that of the body.
    """
    x, P = body.state.x, body.state.P
    rx, ry = point[0] - x[0], point[1] - x[1]
    own, turn, by = (0, 1, 2, 4, 5, 6), (3, 3, 3, 7, 7, 7), (-ry, rx, 0.0, -ry, rx, 0.0)
    velocity, C = np.empty(3), np.empty((6, 6))
    velocity[0], velocity[1], velocity[2] = x[4] - x[7] * ry, x[5] + x[7] * rx, x[6]
    for a in range(6):
        for b in range(6):
            C[a, b] = P[own[a], own[b]] + by[b] * P[own[a], turn[b]]
            C[a, b] += by[a] * (P[turn[a], own[b]] + by[b] * P[turn[a], turn[b]])
    return velocity, C


@part
def without_shadow(
    m: FeatureMap, angle: float, gap: float, shadow: float, lo: FloatArray, hi: FloatArray,
    noise: FloatArray,
) -> int:  # fmt: skip
    """Take length and width of `lo`, `hi`, `noise` (3,) from what is higher than `shadow` above the
    bottom: of how many features.

    The shadow on the road moves as the body does, and reaches farther.
    """
    back, front, of_both = np.empty(3), np.empty(3), np.empty(3)
    n = extents(m, outline_above(m, lo[2] + shadow), angle, gap, back, front, of_both)
    for a in range(2):
        lo[a], hi[a], noise[a] = back[a], front[a], of_both[a]
    return n


@part
def outline_above(m: FeatureMap, bottom: float) -> IntArray:
    """Rows of the features of the outline that are higher than `bottom`: those that were seen more
    than once, if there are enough, else all; with too few of them, the same of any height."""
    own, n = np.empty(len(m.f), np.int64), 0
    for low, least in ((bottom, _TRUSTED), (bottom, 0), (-math.inf, _TRUSTED), (-math.inf, 0)):
        n = 0
        for k in range(len(m.f)):
            if m.outline[k] and m.n_seen[k] >= least and m.f[k, 2] > low:
                own[n] = k
                n += 1
        if n >= _ENOUGH:
            break
    return own[:n]


@part
def extents(
    m: FeatureMap, rows: IntArray, angle: float, gap: float, lo: FloatArray, hi: FloatArray,
    noise: FloatArray,
) -> int:  # fmt: skip
    """The least and greatest coordinates (3,) along a heading of some features of a map, each less
    the greatest error that is to be expected of so many, and the sigma (3,) of both; and of how
    many."""
    n = len(rows)
    f, sigma, c, s = np.empty((3, n)), np.empty((3, n)), math.cos(angle), math.sin(angle)
    for i in range(n):
        p, C = m.f[rows[i]], m.cov[rows[i]]
        f[0, i], f[1, i], f[2, i] = c * p[0] + s * p[1], c * p[1] - s * p[0], p[2]
        sigma[0, i] = math.sqrt(max(c * c * C[0, 0] + 2.0 * c * s * C[0, 1] + s * s * C[1, 1], 0.0))
        sigma[1, i] = math.sqrt(max(s * s * C[0, 0] - 2.0 * c * s * C[0, 1] + c * c * C[1, 1], 0.0))
        sigma[2, i] = math.sqrt(max(C[2, 2], 0.0))
    whole = near_the_median(f[0], sigma[0], gap) & near_the_median(f[1], sigma[1], gap)
    n_whole = int(np.sum(whole))
    wider = math.sqrt(2.0 * math.log(max(n_whole if n_whole > 0 else n, 2)))
    for a in range(3):
        lo[a], hi[a], of_lo, of_hi = math.inf, -math.inf, 0.0, 0.0
        for i in range(n):
            if whole[i] or n_whole == 0:
                if f[a, i] + wider * sigma[a, i] < lo[a]:
                    lo[a], of_lo = f[a, i] + wider * sigma[a, i], sigma[a, i]
                if f[a, i] - wider * sigma[a, i] > hi[a]:
                    hi[a], of_hi = f[a, i] - wider * sigma[a, i], sigma[a, i]
        noise[a] = math.sqrt(of_lo**2 + of_hi**2)
        if lo[a] > hi[a]:
            lo[a] = hi[a] = 0.5 * (lo[a] + hi[a])
    return n_whole if n_whole > 0 else n


@part
def near_the_median(x: FloatArray, sigma: FloatArray, gap: float) -> BoolArray:
    """Which of the coordinates (n,) have no gap between them and the median one that is certainly,
    by two standard deviations, longer than `gap`."""
    n, order = len(x), np.argsort(x)
    out, middle = np.zeros(n, np.bool_), n // 2
    for step, start in ((1, middle), (-1, middle)):
        k = start
        out[order[k]] = True
        while 0 <= k + step < n:
            a, b = order[k], order[k + step]
            noise = math.sqrt(sigma[a] ** 2 + sigma[b] ** 2)
            if abs(x[b] - x[a]) - 2.0 * noise > gap:
                break
            out[b] = True
            k += step
    return out


_box_of_body = part(box_of_body)


def steady_box(
    body: Body, kind: int, before: FloatArray, heading: Heading, old: Box, least: FloatArray,
    camera: FloatArray, gain: float, gap: float, sizes: Sizes,
) -> Box:  # fmt: skip
    """The box of a body as `box_of_body` has it, but that it changes slowly in the body's frame, by
    a gain, from the `old` one, of when its frame was at `before` (4,): place and yaw. How far its
    size is behind is part of its standard deviations."""
    new, place = _box_of_body(body, kind, heading, least, camera, gap, sizes), body.state.x
    c, s = math.cos(before[3]), math.sin(before[3])
    dx, dy = old.centre[0] - before[0], old.centre[1] - before[1]
    x, y, z = c * dx + s * dy, c * dy - s * dx, old.centre[2] - before[2]
    c, s = math.cos(place[3]), math.sin(place[3])
    dx, dy = new.centre[0] - place[0], new.centre[1] - place[1]
    x += gain * (c * dx + s * dy - x)
    y += gain * (c * dy - s * dx - y)
    z += gain * (new.centre[2] - place[2] - z)
    centre = np.empty(3)
    centre[0], centre[1] = place[0] + c * x - s * y, place[1] + s * x + c * y
    centre[2] = place[2] + z
    size = old.size + gain * (new.size - old.size)
    std = np.sqrt(new.std_size**2 + (new.size - size) ** 2)
    velocity, covariance = motion_of(body, centre)
    return Box(
        centre, new.yaw, size, std, new.hull_centre, new.hull_size, new.shown,
        new.is_vehicle, velocity, covariance,
    )  # fmt: skip


def carried_box(body: Body, before: FloatArray, box: Box) -> Box:
    """The box of a body that was not seen since its place was `before` (3,): it goes with it."""
    centre, hull_centre = box.centre.copy(), box.hull_centre.copy()
    for a in range(3):
        centre[a] += body.state.x[a] - before[a]
        hull_centre[a] += body.state.x[a] - before[a]
    velocity, covariance = motion_of(body, centre)
    return Box(
        centre, box.yaw, box.size, box.std_size, hull_centre, box.hull_size, box.shown,
        box.is_vehicle, velocity, covariance,
    )  # fmt: skip


_FOLDER = code_folder(Path(__file__))
turned_heading_compiled = compiled(turned_heading, _FOLDER)
box_of_body_compiled = compiled(box_of_body, _FOLDER)
steady_box_compiled = compiled(steady_box, _FOLDER)
carried_box_compiled = compiled(carried_box, _FOLDER)
