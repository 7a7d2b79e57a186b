"""TUM-VI, VIODE, UZH-FPV, 4Seasons: what is told apart, and what is refused, file and row named.

That whole sequences are read back as they were written is tested in tests/sim/test_layouts.py.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.datasets import open_sequence
from ovmot.datasets.images import read_grey
from ovmot.datasets.instance_masks import (
    InstanceImages,
    InstanceMasks,
    read_colours,
)
from ovmot.datasets.viode.calibration import read_vins
from ovmot.errors import CalibrationError, DatasetError, InputError

Edit = Callable[[Path, str, str], None]
_POSE = "[1,0,0,{x}, 0,1,0,0, 0,0,1,0, 0,0,0,1]"
_CAMERA = """\
{name}:
  T_cam_imu: {pose}
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.0, 0.0, 0.0]
  distortion_model: equidistant
  intrinsics: [20, 20, 16, 12]
  resolution: [32, 24]
"""
_NOISE = """\
accelerometer_noise_density: 0.0014
accelerometer_random_walk: 8.6e-05
gyroscope_noise_density: 8.0e-05
gyroscope_random_walk: 2.2e-06
"""
_VINS_CAMERA = """\
%YAML:1.0
---
model_type: PINHOLE
image_width: 32
image_height: 24
distortion_parameters: {k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0}
projection_parameters: {fx: 20.0, fy: 20.0, cx: 16.0, cy: 12.0}
"""


def write_chain(path: Path) -> None:
    poses = zip(("cam0", "cam1"), (0.0, -0.1), strict=True)
    path.write_text("".join(_CAMERA.format(name=n, pose=_POSE.format(x=x)) for n, x in poses))


@pytest.fixture
def tum_vi(euroc: Path) -> Path:
    """The EuRoC folder as TUM-VI has it: no sensor.yaml, but `dso`."""
    for path in euroc.rglob("sensor.yaml"):
        path.unlink()
    (euroc / "dso").mkdir()
    write_chain(euroc / "dso" / "camchain.yaml")
    (euroc / "dso" / "imu_config.yaml").write_text(_NOISE)
    return euroc


@pytest.fixture
def viode(euroc: Path) -> Path:
    """The EuRoC folder as VIODE has it: VINS-Fusion's calibration above it, and segmentation."""
    for path in euroc.rglob("sensor.yaml"):
        path.unlink()
    for camera in ("cam0", "cam1"):
        (euroc / "mav0" / camera / "segmentation").mkdir()
    files = euroc.parent / "calibration_files"
    files.mkdir()
    lines = ["%YAML:1.0", "td: 0.01"]
    for i, y in enumerate((0.0, 0.05)):
        (files / f"cam{i}_pinhole.yaml").write_text(_VINS_CAMERA)
        lines += [f'cam{i}_calib: "cam{i}_pinhole.yaml"', f"body_T_cam{i}: !!opencv-matrix"]
        data = f"[0,0,1,0, 1,0,0,{y}, 0,1,0,0, 0,0,0,1]"
        lines += ["   rows: 4", "   cols: 4", "   dt: d", f"   data: {data}"]
    (files / "calibration.yaml").write_text("\n".join(lines))
    return euroc


@pytest.fixture
def uzh_fpv(euroc: Path, tmp_path: Path) -> Path:
    """The pictures and samples of the EuRoC folder in UZH-FPV's form, seconds with a few digits."""
    root = tmp_path / "indoor_forward_3_snapdragon"
    (root / "img").mkdir(parents=True)
    for i, side in enumerate(("left", "right")):
        rows = ["# id timestamp image_name"]
        for n, path in enumerate(sorted((euroc / f"mav0/cam{i}/data").iterdir())):
            shutil.copy(path, root / "img" / f"image_{i}_{n}.png")
            rows.append(f"{n} {1540821844 + n / 10:.2f} img/image_{i}_{n}.png")
        (root / f"{side}_images.txt").write_text("\n".join(rows))
    samples = (f"{n} {1540821843.9 + n / 100:.3f} 0.1 0.2 0.3 0 0.5 9.8" for n in range(80))
    (root / "imu.txt").write_text("# timestamp ang_vel_x\n" + "\n".join(samples))
    calibration = tmp_path / "indoor_forward_calib_snapdragon"
    calibration.mkdir()
    write_chain(calibration / "camchain-imucam-indoor_forward.yaml")
    (calibration / "imu.yaml").write_text(_NOISE)
    return root


@pytest.fixture
def four_seasons(euroc: Path, tmp_path: Path) -> Path:
    """The same in the form of 4Seasons, the calibration beside the recording."""
    root = tmp_path / "recording_2020-03-24_17-36-22"
    rows = []
    for camera in ("cam0", "cam1"):
        shutil.copytree(euroc / "mav0" / camera / "data", root / "undistorted_images" / camera)
    for path in sorted((root / "undistorted_images/cam0").iterdir()):
        rows.append(f"{path.stem} {int(path.stem) / 1e9:.6f} 1.5")
    (root / "times.txt").write_text("\n".join(rows))
    text = (euroc / "mav0/imu0/data.csv").read_text().split("\n", 1)[1]
    (root / "imu.txt").write_text(text.replace(",", " "))
    (root / "Transformations.txt").write_text(
        "# transform_S_AS: translation vector, rotation quaternion\n1,2,3,0,0,0,1\n\n"
        "# TS_cam_imu: translation vector, rotation quaternion\n0.1,0.2,0.3,0,0,0,1\n"
    )
    calibration = tmp_path / "calibration"
    calibration.mkdir()
    for i in (0, 1):
        text = "Pinhole 20.5 20.5 16 12 0\n32 24\ncrop\n32 24\n"
        (calibration / f"undistorted_calib_{i}.txt").write_text(text)
    (calibration / "undistorted_calib_stereo.txt").write_text(
        "1 0 0 -0.3\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    )
    return root


def test_kinds_are_told_apart(euroc: Path, uzh_fpv: Path, four_seasons: Path) -> None:
    assert open_sequence(euroc).kind == "euroc"
    assert open_sequence(uzh_fpv).kind == "uzh_fpv"
    assert open_sequence(four_seasons).kind == "4seasons"


# ---- TUM-VI


def test_tum_vi(tum_vi: Path) -> None:
    sequence = open_sequence(tum_vi)
    assert (sequence.kind, sequence.name, len(sequence)) == ("tum_vi", "MH_tiny", 6)
    assert sequence.rig.cam0.lens.name == "equidistant"
    assert sequence.imu_noise is not None
    assert sequence.imu_noise.accel == 0.0014
    (tum_vi / "dso" / "imu_config.yaml").unlink()
    assert open_sequence(tum_vi).counts == {"no_imu_noise": 1}


def test_pictures_of_16_bits_become_8(tmp_path: Path) -> None:
    grey = np.arange(0, 256, dtype=np.uint16).reshape(16, 16)
    cv2.imwrite(str(tmp_path / "16.png"), grey * 257)
    np.testing.assert_array_equal(read_grey(tmp_path / "16.png"), grey)


def dso_alone(tum_vi: Path) -> Path:
    for camera in ("cam0", "cam1"):
        (tum_vi / "dso" / camera).mkdir()
        images = tum_vi / "dso" / camera / "images"
        (tum_vi / "mav0" / camera / "data").rename(images)
        rows = (f"{p.stem} {int(p.stem) / 1e9:.9f} 5.0" for p in sorted(images.iterdir()))
        text = "\n".join(["# timestamp(ns) timestamp(s) exposure", *rows])
        (tum_vi / "dso" / camera / "times.txt").write_text(text)
    text = (tum_vi / "mav0/imu0/data.csv").read_text().replace(",", " ")
    (tum_vi / "dso" / "imu.txt").write_text(text)
    shutil.rmtree(tum_vi / "mav0")
    return tum_vi / "dso"


def test_dso_alone(tum_vi: Path, edit: Edit) -> None:
    dso = dso_alone(tum_vi)
    assert len(open_sequence(dso)) == len(open_sequence(tum_vi)) == 6
    edit(dso / "imu.txt", " 9.8\n", " 9.8 1\n")
    with pytest.raises(DatasetError, match=r"imu\.txt, row 2: 8 columns where 7"):
        open_sequence(dso)
    edit(dso / "cam1" / "times.txt", "1403636580200000555 ", "1403636580200000555.5 ")
    with pytest.raises(DatasetError, match=r"times\.txt, row 4: .* is not a stamp"):
        open_sequence(dso)


# ---- VIODE


def test_viode(viode: Path) -> None:
    for stamp in (1403636580000000555, 1403636580100000555):
        for camera in ("cam0", "cam1"):
            picture = np.zeros((24, 32, 3), dtype=np.uint8)
            cv2.imwrite(str(viode / f"mav0/{camera}/segmentation/{stamp}.png"), picture)
    (viode.parent / "rgb_ids.txt").write_text("id,r,g,b\n241,49,89,160\n")
    sequence = open_sequence(viode)
    assert (sequence.kind, sequence.name, len(sequence)) == ("viode", "MH_tiny", 6)
    assert sequence.rig.baseline == pytest.approx(0.05)
    assert sequence.rig.time_offset_s == 0.01
    assert sequence.imu_noise is None
    assert sequence.segmentation is not None
    assert dict(sequence.segmentation.colours) == {241: (49, 89, 160)}
    assert [len(pictures) for pictures in sequence.segmentation.pictures] == [2, 2]


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("cam1_pinhole.yaml", "PINHOLE", "MEI", "'model_type': 'MEI' is not known"),
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


def test_colours_and_ids_of_segmentation(painted_rig: StereoRig, tmp_path: Path) -> None:
    (tmp_path / "rgb_ids.txt").write_text("id,r,g,b\n7,10,20,30\n8,10,20,31\n")
    colours = read_colours(tmp_path / "rgb_ids.txt")
    picture = np.zeros((240, 320, 3), dtype=np.uint8)
    picture[:10], picture[10:20] = (30, 20, 10), (31, 20, 10)  # blue first, as OpenCV writes
    cv2.imwrite(str(tmp_path / "5.png"), picture)
    cv2.imwrite(str(tmp_path / "6.png"), np.full((240, 320), 7, dtype=np.uint8))
    paths = {n: tmp_path / f"{n}.png" for n in (5, 6)}
    masks = InstanceMasks.make(InstanceImages((paths, {}), colours), (7,), painted_rig)
    left, right = masks.of(5)
    assert left is not None and right is None
    np.testing.assert_array_equal(np.flatnonzero(left.any(axis=1)), np.arange(10))
    grey, _ = masks.of(6)
    assert grey is not None and grey.all()
    cv2.imwrite(str(tmp_path / "5.png"), picture[:100])
    with pytest.raises(InputError, match=r"5\.png: is 320x100, the camera 320x240"):
        masks.of(5)
    for row in ("8,10,20,310", "1e19,10,20,31"):
        (tmp_path / "rgb_ids.txt").write_text(f"id,r,g,b\n7,10,20,30\n{row}\n")
        with pytest.raises(DatasetError, match=r"rgb_ids\.txt, row 3: no colour"):
            read_colours(tmp_path / "rgb_ids.txt")


# ---- UZH-FPV


def test_uzh_fpv(uzh_fpv: Path) -> None:
    sequence = open_sequence(uzh_fpv)
    assert (sequence.kind, len(sequence), sequence.warnings) == ("uzh_fpv", 6, ())
    assert sequence.frame_ns.tolist() == [1540821844 * 10**9 + n * 10**8 for n in range(6)]
    assert sequence.imu is not None
    assert sequence.imu.timestamp_ns[1] == 1540821843_910_000_000
    np.testing.assert_array_equal(sequence.imu.gyro[3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sequence.imu.accel[3], [0.0, 0.5, 9.8])
    assert sequence.rig.baseline == pytest.approx(0.1)
    assert sequence.imu_noise is not None


def test_uzh_fpv_imu_without_numbers(uzh_fpv: Path) -> None:
    rows = (uzh_fpv / "imu.txt").read_text().split("\n")[1:]
    (uzh_fpv / "imu.txt").write_text("\n".join(row.split(" ", 1)[1] for row in rows))
    assert open_sequence(uzh_fpv).counts == {}


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("imu.txt", "1540821843.910", "noon", "row 3: 'noon' is not a number"),
        ("imu.txt", "0.3 0 0.5 9.8\n", "0.3\n", "5 columns; 7 or 8 are known"),
        ("left_images.txt", "2 1540821844.20 ", "2 ", "row 4: 2 columns where 3"),
        ("left_images.txt", "1540821844.20", "soon", "row 4: 'soon' is not a time in seconds"),
        ("right_images.txt", "img/", "pictures/", "none of its 6 images is there"),
    ],
)
def test_broken_uzh_fpv_files(
    uzh_fpv: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    edit(uzh_fpv / name, old, new)
    with pytest.raises(DatasetError, match=message) as caught:
        open_sequence(uzh_fpv)
    assert str(uzh_fpv / name) in str(caught.value)


def test_uzh_fpv_without_calibration(uzh_fpv: Path) -> None:
    shutil.rmtree(uzh_fpv.parent / "indoor_forward_calib_snapdragon")
    with pytest.raises(CalibrationError, match=r"no calibration .* give it with --calibration"):
        open_sequence(uzh_fpv)
    write_chain(uzh_fpv.parent / "mine.yaml")
    found = open_sequence(uzh_fpv, calibration=uzh_fpv.parent / "mine.yaml")
    assert found.rig.baseline == pytest.approx(0.1)


# ---- 4Seasons


def test_four_seasons(four_seasons: Path) -> None:
    sequence = open_sequence(four_seasons)
    assert (sequence.kind, len(sequence)) == ("4seasons", 6)
    assert sequence.counts == {"no_imu_noise": 1}
    assert sequence.rig.cam0.fx == 20.5
    np.testing.assert_allclose(sequence.rig.T_imu_cam0[:3, 3], [-0.1, -0.2, -0.3], atol=1e-12)
    np.testing.assert_allclose(sequence.rig.T_cam1_cam0[:3, 3], [-0.3, 0.0, 0.0], atol=1e-12)
    (four_seasons / "times.txt").unlink()
    assert len(open_sequence(four_seasons)) == 6
    folder = four_seasons.parent / "calibration"
    (folder / "imu_config.yaml").write_text(_NOISE)
    assert open_sequence(four_seasons).imu_noise is not None
    (four_seasons / "Transformations.txt").unlink()
    write_chain(folder / "camchain.yaml")
    np.testing.assert_array_equal(open_sequence(four_seasons).rig.T_imu_cam0[:3, 3], 0.0)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("../calibration/undistorted_calib_1.txt", "Pinhole", "FOV", "row 1: no pinhole"),
        ("../calibration/undistorted_calib_1.txt", "20.5 20.5", "0 0", "impossible camera"),
        ("../calibration/undistorted_calib_stereo.txt", "1 0 0 -0.3", "2 0 0 -0.3", "no rigid 4x4"),
        ("Transformations.txt", "TS_cam_imu", "TS", "no row '# TS_cam_imu'"),
        ("Transformations.txt", "0.1,0.2,0.3,0,0,0,1", "0.1,0.2,0.3,0,0,0,2", "row 4: no trans"),
        ("Transformations.txt", "0.1,0.2,0.3,0,0,0,1", "0.1,0.2,0.3,nan,0,0,1", "row 4: no trans"),
        ("Transformations.txt", "0.1,0.2,0.3,0,0,0,1", "inf,0.2,0.3,0,0,0,1", "row 4: no trans"),
    ],
)
def test_broken_four_seasons_files(
    four_seasons: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    edit(four_seasons / name, old, new)
    with pytest.raises(CalibrationError, match=message) as caught:
        open_sequence(four_seasons)
    assert Path(name).name in str(caught.value)
