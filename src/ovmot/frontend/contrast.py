"""Contrast correction before matching."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from ovmot.geometry.arrays import FloatArray, Image


def equalize_histogram(image: Image) -> Image:
    """Spread the grey levels of the whole image evenly."""
    return np.asarray(cv2.equalizeHist(image), dtype=np.uint8)


def equalize_locally(image: Image) -> Image:
    """Contrast-limited adaptive equalisation (K. Zuiderveld, Graphics Gems IV, 1994)."""
    clahe = cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8))
    return np.asarray(clahe.apply(image), dtype=np.uint8)


def stretch_linearly(image: Image) -> Image:
    """Bring the 2nd and 98th percentile to the ends of the range: one gain for all grey levels.

    Unlike a histogram's curve, a gain keeps what optical flow compares alike from frame to frame
    when the scene changes; it is limited so that night stays night.
    """
    low, high = grey_percentiles(image[::4, ::4], (2.0, 98.0))
    gain = min(255.0 / max(high - low, 1.0), _MAX_GAIN)
    levels = np.clip((np.arange(256) - low) * gain, 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.LUT(image, levels), dtype=np.uint8)


def grey_percentiles(image: Image, percent: Sequence[float]) -> FloatArray:
    """Percentiles of grey levels, interpolated between neighbours, from their histogram.

    What `numpy.percentile` gives, which sorts all pixels for it.
    """
    up_to = np.bincount(image.ravel(), minlength=256).cumsum()
    place = np.array(percent) / 100.0 * (up_to[-1] - 1)
    below = np.floor(place)
    grey = np.searchsorted(up_to, np.stack([below, np.ceil(place)]), side="right")
    out: FloatArray = grey[0] + (place - below) * (grey[1] - grey[0])
    return out


def leave_as_is(image: Image) -> Image:
    """No correction."""
    return image


_MAX_GAIN = 4.0

EQUALIZERS: dict[str, Callable[[Image], Image]] = {
    "histogram": equalize_histogram,
    "linear": stretch_linearly,
    "clahe": equalize_locally,
    "none": leave_as_is,
}
