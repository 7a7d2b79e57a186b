"""The settings by themselves: frozen, and each with its help."""

import pytest
from pydantic import ValidationError

from ovmot.settings import Settings, describe_settings


def test_settings_cannot_be_changed_once_made() -> None:
    settings = Settings()
    with pytest.raises(ValidationError):
        setattr(settings.tracker, "max_features", 10)  # noqa: B010  # mypy knows it is frozen


def test_every_setting_has_a_help_text() -> None:
    rows = list(describe_settings())
    assert ("epipolar.scale", "angle") in [(key, default) for key, _, default, _ in rows]
    assert [key for key, _, _, text in rows if not text.strip()] == []
    assert len({key for key, *_ in rows}) == len(rows)
