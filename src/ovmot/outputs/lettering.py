"""Words in images: a real font, smooth at every size, and places where words do not cover each
other."""

from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from PIL import Image as Pictures
from PIL import ImageDraw, ImageFont

from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.outputs.palette import BLACK, Color

_FONT = "mpl-data/fonts/ttf/DejaVuSans.ttf"  # what matplotlib brings; of Bitstream's free licence
_LEAST_PX, _MOST_PX = 11, 22
_PIXELS_A_LETTER = 80  # the image's width by the font's size: an image has 130 letters a line
_SEPARATION_PX = 1.0  # between two words


def font_size(width: int) -> int:
    """Size in pixels that reads well in an image of this width."""
    return int(np.clip(round(width / _PIXELS_A_LETTER), _LEAST_PX, _MOST_PX))


@lru_cache(maxsize=4096)
def word_size(word: str, size: int) -> tuple[int, int]:
    """Width and height (pixels) of the room that a word takes, with its outline."""
    height, width = _mask(word, size).shape
    return width, height


def write(
    image: Image, word: str, left: float, top: float, color: Color, size: int, outline: bool = True
) -> None:
    """Draw a word into an image with its upper left corner at a pixel; what is outside is cut off.

    With `outline` it has a black edge, to be legible on anything.
    """
    mask = _mask(word, size)
    if outline:
        edge = np.asarray(cv2.dilate(mask, np.ones((3, 3), np.uint8)), dtype=np.uint8)
        _blend(image, edge, left, top, BLACK)
    _blend(image, mask, left, top, color)


def place_words(
    anchors: FloatArray,
    sizes: FloatArray,
    bounds: tuple[int, int],
    taken: FloatArray,
    reach: int = 5,
) -> FloatArray:
    """Upper left corners (N, 2) of N words near their anchors (N, 2), so that none covers another.

    Words come first that are first. `sizes` (N, 2) are widths and heights, `bounds` width and
    height of the image, `taken` (M, 4) boxes (left, top, right, bottom) that are to stay free. The
    nearest free place is taken: beside the anchor, then on rings around it. NaN for a word that
    has no place within `reach` lines of its anchor.
    """
    boxes = np.concatenate([taken.reshape(-1, 4), np.empty((len(anchors), 4))])
    n = len(taken)
    corners = np.full((len(anchors), 2), np.nan)
    for i, (anchor, size) in enumerate(zip(anchors, sizes, strict=True)):
        if not np.all(np.isfinite(anchor)):
            continue
        candidates = _candidates(anchor, size, bounds, reach)
        free = _is_free(candidates, size, boxes[:n])
        if free.any():
            corners[i] = candidates[np.argmax(free)]
            boxes[n] = [*corners[i], *(corners[i] + size)]
            n += 1
    return corners


def _candidates(
    anchor: FloatArray, size: FloatArray, bounds: tuple[int, int], reach: int
) -> FloatArray:
    """Corners (C, 2) of a word by its anchor, the best first, moved to lie within the image."""
    w, h = size
    gap = 4.0
    near = [
        (gap, -h), (-w - gap, -h), (gap, -2.2 * h), (-w - gap, -2.2 * h), (-w / 2, -h - gap),
        (gap, 0.0), (-w - gap, 0.0), (-w / 2, gap),
    ]  # fmt: skip
    rings = [
        (du * ring * 1.5 * h - w / 2, dv * ring * h - h / 2)
        for ring in range(1, reach + 1)
        for du, dv in ((0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1), (2, 0), (-2, 0),
                       (2, -1), (-2, -1), (2, 1), (-2, 1))
    ]  # fmt: skip
    corners = anchor + np.array([*near, *rings])
    inside: FloatArray = np.clip(corners, 0.0, np.maximum(np.array(bounds) - size, 0.0))
    return inside


def _is_free(corners: FloatArray, size: FloatArray, boxes: FloatArray) -> BoolArray:
    """Which corners (C, 2) give a word of this size that touches none of the boxes (M, 4)."""
    low, high = corners[:, None] - _SEPARATION_PX, corners[:, None] + size + _SEPARATION_PX
    apart = (low >= boxes[None, :, 2:]) | (high <= boxes[None, :, :2])
    return np.asarray(np.all(np.any(apart, axis=2), axis=1))


def _blend(image: Image, mask: Image, left: float, top: float, color: Color) -> None:
    height, width = image.shape[:2]
    u, v = round(float(left)), round(float(top))
    u0, v0 = max(u, 0), max(v, 0)
    u1, v1 = min(u + mask.shape[1], width), min(v + mask.shape[0], height)
    if u0 >= u1 or v0 >= v1:
        return
    share = mask[v0 - v : v1 - v, u0 - u : u1 - u, None].astype(np.float32) / 255.0
    place = image[v0:v1, u0:u1]
    place[:] = np.rint(place + share * (np.array(color, np.float32) - place)).astype(np.uint8)


@lru_cache(maxsize=4096)
def _mask(word: str, size: int) -> Image:
    """How much of each pixel (height, width) a word covers, 0 to 255, with a pixel of edge."""
    font = _font(size)
    ascent, descent = font.getmetrics()
    width = int(np.ceil(font.getlength(word))) + 2
    sheet = Pictures.new("L", (width, ascent + descent + 2))
    ImageDraw.Draw(sheet).text((1, 1), word, fill=255, font=font)
    return np.asarray(sheet, dtype=np.uint8)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    spec = find_spec("matplotlib")  # it is not loaded for that: half a second
    assert spec is not None
    assert spec.origin is not None
    return ImageFont.truetype(str(Path(spec.origin).parent / _FONT), size)
