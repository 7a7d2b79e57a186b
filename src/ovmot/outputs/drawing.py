"""Lines, dots and words that the overlays are made of. Images are (height, width, 3),
blue-green-red.

Positions are pixels of the original image, (N, 2); `scale` is how much larger the image is.
A position that is not finite, or far outside, is left out. Images are drawn on in place: they
are made here, by `backdrop`, and belong to the caller. Lines and words grow with the image.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.outputs.lettering import font_size, place_words, word_size, write
from ovmot.outputs.palette import BLACK, DARK, Color

_DIM = 0.55  # share of the image's brightness that is kept, so that colours stand out
_FAR_PX = 5000.0
_SUBPIXEL_BITS = 3
_PIXELS_A_LINE = 640  # of the image's width, to one pixel of a line's
_SHADE = 0.35  # what is left of the image under the caption


def backdrop(grey: Image, scale: float) -> Image:
    """A dimmed colour copy of a grey image (height, width), `scale` times as large."""
    if scale != 1.0:
        height, width = grey.shape[:2]
        size = (round(width * scale), round(height * scale))
        method = cv2.INTER_LINEAR if scale > 1.0 else cv2.INTER_AREA
        grey = np.asarray(cv2.resize(grey, size, interpolation=method), dtype=np.uint8)
    dimmed = cv2.convertScaleAbs(grey, alpha=_DIM)
    return np.asarray(cv2.cvtColor(dimmed, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def drawable(pixels: FloatArray) -> BoolArray:
    """Which positions (..., 2) are finite and near enough to the image to be drawn."""
    return np.asarray(np.all(np.abs(pixels) < _FAR_PX, axis=-1))


def line_width(image: Image) -> int:
    """Width of a line that is seen in an image of this size, pixels."""
    return max(1, round(int(image.shape[1]) / _PIXELS_A_LINE))


def dots(
    image: Image, pixels: FloatArray, color: Color, scale: float = 1.0, radius: int = 2
) -> None:
    """Filled discs at pixels (N, 2)."""
    kept = pixels[drawable(pixels)]
    for u, v in np.rint(enlarged(kept, scale)).astype(np.int64).tolist():
        cv2.circle(image, (u, v), radius, color, cv2.FILLED)


def curves(
    image: Image, points: FloatArray, color: Color, scale: float = 1.0, width: int = 1
) -> None:
    """Polylines through points (N, K, 2); one with any position not drawable is left out.

    Wide ones have a black edge, to be seen on anything.
    """
    kept = points[np.all(drawable(points), axis=-1)]
    fixed = list(np.rint(enlarged(kept, scale) * 2**_SUBPIXEL_BITS).astype(np.int32))
    if not fixed:
        return
    if width > 1:
        cv2.polylines(image, fixed, False, BLACK, width + 2, cv2.LINE_AA, _SUBPIXEL_BITS)
    cv2.polylines(image, fixed, False, color, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def arrows(
    image: Image, tails: FloatArray, heads: FloatArray, color: Color, scale: float = 1.0
) -> None:
    """Arrows from pixels (N, 2) to pixels (N, 2)."""
    kept = drawable(tails) & drawable(heads)
    ends = zip(enlarged(tails[kept], scale), enlarged(heads[kept], scale), strict=True)
    width, tip_px = max(line_width(image) - 1, 1), image.shape[1] / 200
    for tail, head in ends:
        length = max(float(np.linalg.norm(head - tail)), 1e-6)
        a, b = (tuple(np.rint(p).astype(np.int64).tolist()) for p in (tail, head))
        cv2.arrowedLine(image, a, b, color, width, cv2.LINE_AA, tipLength=min(tip_px / length, 1.0))


def texts(
    image: Image,
    pixels: FloatArray,
    words: Sequence[str],
    color: Color | list[Color],
    scale: float = 1.0,
    reach: int = 5,
) -> int:
    """Small words beside pixels (N, 2), none over another; how many found no place.

    They have one colour, or each its own; the first ones get their places first, within `reach`
    lines of their pixels. A word that had to go farther away is tied to its pixel by a line.
    """
    shown = [i for i, word in enumerate(words) if word and drawable(pixels[i])]
    if not shown:
        return 0
    colors = color if isinstance(color, list) else [color] * len(words)
    size = font_size(image.shape[1])
    at = enlarged(pixels[shown], scale)
    sizes = np.array([word_size(words[i], size) for i in shown], dtype=np.float64)
    bounds = image.shape[1], image.shape[0]
    head = np.array([[0.0, 0.0, bounds[0], caption_height(image)]])
    corners = place_words(at, sizes, bounds, head, reach)
    placed = np.isfinite(corners[:, 0])
    ties = _ties(at[placed], corners[placed], sizes[placed], 0.9 * sizes[0, 1])
    curves(image, ties, DARK)
    for i, corner in zip(shown, corners, strict=True):
        if np.isfinite(corner[0]):
            write(image, words[i], corner[0], corner[1], colors[i], size)
    return int(np.count_nonzero(~placed))


def labels(
    image: Image,
    boxes: FloatArray,
    words: Sequence[str],
    colors: Sequence[Color],
    scale: float = 1.0,
) -> None:
    """Words in black on coloured plates above boxes (N, 4), none over another.

    Boxes are left, top, right, bottom in pixels; a plate lies within the image. Where the box is
    not drawable there is none.
    """
    seen = np.flatnonzero(np.all(drawable(boxes.reshape(-1, 2, 2)), axis=1)).tolist()
    if not seen:
        return
    size = font_size(image.shape[1])
    bounds = image.shape[1], image.shape[0]
    margin = np.array([6.0, 2.0])
    sizes = np.array([word_size(words[i], size) for i in seen]) + margin
    anchors = enlarged(boxes[seen, :2], scale)
    anchors[:, 0] -= 4.0  # where the plate's left edge is above the box's
    head = np.array([[0.0, 0.0, bounds[0], caption_height(image)]])
    corners = place_words(anchors, sizes, bounds, head)
    for i, corner, plate in zip(seen, corners, sizes, strict=True):
        if np.isfinite(corner[0]):
            left, top = np.rint(corner).astype(np.int64).tolist()
            right, bottom = left + int(plate[0]), top + int(plate[1])
            cv2.rectangle(image, (left, top), (right, bottom), colors[i], cv2.FILLED)
            write(image, words[i], left + 3, top + 1, BLACK, size, outline=False)


def caption(image: Image, words: Sequence[tuple[str, Color]]) -> None:
    """Words, each in its colour, on a dark strip at the upper edge; those that do not fit are left
    out from the end."""
    size, height = font_size(image.shape[1]), caption_height(image)
    strip = image[:height]
    strip[:] = (_SHADE * strip).astype(np.uint8)
    gap = float(size)
    left = 0.5 * gap
    for word, color in words:
        width, tall = word_size(word, size)
        if left + width > image.shape[1]:
            return
        write(image, word, left, 0.5 * (height - tall), color, size)
        left += width + gap


def caption_height(image: Image) -> int:
    """Height of the strip with the caption, pixels."""
    return round(1.7 * font_size(image.shape[1]))


def enlarged(pixels: FloatArray, scale: float) -> FloatArray:
    """Positions in the image; integer positions are pixel centres in both."""
    return (pixels + 0.5) * scale - 0.5


def _ties(at: FloatArray, corners: FloatArray, sizes: FloatArray, far: float) -> FloatArray:
    """Lines (M, 2, 2) from pixels (N, 2) to the nearest edge of their words, where that is far."""
    nearest = np.clip(at, corners, corners + sizes)
    lines = np.stack([at, nearest], axis=1)
    return np.asarray(lines[np.linalg.norm(nearest - at, axis=1) > far])
