"""What the doctor sees while a sequence runs: units and signs at once, the rest where a run stalls.

The IMU alone is looked at before the first frame, which costs nothing. The pictures are examined
only where a run does not go as it should: none of the mistakes that they show lets it.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from ovmot.datasets.sequence import RecordedSequence
from ovmot.doctor.examine import examine_stretches
from ovmot.doctor.fix import fix_over, set_options
from ovmot.doctor.imu_units import check_accel_sign, check_accel_unit
from ovmot.doctor.locations import locations_of
from ovmot.doctor.observe import STRETCH_FRAMES
from ovmot.doctor.report import Finding, Severity
from ovmot.errors import OvmotError
from ovmot.settings import Settings
from ovmot.types import ImuData

_IMU_S = 30.0  # of the IMU's samples, at the start
_WAITED_S = (3.0, 10.0)  # without a start: the pictures are examined, and once more
_YOUNG_S = 20.0  # after the first frame: what goes wrong later is not the recording's form
_UNWELL_FRAMES = 10  # degraded or lost ones
_LEAST_MATCHES = 500
MOST_REFUSED = 0.2
"""Share of refused stereo matches beyond which the calibration is to be doubted; of good recordings
0.02 are refused."""


class RunCheck:
    """Says, in one line each, what is wrong with the recording that runs.

    Parameters
    ----------
    sequence, settings
        As they run: corrected, with the preset.
    doctor_options
        What `ovmot doctor` needs, beside the data, to read the same: the hints repeat it.
    """

    def __init__(
        self, sequence: RecordedSequence, settings: Settings, doctor_options: str = ""
    ) -> None:
        self._sequence, self._settings = sequence, settings
        self._doctor = f"ovmot doctor {sequence.root} {doctor_options}".rstrip()
        self._locations = locations_of(sequence.kind, None)
        self._begun_ns: int | None = None
        self._waits_s = list(_WAITED_S)
        self._may_be_unwell = True
        self._said: set[str] = set()

    def of_imu(self) -> Iterator[str]:
        """The accelerometer's unit and sign, by the first seconds of the IMU."""
        imu = self._sequence.imu
        if imu is None or len(imu) < STRETCH_FRAMES:
            return
        first = _first_seconds(imu, _IMU_S)
        unit = check_accel_unit(first)
        if unit.severity is Severity.WRONG:
            yield from self._lines([unit])
        yield from self._lines([check_accel_sign(first, self._sequence.rig.T_imu_cam0[:3, :3])])

    def after(self, stamp_ns: int, started: bool, counts: Mapping[str, int]) -> Iterator[str]:
        """What is to be said after a frame; `counts`: those of the run so far."""
        if self._begun_ns is None:
            self._begun_ns = stamp_ns
        since_s = 1e-9 * (stamp_ns - self._begun_ns)
        if not started and self._waits_s and since_s >= self._waits_s[0] and not counts["resets"]:
            waited_s = self._waits_s.pop(0)
            found = list(self._of_pictures(stamp_ns))
            yield from found
            if not found and not self._said:
                yield f"no start for {waited_s:g} s: '{self._doctor}' may say why"
        elif self._may_be_unwell and since_s < _YOUNG_S and _is_unwell(counts):
            self._may_be_unwell = False
            found = list(self._of_pictures(stamp_ns))
            yield from found
            unwell = _on_imu_alone(counts)
            if unwell and not found and not self._said:
                yield f"{unwell} frames rest on the IMU alone: '{self._doctor}' may say why"

    def _of_pictures(self, stamp_ns: int) -> Iterator[str]:
        """What the newest frames show to be wrong; nothing where they can not be examined."""
        sequence = self._sequence.of_pairs()
        stop = int(np.searchsorted(sequence.frame_ns, stamp_ns, side="right"))
        if sequence.rig.n_cameras == 1 or stop < STRETCH_FRAMES // 2:
            return
        stretch = (max(stop - STRETCH_FRAMES, 0), stop - 1)
        try:
            found = examine_stretches(sequence, [stretch], self._settings, self._locations)
        except OvmotError:
            return
        yield from self._lines([f for f in found if f.severity is Severity.WRONG])

    def _lines(self, findings: list[Finding]) -> Iterator[str]:
        """A line for each finding of which nothing was said yet, with its remedy."""
        for finding in findings:
            if finding.severity is Severity.FINE or finding.check in self._said:
                continue
            self._said.add(finding.check)
            yield f"{finding.check}: {finding.says}: {self._remedy(finding)}"

    def _remedy(self, finding: Finding) -> str:
        if not finding.fix:
            remedy = f"{finding.remedy}; " if finding.remedy else ""
            return f"{remedy}'{self._doctor}' says more"
        given = set_options(fix_over(finding.fix, self._settings))
        if_doubtful = f"{finding.remedy}: " if finding.severity is Severity.DOUBTFUL else ""
        return f"{if_doubtful}run with {given}, or see '{self._doctor} --fix OUT.yaml'"


def _is_unwell(counts: Mapping[str, int]) -> bool:
    """Was the motion lost, or has it rested on the IMU alone, or do most stereo matches not fit?"""
    if counts["resets"] or _on_imu_alone(counts) >= _UNWELL_FRAMES:
        return True
    tested = counts["stereo_matches"]
    return tested >= _LEAST_MATCHES and counts["stereo_matches_refused"] > MOST_REFUSED * tested


def _on_imu_alone(counts: Mapping[str, int]) -> int:
    return counts["frames_degraded"] + counts["frames_lost"]


def _first_seconds(imu: ImuData, seconds: float) -> ImuData:
    stop = int(np.searchsorted(imu.timestamp_ns, imu.timestamp_ns[0] + round(1e9 * seconds)))
    return ImuData(imu.timestamp_ns[:stop], imu.gyro[:stop], imu.accel[:stop])
