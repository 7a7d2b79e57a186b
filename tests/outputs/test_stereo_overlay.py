import numpy as np
from overlay_checks import Maker, color_at, distance_to_polyline, has_words, images_of, text_area

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.outputs import palette
from ovmot.outputs.stereo_overlay import draw_stereo, epipolar_curves


def test_stereo_points_have_their_colours_in_both_images(
    rig: StereoRig, make_result: Maker
) -> None:
    result = make_result(0)
    image = draw_stereo(images_of(result), result.matches, rig, 0.0)
    assert image.shape == (160, 480, 3)
    assert color_at(image, 60, 60) == palette.BLUE
    assert color_at(image, 240 + 100, 70) == palette.BLUE
    assert color_at(image, 200, 130) == palette.RED
    assert color_at(image, 240 + 120, 120) == palette.RED
    assert palette.BLUE[0] > 2 * max(palette.BLUE[1:])


def test_stereo_distances_are_green_in_the_right_image(rig: StereoRig, make_result: Maker) -> None:
    result = make_result(0)
    image = draw_stereo(images_of(result), result.matches, rig, 0.0)
    assert has_words(text_area(image, 240 + 100, 70), palette.GREEN)
    assert has_words(text_area(image, 240 + 120, 120), palette.GREEN)
    assert not has_words(image[20:, :240], palette.GREEN)


def test_an_outlier_s_line_is_drawn_where_the_geometry_puts_it(
    rig: StereoRig, make_result: Maker
) -> None:
    result = make_result(0)
    image = draw_stereo(images_of(result), result.matches, rig, 0.0)
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
