"""The smoothing spline is the low-pass filter that its cut-off says, and it bridges holes."""

import numpy as np
import pytest

from ovmot.geometry.smoothing import low_pass


@pytest.mark.parametrize(("frequency", "height"), [(0.25, 1.0), (1.0, 0.5), (3.0, 0.0)])
def test_a_wave_keeps_its_share(frequency: float, height: float) -> None:
    t = np.linspace(0.0, 20.0, 401)
    wave = np.sin(2.0 * np.pi * frequency * t)[:, None]
    smooth = low_pass(t, wave + 7.0, 1.0, 0.05)(t)[:, 0] - 7.0
    inner = slice(100, 300)
    share = float(smooth[inner] @ wave[inner, 0] / (wave[inner, 0] @ wave[inner, 0]))
    assert share == pytest.approx(height, abs=0.02)


def test_parabolas_pass_unchanged_also_over_a_hole() -> None:
    t = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 200))
    t = t[(t < 4.0) | (t > 6.5)]
    values = np.stack([3.0 - 2.0 * t + 0.5 * t**2, 1e4 + t], axis=-1)
    spline = low_pass(t, values, 1.0, 0.05)
    at = np.linspace(t[0], t[-1], 300)
    expected = np.stack([3.0 - 2.0 * at + 0.5 * at**2, 1e4 + at], axis=-1)
    np.testing.assert_allclose(spline(at), expected, atol=1e-5)
    np.testing.assert_allclose(spline(at, nu=2), np.tile([1.0, 0.0], (300, 1)), atol=1e-3)
