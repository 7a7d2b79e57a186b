"""The accelerometer against stereo displacements of a known path."""

from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.doctor.camera_rotations import CameraRotations
from ovmot.doctor.locations import Locations
from ovmot.doctor.report import Finding, Severity
from ovmot.doctor.stereo_scale import check_scale, fit_scale
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.sim.rigs import street_rig
from ovmot.types import ImuData

ORIGIN_NS = 1_500_000_000_000_000_000
RIG = street_rig()
GRAVITY = np.array([0.0, 0.0, 9.81])


def position(t: FloatArray, size: float) -> FloatArray:
    """Of the IMU in world (N, 3), m."""
    wave = np.sin(2.0 * t[:, None] + [0.0, 1.0, 2.0]) * [1.0, 0.7, 0.3]
    return np.asarray(size * wave + np.array([4.0, 0.5, 0.0]) * t[:, None])


def rotation(t: FloatArray, turning: float) -> FloatArray:
    """R_world_imu (N, 3, 3)."""
    return so3.exp(turning * np.sin(1.3 * t[:, None] + [0.5, 1.0, 0.0]))


def recorded(
    size: float = 0.5, accel_scale: float = 1.0, turning: float = 0.3
) -> tuple[CameraRotations, ImuData]:
    """Three seconds at 10 Hz, with the noise of stereo and of an IMU with biases."""
    rng = np.random.default_rng(2)
    t, h = np.arange(-0.5, 3.6, 0.005), 1e-4
    R = rotation(t, turning)
    turned = np.swapaxes(rotation(t - h, turning), 1, 2) @ rotation(t + h, turning)
    gyro = so3.log(turned) / (2.0 * h) + np.array([0.02, -0.05, 0.03])
    force = (position(t + h, size) - 2.0 * position(t, size) + position(t - h, size)) / h**2
    accel = np.einsum("nji,nj->ni", R, force + GRAVITY) + rng.normal(0.0, 0.03, (len(t), 3))
    imu_ns = ORIGIN_NS + np.round(1e9 * t).astype(np.int64)
    at = np.arange(0.0, 3.05, 0.1)
    T = se3.make(rotation(at, turning), position(at, size)) @ RIG.T_imu_cam0
    steps = se3.inverse(T[:-1]) @ T[1:]
    ns = ORIGIN_NS + np.round(1e9 * at).astype(np.int64)
    noise = rng.normal(0.0, 1.0, (2, len(steps), 3))
    turns = CameraRotations(
        ns[:-1], ns[1:], so3.log(steps[:, :3, :3]) + 3e-4 * noise[0],
        steps[:, :3, 3] + 5e-3 * noise[1],
    )  # fmt: skip
    return turns, ImuData(imu_ns, gyro, accel_scale * accel)


def found(turns: CameraRotations, imu: ImuData, rig: StereoRig = RIG) -> Finding:
    period_s = 1e-9 * float(np.median(np.diff(imu.timestamp_ns)))
    return check_scale(fit_scale(turns, imu, rig, 0.0), rig, period_s, Locations())


def test_the_factor_is_one() -> None:
    turns, imu = recorded()
    scale = fit_scale(turns, imu, RIG, 0.0)
    assert scale is not None
    assert abs(scale.factor - 1.0) < 4.0 * scale.std < 0.06
    assert found(turns, imu).severity is Severity.FINE


@pytest.mark.parametrize("factor", [0.7, 0.9, 1.1, 1.4])
def test_a_wrong_baseline(factor: float) -> None:
    turns, imu = recorded()
    says = found(replace(turns, translation=factor * turns.translation), imu)
    assert says.check == "stereo scale"
    assert says.severity is (Severity.WRONG if factor in (0.7, 1.4) else Severity.DOUBTFUL)
    assert not says.fix


def test_a_negated_accelerometer() -> None:
    says = found(*recorded(accel_scale=-1.0))
    assert (says.check, says.severity) == ("accelerometer sign", Severity.WRONG)
    assert says.fix == {"recording.accel_scale": -1.0}


def test_an_even_drive_tells_nothing() -> None:
    turns, imu = recorded(size=0.0, turning=0.01)
    assert found(turns, imu).severity is Severity.UNKNOWN


def test_a_lag_is_taken_off() -> None:
    turns, imu = recorded()
    late = replace(imu, timestamp_ns=imu.timestamp_ns + 200_000_000)
    right, wrong = (fit_scale(turns, late, RIG, offset_s) for offset_s in (0.2, 0.0))
    assert right is not None and wrong is not None
    assert abs(right.factor - 1.0) < 0.03 < abs(wrong.factor - 1.0)


def test_frames_that_the_images_do_not_tell() -> None:
    turns, imu = recorded()
    blind = turns.rotation.copy()
    blind[[5, 14, 22]] = np.nan
    assert found(replace(turns, rotation=blind), imu).severity is Severity.UNKNOWN
