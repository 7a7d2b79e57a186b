"""Tracks in the image: boxes where the geometry puts them, trails, and what is cut off."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from overlay_checks import has_color, has_words, images_of

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.outputs import palette
from ovmot.outputs.drawing import caption_height
from ovmot.outputs.objects_overlay import draw_objects, draw_tracks, scene_picture, track_words
from ovmot.outputs.trails import TRAIL_S, Trails, body_edges, seen_pieces
from ovmot.types import FrameResult, ObjectTrack

Maker = Callable[[int], FrameResult]
WIDTH, HEIGHT = 240, 160
# the camera looks along the world's x axis, at its origin: camera x = -y, y = -z, z = x
T_CAM0_WORLD = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.zeros(3))
ORANGE = palette.color_of(6)


@pytest.fixture
def track(make_result: Maker) -> ObjectTrack:
    """A body 4 x 2 x 1.5 m, 10 m ahead, that drives to the left; colour 0 of the palette."""
    (made,) = make_result(0).tracks
    return replace(
        made, track_id=6, position=np.array([10.0, 0.0, 0.0]), yaw=0.5 * np.pi,
        size=np.array([4.0, 2.0, 1.5]), box_px=np.array([100.0, 70.0, 140.0, 90.0]),
        velocity=np.array([0.0, 5.0, 0.0]),
    )  # fmt: skip


@pytest.fixture
def pinhole() -> Camera:
    return Camera.make((WIDTH, HEIGHT), (150.0, 150.0), (120.0, 80.0))


def blank() -> Image:
    return np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)


def drawn(
    track: ObjectTrack, camera: Camera, trails: Trails | None = None, scale: float = 1.0
) -> Image:
    image = np.zeros((round(scale * HEIGHT), round(scale * WIDTH), 3), dtype=np.uint8)
    draw_tracks(image, [track], trails or Trails(), T_CAM0_WORLD, camera, scale)
    return image


def bright(image: Image, u: float, v: float) -> bool:
    """Is there a line of the track's colour within a pixel?"""
    patch = image[round(v) - 1 : round(v) + 2, round(u) - 1 : round(u) + 2].astype(int)
    return bool(np.any(np.abs(patch - np.array(ORANGE)).max(axis=-1) < 120))


def way(*positions: tuple[float, float, float]) -> Trails:
    return Trails(0, 0, {6: tuple((i, np.array(p)) for i, p in enumerate(positions))})


def test_the_edges_are_those_of_the_body(track: ObjectTrack) -> None:
    edges = body_edges(track)
    assert edges.shape == (14, 2, 3)
    lengths = np.sort(np.linalg.norm(edges[:12, 1] - edges[:12, 0], axis=1))
    np.testing.assert_allclose(lengths, [1.5] * 4 + [2.0] * 4 + [4.0] * 4)
    np.testing.assert_allclose(edges[:12].reshape(-1, 3).mean(axis=0), track.position, atol=1e-12)
    np.testing.assert_allclose(edges[12:, :, 1], 2.0)  # the cross: on the side it drives to


def test_the_3d_box_is_where_the_camera_sees_its_corners(
    track: ObjectTrack, pinhole: Camera
) -> None:
    image = drawn(track, pinhole)
    for y in (-2.0, 2.0):
        for x in (9.0, 11.0):
            assert bright(image, 120.0 - 150.0 * y / x, 80.0 - 150.0 * 0.75 / x)
    assert not image[100:].any()  # the nearest lower edge is at v = 92.5


def test_a_lens_bends_the_edges(rig: StereoRig) -> None:
    ends = np.array([[[4.0, -2.5, 1.0], [4.0, 2.5, 1.0]]])
    pieces = seen_pieces(ends, T_CAM0_WORLD, rig.cam0)
    middle = rig.cam0.project(se3.apply(T_CAM0_WORLD, ends[0].mean(axis=0)))
    assert np.linalg.norm(pieces.reshape(-1, 2) - middle, axis=1).min() < 12.0
    rows = pieces[..., 1]
    assert np.ptp(rows) > 1.0


@pytest.mark.parametrize(
    "ends",
    [
        [[-5.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],  # behind
        [[2.0, 50.0, 0.0], [2.0, 60.0, 0.0]],  # far out to the left
        [[np.nan, 0.0, 0.0], [5.0, 0.0, 0.0]],
    ],
)
def test_what_is_not_seen_has_no_pieces(rig: StereoRig, ends: list[list[float]]) -> None:
    assert len(seen_pieces(np.array([ends]), T_CAM0_WORLD, rig.cam0)) == 0


def test_a_line_through_the_camera_keeps_its_part_ahead(pinhole: Camera) -> None:
    ends = np.array([[[-10.0, 0.5, 0.0], [20.0, 0.5, 0.0]]])
    pieces = seen_pieces(ends, T_CAM0_WORLD, pinhole)
    assert 0 < len(pieces) < 11
    assert np.all(pieces[..., 0] < 120.0)
    assert np.all(pieces[..., 0] > -0.2 * WIDTH)


def test_a_lens_that_folds_back_brings_nothing_from_outside_into_the_image() -> None:
    strong = Camera.make(
        (WIDTH, HEIGHT), (150.0, 150.0), (120.0, 80.0), "radtan", [-0.3, 0.0, 0.0, 0.0]
    )
    ends: FloatArray = np.array([[[1.0, 1.8, 0.0], [1.0, 1.7, 0.0]]])
    u = strong.project(se3.apply(T_CAM0_WORLD, ends[0]))[:, 0]
    assert np.all(strong.inside(np.stack([u, u * 0 + 80.0], axis=1)))  # the model's lie
    assert len(seen_pieces(ends, T_CAM0_WORLD, strong)) == 0


def test_the_trail_is_the_way_it_came_in_the_present_image(
    track: ObjectTrack, pinhole: Camera
) -> None:
    trails = way((10.0, -5.0, -3.0), (10.0, -3.0, -3.0), (10.0, 0.0, -3.0))
    image = drawn(track, pinhole, trails)
    for y in (-4.0, -1.0):
        assert bright(image, 120.0 - 15.0 * y, 80.0 + 45.0)
    assert not drawn(track, pinhole)[120:].any()


def test_a_jump_is_no_way(track: ObjectTrack, pinhole: Camera) -> None:
    trails = way((10.0, -6.0, -3.0), (10.0, 6.0, -3.0))
    np.testing.assert_array_equal(drawn(track, pinhole, trails), drawn(track, pinhole))


def test_trails_grow_forget_and_end_with_their_segment(make_result: Maker) -> None:
    trails = Trails()
    for k in range(4):
        trails = trails.extended(make_result(k * 10**9))
    assert trails.of(3).shape == (4, 3)
    late = trails.extended(make_result(round((TRAIL_S + 1.5) * 1e9)))
    assert late.of(3).shape == (3, 3)  # of 2 and 3 s, and now
    nobody = replace(make_result(4 * 10**9), tracks=())
    assert trails.extended(nobody).of(3).shape == (4, 3)
    assert trails.of(99).shape == (0, 3)
    assert trails.extended(replace(nobody, segment=1)).points == {}


@pytest.mark.parametrize("state", ["tentative", "coasting"])
def test_only_confirmed_tracks_are_drawn(track: ObjectTrack, pinhole: Camera, state: str) -> None:
    np.testing.assert_array_equal(drawn(replace(track, state=state), pinhole), blank())


@pytest.mark.parametrize("corner", [(-50.0, -40.0), (500.0, 300.0), (100.0, 2.0)])
def test_the_label_stays_in_the_image(
    track: ObjectTrack, pinhole: Camera, corner: tuple[float, float]
) -> None:
    box = np.array([*corner, corner[0] + 10.0, corner[1] + 10.0])
    away = replace(track, position=np.array([-10.0, 0.0, 0.0]), box_px=box)
    plate = np.argwhere(np.all(drawn(away, pinhole) == ORANGE, axis=-1))
    assert np.ptp(plate[:, 0]) >= 9
    assert np.ptp(plate[:, 1]) >= 60


def test_a_track_without_a_box_in_the_image_has_no_label(
    track: ObjectTrack, pinhole: Camera
) -> None:
    away = replace(track, position=np.array([-10.0, 0.0, 0.0]), box_px=np.full(4, np.nan))
    np.testing.assert_array_equal(drawn(away, pinhole), blank())


def test_scale_enlarges_positions(track: ObjectTrack, pinhole: Camera) -> None:
    image = drawn(track, pinhole, scale=2.0)
    assert bright(image, 2.0 * (120.0 + 150.0 * 2.0 / 9.0 + 0.5), 2.0 * (92.5 + 0.5))


@pytest.mark.parametrize("width", [640, 1280, 1920])
def test_the_view_shows_dots_arrows_and_a_label_at_any_width(
    rig: StereoRig, make_result: Maker, width: int
) -> None:
    result = make_result(10**9)
    (track,) = result.tracks
    ahead = replace(track, position=np.array([0.0, 0.0, 8.0]))  # in a world with the camera's axes
    ego = replace(result.ego, T_world_imu=np.eye(4), T_imu_cam0=np.eye(4))
    result = replace(result, tracks=(ahead,), ego=ego)
    trails = Trails().extended(make_result(0)).extended(result)
    image = draw_objects(images_of(result).left, scene_picture(result, rig.cam0, trails), width)
    assert image.shape == (round(160 * width / 240), width, 3)
    scale = width / 240
    color = palette.color_of(3)

    def near(u: float, v: float) -> Image:
        column, row = round((u + 0.5) * scale), round((v + 0.5) * scale)
        return image[row - 4 : row + 4, column - 4 : column + 4]

    assert has_color(near(180, 60), palette.GREY)  # a static point
    middle = near(50, 65)
    assert has_words(middle, color)  # of the dynamic point's arrow, from (40, 70) to (60, 60)
    plate = np.argwhere(np.all(image == np.array(color), axis=-1))
    assert len(plate) > 300
    strip = image[: caption_height(image)]
    assert has_words(strip, palette.YELLOW)  # it is degraded


def test_times_are_seconds_from_the_start(rig: StereoRig, make_result: Maker) -> None:
    trails = Trails().extended(make_result(5 * 10**18)).extended(make_result(5 * 10**18 + 10**9))
    scene = scene_picture(make_result(5 * 10**18 + 2 * 10**9), rig.cam0, trails)
    assert scene.seconds == pytest.approx(2.0)
    restarted = trails.extended(replace(make_result(5 * 10**18 + 3 * 10**9), segment=1))
    assert restarted.start_ns == 5 * 10**18


def test_labels_of_neighbours_do_not_cover_each_other(track: ObjectTrack, pinhole: Camera) -> None:
    """Five bodies on nearly one place: five plates, each whole."""
    crowd = [
        replace(track, track_id=k, box_px=track.box_px + k, position=np.array([-10.0, 0.0, 0.0]))
        for k in range(5)
    ]
    image = np.zeros((HEIGHT * 3, WIDTH * 3, 3), dtype=np.uint8)
    draw_tracks(image, crowd, Trails(), T_CAM0_WORLD, pinhole, 3.0)
    areas = [np.count_nonzero(np.all(image == palette.color_of(k), axis=-1)) for k in range(5)]
    assert min(areas) > 0.7 * max(areas)


def test_the_words_of_a_track(track: ObjectTrack) -> None:
    unknown = replace(track, class_probability=np.full(3, np.nan))
    assert track_words(unknown) == "#6 5.0 m/s"
    cyclist = replace(track, class_probability=np.array([0.2, 0.7, 0.1]))
    assert track_words(cyclist) == "#6 cyclist 5.0 m/s"
    unsure = replace(track, class_probability=np.array([0.4, 0.4, 0.2]))
    assert track_words(unsure) == "#6 5.0 m/s"
