"""Checks of the images: contrast, saturation, brightness, images that repeat."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.doctor.report import Finding, Severity
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.types import StereoFrame

_STEP = 4  # every fourth pixel of every fourth row is enough
_LOW_RANGE, _NO_RANGE = 40.0, 8.0  # grey levels: a gain of 4 is the most the front end gives
_BRIGHT_SHARE, _DARK_SHARE, _LOST_SHARE = 0.15, 0.3, 0.6
_UNEVEN = 1.5


@dataclass(frozen=True, slots=True)
class ImageStatistics:
    """One stereo pair in numbers, left and right (2,): the grey range from the 2nd to the 98th
    percentile, the mean, the shares of pixels at 0 and at 255; whether left equals right, and
    whether the left image equals the one before."""

    grey_range: FloatArray
    mean: FloatArray
    black: FloatArray
    white: FloatArray
    sides_equal: bool
    repeats: bool
    thinned: Image


def image_statistics(frame: StereoFrame, before: ImageStatistics | None) -> ImageStatistics:
    """What a stereo pair looks like."""
    thin = [np.ascontiguousarray(x[::_STEP, ::_STEP]) for x in (frame.left, frame.right)]
    low, high = np.percentile([x.ravel() for x in thin], (2.0, 98.0), axis=1)
    return ImageStatistics(
        grey_range=np.asarray(high - low),
        mean=np.array([x.mean() for x in thin]),
        black=np.array([(x == 0).mean() for x in thin]),
        white=np.array([(x == 255).mean() for x in thin]),
        sides_equal=bool(np.array_equal(frame.left, frame.right)),
        repeats=before is not None and bool(np.array_equal(before.thinned, thin[0])),
        thinned=thin[0],
    )


def check_images(images: Sequence[ImageStatistics]) -> list[Finding]:
    """Findings about sampled stereo pairs, by the median over them."""
    grey_range, mean, black, white = (
        np.median([getattr(p, name) for p in images], axis=0)
        for name in ("grey_range", "mean", "black", "white")
    )
    return [
        _contrast(float(grey_range.min())),
        _saturation(float(black.max()), float(white.max())),
        _brightness(mean),
        _copies(images),
    ]


def check_readable(broken: Sequence[str], n_read: int) -> list[Finding]:
    """One finding where some of the sampled images could not be read; `broken` has a line each."""
    if not broken:
        return []
    says = f"{len(broken)} of {n_read + len(broken)} stereo pairs cannot be read: {broken[0]}"
    return [Finding("images", Severity.WRONG, says)]


def _contrast(grey_range: float) -> Finding:
    says = f"grey levels span {grey_range:.0f} of 255 (2nd to 98th percentile)"
    if grey_range < _NO_RANGE:
        return Finding(
            "contrast", Severity.WRONG, says, "the images show nothing: check the lens cap"
        )
    if grey_range < _LOW_RANGE:
        return Finding("contrast", Severity.DOUBTFUL, says, "expose longer, or light the scene")
    return Finding("contrast", Severity.FINE, says)


def _saturation(black: float, white: float) -> Finding:
    says = f"{black:.1%} of the pixels are at 0, {white:.1%} at 255"
    if max(black, white) > _LOST_SHARE:
        return Finding("exposure", Severity.WRONG, says, "correct the exposure")
    if black > _DARK_SHARE or white > _BRIGHT_SHARE:
        return Finding("exposure", Severity.DOUBTFUL, says, "correct the exposure")
    return Finding("exposure", Severity.FINE, says)


def _brightness(mean: FloatArray) -> Finding:
    says = f"mean grey is {mean[0]:.0f} on the left and {mean[1]:.0f} on the right"
    if max(mean) > _UNEVEN * max(min(mean), 1.0):
        return Finding("brightness", Severity.DOUBTFUL, says, "give both cameras the same exposure")
    return Finding("brightness", Severity.FINE, says)


def _copies(images: Sequence[ImageStatistics]) -> Finding:
    equal = sum(p.sides_equal for p in images)
    repeats = sum(p.repeats for p in images)
    check, n = "repeated images", len(images)
    if equal:
        says = f"left and right image are the same file's in {equal} of {n} pairs"
        return Finding(check, Severity.WRONG, says, "copy the right camera's own images")
    if repeats:
        says = f"{repeats} of {n} left images equal the one before"
        severity = Severity.WRONG if repeats > 0.1 * n else Severity.DOUBTFUL
        return Finding(check, severity, says, "the recorder wrote images twice: take them out")
    return Finding(check, Severity.FINE, "no image is a copy of another")
