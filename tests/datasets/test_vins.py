"""Calibration files of VINS-Mono and VINS-Fusion: their camera models, and broken ones."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.given_calibration import read_calibration
from ovmot.datasets.vins import read_vins
from ovmot.errors import CalibrationError

Edit = Callable[[Path, str, str], None]


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("cam1_pinhole.yaml", "PINHOLE", "SCARAMUZZA", "'model_type': 'SCARAMUZZA' is not known"),
        ("cam1_pinhole.yaml", "fy: 20.0, ", "", "'projection_parameters.fy': this key is missing"),
        ("cam1_pinhole.yaml", "fx: 20.0", "fx: 0.0", "'projection_parameters': impossible camera"),
        ("calibration.yaml", "body_T_cam1", "body_T", "'body_T_cam1': this key is missing"),
    ],
)
def test_broken_vins_files(
    viode: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    folder = viode.parent / "calibration_files"
    edit(folder / name, old, new)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_vins(folder / "calibration.yaml")
    assert str(folder / name) in str(caught.value)


MEI = """\
%YAML:1.0
---
model_type: MEI
camera_name: camera
image_width: 848
image_height: 800
mirror_parameters:
   xi: 1.75347951
distortion_parameters:
   k1: 0.03509054
   k2: -0.3590536
   p1: 0.00250588
   p2: 0.00058101
projection_parameters:
   gamma1: 788.10829678
   gamma2: 788.19861186
   u0: 416.33019648
   v0: 404.21771229
"""
KANNALA_BRANDT = """\
%YAML:1.0
---
model_type: KANNALA_BRANDT
camera_name: camera
image_width: 640
image_height: 512
projection_parameters:
   k2: -0.061
   k3: -0.0038
   k4: 0.0273
   k5: -0.0303
   mu: 413.3
   mv: 413.7
   u0: 306.0
   v0: 259.4
"""
BODY = """\
body_T_cam{k}: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [1.0, 0.0, 0.0, {x}, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
"""
EXTRINSIC = """\
extrinsicRotation: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
extrinsicTranslation: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [-0.02, -0.06, 0.01]
td: 0.013
"""


def fusion(folder: Path, left: str, right: str | None) -> Path:
    (folder / "left.yaml").write_text(left)
    (folder / "right.yaml").write_text(right or "")
    path = folder / "rig.yaml"
    bodies = "".join(BODY.format(k=k, x=0.2 * k) for k in range(2))
    files = 'cam0_calib: "left.yaml"\ncam1_calib: "right.yaml"\n'
    path.write_text(f"%YAML:1.0\nimu: 1\nnum_of_cam: {2 if right else 1}\n{files}{bodies}td: 0.0\n")
    return path


def test_mirror_and_fisheye_cameras(tmp_path: Path) -> None:
    rig = read_calibration(fusion(tmp_path, MEI, KANNALA_BRANDT)).rig
    assert rig.baseline == pytest.approx(0.2)
    assert (rig.cam0.model.name, rig.cam1.model.name) == ("omni", "equidistant")
    mirror = [1.75347951, 0.03509054, -0.3590536, 0.00250588, 0.00058101]
    np.testing.assert_array_equal(rig.cam0.distortion, mirror)
    np.testing.assert_array_equal(rig.cam1.distortion, [-0.061, -0.0038, 0.0273, -0.0303])
    np.testing.assert_array_equal(rig.cam1.intrinsics[:4], [413.3, 413.7, 306.0, 259.4])
    assert rig.cam0.fx == pytest.approx(788.10829678 / 2.75347951)


def test_coefficients_of_a_fisheye_may_have_keys_of_their_own(tmp_path: Path) -> None:
    own = KANNALA_BRANDT.replace("projection_parameters", "distortion_parameters")
    own = own.replace("   mu:", "projection_parameters:\n   mu:")
    path = fusion(tmp_path, own, KANNALA_BRANDT)
    rig = read_calibration(path).rig
    np.testing.assert_array_equal(rig.cam0.distortion, rig.cam1.distortion)


def test_one_camera_of_vins_fusion_and_of_vins_mono(tmp_path: Path) -> None:
    assert read_calibration(fusion(tmp_path, MEI, None)).rig.n_cameras == 1
    (tmp_path / "mono.yaml").write_text(MEI + EXTRINSIC)
    rig = read_calibration(tmp_path / "mono.yaml").rig
    assert rig.n_cameras == 1
    assert rig.time_offset_s == 0.013
    np.testing.assert_array_equal(rig.T_imu_cam0[:3, 3], [-0.02, -0.06, 0.01])
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 0], [0.0, 1.0, 0.0])


def test_a_mirror_in_front_of_the_camera(tmp_path: Path) -> None:
    path = fusion(tmp_path, MEI.replace("xi: 1.7", "xi: -1.7"), MEI)
    with pytest.raises(CalibrationError, match=r"'mirror_parameters': xi is -1\.75"):
        read_calibration(path)
