"""The views by name: their sizes, and that each shows what it is named for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from overlay_checks import has_color

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.outputs import palette
from ovmot.outputs.trails import Trails
from ovmot.outputs.views import VIEW_NAMES, View, draw_view
from ovmot.types import FeatureFrame, FrameResult, StereoFrame

Maker = Callable[[int], FrameResult]


def sized(result: FrameResult, size: tuple[int, int]) -> FrameResult:
    grey = np.full(size, 100, dtype=np.uint8)
    return replace(result, frame=StereoFrame(result.timestamp_ns, grey, grey))


@pytest.mark.parametrize(
    ("view", "size", "canvas"),
    [
        ("objects", (280, 640), (560, 1280)),  # small images are enlarged, for the words
        ("objects", (560, 1280), (560, 1280)),
        ("objects", (1200, 2448), (942, 1920)),  # no wider than 1920
        ("objects", (375, 1242), (386, 1280)),
        ("stereo", (280, 640), (280, 1280)),
        ("stereo", (560, 1280), (420, 1920)),
        ("dynamic", (281, 1281), (282, 1282)),  # made even
        ("all", (560, 1280), (840 + 420 + 840, 1920)),
    ],
)
def test_the_canvas_is_even_and_holds_its_pictures(
    rig: StereoRig, make_result: Maker, view: View, size: tuple[int, int], canvas: tuple[int, int]
) -> None:
    image = draw_view(view, sized(make_result(0), size), rig, Trails())
    assert image.shape == (*canvas, 3)
    assert image[-3, -3].any()


def test_a_width_may_be_asked_for(rig: StereoRig, make_result: Maker) -> None:
    assert draw_view("all", make_result(0), rig, Trails(), 640).shape[1] == 640


def test_each_view_shows_what_it_is_named_for(rig: StereoRig, make_result: Maker) -> None:
    drawn = {view: draw_view(view, make_result(0), rig, Trails()) for view in VIEW_NAMES}
    originals: dict[View, tuple[palette.Color, ...]] = {
        "stereo": (palette.BLUE, palette.RED),
        "dynamic": (palette.RED, palette.PINK),
    }
    for view, colors in originals.items():
        assert all(has_color(drawn[view], color) for color in colors)
        assert all(has_color(drawn["all"], color) for color in colors)
        assert not any(has_color(drawn["objects"], color) for color in colors)
    assert has_color(drawn["objects"], palette.color_of(3))


def test_features_alone_cannot_be_drawn(rig: StereoRig, make_result: Maker) -> None:
    features = FeatureFrame(5, np.empty(0, np.int64), np.empty((0, 4)))
    with pytest.raises(OvmotError, match="frame 5: no images to draw on"):
        draw_view("objects", replace(make_result(5), frame=features), rig, Trails())
