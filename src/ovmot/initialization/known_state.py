"""Initialization by a known state: for simulations, where the truth is at hand."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, empty_table
from ovmot.settings import Settings
from ovmot.types import FrontendFrame, ImuNoise
from ovmot.vio.filter import MsckfFilter, with_online_calibration
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import (
    ACCEL_BIAS,
    GYRO_BIAS,
    N_BASE,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    ImuState,
    State,
    no_clones,
)


@dataclass(frozen=True, slots=True)
class InitialSigmas:
    """Standard deviations of a known initial state: rad, m, m/s, rad/s, m/s².

    Position and heading are not observable: their initial covariance stays, and lowers every later
    NEES.
    """

    rotation: float = 1e-3
    position: float = 1e-3
    velocity: float = 1e-2
    gyro_bias: float = 1e-3
    accel_bias: float = 1e-2


OPENVINS_SIGMAS = InitialSigmas(
    rotation=0.017, position=0.05, velocity=0.01, gyro_bias=0.02, accel_bias=0.02
)
"""What OpenVINS 2.6 assumes when its simulator initializes it by the truth; for comparison."""


@dataclass(frozen=True, slots=True)
class KnownStateInitializer:
    """Initializes a filter whose state at the frame `timestamp_ns` is `imu`.

    The state, biases included, is taken as given; `sigmas` makes its covariance, no error is drawn.
    The world is that of this state: heading and position need no alignment afterwards.
    """

    timestamp_ns: int
    imu: ImuState
    sigmas: InitialSigmas
    rig: StereoRig
    noise: ImuNoise
    settings: Settings

    def imu_time_ns(self, frame_ns: int) -> int:
        """A frame's time on the IMU's clock, by the calibration's time offset."""
        return frame_ns + round(self.rig.time_offset_s * 1e9)

    def imu_needed_until(self, frame_ns: int) -> int | None:
        """The IMU time that must be reached before this frame can be used."""
        return self.imu_time_ns(frame_ns)

    def __call__(
        self, frames: Sequence[FrontendFrame], imu: ImuBuffer
    ) -> tuple[MsckfFilter, FeatureTable] | str:
        """A filter at the first frame's time and an empty table, or why there is none."""
        first_ns = frames[0].timestamp_ns
        if first_ns != self.timestamp_ns:
            return f"the known state is at {self.timestamp_ns} ns, the first frame at {first_ns} ns"
        settings = self.settings.filter
        variance = np.zeros(N_BASE)
        variance[THETA] = self.sigmas.rotation**2
        variance[POSITION] = self.sigmas.position**2
        variance[VELOCITY] = self.sigmas.velocity**2
        variance[GYRO_BIAS] = self.sigmas.gyro_bias**2
        variance[ACCEL_BIAS] = self.sigmas.accel_bias**2
        if settings.estimate_time_offset:
            variance[TIME_OFFSET] = settings.time_offset_sigma_s**2
        state = State(
            self.imu_time_ns(first_ns), self.imu, self.imu, self.rig.time_offset_s,
            no_clones(), np.diag(variance),
        )  # fmt: skip
        state = with_online_calibration(state, self.rig, self.settings)
        return MsckfFilter(state, self.rig, self.noise, self.settings), empty_table()
