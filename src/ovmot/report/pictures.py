"""The pictures of a page: overlay frames and views of the objects, as data URIs."""

import base64
from dataclasses import dataclass, field

import cv2
import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, Image
from ovmot.outputs.finished_run import Rows, Run
from ovmot.outputs.objects_overlay import ScenePicture, draw_objects
from ovmot.outputs.preview import PREVIEW_FILE, Preview, PreviewPicture, decoded, read_preview
from ovmot.outputs.trails import TRAIL_S, Trails
from ovmot.report.numbers import grid
from ovmot.report.tracks import columns, object_tracks
from ovmot.types import Health

_WIDTH = 800
_QUALITY = 72


@dataclass(frozen=True, slots=True)
class Pictures:
    """Overlay frames (stamp in ns, data URI) in order of time, and a view of each object by id."""

    frames: tuple[tuple[int, str], ...] = ()
    views: dict[int, str] = field(default_factory=dict)


def pictures_of(run: Run, most_bytes: int) -> Pictures:
    """The pictures of a run, with data URIs of at most so many bytes; none without its preview.

    Where there is no room for all, every other frame is left out, again and again. Raises
    `InputError` for a broken file.
    """
    path = run.folder / PREVIEW_FILE
    if not path.is_file():
        return Pictures()
    preview = read_preview(path)
    views, left = _views(preview, most_bytes // 4)
    return Pictures(_frames(run, preview, left + most_bytes - most_bytes // 4), views)


def _views(preview: Preview, most_bytes: int) -> tuple[dict[int, str], int]:
    """Views of the objects, the largest first, as long as there is room, and the room left."""
    views: dict[int, str] = {}
    for track_id, view in sorted(preview.views.items(), key=lambda item: -item[1].area_px):
        uri = data_uri(view.jpeg)
        if len(uri) > most_bytes:
            break
        most_bytes -= len(uri)
        views[track_id] = uri
    return views, most_bytes


def _frames(run: Run, preview: Preview, most_bytes: int) -> tuple[tuple[int, str], ...]:
    """Frames that fit; the size of a few tells how many that are."""
    pictures = preview.pictures
    few = [_drawn(run, preview, pictures[i]) for i in grid(len(pictures), 3)]
    mean = sum(len(uri) for uri in few) / max(len(few), 1)
    n = min(len(pictures), int(0.9 * most_bytes / max(mean, 1.0)))
    kept, room = [], most_bytes
    for i in grid(len(pictures), n) if n > 1 else ():
        uri = _drawn(run, preview, pictures[i])
        room -= len(uri)
        if room < 0:
            break
        kept.append((pictures[i].timestamp_ns, uri))
    return tuple(kept)


def _drawn(run: Run, preview: Preview, picture: PreviewPicture) -> str:
    scene = _scene(run, preview, picture)
    return data_uri(jpeg(draw_objects(decoded(picture.jpeg), scene, _WIDTH)))


def _scene(run: Run, preview: Preview, picture: PreviewPicture) -> ScenePicture:
    stamp, state = picture.timestamp_ns, run.state
    row = state[min(int(np.searchsorted(state["timestamp_ns"], stamp)), len(state) - 1)]
    speed = np.linalg.norm([row["vx"], row["vy"], row["vz"]])
    first = int(state["timestamp_ns"][0])
    return ScenePicture(
        1e-9 * (stamp - first), float(speed), Health(str(row["health"])), bool(row["standing"]),
        picture.pixels, picture.previous, picture.label, picture.track_id,
        object_tracks(_at(run.tracks, stamp)), _trails(run.tracks, stamp, first),
        _T_cam0_world(row), preview.camera,
    )  # fmt: skip


def _trails(tracks: Rows, stamp: int, first: int) -> Trails:
    """The paths of the last seconds; a jump between segments is no step of a path."""
    since = np.searchsorted(tracks["timestamp_ns"], stamp - round(1e9 * TRAIL_S))
    until = np.searchsorted(tracks["timestamp_ns"], stamp, side="right")
    recent = tracks[since:until]
    recent = recent[recent["state"] == "confirmed"]
    points: dict[int, tuple[tuple[int, FloatArray], ...]] = {}
    for track_id in np.unique(recent["track_id"]).tolist():
        rows = recent[recent["track_id"] == track_id]
        positions = zip(rows["timestamp_ns"].tolist(), columns(rows, "x", "y", "z"), strict=True)
        points[track_id] = tuple(positions)
    return Trails(0, first, points)


def _at(tracks: Rows, stamp: int) -> Rows:
    """The rows of one frame; the table is in order of time."""
    low, high = (np.searchsorted(tracks["timestamp_ns"], stamp, side) for side in ("left", "right"))
    return tracks[low:high]


def _T_cam0_world(row: np.void) -> FloatArray:
    T_world_imu, T_imu_cam0 = (
        se3.make(
            so3.from_quaternion(np.array([float(row[f"{part}q{a}"]) for a in "xyzw"])),
            np.array([float(row[f"{part}{a}"]) for a in "xyz"]),
        )
        for part in ("", "imu_cam0_")
    )
    return se3.inverse(T_world_imu @ T_imu_cam0)


def jpeg(image: Image) -> bytes:
    """A colour image (BGR) as JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes()


def data_uri(data: bytes) -> str:
    """A JPEG as an address that holds it."""
    return "data:image/jpeg;base64," + base64.b64encode(data).decode("ascii")
