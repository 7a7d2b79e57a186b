"""Pictures that show nothing of now: missing, flat, the last one once more, or torn.

A driver that hangs hands out the same picture again; a buffer that is read while it is written has
rows of two. Sensor noise makes no two pictures equal byte for byte, unless the scene is rendered
and the rig stands: so a repeated one is told by the rig's motion. Of pictures torn one after the
other only the first has rows of the one before it as it came; the next ones are torn at its seam.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.errors import OvmotError
from ovmot.frontend.image_kernel import thin_out_compiled
from ovmot.frontend.preprocessing import NO_MASK, for_kernels
from ovmot.geometry.arrays import BoolArray, Image
from ovmot.types import FeatureFrame, Picture, StereoFrame

_STEP = 8
"""Every so many columns are compared: equal ones all over a row are equal."""
_FLAT_LEVELS = 4
"""Grey levels between the darkest and the brightest hundredth of a picture that is flat: sensor
noise alone makes as many."""
_TORN_SHARE = 0.05
"""Of the rows: fewer equal ones come about by themselves, in a sky without clouds."""
_BESIDE = 8
"""Rows to either side with which a seam is compared: of an untorn picture, one row in 17 is the
steepest of its neighbours, so that with this probability one too many is left out."""


Pictures = tuple[Picture, Picture]


@dataclass(frozen=True, slots=True)
class LastPicture:
    """Every eighth column (height, width / 8) of a picture, which rows (height,) of it were those
    of the one before, and, of a torn one, the first rows below its seams."""

    thin: Image
    repeated: BoolArray
    seams: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class LastPictures:
    """The last left and the last right picture; None before the first."""

    left: LastPicture | None = None
    right: LastPicture | None = None


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
    image: Image, missing: bool, last: LastPicture | None, moving: bool
) -> tuple[Picture, LastPicture | None]:
    if missing:
        return Picture.MISSING, last
    before = NO_MASK if last is None else last.thin
    thin, equal, low, high = thin_out_compiled(for_kernels(image), _STEP, before, 1.0, 99.0)
    kept = LastPicture(thin, equal)
    if high - low < _FLAT_LEVELS:
        return Picture.FLAT, kept
    if last is None or not moving:
        return Picture.FINE, kept
    if equal.all():
        return Picture.REPEATED, kept
    # what is equal in each picture is the rig itself, or has no texture
    changed = equal & ~last.repeated
    if changed.mean() >= _TORN_SHARE and np.ptp(thin[changed], axis=1).max() > _FLAT_LEVELS:
        return Picture.TORN, LastPicture(thin, equal, _ends(changed))
    seams = tuple(
        row for row in last.seams if not equal[row - 1 : row + 1].any() and _is_steepest(thin, row)
    )
    return Picture.TORN if seams else Picture.FINE, LastPicture(thin, equal, seams)


def _ends(rows: BoolArray) -> tuple[int, ...]:
    """Where the longest run of `rows` (height,) begins and ends, inside the picture."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(np.int8), [0]])))
    begin, end = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0])
    return tuple(row for row in (begin, end) if 0 < row < len(rows))


def _is_steepest(thin: Image, row: int) -> bool:
    """Do grey levels change more from the row above to this one than between rows nearby?"""
    first = max(row - _BESIDE - 1, 0)
    near = thin[first : row + _BESIDE + 1].astype(np.int16)
    step = np.abs(np.diff(near, axis=0)).mean(axis=1)
    return int(np.argmax(step)) == row - 1 - first
