"""Small pictures of a run: as they were, few however long it is, and never its end."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.outputs.preview import PreviewFile, decoded, read_preview
from ovmot.types import FrameResult, StereoFrame

Maker = Callable[[int], FrameResult]
SECOND = 1_000_000_000


def write(path: Path, rig: StereoRig, results: list[FrameResult]) -> None:
    file = PreviewFile(path, rig.cam0)
    for result in results:
        file.write(result)
    file.close()
    file.close()


def painted(result: FrameResult, size: tuple[int, int]) -> FrameResult:
    v, u = np.mgrid[: size[0], : size[1]]
    grey = (127 + 120 * np.sin(u / 17) * np.cos(v / 23)).astype(np.uint8)
    return replace(result, frame=StereoFrame(result.timestamp_ns, grey, grey))


def test_what_is_read_is_what_was_seen(tmp_path: Path, rig: StereoRig, make_result: Maker) -> None:
    results = [painted(make_result(k * SECOND), (160, 240)) for k in range(3)]
    write(tmp_path / "preview.npz", rig, results)
    preview = read_preview(tmp_path / "preview.npz")
    assert [p.timestamp_ns for p in preview.pictures] == [0, SECOND, 2 * SECOND]
    points = results[0].points
    np.testing.assert_allclose(preview.pictures[1].pixels, points.pixels[:, :2], atol=1e-4)
    np.testing.assert_allclose(preview.pictures[1].previous, points.previous, atol=1e-4)
    np.testing.assert_array_equal(preview.pictures[1].label, points.label)
    np.testing.assert_array_equal(preview.pictures[1].track_id, points.track_id)
    image = decoded(preview.pictures[0].jpeg).astype(float)
    assert isinstance(results[0].frame, StereoFrame)
    assert np.mean(np.abs(image - results[0].frame.left)) < 3.0
    np.testing.assert_array_equal(preview.camera.intrinsics, rig.cam0.intrinsics)
    np.testing.assert_array_equal(preview.camera.distortion, rig.cam0.distortion)
    assert preview.camera.model is rig.cam0.model
    view = decoded(preview.views[3].jpeg)  # of the box of 40.5 x 40 pixels, and a margin
    assert view.shape == pytest.approx((52, 53), abs=2)


def test_large_images_become_small(tmp_path: Path, rig: StereoRig, make_result: Maker) -> None:
    write(tmp_path / "preview.npz", rig, [painted(make_result(0), (560, 1280))])
    (picture,) = read_preview(tmp_path / "preview.npz").pictures
    assert decoded(picture.jpeg).shape == (350, 800)


def test_a_long_run_keeps_few_pictures_over_all_of_it(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    n, step = 3000, SECOND // 10
    write(tmp_path / "preview.npz", rig, [make_result(k * step) for k in range(n)])
    stamps = [p.timestamp_ns for p in read_preview(tmp_path / "preview.npz").pictures]
    assert 100 <= len(stamps) <= 200
    gaps = np.diff(stamps)
    assert gaps.max() <= 2 * gaps.min()
    assert stamps[0] == 0
    assert stamps[-1] > 0.98 * n * step


def test_the_largest_view_of_an_object_is_kept(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    results = []
    for k, size in enumerate((20.0, 60.0, 30.0)):
        result = painted(make_result(k * SECOND), (160, 240))
        (track,) = result.tracks
        box = np.array([50.0, 40.0, 50.0 + size, 40.0 + size])
        results.append(replace(result, tracks=(replace(track, box_px=box),)))
    write(tmp_path / "preview.npz", rig, results)
    assert decoded(read_preview(tmp_path / "preview.npz").views[3].jpeg).shape == (76, 76)


def test_without_images_there_is_no_file(tmp_path: Path, rig: StereoRig) -> None:
    write(tmp_path / "preview.npz", rig, [])
    assert not (tmp_path / "preview.npz").exists()


def test_a_full_disk_is_a_warning_and_leaves_no_half_file(
    tmp_path: Path,
    rig: StereoRig,
    make_result: Maker,
    full_disk: Callable[[int], AbstractContextManager[None]],
) -> None:
    results = [painted(make_result(k * SECOND), (160, 240)) for k in range(9)]
    with full_disk(4096), pytest.warns(UserWarning, match=r"preview\.npz: cannot be written"):
        write(tmp_path / "preview.npz", rig, results)
    assert not (tmp_path / "preview.npz").exists()


@pytest.mark.parametrize("spoil", ["cut", "text", "missing"])
def test_a_broken_file_is_a_clear_error(
    tmp_path: Path, rig: StereoRig, make_result: Maker, spoil: str
) -> None:
    path = tmp_path / "preview.npz"
    write(path, rig, [make_result(0)])
    whole = path.read_bytes()
    if spoil == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif spoil == "text":
        path.write_text("no pictures")
    else:
        np.savez(path, timestamp_ns=np.zeros(1))
    with pytest.raises(InputError, match=r"preview\.npz: is no preview of a run"):
        read_preview(path)
