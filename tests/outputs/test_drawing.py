"""Strokes: scaled, on copies, and nothing far outside."""

from dataclasses import replace

import numpy as np
import pytest
from overlay_checks import Maker, color_at, has_color, images_of

from ovmot.cameras.rig import StereoRig
from ovmot.outputs import palette
from ovmot.outputs.dynamic_overlay import draw_dynamic
from ovmot.outputs.stereo_overlay import draw_stereo


def test_scale_enlarges_image_and_positions(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    dynamic = draw_dynamic(images_of(result), result.points, 0.0, scale=2.0)
    stereo = draw_stereo(images_of(result), result.matches, rig, 0.0, scale=2.0)
    assert dynamic.shape == (320, 480, 3)
    assert stereo.shape == (320, 960, 3)
    assert color_at(dynamic, 120, 120) == palette.RED
    assert color_at(stereo, 400, 260) == palette.RED


def test_drawing_leaves_the_input_alone(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    draw_stereo(images_of(result), result.matches, rig, 0.0)
    draw_dynamic(images_of(result), result.points, 0.0)
    assert np.all(images_of(result).left == 40)
    assert np.all(images_of(result).right == 40)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_positions_far_away_are_left_out(make_result: Maker, bad: float) -> None:
    points = make_result(0).points
    image = draw_dynamic(
        images_of(make_result(0)),
        replace(points, predicted=np.full_like(points.predicted, bad)),
        0.0,
    )
    assert color_at(image, 60, 60) == palette.RED
    assert not has_color(image[20:], palette.PINK)


def test_no_points_at_all(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    nothing = replace(
        result.matches, feature_id=np.empty(0, np.int64), pixels=np.empty((0, 4)),
        distance_px=np.empty(0), accepted=np.empty(0, np.bool_), line=np.empty((0, 3)),
    )  # fmt: skip
    image = draw_stereo(images_of(result), nothing, rig, 0.0)
    assert np.all(image[20:] == image[-1, -1])
