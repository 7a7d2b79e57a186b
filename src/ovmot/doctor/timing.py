"""Checks of the stamps: rates, jitter, gaps, missing frames."""

from collections.abc import Mapping

import numpy as np

from ovmot.doctor.report import Finding, Severity
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.settings import ImuSettings

_HOLE = 1.5  # an interval of more than so many periods lacks a sample
_MANY = 0.03  # share of missing frames
_MOSTLY_OUTSIDE = 0.5
_LONGEST_HOLE_S = 0.5
_JITTER = 0.1  # of a period
_CAMERA_HZ, _IMU_HZ = 5.0, 80.0
_IMU_LOSS, _IMU_HOLE_PERIODS = 0.005, 3.5  # a share, and a hole that interpolation spans
_NOTICED = {
    "stamps_without_image": "listed stamps without an image",
    "unpaired_images": "images without a partner",
}


def check_frame_times(frame_ns: IntArray, counts: Mapping[str, int]) -> list[Finding]:
    """Rate, jitter and dropped frames of stereo pairs at `frame_ns` (M,), rising.

    `counts`: what the reader noticed (`stamps_without_image`, `unpaired_images`).
    """
    if len(frame_ns) < 3:
        return [Finding("frame rate", Severity.UNKNOWN, f"{len(frame_ns)} stereo pairs only")]
    steps_s = 1e-9 * np.diff(frame_ns)
    period_s = float(np.median(steps_s))
    return [
        _rate("frame rate", "stereo pairs", len(frame_ns), period_s, _CAMERA_HZ),
        _jitter("frame jitter", steps_s, period_s),
        _dropped(steps_s, period_s, len(frame_ns), counts),
    ]


def check_imu_times(
    imu_ns: IntArray, counts: Mapping[str, int], settings: ImuSettings
) -> list[Finding]:
    """Rate, jitter and holes of IMU samples at `imu_ns` (N,).

    A rate that `imu.max_gap_s` allows, where a preset or the user has given it, is expected.
    """
    if len(imu_ns) < 3:
        says = f"{len(imu_ns)} IMU samples only"
        return [Finding("IMU rate", Severity.WRONG, says, "give the whole IMU file")]
    steps_s = 1e-9 * np.diff(imu_ns)
    period_s = float(np.median(steps_s))
    return [
        _rate("IMU rate", "samples", len(imu_ns), period_s, _least_imu_hz(settings)),
        _jitter("IMU jitter", steps_s, period_s),
        _imu_holes(steps_s, period_s, counts.get("imu_duplicates", 0), settings.max_gap_s),
    ]


def median_period_s(timestamp_ns: IntArray) -> float:
    """The median interval of stamps (N,), s."""
    return float(np.median(1e-9 * np.diff(timestamp_ns)))


def _least_imu_hz(settings: ImuSettings) -> float:
    given = "max_gap_s" in settings.model_fields_set
    return min(_IMU_HZ, 1.0 / settings.max_gap_s) if given else _IMU_HZ


def check_coverage(n_frames: int, counts: Mapping[str, int]) -> Finding:
    """How many stereo pairs the reader dropped (`frames_outside_imu`) beside `n_frames` it kept."""
    lost = counts.get("frames_outside_imu", 0)
    share = lost / max(n_frames + lost, 1)
    says = f"the IMU covers {n_frames} of {n_frames + lost} stereo pairs"
    if share <= _MANY:  # recorders start and stop their sensors one by one
        return Finding("IMU coverage", Severity.FINE, says)
    remedy = "copy the whole IMU file, and check that both have one clock"
    severity = Severity.WRONG if share >= _MOSTLY_OUTSIDE else Severity.DOUBTFUL
    return Finding("IMU coverage", severity, says, remedy)


def lost_in_holes(steps_s: FloatArray, period_s: float) -> int:
    """How many samples the intervals (N,) lack, where each should last one period."""
    holes = steps_s[steps_s > _HOLE * period_s]
    return int(np.round(holes / period_s - 1.0).sum())


def _rate(check: str, what: str, count: int, period_s: float, least_hz: float) -> Finding:
    rate = 1.0 / period_s
    says = f"{count} {what} at {rate:.4g} Hz"
    if rate < 0.98 * least_hz:
        remedy = f"record at {least_hz:g} Hz or more, or check that the stamps are nanoseconds"
        return Finding(check, Severity.DOUBTFUL, says, remedy)
    return Finding(check, Severity.FINE, says)


def _jitter(check: str, steps_s: FloatArray, period_s: float) -> Finding:
    regular = steps_s[steps_s <= _HOLE * period_s]
    jitter_s = float(np.sqrt(np.mean((regular - period_s) ** 2)))
    says = f"intervals differ from {1e3 * period_s:.4g} ms by {1e3 * jitter_s:.2g} ms (rms)"
    if jitter_s > _JITTER * period_s:
        remedy = "take the sensor's own stamps, not those of arrival at the computer"
        return Finding(check, Severity.DOUBTFUL, says, remedy)
    return Finding(check, Severity.FINE, says)


def _dropped(
    steps_s: FloatArray, period_s: float, n_frames: int, counts: Mapping[str, int]
) -> Finding:
    lost = lost_in_holes(steps_s, period_s)
    share, longest = lost / (n_frames + lost), float(steps_s.max())
    says = "no stereo pair is missing between the first and the last"
    if lost:
        says = (
            f"{lost} of {n_frames + lost} stereo pairs are missing ({share:.1%}),"
            f" the longest hole lasts {longest:.2f} s"
        )
    for key, text in _NOTICED.items():
        if counts.get(key):
            says += f"; {text}: {counts[key]}"
    alone = counts.get("unpaired_images", 0)
    share = max(share, alone / (n_frames + alone))
    remedy = "copy the missing images, or record with more disk or network bandwidth"
    if share > _MANY or (lost and longest > _LONGEST_HOLE_S):
        return Finding("dropped frames", Severity.WRONG, says, remedy)
    if lost or alone:
        return Finding("dropped frames", Severity.DOUBTFUL, says, remedy)
    return Finding("dropped frames", Severity.FINE, says)


def _imu_holes(steps_s: FloatArray, period_s: float, doubles: int, max_gap_s: float) -> Finding:
    lost, longest = lost_in_holes(steps_s, period_s), float(steps_s.max())
    says = f"{lost} samples are missing, the longest hole lasts {1e3 * longest:.3g} ms"
    if doubles:
        says += f", {doubles} stamps come twice"
    remedy = "record the IMU without loss: it is integrated from sample to sample"
    if longest > max_gap_s:
        return Finding("IMU gaps", Severity.WRONG, says, remedy)
    many = max(lost, doubles) > _IMU_LOSS * len(steps_s)
    if many or longest > _IMU_HOLE_PERIODS * period_s:
        return Finding("IMU gaps", Severity.DOUBTFUL, says, remedy)
    return Finding("IMU gaps", Severity.FINE, says if lost or doubles else "no sample is missing")
