"""A sequence written in the form of a data set is read back: rig, stamps, samples, images."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from written_formats import (
    FORMS,
    KEEPS_NOISE,
    SEED,
    RigCheck,
    assert_same_imu,
    of_form,
    rendered,
)

from ovmot.datasets.registry import WRITERS, open_sequence
from ovmot.errors import CalibrationError, InputError
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation


@pytest.fixture(scope="module", params=sorted(FORMS))
def form(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def written(
    form: str, small_simulation: Simulation, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp(form) / "data"
    simulation = of_form(form, small_simulation)
    assert list(WRITERS[form](folder, record(simulation, SEED))) == simulation.camera_ns.tolist()
    return folder


def test_every_form_has_a_test() -> None:
    assert WRITERS.keys() == FORMS.keys()


def test_what_was_written_is_read(
    written: Path, form: str, small_simulation: Simulation, assert_same_rig: RigCheck
) -> None:
    simulation = of_form(form, small_simulation)
    sequence = open_sequence(written)
    assert sequence.kind == FORMS[form][0]
    assert_same_rig(sequence.rig, FORMS[form][2](simulation.rig))
    assert sequence.rig.time_offset_s == simulation.rig.time_offset_s
    assert sequence.imu_noise == (simulation.imu.noise if form in KEEPS_NOISE else None)
    np.testing.assert_array_equal(sequence.frame_ns, simulation.camera_ns)
    assert_same_imu(sequence, form, simulation)
    if form == "kaist":
        return  # its images are mosaics: test_writer.py
    paths = zip(sequence.left_paths, sequence.right_paths, strict=True)
    for frame, (left, right) in zip(rendered(form, simulation), paths, strict=True):
        np.testing.assert_array_equal(sequence.decode(left), frame.frame.left)
        np.testing.assert_array_equal(sequence.decode(right), frame.frame.right)
    assert frame.frame.left.std() > 10.0


def test_kinds_are_told_apart(euroc: Path, uzh_fpv: Path, four_seasons: Path) -> None:
    assert open_sequence(euroc).kind == "euroc"
    assert open_sequence(uzh_fpv).kind == "uzh_fpv"
    assert open_sequence(four_seasons).kind == "4seasons"


def test_sequence_chosen_in_a_folder_of_folders(euroc: Path) -> None:
    assert open_sequence(euroc.parent, sequence="MH_tiny").kind == "euroc"


def test_folders_that_are_no_data_set(tmp_path: Path, euroc: Path, kaist: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        open_sequence(tmp_path / "gone")
    with pytest.raises(InputError, match="not a folder"):
        open_sequence(euroc / "mav0" / "imu0" / "data.csv")
    with pytest.raises(InputError, match=r"no known kind.*by --format.*: euroc, kaist"):
        open_sequence(tmp_path)
    shutil.copytree(euroc / "mav0", kaist / "mav0")
    with pytest.raises(InputError, match="looks like euroc and kaist; choose with --format"):
        open_sequence(kaist)
    assert open_sequence(kaist, format="kaist").kind == "kaist"
    with pytest.raises(InputError, match="unknown; known: euroc, kaist, kitti"):
        open_sequence(kaist, format="rosbag")
    with pytest.raises(InputError, match="not a KITTI folder"):
        open_sequence(euroc, format="kitti")


def test_calibration_given_beside_the_data(euroc: Path, tmp_path: Path) -> None:
    chain = tmp_path / "chain.yaml"
    camera = "{T_imu_cam: [1,0,0,%s, 0,1,0,0, 0,0,1,0, 0,0,0,1], intrinsics: [30,30,16,12],"
    camera += " distortion_model: none, resolution: [32, 24], timeshift_cam_imu: 0.01}"
    chain.write_text(f"cam0: {camera % 0.0}\ncam1: {camera % 0.2}\n")
    sequence = open_sequence(euroc, calibration=chain)
    assert sequence.rig.baseline == pytest.approx(0.2)
    assert sequence.rig.time_offset_s == 0.01
    assert sequence.imu_noise is None
    with pytest.raises(CalibrationError, match="no such calibration file"):
        open_sequence(euroc, calibration=tmp_path / "gone.yaml")


@pytest.mark.parametrize(
    ("name", "kind", "frames", "samples"),
    [
        ("euroc_mh01", "euroc", 161, 3498),
        ("street_traffic", "kaist", 200, 2080),
        ("kaist_sample", "kaist", 1, None),
        ("kitti_tracking", "kitti", 21, None),
    ],
)
def test_real_folders(
    data_root: Path, name: str, kind: str, frames: int, samples: int | None
) -> None:
    if not (data_root / name).is_dir():
        pytest.skip(f"{data_root / name} is missing")
    sequence = open_sequence(data_root / name)
    assert (sequence.kind, len(sequence)) == (kind, frames)
    assert (None if sequence.imu is None else len(sequence.imu)) == samples
