"""What the settings correct in a recording: units, exchanged cameras, the clocks' offset."""

from collections.abc import Generator
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from ovmot.datasets.findings import Findings
from ovmot.datasets.sequence import RecordedSequence, StoredPair, covered_frames
from ovmot.geometry.arrays import IntArray
from ovmot.settings import RecordingSettings
from ovmot.types import ImuData


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectedSequence(RecordedSequence):
    """A sequence that reads its images from `base`: frame i is its frame `at[i]`, rising; left and
    right are exchanged where `exchanged`."""

    base: RecordedSequence
    at: IntArray
    exchanged: bool

    def pairs(self, first: int, stop: int) -> Generator[StoredPair, None, None]:
        if first >= stop:
            return
        wanted = set(self.at[first:stop].tolist())
        begin, end = int(self.at[first]), int(self.at[stop - 1]) + 1
        for k, (left, right) in enumerate(self.base.pairs(begin, end), start=begin):
            if k in wanted:
                yield (right, left) if self.exchanged else (left, right)

    def of_pairs(self) -> Self:
        keep = self.complete
        return replace(
            self, frame_ns=self.frame_ns[keep], frame_number=self.frame_number[keep], missing={},
            at=self.at[keep],
        )  # fmt: skip


def corrected(sequence: RecordedSequence, settings: RecordingSettings) -> RecordedSequence:
    """The sequence as the settings correct it; itself where they do not.

    Raises `DatasetError` where a time offset leaves no frame that the IMU covers.
    """
    offset_s = settings.time_offset_s
    rig = sequence.rig if offset_s is None else replace(sequence.rig, time_offset_s=offset_s)
    scales = settings.gyro_scale, settings.accel_scale
    if rig is sequence.rig and scales == (1.0, 1.0) and not settings.exchange_cameras:
        return sequence
    sequence = sequence.without_mended_warnings(settings)
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
        "missing": _missing(sequence, keep, settings.exchange_cameras),
    }
    return CorrectedSequence(
        **{**same, **changed},
        base=sequence,
        at=keep,
        exchanged=settings.exchange_cameras,
    )


def _missing(sequence: RecordedSequence, keep: IntArray, exchanged: bool) -> dict[int, int]:
    """The camera that gave no image, by the index of the frame among those kept."""
    of_base = ((i, sequence.missing.get(int(k))) for i, k in enumerate(keep))
    return {i: 1 - side if exchanged else side for i, side in of_base if side is not None}
