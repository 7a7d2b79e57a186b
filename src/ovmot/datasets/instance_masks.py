"""Instance images of a data set, and masks made of them.

Each pixel shows the colour of what is seen there, and a table gives the colours numbers (VIODE and
other data rendered by AirSim). Grey images hold the numbers themselves.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.findings import Findings
from ovmot.datasets.frames import numbered_images
from ovmot.datasets.text_tables import read_lines
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import Image

_MOST_ID = 2**31
_COLOUR_COLUMNS = ("id", "r", "g", "b")


@dataclass(frozen=True, slots=True)
class InstanceImages:
    """The images of both cameras by stamp (ns), and the colour (red, green, blue) of each id.

    `colours` is empty where the images are grey and hold the ids.
    """

    images: tuple[Mapping[int, Path], Mapping[int, Path]]
    colours: Mapping[int, tuple[int, int, int]]


@dataclass(frozen=True, slots=True)
class InstanceMasks:
    """Masks of the pixels that show one of `ids`; a source of masks as `Masks` is."""

    instances: InstanceImages
    ids: tuple[int, ...]
    sizes: tuple[tuple[int, int], tuple[int, int]]

    @classmethod
    def make(
        cls, instances: InstanceImages, ids: tuple[int, ...], rig: StereoRig
    ) -> "InstanceMasks":
        """For the images of a rig."""
        sizes = ((rig.cam0.width, rig.cam0.height), (rig.cam1.width, rig.cam1.height))
        return cls(instances, ids, sizes)

    def of(self, timestamp_ns: int) -> tuple[Image | None, Image | None]:
        """The masks of one frame; None where it has no image. Raises `InputError`."""
        left, right = (
            self._mask(images.get(timestamp_ns), size)
            for images, size in zip(self.instances.images, self.sizes, strict=True)
        )
        return left, right

    def _mask(self, path: Path | None, size: tuple[int, int]) -> Image | None:
        if path is None:
            return None
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise InputError.at(path, "is no image", "write it as PNG")
        if image.shape[1::-1] != size:
            found = f"{image.shape[1]}x{image.shape[0]}"
            remedy = "segmentation and images need one size"
            raise InputError.at(path, f"is {found}, the camera {size[0]}x{size[1]}", remedy)
        if image.ndim == 2:
            return np.asarray(np.isin(image, self.ids), dtype=np.uint8)
        mask = np.zeros(image.shape[:2], dtype=bool)
        for number in self.ids:
            colour = self.instances.colours.get(number)
            if colour is None:
                remedy = "put the table rgb_ids.txt beside the data, or take the id out"
                raise InputError.at(path, f"no colour is known for id {number}", remedy)
            mask |= np.all(image[..., 2::-1] == colour, axis=-1)
        return mask.astype(np.uint8)


def find_instance_images(
    folders: tuple[Path, Path], table: Path | None, findings: Findings
) -> InstanceImages | None:
    """The images `<ns>.png` of both cameras, those of a missing folder left out.

    None where both folders are missing. Raises `DatasetError` for a broken table of colours.
    """
    if not any(folder.is_dir() for folder in folders):
        return None
    left, right = (numbered_images(folder) if folder.is_dir() else {} for folder in folders)
    if table is None:
        text = f"{folders[0]}: no table rgb_ids.txt: coloured segmentation cannot be used as masks"
        findings.note("no_segmentation_colours", 1, text)
    return InstanceImages((left, right), {} if table is None else read_colours(table))


def read_colours(path: Path) -> dict[int, tuple[int, int, int]]:
    """Rows `id,r,g,b` of a table of colours; raises `DatasetError` naming the row."""
    lines = read_lines(path, DatasetError)
    table = lines.parse(np.dtype(np.float64), len(_COLOUR_COLUMNS), ",")
    wrong = np.any((table[:, 1:] < 0) | (table[:, 1:] > 255), axis=1)
    wrong |= np.abs(table[:, 0]) > _MOST_ID
    if np.any(wrong):
        row = int(lines.row[int(np.argmax(wrong))])
        raise DatasetError.at(path, "no colour", "red, green, blue are 0 to 255", row=row)
    return {int(i): (int(r), int(g), int(b)) for i, r, g, b in table}
