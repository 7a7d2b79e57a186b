"""The rig's own body: what stands in the picture while the world moves is kept out."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory, append_frame, empty_table
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.segmentation.rig_body import (
    RigBody,
    counted,
    no_rig_body,
    standing_features,
    without_rig_body,
)
from ovmot.segmentation.rig_body_kernel import count_in_cells_compiled, find_standing_compiled
from ovmot.segmentation.segmentation import Segmentation
from ovmot.segmentation.stereo_history import stereo_history
from ovmot.types import FrontendFrame, PixelNoise, PointLabel, PoseWindow, ScenePoints

Make = Callable[..., Any]
NOISE = PixelNoise(0.4, 0.4, 0.15, 0.01)
N_RIG, N_REST, N_AHEAD = 30, 60, 20


@pytest.fixture
def scene(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Make
) -> tuple[StereoHistory, PoseWindow, FloatArray]:
    """A drive at 6 m/s: first points on the rig, 1.2 m ahead and lower, then on a car 12 m ahead
    that keeps its distance, then of the world. The history, the window and the pixels of now."""
    T, rng = drive(12, 6.0), np.random.default_rng(0)
    bonnet = np.column_stack(
        [rng.uniform(-0.3, 0.3, N_RIG), rng.uniform(0.2, 0.5, N_RIG), np.full(N_RIG, 1.2)]
    )
    ahead = np.column_stack([rng.uniform(-0.8, 0.8, (N_AHEAD, 2)), np.full(N_AHEAD, 12.0)])
    carried = se3.apply((T @ rig.T_imu_cam0)[:, None], np.concatenate([bonnet, ahead])[None])
    rest = np.repeat(in_view(rig, T, N_REST, (5.0, 25.0), rng)[None], len(T), axis=0)
    normalized = measure(rig, T, np.concatenate([carried, rest], axis=1), 0.3, rng)
    pixels = np.concatenate(
        [rig.cam0.denormalize(normalized[..., :2]), rig.cam1.denormalize(normalized[..., 2:])], -1
    )
    window, table, ids = window_of(T), empty_table(), np.arange(normalized.shape[1])
    for k, stamp in enumerate(window.timestamp_ns.tolist()):
        seen = FrontendFrame(stamp, ids, pixels[k], normalized[k], np.full(len(ids), k), ids >= 0)
        table = append_frame(table, seen)
    history = stereo_history(table, ids, window.timestamp_ns, rig, (1.0, 0.5, 0.2), NOISE)
    return history, window, pixels[-1]


def on_rig(n: int) -> BoolArray:
    return np.arange(n) < N_RIG


def test_the_bonnet_stands_and_the_world_moves(
    scene: tuple[StereoHistory, PoseWindow, FloatArray], rig: StereoRig
) -> None:
    history, window, pixels = scene
    stands, moves = standing_features(history, window, rig)
    seen = np.isfinite(pixels[:, 2])
    assert stands[on_rig(len(pixels)) & seen].mean() > 0.9
    assert not stands[~on_rig(len(pixels))].any()  # neither the world nor the car ahead
    assert not moves[on_rig(len(pixels))].any()
    assert moves[N_RIG + N_AHEAD :].mean() > 0.7


def test_cells_are_the_rigs_after_they_stood_for_long(
    scene: tuple[StereoHistory, PoseWindow, FloatArray], rig: StereoRig
) -> None:
    history, window, pixels = scene
    stands, moves = standing_features(history, window, rig)
    body = no_rig_body(rig)
    assert body.mask(0, rig.cam0) is None
    for _ in range(30):
        body = counted(body, stands, moves, pixels, rig)
    shown = body.shows(pixels, rig)
    assert shown[on_rig(len(pixels)) & stands].mean() > 0.8
    mask = body.mask(0, rig.cam0)
    assert mask is not None and mask.shape == (rig.cam0.height, rig.cam0.width)
    in_picture = pixels[:, 1] < rig.cam0.height - 1
    u, v = pixels[on_rig(len(pixels)) & stands & in_picture, :2].astype(int).T
    assert (mask[v, u] == 255).mean() > 0.8
    assert mask[: rig.cam0.height // 4].max() == 0  # the sky side is free


def test_a_cell_in_which_most_features_move_is_not_the_rigs(rig: StereoRig) -> None:
    body: RigBody = no_rig_body(rig)
    pixels = np.tile([100.0, 100.0, np.nan, np.nan], (4, 1))
    one = np.array([True, False, False, False])
    for _ in range(100):
        body = counted(body, one, ~one, pixels, rig)
    assert not body.cells(0).any()


def test_what_lies_on_the_rig_is_unknown_and_an_outlier() -> None:
    n = 5
    nothing, two = np.full(n, np.nan), np.full((n, 2), np.nan)
    points = ScenePoints(
        np.arange(n), np.zeros((n, 4)), np.ones((n, 3)), np.ones((n, 3, 3)),
        np.full(n, int(PointLabel.DYNAMIC)), np.full(n, -1), two, two, nothing, nothing,
        np.ones(n, dtype=np.bool_),
    )  # fmt: skip
    split = Segmentation(points, np.zeros(n, dtype=np.bool_), trusted=True)
    where = np.arange(n) < 2
    kept = without_rig_body(split, where)
    assert (kept.points.label == int(PointLabel.UNKNOWN)).tolist() == where.tolist()
    assert kept.outlier.tolist() == where.tolist()
    assert without_rig_body(split, np.zeros(n, dtype=np.bool_)) is split


def test_the_kernel_is_its_plain_twin(rig: StereoRig) -> None:
    rng = np.random.default_rng(3)
    n_rows, n = 4, 200
    then = rng.uniform(-0.5, 0.5, (n_rows, n, 4))
    then[rng.random((n_rows, n)) < 0.3] = np.nan
    p_then = np.concatenate([then[..., :2], np.ones((n_rows, n, 1))], axis=-1)
    p_then *= rng.uniform(0.5, 6.0, (n_rows, n, 1))
    p_then[rng.random((n_rows, n)) < 0.3] = np.nan
    now = rng.uniform(-0.5, 0.5, (n, 4))
    now[: n // 2] = then[0, : n // 2] + rng.normal(0.0, 0.002, (n // 2, 4))
    T = np.tile(np.eye(4), (n_rows, 1, 1))
    T[:, :3, 3] = rng.uniform(-0.6, 0.6, (n_rows, 3))
    sigma_px = np.array([1.0, 0.8, 0.7, 0.6])
    stands, moves = find_standing_compiled(then, p_then, now, T, sigma_px, 400.0, 3.0)
    open_ = np.ones(n, dtype=np.bool_)
    wanted_stands, wanted_moves = np.zeros((2, n), dtype=np.bool_)
    with np.errstate(invalid="ignore", divide="ignore"):
        for k in range(n_rows):
            seen = open_ & np.isfinite(then[k, :, 0])
            way = 400.0 * np.linalg.norm(now[:, :2] - then[k, :, :2], axis=1)
            unknown, far = np.isnan(p_then[k, :, 2]), p_then[k, :, 2] >= 3.0
            ray = np.concatenate([then[k, :, :2], np.ones((n, 1))], axis=1)
            moved = np.where(unknown[:, None], ray @ T[k, :3, :3].T, se3.apply(T[k], p_then[k]))
            off = 400.0 * np.linalg.norm(moved[:, :2] / moved[:, 2:] - then[k, :, :2], axis=1)
            off = np.where(far, np.nan, np.where(moved[:, 2] > 0.0, off, np.inf))
            wanted_stands |= seen & (off > 10.0 * sigma_px[k]) & (way < 3.0 * sigma_px[k])
            wanted_moves |= seen & (way > 6.0 * sigma_px[k])
            open_ &= ~seen
    assert 5 < stands.sum() < n and 5 < moves.sum() < n
    np.testing.assert_array_equal(stands, wanted_stands)
    np.testing.assert_array_equal(moves, wanted_moves)


@pytest.mark.parametrize("side", [0, 1])
def test_features_are_counted_in_their_cells(side: int) -> None:
    """By the kernel as by NumPy; those beyond the picture or unseen are not."""
    rng = np.random.default_rng(7)
    stereo = rng.uniform(-20.0, 120.0, (200, 4))
    stereo[::9] = np.nan
    pixels = stereo[:, 2 * side : 2 * side + 2]
    stands, moves = rng.uniform(size=(2, 200)) < 0.4
    before = rng.integers(0, 9, (2, 8, 10))
    after = count_in_cells_compiled(stereo, side, stands, moves, 10, 100, 75, before[0], before[1])
    inside = (pixels >= 0.0).all(axis=1) & (pixels < [100.0, 75.0]).all(axis=1)
    for k, which in enumerate((stands, moves)):
        expected = before[k].copy()
        column, row = (pixels[inside & which] // 10).astype(np.int64).T
        np.add.at(expected, (row, column), 1)
        np.testing.assert_array_equal(after[k], expected)
    assert (before != after[0]).any()
