"""ROS bags as sequences: topics, encodings, calibration, and each mistake as one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_fixtures import (
    COLOURS,
    START_NS,
    ImageMaker,
    frames,
    imu,
    mono,
    write_bag,
)

from ovmot.datasets.bag.topics import BagTopics
from ovmot.datasets.registry import open_recording
from ovmot.errors import DatasetError, InputError
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.values import Message, Published, image


def test_messages_out_of_order_and_frames_without_a_partner(tmp_path: Path, chain: Path) -> None:
    path = tmp_path / "tiny.bag"
    with BagWriter(path) as bag:
        # one sample is late, one image has no partner
        for turn, tick in enumerate((-1, 0, 1, 3, 2, 4, 5, 6)):
            stamp, now = START_NS + tick * 10_000_000, START_NS + turn * 10_000_000
            bag.write(Published("/imu", imu(stamp)), now + 1000)
            bag.write(Published("/left", mono(stamp)), now + 2000)
            if tick != 4:
                bag.write(Published("/right", mono(stamp)), now + 3000)
    sequence = open_recording(path, calibration=chain)
    assert sequence.imu is not None and np.all(np.diff(sequence.imu.timestamp_ns) > 0)
    assert sequence.counts["imu_out_of_order"] == 1
    assert sequence.counts["unpaired_images"] == 1
    ticks = [round((f.timestamp_ns - START_NS) / 1e7) for f in frames(path, chain)]
    assert ticks == [-1, 0, 1, 2, 3, 4, 5]
    assert sequence.missing == {5: 1}
    gone = frames(path, chain)[5]
    assert gone.missing == (1,)
    assert np.array_equal(gone.left, frames(path, chain)[4].left) and not gone.pair[1].any()
    assert sequence.of_pairs().frame_ns.tolist() == [
        START_NS + tick * 10_000_000 for tick in (-1, 0, 1, 2, 3, 5)
    ]


def test_headers_without_stamps(tmp_path: Path, chain: Path) -> None:
    unstamped = image(0, "cam", COLOURS[:, :, 0])
    cameras: dict[str, ImageMaker] = {"/left": lambda _: unstamped, "/right": lambda _: unstamped}
    with pytest.raises(DatasetError, match=r"topic /left: the headers hold no stamps"):
        open_recording(write_bag(tmp_path / "tiny.bag", cameras), calibration=chain)


def test_without_an_imu_the_bag_says_so(tmp_path: Path, chain: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": mono}, imus=())
    sequence = open_recording(path, calibration=chain)
    assert sequence.imu is None
    assert "no topic of type sensor_msgs/Imu, only /" in sequence.warnings[0]
    assert "(sensor_msgs/Image)" in sequence.warnings[0]


def test_options_that_do_not_fit_the_data(tmp_path: Path, chain: Path) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": mono})
    with pytest.raises(InputError, match="is a bag; leave out '--format kaist'"):
        open_recording(path, format="kaist", calibration=chain)
    with pytest.raises(InputError, match="is no bag; leave out '--imu /imu'"):
        open_recording(tmp_path, topics=BagTopics(imu="/imu"))


def test_a_mistake_in_a_bag_ends_the_command_with_2(
    tmp_path: Path, ovmot_command: Callable[..., Any]
) -> None:
    path = write_bag(tmp_path / "tiny.bag", {"/a": mono, "/b": mono, "/c": mono})
    found = ovmot_command("run", path, "-o", tmp_path / "out")
    assert found.code == 2
    assert found.complaint.endswith("choose with --left TOPIC --right TOPIC")


@pytest.mark.parametrize(
    ("apart_ns", "kept"), [(4_000_000, True), (-3_000_000, True), (6_000_000, False)]
)
def test_left_and_right_may_be_stamped_a_little_apart(
    tmp_path: Path, chain: Path, apart_ns: int, kept: bool
) -> None:
    def right(stamp: int) -> Message:
        return image(stamp + apart_ns, "cam", COLOURS[:, :, 1])

    path = write_bag(tmp_path / "tiny.bag", {"/left": mono, "/right": right})
    if not kept:
        with pytest.raises(DatasetError, match="6 left and 6 right images, only 0 pairs"):
            open_recording(path, calibration=chain)
        return
    seen = frames(path, chain)
    assert [f.timestamp_ns for f in seen] == [START_NS + i * 10**8 for i in range(6)]
    assert all(np.array_equal(f.pair[1], COLOURS[:, :, 1]) for f in seen)
