"""Masks: parts of the images in which no features are taken, such as the bonnet or the sky.

A folder holds `cam0.png` and `cam1.png`, the same for all frames, or folders `cam0` and `cam1` with
`<stamp in ns>.png` for single frames, or both; each is optional. The folder of a run that has found
the rig's own body (`RIG_MASKS`) is one too. Pixels that are not zero are masked.
"""

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.geometry.arrays import Image
from ovmot.types import Event, StereoFrame

_CAMERAS = ("cam0", "cam1")
RIG_MASKS = ("ego_mask_cam0.png", "ego_mask_cam1.png")
"""Masks of the rig's own body in the folder of a run."""


class MaskSource(Protocol):
    """Gives the masks of a frame."""

    def of(self, timestamp_ns: int) -> tuple[Image | None, Image | None]:
        """Left and right; None where nothing is masked. Raises `InputError`."""
        ...


@dataclass(frozen=True, slots=True)
class Masks:
    """The folder, the size (width, height) of each camera, and what is masked in all frames."""

    folder: Path
    sizes: tuple[tuple[int, int], tuple[int, int]]
    always: tuple[Image | None, Image | None]

    def of(self, timestamp_ns: int) -> tuple[Image | None, Image | None]:
        """The masks of one frame; None where nothing is masked. Raises `InputError`."""
        left, right = (
            _joined(always, _read(self.folder / camera / f"{timestamp_ns}.png", size))
            for camera, size, always in zip(_CAMERAS, self.sizes, self.always, strict=True)
        )
        return left, right


def open_masks(folder: Path, rig: StereoRig) -> Masks:
    """The masks of a folder; raises `InputError` where it holds none, or one of another size."""
    sizes = ((rig.cam0.width, rig.cam0.height), (rig.cam1.width, rig.cam1.height))
    left, right = (
        _joined(_read(folder / f"{camera}.png", size), _read(folder / of_run, size))
        for camera, of_run, size in zip(_CAMERAS, RIG_MASKS, sizes, strict=True)
    )
    if left is None and right is None and not any((folder / name).is_dir() for name in _CAMERAS):
        problem = "holds no masks"
        raise InputError.at(folder, problem, "cam0.png, cam1.png, or folders cam0, cam1 of them")
    return Masks(folder, sizes, (left, right))


@dataclass(frozen=True, slots=True)
class FixedMasks:
    """The same masks for all frames."""

    always: tuple[Image | None, Image | None]

    def of(self, timestamp_ns: int) -> tuple[Image | None, Image | None]:
        """Those masks."""
        return self.always


def open_mask_files(files: tuple[Path | None, Path | None], rig: StereoRig) -> FixedMasks:
    """Masks of two images, each optional; raises `InputError` for one of another size."""
    sizes = ((rig.cam0.width, rig.cam0.height), (rig.cam1.width, rig.cam1.height))
    left, right = (
        None if file is None else _read(file, size) for file, size in zip(files, sizes, strict=True)
    )
    return FixedMasks((left, right))


def with_masks(
    stream: Generator[Event, None, None], masks: MaskSource
) -> Generator[Event, None, None]:
    """The events, each stereo frame with these masks too; the stream is closed with this one."""
    with closing(stream):
        for event in stream:
            if isinstance(event, StereoFrame):
                left, right = masks.of(event.timestamp_ns)
                left, right = _joined(event.left_mask, left), _joined(event.right_mask, right)
                yield replace(event, left_mask=left, right_mask=right)
            else:
                yield event


def _read(path: Path, size: tuple[int, int]) -> Image | None:
    if not path.is_file():
        return None
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError.at(path, "is no image", "write it as PNG")
    if image.shape[::-1] != size:
        found = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError.at(path, f"is {found}, the camera {size[0]}x{size[1]}", "bring it to size")
    return np.asarray(image, dtype=np.uint8)


def _joined(a: Image | None, b: Image | None) -> Image | None:
    if a is None or b is None:
        return a if b is None else b
    return np.asarray(a | b)
