"""Settings from files and overrides, and one clear line for every mistake."""

import re
from pathlib import Path

import pytest

from ovmot.errors import InputError, SettingsWarning
from ovmot.settings import Settings, describe_settings
from ovmot.settings_file import REMOVED, RENAMED, load_settings


def written(folder: Path, text: str) -> Path:
    path = folder / "settings.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def message_of(path: Path | None, *overrides: str) -> str:
    with pytest.raises(InputError) as caught:
        load_settings(path, overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_without_a_file_the_defaults_hold() -> None:
    assert load_settings(None) == Settings()


def test_a_file_changes_only_what_it_names(tmp_path: Path) -> None:
    path = written(tmp_path, "tracker:\n  max_features: 400\nepipolar: {scale: fy}\n")
    settings = load_settings(path)
    assert settings.tracker.max_features == 400
    assert settings.epipolar.scale == "fy"
    assert settings.tracker.klt_levels == Settings().tracker.klt_levels
    assert settings.segmentation == Settings().segmentation


@pytest.mark.parametrize("text", ["", "# nothing yet\n", "tracker:\n  # max_features: 400\n"])
def test_a_file_or_a_section_may_be_empty(tmp_path: Path, text: str) -> None:
    assert load_settings(written(tmp_path, text)) == Settings()


def test_overrides_win_over_the_file_and_later_ones_over_earlier_ones(tmp_path: Path) -> None:
    path = written(tmp_path, "tracker: {max_features: 400, klt_levels: 3}\n")
    settings = load_settings(path, ["tracker.max_features=150", "tracker.max_features = 160"])
    assert settings.tracker.max_features == 160
    assert settings.tracker.klt_levels == 3


def test_an_override_takes_numbers_with_exponents_and_none() -> None:
    settings = load_settings(None, ["segmentation.false_alarm=1e-3", "imu.gyro_noise=null"])
    assert settings.segmentation.false_alarm == 1e-3
    assert settings.imu.gyro_noise is None


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("tracker: {max_feature: 4}\n", ["unknown key 'tracker.max_feature'"]),
        ("trackers: {max_features: 400}\n", ["unknown key 'trackers'"]),
        ("tracker: {max_features: many}\n", ["'tracker.max_features'", "'many'"]),
        ("tracker: {max_features: 2}\n", ["'tracker.max_features'", "20", "got 2"]),
        ("tracker: {klt_levels: true}\n", ["'tracker.klt_levels'", "True"]),
        ("imu: {gyro_noise: 1.0e+9}\n", ["'imu.gyro_noise'", "less than 100"]),
        ("imu: {accel_walk: 0}\n", ["'imu.accel_walk'", "greater than 0"]),
        ("tracker: 7\n", ["'tracker'", "got 7"]),
        ("epipolar: {scale: fx}\n", ["'epipolar.scale'", "'angle'", "'fy'"]),
        ("epipolar: {threshold_px: .nan}\n", ["'epipolar.threshold_px'", "nan"]),
        ("- tracker\n", ["holds no keys"]),
        ("[tracker]: 3\n", ["row 1: not valid YAML"]),
        ("tracker: [1, 2\n", ["row 2: not valid YAML"]),
        ("tracker: !!python/object:os.system {}\n", ["not valid YAML"]),
        ("tracker: {klt_levels: 3}\ntracker: {max_features: 99}\n", ["'tracker' twice"]),
        ("tracker:\n  klt_levels: 3\n  klt_levels: 4\n", ["'klt_levels' twice", "row 3"]),
    ],
)
def test_a_mistake_in_a_file_is_one_line_naming_file_and_key(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    path = written(tmp_path, text)
    message = message_of(path)
    assert message.startswith(str(path))
    for part in parts:
        assert part in message


def test_every_mistake_of_a_file_is_told_at_once(tmp_path: Path) -> None:
    message = message_of(written(tmp_path, "tracker: {max_features: 2, nope: 1}\n"))
    assert "max_features" in message
    assert "nope" in message


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    missing = tmp_path / "missing.yaml"
    assert str(missing) in message_of(missing)
    assert str(tmp_path) in message_of(tmp_path)
    binary = tmp_path / "image.png"
    binary.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    assert str(binary) in message_of(binary)


@pytest.mark.parametrize(
    "override",
    ["tracker.max_features", "max_features=3", "=3", "tracker.=3", ".x=3", "tracker.klt_levels=["],
)
def test_an_override_of_the_wrong_form_is_shown_back(override: str) -> None:
    assert f"--set {override}" in message_of(None, override)


@pytest.mark.parametrize("override", ["tracker.nope=3", "nope.max_features=3", "tracker.a.b=3"])
def test_an_override_of_an_unknown_setting_is_refused(override: str) -> None:
    assert "unknown key" in message_of(None, override)


def test_an_override_of_a_section_that_the_file_filled_with_a_number(tmp_path: Path) -> None:
    path = written(tmp_path, "tracker: 7\n")
    assert "tracker" in message_of(path, "tracker.max_features=100")


def test_a_wrong_override_is_named_beside_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, "tracker: {klt_levels: 3}\n")
    assert message_of(path, "tracker.nope=3").startswith(f"{path}, --set tracker.nope=3: ")


@pytest.mark.parametrize(
    ("old", "key", "value"),
    [
        ("split.false_alarm=1e-3", "segmentation.false_alarm", 1e-3),
        ("split.pixel_sigma=0.5", "noise.pixel_sigma", 0.5),
        ("objects.slide_per_hop_px=0.2", "noise.drift_per_frame_px", 0.2),
        ("initialization.rest_pixel=0.6", "zero_velocity.pixel", 0.6),
    ],
)
def test_an_old_key_is_taken_and_the_new_one_named(old: str, key: str, value: float) -> None:
    with pytest.warns(SettingsWarning, match=f"is called '{key.split('.', maxsplit=1)[0]}"):
        settings = load_settings(None, [old])
    section, name = key.split(".")
    assert getattr(getattr(settings, section), name) == value


def test_a_new_key_wins_over_its_old_name() -> None:
    with pytest.warns(SettingsWarning):
        settings = load_settings(None, ["objects.pixel_sigma=0.5", "noise.pixel_sigma=0.6"])
    assert settings.noise.pixel_sigma == 0.6


@pytest.mark.parametrize("key", sorted(REMOVED))
def test_a_removed_key_is_passed_over_with_what_takes_its_place(key: str) -> None:
    with pytest.warns(SettingsWarning, match=re.escape(REMOVED[key])):
        settings = load_settings(None, [f"{key}=1"])
    assert settings == Settings()


def test_old_names_lead_to_settings_that_are_there() -> None:
    known = {row[0] for row in describe_settings()}
    sections = {key.split(".")[0] for key in known}
    assert all(new in known or new in sections for new in RENAMED.values())
    assert not known & (set(REMOVED) | set(RENAMED))
