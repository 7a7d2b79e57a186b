"""The IMU samples that frames still need, and intervals of them between exact times."""

from bisect import bisect_left, bisect_right

import numpy as np

from ovmot.errors import DatasetError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuData, ImuSample


class ImuBuffer:
    """Samples in time order; `between` interpolates at both ends of an interval."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._rates: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def first_ns(self) -> int | None:
        """Stamp of the oldest sample kept."""
        return self._stamps[0] if self._stamps else None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the newest sample."""
        return self._stamps[-1] if self._stamps else None

    def append(self, sample: ImuSample) -> None:
        """Add a sample; raises `DatasetError` when its stamp does not follow the last one."""
        if self._stamps and sample.timestamp_ns <= self._stamps[-1]:
            raise DatasetError(
                f"IMU stamp {sample.timestamp_ns} does not follow {self._stamps[-1]}:"
                " samples must be in time order"
            )
        self._stamps.append(sample.timestamp_ns)
        self._rates.append(np.concatenate([sample.gyro, sample.accel]))

    def between(
        self, start_ns: int, end_ns: int, *, held_ns: int = 0, also_at_ns: tuple[int, ...] = ()
    ) -> ImuData:
        """Samples from `start_ns` to `end_ns`, both ends interpolated linearly.

        And those `also_at_ns`, times inside the interval. The newest sample is held for `held_ns`
        at most. Raises `DatasetError` when the buffer does not reach over both ends.
        """
        if len(self) < 2 or not (
            self._stamps[0] <= start_ns < end_ns <= self._stamps[-1] + held_ns
        ):
            raise DatasetError(f"the IMU does not cover {start_ns}..{end_ns} ns")
        lo, hi = bisect_right(self._stamps, start_ns) - 1, bisect_left(self._stamps, end_ns)
        stamps = np.array(self._stamps[lo : hi + 1], dtype=np.int64)
        rates = np.array(self._rates[lo : hi + 1])
        inner = stamps[(stamps > start_ns) & (stamps < end_ns)]
        interval = np.concatenate([[start_ns], inner, [end_ns]]).astype(np.int64)
        if also_at_ns:
            interval = np.union1d(interval, np.array(also_at_ns, dtype=np.int64))
        # seconds since the start: epoch nanoseconds do not fit into a double
        at, measured_at = (interval - start_ns) * 1e-9, (stamps - start_ns) * 1e-9
        columns = [np.interp(at, measured_at, rates[:, i]) for i in range(6)]
        values = np.stack(columns, axis=1)
        return ImuData(interval, values[:, :3], values[:, 3:])

    def at(self, stamp_ns: int) -> ImuSample:
        """The sample at one time, interpolated; raises `DatasetError` as `between` does."""
        last = self.last_ns
        if last is not None and stamp_ns == last:
            end = self.between(stamp_ns - 1, stamp_ns)
            return ImuSample(stamp_ns, end.gyro[-1], end.accel[-1])
        begin = self.between(stamp_ns, stamp_ns + 1)
        return ImuSample(stamp_ns, begin.gyro[0], begin.accel[0])

    def spacing_s(self, interval: ImuData) -> FloatArray:
        """Seconds (n,) between the measured samples around each pair of an interval from here.

        A pair of an interval can be short and still lie in a long gap of the stream.
        """
        stamps = np.array(self._stamps, dtype=np.int64)
        after = np.searchsorted(stamps, interval.timestamp_ns[:-1], side="right")
        after = np.minimum(after, len(stamps) - 1)  # behind the newest sample: as before it
        return np.asarray((stamps[after] - stamps[after - 1]) * 1e-9)

    def snapshot(self) -> "ImuBuffer":
        """The samples of now, for another thread: what is appended later is not in it."""
        out = ImuBuffer()
        out._stamps, out._rates = self._stamps.copy(), self._rates.copy()
        return out

    def drop_before(self, stamp_ns: int) -> None:
        """Drop the samples that no interval from `stamp_ns` on needs."""
        first = bisect_left(self._stamps, stamp_ns) - 1
        if first > 0:
            del self._stamps[:first], self._rates[:first]


def integrated_rotation(samples: ImuData) -> FloatArray:
    """R_start_end (3, 3) by the gyroscope alone, its bias not removed."""
    dt = np.diff(samples.timestamp_ns) * 1e-9
    R = np.eye(3)
    for step in so3.exp(0.5 * (samples.gyro[:-1] + samples.gyro[1:]) * dt[:, None]):
        R = R @ step
    return R
