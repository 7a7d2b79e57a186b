"""Real recordings: nothing is called wrong on good ones, each fault of spoiled ones is named."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ovmot
from ovmot import RecordedSequence
from ovmot.datasets.corrections import corrected
from ovmot.doctor.examine import examine
from ovmot.doctor.report import Severity
from ovmot.doctor.stereo_geometry import moved
from ovmot.geometry import se3
from ovmot.settings import RecordingSettings

DRIVE = "kitti_raw/2011_09_26/2011_09_26_drive_0039_sync"
FOLDERS = (DRIVE, "kitti_tracking", "kaist_sample", "euroc_mh01")
Spoil = Callable[[RecordedSequence], RecordedSequence]


def set_to(**values: float) -> Spoil:
    return lambda sequence: corrected(sequence, RecordingSettings.model_validate(values))


def clock(offset_s: float) -> Spoil:
    def spoil(sequence: RecordedSequence) -> RecordedSequence:
        assert sequence.imu is not None
        ns = sequence.imu.timestamp_ns + round(1e9 * offset_s)
        return replace(sequence, imu=replace(sequence.imu, timestamp_ns=ns))

    return spoil


def turned(axis: int) -> Spoil:
    delta = np.radians(0.5) * np.eye(5)[axis]
    return lambda sequence: replace(sequence, rig=moved(sequence.rig, delta))


def baseline(factor: float) -> Spoil:
    def spoil(sequence: RecordedSequence) -> RecordedSequence:
        T = sequence.rig.T_cam1_cam0.copy()
        T[:3, 3] *= factor
        T_imu_cam1 = sequence.rig.T_imu_cam0 @ se3.inverse(T)
        return replace(sequence, rig=replace(sequence.rig, T_imu_cam1=T_imu_cam1))

    return spoil


FAULTS = {
    "accelerometer unit": set_to(accel_scale=1.0 / 9.80665),
    "gyroscope unit": set_to(gyro_scale=180.0 / np.pi),
    "left and right": set_to(exchange_cameras=True),
    "accelerometer sign": set_to(accel_scale=-1.0),
    "time offset": clock(0.3),
    "stereo scale": baseline(1.25),
}


@pytest.mark.slow
@pytest.mark.parametrize("folder", FOLDERS)
def test_nothing_is_called_wrong(data_root: Path, folder: str) -> None:
    report = examine(ovmot.open(data_root / folder))
    assert [f for f in report.findings if f.severity is Severity.WRONG] == []
    assert {f.check: f.severity for f in report.findings}["extrinsics"] is Severity.FINE


@pytest.mark.slow
@pytest.mark.parametrize("folder", [DRIVE, "euroc_mh01"])
@pytest.mark.parametrize("check", FAULTS)
def test_each_fault_is_named(data_root: Path, folder: str, check: str) -> None:
    report = examine(FAULTS[check](ovmot.open(data_root / folder)))
    assert check in {f.check for f in report.findings if f.severity is Severity.WRONG}


@pytest.mark.slow
@pytest.mark.parametrize("folder", [DRIVE, "euroc_mh01"])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_right_camera_turned_by_half_a_degree(data_root: Path, folder: str, axis: int) -> None:
    report = examine(turned(axis)(ovmot.open(data_root / folder)))
    assert "extrinsics" in {f.check for f in report.findings if f.severity is Severity.WRONG}
