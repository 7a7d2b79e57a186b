"""The launch file, the RViz configuration and the Makefile name what the node has."""

from pathlib import Path
from xml.etree import ElementTree

import yaml

from ovmot.ros.parameters import read_parameters
from ovmot.ros.session import LIVE_TOPICS
from ovmot.settings_file import load_settings

FOLDER = Path(__file__).parents[2] / "ros"


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
    told = read_parameters(private)
    assert load_settings(None, told.overrides).live.imu == "/topic"


def test_rviz_shows_topics_that_are_published() -> None:
    shown = yaml.safe_load((FOLDER / "rviz" / "ovmot.rviz").read_text())
    topics = {
        value
        for display in shown["Visualization Manager"]["Displays"]
        for key, value in display.items()
        if key.endswith("Topic")
    }
    assert len(topics) == 6 and topics <= set(LIVE_TOPICS)
