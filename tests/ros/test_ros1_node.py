"""The node live: a real ROS master, a bag played into it, its results recorded and measured.

`make test-ros` runs this; elsewhere it skips, since it needs ROS 1 and a machine with little to do.
OVMOT_ROS_RATE slows the bag down for a busy machine.
"""

import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.registry import open_sequence
from ovmot.ros.bag_output import IMU, LEFT, RIGHT, write_sequence_bag
from ovmot.ros.environment import PYTHON, exports
from ovmot.ros.messages import OBJECTS, ODOMETRY
from ovmot.ros.typestore import typestore
from ovmot.run import RunOptions, run_sequence
from ovmot.run_evaluation import evaluate
from ovmot.settings import Settings
from ovmot.sim.recording import record
from ovmot.sim.scene_file import load_scene
from ovmot.sim.scenes import make_simulation
from ovmot.types import ImuData

RATE = float(os.environ.get("OVMOT_ROS_RATE", "1.0"))
HOLE_S = (9.0, 11.0)
PART_S = 6.0
ATE, RECALL = "ate_yaw_m", "object_recall"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("OVMOT_TEST_ROS" not in os.environ, reason="run 'make test-ros'"),
]


class Ros:
    """A master of its own, and processes that know it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.environment = {
            **os.environ,
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder / "ros_home"),
        }
        self._started: list[subprocess.Popen[bytes]] = []
        self._core = ("roscore", "-p", str(port))
        self.master = self.start_master()

    def start_master(self) -> subprocess.Popen[bytes]:
        """A master at the port; it knows nobody."""
        master = self.start(*self._core)
        self.wait_for("master", lambda: self.call("rostopic", "list") is not None)
        return master

    def start_node(self, sequence: Path, *options: str) -> subprocess.Popen[bytes]:
        """The live node, when it listens; it must be the first after the master."""
        command = ("-m", "ovmot", "ros", "--calibration", str(sequence), *options)
        node = self.start(sys.executable, *command)
        self.wait_for("the node", lambda: "/ovmot" in (self.call("rostopic", "info", IMU) or ""))
        return node

    def play(self, bag: Path, *options: str) -> None:
        """Play a bag to its end."""
        subprocess.run(
            ["rosbag", "play", "-q", "--delay=1", "-r", str(RATE), *options, str(bag)],
            env=self.environment, check=True, timeout=300, stdout=subprocess.DEVNULL,
        )  # fmt: skip

    def end_node(self, node: subprocess.Popen[bytes]) -> str:
        """Ctrl-C, and what the node has said."""
        assert self.stop(node) == 130
        return (self.folder / "python_1.log").read_text()

    def start(self, *command: str) -> subprocess.Popen[bytes]:
        log = self.folder / f"{Path(command[0]).name}_{len(self._started)}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(
                command, env=self.environment, stdout=out, stderr=out, start_new_session=True
            )
        self._started.append(process)
        return process

    def call(self, *command: str) -> str | None:
        done = subprocess.run(
            command, env=self.environment, capture_output=True, text=True, check=False, timeout=120
        )
        return done.stdout if done.returncode == 0 else None

    def wait_for(self, what: str, test: Any, timeout_s: float = 60.0) -> None:
        end = time.monotonic() + timeout_s
        while not test():
            assert time.monotonic() < end, f"waited for {what}"
            time.sleep(0.5)

    def stop(self, process: subprocess.Popen[bytes]) -> int:
        """Ctrl-C, and what the process makes of it."""
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        return process.wait(timeout=30)

    def close(self) -> None:
        for process in reversed(self._started):
            try:
                self.stop(process)
            except subprocess.TimeoutExpired:
                process.kill()


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[Ros]:
    for command in ("roscore", "rosbag", "rostopic"):
        assert shutil.which(command), f"no {command}: install Debian's ROS packages (docs/ros.md)"
    master = Ros(tmp_path)
    yield master
    master.close()


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """20 s of traffic at 10 Hz in pictures of 640x280, as a KAIST folder."""
    folder = tmp_path_factory.mktemp("street") / "traffic"
    simulation = make_simulation(load_scene("traffic"), seed=0, size=(640, 280), duration_s=20.0)
    for _ in write_kaist(folder, record(simulation, 0)):
        pass
    return folder


def offline(sequence: Any, out: Path) -> None:
    """The same input from a file; it also compiles what the node then finds compiled."""
    run_sequence(sequence, Settings(), RunOptions(out))


def played(ros: Ros, sequence: Path, bags: Mapping[Path, tuple[str, ...]]) -> tuple[Path, str]:
    """Bag of the results, and the node's words, after bags were played with options."""
    node = ros.start_node(sequence)
    results = ros.folder / "results.bag"
    recorder = ros.start("/usr/lib/rosbag/record", "-O", str(results), ODOMETRY, OBJECTS)
    ros.wait_for("the recorder", lambda: "record" in (ros.call("rostopic", "info", OBJECTS) or ""))
    for bag, options in bags.items():
        ros.play(bag, *options)
    time.sleep(3.0)
    ros.stop(recorder)
    return results, ros.end_node(node)


def as_run(results: Path, out: Path) -> list[int]:
    """trajectory.tum and tracks.csv of the results after the last jump back; all stamps."""
    from rosbags.rosbag1 import Reader

    store = typestore(1)
    odometry: list[Any] = []
    objects: list[Any] = []
    stamps: list[int] = []
    with Reader(results) as bag:
        for connection, _, raw in bag.messages():
            message: Any = store.deserialize_ros1(raw, connection.msgtype)
            at = message.header.stamp
            stamp = at.sec * 1_000_000_000 + at.nanosec
            if connection.topic == ODOMETRY:
                if stamps and stamp < stamps[-1]:
                    odometry.clear()
                    objects.clear()
                stamps.append(stamp)
                odometry.append((stamp, message.pose.pose))
            elif stamps and abs(stamp - stamps[-1]) < 1_000_000_000:  # not of before the jump
                objects += [(stamp, one) for one in message.objects]
    out.mkdir()
    write_run(out, odometry, objects)
    return stamps


def write_run(out: Path, odometry: list[Any], objects: list[Any]) -> None:
    states = ("tentative", "confirmed", "coasting")
    with (out / "trajectory.tum").open("w") as file:
        for stamp, pose in odometry:
            p, q = pose.position, pose.orientation
            time_s = f"{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d}"
            file.write(f"{time_s} {p.x} {p.y} {p.z} {q.x} {q.y} {q.z} {q.w}\n")
    with (out / "tracks.csv").open("w") as file:
        file.write(
            "timestamp_ns,track_id,state,x,y,z,vx,vy,vz,yaw,yaw_rate,length,width,height,"
            "u_min,v_min,u_max,v_max,n_points,std_x,std_y,std_z,std_vx,std_vy,std_vz\n"
        )
        first_ns = odometry[0][0]
        for stamp, o in objects:
            if stamp < first_ns:
                continue
            vectors = (o.pose.position, o.velocity)
            row = [stamp, o.id, states[o.state], *(c for v in vectors for c in (v.x, v.y, v.z))]
            row += [o.yaw, o.yaw_rate, o.size.x, o.size.y, o.size.z, *o.box_px, o.n_points]
            row += [c for v in (o.std_position, o.std_velocity) for c in (v.x, v.y, v.z)]
            cells = ("" if isinstance(c, float) and np.isnan(c) else str(c) for c in row)
            file.write(",".join(cells) + "\n")


def check(live: Path, reference: Path, truth: Path, words: str, what: str) -> None:
    """ATE within 20 %, recall within 0.05."""
    got, wanted = (evaluate(run, truth).scalars() for run in (live, reference))
    print(f"\n{what}: rate {RATE}, load {os.getloadavg()[0]:.1f}")
    print({key: (got[key], wanted[key]) for key in (ATE, RECALL)})
    print(words)
    ate, recall = got[ATE], got[RECALL]
    reference_ate, reference_recall = wanted[ATE], wanted[RECALL]
    assert ate is not None and reference_ate is not None and ate <= 1.2 * reference_ate
    assert recall is not None and reference_recall is not None
    assert recall >= reference_recall - 0.05


def test_live_is_as_good_as_from_the_folder(ros: Ros, street: Path, tmp_path: Path) -> None:
    sequence = open_sequence(street)
    offline(sequence, tmp_path / "offline")
    write_sequence_bag(tmp_path / "street.bag", sequence)
    results, words = played(ros, street, {tmp_path / "street.bag": ()})
    as_run(results, tmp_path / "live")
    check(tmp_path / "live", tmp_path / "offline", street, words, "whole")
    assert f"{len(sequence)} frames" in words and " 0 dropped" in words


@pytest.mark.parametrize("faster", [1, 2])
def test_a_real_rig_is_followed_at_its_rate_and_at_twice_it(
    ros: Ros, data_root: Path, tmp_path: Path, faster: int
) -> None:
    """EuRoC's pictures of 752x480, at 10 and at 20 Hz: none is dropped."""
    folder = data_root / "euroc_mh01"
    sequence = open_sequence(folder)
    offline(sequence, tmp_path / "offline")
    bag = tmp_path / "euroc.bag"
    write_sequence_bag(bag, sequence)
    node = ros.start_node(folder)
    ros.play(bag, "-r", str(RATE * faster))
    time.sleep(3.0)
    words = ros.end_node(node)
    print(f"\n{10 * faster} Hz: rate {RATE}, load {os.getloadavg()[0]:.1f}")
    print(words)
    assert f"{len(sequence)} frames" in words and " 0 dropped" in words


def test_a_bag_played_again_is_a_new_segment(ros: Ros, street: Path, tmp_path: Path) -> None:
    sequence = open_sequence(street)
    offline(sequence, tmp_path / "offline")
    bag, again = tmp_path / "street.bag", tmp_path / "again.bag"
    write_sequence_bag(bag, sequence)
    again.hardlink_to(bag)
    results, words = played(ros, street, {bag: ("-u", str(PART_S)), again: ()})
    stamps = as_run(results, tmp_path / "live")
    assert sum(b < a for a, b in pairwise(stamps)) == 1
    check(tmp_path / "live", tmp_path / "offline", street, words, "played again")
    assert "went back by" in words and "1 restarts" in words


def test_without_the_imu_for_two_seconds(ros: Ros, street: Path, tmp_path: Path) -> None:
    sequence = open_sequence(street)
    imu = sequence.imu
    assert imu is not None
    at_s = 1e-9 * (imu.timestamp_ns - sequence.frame_ns[0])
    kept = (at_s < HOLE_S[0]) | (at_s > HOLE_S[1])
    cut = ImuData(imu.timestamp_ns[kept], imu.gyro[kept], imu.accel[kept])
    sequence = replace(sequence, imu=cut)
    offline(sequence, tmp_path / "offline")
    write_sequence_bag(tmp_path / "cut.bag", sequence)
    results, words = played(ros, street, {tmp_path / "cut.bag": ()})
    as_run(results, tmp_path / "live")
    check(tmp_path / "live", tmp_path / "offline", street, words, "IMU cut")
    assert "/imu0: nothing for" in words and "/imu0: messages again" in words


def test_tools_of_ros_know_the_messages_and_the_cameras_without_a_workspace(
    ros: Ros, data_root: Path, tmp_path: Path
) -> None:
    """As after `eval "$(python -m ovmot.ros.environment)"`; the tools run by Debian's Python."""
    folder = data_root / "euroc_mh01"
    bag = tmp_path / "euroc.bag"
    write_sequence_bag(bag, open_sequence(folder))
    node = ros.start_node(folder)
    lines = (line.removeprefix("export ").partition("=") for line in exports(os.environ))
    ros.environment |= {name: shlex.split(value)[0] for name, _, value in lines}
    ros.environment["PYTHONPATH"] = str(PYTHON)
    echo = ros.start("rostopic", "echo", "-n", "1", OBJECTS)
    ros.play(bag, "-u", str(PART_S))
    assert echo.wait(timeout=30) == 0
    heard = "".join(log.read_text() for log in tmp_path.glob("rostopic_*.log"))
    assert 'frame_id: "world"' in heard and "objects:" in heard
    cameras = ros.call("rostopic", "echo", "-n", "1", "/tf_static") or ""  # sent long ago
    assert 'child_frame_id: "cam0"' in cameras and 'child_frame_id: "cam1"' in cameras
    assert "success: True" in (ros.call("rosservice", "call", "/ovmot/reset") or "")
    assert "[INFO]" in ros.end_node(node)


def test_a_new_master_is_used_and_a_wrong_name_is_said_with_the_right_ones(
    ros: Ros, street: Path, tmp_path: Path
) -> None:
    bag = tmp_path / "street.bag"
    write_sequence_bag(bag, open_sequence(street))
    node = ros.start_node(street, "--set", "live.right=/nowhere")
    ros.stop(ros.master)
    ros.start_master()
    ros.play(bag, "-u", str(PART_S))
    words = ros.end_node(node)
    assert "the ROS master is gone" in words and "there is a ROS master again" in words
    assert f"{LEFT}: messages come" in words and f"{IMU}: messages come" in words
    assert "/nowhere: nothing for" in words
    assert f"topics of sensor_msgs/Image: {LEFT}, {RIGHT}" in words
