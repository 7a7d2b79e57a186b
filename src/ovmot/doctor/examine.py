"""All checks on one sequence."""

from collections.abc import Callable, Mapping
from pathlib import Path

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.corrections import corrected
from ovmot.datasets.sequence import RecordedSequence
from ovmot.doctor.camera_rotations import CameraRotations, camera_rotations
from ovmot.doctor.images import check_images, check_readable
from ovmot.doctor.imu_units import (
    check_accel_unit,
    check_gravity,
    check_gyro_range,
    check_imu_saturation,
)
from ovmot.doctor.locations import Locations, locations_of
from ovmot.doctor.observe import Observations, choose_stretches, observe
from ovmot.doctor.report import Finding, Report, Severity, make_report
from ovmot.doctor.stereo_geometry import beyond_correction, check_stereo
from ovmot.doctor.stereo_scale import check_scale, fit_scale
from ovmot.doctor.time_offset import check_gyro, fit_gyro
from ovmot.doctor.timing import (
    check_coverage,
    check_frame_times,
    check_imu_times,
    median_period_s,
)
from ovmot.errors import InputError
from ovmot.settings import Settings
from ovmot.types import ImuData

_BEFORE_SCALE = (
    "left and right", "extrinsics", "camera model", "accelerometer unit", "gyroscope unit",
    "gyroscope range", "camera on IMU", "IMU rate",
)  # fmt: skip
"""Checks without which accelerometer and stereo cannot be compared."""


def sampled_frames(sequence: RecordedSequence) -> int:
    """How many stereo pairs `examine` will look at."""
    sequence = sequence.of_pairs()
    if len(sequence) == 0:
        return 0
    return sum(
        last - first + 1 for first, last in choose_stretches(sequence.frame_ns, sequence.imu)
    )


def examine(
    recorded: RecordedSequence,
    advance: Callable[[int], None] = lambda done: None,
    calibration: Path | None = None,
    given: Settings | None = None,
) -> Report:
    """Everything that is wrong or doubtful in a sequence, in plain words.

    `advance` hears how many frames have been looked at; `calibration` is the file that stands in
    place of the data's own, if one does; `given`: settings over those of the data's preset. A
    sequence without pairs, since one camera's images are missing, is examined so far as that goes.
    Raises `DatasetError` where no image can be read, `InputError` for a rig of one camera.
    """
    if recorded.rig.n_cameras == 1:
        problem = "has one camera: the doctor compares two"
        raise InputError.at(recorded.root, problem, "give the calibration and images of a pair")
    settings = recorded.settings(given)
    sequence = corrected(recorded, settings.recording)
    locations = locations_of(sequence.kind, None if calibration is None else str(calibration))
    sequence = sequence.of_pairs()
    if len(sequence) == 0:
        findings = _without_pairs(sequence, settings, locations)
        return make_report(sequence.name, sequence.kind, findings)
    stretches = choose_stretches(sequence.frame_ns, sequence.imu)
    findings = examine_stretches(sequence, stretches, settings, locations, advance)
    return make_report(sequence.name, sequence.kind, findings)


def mistake_beyond_refinement(
    recorded: RecordedSequence,
    settings: Settings,
    advance: Callable[[int], None] = lambda done: None,
) -> Finding | None:
    """What no small correction of the calibration makes good, None where there is nothing.

    Exchanged images, an inverted pose and the like; of the IMU, what is wrong in its units, its
    clock, its axes on the camera, and in the scale by stereo. `settings`: with those of the preset.
    None also for a rig of one camera. Raises `DatasetError` where no image can be read.
    """
    sequence = corrected(recorded, settings.recording).of_pairs()
    if sequence.rig.n_cameras == 1 or len(sequence) == 0:
        return None
    locations = locations_of(sequence.kind, None)
    stretches = choose_stretches(sequence.frame_ns, sequence.imu)
    seen = observe(sequence, stretches, settings, advance)
    of_stereo = beyond_correction(seen.matches, sequence.rig, locations)
    if of_stereo is not None:
        return of_stereo
    by_stereo = check_stereo(seen.matches, sequence.rig, locations)
    findings = _with_imu(seen, sequence, by_stereo, settings, locations)
    return next((found for found in findings if found.severity is Severity.WRONG), None)


def examine_stretches(
    sequence: RecordedSequence,
    stretches: list[tuple[int, int]],
    settings: Settings,
    locations: Locations,
    advance: Callable[[int], None] = lambda done: None,
) -> list[Finding]:
    """What these stretches (first and last frame) of a sequence of pairs show, as it is.

    `settings`: with those of its preset; what they correct in a recording is taken as corrected.
    Raises `DatasetError` where no image can be read.
    """
    seen = observe(sequence, stretches, settings, advance)
    by_stereo = check_stereo(seen.matches, sequence.rig, locations)
    findings = [
        *check_frame_times(sequence.frame_ns, sequence.counts),
        *check_images(seen.images),
        *check_readable(seen.broken, len(seen.images)),
        *by_stereo[0],
    ]
    if sequence.imu is None:
        findings.append(_no_imu(sequence, locations))
    else:
        findings.append(check_coverage(len(sequence), sequence.counts))
        findings += _with_imu(seen, sequence, by_stereo, settings, locations)
    return findings


def _with_imu(
    seen: Observations,
    sequence: RecordedSequence,
    by_stereo: tuple[list[Finding], StereoRig],
    settings: Settings,
    locations: Locations,
) -> list[Finding]:
    """The checks of the IMU, alone and against the images, none for a sequence without an IMU.

    `by_stereo`: what the stereo matches say, and a rig that explains them.
    """
    imu, (of_stereo, rig) = sequence.imu, by_stereo
    if imu is None:
        return []
    turns = camera_rotations(seen.stretches, rig)
    findings = _imu_findings(imu, turns, rig, sequence.counts, settings, locations)
    if not any(_hides_the_scale(finding) for finding in [*of_stereo, *findings]):
        findings.append(_scale(imu, turns, rig, locations))
    return findings


def _no_imu(sequence: RecordedSequence, locations: Locations) -> Finding:
    """Missing, or not a part of this kind of data at all."""
    remedy = "run it with --ego poses FILE"
    if sequence.counts.get("no_imu") and len(sequence) != 1:  # one pair alone is no recording
        says = "the data should have an IMU, and has none"
        return Finding("IMU", Severity.WRONG, says, f"copy {locations.imu}, or {remedy}")
    says = "the data has no IMU, or none that is fast enough"
    return Finding("IMU", Severity.UNKNOWN, says, remedy)


def _without_pairs(
    sequence: RecordedSequence, settings: Settings, locations: Locations
) -> list[Finding]:
    """The checks that need no stereo pair."""
    says = "one camera has no images: no check of images and calibration is possible"
    findings = [Finding("cameras", Severity.WRONG, says, f"copy {locations.images}")]
    if sequence.imu is None:
        return [*findings, _no_imu(sequence, locations)]
    imu = sequence.imu
    findings += check_imu_times(imu.timestamp_ns, sequence.counts, settings.imu)
    if len(imu) < 3:
        return findings
    more = check_accel_unit(imu), check_gyro_range(imu), *check_imu_saturation(imu)
    return [*findings, *more]


def _imu_findings(
    imu: ImuData,
    turns: CameraRotations,
    rig: StereoRig,
    counts: Mapping[str, int],
    settings: Settings,
    locations: Locations,
) -> list[Finding]:
    times = check_imu_times(imu.timestamp_ns, counts, settings.imu)
    if len(imu) < 3:
        return times
    R_imu_cam0, offset_s = rig.T_imu_cam0[:3, :3], rig.time_offset_s
    by_gyro = check_gyro(
        fit_gyro(turns, imu, offset_s), R_imu_cam0, offset_s, settings.filter.time_offset_sigma_s,
        locations,
    )  # fmt: skip
    alone = [
        check_accel_unit(imu),
        check_gyro_range(imu),
        *check_imu_saturation(imu),
        check_gravity(imu, R_imu_cam0, locations.mount),
    ]
    return [*times, *alone, *by_gyro]


def _hides_the_scale(finding: Finding) -> bool:
    """Whether accelerometer and stereo cannot be compared by what is found."""
    amiss = finding.severity in (Severity.WRONG, Severity.DOUBTFUL)
    return amiss and finding.check in _BEFORE_SCALE


def _scale(imu: ImuData, turns: CameraRotations, rig: StereoRig, locations: Locations) -> Finding:
    compared = fit_gyro(turns, imu, rig.time_offset_s)
    lag_s = compared.lag_s if compared is not None and compared.is_sure else 0.0
    found = fit_scale(turns, imu, rig, rig.time_offset_s + lag_s)
    return check_scale(found, rig, median_period_s(imu.timestamp_ns), locations)
