"""The settings files that are shipped: they load, and say only what differs."""

from pathlib import Path

import pytest

from ovmot.settings import Settings
from ovmot.settings_file import load_settings, read_yaml_mapping

CONFIG = Path(__file__).parents[1] / "config"
PRESETS = sorted(CONFIG.glob("*.yaml"))


def test_there_is_one_for_each_data_set() -> None:
    assert {"euroc", "kaist", "kitti", "tum_vi", "viode"} <= {path.stem for path in PRESETS}


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_only_what_differs(path: Path) -> None:
    settings, default = load_settings(path), Settings()
    for section, keys in read_yaml_mapping(path).items():
        for key in keys:
            value = getattr(getattr(settings, section), key)
            assert value != getattr(getattr(default, section), key), f"{section}.{key}"
