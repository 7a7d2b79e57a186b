"""Effects of lens, shutter and exposure control on images, one function each."""

import cv2
import numpy as np

from ovmot.geometry.arrays import AnyArray, FloatArray, IntArray
from ovmot.sim.paths import sines

SUB_EXPOSURES = 5
"""Moments that a blurred image is the mean of; odd, so that the stamp is one of them."""
_DRIFT_HZ = (0.03, 0.25)
_GREATEST_SINES = 6.0**0.5  # three sines of amplitude sqrt(2/3)
_OWN_SHARE = 0.15


def sub_exposures(timestamp_ns: int, exposure_s: float) -> list[int]:
    """Middles, in ns, of equal parts of the exposure around the stamp; without one, the stamp."""
    if exposure_s == 0.0:
        return [timestamp_ns]
    middles = (np.arange(SUB_EXPOSURES) + 0.5) / SUB_EXPOSURES - 0.5
    since_ns = np.round(1e9 * exposure_s * middles).astype(np.int64)
    return [timestamp_ns + int(since) for since in since_ns]


def exposure_gains(timestamp_ns: IntArray, drift: float, rng: np.random.Generator) -> FloatArray:
    """Factors (N, 2) on the brightness of the left and the right image.

    Slow sines, most of them common to both cameras, that stay within 1 ± `drift`.
    """
    seconds = np.asarray(1e-9 * (timestamp_ns - timestamp_ns[:1]))
    common, left, right = (sines(seconds, rng, *_DRIFT_HZ) / _GREATEST_SINES for _ in range(3))
    own = np.stack([left, right], axis=-1)
    return np.asarray(1.0 + drift * ((1.0 - _OWN_SHARE) * common[:, None] + _OWN_SHARE * own))


def defocused(grey: AnyArray, sigma_px: float) -> AnyArray:
    """The image (H, W) behind a lens whose blur is a Gaussian; itself where that is zero."""
    if sigma_px == 0.0:
        return grey
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT))
