"""Past paths and boxes of the tracks, and what of them a camera sees."""

from dataclasses import dataclass, field

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.boxes import box_corners
from ovmot.types import FrameResult, ObjectTrack

TRAIL_S = 4.0
"""How much of a track's way is shown."""
_NEAREST_M = 0.3  # what is nearer to the camera's plane is cut off
_MOST_GAP_M = 8.0  # a longer step of a trail would be a line across the image
_SAMPLES = 12  # along an edge, which the distortion bends into a curve
_EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)])
_FRONT = np.array([(4, 7), (5, 6)])  # a cross on the side that the body moves towards


@dataclass(frozen=True, slots=True)
class Trails:
    """Past positions of the confirmed tracks: times (ns) and positions in the world, last seconds.

    `segment` is the run's: positions before a restart belong to another world. `start_ns` is the
    stamp of the first frame.
    """

    segment: int = 0
    start_ns: int | None = None
    points: dict[int, tuple[tuple[int, FloatArray], ...]] = field(default_factory=dict)

    def extended(self, result: FrameResult) -> "Trails":
        """The trails with a further frame, without what is older than `TRAIL_S`."""
        before = self.points if result.segment == self.segment else {}
        since = result.timestamp_ns - round(1e9 * TRAIL_S)
        now = {t.track_id: t.position for t in result.tracks if t.state == "confirmed"}
        points = {}
        for track_id in dict.fromkeys((*before, *now)):
            kept = tuple(p for p in before.get(track_id, ()) if p[0] >= since)
            new = ((result.timestamp_ns, now[track_id]),) if track_id in now else ()
            if kept or new:
                points[track_id] = (*kept, *new)
        start_ns = result.timestamp_ns if self.start_ns is None else self.start_ns
        return Trails(result.segment, start_ns, points)

    def seconds(self, timestamp_ns: int) -> float:
        """Seconds since the first frame."""
        return 0.0 if self.start_ns is None else 1e-9 * (timestamp_ns - self.start_ns)

    def of(self, track_id: int) -> FloatArray:
        """Positions (K, 3) of a track, the oldest first."""
        positions = [p for _, p in self.points.get(track_id, ())]
        return np.array(positions, dtype=np.float64).reshape(-1, 3)


def moved_ways(trail: FloatArray) -> FloatArray:
    """The steps (M, 2, 3) between successive positions (K, 3) of a trail, without jumps."""
    ways = np.stack([trail[:-1], trail[1:]], axis=1)
    return np.asarray(ways[np.linalg.norm(ways[:, 1] - ways[:, 0], axis=1) < _MOST_GAP_M])


def body_edges(track: ObjectTrack) -> FloatArray:
    """Ends (14, 2, 3) in the world of the edges of a track's box and of the cross on its front."""
    corners = box_corners(track.position, track.size, track.yaw)
    return np.asarray(corners[np.concatenate([_EDGES, _FRONT])])


def seen_pieces(ends: FloatArray, T_cam0_world: FloatArray, camera: Camera) -> FloatArray:
    """Pixels (M, 2, 2) of the pieces of straight lines (N, 2, 3) in the world that are seen.

    A piece is left out where it is behind the camera, out of the image, or where the camera model
    has folded back.
    """
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    points = ends[:, None, 0] * (1.0 - share) + ends[:, None, 1] * share
    p = se3.apply(T_cam0_world, points)
    z = np.where(p[..., 2:] > _NEAREST_M, p[..., 2:], np.nan)
    xy = p[..., :2] / z
    uv = camera.denormalize(xy)
    margin = 0.1 * camera.width
    good = camera.inside(uv, -margin)
    back = camera.normalize(np.where(good[..., None], uv, np.nan))
    good &= np.max(np.abs(back - xy), axis=-1) < 1e-3
    pieces = np.stack([uv[:, :-1], uv[:, 1:]], axis=2)
    return np.asarray(pieces[good[:, :-1] & good[:, 1:]])
