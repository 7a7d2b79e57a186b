"""The compiled gate and the pairs that it takes, against plain NumPy twins."""

import numpy as np
import pytest

from ovmot.frontend.epipolar import epipolar_lines
from ovmot.frontend.epipolar_kernel import gate_pairs_compiled, pair_up_compiled
from ovmot.geometry import se3, so3
from ovmot.geometry.triangulation import triangulate_stereo

T = se3.make(so3.exp(np.array([0.02, -0.03, 0.4])), np.array([-0.4, 0.1, 0.02]))
E = so3.hat(T[:3, 3]) @ T[:3, :3]
FOCAL = np.array([400.0, 300.0])


@pytest.mark.parametrize("n", [0, 1, 300])
def test_the_gate_is_its_twin(n: int) -> None:
    rng = np.random.default_rng(n)
    p = np.array([0.0, 0.0, 12.0]) + rng.uniform(-4.0, 4.0, (n, 3))
    q = se3.apply(T, p)
    normalized = np.concatenate([p[:, :2] / p[:, 2:], q[:, :2] / q[:, 2:]], axis=1)
    normalized[:, 2:] += rng.normal(0.0, 1.0 / 350.0, (n, 2))
    pixels = 350.0 * normalized
    pixels[::7, 2:] = normalized[::7, 2:] = np.nan
    pixels[3::50, :2] = np.nan
    normalized[5::60, 2] = np.nan  # seen, but outside the camera model
    gated = gate_pairs_compiled(pixels, normalized, E, FOCAL, 1.5, T)
    tested = np.flatnonzero(np.isfinite(pixels[:, [0, 2]]).all(axis=1))
    line = epipolar_lines(normalized[tested, :2], E)
    off = np.abs((line[:, :2] * normalized[tested, 2:]).sum(1) + line[:, 2])
    distance = off / np.linalg.norm(line[:, :2] / FOCAL, axis=1)
    accepted = distance <= 1.5
    np.testing.assert_array_equal(gated.tested, tested)
    np.testing.assert_allclose(gated.line, line, rtol=1e-12)
    np.testing.assert_allclose(gated.distance_px, distance, rtol=1e-9)
    np.testing.assert_array_equal(gated.accepted, accepted)
    kept_pixels, kept_normalized = pixels.copy(), normalized.copy()
    kept_pixels[tested[~accepted], 2:] = kept_normalized[tested[~accepted], 2:] = np.nan
    np.testing.assert_array_equal(gated.pixels, kept_pixels)
    np.testing.assert_array_equal(gated.normalized, kept_normalized)
    positions = np.full((n, 3), np.nan)
    positions[tested] = triangulate_stereo(kept_normalized[tested], T)
    np.testing.assert_allclose(gated.p_cam0, positions, rtol=1e-9)


@pytest.mark.parametrize("masked", [False, True])
def test_pairs_are_those_found_in_the_image(masked: bool) -> None:
    rng = np.random.default_rng(0)
    uv, xy, right_xy = rng.uniform(0.0, 1.0, (3, 200, 2))
    right_uv = rng.uniform(-5.0, [85.0, 65.0], (200, 2))
    found = rng.random(200) < 0.7
    right_uv[:3] = np.nan
    mask = np.zeros((60, 80) if masked else (0, 0), dtype=np.uint8)
    mask[20:40, 10:50] = 255
    inside = ((right_uv >= 4.0) & (right_uv <= np.array([75.0, 55.0]))).all(axis=1)
    expected = found & inside
    if masked:
        u, v = np.round(right_uv[inside]).astype(int).T
        expected[np.flatnonzero(inside)] &= mask[v, u] == 0
    pixels, normalized = pair_up_compiled(uv, xy, right_uv, right_xy, found, mask, 80, 60, 4)
    nothing = np.full((200, 2), np.nan)
    for both, left, right in ((pixels, uv, right_uv), (normalized, xy, right_xy)):
        there = np.where(expected[:, None], right, nothing)
        np.testing.assert_array_equal(both, np.concatenate([left, there], axis=1))
