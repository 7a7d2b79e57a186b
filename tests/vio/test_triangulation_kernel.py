"""The compiled triangulation against the plain one, `geometry.triangulation`."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import MAX_DEPTH_M, project_normalized, triangulate_many_views
from ovmot.vio.triangulation_kernel import triangulate_views_compiled

SIGMA = 1e-3
RANGE = (0.1, 40.0)


@pytest.fixture
def views() -> FloatArray:
    """T_view_world (12, 4, 4) of cameras some metres apart, turned a little."""
    rng = np.random.default_rng(1)
    return se3.make(so3.exp(rng.normal(0.0, 0.05, (12, 3))), rng.normal(0.0, 1.0, (12, 3)))


def seen_from(views: FloatArray, rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray]:
    """World points (n, 3), near, far and beyond the range, and their noisy views (n, 12, 2)."""
    points = np.column_stack([rng.uniform(-4.0, 4.0, (n, 2)), rng.uniform(3.0, 80.0, n)])
    xy, _ = project_normalized(se3.apply(views[None], points[:, None]))
    return points, xy + SIGMA * rng.normal(size=xy.shape)


def test_points_are_those_of_the_plain_triangulation(views: FloatArray) -> None:
    rng = np.random.default_rng(2)
    _, xy = seen_from(views, rng, 60)
    xy[rng.random(xy.shape[:2]) < 0.4] = np.nan
    xy[0] = np.nan  # seen by none
    xy[1, 1:] = np.nan  # by one view
    xy[2] += 0.05 * rng.normal(size=xy[2].shape)  # no point fits
    xy[3, ::2] *= -1.0
    limits = np.array([*RANGE, MAX_DEPTH_M])
    points, valid = triangulate_views_compiled(xy, views, SIGMA, limits)
    plain = triangulate_many_views(xy, views, SIGMA, depth_range=RANGE)
    np.testing.assert_array_equal(valid, plain.valid)
    assert 20 < valid.sum() < 57
    assert not valid[:4].any()
    np.testing.assert_allclose(points[valid], plain.p_world[valid], rtol=1e-6, atol=1e-6)
