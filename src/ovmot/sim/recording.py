"""A rendered simulation as a sequence to be written: its IMU samples, frames and truth."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.truth import TrueObjects
from ovmot.datasets.writing import FrameToWrite, ImuToWrite, SequenceToWrite
from ovmot.geometry.arrays import Image, IntArray
from ovmot.sim.imu import SimulatedImu, simulated_imu
from ovmot.sim.render import render_stereo
from ovmot.sim.simulation import Simulation

_IMU_LEAD_S, _IMU_TAIL_S = 0.5, 0.3


def record(simulation: Simulation, seed: int) -> SequenceToWrite:
    """The simulation as the writers of `ovmot.datasets` take it.

    `seed` starts the noise of images and IMU: the same simulation and seed give the same sequence.
    Frames are rendered when they are asked for.
    """
    imu = imu_samples(simulation, generators(seed)[1])

    def frames(rig: StereoRig) -> Iterator[FrameToWrite]:
        return _frames(replace(simulation, rig=rig), generators(seed)[0])

    return SequenceToWrite(
        simulation.rig,
        simulation.camera_ns,
        simulation.path,
        simulation.T_vehicle_imu,
        ImuToWrite(
            imu.data, imu.gyro_bias, imu.accel_bias, simulation.imu.rate_hz, simulation.imu.noise,
            _imu_errors(simulation),
        ),
        frames,
    )  # fmt: skip


def generators(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Generators of the images' noise and of the IMU's, independent of each other."""
    images, imu = np.random.SeedSequence(seed).spawn(2)
    return np.random.default_rng(images), np.random.default_rng(imu)


def imu_times(simulation: Simulation) -> IntArray:
    """IMU stamps (N,) in ns by the IMU's clock, from before the first image to after the last.

    Without a time offset one of them is the first image's.
    """
    first, last = int(simulation.camera_ns[0]), int(simulation.camera_ns[-1])
    period_ns = round(1e9 / simulation.imu.rate_hz)
    first += period_ns * round(1e9 * simulation.rig.time_offset_s / period_ns)
    last += round(1e9 * simulation.rig.time_offset_s)
    before = int(_IMU_LEAD_S * simulation.imu.rate_hz)
    count = before + (last - first) // period_ns + int(_IMU_TAIL_S * simulation.imu.rate_hz) + 1
    return first + period_ns * (np.arange(count, dtype=np.int64) - before)


def imu_samples(simulation: Simulation, rng: np.random.Generator) -> SimulatedImu:
    """The samples that the sequence's IMU file holds."""
    return simulated_imu(
        simulation.path, imu_times(simulation), simulation.imu, rng,
        time_offset_s=simulation.rig.time_offset_s,
    )  # fmt: skip


def true_objects(simulation: Simulation, timestamp_ns: int, object_id: Image) -> TrueObjects:
    """The movers at one time; `object_id` (H, W) is the left camera's image of their ids."""
    states = [mover.state(timestamp_ns) for mover in simulation.scene.movers]
    visible = np.bincount(object_id.ravel(), minlength=256)
    ids = np.array([state.object_id for state in states], dtype=np.int64)
    return TrueObjects(
        timestamp_ns,
        ids,
        np.array([state.center for state in states]).reshape(-1, 3),
        np.array([state.yaw for state in states], dtype=np.float64),
        np.array([state.size for state in states]).reshape(-1, 3),
        np.array([state.velocity for state in states]).reshape(-1, 3),
        np.array([state.yaw_rate for state in states], dtype=np.float64),
        visible[ids],
        tuple(state.category for state in states),
    )


def _frames(simulation: Simulation, rng: np.random.Generator) -> Iterator[FrameToWrite]:
    rendered = render_stereo(
        simulation.scene, simulation.rig, simulation.path, simulation.camera_ns,
        simulation.optics, rng,
    )  # fmt: skip
    for frame in rendered:
        left, right = frame.left, frame.right
        objects = true_objects(simulation, frame.frame.timestamp_ns, left.object_id)
        yield FrameToWrite(frame.frame, left.object_id, right.object_id, left.depth, objects)


def _imu_errors(simulation: Simulation) -> dict[str, Any] | None:
    """The IMU's systematic errors, with the names and units of `ImuErrors`; None without any."""
    errors, time_offset_s = simulation.imu.errors, simulation.rig.time_offset_s
    if not errors.any and time_offset_s == 0.0:
        return None
    return {
        "time_offset_s": time_offset_s,
        "gyro_matrix": errors.gyro_matrix.tolist(),
        "accel_matrix": errors.accel_matrix.tolist(),
        "g_sensitivity": errors.g_sensitivity.tolist(),
        "gyro_range": errors.gyro_range,
        "accel_range": errors.accel_range,
        "dropped_share": errors.dropped_share,
        "bursts_per_s": errors.bursts_per_s,
        "burst_s": errors.burst_s,
    }
