"""Plans are read whole, and each mistake is one line."""

from pathlib import Path

import pytest

from ovmot.batch.plan import Features, Recorded, Rendered, nested, read_plan
from ovmot.errors import InputError

PLAN = """\
sequences:
  mh01: {data: data/mh01}
  street: {scene: traffic, size: [320, 140], duration_s: 2}
  walk: {features: walk.txt, n_features: 100}
settings:
  default: {}
  no_seg: {segmentation.enabled: false, tracker: {max_features: 100}, tracker.klt_levels: 3}
seeds: 3
"""


def plan_file(folder: Path, text: str) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text)
    return path


def test_a_plan(tmp_path: Path) -> None:
    plan = read_plan(plan_file(tmp_path, PLAN))
    mh01, street, walk = plan.sequences.values()
    assert isinstance(mh01, Recorded) and mh01.data == tmp_path / "data" / "mh01"
    assert isinstance(street, Rendered) and street.size == (320, 140)
    assert isinstance(walk, Features) and walk.features == tmp_path / "walk.txt"
    settings = plan.settings_of("no_seg")
    assert not settings.segmentation.enabled
    assert (settings.tracker.max_features, settings.tracker.klt_levels) == (100, 3)
    assert plan.seed_list == (0, 1, 2)


def test_a_plan_of_the_least(tmp_path: Path) -> None:
    plan = read_plan(plan_file(tmp_path, "sequences: {a: {data: /x}}\nseeds: [4, 7]\n"))
    assert plan.seed_list == (4, 7)
    assert plan.settings_of("default") is not None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("{data: data/mh01}", "{}", "exactly one of the keys data, scene and features"),
        ("{data: data/mh01}", "{data: a, scene: b}", "exactly one of the keys"),
        ("{data: data/mh01}", "7", "exactly one of the keys"),
        ("duration_s: 2", "duration: 2", "unknown key 'sequences.street.scene.duration'"),
        ("duration_s: 2", "duration_s: -2", "greater than 0"),
        ("n_features: 100", "depth_m: [7, 5]", "the smaller one first"),
        ("  street:", "  ../street:", "'../street' can not be the name of a folder"),
        ("  street:", "  data:", "'data' can not be the name of a folder"),
        ("  street:", "  mh01:", "found 'mh01' twice"),
        ("seeds: 3", "seeds: 0", "a number from 1 on"),
        ("seeds: 3", "seeds: 1000000000000", "at most 100000 seeds"),
        ("seeds: 3", "seeds: [1, 1]", "different seeds"),
        ("seeds: 3", "seed: 3", "unknown key 'seed'"),
        ("n_features: 100", "calibration_error: {rotation: 1}", "calibration_error.rotation'"),
        ("n_features: 100", "calibration_error: {rotation_deg: -1}", "greater than or equal to 0"),
        (
            "segmentation.enabled: false", "segmentation.enable: false",
            "no_seg: unknown key 'segmentation.enable'",
        ),
        (
            "segmentation.enabled: false", "segmentation.enabled: 7",
            "settings no_seg: 'segmentation.enabled'",
        ),
        ("sequences:", "sequences: !!python/object:os.system", "not valid YAML"),
        (PLAN, "", "'sequences' is missing"),
        (PLAN, "[]", "holds no keys"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in PLAN
    path = plan_file(tmp_path, PLAN.replace(old, new))
    with pytest.raises(InputError) as raised:
        read_plan(path)
    line = str(raised.value)
    assert "\n" not in line
    assert line.startswith(str(path))
    assert message in line


def test_a_missing_plan(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.yaml: no such file"):
        read_plan(tmp_path / "nowhere.yaml")


def test_dotted_and_nested_keys_meet() -> None:
    assert nested({"a.b": 1, "a": {"c": 2}, "a.d": 3}) == {"a": {"b": 1, "c": 2, "d": 3}}
