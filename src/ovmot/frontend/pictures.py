"""Pictures that show nothing of now: missing, flat, the last one once more, or torn.

A driver that hangs hands out the same picture again; a buffer that is read while it is written has
rows of two. Sensor noise makes no two pictures equal byte for byte, unless the scene is rendered
and the rig stands: so a repeated one is told by the rig's motion.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.errors import OvmotError
from ovmot.frontend.image_kernel import grey_range_compiled
from ovmot.frontend.preprocessing import for_kernels
from ovmot.geometry.arrays import BoolArray, Image
from ovmot.types import FeatureFrame, Picture, StereoFrame

_STEP = 8
"""Every so many columns are compared: equal ones all over a row are equal."""
_FLAT_LEVELS = 4
"""Grey levels between the darkest and the brightest hundredth of a picture that is flat: sensor
noise alone makes as many."""
_TORN_SHARE = 0.05
"""Of the rows: fewer equal ones come about by themselves, in a sky without clouds."""


Pictures = tuple[Picture, Picture]


@dataclass(frozen=True, slots=True)
class LastPictures:
    """Every eighth column of the last left and right picture, and which rows (height,) of each
    were those of the one before; None before the first."""

    left: tuple[Image, BoolArray] | None = None
    right: tuple[Image, BoolArray] | None = None


def judge_pictures(
    frame: StereoFrame | FeatureFrame, last: LastPictures, moving: bool
) -> tuple[Pictures, LastPictures]:
    """What both cameras gave, and what to compare the next pictures with.

    `moving`: by the prediction, what is in view has moved in the picture since the last frame.
    Raises `OvmotError` for a frame without images.
    """
    if isinstance(frame, FeatureFrame):
        raise OvmotError(f"frame {frame.timestamp_ns}: features where images were expected")
    images = frame.pair
    left, kept_left = _judge(images[0], 0 in frame.missing, last.left, moving)
    right, kept_right = _judge(images[1], 1 in frame.missing, last.right, moving)
    return (left, right), LastPictures(kept_left, kept_right)


def _judge(
    image: Image, missing: bool, last: tuple[Image, BoolArray] | None, moving: bool
) -> tuple[Picture, tuple[Image, BoolArray] | None]:
    if missing:
        return Picture.MISSING, last
    thin = np.ascontiguousarray(image[:, ::_STEP])
    unlike = np.zeros(len(thin), dtype=np.bool_)
    equal = unlike if last is None else np.asarray((thin == last[0]).all(axis=1))
    kept = thin, equal
    low, high = grey_range_compiled(for_kernels(image), _STEP, 1.0, 99.0)
    if high - low < _FLAT_LEVELS:
        return Picture.FLAT, kept
    if last is None or not moving:
        return Picture.FINE, kept
    if equal.all():
        return Picture.REPEATED, kept
    # what is equal in each picture is the rig itself, or has no texture
    changed = equal & ~last[1]
    if changed.mean() >= _TORN_SHARE and np.ptp(thin[changed], axis=1).max() > _FLAT_LEVELS:
        return Picture.TORN, kept
    return Picture.FINE, kept
