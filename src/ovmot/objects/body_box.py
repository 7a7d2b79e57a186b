"""The box of a body: the hull of its map along its heading, and what was never seen of it."""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body import Body
from ovmot.physics import CAR_SIZE_M, LORRY_SIZE_M, MAX_VEHICLE_SIZE_M, WALKER_MPS, WALKER_SIGMA_MPS

_GRAZING = 0.5  # sine of 30 degrees: flatter, a side shows no texture that could be followed
_TRUSTED = 2  # frames in which a feature of the hull was seen
_UNSEEN_SHARE = 0.25  # standard deviation of vehicles' sizes, of their size
_SEEN_SIGMA = 0.3  # from the outermost feature to the end of a body, m
_LEAST_SIZE_M = 0.3
_SIGMAS = 2.0  # of a point's place


@dataclass(frozen=True, slots=True)
class Heading:
    """Direction of travel in the body's frame, rad, its variance, and which of its sides were ever
    seen: along (that shows its length) and across it (its width)."""

    angle: float
    variance: float
    shown: BoolArray
    drives: bool


@dataclass(frozen=True, slots=True)
class Box:
    """Centre (3,) in world, yaw, size (3,): length, width, height, and standard deviations (3,).

    `hull_centre`, `hull_size` (3,): of what was seen of the body, along the same axes.
    """

    centre: FloatArray
    yaw: float
    size: FloatArray
    std_size: FloatArray
    hull_centre: FloatArray
    hull_size: FloatArray
    is_vehicle: bool

    @property
    def gap_m(self) -> float:
        """Without features, between two parts of the body, at most."""
        return GAP_M if self.is_vehicle else REACH_M


def new_heading() -> Heading:
    """That of a body's birth: its frame lies along its velocity."""
    return Heading(0.0, np.pi**2, np.zeros(2, np.bool_), False)


def updated_heading(
    heading: Heading, body: Body, centre: FloatArray, camera: FloatArray, dt: float
) -> Heading:
    """The heading after dt seconds, by the body's velocity, and the sides that a `camera` (3,)
    sees of its `centre` (3,)."""
    v, P = body.velocity, body.velocity_cov
    speed = float(np.hypot(v[0], v[1]))
    angle, variance = heading.angle, heading.variance + 0.03**2 * dt
    if speed > 1e-3:
        across = np.array([-v[1], v[0], 0.0]) / speed
        noise = float(across @ P @ across) / speed**2
        if noise < 0.3**2:
            noise *= max(1.0 / max(dt, 1e-3), 1.0)  # errors persist for about a second
            off = np.arctan2(v[1], v[0]) - float(body.state.x[3]) - angle
            off = (off + np.pi) % (2.0 * np.pi) - np.pi
            gain = variance / (variance + noise)
            angle, variance = angle + gain * off, (1.0 - gain) * variance
    ray = centre[:2] - camera[:2]
    ray = ray / max(float(np.linalg.norm(ray)), 1e-9)
    yaw = float(body.state.x[3]) + angle
    cosine, sine = abs(np.cos(yaw) * ray[0] + np.sin(yaw) * ray[1]), 0.0
    sine = float(np.sqrt(max(1.0 - cosine**2, 0.0)))
    shown = np.array([sine > _GRAZING, cosine > _GRAZING])
    along = v / max(float(np.linalg.norm(v)), 1e-9)
    sigma = float(np.sqrt(along @ P @ along))
    fast = speed - 2.0 * sigma > WALKER_MPS + 4.0 * WALKER_SIGMA_MPS
    return Heading(
        float(angle), float(variance), heading.shown | shown, heading.drives or bool(fast)
    )


def box_of(body: Body, heading: Heading, least: FloatArray, camera: FloatArray) -> Box:
    """The box of a body seen by a `camera` (3,), of at least the size `least` (3,).

    What was not seen of a vehicle is as large as a passenger car's, behind what was.
    """
    R = rotation_z(float(body.state.x[3]) + heading.angle)
    to_local = rotation_z(heading.angle)
    trusted = body.map.outline & (body.map.count >= _TRUSTED)
    if trusted.sum() < 3:
        trusted = body.map.outline
    f = body.map.f[trusted] @ to_local
    sigma = np.sqrt(np.einsum("ai,nab,bi->ni", to_local, body.map.cov[trusted], to_local))
    whole = _without_gaps(f[:, 0], sigma[:, 0]) & _without_gaps(f[:, 1], sigma[:, 1])
    if whole.any():
        f, sigma = f[whole], sigma[whole]
    sigma *= np.sqrt(2.0 * np.log(max(len(f), 2)))  # the greatest of so many errors
    lo, hi = (f + sigma).min(0), (f - sigma).max(0)
    crossed = lo > hi
    middle = 0.5 * (lo + hi)
    lo, hi = np.where(crossed, middle, lo), np.where(crossed, middle, hi)
    size = hi - lo
    vehicle = heading.drives or size[1] > 1.2
    wanted = np.maximum(size, np.maximum(least, _LEAST_SIZE_M))
    std = np.full(3, _SEEN_SIGMA)
    if vehicle:
        tall = size[1] > CAR_SIZE_M[1] or size[2] > CAR_SIZE_M[2]
        usual = np.array(LORRY_SIZE_M if tall and heading.drives else CAR_SIZE_M)
        unseen = np.append(~heading.shown, False) | (wanted < 0.5 * usual)
        unseen &= (wanted < usual) & (np.arange(3) < 2)
        wanted = np.where(unseen, usual, wanted)
        std = np.where(unseen, _UNSEEN_SHARE * usual, std)
    wanted = np.minimum(wanted, MAX_VEHICLE_SIZE_M)
    eye = R.T @ (camera - body.state.x[:3])
    # the nearer face stays
    near_low = eye < middle
    centre = np.where(near_low, lo + 0.5 * wanted, hi - 0.5 * wanted)
    centre[2] = middle[2]
    vehicle = bool(vehicle)
    p, yaw = body.state.x[:3], float(body.state.x[3]) + heading.angle
    return Box(p + R @ centre, yaw, wanted, std, p + R @ middle, size, vehicle)


GAP_M = 2.5
"""Without features, between two ends of a vehicle: as much as a lorry's axles are apart."""

REACH_M = 0.5
"""The same for who walks."""


def _without_gaps(x: FloatArray, sigma: FloatArray) -> BoolArray:
    """Which of the coordinates (N,) belong to the median one: no gap between them is certainly
    longer than a lorry. What lies beyond is not of this body."""
    order = np.argsort(x, kind="stable")
    noise = np.hypot(sigma[order[1:]], sigma[order[:-1]])
    part = np.append(0, np.cumsum(np.diff(x[order]) - _SIGMAS * noise > LORRY_SIZE_M[0]))
    belongs = np.empty(len(x), dtype=np.bool_)
    belongs[order] = part == part[len(x) // 2]
    return belongs


def may_belong(box: Box, p_world: FloatArray, sigma: FloatArray) -> BoolArray:
    """Which points (N, 3), with standard deviations (N,), may be of the body of a box.

    With each of them its hull must be no larger than vehicles are, nor have a greater gap.
    """
    local = (p_world - box.hull_centre) @ rotation_z(box.yaw)
    outside = np.maximum(np.abs(local) - 0.5 * box.hull_size, 0.0)
    outside = np.maximum(outside - _SIGMAS * sigma[:, None], 0.0)
    fits = (box.hull_size + outside <= np.maximum(box.hull_size, MAX_VEHICLE_SIZE_M)).all(1)
    return np.asarray(fits & (outside[:, :2].max(1) < box.gap_m))


def distance_to_hull(box: Box, p_world: FloatArray) -> FloatArray:
    """Distances (N,) of points (N, 3) to the hull of a box, 0 inside."""
    local = (p_world - box.hull_centre) @ rotation_z(box.yaw)
    outside = np.maximum(np.abs(local) - 0.5 * box.hull_size, 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1))
