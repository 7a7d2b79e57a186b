"""Errors of paired tracks, and how late they come."""

import numpy as np
import pytest
from true_objects import objects_at, tracks_at

from ovmot.evaluation.matching import (
    ComparedFrame,
    ObjectCriteria,
    compare_frame,
)
from ovmot.evaluation.object_errors import detection_latency, pair_errors, pull_out_latency

STAMP = 100


def test_motion_error_and_latency() -> None:
    stamps = [0, 100_000_000, 200_000_000, 300_000_000]
    frames = [
        compare_frame(
            objects_at(10.0 + 6.0 * t * 1e-9, speed=6.0, stamp=t),
            tracks_at(*([10.0 + 6.0 * t * 1e-9] if t >= 200_000_000 else []), stamp=t),
            np.eye(4), np.eye(4), ObjectCriteria(),
        )
        for t in stamps
    ]  # fmt: skip
    latency = detection_latency(frames)
    np.testing.assert_allclose(latency.seconds, [0.2])
    assert latency.never == 0
    errors = pair_errors(frames)
    np.testing.assert_allclose(errors.speed, -1.0)
    np.testing.assert_allclose(errors.motion_m, [0.1])  # 1 m/s too slow for 0.1 s
    np.testing.assert_allclose(errors.motion_rad, 0.0)
    never = detection_latency(frames[:2])
    assert (len(never.seconds), never.never) == (0, 1)


def pulling_out(
    speeds: list[float], *, tracked_from: int, x: float = 12.0, pixels: int = 900
) -> list[ComparedFrame]:
    """Ten frames a second of a car at these speeds, with a track on it from some frame on."""
    return [
        compare_frame(
            objects_at(x, speed=speed, stamp=k * 10**8, pixels=pixels),
            tracks_at(*([x] if k >= tracked_from else []), stamp=k * 10**8),
            np.eye(4), np.eye(4), ObjectCriteria(),
        )
        for k, speed in enumerate(speeds)
    ]  # fmt: skip


PULL_OUT = ObjectCriteria(min_speed_mps=2.0, max_range_m=20.0)


STARTING = [0.0, 0.0, 1.2, 1.9, 2.1, 3.0, 4.0, 5.0]


@pytest.mark.parametrize(("tracked_from", "seconds"), [(7, 0.3), (4, 0.0), (2, 0.0)])
def test_pull_out_latency_counts_from_two_metres_a_second(
    tracked_from: int, seconds: float
) -> None:
    latency = pull_out_latency(pulling_out(STARTING, tracked_from=tracked_from), PULL_OUT)
    np.testing.assert_allclose(latency.seconds, [seconds], atol=1e-9)
    assert latency.never == 0


def test_a_pull_out_without_a_track_is_counted_apart() -> None:
    latency = pull_out_latency(pulling_out(STARTING, tracked_from=99), PULL_OUT)
    assert (len(latency.seconds), latency.never) == (0, 1)


@pytest.mark.parametrize(
    "frames",
    [
        pulling_out([5.0, 5.0, 1.0, 3.0, 5.0], tracked_from=0),  # it came in fast
        pulling_out(STARTING, tracked_from=0, x=25.0),
        pulling_out(STARTING, tracked_from=0, x=-8.0),
        pulling_out(STARTING, tracked_from=0, pixels=300),
        pulling_out([0.0, 1.5, 1.9], tracked_from=0),
    ],
)
def test_what_does_not_pull_out_near_by_has_no_latency(frames: list[ComparedFrame]) -> None:
    latency = pull_out_latency(frames, PULL_OUT)
    assert (len(latency.seconds), latency.never) == (0, 0)
