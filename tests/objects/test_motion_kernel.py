"""The compiled search for moving points equals its plain NumPy twin."""

from collections.abc import Callable

import numpy as np
import pytest
from static_twin import compare_with_static, fit_velocity, widened

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import IntArray
from ovmot.objects.motion_kernel import (
    MovingPoints,
    moving_points,
    moving_points_compiled,
    points_to_look_at,
    points_to_look_at_compiled,
)
from ovmot.segmentation.static_comparison import ego_motion_since, pairs_of, stereo_noise
from ovmot.types import PoseWindow

ACCEL, MOVES = 1.5, 0.3
Case = tuple[StereoHistory, PoseWindow]


@pytest.mark.parametrize("search", [points_to_look_at, points_to_look_at_compiled])
def test_points_to_look_at_are_far_from_rest_or_not_static(
    rig: StereoRig, compared_case: Case, search: Callable[..., tuple[IntArray, IntArray]]
) -> None:
    history, window = compared_case
    ego = ego_motion_since(history, window, rig)
    seems_static = np.arange(30) % 10 != 0
    index, known = search(
        pairs_of(history), history.cov_now, ego.T_now_then, seems_static, 35.0, 4.0
    )
    predicted = se3.apply(ego.T_now_then[:, None], history.p_then)
    variance = 2.0 * np.diagonal(history.cov_now, axis1=1, axis2=2)
    squared = ((predicted - history.p_now) ** 2 / variance).sum(-1)
    oldest = np.where(np.isfinite(squared[0]), squared[0], squared[1])
    with np.errstate(invalid="ignore"):
        expected = (history.p_now[:, 2] < 35.0) & ((oldest > 4.0) | ~seems_static)
    assert index.tolist() == np.flatnonzero(expected).tolist()
    assert 3 in index and 5 not in index
    assert (oldest[index] <= 4.0).any()
    np.testing.assert_array_equal(known, np.isfinite(history.p_then[:, index, 2]).sum(0))


@pytest.mark.parametrize("search", [moving_points, moving_points_compiled])
def test_moving_points_have_the_velocity_of_the_twin(
    rig: StereoRig, compared_case: Case, search: Callable[..., MovingPoints]
) -> None:
    """A point that no velocity explains moves by its last rows, where it is a track's."""
    history, window = compared_case
    c = compare_with_static(history, window, rig)
    candidate = np.setdiff1d(np.arange(30), [5, 8])
    has_track, n_old = candidate % 3 == 0, 1
    bound = np.array([0.0, 2.0, 8.0, 2.0])
    found = search(
        pairs_of(history), ego_motion_since(history, window, rig),
        stereo_noise(history, history.noise.sigma_px, rig),
        candidate, has_track, n_old, ACCEL, bound, MOVES,
    )  # fmt: skip
    S = widened(c.S_motion, c.J_motion, 0.5 * ACCEL * c.span_s**2)
    index: list[int] = []
    shortened = 0
    for point, of_track in zip(candidate, has_track, strict=True):
        for first in (0, n_old) if of_track else (0,):
            tested = c.tested & (np.arange(3) >= first)[:, None]
            v, C, cost = fit_velocity(c, S, tested, int(point))
            if cost < bound[tested[:, point].sum()]:
                break
        else:
            continue
        if v @ np.linalg.solve(C, v) <= MOVES:
            continue
        k, rows = len(index), tested[:, point]
        index.append(int(point))
        shortened += first == n_old
        np.testing.assert_allclose(found.velocity[k], v, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.velocity_cov[k], C, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(found.predicted[:, k], c.predicted[:, point], rtol=1e-9)
        W, J = np.linalg.inv(c.S_motion[rows, point]), c.J_motion[rows, point]
        np.testing.assert_allclose(found.weight[rows, k], W, rtol=1e-6, atol=1e-9 * W.max())
        information = np.swapaxes(J, -1, -2) @ W @ J
        np.testing.assert_allclose(found.information[rows, k], information, rtol=1e-6, atol=1e-6)
        assert not found.weight[~rows, k].any() and not found.information[~rows, k].any()
    assert found.point.tolist() == index
    assert len(index) > 6 and shortened > 0
