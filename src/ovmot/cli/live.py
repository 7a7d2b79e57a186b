"""`ovmot ros` and `ovmot ros2`: the live nodes."""

from pathlib import Path
from typing import Annotated

import typer

from ovmot.cli.console import interruptible
from ovmot.cli.options import SetOption
from ovmot.errors import InputError

_Calibration = Annotated[Path | None, typer.Option(help="Kalibr chain, or a data set's folder.")]
_Config = Annotated[
    Path | None, typer.Option(help="YAML settings; topics are in the section `live`.")
]


def ros(
    remappings: Annotated[
        list[str] | None,
        typer.Argument(metavar="[A:=B]...", help="ROS's own arguments: a:=b, __name:=c."),
    ] = None,
    calibration: _Calibration = None,
    config: _Config = None,
    set_: SetOption = None,
) -> None:
    """Run live on ROS 1: two image topics and an IMU in, odometry and objects out."""
    strange = [text for text in remappings or () if ":=" not in text]
    if strange:
        raise InputError(f"{strange[0]}: neither an option nor a remapping a:=b")
    from ovmot.ros import ros1_node

    _prepare()
    with interruptible("the node has ended"):
        ros1_node.run_node(config, calibration, tuple(set_ or ()))


def ros2(
    arguments: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ARGUMENT]...", help="ROS's own arguments: -- --ros-args ..."),
    ] = None,
    calibration: _Calibration = None,
    config: _Config = None,
    set_: SetOption = None,
) -> None:
    """Run live on ROS 2: two image topics and an IMU in, odometry and objects out."""
    from ovmot.ros import ros2_node

    _prepare()
    with interruptible("the node has ended"):
        ros2_node.run_node(config, calibration, tuple(set_ or ()), tuple(arguments or ()))


def _prepare() -> None:
    import ovmot
    from ovmot.cli.compiling import compiling
    from ovmot.cli.progress import Style

    with compiling(Style.BAR) as wait_for_kernels:
        ovmot.prepare_process()
        wait_for_kernels()
