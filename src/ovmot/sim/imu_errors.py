"""Systematic errors of a real IMU: scale, misalignment, g-sensitivity, range, lost samples."""

from dataclasses import dataclass, field

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.types import ImuData


def _identity() -> FloatArray:
    return np.eye(3)


def _zero() -> FloatArray:
    return np.zeros((3, 3))


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """Systematic errors of an IMU; as made without arguments, it has none.

    With the true rate ω and specific force f in the IMU's frame it reads

        gyro = M_g ω + G_a f + bias + noise        accel = M_a f + bias + noise

    `gyro_matrix` is M_g and `accel_matrix` M_a, scale factors on the diagonal and misalignment
    beside it; `g_sensitivity` G_a is in rad/s per m/s² (J. Rehder et al., "Extending kalibr", ICRA
    2016, with the sensors' rotations within M). Readings end at ±`gyro_range` rad/s and
    ±`accel_range` m/s². `dropped_share` of all samples are missing, each for itself, and so are all
    samples of bursts `burst_s` long that begin `bursts_per_s` times a second on average.
    """

    gyro_matrix: FloatArray = field(default_factory=_identity)
    accel_matrix: FloatArray = field(default_factory=_identity)
    g_sensitivity: FloatArray = field(default_factory=_zero)
    gyro_range: float = np.inf
    accel_range: float = np.inf
    dropped_share: float = 0.0
    bursts_per_s: float = 0.0
    burst_s: float = 0.0

    def __post_init__(self) -> None:
        """Raises `ValueError` for values that no IMU can have."""
        for matrix in (self.gyro_matrix, self.accel_matrix, self.g_sensitivity):
            if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
                raise ValueError("the IMU's error matrices are finite and 3x3")
        if not 0.0 <= self.dropped_share < 1.0:
            raise ValueError(f"a share of {self.dropped_share:g} dropped samples is not in [0, 1)")
        if min(self.bursts_per_s, self.burst_s) < 0.0:
            raise ValueError("bursts of dropped samples can not be negative")
        if not min(self.gyro_range, self.accel_range) > 0.0:
            raise ValueError("an IMU's range is positive")

    @classmethod
    def random(
        cls,
        rng: np.random.Generator,
        *,
        scale: float = 0.01,
        misalignment_rad: float = 0.005,
        g_sensitivity: float = 1e-4,
        dropped_share: float = 0.0,
    ) -> "ImuErrors":
        """Errors drawn with these standard deviations; typical of consumer MEMS sensors.

        Misalignments of the accelerometer are lower triangular: its x axis defines the IMU's, and
        those of the gyro are full, since they hold its rotation against the accelerometer.
        """

        def off_diagonal() -> FloatArray:
            angles = rng.normal(0.0, misalignment_rad, (3, 3))
            return np.asarray(angles - np.diag(np.diag(angles)))

        gyro = np.diag(1.0 + rng.normal(0.0, scale, 3)) + off_diagonal()
        accel = np.diag(1.0 + rng.normal(0.0, scale, 3)) + np.tril(off_diagonal())
        sensitivity = rng.normal(0.0, g_sensitivity, (3, 3))
        return cls(gyro, accel, sensitivity, dropped_share=dropped_share)

    @property
    def any(self) -> bool:
        """Whether it differs from an IMU without such errors."""
        matrices = (self.gyro_matrix, self.accel_matrix, self.g_sensitivity)
        wanted = (np.eye(3), np.eye(3), np.zeros((3, 3)))
        bent = any(np.any(m != w) for m, w in zip(matrices, wanted, strict=True))
        limited = np.isfinite(self.gyro_range) or np.isfinite(self.accel_range)
        return bool(bent or limited or self.dropped_share or self.bursts_per_s * self.burst_s)

    def distorted(self, perfect: ImuData) -> ImuData:
        """Samples after scale, misalignment and g-sensitivity."""
        gyro = perfect.gyro @ self.gyro_matrix.T + perfect.accel @ self.g_sensitivity.T
        return ImuData(perfect.timestamp_ns, gyro, perfect.accel @ self.accel_matrix.T)

    def saturated(self, data: ImuData) -> ImuData:
        """Samples cut to the sensors' ranges."""
        gyro = np.clip(data.gyro, -self.gyro_range, self.gyro_range)
        accel = np.clip(data.accel, -self.accel_range, self.accel_range)
        return ImuData(data.timestamp_ns, gyro, accel)

    def kept(self, timestamp_ns: IntArray, rng: np.random.Generator) -> BoolArray:
        """Which samples (N,) arrive. The first and the last one always do."""
        keep = np.asarray(rng.uniform(size=len(timestamp_ns)) >= self.dropped_share)
        if self.bursts_per_s * self.burst_s > 0.0 and len(timestamp_ns):
            seconds = 1e-9 * (timestamp_ns - timestamp_ns[0])
            count = rng.poisson(self.bursts_per_s * seconds[-1])
            begin = np.sort(rng.uniform(0.0, seconds[-1], count))
            latest = np.searchsorted(begin, seconds, side="right") - 1
            since = seconds - np.concatenate([begin, [-np.inf]])[latest]
            keep &= ~((since >= 0.0) & (since < self.burst_s))
        keep[:1] = keep[-1:] = True
        return keep


NO_ERRORS = ImuErrors()
