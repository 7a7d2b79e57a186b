"""Contrast correction before matching."""

from collections.abc import Callable

import cv2
import numpy as np

from ovmot.geometry.arrays import Image


def equalize_histogram(image: Image) -> Image:
    """Spread the grey levels of the whole image evenly."""
    return np.asarray(cv2.equalizeHist(image), dtype=np.uint8)


def equalize_locally(image: Image) -> Image:
    """Contrast-limited adaptive equalisation (K. Zuiderveld, Graphics Gems IV, 1994)."""
    clahe = cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8))
    return np.asarray(clahe.apply(image), dtype=np.uint8)


def leave_as_is(image: Image) -> Image:
    """No correction."""
    return image


EQUALIZERS: dict[str, Callable[[Image], Image]] = {
    "histogram": equalize_histogram,
    "clahe": equalize_locally,
    "none": leave_as_is,
}
