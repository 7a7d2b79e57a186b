"""Tracks as wholes: smoothness, false tracks, latency of confirmation, on tracks made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from true_objects import objects_at, tracks_at

from ovmot.datasets.truth import TrueObjects
from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria, compare_frame
from ovmot.evaluation.objects import evaluate_objects, object_scalars
from ovmot.evaluation.track_quality import (
    centre_accelerations,
    confirmation_latency,
    confirmed_scalars,
    count_false_tracks,
)
from ovmot.outputs.run_reader import Tracks

STEP_NS = 100_000_000


def compared(objects: TrueObjects, tracks: Tracks) -> ComparedFrame:
    return compare_frame(objects, tracks, np.eye(4), np.eye(4), ObjectCriteria())


def way(places: list[float], found: list[float]) -> list[ComparedFrame]:
    """A car at `places` along x, ten frames a second, and its track at `found`."""
    return [
        compared(objects_at(x, stamp=k * STEP_NS), tracks_at(z, stamp=k * STEP_NS))
        for k, (x, z) in enumerate(zip(places, found, strict=True))
    ]


def test_acceleration_of_a_centre_that_brakes_and_of_one_that_jumps() -> None:
    t = 0.1 * np.arange(6)
    places = (10.0 + 8.0 * t - 2.0 * t**2).tolist()
    smooth = centre_accelerations(way(places, [x + 0.3 for x in places]))
    np.testing.assert_allclose(smooth.true, 4.0)
    np.testing.assert_allclose(smooth.reported, 4.0)
    jumped = [*places[:3], *(x + 1.0 for x in places[3:])]
    rough = centre_accelerations(way(places, jumped))
    np.testing.assert_allclose(rough.reported, [4.0, 96.0, 104.0, 4.0])
    assert len(centre_accelerations(way(places[:2], places[:2])).true) == 0


def test_a_new_id_and_a_gap_in_time_begin_anew() -> None:
    frames = way([10.0, 10.5, 11.0, 11.5], [10.0, 10.5, 11.0, 11.5])
    renamed = replace(frames[3].tracks, track_id=np.array([5]))
    changed = [*frames[:3], replace(frames[3], tracks=renamed)]
    assert len(centre_accelerations(changed).reported) == 1
    late = compared(objects_at(12.5, stamp=5 * STEP_NS), tracks_at(12.5, stamp=5 * STEP_NS))
    assert len(centre_accelerations([*frames[:2], late]).reported) == 0


def test_a_track_mostly_on_nothing_is_false() -> None:
    """Track 0 is on the car, 1 in one frame of three, 2 stands alone; they last two seconds."""
    frames = [
        compared(objects_at(10.0, stamp=k * 10 * STEP_NS), tracks_at(*x, stamp=k * 10 * STEP_NS))
        for k, x in enumerate(([10.0, 30.0, -30.0], [10.0, 30.0], [30.0, 10.0]))
    ]
    found = count_false_tracks(frames)
    assert found.false == 2
    assert found.per_minute == pytest.approx(60.0)


def test_false_tracks_are_counted_where_nothing_moves() -> None:
    empty = TrueObjects(
        0, np.empty(0, np.int64), np.empty((0, 3)), np.empty(0), np.empty((0, 3)),
        np.empty((0, 3)), np.empty(0), np.empty(0, np.int64),
    )  # fmt: skip
    frames = tuple(
        compared(
            replace(empty, timestamp_ns=k * STEP_NS),
            tracks_at(*([9.0] if k > 2 else []), stamp=k * STEP_NS),
        )
        for k in range(31)
    )
    found = object_scalars(evaluate_objects(frames, ObjectCriteria()))
    assert found["false_tracks"] == 1.0
    assert found["false_tracks_per_min"] == pytest.approx(20.0)
    assert found["centre_acceleration_ratio"] is None


def test_a_track_on_a_parked_car_is_not_false() -> None:
    frames = [compared(objects_at(10.0, speed=0.0), tracks_at(10.0))]
    found = count_false_tracks(frames)
    assert found.false == 0
    assert found.per_minute is None


def test_confirmed_tracks_of_a_run_without_truth_of_objects() -> None:
    stamps = np.arange(0, 301) * STEP_NS
    found = confirmed_scalars(tracks_at(1.0, 9.0), stamps)
    assert found == {"confirmed_tracks": 2.0, "confirmed_tracks_per_min": pytest.approx(4.0)}


@pytest.mark.parametrize(("found_from", "seconds"), [(5, 0.2), (3, 0.0), (1, 0.0)])
def test_latency_counts_from_when_the_body_is_whole_in_view(
    found_from: int, seconds: float
) -> None:
    frames = [
        compared(
            objects_at(12.0 + k, stamp=k * STEP_NS),
            tracks_at(*([12.0 + k] if k >= found_from else []), stamp=k * STEP_NS),
        )
        for k in range(8)
    ]
    whole = [np.array([k >= 3]) for k in range(8)]
    latency = confirmation_latency(frames, whole)
    np.testing.assert_allclose(latency.seconds, [seconds])
    np.testing.assert_allclose(latency.distance, [np.linalg.norm([15.0, 3.0, 0.8])])
    assert latency.median(10.0, 20.0) == pytest.approx(seconds)
    assert latency.median(20.0, 30.0) is None
    never = confirmation_latency(frames[:1], [np.array([True])])
    assert (len(never.seconds), never.never) == (0, 1 if found_from > 0 else 0)


def test_size_position_and_turn_rate_against_their_sigmas() -> None:
    tracks = tracks_at(10.2)
    tracks = replace(
        tracks, size=np.array([[3.0, 2.2, 1.6]]), yaw=np.array([0.1]), yaw_rate=np.array([0.06]),
        std=np.full((1, 6), 0.1), std_box=np.array([[0.5, 0.1, 0.2, 0.05, 0.03]]),
    )  # fmt: skip
    found = object_scalars(
        evaluate_objects((compared(objects_at(10.0), tracks),), ObjectCriteria())
    )
    assert found["object_size_nees"] == pytest.approx(8.0)  # 2² + 2² + 0²
    assert found["object_position_nees"] == pytest.approx(4.0)
    assert found["object_heading_nees"] == pytest.approx(4.0)
    assert found["object_yaw_rate_nees"] == pytest.approx(4.0)
    assert found["object_position_rmse_m"] == pytest.approx(0.2)
    assert found["two_sides_length_rmse_m"] == pytest.approx(1.0)  # at (10, 3) both are seen
    none = object_scalars(
        evaluate_objects((compared(objects_at(10.0), tracks_at(10.2)),), ObjectCriteria())
    )
    assert none["object_size_nees"] is None
    assert none["object_yaw_rate_nees"] is None
