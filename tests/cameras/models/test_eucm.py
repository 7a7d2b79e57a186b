"""The enhanced unified model: known values, and the end of its field of view."""

import numpy as np
import pytest

from ovmot.cameras.models import CAMERA_MODELS

EUCM, OMNI = CAMERA_MODELS["eucm"], CAMERA_MODELS["omni"]


def test_with_beta_one_it_is_the_unified_model() -> None:
    """alpha = xi / (1 + xi), and the image is larger by 1 + xi (Khomutenko et al., sec. II)."""
    xi, xy = 0.7, np.random.default_rng(1).uniform(-3.0, 3.0, (30, 2))
    unified = (1.0 + xi) * OMNI.distort(xy, np.array([xi]))
    ours = EUCM.distort(xy, np.array([xi / (1.0 + xi), 1.0]))
    np.testing.assert_allclose(ours, unified, rtol=1e-13)


@pytest.mark.parametrize("alpha", [0.3, 0.5, 0.7])
def test_no_ray_at_a_right_angle_or_past_it(alpha: float) -> None:
    beta, angle = 1.2, np.radians([89.9, 90.0, 93.0])
    x, z = np.sin(angle), np.cos(angle)
    seen = x / (alpha * np.sqrt(beta * x * x + z * z) + (1.0 - alpha) * z)
    found = EUCM.undistort(np.column_stack([np.zeros(3), seen]), np.array([alpha, beta]))
    assert found[0, 1] == pytest.approx(np.tan(angle[0]), rel=1e-9)
    assert np.all(np.isnan(found[1:]))


def test_no_ray_past_the_largest_radius() -> None:
    alpha, beta = 0.7, 1.2
    largest = 1.0 / np.sqrt(beta * (2.0 * alpha - 1.0))
    beyond = np.array([1.001 * largest, 0.0])
    assert np.all(np.isnan(EUCM.undistort(beyond, np.array([alpha, beta]))))
