"""Drift of the estimate while the true rig is stationary, as at a red light."""

from dataclasses import dataclass

import numpy as np

from ovmot.evaluation.trajectory import relative_errors
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray

MAX_SPEED_MPS = 0.05
MAX_RATE_RPS = 0.02
MIN_DURATION_S = 1.0
_BASE_S = 0.2  # motion is taken over this long, so that the truth's own noise is no motion


@dataclass(frozen=True, slots=True)
class StandstillDrift:
    """How far the estimate went from the first to the last pose of one standing interval.

    `duration_s` is between those two poses, `speed_mps` the translation over it.
    """

    start_ns: int
    duration_s: float
    translation_m: float
    rotation_rad: float

    @property
    def speed_mps(self) -> float:
        return self.translation_m / self.duration_s


def standing_intervals(
    timestamp_ns: IntArray,
    T_world_imu: FloatArray,
    max_speed_mps: float = MAX_SPEED_MPS,
    max_rate_rps: float = MAX_RATE_RPS,
    min_duration_s: float = MIN_DURATION_S,
) -> list[tuple[int, int]]:
    """First and last stamp (ns) of each interval of the true poses (N, 4, 4) without motion.

    An interval shorter than `min_duration_s` is none.
    """
    if len(timestamp_ns) < 2:
        return []
    half = round(0.5e9 * _BASE_S)
    last = len(timestamp_ns) - 1
    before = np.maximum(np.searchsorted(timestamp_ns, timestamp_ns - half, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(timestamp_ns, timestamp_ns + half), last)
    seconds = (timestamp_ns[after] - timestamp_ns[before]) * 1e-9
    T_before, T_after = T_world_imu[before], T_world_imu[after]
    moved = np.linalg.norm(T_after[:, :3, 3] - T_before[:, :3, 3], axis=1)
    turn = so3.log(np.swapaxes(T_before[:, :3, :3], -1, -2) @ T_after[:, :3, :3])
    turned = np.linalg.norm(turn, axis=1)
    still = (moved <= max_speed_mps * seconds) & (turned <= max_rate_rps * seconds)
    edges = np.diff(np.concatenate([[0], still.astype(np.int64), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    spans = [
        (int(timestamp_ns[a]), int(timestamp_ns[b])) for a, b in zip(starts, ends, strict=True)
    ]
    return [(a, b) for a, b in spans if b - a >= min_duration_s * 1e9]


def standstill_drift(
    timestamp_ns: IntArray,
    T_reference: FloatArray,
    T_estimate: FloatArray,
    intervals: list[tuple[int, int]],
) -> list[StandstillDrift]:
    """Drift over each interval that holds two of the paired poses (N, 4, 4) at `timestamp_ns`."""
    drifts = []
    for start_ns, end_ns in intervals:
        a = int(np.searchsorted(timestamp_ns, start_ns))
        b = int(np.searchsorted(timestamp_ns, end_ns, side="right")) - 1
        if b <= a:
            continue
        error = relative_errors(T_reference, T_estimate, np.array([a]), np.array([b]))
        drifts.append(
            StandstillDrift(
                start_ns=int(timestamp_ns[a]),
                duration_s=float((timestamp_ns[b] - timestamp_ns[a]) * 1e-9),
                translation_m=float(error.translation[0]),
                rotation_rad=float(error.rotation[0]),
            )
        )
    return drifts
