"""Each fault changes what it says, in its span, and nothing else."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.registry import open_sequence
from ovmot.errors import DatasetError, InputError
from ovmot.geometry.arrays import FloatArray
from ovmot.sim.faults import FAULTS, InjectedFault, Span, with_faults, with_injected
from ovmot.types import Event, FeatureFrame, ImuSample, StereoFrame

FRAME_NS, IMU_NS, START_NS = 100_000_000, 10_000_000, 10**18
SPAN = Span(START_NS + 10 * FRAME_NS, START_NS + 20 * FRAME_NS)


def events(features: bool = False) -> list[Event]:
    """Three seconds, each image grey by its number, each sample by its own."""
    out: list[Event] = []
    for k in range(300):
        stamp = START_NS + IMU_NS * k
        out.append(ImuSample(stamp, np.array([k, 0.0, 0.0]), np.array([0.0, 0.0, 9.81])))
        if k % 10 == 0:
            number = k // 10
            image = np.full((4, 6), number, dtype=np.uint8)
            pixels = np.full((5, 4), float(number))
            out.append(
                FeatureFrame(stamp, np.arange(5), pixels)
                if features
                else StereoFrame(stamp, image, image + 100)
            )
    return out


def spoilt(name: str, features: bool = False) -> list[Event]:
    return list(with_injected(events(features), [InjectedFault(name, SPAN, 3)]))


def frames(some: Iterable[Event]) -> list[StereoFrame]:
    return [e for e in some if isinstance(e, StereoFrame)]


def numbers(some: Iterable[Event]) -> list[int]:
    return [(f.timestamp_ns - START_NS) // FRAME_NS for f in some if not isinstance(f, ImuSample)]


def samples(some: Iterable[Event]) -> list[ImuSample]:
    return [e for e in some if isinstance(e, ImuSample)]


@pytest.mark.parametrize("name", sorted(FAULTS.keys() - {"reader_fails"}))
@pytest.mark.parametrize("features", [False, True])
def test_nothing_changes_before_the_fault_and_the_same_seed_is_the_same_fault(
    name: str, features: bool
) -> None:
    plain = events(features)
    first, second = spoilt(name, features), spoilt(name, features)
    before = [e.timestamp_ns for e in plain if e.timestamp_ns < SPAN.begin_ns]
    assert [e.timestamp_ns for e in first][: len(before)] == before
    assert [e.timestamp_ns for e in first] == [e.timestamp_ns for e in second]
    if not name.startswith("clock"):
        after = [e.timestamp_ns for e in plain if e.timestamp_ns > SPAN.end_ns + FRAME_NS]
        assert [e.timestamp_ns for e in first][-len(after) :] == after


def test_lost_late_and_repeated_frames() -> None:
    inside = list(range(10, 20))
    assert numbers(spoilt("no_frames")) == [*range(10), *range(20, 30)]
    lost = set(inside) - set(numbers(spoilt("dropped_frames")))
    assert 1 <= len(lost) <= 9
    late = numbers(spoilt("late_frames"))
    assert late[10:15] == [10, 11, 13, 12, 14]
    assert sorted(late) == list(range(30))
    assert numbers(spoilt("duplicated_frames"))[10:14] == [10, 10, 11, 11]


def test_images_that_lie() -> None:
    def left(name: str, number: int) -> list[int]:
        return [int(grey) for grey in frames(spoilt(name))[number].left[:, 0]]

    assert left("frozen_images", 15) == [9] * 4
    assert left("frozen_images", 20) == [20] * 4
    assert left("torn_images", 15) == [14, 14, 15, 15]
    assert left("black_images", 15) == [0] * 4
    assert left("white_images", 15) == [255] * 4
    assert left("overexposed_images", 15) == [45] * 4
    assert frames(spoilt("overexposed_images"))[15].pair[1].max() == 255
    assert left("underexposed_images", 10) == [3] * 4
    for name, side in (("left_gone", 0), ("right_gone", 1)):
        frame = frames(spoilt(name))[15]
        assert frame.missing == (side,)
        assert frame.pair[side].max() == 0 < frame.pair[1 - side].max()


def test_features_of_one_camera_and_of_none() -> None:
    def pixels(name: str) -> FloatArray:
        (found,) = [
            e for e in spoilt(name, features=True)
            if isinstance(e, FeatureFrame) and e.timestamp_ns == START_NS + 15 * FRAME_NS
        ]  # fmt: skip
        return found.pixels

    assert len(pixels("black_images")) == 0
    assert np.isnan(pixels("left_gone")[:, :2]).all()
    assert np.isfinite(pixels("left_gone")[:, 2:]).all()
    assert np.isnan(pixels("right_gone")[:, 2:]).all()


def test_spoilt_imu_samples() -> None:
    assert len(samples(spoilt("imu_gap"))) == 200
    spikes = [
        s.timestamp_ns
        for s, good in zip(samples(spoilt("imu_spikes")), samples(events()), strict=True)
        if not (np.array_equal(s.gyro, good.gyro) and np.array_equal(s.accel, good.accel))
    ]
    assert 1 <= len(spikes) <= 15
    assert all(stamp in SPAN for stamp in spikes)
    ends = [np.deg2rad(250.0)] * 3 + [19.62] * 3
    saturated = samples(spoilt("imu_saturated"))[100:105]
    values = np.array([[*s.gyro, *s.accel] for s in saturated])
    assert np.all(np.isclose(np.abs(values), ends), axis=0).any()
    assert len(samples(spoilt("imu_repeated"))) == 400
    stamps = np.array([s.timestamp_ns for s in samples(spoilt("imu_backward"))])
    assert np.count_nonzero(np.diff(stamps) < 0) == 10


def test_clocks_and_the_reader() -> None:
    stamps = np.array([e.timestamp_ns for e in spoilt("clock_back")])
    assert np.diff(stamps).min() == IMU_NS - 500_000_000
    with pytest.raises(DatasetError, match="cannot be read"):
        spoilt("reader_fails")
    with pytest.raises(InputError, match="fault rust: unknown; choose one of dropped_frames"):
        InjectedFault("rust", SPAN).into([])


def test_a_recorded_sequence_with_faults_is_one(painted_euroc: Path) -> None:
    sequence = open_sequence(painted_euroc)
    span = Span(int(sequence.frame_ns[4]), int(sequence.frame_ns[6]))
    faulty = with_faults(sequence, InjectedFault("no_frames", span))
    assert (faulty.kind, faulty.root, len(faulty)) == ("euroc", sequence.root, 12)
    assert len(frames(faulty)) == 10
    assert len(frames(faulty.events(3, 6))) == 2
