"""Folders in the ASL layout."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.asl import read_euroc


def test_real_euroc_calibration(data_root: Path) -> None:
    mav = data_root / "euroc_mh01" / "mav0"
    if not mav.is_dir():
        pytest.skip(f"{mav} is missing")
    cam0, cam1, imu = (mav / name / "sensor.yaml" for name in ("cam0", "cam1", "imu0"))
    found = read_euroc(cam0, cam1, imu)
    assert found.rig.baseline == pytest.approx(0.11008, abs=1e-5)
    np.testing.assert_allclose(
        found.rig.T_imu_cam0[:3, 3], [-0.02164, -0.06468, 0.00981], atol=1e-5
    )
    assert found.imu_noise is not None
    assert found.imu_noise.accel_walk == 3e-3
