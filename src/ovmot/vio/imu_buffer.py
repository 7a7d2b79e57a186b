"""The IMU samples that frames still need, and intervals of them between exact times."""

import numpy as np

from ovmot.errors import DatasetError
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.types import ImuData, ImuSample
from ovmot.vio.imu_kernel import samples_between_compiled

_LEAST_ROOM = 256  # samples


class ImuBuffer:
    """Samples in time order; `between` interpolates at both ends of an interval.

    Kept in arrays with room for more. What has been written there is never changed, so that a
    snapshot can share them.
    """

    def __init__(self) -> None:
        self._room_ns: IntArray = np.empty(_LEAST_ROOM, dtype=np.int64)
        self._room: FloatArray = np.empty((_LEAST_ROOM, 6))
        self._begin = self._end = 0

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def first_ns(self) -> int | None:
        """Stamp of the oldest sample kept."""
        return int(self._room_ns[self._begin]) if len(self) else None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the newest sample."""
        return int(self._room_ns[self._end - 1]) if len(self) else None

    @property
    def _stamps(self) -> IntArray:
        """Stamps (n,) of the samples kept."""
        return self._room_ns[self._begin : self._end]

    def append(self, sample: ImuSample) -> None:
        """Add a sample; raises `DatasetError` when its stamp does not follow the last one."""
        last = self.last_ns
        if last is not None and sample.timestamp_ns <= last:
            raise DatasetError(
                f"IMU stamp {sample.timestamp_ns} does not follow {last}:"
                " samples must be in time order"
            )
        if self._end == len(self._room_ns):
            self._make_room()
        self._room_ns[self._end] = sample.timestamp_ns
        self._room[self._end, :3], self._room[self._end, 3:] = sample.gyro, sample.accel
        self._end += 1

    def _make_room(self) -> None:
        """New arrays, at least half of them free; snapshots keep the old ones."""
        n, size = len(self), max(_LEAST_ROOM, 2 * len(self))
        stamps, rates = np.empty(size, dtype=np.int64), np.empty((size, 6))
        stamps[:n], rates[:n] = self._stamps, self._room[self._begin : self._end]
        self._room_ns, self._room, self._begin, self._end = stamps, rates, 0, n

    def between(
        self, start_ns: int, end_ns: int, *, held_ns: int = 0, also_at_ns: tuple[int, ...] = ()
    ) -> ImuData:
        """Samples from `start_ns` to `end_ns`, both ends interpolated linearly.

        And those `also_at_ns`, times inside the interval. The newest sample is held for `held_ns`
        at most. Raises `DatasetError` when the buffer does not reach over both ends.
        """
        stamps = self._stamps
        if len(self) < 2 or not (stamps[0] <= start_ns < end_ns <= stamps[-1] + held_ns):
            raise DatasetError(f"the IMU does not cover {start_ns}..{end_ns} ns")
        lo = self._begin + int(stamps.searchsorted(start_ns, side="right")) - 1
        hi = min(self._begin + int(stamps.searchsorted(end_ns)) + 1, self._end)
        wanted = np.array([start_ns, *sorted(also_at_ns), end_ns], dtype=np.int64)
        return ImuData(*samples_between_compiled(self._room_ns, self._room, lo, hi, wanted))

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
        stamps = self._stamps
        after = stamps.searchsorted(interval.timestamp_ns[:-1], side="right")
        after = np.minimum(after, len(stamps) - 1)  # behind the newest sample: as before it
        return np.asarray((stamps[after] - stamps[after - 1]) * 1e-9)

    def snapshot(self) -> "ImuBuffer":
        """The samples of now, for another thread: what is appended later is not in it."""
        out = ImuBuffer.__new__(ImuBuffer)
        out._room_ns, out._room = self._room_ns, self._room
        out._begin, out._end = self._begin, self._end
        return out

    def drop_before(self, stamp_ns: int) -> None:
        """Drop the samples that no interval from `stamp_ns` on needs."""
        self._begin += max(int(self._stamps.searchsorted(stamp_ns)) - 1, 0)


def integrated_rotation(samples: ImuData) -> FloatArray:
    """R_start_end (3, 3) by the gyroscope alone, its bias not removed."""
    dt = np.diff(samples.timestamp_ns) * 1e-9
    R = np.eye(3)
    for step in so3.exp(0.5 * (samples.gyro[:-1] + samples.gyro[1:]) * dt[:, None]):
        R = R @ step
    return R
