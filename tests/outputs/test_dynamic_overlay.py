"""The overlay of static and dynamic points."""

from dataclasses import replace

import numpy as np
from overlay_checks import Maker, color_at, has_color, images_of, text_area

from ovmot.outputs import drawing
from ovmot.outputs.dynamic_overlay import draw_dynamic
from ovmot.types import PointLabel


def test_dynamic_point_shows_three_positions_and_green_text(make_result: Maker) -> None:
    result = make_result(0)
    image = draw_dynamic(images_of(result), result.points)
    assert image.shape == (160, 240, 3)
    assert color_at(image, 40, 70) == drawing.WHITE
    assert color_at(image, 60, 60) == drawing.RED
    assert color_at(image, 70, 75) == drawing.PINK
    assert color_at(image, 50, 65) != color_at(image, 5, 155)  # the thin line
    assert has_color(text_area(image, 60, 60), drawing.GREEN)
    assert not has_color(text_area(image, 60, 60), drawing.RED)


def test_static_point_that_ransac_rejected_has_red_text(make_result: Maker) -> None:
    result = make_result(0)
    image = draw_dynamic(images_of(result), result.points)
    assert color_at(image, 40, 130) == drawing.WHITE
    assert color_at(image, 60, 120) == drawing.RED
    assert color_at(image, 66, 130) == drawing.PINK
    assert has_color(text_area(image, 60, 120), drawing.RED)
    assert not has_color(text_area(image, 60, 120), drawing.GREEN)


def test_other_points_are_quiet_dots(make_result: Maker) -> None:
    result = make_result(0)
    image = draw_dynamic(images_of(result), result.points)
    assert color_at(image, 180, 60) == drawing.GREY
    assert color_at(image, 180, 120) == drawing.DARK
    plain = np.array(color_at(image, 5, 155))
    assert np.all(text_area(image, 180, 60) == plain)
    assert np.all(text_area(image, 180, 120) == plain)


def test_static_point_that_was_never_compared_stays_quiet(make_result: Maker) -> None:
    points = make_result(0).points
    nowhere = np.full_like(points.predicted, np.nan)
    label = np.full_like(points.label, PointLabel.STATIC)
    image = draw_dynamic(
        images_of(make_result(0)), replace(points, label=label, previous=nowhere, predicted=nowhere)
    )
    assert color_at(image, 60, 120) == drawing.GREY
    assert not has_color(image[20:], drawing.RED)
