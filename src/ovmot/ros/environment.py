"""How a virtual environment and a shell find ROS 1 and what ovmot has for it.

    python -m ovmot.ros.environment --link            # once: this environment sees Debian's ROS 1
    eval "$(python -m ovmot.ros.environment)"         # in a shell: ROS 1's tools see ovmot's files

The second is what a workspace's `setup.bash` would do, for a package that pip has installed.
"""

import argparse
import os
import shlex
import sys
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path

SHARE = Path(__file__).parent / "share"
"""ROS packages: `ovmot_msgs`, and `ovmot` with the launch file and the views."""
PYTHON = Path(__file__).parent / "python"
"""The Python package `ovmot_msgs` of ROS 1, for programs that do not run in our environment."""
DEBIAN_PACKAGES = Path("/usr/lib/python3/dist-packages")

_ROS_NAMES = ("catkin*", "gen*", "ros*", "tf*", "*_msgs", "*_srvs", "message_filters", "actionlib")
"""What of Debian's Python packages is ROS 1's. All others are to be those of the environment: some
of Debian's, as an old `coverage`, keep numba from being imported."""
_LINKS, _PATH_FILE = "ovmot-ros1", "zz-debian-ros.pth"


def exports(environment: Mapping[str, str]) -> list[str]:
    """Lines of a POSIX shell: our folders before those in `environment`, once, and the node."""
    command = Path(sys.prefix) / "bin" / "ovmot"
    values = {
        "ROS_PACKAGE_PATH": _before(SHARE, environment.get("ROS_PACKAGE_PATH", "")),
        "PYTHONPATH": _before(PYTHON, environment.get("PYTHONPATH", "")),
        "OVMOT": str(command) if command.exists() else "ovmot",
    }
    return [f"export {name}={shlex.quote(value)}" for name, value in values.items()]


def link_ros(packages: Path, site_packages: Path) -> int:
    """Let `site_packages` see the ROS 1 of `packages`, and `ovmot_msgs`; returns how many packages.

    They come last in the search path. A second call brings the links up to date.
    """
    folder = site_packages / _LINKS
    folder.mkdir(exist_ok=True)
    for link in folder.iterdir():
        link.unlink()
    found = {path for pattern in _ROS_NAMES for path in packages.glob(pattern) if path.is_dir()}
    for path in found:
        (folder / path.name).symlink_to(path)
    (site_packages / _PATH_FILE).write_text(f"{folder}\n{PYTHON}\n")
    return len(found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what a shell needs, or with `--link` let this environment see ROS 1."""
    parser = argparse.ArgumentParser(prog="python -m ovmot.ros.environment")
    parser.add_argument(
        "--link", nargs="?", type=Path, const=DEBIAN_PACKAGES, metavar="FOLDER",
        help="let this environment see the ROS 1 in a folder of Python packages (Debian's)",
    )  # fmt: skip
    packages = parser.parse_args(arguments).link
    if packages is None:
        print("\n".join(exports(os.environ)))
        return 0
    if sys.prefix == sys.base_prefix:
        print("ovmot: --link is for a virtual environment: make one first", file=sys.stderr)
        return 2
    if not link_ros(packages, Path(sysconfig.get_path("purelib"))):
        print(f"ovmot: {packages}: no ROS 1 there: see docs/ros.md", file=sys.stderr)
        return 2
    return 0


def _before(folder: Path, paths: str) -> str:
    others = [path for path in paths.split(os.pathsep) if path and path != str(folder)]
    return os.pathsep.join([str(folder), *others])


if __name__ == "__main__":
    sys.exit(main())
