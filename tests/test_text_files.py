"""Files of text and YAML, and what must not be able to hang, flood or run the program."""

import os
from pathlib import Path

import pytest

from ovmot.errors import InputError
from ovmot.text_files import YamlError, parse_yaml, read_text, read_yaml

_BOMB = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)
)


def test_text_is_without_the_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "a b\u00fc.txt"
    path.write_bytes(b"\xef\xbb\xbfone\r\ntwo")
    assert read_text(path, InputError) == "one\ntwo"


def test_pipes_devices_and_folders_are_refused(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    device = tmp_path / "endless.csv"
    device.symlink_to("/dev/zero")
    for path in (pipe, device, tmp_path):
        with pytest.raises(InputError, match=f"{path.name}: is no file"):
            read_text(path, InputError)


def test_other_encodings_and_missing_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "wide.csv").write_text("1,2", encoding="utf-16")
    with pytest.raises(InputError, match=r"wide\.csv: cannot be read as text.*UTF-8"):
        read_text(tmp_path / "wide.csv", InputError)
    with pytest.raises(InputError, match=r"none\.csv: not there"):
        read_text(tmp_path / "none.csv", InputError, "not there")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a: 1\na: 2\n", "found 'a' twice"),
        ("a: [1,\n", "expected the node content"),
        ("a: !!python/object/apply:os.system ['touch ran']\n", "could not determine"),
        ("a: 2001-99-99\n", "a value cannot be read"),
        ("a: !!int zz\n", "a value cannot be read"),
        ("a: !!timestamp zz\n", "a value cannot be read"),
        (f"a: {'9' * 5000}\n", "a value cannot be read"),
        ("a: " + "[" * 20_000, "nested too deeply"),
        (_BOMB, "more than 100000 values"),
        ("a: &a [*a, 1]\n", "more than 100000 values"),
        ("#" * 500_001, "more than 500000 characters"),
    ],
)
def test_hostile_yaml_is_one_error(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(YamlError, match=problem):
        parse_yaml(text)
    path = tmp_path / "hostile.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=problem) as caught:
        read_yaml(path, InputError)
    assert "\n" not in str(caught.value)
    assert not Path("ran").exists()


def test_the_row_of_a_mistake_is_named(tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("%YAML:1.0\na: 1\na: 2\n")
    with pytest.raises(InputError, match=r"settings\.yaml, row 3: not valid YAML: found 'a' twice"):
        read_yaml(path, InputError)


def test_opencv_matrices_are_mappings() -> None:
    matrix = parse_yaml("M: !!opencv-matrix {rows: 1, cols: 2, dt: d, data: [1., 2.]}")["M"]
    assert matrix == {"rows": 1, "cols": 2, "dt": "d", "data": [1.0, 2.0]}


OPENCV = """\
%YAML:1.0
---
model_type:PINHOLE
image_width:752
# a comment with a key:value
distortion_parameters:
   k1:-0.28
   k2: 0.07
T: !!opencv-matrix
   rows:2
   cols:2
   data: [ 1.0,\t0.0,
\t   0.0,\t1.0 ]
topic: /cam0/image_raw
"""


def test_what_opencv_reads_is_read(tmp_path: Path) -> None:
    """A key without a blank after its colon, tabs within a matrix."""
    path = tmp_path / "cam0.yaml"
    path.write_text(OPENCV)
    assert read_yaml(path, InputError) == {
        "model_type": "PINHOLE",
        "image_width": 752,
        "distortion_parameters": {"k1": -0.28, "k2": 0.07},
        "T": {"rows": 2, "cols": 2, "data": [1.0, 0.0, 0.0, 1.0]},
        "topic": "/cam0/image_raw",
    }
    path.write_text("%YAML 1.0\nwidth:752\nheight:480\n")
    assert read_yaml(path, InputError) == {"width": 752, "height": 480}


def test_yaml_that_pyyaml_reads_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "plain.yaml"
    path.write_text("a: x:y\nb: 'c:d'\nc: [e:f]\n")
    assert read_yaml(path, InputError) == {"a": "x:y", "b": "c:d", "c": ["e:f"]}


def test_the_right_row_is_named(tmp_path: Path) -> None:
    """What is broken, and not the row after a key without a blank."""
    path = tmp_path / "cam0.yaml"
    path.write_text(OPENCV.replace("   k2: 0.07", "   k2: @0.07"))
    with pytest.raises(InputError, match=r"cam0\.yaml, row 8: not valid YAML"):
        read_yaml(path, InputError)


def test_a_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    with pytest.raises(InputError, match=r"data\.csv: is a Git LFS pointer.*git lfs pull"):
        read_text(path, InputError)
