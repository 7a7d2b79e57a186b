"""A sequence written in the form of a data set is read back: rig, stamps, samples, pictures."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.models import CAMERA_MODELS
from ovmot.cameras.rig import StereoRig, rectified, without_distortion
from ovmot.datasets.instance_masks import InstanceMasks
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.sequence import FolderSequence
from ovmot.errors import InputError
from ovmot.sim.render import RenderedFrame, render_stereo
from ovmot.sim.sequence_files import generators, imu_samples
from ovmot.sim.simulation import Simulation
from ovmot.sim.writers import WRITERS

SEED = 5
RigCheck = Callable[[StereoRig, StereoRig], None]


def fisheye(camera: Camera) -> Camera:
    coefficients = np.array([-0.02, 0.004, -0.002, 0.0003])
    return replace(camera, lens=CAMERA_MODELS["equidistant"], distortion=coefficients)


def with_fisheye(rig: StereoRig) -> StereoRig:
    return replace(rig, cam0=fisheye(rig.cam0), cam1=fisheye(rig.cam1))


def same(rig: StereoRig) -> StereoRig:
    return rig


# form -> (kind that is recognised, the street's rig -> the rig given, -> the rig of the pictures)
FORMS = {
    "kaist": ("kaist", same, same),
    "asl": ("euroc", same, same),
    "kitti_sync": ("kitti_raw", same, rectified),
    "kitti_extract": ("kitti_raw", same, same),
    "tum_vi": ("tum_vi", with_fisheye, same),
    "viode": ("viode", same, without_distortion),
    "uzh_fpv": ("uzh_fpv", with_fisheye, same),
    "4seasons": ("4seasons", same, rectified),
}
KEEPS_OFFSET = {"tum_vi", "uzh_fpv", "viode"}
KEEPS_NOISE = {"asl", "tum_vi", "uzh_fpv"}


def of_form(form: str, small: Simulation) -> Simulation:
    """The small street through the form's lenses, three frames; its clocks differ where it can."""
    offset_s = 0.013 if form in KEEPS_OFFSET else 0.0
    rig = replace(FORMS[form][1](small.rig), time_offset_s=offset_s)
    return replace(small, rig=rig, camera_ns=small.camera_ns[:3])


def rendered(form: str, simulation: Simulation) -> list[RenderedFrame]:
    return list(
        render_stereo(
            simulation.scene, FORMS[form][2](simulation.rig), simulation.path, simulation.camera_ns,
            simulation.optics, generators(SEED)[0],
        )
    )  # fmt: skip


@pytest.fixture(scope="module", params=sorted(FORMS))
def form(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def written(
    form: str, small_simulation: Simulation, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp(form) / "data"
    simulation = of_form(form, small_simulation)
    assert list(WRITERS[form](folder, simulation, SEED)) == simulation.camera_ns.tolist()
    return folder


def assert_same_imu(sequence: FolderSequence, form: str, simulation: Simulation) -> None:
    imu = imu_samples(simulation, generators(SEED)[1]).data
    kept = np.ones(len(imu), dtype=bool)
    if form == "kitti_sync":  # one sample a picture, at its time
        kept = np.isin(imu.timestamp_ns, simulation.camera_ns)
        assert np.count_nonzero(kept) == len(simulation.camera_ns)
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.timestamp_ns, imu.timestamp_ns[kept])
    np.testing.assert_allclose(sequence.imu.gyro, imu.gyro[kept], rtol=0.0, atol=5.1e-10)
    np.testing.assert_allclose(sequence.imu.accel, imu.accel[kept], rtol=0.0, atol=5.1e-10)


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
        return  # its pictures are mosaics: test_writer.py
    paths = zip(sequence.left_paths, sequence.right_paths, strict=True)
    for frame, (left, right) in zip(rendered(form, simulation), paths, strict=True):
        np.testing.assert_array_equal(sequence.decode(left), frame.frame.left)
        np.testing.assert_array_equal(sequence.decode(right), frame.frame.right)
    assert frame.frame.left.std() > 10.0


def test_dso_alone_is_tum_vi_too(small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = of_form("tum_vi", small_simulation)
    list(WRITERS["tum_vi"](tmp_path / "whole", simulation, SEED))
    shutil.copytree(tmp_path / "whole/dso", tmp_path / "room/dso")  # links become folders
    sequence = open_sequence(tmp_path / "room")
    assert (sequence.kind, sequence.name) == ("tum_vi", "room")
    np.testing.assert_array_equal(sequence.frame_ns, simulation.camera_ns)
    assert_same_imu(sequence, "tum_vi", simulation)
    whole = open_sequence(tmp_path / "whole" / "mav0")
    assert (whole.kind, whole.name) == ("tum_vi", "whole")


def test_segmentation_of_viode_becomes_masks(small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = of_form("viode", small_simulation)
    list(WRITERS["viode"](tmp_path, simulation, SEED))
    sequence = open_sequence(tmp_path)
    assert sequence.segmentation is not None
    frame = rendered("viode", simulation)[1]
    seen = np.unique(frame.left.object_id)
    ids = tuple(int(i) for i in seen[seen > 0][:2])
    assert len(ids) == 2
    masks = InstanceMasks.make(sequence.segmentation, ids, sequence.rig)
    left, right = masks.of(frame.frame.timestamp_ns)
    assert left is not None and right is not None
    np.testing.assert_array_equal(left > 0, np.isin(frame.left.object_id, ids))
    np.testing.assert_array_equal(right > 0, np.isin(frame.right.object_id, ids))
    assert masks.of(1) == (None, None)
    (tmp_path / "segmentation/rgb_ids.txt").unlink()
    bare = open_sequence(tmp_path)
    assert bare.counts["no_segmentation_colours"] == 1
    assert bare.segmentation is not None
    with pytest.raises(InputError, match=r"segmentation/\d+\.png: no colour is known for id"):
        replace(masks, segmentation=bare.segmentation).of(frame.frame.timestamp_ns)


@pytest.mark.parametrize("form", ["tum_vi", "uzh_fpv"])
def test_kalibr_files_hold_no_skew(form: str, small_simulation: Simulation, tmp_path: Path) -> None:
    skewed = Camera.make((160, 70), (100, 100), (80, 35), "none", skew=0.1)
    rig = replace(small_simulation.rig, cam0=skewed)
    with pytest.raises(InputError, match=r"skew of 0\.1"):
        next(WRITERS[form](tmp_path / "new", replace(small_simulation, rig=rig), SEED))
    assert not (tmp_path / "new").exists()


def test_kitti_files_hold_no_fisheye(small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = replace(small_simulation, rig=with_fisheye(small_simulation.rig))
    with pytest.raises(InputError, match="lens 'equidistant'; use radtan"):
        next(WRITERS["kitti_extract"](tmp_path / "new", simulation, SEED))
