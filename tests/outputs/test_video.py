from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.outputs import video
from ovmot.outputs.tracks_overlay import Trails
from ovmot.outputs.video import OverlayVideo, compose
from ovmot.types import FrameResult, StereoFrame

Maker = Callable[[int], FrameResult]
STAMPS = (0, 50_000_000, 100_000_000, 250_000_000, 300_000_000)


def write_video(path: Path, rig: StereoRig, results: list[FrameResult]) -> None:
    output = OverlayVideo(path, rig)
    for result in results:
        output.write(result)
    output.close()


def textured(result: FrameResult, size: tuple[int, int] = (160, 240)) -> FrameResult:
    """The result with a smooth pattern for an image, so that right and wrong decoding differ."""
    v, u = np.mgrid[: size[0], : size[1]]
    grey = (127 + 120 * np.sin(u / 17) * np.cos(v / 23)).astype(np.uint8)
    return replace(result, frame=StereoFrame(result.timestamp_ns, grey, grey))


def test_what_is_decoded_is_what_was_drawn(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    path = tmp_path / "overlay.mp4"
    results = [textured(make_result(stamp)) for stamp in STAMPS]
    write_video(path, rig, results)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        frames = list(container.decode(stream))
    assert len(frames) == len(STAMPS)
    assert [frame.time for frame in frames] == pytest.approx([1e-9 * s for s in STAMPS], abs=1e-4)
    trails = Trails()
    for frame, result in zip(frames, results, strict=True):
        expected = compose(result, rig, trails := trails.extended(result))
        decoded = frame.to_ndarray(format="bgr24")
        assert decoded.shape == expected.shape == (480, 480, 3)
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


@pytest.mark.parametrize(
    ("size", "canvas"),
    [
        ((43, 65), (130, 130)),  # 43 + 86 rows, made even
        ((280, 640), (840, 1280)),
        ((560, 1280), (1260, 1920)),  # no wider than 1920
        ((375, 1242), (870, 1920)),
        ((401, 1281), (902, 1920)),
    ],
)
def test_canvas_is_even_and_holds_both_images(
    rig: StereoRig, make_result: Maker, size: tuple[int, int], canvas: tuple[int, int]
) -> None:
    image = compose(textured(make_result(0), size), rig)
    assert image.shape == (*canvas, 3)
    assert image[-3, -3].any()


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
    tmp_path: Path, rig: StereoRig, make_result: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(result: FrameResult, rig: StereoRig, trails: Trails) -> None:
        raise ValueError("cannot draw")

    monkeypatch.setattr(video, "compose", fail)
    output = OverlayVideo(tmp_path / "overlay.mp4", rig)

    def write_many() -> None:
        for stamp in range(100):  # many more than may wait
            output.write(make_result(stamp))
        output.close()

    with pytest.raises(ValueError, match="cannot draw"):
        write_many()
    output.close()
    output.close()


def test_missing_folder_is_a_clear_error(
    tmp_path: Path, rig: StereoRig, make_result: Maker
) -> None:
    with pytest.raises(OvmotError, match=r"nowhere/overlay\.mp4: cannot write the video"):
        write_video(tmp_path / "nowhere" / "overlay.mp4", rig, [make_result(0)])
