"""Lines, dots and text that the overlays are made of. Images are (height, width, 3),
blue-green-red.

Positions are pixels of the original image, (N, 2); `scale` is how much larger the image is.
A position that is not finite, or far outside, is left out. Images are drawn on in place: they
are made here, by `backdrop`, and belong to the caller.
"""

from collections.abc import Iterable

import cv2
import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, Image

Color = tuple[int, int, int]

BLUE: Color = (255, 100, 0)
RED: Color = (0, 0, 255)
DARK_RED: Color = (30, 30, 170)
GREEN: Color = (60, 255, 60)
WHITE: Color = (255, 255, 255)
PINK: Color = (203, 105, 255)
GREY: Color = (185, 185, 185)
BLACK: Color = (0, 0, 0)
DARK: Color = (70, 70, 70)
_OF_TRACKS: tuple[Color, ...] = (
    (0, 230, 255), (255, 230, 0), (0, 150, 255), (255, 130, 120), (90, 255, 170), (220, 120, 255),
)  # fmt: skip

_DIM = 0.55  # share of the image's brightness that is kept, so that colours stand out
_FAR_PX = 5000.0
_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_PLAIN, 0.8
_SUBPIXEL_BITS = 3


def color_of(track_id: int) -> Color:
    """The colour of a track, the same as long as it lives."""
    return _OF_TRACKS[track_id % len(_OF_TRACKS)]


def dimmed(color: Color) -> Color:
    """The same colour, half as bright."""
    blue, green, red = (c // 2 for c in color)
    return blue, green, red


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


def dots(
    image: Image, pixels: FloatArray, color: Color, scale: float = 1.0, radius: int = 2
) -> None:
    """Filled discs at pixels (N, 2)."""
    kept = pixels[drawable(pixels)]
    for u, v in np.rint(_enlarge(kept, scale)).astype(np.int64).tolist():
        cv2.circle(image, (u, v), radius, color, cv2.FILLED)


def curves(image: Image, points: FloatArray, color: Color, scale: float = 1.0) -> None:
    """Thin polylines through points (N, K, 2); one with any position not drawable is left out."""
    kept = points[np.all(drawable(points), axis=-1)]
    fixed = np.rint(_enlarge(kept, scale) * 2**_SUBPIXEL_BITS).astype(np.int32)
    if len(fixed):
        cv2.polylines(image, list(fixed), False, color, 1, cv2.LINE_AA, _SUBPIXEL_BITS)


def texts(
    image: Image, pixels: FloatArray, words: Iterable[str], color: Color, scale: float = 1.0
) -> None:
    """Small words above pixels (N, 2): to the right, or to the left where the image ends."""
    places = np.rint(_enlarge(pixels, scale))
    for (u, v), word, inside in zip(places, words, drawable(pixels), strict=True):
        if not inside:
            continue
        width = cv2.getTextSize(word, _FONT, _FONT_SCALE, 1)[0][0]
        left = u + 4 if u + 4 + width < image.shape[1] else u - 4 - width
        place = (int(left), int(v) - 4)
        # a dark outline, to be legible
        cv2.putText(image, word, place, _FONT, _FONT_SCALE, BLACK, 2)
        cv2.putText(image, word, place, _FONT, _FONT_SCALE, color, 1)


def rectangle(image: Image, box: FloatArray, color: Color, scale: float = 1.0) -> None:
    """The outline of a box (4,): left, top, right, bottom."""
    corners = box[[[0, 1], [2, 1], [2, 3], [0, 3], [0, 1]]]
    curves(image, corners[None], color, scale)


def label(image: Image, corner: FloatArray, word: str, color: Color, scale: float = 1.0) -> None:
    """A word in black on a coloured background whose lower left corner is at a pixel (2,).

    It is moved to lie within the image; nothing is drawn where the pixel is not drawable.
    """
    if not drawable(corner):
        return
    u, v = np.rint(_enlarge(corner, scale)).astype(np.int64).tolist()
    (width, height), rest = cv2.getTextSize(word, _FONT, 1.0, 1)
    left = min(max(u, 0), image.shape[1] - width - 4)
    bottom = min(max(v, height + rest + 2), image.shape[0])
    top = bottom - height - rest - 2
    cv2.rectangle(image, (left, top), (left + width + 4, bottom), color, cv2.FILLED)
    place = (left + 2, bottom - rest)
    cv2.putText(image, word, place, _FONT, 1.0, BLACK, 1, cv2.LINE_AA)


def caption(image: Image, words: Iterable[tuple[str, Color]]) -> None:
    """One line of words, each in its colour, on black in the image's upper left corner."""
    parts = [(word, color, cv2.getTextSize(word, _FONT, 1.0, 1)[0][0]) for word, color in words]
    gap, height = 12, 18
    total = sum(width + gap for _, _, width in parts) + gap
    cv2.rectangle(image, (0, 0), (total, height), BLACK, cv2.FILLED)
    left = gap
    for word, color, width in parts:
        cv2.putText(image, word, (left, height - 5), _FONT, 1.0, color, 1, cv2.LINE_AA)
        left += width + gap


def _enlarge(pixels: FloatArray, scale: float) -> FloatArray:
    """Positions in the image; integer positions are pixel centres in both."""
    return (pixels + 0.5) * scale - 0.5
