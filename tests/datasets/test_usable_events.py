"""What is left out of the events of a run."""

from collections import Counter
from collections.abc import Iterable

import numpy as np
import pytest

from ovmot.datasets.usable_events import usable_events
from ovmot.geometry.arrays import FloatArray
from ovmot.types import Event, FeatureFrame, ImuSample

PERIOD_NS = 5_000_000


def sample(k: int, values: FloatArray | None = None) -> ImuSample:
    values = np.zeros(6) if values is None else values
    return ImuSample(PERIOD_NS * k, values[:3], values[3:])


def frame(k: int) -> FeatureFrame:
    return FeatureFrame(PERIOD_NS * k, np.empty(0, dtype=np.int64), np.empty((0, 4)))


def noisy(n: int, seed: int = 0) -> FloatArray:
    """Readings (n, 6) of a rig that shakes."""
    return np.random.default_rng(seed).normal(0.0, [0.1] * 3 + [1.0] * 3, (n, 6))


def used(events: Iterable[Event]) -> tuple[list[Event], Counter[str]]:
    counts: Counter[str] = Counter()
    return list(usable_events(events, counts, 0.7)), counts


def stamps(events: Iterable[Event], kind: type) -> list[int]:
    return [e.timestamp_ns // PERIOD_NS for e in events if isinstance(e, kind)]


def test_good_events_pass_as_they_are_in_their_order() -> None:
    events: list[Event] = [frame(-1)]
    for k, values in enumerate(noisy(500)):
        events.append(sample(k, values))
        events += [frame(k)] if k % 20 == 0 else []
    out, counts = used([*events, frame(501), frame(502)])
    assert [id(e) for e in out[:-2]] == [id(e) for e in events]
    assert len(out) == len(events) + 2
    assert not counts


def test_stamps_that_do_not_follow_are_left_out_by_kind() -> None:
    order = [0, 1, 1, 3, 2, 4, 5]
    out, counts = used([*(sample(k) for k in order), *(frame(k) for k in order)])
    assert stamps(out, ImuSample) == stamps(out, FeatureFrame) == [0, 1, 3, 4, 5]
    assert counts == {"imu_out_of_order": 2, "frames_out_of_order": 2}


@pytest.mark.parametrize("again_from", [297, 61])
def test_after_the_clock_was_set_back_there_is_a_gap_that_the_odometry_sees(
    again_from: int,
) -> None:
    """It begins with the last sample before and is longer than twice 0.7 s, 280 samples: also
    between frames, whose clock differs from the IMU's by less than that."""
    out, counts = used(map(sample, [*range(301), *range(again_from, 700)]))
    assert stamps(out, ImuSample) == [*range(301), *range(581, 700)]
    late = 301 - again_from
    assert counts == {"clock_set_back": 1, "imu_out_of_order": late, "events_after_clock": 280}


@pytest.mark.parametrize("axis", range(6))
def test_a_value_alone_between_its_neighbours_is_a_spike(axis: int) -> None:
    values = noisy(400)
    values[300, axis] += 200.0
    out, counts = used(sample(k, v) for k, v in enumerate(values))
    assert stamps(out, ImuSample) == [k for k in range(400) if k != 300]
    assert counts == {"imu_spikes": 1}


def test_spikes_to_either_side_in_a_row_are_all_left_out() -> None:
    """As of a link that spoils single values; found in an hour of faults: the attitude went off."""
    values = noisy(400)
    values[300:303, 1] = [30.0, -30.0, 600.0]
    out, counts = used(sample(k, v) for k, v in enumerate(values))
    assert stamps(out, ImuSample) == [*range(300), *range(303, 400)]
    assert counts == {"imu_spikes": 3}


def test_a_jolt_of_several_samples_and_a_new_level_are_none() -> None:
    values = noisy(600)
    values[300:304, 5] += [60.0, 150.0, 110.0, 40.0]
    values[400:, 5] += 100.0
    _, counts = used(sample(k, v) for k, v in enumerate(values))
    assert not counts


def test_after_a_change_of_vibration_only_a_few_samples_are_taken_for_spikes() -> None:
    values = 1e-3 * noisy(1200)
    values[200:] = noisy(1000, 1)
    _, counts = used(sample(k, v) for k, v in enumerate(values))
    assert counts["imu_spikes"] < 10


def test_a_smooth_motion_without_noise_has_no_spikes() -> None:
    t = 5e-3 * np.arange(4000)
    values = np.stack([np.sin(2.0 * t + k) for k in range(6)], axis=1)
    values[:400] = values[400]
    _, counts = used(sample(k, v) for k, v in enumerate(values))
    assert not counts


@pytest.mark.parametrize(("axis", "end"), [(1, -np.deg2rad(250.0)), (5, 19.62), (4, -78.5)])
def test_values_that_stay_at_the_end_of_a_range_are_left_out(axis: int, end: float) -> None:
    values = noisy(400)
    values[300:305, axis] = end
    out, counts = used(sample(k, v) for k, v in enumerate(values))
    assert stamps(out, ImuSample) == [*range(300), *range(305, 400)]
    assert counts == {"imu_saturated": 5}


def test_equal_values_inside_the_range_and_what_is_not_finite() -> None:
    values = np.tile(noisy(1), (50, 1))
    values[20, 2] = np.nan
    out, counts = used(sample(k, v) for k, v in enumerate(values))
    assert len(out) == 49
    assert counts == {"imu_spikes": 1}
