"""The launch file, the RViz configuration and the Makefile name what the node has."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import yaml

import ovmot
from ovmot.ros.environment import PYTHON, SHARE, exports, link_ros
from ovmot.ros.parameters import read_parameters
from ovmot.ros.ros1_node import REMEDY
from ovmot.ros.session import LIVE_TOPICS
from ovmot.ros.typestore import own_definitions
from ovmot.settings_file import load_settings

REPOSITORY = Path(__file__).parents[2]
FOLDER = SHARE / "ovmot"


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
    live = {topic.removesuffix("/compressed") for topic in LIVE_TOPICS}  # that is a transport
    assert len(topics) == 6 and topics <= live


def test_foxglove_shows_topics_that_are_published() -> None:
    layout = json.loads((FOLDER / "foxglove" / "ovmot.json").read_text())
    panels = layout["configById"]
    shown = set(panels["3D!ovmot"]["topics"])
    shown.add(panels["Image!overlay"]["imageMode"]["imageTopic"])
    shown.add(panels["RawMessages!objects"]["topicPath"])
    shown |= {path["value"].split(".")[0] for path in panels["Plot!speed"]["paths"]}
    assert len(shown) == 7 and shown <= set(LIVE_TOPICS)
    assert panels.keys() == set(re.findall(r'"(\w+!\w+)"', json.dumps(layout["layout"])))


def test_the_packages_name_their_messages_and_the_version() -> None:
    for name in ("ovmot", "ovmot_msgs"):
        package = ElementTree.parse(SHARE / name / "package.xml").getroot()
        assert package.findtext("name") == name
        assert package.findtext("version") == ovmot.__version__
    builds = (SHARE / "ovmot_msgs" / "CMakeLists.txt").read_text()
    for definition in own_definitions():
        file = f"{definition.partition('/')[2]}.msg"
        assert builds.count(f" {file}") + builds.count(f"msg/{file}") == 2  # ROS 1 and ROS 2


def test_a_shell_is_told_the_folders_once_and_before_its_own() -> None:
    given = {"ROS_PACKAGE_PATH": f"/ws/src:{SHARE}", "PYTHONPATH": "/ws/lib"}
    lines = exports(given)
    assert f"export ROS_PACKAGE_PATH={SHARE}:/ws/src" in lines
    assert f"export PYTHONPATH={PYTHON}:/ws/lib" in lines
    assert lines[2].startswith("export OVMOT=")


def test_an_environment_sees_of_debian_what_is_ros_alone(tmp_path: Path) -> None:
    packages, site = tmp_path / "debian", tmp_path / "site"
    for name in ("rospy", "std_msgs", "std_srvs", "coverage", "numpy"):
        (packages / name).mkdir(parents=True)
    site.mkdir()
    assert link_ros(packages, site) == 3
    (packages / "std_srvs").rmdir()
    assert link_ros(packages, site) == 2  # and no dead link
    links, own = (site / "zz-debian-ros.pth").read_text().split()
    assert sorted(path.name for path in Path(links).iterdir()) == ["rospy", "std_msgs"]
    assert (Path(own) / "ovmot_msgs" / "msg" / "__init__.py").is_file()


def test_docs_makefile_and_node_name_the_same_packages() -> None:
    def packages(text: str, start: str, end: str) -> set[str]:
        return set(re.findall(r"python3-[a-z0-9-]+", text.partition(start)[2].partition(end)[0]))

    makefile, docs = ((REPOSITORY / name).read_text() for name in ("Makefile", "docs/ros.md"))
    wanted = packages(makefile, "ROS_PACKAGES :=", "\n\n")
    assert len(wanted) == 10
    assert packages(docs, "sudo apt-get install", "make install-ros") == wanted
    assert set(re.findall(r"python3-[a-z0-9-]+", REMEDY)) < wanted
