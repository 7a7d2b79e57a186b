"""What a run has found of the calibration, as files of Kalibr and OpenVINS."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from rich.table import Column, Table
from rich.text import Text

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.calibration_export import WrittenCalibration, calibration_files, write_rig
from ovmot.datasets.kalibr import CHAIN_FILE, read_kalibr
from ovmot.errors import InputError
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.finished_run import Run
from ovmot.outputs.run_reader import TIME_OFFSET, read_calibration
from ovmot.physics import gate
from ovmot.settings import Settings
from ovmot.text_files import StrPath
from ovmot.types import ImuNoise
from ovmot.vio.online_calibration import (
    CAMERA_INTRINSICS,
    MOUNT,
    STEREO,
    OnlineCalibration,
    calibrated_rig,
    make_calibration,
)

OBSERVED_SHARE = 0.5
"""Observed is what is known twice as well as before: the motion has told more than the files."""
_POSSIBLE = 0.9999  # probability that a part stays in the gate of its prior, where that is right


@dataclass(frozen=True, slots=True)
class CalibratedValue:
    """One coordinate: before, after and its 1-sigma at the end, in `unit`; whether it was observed.

    Rotations are turns against the file's, about the axes of the camera.
    """

    name: str
    unit: str
    before: float
    after: float
    sigma: float
    observed: bool


@dataclass(frozen=True, slots=True)
class RunCalibration:
    """The rig that a run was given, that with all that was observed, and the values in between.

    `doubt`: why these values should not be believed, empty where there is no reason.
    """

    before: StereoRig
    after: StereoRig
    values: tuple[CalibratedValue, ...]
    doubt: str = ""


def refuse_existing_files(path: StrPath, with_noise: bool) -> None:
    """Raise `InputError` where a calibration, perhaps with the IMU's noise, is there already."""
    calibration_files(path, with_noise, replace=False)


def run_calibration(folder: StrPath) -> RunCalibration:
    """What a run has estimated at its last frame.

    Raises `InputError` where it estimated nothing, or nothing was observed.
    """
    run = Run(folder)
    found, chain = read_calibration(run.folder), run.folder / CHAIN_FILE
    if found is None or not chain.is_file() or not len(found.timestamp_ns):
        remedy = "run it again with --set calibration.extrinsics=true"
        raise InputError.at(run.folder, "the run has estimated no calibration", remedy)
    before, settings = read_kalibr(chain).rig, run.settings
    value = dict(zip(found.names, found.value[-1], strict=True))
    sigma = dict(zip(found.names, found.sigma[-1], strict=True))
    estimated = settings.calibration.model_copy(update={"lens_sigma_px": 0.0})
    calibration, variance = make_calibration(before, estimated)
    names = calibration.names()
    prior = np.sqrt(variance)
    known = np.array([_is_observed(sigma[n], s) for n, s in zip(names, prior, strict=True)])
    deviation = np.array([value[n] for n in names])
    after = calibrated_rig(before, calibration.plus(np.where(known, deviation, 0.0)))
    of_cameras: tuple[str, ...] = (MOUNT, STEREO, *CAMERA_INTRINSICS)
    if before.n_cameras == 1:
        of_cameras = (MOUNT, CAMERA_INTRINSICS[0])
    rows = []
    for name, observed in zip(names, known, strict=True):
        if name.startswith(of_cameras):
            unit, scale, origin = _unit(name, before, calibration)
            end = origin + scale * value[name]
            rows.append(
                CalibratedValue(name, unit, origin, end, scale * sigma[name], bool(observed))
            )
    clock = _clock(before, value, sigma, settings)
    rows += [clock] if clock is not None else []
    if not any(row.observed for row in rows):
        remedy = "nothing to write: record a drive that turns about all axes and accelerates"
        raise InputError.at(run.folder, "the motion has shown nothing of the calibration", remedy)
    if clock is not None and clock.observed:
        after = replace(after, time_offset_s=clock.after)
    return RunCalibration(before, after, tuple(rows), _doubt(calibration, deviation, prior))


def _doubt(calibration: OnlineCalibration, deviation: FloatArray, prior: FloatArray) -> str:
    """Which coordinate is farthest in the first part whose deviations (C,) are more than their
    prior sigmas (C,) allow; empty where none is."""
    ratio, names = np.abs(deviation / prior), calibration.names()
    for part in calibration.parts:
        own = ratio[part.columns]
        if float(own @ own) > gate(len(own), _POSSIBLE):
            worst = int(np.argmax(own))
            return (
                f"{names[part.columns.start + worst]} comes out {own[worst]:.1f} prior standard"
                " deviations off the files: not a small error, or not one of the calibration"
            )
    return ""


def _is_observed(sigma: float, prior: float) -> bool:
    return bool(sigma < OBSERVED_SHARE * prior)


def _clock(
    before: StereoRig, value: dict[str, float], sigma: dict[str, float], settings: Settings
) -> CalibratedValue | None:
    if TIME_OFFSET not in value:
        return None
    observed = _is_observed(sigma[TIME_OFFSET], settings.filter.time_offset_sigma_s)
    at, std = float(value[TIME_OFFSET]), float(sigma[TIME_OFFSET])
    return CalibratedValue(TIME_OFFSET, "s", before.time_offset_s, at, std, observed)


def _unit(name: str, rig: StereoRig, calibration: OnlineCalibration) -> tuple[str, float, float]:
    """Unit, factor on the deviation, and the value that the rig has."""
    part, _, label = name.rpartition("_")
    if label in ("rx", "ry", "rz"):
        return "deg", 180.0 / np.pi, 0.0
    if part in CAMERA_INTRINSICS:
        camera = rig.cameras[CAMERA_INTRINSICS.index(part)]
        i = int(calibration_index(calibration, name, part))
        values = (*camera.intrinsics[:4], *camera.distortion)
        return ("px" if i < 4 else ""), 1.0, float(values[i])
    if part == MOUNT:
        return "m", 1.0, float(rig.T_imu_cam0[:3, 3]["xyz".index(label)])
    along = ("length", "down", "forward").index(label)
    return "m", 1.0, rig.baseline if along == 0 else 0.0


def calibration_index(calibration: OnlineCalibration, name: str, part: str) -> int:
    """The place of a named coordinate inside its part."""
    columns = calibration.columns(part)
    return calibration.names().index(name) - (0 if columns is None else columns.start)


def write_run_calibration(
    folder: StrPath, path: StrPath, found: RunCalibration, overwrite: bool = False
) -> WrittenCalibration:
    """The rig found as a Kalibr chain, and the IMU's noise of the run as OpenVINS's file beside it.

    The values stand above as comments. Raises `InputError` as `write_calibration` does.
    """
    run = Run(folder)
    noise = run.summary["imu_noise"]
    source = run.summary["input"]
    span_ns = (source["last_timestamp_ns"] or 0) - (source["first_timestamp_ns"] or 0)
    rate_hz = round(1e9 * source["n_imu_samples"] / span_ns, 1) if span_ns > 0 else 0.0
    return write_rig(
        path, found.after, None if noise is None else ImuNoise(**noise), rate_hz, overwrite,
        comment=tuple(_lines(source["path"], found)),
    )  # fmt: skip


def _lines(source: str, found: RunCalibration) -> Iterator[str]:
    yield f"estimated in a run of {source}; name: before -> after +- sigma"
    for v in found.values:
        if v.observed:
            yield f"{v.name}: {v.before:.6g} -> {v.after:.6g} +- {v.sigma:.2g} {v.unit}".rstrip()
        else:
            yield f"{v.name}: {v.before:.6g} {v.unit}: kept, not observed"


def calibration_table(found: RunCalibration) -> Table:
    """The values for a reader's eyes."""
    table = Table("value", "unit", *(Column(c, justify="right") for c in ("before", "after", "±")),
                  "")  # fmt: skip
    for v in found.values:
        after = f"{v.after:.6g}" if v.observed else f"{v.before:.6g}"
        note = "" if v.observed else "not observed: kept"
        cells = (v.name, v.unit, f"{v.before:.6g}", after, f"{v.sigma:.2g}", note)
        table.add_row(*(Text(cell) for cell in cells))
    return table
