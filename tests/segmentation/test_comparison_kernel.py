"""The compiled comparison with rest equals its plain NumPy twin."""

from collections.abc import Callable

import numpy as np
import pytest
from static_twin import (
    StaticComparison,
    compare_with_static,
    fit_velocity,
    squared_distances,
    widened,
)

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import project_stereo
from ovmot.segmentation.comparison_kernel import (
    Rest,
    compare_with_rest,
    compare_with_rest_compiled,
)
from ovmot.segmentation.static_comparison import ego_motion_since, pairs_of, stereo_noise
from ovmot.types import PoseWindow

MAX_RANGE_M, FORGIVEN, ACCEL, FIT_BEYOND, DEPTH_WEIGHT = 32.0, 0.15, 1.5, 1.0, 0.3
Case = tuple[StereoHistory, PoseWindow]


@pytest.fixture(params=[compare_with_rest, compare_with_rest_compiled])
def found_and_twin(
    request: pytest.FixtureRequest, rig: StereoRig, compared_case: Case
) -> tuple[Rest, StaticComparison]:
    history, window = compared_case
    kernel: Callable[..., Rest] = request.param
    found = kernel(
        pairs_of(history), ego_motion_since(history, window, rig),
        stereo_noise(history, history.noise.sigma_px, rig),
        MAX_RANGE_M, FORGIVEN, ACCEL, FIT_BEYOND, DEPTH_WEIGHT, focal(rig),
    )  # fmt: skip
    return found, compare_with_static(history, window, rig)


def focal(rig: StereoRig) -> FloatArray:
    return np.array([rig.cam0.fx, rig.cam0.fy, rig.cam1.fx, rig.cam1.fy])


def test_the_distances_from_rest(
    found_and_twin: tuple[Rest, StaticComparison], compared_case: Case
) -> None:
    found, c = found_and_twin
    with np.errstate(invalid="ignore"):
        near = (compared_case[0].p_now[:, 2] < MAX_RANGE_M) & (c.predicted[..., 2] < MAX_RANGE_M)
    tested = c.tested & near
    S = widened(c.S, c.J, FORGIVEN * c.span_s)
    distance = np.where(tested, squared_distances(S, c.residual), 0.0).max(0)
    np.testing.assert_array_equal(found.rows, tested.sum(0))
    np.testing.assert_array_equal(found.in_last, tested[-1])
    far = distance >= FIT_BEYOND
    np.testing.assert_allclose(found.distance[far], distance[far], rtol=1e-6)
    assert (found.distance[~far] < FIT_BEYOND).all()  # not computed where the noise explains it
    assert 0 < tested.sum() < c.tested.sum()


def test_velocities_are_those_of_weighted_least_squares(
    found_and_twin: tuple[Rest, StaticComparison],
) -> None:
    found, c = found_and_twin
    fitted = (found.rows > 0) & (found.distance >= FIT_BEYOND)
    assert 5 < fitted.sum() < (found.rows > 0).sum()
    np.testing.assert_array_equal(np.isfinite(found.cost), fitted)
    with np.errstate(invalid="ignore"):
        tested = c.tested & (c.predicted[..., 2] < MAX_RANGE_M)
    S = widened(c.S, c.J, 0.5 * ACCEL * c.span_s**2)
    for n in np.flatnonzero(fitted).tolist():
        v, C, cost = fit_velocity(c, S, tested, n)
        np.testing.assert_allclose(found.velocity[n], v, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.covariance[n], C, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(found.cost[n], cost, rtol=1e-6, atol=1e-6)


def test_the_last_interval(
    found_and_twin: tuple[Rest, StaticComparison], compared_case: Case, rig: StereoRig
) -> None:
    found, c = found_and_twin
    history = compared_case[0]
    with np.errstate(invalid="ignore"):
        near = history.p_now[:, 2:] < MAX_RANGE_M
    p = np.where(near, c.predicted[-1], np.nan)
    np.testing.assert_allclose(found.predicted, p, rtol=1e-10)
    way = (history.p_now - p) * [1.0, 1.0, DEPTH_WEIGHT]
    np.testing.assert_allclose(found.distance_m, np.linalg.norm(way, axis=1), rtol=1e-7)
    off = (history.now - project_stereo(p, rig.T_cam1_cam0)[0]) * focal(rig)
    worse = np.maximum(np.hypot(off[:, 0], off[:, 1]), np.hypot(off[:, 2], off[:, 3]))
    np.testing.assert_allclose(found.reprojection, worse, rtol=1e-7)
