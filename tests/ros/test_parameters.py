"""Private parameters are settings."""

from pathlib import Path

import pytest

from ovmot.errors import InputError
from ovmot.ros.parameters import read_parameters
from ovmot.settings_file import load_settings


def test_parameters_set_settings_and_files() -> None:
    private = {
        "calibration": "/c.yaml",
        "config": "",
        "live": {"left": "/camera/left", "queue_frames": 7, "right": "", "publish_tf": False},
        "tracker": {"two_view_threshold_px": 1.25},
    }
    found = read_parameters(private)
    assert found.calibration == Path("/c.yaml") and found.config is None
    settings = load_settings(None, found.overrides)
    assert settings.live.left == "/camera/left"
    assert settings.live.right == "/cam1/image_raw"
    assert settings.live.queue_frames == 7 and not settings.live.publish_tf
    assert settings.tracker.two_view_threshold_px == 1.25


def test_an_unknown_parameter_is_named() -> None:
    with pytest.raises(InputError, match="~calibratoin: unknown"):
        read_parameters({"calibratoin": "/c.yaml"})
