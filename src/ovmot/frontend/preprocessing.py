"""Images made ready for tracking: contrast correction, pyramid, smoothing."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import numpy.typing as npt

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.frontend.image_kernel import (
    grey_range_compiled,
    scale_levels_compiled,
    smooth_to_words_compiled,
)
from ovmot.frontend.klt_kernel import BACK_LEVELS, margin_of
from ovmot.frontend.patch_kernel import MARGIN, Quads
from ovmot.geometry.arrays import BoolArray, FloatArray, Image
from ovmot.runtime import do_together
from ovmot.settings import TrackerSettings
from ovmot.types import FeatureFrame, StereoFrame

LEFT, RIGHT = 0, 1
NO_MASK: Image = np.empty((0, 0), dtype=np.uint8)
"""An image of no pixels: no mask, as kernels take it."""
_MAX_GAIN = 4.0
"""Greatest gain of contrast, so that night stays night; CLAHE's clip limit is the same bound."""


def _smoothing_weights(sigma_px: float) -> npt.NDArray[np.int32]:
    """A Gaussian of five pixels in 256ths: the outer two weights, and the middle one (3,)."""
    outer = np.round(256.0 * cv2.getGaussianKernel(5, sigma_px).ravel()[:2])
    return np.append(outer, 256.0 - 2.0 * outer.sum()).astype(np.int32)


_SMOOTHING = _smoothing_weights(0.8)
"""Of images that patches are cut from: between smoothed pixels, bilinear sampling costs little
sharpness."""


@dataclass(frozen=True, slots=True)
class Pyramid:
    """An image from fine to coarse, each level (height, width) padded by
    `klt_kernel.margin_of(window)`, for windows of side `window` pixels."""

    levels: tuple[Image, ...]
    window: int


@dataclass(frozen=True, slots=True)
class View:
    """One camera's image (height, width) with corrected contrast, and what is derived from it.

    `pyramid` is for optical flow, `words` for patches, see `patch_image`; `mask`
    (height, width) is not zero where nothing is taken from; `camera`: the calibration of now.
    """

    image: Image
    pyramid: Pyramid
    words: Quads
    mask: Image | None
    camera: Camera

    @property
    def compact_mask(self) -> Image:
        """The mask as kernels take it: empty where there is none."""
        return NO_MASK if self.mask is None else for_kernels(self.mask)

    def contains(self, uv: FloatArray) -> BoolArray:
        """Around which pixels (N, 2) the window of optical flow lies in the image, and which of
        them are not masked; NaN is not."""
        return self.camera.inside(uv, self.pyramid.window // 2) & ~inside_mask(uv, self.mask)


def preprocess(
    frame: StereoFrame | FeatureFrame,
    rig: StereoRig,
    settings: TrackerSettings,
    helper: Executor,
    sides: tuple[int, ...] = (LEFT, RIGHT),
) -> tuple[View, ...]:
    """The views of a frame that the cameras `sides` have, in their order. Raises `OvmotError` for a
    frame without images, or without one of these."""
    if isinstance(frame, FeatureFrame):
        raise OvmotError(f"frame {frame.timestamp_ns}: features where images were expected")

    def view_of(image: Image, mask: Image | None, camera: Camera) -> View:
        even = EQUALIZERS[settings.equalization](image)
        return View(even, build_pyramid(even, settings), patch_image(even), mask, camera)

    images = (frame.left,) if sides == (LEFT,) else frame.pair
    masks = frame.left_mask, frame.right_mask
    jobs = [partial(view_of, images[side], masks[side], rig.cameras[side]) for side in sides]
    return tuple(do_together(jobs, helper))


def build_pyramid(image: Image, settings: TrackerSettings) -> Pyramid:
    """The pyramid of an image (height, width), built once for all searches from and in it.

    Each level has half the size of the last one (Gaussian, 5x5), and none is smaller than the
    window.
    """
    window = settings.klt_window_px
    margin = margin_of(window)
    n_levels = max(settings.klt_levels, BACK_LEVELS)
    levels: list[Image] = []
    while len(levels) < n_levels and (not levels or min(image.shape) > window):
        padded = cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REFLECT_101)
        levels.append(np.asarray(padded, dtype=np.uint8))
        image = np.asarray(cv2.pyrDown(image))
    return Pyramid(tuple(levels), window)


def patch_image(image: Image) -> Quads:
    """The image as patches are cut from it and aligned with it: smoothed, continued by `MARGIN`
    pixels of its border, in words of four: a pixel, its right, its lower and its lower right
    neighbour, from the lowest byte on. One load has all that a bilinear sample needs.
    """
    return smooth_to_words_compiled(for_kernels(image), _SMOOTHING, MARGIN)


def inside_mask(uv: FloatArray, mask: Image | None) -> BoolArray:
    """Which pixels (N, 2) lie where the mask (height, width) is not zero; those outside do not."""
    masked = np.zeros(len(uv), dtype=np.bool_)
    if mask is None:
        return masked
    height, width = mask.shape
    near = np.isfinite(uv).all(axis=1)
    u, v = np.round(uv[near]).astype(np.int64).T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    masked[np.flatnonzero(near)[inside]] = mask[v[inside], u[inside]] > 0
    return masked


def equalize_histogram(image: Image) -> Image:
    """Spread the grey levels of the whole image evenly."""
    return np.asarray(cv2.equalizeHist(image), dtype=np.uint8)


def equalize_locally(image: Image) -> Image:
    """Contrast-limited adaptive equalization (K. Zuiderveld, Graphics Gems IV, 1994)."""
    clahe = cv2.createCLAHE(clipLimit=_MAX_GAIN, tileGridSize=(8, 8))
    return np.asarray(clahe.apply(image), dtype=np.uint8)


def stretch_linearly(image: Image) -> Image:
    """Bring the 2nd and 98th percentile to the ends of the range: one gain for all grey levels.

    Unlike the curve of a histogram, a gain keeps what optical flow compares alike from frame to
    frame when the scene changes; it is limited so that night stays night.
    """
    image = for_kernels(image)
    low, high = grey_range_compiled(image, 4, 2.0, 98.0)
    gain = min(255.0 / max(high - low, 1.0), _MAX_GAIN)
    return scale_levels_compiled(image, low, gain)


def for_kernels(image: Image) -> Image:
    """The image as kernels are compiled for: rows one after the other, in memory to be written."""
    return np.require(image, np.uint8, ["C", "W"])


def leave_as_is(image: Image) -> Image:
    """No correction."""
    return image


EQUALIZERS: dict[str, Callable[[Image], Image]] = {
    "histogram": equalize_histogram,
    "linear": stretch_linearly,
    "clahe": equalize_locally,
    "none": leave_as_is,
}
"""Contrast corrections by the setting `tracker.equalization`."""
