"""Bags that are written: replaced when asked, refused when odd."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError, OvmotError
from ovmot.ros import messages
from ovmot.ros.bag_output import BagOutput
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.values import Published
from ovmot.types import FrameResult


def topics_in(path: Path) -> Counter[str]:
    with AnyReader([path]) as reader:
        return Counter(connection.topic for connection, _, _ in reader.messages())


def write(path: Path, rig: StereoRig, result: FrameResult, **options: Any) -> None:
    output = BagOutput(path, rig, **options)
    for i in range(3):
        stamp = result.timestamp_ns + i * 10**8
        frame = replace(result.frame, timestamp_ns=stamp)
        ego = replace(result.ego, timestamp_ns=stamp)
        output.write(replace(result, frame=frame, ego=ego))
    output.close()


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "out"])
def test_a_bag_is_replaced_only_when_asked(
    tmp_path: Path, painted_rig: StereoRig, result: FrameResult, name: str
) -> None:
    path = tmp_path / name
    write(path, painted_rig, result)
    with pytest.raises(InputError, match="already there; replace it with --force"):
        BagWriter(path)
    write(path, painted_rig, result, replace=True)
    assert topics_in(path)[messages.ODOMETRY] == 3


def test_a_folder_that_is_no_bag_stays(tmp_path: Path) -> None:
    precious = tmp_path / "out" / "precious"
    precious.mkdir(parents=True)
    with pytest.raises(InputError, match="no bag"):
        BagWriter(tmp_path / "out", replace=True)
    assert precious.is_dir()


def test_an_unknown_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"end it in \.bag"):
        BagWriter(tmp_path / "out.db4")


def test_a_closed_bag_takes_no_more(tmp_path: Path, result: FrameResult) -> None:
    odometry = Published(messages.ODOMETRY, messages.odometry(result.ego, messages.FrameNames()))
    bag = BagWriter(tmp_path / "out.bag")
    bag.write(odometry, result.timestamp_ns)
    bag.close()
    bag.close()
    with pytest.raises(OvmotError, match=r"out\.bag: cannot write any further"):
        bag.write(odometry, result.timestamp_ns)
    assert np.sum(list(topics_in(tmp_path / "out.bag").values())) == 1
