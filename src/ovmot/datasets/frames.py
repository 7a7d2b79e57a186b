"""Which stereo frames a folder holds: files, stamps, and the pairs of left and right."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from ovmot.datasets.findings import Findings, rising
from ovmot.datasets.images import SUFFIXES
from ovmot.datasets.text_tables import StampedNames, is_stamp
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import IntArray
from ovmot.settings import ImuSettings, RecordingSettings


@dataclass(frozen=True, slots=True)
class ReadingLimits:
    """Up to where the reader of a folder or bag takes what is not as it should be.

    `imu_max_gap_s`: a longer hole in the IMU's samples is reported. `pair_tolerance_s`: so far
    apart may the stamps of the two images of a pair be. `need_pairs`: whether a camera without
    images is an error; else its frames are listed as single images of the other one.
    `need_imu_pose`: whether a calibration must say where the cameras are on the IMU.
    """

    imu_max_gap_s: float = ImuSettings().max_gap_s
    pair_tolerance_s: float = RecordingSettings().pair_tolerance_s
    need_pairs: bool = True
    need_imu_pose: bool = True

    @property
    def pair_tolerance_ns(self) -> int:
        return round(self.pair_tolerance_s * 1e9)

    @property
    def by_number(self) -> "ReadingLimits":
        """For images that are paired by frame numbers."""
        return replace(self, pair_tolerance_s=0.0)


class NoImagesError(DatasetError):
    """A camera has no images."""


@dataclass(frozen=True, slots=True)
class StereoListing:
    """Stereo pairs in time order: stamps (M,) in ns (the left image's) and the image of each side.

    Of one camera the left ones alone. `left_alone` and `right_alone` are the images without a
    partner, by their stamp. `numbers` are what the data calls the frames, by their stamp; empty
    where it does not count them.
    """

    frame_ns: IntArray
    left_paths: tuple[Path, ...]
    right_paths: tuple[Path, ...]
    left_alone: Mapping[int, Path] = field(default_factory=dict)
    right_alone: Mapping[int, Path] = field(default_factory=dict)
    numbers: Mapping[int, int] = field(default_factory=dict)

    @property
    def any_path(self) -> Path:
        """One of the images."""
        alone = *self.left_alone.values(), *self.right_alone.values()
        return next(iter((*self.left_paths, *alone)))

    def stamped(self, stamps_of: Callable[[IntArray], IntArray]) -> "StereoListing":
        """The same by stamps in ns, where it is by frame numbers; `stamps_of` (K,) rising numbers.

        Without the single images where their times do not serve: the pairs are complete.
        """
        frame_ns = stamps_of(self.frame_ns)
        alone = *self.left_alone, *self.right_alone
        numbers = np.array(sorted({*self.frame_ns.tolist(), *alone}), dtype=np.int64)
        try:
            stamps = stamps_of(numbers) if alone else frame_ns
        except DatasetError:
            return replace(self, left_alone={}, right_alone={}).stamped(stamps_of)
        stamp_of = dict(zip(numbers.tolist(), stamps.tolist(), strict=True))
        return replace(
            self,
            frame_ns=frame_ns,
            left_alone={stamp_of[n]: path for n, path in self.left_alone.items()},
            right_alone={stamp_of[n]: path for n, path in self.right_alone.items()},
            numbers={stamp: number for number, stamp in stamp_of.items()},
        )


@dataclass(frozen=True, slots=True)
class ListedFrame:
    """The images of one exposure; None for the side that is missing, or that the rig lacks."""

    timestamp_ns: int
    left: Path | None
    right: Path | None


def listed_frames(listing: StereoListing, n_cameras: int = 2) -> tuple[ListedFrame, ...]:
    """All frames in time order: the pairs, and the single images, the other side None.

    For a rig of one camera, the left images.
    """
    rights = listing.right_paths or (None,) * len(listing.left_paths)
    pairs = zip(listing.frame_ns.tolist(), listing.left_paths, rights, strict=True)
    frames = [
        *(ListedFrame(*pair) for pair in pairs),
        *(ListedFrame(stamp, path, None) for stamp, path in listing.left_alone.items()),
    ]
    if n_cameras == 2:
        frames += (ListedFrame(stamp, None, path) for stamp, path in listing.right_alone.items())
    return tuple(sorted(frames, key=lambda frame: frame.timestamp_ns))


def listed_images(images: Mapping[int, Path]) -> StereoListing:
    """The images of one camera by stamp, as a listing."""
    stamps = sorted(images)
    return StereoListing(np.array(stamps, dtype=np.int64), tuple(images[s] for s in stamps), ())


def images_in(folder: Path) -> dict[str, Path]:
    """The image files of a folder by name; raises `NoImagesError` if it is missing or has none."""
    if not folder.is_dir():
        raise NoImagesError.at(folder, "no such folder", "the images of one camera belong here")
    names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in SUFFIXES)
    found = {name: folder / name for name in names if not name.startswith(".")}
    if not found:
        raise NoImagesError.at(folder, "no images in this folder", f"known: {' '.join(SUFFIXES)}")
    return found


def camera_images(
    read: Callable[[], dict[int, Path]], limits: ReadingLimits, findings: Findings
) -> dict[int, Path]:
    """The images that `read` finds; none, noted, where that serves too (`limits.need_pairs`)."""
    try:
        return read()
    except NoImagesError as error:
        if limits.need_pairs:
            raise
        findings.note("camera_missing", 1, str(error))
        return {}


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


def present_images(
    stamps: Mapping[int, str], folder: Path, listed_in: Path, tolerance_ns: int = 0
) -> dict[int, Path]:
    """The images of those listed stamps that have one, by stamp.

    A stamp listed without a file name means `<stamp>.png`, else the image whose own stamp, its
    name, is the nearest within `tolerance_ns`; it keeps its own. Raises `NoImagesError` if none is
    there.
    """
    files = images_in(folder)
    found = {
        stamp: files[name]
        for stamp, name in ((s, n or f"{s}.png") for s, n in stamps.items())
        if name in files
    }
    nameless = [stamp for stamp, name in stamps.items() if not name and stamp not in found]
    if nameless and tolerance_ns:
        own = {int(p.stem): p for p in files.values() if is_stamp(p.stem)}
        others = own.keys() - found.keys()
        found |= {s: own[s] for s in match_stamps(nameless, others, tolerance_ns).values()}
    if not found:
        problem = f"none of its {len(stamps)} stamps has an image in {folder}"
        raise NoImagesError.at(listed_in, problem, "file names are the stamps in nanoseconds")
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


def pair_listed(
    folders: tuple[Path, Path], listed: Path, read: Callable[[Path], StampedNames], root: Path,
    findings: Findings, limits: ReadingLimits,
) -> StereoListing:  # fmt: skip
    """The pairs in the left and the right folder that a file lists, as `read` finds its stamps.

    A stamp without a file name is as `present_images` has it. Without the file, images are numbered
    by their names.
    """
    if not listed.exists():
        left, right = (
            camera_images(partial(numbered_images, folder), limits, findings) for folder in folders
        )
        return pair_images(left, right, root, findings, limits)
    stamps = checked_stamps(read(listed), findings)
    left, right = (
        camera_images(
            partial(present_images, stamps, folder, listed, limits.pair_tolerance_ns),
            limits, findings,
        )
        for folder in folders
    )  # fmt: skip
    note_missing_images(stamps, left.keys() | right.keys(), listed, findings)
    return pair_images(left, right, root, findings, limits)


def pair_images(
    left: Mapping[int, Path],
    right: Mapping[int, Path],
    root: Path,
    findings: Findings,
    limits: ReadingLimits,
) -> StereoListing:
    """The pairs of images by stamp (or number), as `pair_stamps`."""
    left_ns, right_ns = pair_stamps(left.keys(), right.keys(), root, findings, limits)
    pairs_left, pairs_right = left_ns.tolist(), right_ns.tolist()
    return StereoListing(
        left_ns,
        tuple(left[s] for s in pairs_left),
        tuple(right[s] for s in pairs_right),
        {s: left[s] for s in sorted(left.keys() - set(pairs_left))},
        {s: right[s] for s in sorted(right.keys() - set(pairs_right))},
    )


def pair_stamps(
    left: Collection[int],
    right: Collection[int],
    root: Path,
    findings: Findings,
    limits: ReadingLimits,
) -> tuple[IntArray, IntArray]:
    """Stamps in ns of the M pairs, left (M,) and right (M,), both rising.

    A pair are two images nearest to each other, at most `limits.pair_tolerance_s` apart. What has
    no partner is counted, and so are pairs of unequal stamps. Raises `DatasetError` where there is
    no pair, unless one camera has no images and that serves too.
    """
    partner = match_stamps(left, right, limits.pair_tolerance_ns)
    one_camera = bool(left) != bool(right)
    if not partner and (limits.need_pairs or not one_camera):
        problem, remedy = _no_pairs(left, right), _pair_remedy(limits.pair_tolerance_ns)
        raise DatasetError.at(root, problem, remedy)
    left_ns = np.array(list(partner), dtype=np.int64)
    right_ns = np.array(list(partner.values()), dtype=np.int64)
    alone = len(left) - len(partner), len(right) - len(partner)
    text = (
        f"{root}: {alone[0]} left and {alone[1]} right images without a partner"
        f" (of {len(left)} and {len(right)}): frames of one camera"
    )
    findings.note("unpaired_images", sum(alone), text)
    apart_ns = np.abs(right_ns - left_ns)
    most_ms = 1e-6 * apart_ns.max(initial=0)
    text = (
        f"{root}: the stamps of left and right differ by up to {most_ms:.3g} ms:"
        " paired by the nearest, the left one's counts"
    )
    findings.note("pairs_of_unequal_stamps", int(np.count_nonzero(apart_ns)), text)
    return left_ns, right_ns


def match_stamps(
    left: Collection[int], right: Collection[int], tolerance_ns: int
) -> dict[int, int]:
    """Left stamp -> right stamp (ns), rising, of those nearest to each other and near enough."""
    if not left or not right:
        return {}
    a, b = (np.array(sorted(stamps), dtype=np.int64) for stamps in (left, right))
    to_left, to_right = _nearest(a, b), _nearest(b, a)
    mutual = to_left[to_right] == np.arange(len(a))
    mutual &= np.abs(b[to_right] - a) <= tolerance_ns
    return dict(zip(a[mutual].tolist(), b[to_right[mutual]].tolist(), strict=True))


def _nearest(stamps: IntArray, wanted: IntArray) -> IntArray:
    """Index of the nearest stamp for each wanted one; both rise."""
    after = np.clip(np.searchsorted(stamps, wanted), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(stamps[before] - wanted) < np.abs(stamps[after] - wanted)
    return np.where(nearer, before, after)


def _no_pairs(left: Collection[int], right: Collection[int]) -> str:
    problem = f"{len(left)} left and {len(right)} right images, only 0 pairs"
    nearest = match_stamps(left, right, 2**62)
    if not nearest:
        return problem
    gap_ns = min(abs(r - s) for s, r in nearest.items())
    return f"{problem}: the nearest stamps are {1e-6 * gap_ns:.6g} ms apart"


def _pair_remedy(tolerance_ns: int) -> str:
    if not tolerance_ns:
        return "both cameras need images of equal numbers; copy the missing ones"
    return (
        f"a pair's stamps differ by at most {1e-9 * tolerance_ns:g} s"
        " (--set recording.pair_tolerance_s): copy the missing images, or check the clocks"
    )
