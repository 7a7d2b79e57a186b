"""Images in bags: encodings, compressed ones, Bayer patterns."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from bag_fixtures import (
    COLOURS,
    HEIGHT,
    WIDTH,
    ImageMaker,
    compressed,
    encoded,
    frames,
    mono,
    write_bag,
)

from ovmot.datasets.registry import open_recording
from ovmot.errors import DatasetError
from ovmot.ros.values import Message

GREY = cv2.cvtColor(COLOURS, cv2.COLOR_BGR2GRAY)


DEEP = COLOURS[:, :, 0].astype(np.uint16) * 256 + 99


@pytest.mark.parametrize(
    ("make_image", "expected"),
    [
        (encoded("mono8", COLOURS[:, :, 0], padding=5), COLOURS[:, :, 0]),
        (encoded("mono16", DEEP), COLOURS[:, :, 0]),
        (encoded("mono16", DEEP, padding=4), COLOURS[:, :, 0]),
        (encoded("bgr8", COLOURS, padding=1), GREY),
        (encoded("rgb8", COLOURS[:, :, ::-1]), GREY),
        (encoded("bgra8", cv2.cvtColor(COLOURS, cv2.COLOR_BGR2BGRA)), GREY),
        (compressed("bgr8; png compressed bgr8"), GREY),
        (compressed("png", pixels=COLOURS[:, :, 0]), COLOURS[:, :, 0]),
    ],
)
@pytest.mark.parametrize("ending", [".bag", ".mcap"])
def test_encodings_become_grey(
    tmp_path: Path, chain: Path, make_image: ImageMaker, expected: np.ndarray, ending: str
) -> None:
    path = write_bag(tmp_path / f"tiny{ending}", {"/left": make_image, "/right": make_image})
    seen = frames(path, chain)
    assert len(seen) == 6
    for seen_image in (seen[0].left, seen[5].pair[1]):  # libpng rounds colours down
        assert np.abs(seen_image.astype(int) - expected).max() <= (expected is GREY)


def test_jpeg_is_close_and_broken_jpeg_is_an_error(tmp_path: Path, chain: Path) -> None:
    smooth = cv2.GaussianBlur(COLOURS, (9, 9), 3.0)
    jpeg = compressed("jpeg", ".jpg", smooth)
    path = write_bag(tmp_path / "tiny.bag", {"/left": jpeg, "/right": jpeg})
    difference = frames(path, chain)[0].left.astype(int) - cv2.cvtColor(smooth, cv2.COLOR_BGR2GRAY)
    assert np.abs(difference).max() < 12

    def half(stamp: int) -> Message:
        whole = jpeg(stamp)
        data = np.asarray(whole.fields["data"])
        return Message(whole.type_name, {**whole.fields, "data": data[: len(data) // 2]})

    path = write_bag(tmp_path / "half.bag", {"/left": jpeg, "/right": half})
    with pytest.raises(DatasetError, match=r"half\.bag, topic /right, image \d+ ns: .*truncated"):
        frames(path, chain)


@pytest.mark.parametrize(
    ("encoding", "first_rows"),
    [
        ("bayer_rggb8", "rg/gb"),
        ("bayer_bggr8", "bg/gr"),
        ("bayer_gbrg8", "gb/rg"),
        ("bayer_grbg8", "gr/bg"),
    ],
)
def test_a_bayer_pattern_is_read_by_its_first_rows(
    tmp_path: Path, chain: Path, encoding: str, first_rows: str
) -> None:
    """A red wall: red pixels full, the others 0, is 0.299 * 255 in grey everywhere."""
    tile = np.array([[255 * (c == "r") for c in row] for row in first_rows.split("/")])
    mosaic = np.tile(tile, (HEIGHT // 2, WIDTH // 2)).astype(np.uint8)
    png = compressed(f"{encoding}; png compressed ", pixels=mosaic)
    path = write_bag(tmp_path / "tiny.bag", {"/left": encoded(encoding, mosaic), "/right": png})
    frame = frames(path, chain)[0]
    for side in frame.pair:
        assert np.abs(side[4:-4, 4:-4].astype(float) - 0.299 * 255).max() < 2


def test_an_unknown_encoding_is_one_line_before_the_run(tmp_path: Path, chain: Path) -> None:
    odd = encoded("yuv422", np.zeros((HEIGHT, WIDTH), dtype=np.uint16))
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": odd})
    with pytest.raises(
        DatasetError, match=r"topic /right.*unknown encoding 'yuv422'; known: mono8"
    ):
        open_recording(path, calibration=chain)
