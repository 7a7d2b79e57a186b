"""The overlay of static and dynamic points."""

from dataclasses import replace

import numpy as np
from overlay_checks import Maker, color_at, has_color, has_words, images_of, text_area

from ovmot.outputs import palette
from ovmot.outputs.dynamic_overlay import draw_dynamic
from ovmot.outputs.lettering import font_size, place_words, word_size
from ovmot.types import PointLabel


def test_dynamic_point_shows_three_positions_and_green_text(make_result: Maker) -> None:
    result = make_result(0)
    image = draw_dynamic(images_of(result), result.points, 0.0)
    assert image.shape == (160, 240, 3)
    assert color_at(image, 40, 70) == palette.WHITE
    assert color_at(image, 60, 60) == palette.RED
    assert color_at(image, 70, 75) == palette.PINK
    assert color_at(image, 50, 65) != color_at(image, 5, 155)  # the thin line
    assert has_words(text_area(image, 60, 60), palette.GREEN)
    assert not has_words(text_area(image, 60, 60), palette.RED)


def test_static_point_that_ransac_rejected_has_red_text(make_result: Maker) -> None:
    result = make_result(0)
    image = draw_dynamic(images_of(result), result.points, 0.0)
    assert color_at(image, 40, 130) == palette.WHITE
    assert color_at(image, 60, 120) == palette.RED
    assert color_at(image, 66, 130) == palette.PINK
    assert has_words(text_area(image, 60, 120), palette.RED)
    assert not has_words(text_area(image, 60, 120), palette.GREEN)


def test_other_points_are_quiet_dots(make_result: Maker) -> None:
    result = make_result(0)
    image = draw_dynamic(images_of(result), result.points, 0.0)
    assert color_at(image, 180, 60) == palette.GREY
    assert color_at(image, 180, 120) == palette.DARK
    plain = np.array(color_at(image, 5, 155))
    assert np.all(text_area(image, 180, 60) == plain)
    assert np.all(text_area(image, 180, 120) == plain)


def test_static_point_that_was_never_compared_stays_quiet(make_result: Maker) -> None:
    points = make_result(0).points
    nowhere = np.full_like(points.predicted, np.nan)
    label = np.full_like(points.label, PointLabel.STATIC)
    image = draw_dynamic(
        images_of(make_result(0)),
        replace(points, label=label, previous=nowhere, predicted=nowhere),
        0.0,
    )
    assert color_at(image, 60, 120) == palette.GREY
    assert not has_color(image[20:], palette.RED)


def test_numbers_of_a_crowd_do_not_cover_each_other(make_result: Maker) -> None:
    """86 dynamic points on two bodies: what is written can be read, the rest is counted."""
    rng = np.random.default_rng(0)
    middle = np.where(np.arange(86)[:, None] % 2, [400.0, 200.0], [900.0, 250.0])
    at = middle + rng.normal(0.0, 20.0, (86, 2))
    words = [f"{0.01 * i:.2f}m {0.1 * i:.1f}px" for i in range(86)]
    size = font_size(1280)
    sizes = np.array([word_size(word, size) for word in words], dtype=np.float64)
    corners = place_words(at, sizes, (1280, 560), np.empty((0, 4)))
    placed = np.isfinite(corners[:, 0])
    assert np.count_nonzero(placed) > 60
    low, high = corners[placed], (corners + sizes)[placed]
    apart = np.any((low[:, None] >= high[None]) | (high[:, None] <= low[None]), axis=2)
    assert np.all(apart | np.eye(len(low), dtype=bool))
    assert np.all(low >= 0.0)
    assert np.all(high <= [1280.0, 560.0])
