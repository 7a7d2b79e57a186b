"""The pictures of a result, by name: the one door for video, report and ROS.

`objects` is drawn where nothing else is asked for; `stereo` and `dynamic` are the original's two
pictures.
"""

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.geometry.arrays import Image
from ovmot.outputs.dynamic_overlay import draw_dynamic
from ovmot.outputs.objects_overlay import draw_objects, scene_picture
from ovmot.outputs.stereo_overlay import draw_stereo
from ovmot.outputs.trails import Trails
from ovmot.types import FrameResult, StereoFrame

View = Literal["objects", "stereo", "dynamic", "all"]
VIEW_NAMES: tuple[View, ...] = get_args(View)

_LEAST_WIDTH, _MOST_WIDTH = 1280, 1920


def draw_view(
    view: View, result: FrameResult, rig: StereoRig, trails: Trails, width: int | None = None
) -> Image:
    """A result as an image of even size (BGR); `trails` has been extended by it.

    `width` in pixels is that of the whole image; None for that of the left image, for two of them
    side by side where both are shown, but 1280 at least and 1920 at most. Raises `OvmotError` for
    a frame without images.
    """
    frame = result.frame
    if not isinstance(frame, StereoFrame):
        raise OvmotError(f"frame {frame.timestamp_ns}: no images to draw on")
    if width is None:
        width = natural_width(view, frame)
    parts = [draw(result, frame, rig, trails, width) for draw in _VIEWS[view]]
    height = sum(part.shape[0] for part in parts)
    canvas = np.zeros((height + height % 2, width + width % 2, 3), dtype=np.uint8)
    top = 0
    for part in parts:
        across = min(width, part.shape[1])  # rounding may make one a pixel wider
        canvas[top : top + part.shape[0], :across] = part[:, :across]
        top += part.shape[0]
    return canvas


def natural_width(view: View, frame: StereoFrame) -> int:
    """The width that a view of a frame has where none is asked for, pixels."""
    pair = view in ("stereo", "all") and frame.right is not None
    width = frame.left.shape[1] * (2 if pair else 1)
    return int(np.clip(width + width % 2, _LEAST_WIDTH, _MOST_WIDTH))


def _objects(
    result: FrameResult, frame: StereoFrame, rig: StereoRig, trails: Trails, width: int
) -> Image:
    return draw_objects(frame.left, scene_picture(result, rig.cam0, trails), width)


def _stereo(
    result: FrameResult, frame: StereoFrame, rig: StereoRig, trails: Trails, width: int
) -> Image:
    across = frame.left.shape[1] * (1 if frame.right is None else 2)
    seconds = trails.seconds(frame.timestamp_ns)
    return draw_stereo(frame, result.matches, rig, seconds, width / across)


def _dynamic(
    result: FrameResult, frame: StereoFrame, rig: StereoRig, trails: Trails, width: int
) -> Image:
    seconds = trails.seconds(frame.timestamp_ns)
    return draw_dynamic(frame, result.points, seconds, width / frame.left.shape[1])


_Draw = Callable[[FrameResult, StereoFrame, StereoRig, Trails, int], Image]
_VIEWS: dict[View, tuple[_Draw, ...]] = {
    "objects": (_objects,),
    "stereo": (_stereo,),
    "dynamic": (_dynamic,),
    "all": (_objects, _stereo, _dynamic),
}
