"""Velocities and ids of tracks against the labels, on KITTI tracking with given poses.

    python benchmarks/kitti_velocity.py LABELS.txt POSES.txt RUN TRACK_ID [TRACK_ID ...]

LABELS is the sequence's `label_02` file, POSES the file (12 columns, T_world_cam0) that the run was
given, RUN its folder, the ids those of labelled vehicles. A label's velocity is the slope of a
parabola through its positions in the world, 0.4 s to either side. A track is on a vehicle where the
two stand less than 2.5 m apart on the ground; it counts where the label is nearer than 40 m.
"""

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RANGE_M, NEAR_M, HALF_S = 40.0, 2.5, 0.4
FRAME_NS, FRAME_S = 100_000_000, 0.1
R_RUN_FILE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the world of KITTI's poses (z ahead, y down) into that of a run (x ahead, z up)."""

Positions = dict[int, dict[int, np.ndarray]]


def positions_of(path: Path) -> Positions:
    """Positions (3,) in the left camera by id and frame, of labels or of `objects_kitti.txt`."""
    found: Positions = {}
    for line in path.read_text().splitlines():
        fields = line.split()
        if fields[2] != "DontCare":
            place = np.array([float(x) for x in fields[13:16]])
            found.setdefault(int(fields[1]), {})[int(fields[0])] = place
    return found


def velocities_of(run: Path) -> Positions:
    """Velocities (3,) in the run's world by track id and frame."""
    found: Positions = {}
    with (run / "tracks.csv").open() as rows:
        for row in csv.DictReader(rows):
            velocity = np.array([float(row[name]) for name in ("vx", "vy", "vz")])
            frame = int(row["timestamp_ns"]) // FRAME_NS
            found.setdefault(int(row["track_id"]), {})[frame] = velocity
    return found


def slope(path: dict[int, np.ndarray], frame: int) -> np.ndarray | None:
    """Velocity (3,) at a frame from positions by frame; None where fewer than five are near."""
    near = [f for f in path if abs(f - frame) * FRAME_S <= HALF_S + 1e-9]
    if len(near) < 5:
        return None
    seconds = FRAME_S * (np.array(near) - frame)
    fitted: np.ndarray = np.polyfit(seconds, np.array([path[f] for f in near]), 2)[1]
    return fitted


def nearest(tracked: Positions, place: np.ndarray, frame: int) -> int | None:
    """The track that stands nearest to a place on the ground, None where none is near enough."""
    gaps = {
        track: float(np.linalg.norm((places[frame] - place)[[0, 2]]))
        for track, places in tracked.items() if frame in places
    }  # fmt: skip
    track = min(gaps, key=gaps.__getitem__, default=None)
    return None if track is None or gaps[track] > NEAR_M else track


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A labelled vehicle in a run: frames in range, in which it is tracked, ids of its tracks, and
    pairs of velocities (run's, label's; m/s) where the labels give one."""

    vehicle: int
    frames: int
    tracked: int
    ids: list[int]
    velocities: list[tuple[np.ndarray, np.ndarray]]

    @property
    def off(self) -> list[float]:
        """Differences of the level velocities, m/s."""
        return [float(np.linalg.norm((v - w)[:2])) for v, w in self.velocities]

    @property
    def speed(self) -> float:
        """The label's, median, m/s; NaN without any."""
        speeds = [np.linalg.norm(w) for _, w in self.velocities]
        return float(np.median(speeds)) if speeds else float("nan")


def compared(labels: Path, poses: Path, run: Path, ids: Sequence[int]) -> list[Vehicle]:
    """The labelled vehicles of these ids, held against the run's tracks."""
    T = np.loadtxt(poses).reshape(-1, 3, 4)
    labelled, tracked = positions_of(labels), positions_of(run / "objects_kitti.txt")
    velocity = velocities_of(run)
    found = []
    for vehicle in ids:
        seen = labelled[vehicle]
        world = {f: T[f, :, :3] @ p + T[f, :, 3] for f, p in seen.items()}
        frames = [f for f, p in sorted(seen.items()) if np.linalg.norm(p) < RANGE_M]
        by = {f: nearest(tracked, seen[f], f) for f in frames}
        hits = {f: track for f, track in by.items() if track is not None}
        true = {f: slope(world, f) for f in hits}
        pairs = [
            (velocity[hits[f]][f], R_RUN_FILE @ v) for f, v in true.items() if v is not None
        ]  # fmt: skip
        found.append(Vehicle(vehicle, len(frames), len(hits), sorted(set(hits.values())), pairs))
    return found


def main(labels: Path, poses: Path, run: Path, ids: list[int]) -> None:
    """Print, for each vehicle: frames tracked, by which ids, and the difference of velocity."""
    for found in compared(labels, poses, run, ids):
        print(
            f"vehicle {found.vehicle}: within {RANGE_M:g} m in {found.frames} frames, tracked in"
            f" {found.tracked}, by ids {found.ids}"
        )
        if found.off:
            print(
                f"    velocity differs by {np.median(found.off):.2f} m/s in the median, by"
                f" {max(found.off):.2f} at most; it goes at {found.speed:.1f} m/s"
            )


if __name__ == "__main__":
    if len(sys.argv) < 5:
        sys.exit(__doc__)
    labels, poses, run = (Path(text) for text in sys.argv[1:4])
    main(labels, poses, run, [int(text) for text in sys.argv[4:]])
