"""Errors of an estimated calibration, read from a run's tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.evaluation.calibration import (
    calibration_errors,
    calibration_scalars,
    true_deviations,
)
from ovmot.geometry import se3, so3
from ovmot.outputs.run_reader import read_calibration
from ovmot.sim.handheld import handheld_rig

TURN = np.array([0.01, -0.02, 0.005])
SHIFT = np.array([0.003, 0.0, -0.004])


@pytest.fixture
def prior() -> StereoRig:
    """Its left camera has to be turned, shifted and lengthened, its clock to be set back."""
    true = handheld_rig()
    T = true.T_imu_cam0
    wrong = se3.make(T[:3, :3] @ so3.exp(-TURN), T[:3, 3] - SHIFT)
    intrinsics = true.cam0.intrinsics - [3.0, 4.0, 0.5, 0.0, 0.0]
    return replace(
        true, T_imu_cam0=wrong, cam0=replace(true.cam0, intrinsics=intrinsics),
        time_offset_s=true.time_offset_s + 0.01,
    )  # fmt: skip


def test_deviations_lead_from_the_told_rig_to_the_true_one(prior: StereoRig) -> None:
    right = true_deviations(prior, handheld_rig())
    names = ("rx", "ry", "rz", "x", "y", "z")
    np.testing.assert_allclose([right[f"cam0_pose_{n}"] for n in names], [*TURN, *SHIFT])
    np.testing.assert_allclose([right[f"cam1_pose_{n}"] for n in names], 0.0, atol=1e-14)
    assert [right[f"cam0_lens_{n}"] for n in ("fx", "fy", "cx", "cy", "d0")] == pytest.approx(
        [3.0, 4.0, 0.5, 0.0, 0.0]
    )
    assert right["time_offset_s"] == handheld_rig().time_offset_s


def write(run: Path, poses: bool = True, clock_sigma_s: float = 0.001) -> None:
    """Two frames, 6 s apart: nothing found yet; then the half of fx and of the rotation."""
    pose = [f"cam0_pose_{n}" for n in ("rx", "ry", "rz", "x", "y", "z")] if poses else []
    names = [
        *pose,
        "cam0_lens_fx",
        "cam0_lens_fy",
        "cam0_lens_cx",
        "cam0_lens_cy",
        "gyro_matrix_00",
    ]
    header = ",".join(("timestamp_ns", *names, *(f"std_{n}" for n in names)))
    first = dict.fromkeys(names, 0.0)
    last = first | {"cam0_lens_fx": 1.5, "cam0_lens_fy": 4.0, "cam0_lens_cx": 0.5}
    last |= dict(zip(pose, (*(0.5 * TURN), *SHIFT), strict=True)) if poses else {}
    rows = [",".join(str(v) for v in (t, *row.values(), *([1.0] * len(names))))
            for t, row in ((0, first), (6_000_000_000, last))]  # fmt: skip
    (run / "calibration.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    offset = handheld_rig().time_offset_s + 0.004
    (run / "state.csv").write_text(
        "timestamp_ns,time_offset_s,std_time_offset_s\n"
        f"0,{offset},{clock_sigma_s}\n6000000000,{offset},{clock_sigma_s}\n",
        encoding="utf-8",
    )


def test_errors_and_sigmas(prior: StereoRig, tmp_path: Path) -> None:
    write(tmp_path)
    errors = calibration_errors(read_calibration(tmp_path), prior, handheld_rig())
    assert errors is not None
    assert errors.names[-1] == "time_offset_s"
    assert "gyro_matrix_00" not in errors.names
    assert errors.error.shape == errors.sigma.shape == (2, 11)
    found = calibration_scalars(errors)
    assert found["calibration_rotation_deg"] == pytest.approx(
        np.degrees(0.5 * np.linalg.norm(TURN))
    )
    assert found["calibration_position_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["calibration_focal_px"] == pytest.approx(1.5)
    assert found["calibration_center_px"] == pytest.approx(0.0, abs=1e-12)
    assert found["calibration_time_offset_ms"] == pytest.approx(4.0)
    assert found["calibration_worst_sigmas"] == pytest.approx(4.0)  # the clock's
    assert found["calibration_end_inside_3_sigma"] == pytest.approx(10 / 11)
    assert found["calibration_inside_3_sigma"] == pytest.approx(10 / 11)  # the first frame is early


def test_what_is_not_estimated_has_no_value(prior: StereoRig, tmp_path: Path) -> None:
    assert calibration_errors(read_calibration(tmp_path), prior, handheld_rig()) is None
    write(tmp_path, poses=False)
    errors = calibration_errors(read_calibration(tmp_path), prior, handheld_rig())
    assert errors is not None
    found = calibration_scalars(errors)
    assert found["calibration_rotation_deg"] is None
    assert found["calibration_focal_px"] == pytest.approx(1.5)


def test_a_clock_that_is_held_does_not_count(prior: StereoRig, tmp_path: Path) -> None:
    write(tmp_path, clock_sigma_s=0.0)
    errors = calibration_errors(read_calibration(tmp_path), prior, handheld_rig())
    assert errors is not None and "time_offset_s" not in errors.names
    found = calibration_scalars(errors)
    assert found["calibration_time_offset_ms"] is None
    assert found["calibration_end_inside_3_sigma"] == 1.0
