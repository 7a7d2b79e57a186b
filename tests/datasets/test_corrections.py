"""A recording as the settings correct it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.datasets.corrections import corrected
from ovmot.datasets.imu import BY_UNIT
from ovmot.errors import DatasetError
from ovmot.settings import RecordingSettings, Settings
from ovmot.types import ImuSample, StereoFrame

FRAME_NS = 100_000_000


def test_nothing_to_correct(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    assert corrected(sequence, RecordingSettings()) is sequence


def test_units(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    scaled = corrected(sequence, RecordingSettings(gyro_scale=0.5, accel_scale=-2.0))
    assert sequence.imu is not None and scaled.imu is not None
    np.testing.assert_array_equal(scaled.imu.gyro, 0.5 * sequence.imu.gyro)
    np.testing.assert_array_equal(scaled.imu.accel, -2.0 * sequence.imu.accel)
    samples = [event for event in scaled if isinstance(event, ImuSample)]
    assert samples
    np.testing.assert_array_equal(samples[0].accel, scaled.imu.accel[0])
    assert scaled.settings() == Settings()


def test_a_scale_that_mends_the_unit_takes_its_warning_away(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    assert sequence.imu is not None
    in_g = replace(
        sequence, imu=replace(sequence.imu, accel=sequence.imu.accel / 9.80665),
        counts={**sequence.counts, "imu_units": 1},
        warnings=(*sequence.warnings, f"imu: 1 m/s², {BY_UNIT}: g"),
    )  # fmt: skip
    mended = corrected(in_g, RecordingSettings(accel_scale=9.80665))
    assert (mended.counts, mended.warnings) == (sequence.counts, sequence.warnings)
    other = corrected(in_g, RecordingSettings(accel_scale=2.0))
    assert (other.counts, other.warnings) == (in_g.counts, in_g.warnings)


def test_exchanged_cameras(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    exchanged = corrected(sequence, RecordingSettings(exchange_cameras=True))
    assert exchanged.rig is sequence.rig
    frames, others = ([e for e in s if isinstance(e, StereoFrame)] for s in (sequence, exchanged))
    assert len(frames) == len(others) > 0
    for frame, other in zip(frames, others, strict=True):
        np.testing.assert_array_equal(frame.left, other.right)
        np.testing.assert_array_equal(frame.right, other.left)


def test_a_time_offset_leaves_the_frames_that_the_imu_covers(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    assert sequence.imu is not None
    first_ns = int(sequence.imu.timestamp_ns[0])
    offset_s = 1e-9 * (first_ns - int(sequence.frame_ns[1]))  # frame 1 at the first sample
    moved = corrected(sequence, RecordingSettings(time_offset_s=offset_s))
    assert moved.rig.time_offset_s == offset_s
    assert moved.frame_ns.tolist() == sequence.frame_ns[1:].tolist()
    assert moved.frame_number.tolist() == sequence.frame_number[1:].tolist()
    assert moved.counts["frames_outside_imu"] == 1 + sequence.counts.get("frames_outside_imu", 0)
    (left, right), *_ = moved.pairs(0, 1)
    (same, _), *_ = sequence.pairs(1, 2)
    assert left is not None and right is not None and same is not None
    assert left.where == same.where != right.where
    with pytest.raises(DatasetError, match="do not overlap"):
        corrected(sequence, RecordingSettings(time_offset_s=90.0))


@pytest.mark.parametrize("key", ["gyro_scale", "accel_scale"])
def test_no_scale_is_zero(key: str) -> None:
    with pytest.raises(ValueError, match="must not be 0"):
        RecordingSettings.model_validate({key: 0.0})
