"""The compiled search for moving points equals its plain NumPy twin."""

from collections.abc import Callable

import numpy as np
import pytest
from static_twin import compare_with_static, fit_velocity, widened

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.objects.motion_kernel import (
    Limits,
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
    rig: StereoRig, compared_case: Case, search: Callable[..., IntArray]
) -> None:
    history, window = compared_case
    ego = ego_motion_since(history, window, rig)
    seems_static = np.arange(30) % 10 != 0
    rng = np.random.default_rng(2)
    pixels, track_id = rng.uniform(0.0, 700.0, (30, 4)), rng.integers(-1, 2, 30)

    def found(limits: Limits) -> IntArray:
        return search(
            pairs_of(history), history.cov_now, ego.T_now_then, seems_static, pixels, track_id,
            limits,
        )  # fmt: skip

    index = found(Limits(35.0, 4.0, 30, 30))
    predicted = se3.apply(ego.T_now_then[:, None], history.p_then)
    variance = 2.0 * np.diagonal(history.cov_now, axis1=1, axis2=2)
    squared = ((predicted - history.p_now) ** 2 / variance).sum(-1)
    oldest = np.where(np.isfinite(squared[0]), squared[0], squared[1])
    with np.errstate(invalid="ignore"):
        expected = (history.p_now[:, 2] < 35.0) & ((oldest > 4.0) | ~seems_static)
    assert index.tolist() == np.flatnonzero(expected).tolist()
    assert 3 in index and 5 not in index
    assert (oldest[index] <= 4.0).any()
    known = np.isfinite(history.p_then[:, index, 2]).sum(0)
    for most, per_track in ((30, 3), (9, 30), (8, 2)):
        chosen = index[chosen_points(known, pixels[index, 0], track_id[index], most, per_track)]
        assert found(Limits(35.0, 4.0, most, per_track)).tolist() == chosen.tolist()
        assert len(chosen) < len(index)


def chosen_points(
    known: IntArray, u: FloatArray, track_id: IntArray, most: int, per_track: int
) -> IntArray:
    """Of each track's points every so many-th along u, then those known in most rows, in order."""
    looked_at = np.ones(len(known), dtype=np.bool_)
    for track in range(2):
        own = np.flatnonzero((track_id == track) & (known > 1))
        if len(own) > per_track:
            looked_at[own] = False
            looked_at[own[np.argsort(u[own])][:: -(-len(own) // per_track)]] = True
    some = np.flatnonzero(looked_at)
    return np.sort(some[np.argsort(-known[some], kind="stable")[:most]])


@pytest.mark.parametrize("search", [moving_points, moving_points_compiled])
def test_moving_points_have_the_velocity_of_the_twin(
    rig: StereoRig, compared_case: Case, search: Callable[..., MovingPoints]
) -> None:
    """A point that no velocity explains moves by its last rows, where it is a track's."""
    history, window = compared_case
    c = compare_with_static(history, window, rig)
    candidate = np.setdiff1d(np.arange(30), [5, 8])
    track_id, n_old = np.where(np.arange(30) % 3 == 0, 4, -1), 1
    bound = np.array([0.0, 2.0, 8.0, 2.0])
    found = search(
        pairs_of(history), ego_motion_since(history, window, rig),
        stereo_noise(history, history.noise.sigma_px, rig),
        candidate, track_id, n_old, ACCEL, bound, MOVES,
    )  # fmt: skip
    S = widened(c.S_motion, c.J_motion, 0.5 * ACCEL * c.span_s**2)
    index: list[int] = []
    shortened = 0
    for point in candidate:
        for first in (0, n_old) if track_id[point] >= 0 else (0,):
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
        np.testing.assert_allclose(found.predicted[k], c.predicted[:, point], rtol=1e-9)
        W, J = np.linalg.inv(c.S_motion[rows, point]), c.J_motion[rows, point]
        np.testing.assert_allclose(found.weight[k, rows], W, rtol=1e-6, atol=1e-9 * W.max())
        information = np.swapaxes(J, -1, -2) @ W @ J
        np.testing.assert_allclose(found.information[k, rows], information, rtol=1e-6, atol=1e-6)
        assert not found.weight[k, ~rows].any() and not found.information[k, ~rows].any()
    assert found.point.tolist() == index
    assert len(index) > 6 and shortened > 0
