"""What the commands that read a recording share."""

from pathlib import Path

from ovmot.cli.recorded import repeated_options


def test_options_are_repeated_as_a_shell_takes_them() -> None:
    given = repeated_options(format=None, calibration=Path("my chain.yaml"), left="/front/left")
    assert given == "--calibration 'my chain.yaml' --left /front/left"
    assert repeated_options(imu=None) == ""
