from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import AnyArray, Image
from ovmot.outputs import drawing
from ovmot.outputs.dynamic_overlay import draw_dynamic
from ovmot.outputs.stereo_overlay import draw_stereo, epipolar_curves
from ovmot.types import FrameResult, PointLabel, StereoFrame

Maker = Callable[[int], FrameResult]


def images_of(result: FrameResult) -> StereoFrame:
    """The images that a result belongs to."""
    assert isinstance(result.frame, StereoFrame)
    return result.frame


def color_at(image: Image, u: float, v: float) -> tuple[int, ...]:
    return tuple(int(c) for c in image[round(v), round(u)])


def has_color(patch: AnyArray, color: drawing.Color) -> bool:
    return bool(np.any(np.all(patch == np.array(color), axis=-1)))


def text_area(image: Image, u: int, v: int) -> Image:
    """Where words beside a point are, clear of its dot."""
    return image[v - 14 : v - 3, u + 4 : u + 80]


def test_stereo_points_have_their_colours_in_both_images(
    rig: StereoRig, make_result: Maker
) -> None:
    result = make_result(0)
    image = draw_stereo(images_of(result), result.matches, rig)
    assert image.shape == (160, 480, 3)
    assert color_at(image, 60, 60) == drawing.BLUE
    assert color_at(image, 240 + 100, 70) == drawing.BLUE
    assert color_at(image, 200, 130) == drawing.RED
    assert color_at(image, 240 + 120, 120) == drawing.RED
    assert drawing.BLUE[0] > 2 * max(drawing.BLUE[1:])


def test_stereo_distances_are_green_in_the_right_image(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    image = draw_stereo(images_of(result), result.matches, rig)
    assert has_color(text_area(image, 240 + 100, 70), drawing.GREEN)
    assert has_color(text_area(image, 240 + 120, 120), drawing.GREEN)
    assert not has_color(image[20:, :240], drawing.GREEN)


def test_an_outlier_s_line_is_drawn_where_the_geometry_puts_it(
    rig: StereoRig, make_result: Maker
) -> None:
    result = make_result(0)
    image = draw_stereo(images_of(result), result.matches, rig)
    for x in (-0.25, 0.2):  # the refused match has the line y = 0.3, off its point
        u, v = rig.cam1.denormalize(np.array([x, 0.3]))
        blue, green, red = color_at(image, 240 + u, v)
        assert red > 150
        assert max(blue, green) < 60
        assert color_at(image, 240 + u, v + 4) == color_at(image, 5, 155)


def test_epipolar_curves_pass_through_every_depth_of_the_left_point(rig: StereoRig) -> None:
    """A rolled, distorted right camera: what the left pixel may see lies along the curve."""
    p_left = np.array([[90.0, 70.0], [150.0, 100.0]])
    ray = np.concatenate([rig.cam0.normalize(p_left), np.ones((2, 1))], axis=1)
    line = ray @ rig.essential.T
    at_depth = [
        rig.cam1.project(se3.apply(rig.T_cam1_cam0, depth * ray)) for depth in (3.0, 4.0, 8.0)
    ]
    curves = epipolar_curves(at_depth[1], line, rig.cam1, reach_px=60.0)
    for pixels in at_depth:
        for curve, pixel in zip(curves, pixels, strict=True):
            assert distance_to_polyline(curve, pixel) < 0.05
    slope = np.abs(curves[:, -1] - curves[:, 0])
    assert np.all(slope[:, 1] > 0.4 * slope[:, 0])  # the roll: far from horizontal
    assert np.all(np.linalg.norm(curves[:, -1] - curves[:, 0], axis=1) > 80.0)


def test_a_line_without_direction_is_not_drawn() -> None:
    camera = Camera.make((10, 10), (10.0, 10.0), (5.0, 5.0))
    curve = epipolar_curves(np.array([[3.0, 3.0]]), np.zeros((1, 3)), camera, 5.0)
    assert np.all(np.isnan(curve))


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


def test_scale_enlarges_image_and_positions(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    dynamic = draw_dynamic(images_of(result), result.points, scale=2.0)
    stereo = draw_stereo(images_of(result), result.matches, rig, scale=2.0)
    assert dynamic.shape == (320, 480, 3)
    assert stereo.shape == (320, 960, 3)
    assert color_at(dynamic, 120, 120) == drawing.RED
    assert color_at(stereo, 400, 260) == drawing.RED


def test_drawing_leaves_the_input_alone(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    draw_stereo(images_of(result), result.matches, rig)
    draw_dynamic(images_of(result), result.points)
    assert np.all(images_of(result).left == 40)
    assert np.all(images_of(result).right == 40)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_positions_far_away_are_left_out(make_result: Maker, bad: float) -> None:
    points = make_result(0).points
    image = draw_dynamic(
        images_of(make_result(0)), replace(points, predicted=np.full_like(points.predicted, bad))
    )
    assert color_at(image, 60, 60) == drawing.RED
    assert not has_color(image[20:], drawing.PINK)


def test_no_points_at_all(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    nothing = replace(
        result.matches, feature_id=np.empty(0, np.int64), pixels=np.empty((0, 4)),
        distance_px=np.empty(0), accepted=np.empty(0, np.bool_), line=np.empty((0, 3)),
    )  # fmt: skip
    image = draw_stereo(images_of(result), nothing, rig)
    assert np.all(image[20:] == image[-1, -1])


def distance_to_polyline(curve: AnyArray, pixel: AnyArray) -> float:
    start, step = curve[:-1], np.diff(curve, axis=0)
    along = np.sum((pixel - start) * step, axis=1) / np.sum(step * step, axis=1)
    nearest = start + np.clip(along, 0.0, 1.0)[:, None] * step
    return float(np.linalg.norm(nearest - pixel, axis=1).min())
