"""Scene files: the catalog loads, defaults fill in, every mistake is one clear line."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from ovmot.errors import InputError
from ovmot.sim.scene_file import CATALOG, SCENES, AcrossPart, AlongPart, SceneFile, load_scene


def test_the_catalog_is_what_is_in_its_folder() -> None:
    assert {path.stem for path in CATALOG.glob("*.yaml")} == set(SCENES)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_of_the_catalog_loads(name: str) -> None:
    scene = load_scene(name)
    assert 5.0 <= scene.duration_s <= 20.0
    assert bool(scene.along or scene.across) == (name != "empty")


def test_a_file_is_read_as_a_scene(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("duration_s: 3\nalong:\n  - {start_m: 20, offset_m: 1.7, oncoming: true}\n")
    scene = load_scene(str(path))
    assert (scene.duration_s, scene.rate_hz, scene.rig) == (3.0, 10.0, "street")
    assert scene.along[0].oncoming and scene.along[0].kind == "car"
    assert scene.across == ()


def test_every_key_has_a_help_text() -> None:
    sections: list[type[BaseModel]] = [SceneFile, AlongPart, AcrossPart]
    for field in SceneFile.model_fields.values():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            sections.append(field.annotation)
    for section in sections:
        for name, field in section.model_fields.items():
            part = isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
            assert part or field.description, f"{section.__name__}.{name}"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["'duration_s' is missing"]),
        ("duration_s: 0\n", ["'duration_s'", "greater than 0"]),
        ("duration_s: 601\n", ["'duration_s'", "600"]),
        ("duration_s: yes\n", ["'duration_s'", "true or false"]),
        ("duration_s: 3\nrate_hz: 200\n", ["'rate_hz'", "100"]),
        ("duration_s: 3\nduration_s: 4\n", ["found 'duration_s' twice"]),
        ("duration_s: 3\nwheather: rain\n", ["unknown key 'wheather'"]),
        ("duration_s: 3\nlight: {suns: 2}\n", ["unknown key 'light.suns'"]),
        ("duration_s: 3\nrig: mono\n", ["'rig'", "'street' or 'fisheye'", "'mono'"]),
        ("duration_s: 3\ndrive: {speed: [[1, 2], [1, 3]]}\n", ["'drive.speed'", "must rise"]),
        ("duration_s: 3\ndrive: {speed: []}\n", ["'drive.speed'", "must rise"]),
        ("duration_s: 3\ndrive: {speed: [[0, -2]]}\n", ["'drive.speed'", "0 to 40 m/s"]),
        ("duration_s: 3\nroad: {curvature: [[0, 3]]}\n", ["'road.curvature'", "-0.2 to 0.2"]),
        ("duration_s: 3\nalong: [{offset_m: 2}]\n", ["'along.0.start_m' is missing"]),
        (
            "duration_s: 3\nalong: [{start_m: 2, offset_m: 2, kind: tram}]\n",
            ["along.0.kind", "tram"],
        ),
        ("duration_s: 3\nacross: [{at_m: .inf}]\n", ["'across.0.at_m'", "finite"]),
        ("duration_s: 3\nstreet: {crossing: [9, 3]}\n", ["'street.crossing'", "smaller"]),
        ("duration_s: [\n", ["not valid YAML"]),
        ("- 3\n", ["holds no keys"]),
    ],
)
def test_a_mistake_is_one_line_naming_file_and_key(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_scene(str(path))
    message = str(caught.value)
    assert "\n" not in message
    for part in (str(path), *parts):
        assert part in message


def test_an_unknown_name_lists_the_catalog() -> None:
    with pytest.raises(InputError, match=r"trafic: neither a scene.*demo, traffic, crossing"):
        load_scene("trafic")


def test_too_many_movers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    along = "\n".join(f"  - {{start_m: {9 * i}, offset_m: 2}}" for i in range(200))
    across = "\n".join(f"  - {{at_m: {i}, from_offset_m: 9, speed: [[0, 1]]}}" for i in range(56))
    path.write_text(f"duration_s: 3\nalong:\n{along}\nacross:\n{across}\n")
    with pytest.raises(InputError, match="more than 255 movers"):
        load_scene(str(path))
