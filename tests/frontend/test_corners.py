"""New corners: on corners, apart from each other and from what is there, evenly spread."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.frontend.corners import (
    Spread,
    even_spread,
    fine_cell_px,
    focus_areas,
    focus_mask,
    new_corners,
)
from ovmot.frontend.fast_kernel import fast_corners_compiled
from ovmot.frontend.spread_kernel import spread_corners
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.settings import TrackerSettings
from ovmot.types import PointLabel, ScenePoints

MOST_IN_A_CELL = 5
BORDER_PX = 8
SPREAD = Spread(distance_px=10.0, cell_px=64, per_cell=MOST_IN_A_CELL)
SETTINGS = TrackerSettings(max_features=40, focus_features=60, fine_columns=8)
NOTHING: FloatArray = np.empty((0, 2))


@pytest.fixture(scope="module")
def dots() -> Image:
    """Bright 7 px squares everywhere: dense and strong at the left, sparse and faint right."""
    rng = np.random.default_rng(4)
    image = np.full((256, 512), 60, dtype=np.uint8)
    for half, count, grey in ((0, 350, 220), (256, 120, 110)):
        for u, v in rng.integers((half + 6, 6), (half + 244, 244), (count, 2)):
            image[v : v + 7, u : u + 7] = grey
    # a little noise: FAST drops both of two neighbours that answer alike
    return image + rng.integers(0, 6, image.shape).astype(np.uint8)


def detect(image: Image, existing: FloatArray, n_wanted: int) -> FloatArray:
    """New corners (M, 2) of an image."""
    everywhere, (height, width) = np.full_like(image, 255), image.shape
    corners = fast_corners_compiled(image, everywhere, 15, BORDER_PX)
    chosen = spread_corners(
        corners, existing, n_wanted, SPREAD.distance_px, SPREAD.cell_px, SPREAD.per_cell,
        width, height,
    )  # fmt: skip
    return np.asarray(corners[chosen])


def nearest(points: FloatArray, others: FloatArray) -> FloatArray:
    """Distance (N,) from each of `points` (N, 2) to the nearest of `others`, itself apart."""
    apart = np.linalg.norm(points[:, None] - others[None], axis=-1)
    return np.asarray(np.where(apart > 0.0, apart, np.inf).min(axis=1))


def test_a_corner_is_found_at_each_dot_and_nowhere_else() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(48, 53, (128, 128)).astype(np.uint8)
    dots = np.array([[20, 20], [70, 30], [40, 60], [100, 70], [30, 105], [90, 110]])
    for u, v in dots:
        image[v - 3 : v + 4, u - 3 : u + 4] += 150
    found = detect(image, NOTHING, 50)
    assert nearest(dots + 0.1, found).max() <= 6.0
    assert nearest(found, dots + 0.1).max() <= 6.0


def test_corners_keep_apart(dots: Image) -> None:
    found = detect(dots, NOTHING, 500)
    assert len(found) > 40
    assert nearest(found, found).min() >= 10.0


def test_an_even_spread_gives_a_cell_twice_its_share() -> None:
    # 9x5 cells of 60 px
    assert even_spread(90, 20, (256, 512)) == Spread(12.0, 60, 4)


def test_all_lengths_scale_with_the_image() -> None:
    small, large = (256, 512), (512, 1024)
    one, two = (fine_cell_px(shape, SETTINGS) for shape in (small, large))
    assert (one, two) == (64, 128)
    a, b = even_spread(90, one, small), even_spread(90, two, large)
    assert (b.distance_px, b.cell_px, b.per_cell) == (2 * a.distance_px, 2 * a.cell_px, a.per_cell)


def test_no_cell_gets_more_than_it_may_hold(dots: Image) -> None:
    found = detect(dots, NOTHING, 500)
    count = np.zeros((4, 8), dtype=int)
    np.add.at(count, ((found[:, 1] // 64).astype(int), (found[:, 0] // 64).astype(int)), 1)
    assert count.max() == MOST_IN_A_CELL
    # the faint half gets as many as the strong one, though FAST answers less there
    assert count[:, 4:].sum() > 0.8 * count[:, :4].sum()


def test_no_more_than_wanted_the_strongest_first(dots: Image) -> None:
    assert len(detect(dots, NOTHING, 7)) == 7
    assert (detect(dots, NOTHING, 7)[:, 0] < 256).all()
    assert detect(dots, NOTHING, 0).shape == (0, 2)
    assert detect(dots, NOTHING, -3).shape == (0, 2)


def test_existing_points_are_left_room(dots: Image) -> None:
    existing = detect(dots, NOTHING, 25) + 0.4
    added = detect(dots, existing, 500)
    assert len(added) > 10
    assert nearest(added, existing).min() >= 10.0
    both = np.concatenate([existing, added])
    count = np.zeros((4, 8), dtype=int)
    np.add.at(count, ((both[:, 1] // 64).astype(int), (both[:, 0] // 64).astype(int)), 1)
    assert count.max() <= MOST_IN_A_CELL


def test_a_full_cell_gets_none(dots: Image) -> None:
    full = np.array([[10.0, 10.0], [10.0, 30.0], [10.0, 50.0], [30.0, 10.0], [50.0, 10.0]])
    assert len(full) == MOST_IN_A_CELL
    assert np.any((detect(dots, full[:4], 500) < 64).all(1))
    added = detect(dots, full, 500)
    assert not np.any((added < 64).all(1))


def test_a_blank_image_has_no_corners() -> None:
    blank = np.full((128, 128), 90, dtype=np.uint8)
    assert detect(blank, NOTHING, 50).shape == (0, 2)


def test_corners_at_the_border_are_not_taken(dots: Image) -> None:
    edge = np.full((128, 128), 50, dtype=np.uint8)
    edge[:5, :5] = 200
    assert len(detect(edge, NOTHING, 50)) == 0
    found = detect(dots, NOTHING, 500)
    assert found.min() >= BORDER_PX
    assert found[:, 0].max() < 504.0
    assert found[:, 1].max() < 248.0


def test_the_mask_holds_small_circles_alone() -> None:
    assert focus_mask((240, 320), np.empty((0, 2)), np.empty(0), 20) is None
    places = np.array([[100.0, 50.0], [200.0, 150.0]])
    mask = focus_mask((240, 320), places, np.array([20.0, 99.0]), 20)
    assert mask is not None
    assert mask[50, 115] > 0 and mask[50, 125] == 0
    assert mask[150, 200] == 0  # what is near has features enough
    assert focus_mask((240, 320), np.array([[9.0, 9.0]]), np.array([80.0]), 20) is None


def test_every_fine_cell_gets_a_corner_though_there_are_enough(dots: Image) -> None:
    found = new_corners(dots, None, NOTHING, np.zeros(len(NOTHING), np.bool_), None, SETTINGS)
    cell = set(map(tuple, (found // 64).astype(int).tolist()))
    assert len(found) > SETTINGS.max_features
    assert len(cell) >= 30  # of 8 columns of 64 px and 4 rows; they keep apart across cells too
    again = new_corners(dots, None, found, np.zeros(len(found), np.bool_), None, SETTINGS)
    assert len(again) == 0


def test_corners_are_denser_where_the_focus_is_and_none_where_the_mask_is(dots: Image) -> None:
    focus, mask = np.zeros_like(dots), np.zeros_like(dots)
    focus[64:192, 64:192] = 255
    mask[:, 256:] = 1
    even = new_corners(dots, None, NOTHING, np.zeros(len(NOTHING), np.bool_), None, SETTINGS)
    dense = new_corners(dots, mask, NOTHING, np.zeros(len(NOTHING), np.bool_), focus, SETTINGS)
    inside = [int(((c > 64) & (c < 192)).all(axis=1).sum()) for c in (even, dense)]
    assert 2 * inside[0] < inside[1] <= SETTINGS.focus_features
    assert dense[:, 0].max() < 256
    assert nearest(dense, dense).min() >= 4.0


def test_more_features_are_wanted_around_what_moves_or_may() -> None:
    """Half of the width at the depth of each; a static point and one without depth have none. Also
    where a body may come into sight, if that is in the image."""
    camera = Camera.make((640, 480), (400.0, 400.0), (320.0, 240.0))
    n = 5
    p = np.column_stack([np.zeros(n), np.zeros(n), [10.0, 20.0, 5.0, np.nan, 8.0]])
    label = np.full(n, int(PointLabel.STATIC))
    label[[0, 3]] = int(PointLabel.DYNAMIC)
    pixels = np.arange(4.0 * n).reshape(n, 4)
    none = np.full((n, 2), np.nan)
    points = ScenePoints(
        np.arange(n), pixels, p, np.zeros((n, 3, 3)), label, np.array([-1, 4, -1, -1, -1]),
        none, none, none[:, 0], none[:, 0], np.ones(n, dtype=np.bool_),
    )  # fmt: skip
    places = np.array([[1.0, 0.5, 20.0], [30.0, 0.0, 20.0], [0.0, 0.0, -5.0]])
    uv, radius = focus_areas(points, np.arange(n) == 4, places, camera)
    np.testing.assert_array_equal(uv[:3], pixels[[0, 1, 4], :2])
    np.testing.assert_allclose(uv[3:], [[340.0, 250.0]])
    np.testing.assert_allclose(radius, [52.0, 26.0, 65.0, 26.0])


def test_full_cells_are_left_out_before_corners_are_sought(dots: Image) -> None:
    """With the budget spent, new corners are those in cells without a feature, and in the focus."""
    settings = SETTINGS.model_copy(update={"max_features": 20})
    first = new_corners(dots, None, NOTHING, np.zeros(len(NOTHING), np.bool_), None, settings)
    existing = first[first[:, 0] < 256]
    assert len(existing) >= settings.max_features
    focus = np.zeros(dots.shape, dtype=np.uint8)
    focus[64:128, 64:128] = 255
    added = new_corners(dots, None, existing, np.zeros(len(existing), np.bool_), None, settings)
    also = new_corners(dots, None, existing, np.zeros(len(existing), np.bool_), focus, settings)
    cell = 64

    def cells(uv: FloatArray) -> set[tuple[int, int]]:
        return {(int(u) // cell, int(v) // cell) for u, v in uv}

    assert len(added) > 0
    assert not cells(added) & cells(existing)
    in_focus = (also[:, 0] // cell == 1) & (also[:, 1] // cell == 1)
    assert in_focus.sum() > 0
    assert not cells(also[~in_focus]) & cells(existing)


def test_dynamic_features_are_not_counted(dots: Image) -> None:
    """As many static features as are asked for, however many move."""
    settings = SETTINGS.model_copy(update={"fine_features": 0})
    first = new_corners(dots, None, NOTHING, np.zeros(0, np.bool_), None, settings)
    none_moves = np.zeros(len(first), np.bool_)
    assert len(new_corners(dots, None, first, none_moves, None, settings)) == 0
    third = np.arange(len(first)) % 3 == 0
    added = len(new_corners(dots, None, first, third, None, settings))
    assert 0.5 * third.sum() < added <= third.sum()
