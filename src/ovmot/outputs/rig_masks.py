"""Masks of what the run found to be the rig's own body, to be used by `--masks` the next time."""

from pathlib import Path

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.masks import RIG_MASKS
from ovmot.datasets.writing import write_png
from ovmot.segmentation.rig_body import RigBody


def write_rig_masks(out: Path, body: RigBody, rig: StereoRig) -> tuple[str, ...]:
    """Write the mask of each picture that shows the rig; the names of the files written."""
    written = []
    for side, (name, camera) in enumerate(zip(RIG_MASKS, rig.cameras, strict=True)):
        mask = body.mask(side, camera)
        if mask is not None:
            write_png(out / name, mask)
            written.append(name)
    return tuple(written)
