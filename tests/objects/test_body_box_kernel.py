"""The compiled box of a body equals its plain NumPy twin."""

import numpy as np
import pytest
from body_twins import some_body

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body_box_kernel import (
    Box,
    Heading,
    Headings,
    Sizes,
    box_of_body_compiled,
    carried_box_compiled,
    steady_box_compiled,
    turned_heading_compiled,
)
from ovmot.objects.body_step_kernel import Body

SIZES = Sizes(
    np.array([4.5, 1.9, 1.5]), np.array([8.0, 2.5, 3.3]), np.array([18.0, 2.6, 4.0]), 1.2, 0.3,
    0.25, 0.3, 0.2,
)  # fmt: skip
HEADINGS = Headings(0.03, 0.3, 0.5, 3.0)
CAMERA, GAP = np.array([0.2, 0.1, -0.3]), 1.5


def whole(x: FloatArray, sigma: FloatArray) -> BoolArray:
    order = np.argsort(x)
    noise = np.hypot(sigma[order[1:]], sigma[order[:-1]])
    part = np.append(0, np.cumsum(np.diff(x[order]) - 2.0 * noise > GAP))
    out = np.empty(len(x), np.bool_)
    out[order] = part == part[len(x) // 2]
    return out


def motion(body: Body, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity of a point of the body and the covariance of both."""
    x, r, J = body.state.x, point - body.state.x[:3], np.zeros((6, 8))
    J[:3, :3] = J[3:, 4:7] = np.eye(3)
    J[0, 3] = J[3, 7] = -r[1]
    J[1, 3] = J[4, 7] = r[0]
    v = x[4:7] + np.cross([0.0, 0.0, x[7]], r)
    return v, J @ body.state.P[:8, :8] @ J.T


def outline_above(body: Body, low: float) -> BoolArray:
    m = body.map
    high, trusted = m.outline & (m.f[:, 2] > low), m.n_seen >= 2
    wanted = (high & trusted, high, m.outline & trusted)
    return next((rows for rows in wanted if rows.sum() >= 3), m.outline)


def extents(body: Body, rows: BoolArray, to_local: FloatArray) -> tuple[FloatArray, FloatArray]:
    m = body.map
    f = m.f[rows] @ to_local
    sigma = np.sqrt(np.einsum("ai,nab,bi->ni", to_local, m.cov[rows], to_local))
    own = whole(f[:, 0], sigma[:, 0]) & whole(f[:, 1], sigma[:, 1])
    f, sigma = (f[own], sigma[own]) if own.any() else (f, sigma)
    sigma = sigma * np.sqrt(2.0 * np.log(max(len(f), 2)))
    lo, hi = (f + sigma).min(0), (f - sigma).max(0)
    middle = 0.5 * (lo + hi)
    return np.minimum(lo, middle), np.maximum(hi, middle)


def expected_box(body: Body, heading: Heading, least: FloatArray) -> Box:
    x = body.state.x
    R, to_local = rotation_z(float(x[3]) + heading.angle), rotation_z(heading.angle)
    lo, hi = extents(body, outline_above(body, -np.inf), to_local)
    hull_size, hull_middle = hi - lo, 0.5 * (lo + hi)
    back, front = extents(body, outline_above(body, lo[2] + SIZES.shadow), to_local)
    lo[:2], hi[:2] = back[:2], front[:2]
    middle = 0.5 * (lo + hi)
    seen = hi - lo
    vehicle = bool(heading.drives or seen[1] > SIZES.vehicle_m)
    size, std = np.maximum(seen, np.maximum(least, SIZES.least)), np.full(3, SIZES.seen_sigma)
    if vehicle:
        larger = ((seen - SIZES.car) / (SIZES.lorry - SIZES.car))[1:].max()
        share = np.clip(larger, 0.0, 1.0) if heading.drives else 0.0
        usual = SIZES.car + share * (SIZES.lorry - SIZES.car)
        unseen = np.append(~heading.shown, False) | (size < 0.5 * usual)
        unseen &= (size < usual) & (np.arange(3) < 2)
        size = np.where(unseen, usual, size)
        std = np.where(unseen, SIZES.unseen_share * usual, std)
    size = np.minimum(size, SIZES.greatest)
    eye = R.T @ (CAMERA - x[:3])
    local = np.where(eye < middle, lo + 0.5 * size, hi - 0.5 * size)
    local[2] = middle[2]
    centre = x[:3] + R @ local
    return Box(
        centre, float(x[3]) + heading.angle, size, std, x[:3] + R @ hull_middle, hull_size, vehicle,
        *motion(body, centre),
    )  # fmt: skip


def assert_same(found: Box, expected: Box) -> None:
    for name, a, b in zip(Box._fields, found, expected, strict=True):
        np.testing.assert_allclose(np.asarray(a), np.asarray(b), atol=1e-9, err_msg=name)


@pytest.mark.parametrize("shown", [(True, True), (False, True)])
@pytest.mark.parametrize("drives", [True, False])
def test_a_box_is_that_of_the_plain_twin(shown: tuple[bool, bool], drives: bool) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        body, least = some_body(rng), np.array([0.5, 0.2, 2.5])
        body.map.f[:, 0] *= rng.choice([0.1, 1.0, 3.0])  # short ones, and some with a gap
        heading = Heading(0.3, 0.02, np.array(shown), drives)
        found = box_of_body_compiled(body, heading, least, CAMERA, GAP, SIZES)
        assert_same(found, expected_box(body, heading, least))


def test_a_box_changes_slowly_in_the_frame_of_its_body() -> None:
    rng = np.random.default_rng(7)
    body = some_body(rng)
    heading, least = Heading(0.3, 0.02, np.array([True, True]), True), np.zeros(3)
    new = expected_box(body, heading, least)
    before = np.array([0.2, -0.5, 11.5, 0.35])
    old = new._replace(centre=new.centre + np.array([0.4, -1.0, 0.2]), size=1.5 * new.size)
    found = steady_box_compiled(body, before, heading, old, least, CAMERA, 0.25, GAP, SIZES)
    x, R = body.state.x, rotation_z(float(body.state.x[3]))
    offset = rotation_z(before[3]).T @ (old.centre - before[:3])
    offset = offset + 0.25 * (R.T @ (new.centre - x[:3]) - offset)
    centre = x[:3] + R @ offset
    velocity, covariance = motion(body, centre)
    size = old.size + 0.25 * (new.size - old.size)
    assert_same(
        found, new._replace(centre=centre, size=size, velocity=velocity, covariance=covariance)
    )
    carried = carried_box_compiled(body, before, old)
    moved = x[:3] - before[:3]
    velocity, covariance = motion(body, old.centre + moved)
    went = old._replace(centre=old.centre + moved, hull_centre=old.hull_centre + moved)
    assert_same(carried, went._replace(velocity=velocity, covariance=covariance))


@pytest.mark.parametrize("speed", [0.0, 2.0, 20.0])
def test_a_heading_is_that_of_the_plain_twin(speed: float) -> None:
    body = some_body(np.random.default_rng(8))
    body.state.x[4:6] = speed * np.array([np.cos(0.9), np.sin(0.9)])
    heading = Heading(0.2, 0.05, np.array([False, False]), False)
    found = turned_heading_compiled(heading, body, body.state.x[:3], CAMERA, 0.1, HEADINGS)
    angle, variance = heading.angle, heading.variance + HEADINGS.wander**2 * 0.1
    v, P = body.state.x[4:6], body.state.P[4:6, 4:6]
    along = 0.0
    if speed > 0.0:
        u = v / speed
        across = np.array([-u[1], u[0]])
        along = float(np.sqrt(u @ P @ u))
        noise = float(across @ P @ across) / speed**2
        if noise < HEADINGS.told**2:
            off = (0.9 - body.state.x[3] - angle + np.pi) % (2.0 * np.pi) - np.pi
            gain = variance / (variance + 10.0 * noise)
            angle, variance = angle + gain * off, (1.0 - gain) * variance
    ray = (body.state.x[:3] - CAMERA)[:2]
    yaw = float(body.state.x[3]) + angle
    cosine = abs(np.array([np.cos(yaw), np.sin(yaw)]) @ ray) / np.linalg.norm(ray)
    assert found.angle == pytest.approx(angle, abs=1e-9)
    assert found.variance == pytest.approx(variance, abs=1e-9)
    assert found.shown.tolist() == [bool(np.sqrt(1.0 - cosine**2) > 0.5), bool(cosine > 0.5)]
    assert found.drives is bool(speed - 2.0 * along > HEADINGS.drives_mps)
