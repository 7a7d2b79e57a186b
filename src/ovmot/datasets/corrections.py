"""What the settings correct in a recording: units, exchanged cameras, the clocks' offset."""

from collections.abc import Generator
from dataclasses import dataclass, fields, replace

import numpy as np

from ovmot.datasets.findings import Findings
from ovmot.datasets.sequence import RecordedSequence, StoredPair, covered_frames
from ovmot.settings import RecordingSettings
from ovmot.types import ImuData


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectedSequence(RecordedSequence):
    """A sequence that reads its images from `base`, from `first_frame` of it on; left and right
    are exchanged where `exchanged`."""

    base: RecordedSequence
    first_frame: int
    exchanged: bool

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        for left, right in self.base.pairs(first + self.first_frame, stop + self.first_frame):
            yield (right, left) if self.exchanged else (left, right)


def corrected(sequence: RecordedSequence, settings: RecordingSettings) -> RecordedSequence:
    """The sequence as the settings correct it; itself where they do not.

    Raises `DatasetError` where a time offset leaves no frame that the IMU covers.
    """
    offset_s = settings.time_offset_s
    rig = sequence.rig if offset_s is None else replace(sequence.rig, time_offset_s=offset_s)
    scales = settings.gyro_scale, settings.accel_scale
    if rig is sequence.rig and scales == (1.0, 1.0) and not settings.exchange_cameras:
        return sequence
    imu, findings = sequence.imu, Findings()
    keep = np.arange(len(sequence))
    if imu is not None:
        imu = ImuData(imu.timestamp_ns, scales[0] * imu.gyro, scales[1] * imu.accel)
        if rig is not sequence.rig and len(keep):
            keep = covered_frames(
                sequence.frame_ns, imu, rig.time_offset_s, sequence.root, findings
            )
    counts = dict(sequence.counts)
    for name, count in findings.counts.items():
        counts[name] = counts.get(name, 0) + count
    same = {f.name: getattr(sequence, f.name) for f in fields(RecordedSequence)}
    changed = {
        "rig": rig,
        "imu": imu,
        "frame_ns": sequence.frame_ns[keep],
        "frame_number": sequence.frame_number[keep],
        "warnings": (*sequence.warnings, *findings.warnings),
        "counts": counts,
    }
    return CorrectedSequence(
        **{**same, **changed},
        base=sequence,
        first_frame=int(keep[0]) if len(keep) else 0,
        exchanged=settings.exchange_cameras,
    )
