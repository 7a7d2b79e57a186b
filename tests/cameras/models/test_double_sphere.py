"""The double sphere model: known values, its valid region, and the end of its field of view."""

import numpy as np
import pytest

from ovmot.cameras.models import CAMERA_MODELS

DS, OMNI = CAMERA_MODELS["ds"], CAMERA_MODELS["omni"]


def test_with_xi_zero_it_is_the_unified_model() -> None:
    """Of Usenko et al.: alpha = xi_omni / (1 + xi_omni), the image larger by 1 + xi_omni."""
    xi, xy = 0.7, np.random.default_rng(1).uniform(-3.0, 3.0, (30, 2))
    unified = (1.0 + xi) * OMNI.distort(xy, np.array([xi]))
    ours = DS.distort(xy, np.array([0.0, xi / (1.0 + xi)]))
    np.testing.assert_allclose(ours, unified, rtol=1e-13)


@pytest.mark.parametrize(("xi", "alpha"), [(-0.2, 0.6), (0.3, 0.4), (0.5, 0.7)])
def test_no_ray_at_a_right_angle_or_past_it(xi: float, alpha: float) -> None:
    angle = np.radians([89.9, 90.0, 93.0])
    x, z = np.sin(angle), np.cos(angle)
    seen = x / (alpha * np.hypot(x, xi + z) + (1.0 - alpha) * (xi + z))
    found = DS.undistort(np.column_stack([seen, np.zeros(3)]), np.array([xi, alpha]))
    assert found[0, 0] == pytest.approx(np.tan(angle[0]), rel=1e-9)
    assert np.all(np.isnan(found[1:]))


@pytest.mark.parametrize(("xi", "alpha"), [(-0.9, 0.1), (-0.9, 0.8), (-0.5, 0.05), (0.3, 0.2)])
def test_points_have_an_image_so_far_as_it_grows_with_the_angle(xi: float, alpha: float) -> None:
    angle = np.linspace(0.001, 1.57, 2000)
    x, z = np.sin(angle), np.cos(angle)
    D = alpha * np.hypot(x, xi + z) + (1.0 - alpha) * (xi + z)
    grows = (D[1:] > 0.0) & (np.diff(x / D) > 0.0)
    end = 1 + (len(grows) if grows.all() else int(np.argmin(grows)))
    xy, coefficients = np.column_stack([x / z, np.zeros(len(x))]), np.array([xi, alpha])
    seen = DS.distort(xy, coefficients)
    assert np.all(np.isfinite(seen[: end - 1]))
    assert np.all(np.isnan(seen[end + 1 :]))
    back = DS.undistort(seen[: end - 1], coefficients)
    np.testing.assert_allclose(back, xy[: end - 1], rtol=1e-6)
