"""Writes a sequence as a VIODE folder: ASL with segmentation images, its truth beside it.

Layout: `ovmot.datasets.viode.reader`. Images have no distortion, as the data set's, whatever the
rig's camera models are. The segmentation shows 0 for the scene and each mover's id, in the colours
of `rgb_ids.txt`.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig, without_distortion
from ovmot.datasets.asl import write_asl_imu, write_listed
from ovmot.datasets.writing import (
    FrameToWrite,
    SequenceToWrite,
    make_folders,
    writable,
    write_frames,
    write_imu_truth,
    write_png,
    write_true_poses,
)
from ovmot.geometry.arrays import FloatArray, Image

_CAMERAS = ("cam0", "cam1")


def colour_table() -> Image:
    """Colours (256, 3) of the ids, red, green, blue; no two are alike."""
    ids = np.arange(256)[:, None]
    return np.asarray(43 + ids * np.array([119, 53, 201]), dtype=np.int64).astype(np.uint8)


def write_viode(folder: Path, sequence: SequenceToWrite) -> Iterator[int]:
    """Write the sequence, as `write_asl`; the time offset is `td` of the calibration.

    Raises `InputError` where the folder is not empty or not writable.
    """
    with writable(folder):
        yield from _write(folder, sequence, without_distortion(sequence.rig))


def _write(folder: Path, sequence: SequenceToWrite, rig: StereoRig) -> Iterator[int]:
    mav = folder / "mav0"
    names = [f"mav0/{camera}/{part}" for camera in _CAMERAS for part in ("data", "segmentation")]
    make_folders(folder, (*names, "mav0/imu0", "calibration_files", "segmentation"))
    for camera in _CAMERAS:
        write_listed(mav / camera, sequence.camera_ns)
    imu = sequence.imu
    write_asl_imu(mav / "imu0/data.csv", imu)
    write_imu_truth(folder, imu)
    write_true_poses(folder, sequence)
    _write_calibration(folder / "calibration_files", rig)
    colours = colour_table()
    rows = "".join(f"{i},{r},{g},{b}\n" for i, (r, g, b) in enumerate(colours.tolist()))
    (folder / "segmentation/rgb_ids.txt").write_text(f"id,r,g,b\n{rows}")

    def save(frame: FrameToWrite) -> None:
        name = f"{frame.frame.timestamp_ns}.png"
        views = zip(frame.frame.pair, (frame.left_id, frame.right_id), strict=True)
        for camera, (grey, ids) in zip(_CAMERAS, views, strict=True):
            write_png(mav / camera / "data" / name, cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
            write_png(mav / camera / "segmentation" / name, colours[ids][..., ::-1])

    yield from write_frames(folder, sequence, rig, save)


def _write_calibration(folder: Path, rig: StereoRig) -> None:
    """The files of VINS-Fusion, as the data set gives them."""
    lines = ["%YAML:1.0", "imu: 1", "num_of_cam: 2", 'imu_topic: "/imu0"']
    for i, (camera, T) in enumerate(
        zip(rig.cameras, (rig.T_imu_cam0, rig.T_imu_cam1), strict=True)
    ):
        lines += [f'image{i}_topic: "/cam{i}/image_raw"', f'cam{i}_calib: "cam{i}_pinhole.yaml"']
        lines += [f"body_T_cam{i}: !!opencv-matrix", *_matrix(T)]
        _write_camera(folder / f"cam{i}_pinhole.yaml", camera)
    lines += [f"td: {rig.time_offset_s!r}"]
    (folder / "calibration.yaml").write_text("\n".join([*lines, ""]))


def _matrix(T: FloatArray) -> list[str]:
    numbers = ", ".join(repr(x) for x in T.ravel().tolist())
    return ["   rows: 4", "   cols: 4", "   dt: d", f"   data: [{numbers}]"]


def _write_camera(path: Path, camera: Camera) -> None:
    fx, fy, cx, cy, _ = camera.intrinsics.tolist()
    k1, k2, p1, p2 = camera.distortion.tolist()
    path.write_text(
        "%YAML:1.0\n---\nmodel_type: PINHOLE\ncamera_name: camera\n"
        f"image_width: {camera.width}\nimage_height: {camera.height}\n"
        f"distortion_parameters:\n   k1: {k1!r}\n   k2: {k2!r}\n   p1: {p1!r}\n   p2: {p2!r}\n"
        f"projection_parameters:\n   fx: {fx!r}\n   fy: {fy!r}\n   cx: {cx!r}\n   cy: {cy!r}\n"
    )
