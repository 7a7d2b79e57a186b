"""The launch file, the RViz configuration and the Makefile name what the node has."""

import re
from pathlib import Path
from xml.etree import ElementTree

import yaml

from ovmot.ros.parameters import read_parameters
from ovmot.ros.ros1_node import REMEDY
from ovmot.ros.session import LIVE_TOPICS
from ovmot.settings_file import load_settings

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / "ros"


def test_the_launch_file_gives_parameters_that_the_node_knows() -> None:
    launch = ElementTree.parse(FOLDER / "launch" / "ovmot.launch").getroot()
    node = launch.find("node[@pkg='ovmot']")
    assert node is not None and (FOLDER / "scripts" / str(node.get("type"))).exists()
    private: dict[str, object] = {}
    for parameter in node.findall("param"):
        section, _, key = str(parameter.get("name")).partition("/")
        if key:
            private[section] = {**dict(private.get(section, {})), key: "/topic"}  # type: ignore[call-overload]
        else:
            private[section] = ""
    found = read_parameters(private)
    assert load_settings(None, found.overrides).live.imu == "/topic"


def test_rviz_shows_topics_that_are_published() -> None:
    shown = yaml.safe_load((FOLDER / "rviz" / "ovmot.rviz").read_text())
    topics = {
        value
        for display in shown["Visualization Manager"]["Displays"]
        for key, value in display.items()
        if key.endswith("Topic")
    }
    assert len(topics) == 6 and topics <= set(LIVE_TOPICS)


def test_docs_makefile_and_node_name_the_same_packages() -> None:
    def packages(text: str, start: str, end: str) -> set[str]:
        return set(re.findall(r"python3-[a-z0-9-]+", text.partition(start)[2].partition(end)[0]))

    makefile, docs = ((REPOSITORY / name).read_text() for name in ("Makefile", "docs/ros.md"))
    wanted = packages(makefile, "ROS_PACKAGES :=", "\n\n")
    assert len(wanted) == 9
    assert packages(docs, "sudo apt-get install", "make install-ros") == wanted
    assert set(re.findall(r"python3-[a-z0-9-]+", REMEDY)) < wanted
