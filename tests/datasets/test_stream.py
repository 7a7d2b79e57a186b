"""Events: their order, decoding ahead, broken images, clean ends."""

import itertools
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.datasets import events, open_sequence
from ovmot.datasets.images import image_size, read_bayer_as_grey, read_grey
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import Image
from ovmot.types import Event, ImuSample, StereoFrame


def frames_of(stream: list[Event]) -> list[StereoFrame]:
    return [event for event in stream if isinstance(event, StereoFrame)]


def decode_threads() -> list[str]:
    return [t.name for t in threading.enumerate() if t.name.startswith("ovmot-decode")]


def test_events_come_in_time_order(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    stream = list(events(sequence))
    stamps = [event.timestamp_ns for event in stream]
    assert stamps == sorted(stamps)
    assert len(stream) == 6 + 121
    # the IMU has a sample at each frame's very stamp: it comes before the frame
    for before, event in itertools.pairwise(stream):
        if isinstance(event, StereoFrame):
            assert isinstance(before, ImuSample)
            assert before.timestamp_ns == event.timestamp_ns
    assert isinstance(stream[-1], ImuSample)


def test_frames_hold_their_own_images(euroc: Path) -> None:
    for i, frame in enumerate(frames_of(list(events(open_sequence(euroc))))):
        assert frame.left.shape == (24, 32)
        assert frame.left.dtype == np.uint8
        assert np.all(frame.left == 10 * i)
        assert np.all(frame.right == 10 * (i + 10))


def test_a_part_of_the_frames(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    stamps = [f.timestamp_ns for f in frames_of(list(events(sequence, first=2, last=3)))]
    assert stamps == sequence.frame_ns[2:4].tolist()
    with pytest.raises(DatasetError, match="the sequence has frames 0 to 5"):
        events(sequence, first=6)


def test_frames_alone_without_imu(kitti_tracking: Path) -> None:
    stream = list(events(open_sequence(kitti_tracking)))
    assert [event.timestamp_ns for event in stream] == [0, 100_000_000, 200_000_000, 300_000_000]


def test_long_imu_before_the_first_frame_is_left_out(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    assert sequence.imu is not None
    early = sequence.imu.timestamp_ns[0] - np.arange(20, 0, -1) * 1_000_000_000
    longer = replace(
        sequence.imu,
        timestamp_ns=np.concatenate([early, sequence.imu.timestamp_ns]),
        gyro=np.concatenate([np.zeros((20, 3)), sequence.imu.gyro]),
        accel=np.concatenate([np.zeros((20, 3)), sequence.imu.accel]),
    )
    stream = list(events(replace(sequence, imu=longer)))
    assert len(stream) == 6 + 121 + 4  # 1 ... 4 s before lie within the 5 s


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: b"", "the image file is empty"),
        (lambda data: data[:-20], "truncated"),
        (lambda data: data[: len(data) // 2], "truncated"),
        (lambda data: data[:50] + bytes([data[50] ^ 255]) + data[51:], "corrupt"),
        (lambda data: b"this is no image", "not an image"),
    ],
)
def test_a_broken_image_stops_the_stream_at_its_frame(
    euroc: Path, damage: Callable[[bytes], bytes], message: str
) -> None:
    sequence = open_sequence(euroc)
    path = sequence.right_paths[3]
    path.write_bytes(damage(path.read_bytes()))
    seen: list[Event] = []
    with pytest.raises(DatasetError, match=message) as caught:
        for event in events(sequence):
            seen.append(event)
    assert str(path) in str(caught.value)
    assert len(frames_of(seen)) == 3
    assert decode_threads() == []


def test_an_image_that_vanished(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    sequence.left_paths[0].unlink()
    with pytest.raises(DatasetError, match="cannot read the image"):
        list(events(sequence))


def test_an_image_that_is_a_pipe(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    sequence.left_paths[0].unlink()
    os.mkfifo(sequence.left_paths[0])
    with pytest.raises(DatasetError, match=r"\.png: is no file"):
        list(events(sequence))


def test_an_image_of_another_size(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    cv2.imwrite(str(sequence.left_paths[2]), np.zeros((20, 30), dtype=np.uint8))
    with pytest.raises(DatasetError, match="the image is 30x20 pixels, its camera 32x24"):
        list(events(sequence))


def test_exchanged_width_and_height_are_named(euroc: Path) -> None:
    for camera in ("cam0", "cam1"):
        path = euroc / "mav0" / camera / "sensor.yaml"
        path.write_text(path.read_text().replace("[32, 24]", "[24, 32]"))
    with pytest.raises(DatasetError, match=r"its camera 24x32; exchange width and height"):
        list(events(open_sequence(euroc)))


def test_workers_end_when_the_reader_stops_early(euroc: Path) -> None:
    stream = events(open_sequence(euroc))
    while not isinstance(next(stream), StereoFrame):
        pass
    assert decode_threads() != []
    stream.close()
    assert decode_threads() == []


def test_decoding_runs_ahead_but_not_away(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    decoded: list[Path] = []

    def decode(path: Path) -> Image:
        decoded.append(path)
        return read_grey(path)

    many = replace(
        sequence,
        imu=None,
        frame_ns=np.arange(60),
        left_paths=sequence.left_paths * 10,
        right_paths=sequence.right_paths * 10,
        decode=decode,
    )
    stream = events(many)
    next(stream)
    deadline = time.monotonic() + 5.0
    while len(decoded) < 18 and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.05)
    assert len(decoded) == 18  # the pair given out and the eight ahead of it
    assert len(list(stream)) == 59
    assert len(decoded) == 120


def test_colour_and_sixteen_bits_become_grey(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "c.png"), np.full((4, 6, 3), (0, 0, 255), dtype=np.uint8))
    cv2.imwrite(str(tmp_path / "d.png"), np.full((4, 6), 40_000, dtype=np.uint16))
    red = read_grey(tmp_path / "c.png")
    assert red.shape == (4, 6)
    assert np.all(np.abs(red.astype(int) - 76) <= 1)  # 0.299 of 255
    assert np.all(read_grey(tmp_path / "d.png") == 156)
    assert np.all(read_bayer_as_grey(tmp_path / "d.png") == 156)
    np.testing.assert_array_equal(read_bayer_as_grey(tmp_path / "c.png"), red)
    assert image_size(tmp_path / "c.png") == (6, 4)
    cv2.imwrite(str(tmp_path / "e.jpg"), np.zeros((4, 6), dtype=np.uint8))
    assert image_size(tmp_path / "e.jpg") == (6, 4)


def test_bayer_pattern_of_a_colour_is_flat_after_demosaicing(tmp_path: Path) -> None:
    """OpenCV's `RG` in 2GRAY names the second row: a red scene is bright where y and x are odd."""
    raw = np.zeros((16, 16), dtype=np.uint8)
    raw[1::2, 1::2] = 200
    cv2.imwrite(str(tmp_path / "r.png"), raw)
    red = read_bayer_as_grey(tmp_path / "r.png")[2:-2, 2:-2]
    raw = np.zeros((16, 16), dtype=np.uint8)
    raw[::2, ::2] = 200
    cv2.imwrite(str(tmp_path / "b.png"), raw)
    blue = read_bayer_as_grey(tmp_path / "b.png")[2:-2, 2:-2]
    for grey, weight in ((red, 0.299), (blue, 0.114)):
        assert np.ptp(grey) <= 1
        assert abs(float(grey.mean()) - 200 * weight) < 1.5


@pytest.mark.parametrize("name", ["kaist_sample", "street_traffic"])
def test_real_bayer_images_keep_no_checkerboard(data_root: Path, name: str) -> None:
    if not (data_root / name).is_dir():
        pytest.skip(f"{data_root / name} is missing")
    path = open_sequence(data_root / name).left_paths[0]
    raw, grey = read_grey(path), read_bayer_as_grey(path)
    assert checkerboard(grey) < 0.15 * checkerboard(raw)


def checkerboard(image: Image) -> float:
    """RMS over 16-pixel cells of the alternating part, which a scene has next to none of."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    alternating = cv2.blur(image * (-1.0) ** (x + y), (16, 16))
    return float(np.sqrt(np.mean(alternating**2)))
