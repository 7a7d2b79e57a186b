"""Which stereo frames a folder holds: files, stamps, and the pairs of left and right."""

from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.datasets.findings import Findings, rising
from ovmot.datasets.images import SUFFIXES
from ovmot.datasets.text_tables import StampedNames, is_stamp
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import IntArray


@dataclass(frozen=True, slots=True)
class StereoListing:
    """Stereo pairs in time order: stamps (M,) in ns and the image of each side."""

    frame_ns: IntArray
    left_paths: tuple[Path, ...]
    right_paths: tuple[Path, ...]


def images_in(folder: Path) -> dict[str, Path]:
    """The image files of a folder by name; raises `DatasetError` if it is missing or has none."""
    if not folder.is_dir():
        raise DatasetError.at(folder, "no such folder", "the images of one camera belong here")
    names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    found = {name: folder / name for name in names if not name.startswith(".")}
    if not found:
        raise DatasetError.at(folder, "no images in this folder", f"known: {' '.join(SUFFIXES)}")
    return found


def numbered_images(folder: Path) -> dict[int, Path]:
    """Images by the number that is their name; raises `DatasetError` for any other name."""
    found: dict[int, Path] = {}
    for path in images_in(folder).values():
        if not (path.stem.isdigit() and is_stamp(path.stem)):
            problem = "the file name is not a number"
            raise DatasetError.at(path, problem, "name images by stamp (ns) or frame number")
        if int(path.stem) in found:
            other = found[int(path.stem)].name
            raise DatasetError.at(path, f"the same number as {other}", "delete one of them")
        found[int(path.stem)] = path
    return dict(sorted(found.items()))


def checked_stamps(listed: StampedNames, findings: Findings) -> dict[int, str]:
    """Listed stamps and names, without rows whose stamp does not follow all above; these are
    counted. Raises `DatasetError` where most do not."""
    fresh = rising(listed.timestamp_ns, listed.row, listed.path, "frames", findings)
    kept = np.flatnonzero(fresh).tolist()
    return {int(listed.timestamp_ns[k]): listed.names[k] for k in kept}


def present_images(stamps: Mapping[int, str], folder: Path, listed_in: Path) -> dict[int, Path]:
    """The images of those listed stamps that have one, by stamp.

    A stamp listed without a file name means `<stamp>.png`. Raises `DatasetError` if none is there.
    """
    files = images_in(folder)
    found = {
        stamp: files[name]
        for stamp, name in ((s, n or f"{s}.png") for s, n in stamps.items())
        if name in files
    }
    if not found:
        problem = f"none of its {len(stamps)} stamps has an image in {folder}"
        raise DatasetError.at(listed_in, problem, "file names are the stamps in nanoseconds")
    return found


def note_missing_images(
    stamps: Collection[int],
    found: Collection[int],
    listed_in: Path,
    findings: Findings,
) -> None:
    """Count the listed stamps that have an image in neither camera."""
    missing = len(set(stamps) - set(found))
    text = f"{listed_in}: {missing} of {len(stamps)} stamps have no images: skipped"
    findings.note("stamps_without_image", missing, text)


def pair_images(
    left: Mapping[int, Path], right: Mapping[int, Path], root: Path, findings: Findings
) -> StereoListing:
    """Pairs of equal stamp, as `paired_stamps`."""
    both = paired_stamps(left.keys(), right.keys(), root, findings)
    return StereoListing(
        both, tuple(left[s] for s in both.tolist()), tuple(right[s] for s in both.tolist())
    )


def paired_stamps(left: Set[int], right: Set[int], root: Path, findings: Findings) -> IntArray:
    """Stamps (M,) in ns that both cameras have, rising; what has no partner is counted.

    Raises `DatasetError` if fewer than half of one camera's images have a partner.
    """
    both = sorted(left & right)
    most = max(len(left), len(right))
    if 2 * len(both) < most or not both:
        problem = f"{len(left)} left and {len(right)} right images, only {len(both)} pairs"
        remedy = "both cameras need images of equal stamps; copy the missing ones"
        raise DatasetError.at(root, problem, remedy)
    alone_left, alone_right = len(left) - len(both), len(right) - len(both)
    text = f"{root}: {alone_left} left and {alone_right} right images without a partner: dropped"
    findings.note("unpaired_images", alone_left + alone_right, text)
    return np.array(both, dtype=np.int64)
