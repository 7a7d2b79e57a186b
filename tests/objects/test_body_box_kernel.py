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
    Shown,
    Sizes,
    box_of_body_compiled,
    carried_box_compiled,
    steady_box_compiled,
    turned_heading_compiled,
)
from ovmot.objects.body_step_kernel import Body

SIZES = Sizes(
    np.array([[0.5, 0.4, 1.7], [1.8, 0.6, 1.7], [4.5, 1.9, 1.5]]),
    np.array([[0.3, 0.1, 0.1], [0.1, 0.1, 0.1], [0.25, 0.1, 0.2]]),
    np.array([8.0, 2.5, 3.3]), np.array([18.0, 2.6, 4.0]), 1.2, 2.0, 0.3, 0.2,
)  # fmt: skip
CAR = 2
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


def extents(
    body: Body, rows: BoolArray, to_local: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    m = body.map
    f = m.f[rows] @ to_local
    sigma = np.sqrt(np.einsum("ai,nab,bi->ni", to_local, m.cov[rows], to_local))
    own = whole(f[:, 0], sigma[:, 0]) & whole(f[:, 1], sigma[:, 1])
    f, sigma = (f[own], sigma[own]) if own.any() else (f, sigma)
    wider = sigma * np.sqrt(2.0 * np.log(max(len(f), 2)))
    first, last = (f + wider).argmin(0), (f - wider).argmax(0)
    lo, hi = (f + wider).min(0), (f - wider).max(0)
    middle, axes = 0.5 * (lo + hi), np.arange(3)
    noise = np.hypot(sigma[first, axes], sigma[last, axes])
    return np.minimum(lo, middle), np.maximum(hi, middle), noise, len(f)


def fused(seen: float, n: int, usual: float, sigma: float, spread: float) -> tuple[float, float]:
    """Size along an axis of which both faces were in view, with its sigma; 0 of a hidden part."""
    r = min(seen / ((1.0 - SIZES.far * spread) * usual), 1.0)
    if n < 3 or n * r ** (n - 1) - (n - 1) * r**n <= 0.01:
        return 0.0, 0.0
    measured = seen * (n + 1) / (n - 1)
    variance = (2.0 / ((n - 1) * (n + 2)) + 0.01) * max(measured, usual) ** 2
    weight = np.array([1.0 / sigma**2, 1.0 / variance])
    return float(weight @ [usual, measured] / weight.sum()), float(weight.sum() ** -0.5)


def expected_box(body: Body, kind: int, heading: Heading, least: FloatArray) -> Box:
    x = body.state.x
    R, to_local = rotation_z(float(x[3]) + heading.angle), rotation_z(heading.angle)
    lo, hi, noise, n_whole = extents(body, outline_above(body, -np.inf), to_local)
    hull_size, hull_middle = hi - lo, 0.5 * (lo + hi)
    back, front, of_both, n_high = extents(
        body, outline_above(body, lo[2] + SIZES.shadow), to_local
    )
    lo[:2], hi[:2], noise[:2] = back[:2], front[:2], of_both[:2]
    middle, seen, usual = 0.5 * (lo + hi), hi - lo, SIZES.usual[kind]
    if kind == CAR:
        larger = ((seen - usual) / (SIZES.lorry - usual))[1:].max()
        usual = usual + np.clip(larger, 0.0, 1.0) * (SIZES.lorry - usual)
    size, std = usual.copy(), SIZES.spread[kind] * usual
    faces, both = np.append(heading.shown, True), np.zeros(3, np.bool_)
    for a, n in enumerate((n_high, n_high, n_whole)):
        found = fused(seen[a], n, size[a], std[a], SIZES.spread[kind, a])
        if faces[a] and found[0] > 0.0:
            (size[a], std[a]), both[a] = found, True
    size = np.minimum(
        np.maximum(np.maximum(size, seen), np.maximum(least, SIZES.least)), SIZES.greatest
    )
    eye = R.T @ (CAMERA - x[:3])
    local = np.where(eye < middle, lo + 0.5 * size, hi - 0.5 * size)
    local = np.where(both | (np.arange(3) == 2), middle, local)
    centre = x[:3] + R @ local
    vehicle = bool(heading.drives or seen[1] > SIZES.vehicle_m)
    return Box(
        centre, float(x[3]) + heading.angle, size, std, x[:3] + R @ hull_middle, hull_size,
        Shown(seen, noise, faces), vehicle, *motion(body, centre),
    )  # fmt: skip


def assert_same(found: Box, expected: Box) -> None:
    for name, a, b in zip(Box._fields, found, expected, strict=True):
        if name != "shown":
            np.testing.assert_allclose(np.asarray(a), np.asarray(b), atol=1e-9, err_msg=name)
    np.testing.assert_allclose(found.shown.extent, expected.shown.extent, atol=1e-9)
    np.testing.assert_allclose(found.shown.sigma, expected.shown.sigma, atol=1e-9)
    assert found.shown.faces.tolist() == expected.shown.faces.tolist()


@pytest.mark.parametrize("shown", [(True, True), (False, True)])
@pytest.mark.parametrize("drives", [True, False])
@pytest.mark.parametrize("kind", [0, 1, CAR])
def test_a_box_is_that_of_the_plain_twin(shown: tuple[bool, bool], drives: bool, kind: int) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        body, least = some_body(rng), np.array([0.5, 0.2, 2.5])
        body.map.f[:, 0] *= rng.choice([0.1, 1.0, 3.0])  # short ones, and some with a gap
        heading = Heading(0.3, 0.02, np.array(shown), drives)
        found = box_of_body_compiled(body, kind, heading, least, CAMERA, GAP, SIZES)
        assert_same(found, expected_box(body, kind, heading, least))


def test_a_box_changes_slowly_in_the_frame_of_its_body() -> None:
    rng = np.random.default_rng(7)
    body = some_body(rng)
    heading, least = Heading(0.3, 0.02, np.array([True, True]), True), np.zeros(3)
    new = expected_box(body, CAR, heading, least)
    before = np.array([0.2, -0.5, 11.5, 0.35])
    old = new._replace(centre=new.centre + np.array([0.4, -1.0, 0.2]), size=1.5 * new.size)
    found = steady_box_compiled(body, CAR, before, heading, old, least, CAMERA, 0.25, GAP, SIZES)
    x, R = body.state.x, rotation_z(float(body.state.x[3]))
    offset = rotation_z(before[3]).T @ (old.centre - before[:3])
    offset = offset + 0.25 * (R.T @ (new.centre - x[:3]) - offset)
    centre = x[:3] + R @ offset
    velocity, covariance = motion(body, centre)
    size = old.size + 0.25 * (new.size - old.size)
    std = np.hypot(new.std_size, new.size - size)
    steady = new._replace(centre=centre, size=size, std_size=std)
    assert_same(found, steady._replace(velocity=velocity, covariance=covariance))
    carried = carried_box_compiled(body, before, old)
    moved = x[:3] - before[:3]
    velocity, covariance = motion(body, old.centre + moved)
    went = old._replace(centre=old.centre + moved, hull_centre=old.hull_centre + moved)
    assert_same(carried, went._replace(velocity=velocity, covariance=covariance))


@pytest.mark.parametrize("speed", [0.0, 2.0, 20.0])
@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("reverses", [True, False])
def test_a_heading_is_that_of_the_plain_twin(speed: float, whole: bool, reverses: bool) -> None:
    body, direction = some_body(np.random.default_rng(8)), 0.9 + np.pi * reverses
    body.state.x[4:6] = speed * np.array([np.cos(direction), np.sin(direction)])
    heading = Heading(0.2, 0.05, np.array([False, False]), False)
    found = turned_heading_compiled(
        heading, body, body.state.x[:3], CAMERA, whole, reverses, 0.1, HEADINGS
    )
    angle, variance = heading.angle, heading.variance + HEADINGS.wander**2 * 0.1
    v, P = body.state.x[4:6], body.state.P[4:6, 4:6]
    along = 0.0
    if speed > 0.0:
        u = v / speed
        across = np.array([-u[1], u[0]])
        along = float(np.sqrt(u @ P @ u))
        noise = float(across @ P @ across) / speed**2
        if noise < HEADINGS.told**2:
            off = (direction - body.state.x[3] - angle + np.pi) % (2.0 * np.pi) - np.pi
            off -= np.pi * np.sign(off) * (reverses and abs(off) > 0.5 * np.pi)
            gain = variance / (variance + 10.0 * noise)
            angle, variance = angle + gain * off, (1.0 - gain) * variance
    ray = (body.state.x[:3] - CAMERA)[:2]
    yaw = float(body.state.x[3]) + angle
    cosine = abs(np.array([np.cos(yaw), np.sin(yaw)]) @ ray) / np.linalg.norm(ray)
    assert found.angle == pytest.approx(angle, abs=1e-9)
    assert found.variance == pytest.approx(variance, abs=1e-9)
    sides = [bool(np.sqrt(1.0 - cosine**2) > 0.5), bool(cosine > 0.5)]
    assert found.shown.tolist() == [whole and side for side in sides]
    assert found.drives is bool(speed - 2.0 * along > HEADINGS.drives_mps)
