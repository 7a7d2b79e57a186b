from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.outputs.trails import Trails
from ovmot.outputs.video import OverlayVideo
from ovmot.outputs.views import VIEW_NAMES, View, draw_view
from ovmot.types import FeatureFrame, FrameResult, StereoFrame

Maker = Callable[[int], FrameResult]
STAMPS = (0, 50_000_000, 100_000_000, 250_000_000, 300_000_000)


def write_video(
    path: Path, rig: StereoRig, results: list[FrameResult], view: View = "objects"
) -> None:
    output = OverlayVideo(path, rig, view)
    for result in results:
        output.write(result)
    output.close()


def textured(result: FrameResult, size: tuple[int, int] = (160, 240)) -> FrameResult:
    """The result with a smooth pattern for an image, so that right and wrong decoding differ."""
    v, u = np.mgrid[: size[0], : size[1]]
    grey = (127 + 120 * np.sin(u / 17) * np.cos(v / 23)).astype(np.uint8)
    return replace(result, frame=StereoFrame(result.timestamp_ns, grey, grey))


@pytest.mark.parametrize("view", VIEW_NAMES)
def test_what_is_decoded_is_what_was_drawn(
    tmp_path: Path, rig: StereoRig, make_result: Maker, view: View
) -> None:
    path = tmp_path / "overlay.mp4"
    results = [textured(make_result(stamp)) for stamp in STAMPS]
    write_video(path, rig, results, view)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        frames = list(container.decode(stream))
    assert len(frames) == len(STAMPS)
    assert [frame.time for frame in frames] == pytest.approx([1e-9 * s for s in STAMPS], abs=1e-4)
    trails = Trails()
    for frame, result in zip(frames, results, strict=True):
        expected = draw_view(view, result, rig, trails := trails.extended(result))
        decoded = frame.to_ndarray(format="bgr24")
        assert decoded.shape == expected.shape
        assert np.mean(np.abs(decoded.astype(float) - expected)) < 6.0


def test_a_browser_can_start_before_the_end_of_the_file(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    path = tmp_path / "overlay.mp4"
    write_video(path, rig, [make_result(stamp) for stamp in STAMPS])
    data = path.read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")


@pytest.mark.parametrize("n_frames", [0, 1])
def test_short_runs(tmp_path: Path, rig: StereoRig, make_result: Maker, n_frames: int) -> None:
    path = tmp_path / "overlay.mp4"
    write_video(path, rig, [make_result(stamp) for stamp in STAMPS[:n_frames]])
    if n_frames == 0:
        assert not path.exists()
        return
    with av.open(str(path)) as container:
        assert len(list(container.decode(video=0))) == n_frames


def test_full_disk_is_reported_and_what_was_written_can_be_played(
    tmp_path: Path,
    rig: StereoRig,
    make_result: Maker,
    full_disk: Callable[[int], AbstractContextManager[None]],
) -> None:
    path = tmp_path / "overlay.mp4"
    stamps = range(0, 100 * 50_000_000, 50_000_000)
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (len(stamps), 160, 240), dtype=np.uint8)
    results = [
        replace(make_result(stamp), frame=StereoFrame(stamp, image, image))
        for stamp, image in zip(stamps, noise, strict=True)
    ]
    write_video(path, rig, results[:70])
    limit = path.stat().st_size
    with full_disk(limit), pytest.raises(OvmotError, match=r"overlay\.mp4: cannot write the video"):
        write_video(path, rig, results)
    n_frames = 0
    with av.open(str(path)) as container, suppress(av.error.InvalidDataError):
        for _ in container.decode(video=0):  # up to what the last fragment lacks
            n_frames += 1
    assert n_frames >= 30


def test_a_failure_in_the_background_comes_out_once_and_nobody_hangs(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    output = OverlayVideo(tmp_path / "overlay.mp4", rig)
    without_images = FeatureFrame(0, np.empty(0, np.int64), np.empty((0, 4)))

    def write_many() -> None:
        output.write(replace(make_result(0), frame=without_images))
        for stamp in range(1, 100):  # many more than may wait
            output.write(make_result(stamp))
        output.close()

    with pytest.raises(OvmotError, match="no images to draw on"):
        write_many()
    output.close()
    output.close()


def test_a_process_that_has_died_is_a_clear_error(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    output = OverlayVideo(tmp_path / "overlay.mp4", rig)
    output.write(make_result(0))
    output.process.kill()
    with pytest.raises(OvmotError, match="the process that writes the video has died"):
        for stamp in range(1, 100):
            output.write(make_result(stamp))
        output.close()
    output.close()


def test_missing_folder_is_a_clear_error(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    with pytest.raises(OvmotError, match=r"nowhere/overlay\.mp4: cannot write the video"):
        write_video(tmp_path / "nowhere" / "overlay.mp4", rig, [make_result(0)])
