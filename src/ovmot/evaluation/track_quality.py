"""Tracks as wholes: how smoothly they move, which are false, and when they are confirmed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.evaluation.matching import ComparedFrame
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.outputs.run_reader import Tracks

DISTANCES_M = (10.0, 20.0, 30.0, 40.0)
"""Upper ends of the distances by which the latency of confirmation is given."""
_FALSE_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Smoothness:
    """Accelerations (M,) of reported centres and of the true ones at the same times, m/s²."""

    reported: FloatArray
    true: FloatArray


@dataclass(frozen=True, slots=True)
class FalseTracks:
    """How many confirmed tracks lie on no object most of the time, in how many minutes."""

    false: int
    minutes: float

    @property
    def per_minute(self) -> float | None:
        return self.false / self.minutes if self.minutes > 0.0 else None


@dataclass(frozen=True, slots=True)
class Confirmation:
    """Per object that was confirmed: seconds from when it was whole in view, and its distance (m)
    then; `never` were not confirmed."""

    seconds: FloatArray
    distance: FloatArray
    never: int

    def median(self, from_m: float = 0.0, to_m: float = np.inf) -> float | None:
        """Median latency of the objects that were that far, None without any."""
        inside = (self.distance >= from_m) & (self.distance < to_m)
        return float(np.median(self.seconds[inside])) if np.any(inside) else None


def centre_accelerations(frames: Sequence[ComparedFrame]) -> Smoothness:
    """Second differences over three frames in a row in which one track is on one object.

    Both are taken in their own world, so that the rig's true motion does not enter, and the error
    of its estimate does. Frames whose spacing differs by more than a quarter do not count.
    """
    reported: list[float] = []
    true: list[float] = []
    for three in zip(frames, frames[1:], frames[2:], strict=False):
        t = 1e-9 * np.array([f.objects.timestamp_ns - three[1].objects.timestamp_ns for f in three])
        if abs(t[0] + t[2]) > 0.25 * t[2]:
            continue
        rows = [_row_of_pair(frame) for frame in three]
        for pair in rows[0].keys() & rows[1].keys() & rows[2].keys():
            at = [row[pair] for row in rows]
            track = [f.tracks.position[j] for f, (_, j) in zip(three, at, strict=True)]
            centre = [f.objects.center[i] for f, (i, _) in zip(three, at, strict=True)]
            reported.append(_acceleration(track, t))
            true.append(_acceleration(centre, t))
    return Smoothness(np.array(reported), np.array(true))


def count_false_tracks(frames: Sequence[ComparedFrame]) -> FalseTracks:
    """Of the confirmed tracks, those that lie on no true object in most of their frames.

    Objects that need not be found count as objects, and frames in which the data's own rules leave
    a track out do not count.
    """
    there: dict[int, int] = {}
    alone: dict[int, int] = {}
    for frame in frames:
        paired = np.zeros(len(frame.tracks.track_id), dtype=np.bool_)
        paired[frame.pairs[:, 1]] = True
        for track_id in frame.tracks.track_id.tolist():
            there[track_id] = there.get(track_id, 0) + 1
        for track_id in frame.tracks.track_id[frame.counted & ~paired].tolist():
            alone[track_id] = alone.get(track_id, 0) + 1
    false = sum(alone.get(track_id, 0) > _FALSE_SHARE * n for track_id, n in there.items())
    minutes = 1e-9 * (frames[-1].objects.timestamp_ns - frames[0].objects.timestamp_ns) / 60.0
    return FalseTracks(false, minutes)


def confirmed_scalars(tracks: Tracks, timestamp_ns: IntArray) -> dict[str, float | None]:
    """Number of confirmed tracks, and of those a minute of the run's frames (N,), ns.

    Where the truth does not say what moves; in a place where nothing does, all of them are false.
    """
    count = float(len(np.unique(tracks.track_id)))
    minutes = 1e-9 * float(np.ptp(timestamp_ns)) / 60.0
    return {
        "confirmed_tracks": count,
        "confirmed_tracks_per_min": count / minutes if minutes > 0.0 else None,
    }


def confirmation_latency(
    frames: Sequence[ComparedFrame], whole: Sequence[BoolArray]
) -> Confirmation:
    """From the first frame in which an object has to be found and is whole in view.

    `whole` per frame, (N,). The end is the object's first confirmed track; 0 s where it had one
    before.
    """
    since: dict[int, tuple[int, float]] = {}
    found: dict[int, int] = {}
    for frame, in_view in zip(frames, whole, strict=True):
        objects, now = frame.objects, frame.objects.timestamp_ns
        p_body = se3.apply(se3.inverse(frame.T_true), objects.center)
        for row in np.flatnonzero(frame.needed & in_view).tolist():
            distance = float(np.linalg.norm(p_body[row]))
            since.setdefault(int(objects.object_id[row]), (now, distance))
        for object_id in objects.object_id[frame.pairs[:, 0]].tolist():
            found.setdefault(object_id, now)
    both = [object_id for object_id in since if object_id in found]
    late = [1e-9 * max(found[object_id] - since[object_id][0], 0) for object_id in both]
    far = [since[object_id][1] for object_id in both]
    return Confirmation(np.array(late), np.array(far), len(since) - len(both))


def _row_of_pair(frame: ComparedFrame) -> dict[tuple[int, int], tuple[int, int]]:
    """Rows of object and track by their ids, of the frame's pairs."""
    pairs: IntArray = frame.pairs
    return {
        (int(frame.objects.object_id[i]), int(frame.tracks.track_id[j])): (i, j)
        for i, j in pairs.tolist()
    }


def _acceleration(p: Sequence[FloatArray], t: FloatArray) -> float:
    """Norm of the second difference of three places at times t (3,), the middle one at 0."""
    before, after = (p[1] - p[0]) / -t[0], (p[2] - p[1]) / t[2]
    return float(np.linalg.norm((after - before) / (0.5 * (t[2] - t[0]))))
