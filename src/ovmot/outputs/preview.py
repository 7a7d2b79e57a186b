"""`preview.npz`: small pictures of a run for its report, kept while it goes on.

Some left images, small, with the features seen in them, and for each object the largest view of
it. What they cost does not grow with the run: of a long run every other picture is given up again
and again.
"""

import warnings
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.errors import CalibrationError, InputError
from ovmot.geometry.arrays import FloatArray, Image, IntArray
from ovmot.outputs.objects_overlay import left_image
from ovmot.types import FrameResult, ObjectTrack

PREVIEW_FILE = "preview.npz"
_MOST_PICTURES = 200
_LEAST_GAP_NS = 200_000_000
_WIDTH = 800
_VIEW_SIZE = 160, 120  # of an object
_MOST_VIEWS = 500
_GROWTH = 1.3  # of the box's area, from one view of an object to a better one
_QUALITY = 80
_REMEDY = "run it again"
_BROKEN = (
    OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, CalibrationError,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class PreviewPicture:
    """A small left image (JPEG, `size_px` wide and high at most as it came) and N features in it.

    `pixels` and `previous` (N, 2) are those of the full image, now and at the earlier frame of the
    comparison, NaN where not known; `label` and `track_id` (N,) as in `ScenePoints`.
    """

    timestamp_ns: int
    jpeg: bytes
    pixels: FloatArray
    previous: FloatArray
    label: IntArray
    track_id: IntArray


@dataclass(frozen=True, slots=True)
class ObjectView:
    """The largest view of an object so far, as JPEG, and the area of its box, px²."""

    jpeg: bytes
    area_px: float


@dataclass(frozen=True, slots=True)
class Preview:
    """Pictures in order of time, a view of each object by its id, and the left camera."""

    camera: Camera
    pictures: tuple[PreviewPicture, ...]
    views: dict[int, ObjectView]


class PreviewFile:
    """Collects a preview in memory; `close` writes it.

    It is for the report alone: where it cannot be written, that is a warning, and the run goes on.
    """

    def __init__(self, path: Path, camera: Camera) -> None:
        self._path = path
        self._camera = camera
        self._pictures: list[PreviewPicture] = []
        self._views: dict[int, ObjectView] = {}
        self._gap_ns = _LEAST_GAP_NS
        self._closed = False

    def write(self, result: FrameResult) -> None:
        left = left_image(result)
        if left is None:
            return
        self._views = better_views(self._views, left, result.tracks)
        last = self._pictures[-1].timestamp_ns if self._pictures else None
        if last is not None and result.timestamp_ns - last < self._gap_ns:
            return
        self._pictures.append(_picture(result, left))
        if len(self._pictures) > _MOST_PICTURES:
            self._pictures = self._pictures[::2]
            self._gap_ns *= 2

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if not self._pictures:
            return
        try:
            write_preview(self._path, Preview(self._camera, tuple(self._pictures), self._views))
        except OSError as error:
            warnings.warn(
                f"{self._path}: cannot be written: {error.strerror}: the report has no pictures",
                stacklevel=2,
            )


def better_views(
    views: dict[int, ObjectView], left: Image, tracks: Iterable[ObjectTrack]
) -> dict[int, ObjectView]:
    """The views, with those of confirmed tracks that are plainly larger in this image."""
    found = dict(views)
    for track in tracks:
        if track.state != "confirmed" or not np.all(np.isfinite(track.box_px)):
            continue
        if track.track_id not in found and len(found) >= _MOST_VIEWS:
            continue
        cut = _cut_out(left, track.box_px)
        best = found.get(track.track_id)
        if cut.size and (best is None or cut.size > _GROWTH * best.area_px):
            found[track.track_id] = ObjectView(_jpeg(_fitted(cut, _VIEW_SIZE)), float(cut.size))
    return found


def write_preview(path: Path, preview: Preview) -> None:
    """Write a preview; raises `OSError`."""
    camera, pictures, views = preview.camera, preview.pictures, preview.views
    arrays: dict[str, Any] = {
        "camera_size": np.array([camera.width, camera.height]),
        "camera_model": np.array(camera.model.name),
        "camera_intrinsics": camera.intrinsics,
        "camera_distortion": camera.distortion,
        "timestamp_ns": np.array([p.timestamp_ns for p in pictures], dtype=np.int64),
        "n_points": np.array([len(p.label) for p in pictures], dtype=np.int64),
        "pixels": np.concatenate([p.pixels for p in pictures]).astype(np.float32),
        "previous": np.concatenate([p.previous for p in pictures]).astype(np.float32),
        "label": np.concatenate([p.label for p in pictures]).astype(np.int64),
        "track_id": np.concatenate([p.track_id for p in pictures]).astype(np.int64),
        "view_track": np.array(list(views), dtype=np.int64),
        "view_area": np.array([view.area_px for view in views.values()]),
    }
    arrays |= _packed("jpeg", [p.jpeg for p in pictures])
    arrays |= _packed("view_jpeg", [view.jpeg for view in views.values()])
    try:
        with path.open("xb") as file:
            np.savez(file, **arrays)
    except OSError:
        path.unlink(missing_ok=True)  # half a file is none
        raise


def read_preview(path: Path) -> Preview:
    """A preview read back; raises `InputError` for a file that is none."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return _preview({name: file[name] for name in file.files})
    except _BROKEN as error:
        raise InputError.at(path, f"is no preview of a run: {error}", _REMEDY) from None


def _preview(arrays: dict[str, Any]) -> Preview:
    intrinsics = arrays["camera_intrinsics"].tolist()
    camera = Camera.make(
        tuple(arrays["camera_size"].tolist()), (intrinsics[0], intrinsics[1]),
        (intrinsics[2], intrinsics[3]), str(arrays["camera_model"]), arrays["camera_distortion"],
        intrinsics[4],
    )  # fmt: skip
    stamps = arrays["timestamp_ns"].tolist()
    ends = np.cumsum(arrays["n_points"])[:-1]
    columns = [np.split(arrays[name], ends) for name in ("pixels", "previous", "label", "track_id")]
    jpegs = _unpacked("jpeg", arrays)
    views = zip(_unpacked("view_jpeg", arrays), arrays["view_area"].tolist(), strict=True)
    return Preview(
        camera,
        tuple(
            PreviewPicture(stamp, jpeg, pixels.astype(np.float64), previous.astype(np.float64),
                           label, track_id)
            for stamp, jpeg, pixels, previous, label, track_id in zip(
                stamps, jpegs, *columns, strict=True)
        ),
        {
            track: ObjectView(jpeg, area)
            for track, (jpeg, area) in zip(arrays["view_track"].tolist(), views, strict=True)
        },
    )  # fmt: skip


def decoded(jpeg: bytes) -> Image:
    """A grey image (height, width) of a JPEG; raises `InputError` for bytes that are none."""
    data = np.frombuffer(jpeg, dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    if image is None:
        raise InputError(f"{PREVIEW_FILE}: holds a broken picture; {_REMEDY}")
    return np.asarray(image, dtype=np.uint8)


def _picture(result: FrameResult, left: Image) -> PreviewPicture:
    points = result.points
    seen = np.isfinite(points.pixels[:, 0])
    small = left
    if left.shape[1] > _WIDTH:
        size = (_WIDTH, max(1, round(left.shape[0] * _WIDTH / left.shape[1])))
        small = np.asarray(cv2.resize(left, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return PreviewPicture(
        result.timestamp_ns, _jpeg(small), points.pixels[seen, :2], points.previous[seen],
        points.label[seen], points.track_id[seen],
    )  # fmt: skip


def _cut_out(left: Image, box_px: FloatArray) -> Image:
    """The part of the image (height, width) in a box with a tenth more on each side."""
    u0, v0, u1, v1 = box_px
    du, dv = 0.1 * (u1 - u0) + 2.0, 0.1 * (v1 - v0) + 2.0
    height, width = left.shape
    columns = np.clip(np.rint([u0 - du, u1 + du]), 0, width).astype(np.int64)
    rows = np.clip(np.rint([v0 - dv, v1 + dv]), 0, height).astype(np.int64)
    return left[rows[0] : rows[1], columns[0] : columns[1]]


def _fitted(image: Image, most: tuple[int, int]) -> Image:
    """The image no wider and no higher than that; small ones stay as they are."""
    share = min(most[0] / image.shape[1], most[1] / image.shape[0], 1.0)
    if share == 1.0:
        return image
    size = max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _jpeg(image: Image) -> bytes:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes()


def _packed(name: str, parts: list[bytes]) -> dict[str, Any]:
    """Byte strings as one array, and where each ends."""
    return {
        name: np.frombuffer(b"".join(parts), dtype=np.uint8),
        f"{name}_length": np.array([len(part) for part in parts], dtype=np.int64),
    }


def _unpacked(name: str, arrays: dict[str, Any]) -> list[bytes]:
    data, lengths = arrays[name].tobytes(), arrays[f"{name}_length"]
    if lengths.sum() != len(data):
        raise ValueError(f"{name} is cut off")
    ends = np.cumsum(lengths).tolist()
    return [data[end - n : end] for end, n in zip(ends, lengths.tolist(), strict=True)]
