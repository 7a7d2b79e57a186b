"""Text and YAML files that users give: read so that none can hang, flood or run the program."""

import os
import re
from pathlib import Path
from typing import Any

import yaml

from ovmot.errors import InputError

StrPath = str | os.PathLike[str]
"""A file or folder, as text or as a `Path`: what every public function takes."""

_MOST_YAML_CHARACTERS = 500_000
_MOST_YAML_VALUES = 100_000


def read_text(path: Path, error: type[InputError], missing: str = "no such file") -> str:
    """The text of a file in UTF-8, without its byte order mark.

    Raises `error` if it is missing, no plain file (a pipe would never end), or no text.
    """
    try:
        if path.exists() and not path.is_file():
            raise error.at(path, "is no file", "give a file of text")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise error.at(path, missing) from None
    except UnicodeDecodeError as problem:
        raise error.at(path, f"cannot be read as text: {problem}", "save it as UTF-8") from None
    except OSError as problem:
        raise error.at(path, f"cannot be read: {problem.strerror}") from None
    if is_lfs_pointer(text):
        raise error.at(path, LFS_POINTER, LFS_REMEDY)
    return text


LFS_POINTER = "is a Git LFS pointer, not the file itself"
LFS_REMEDY = "fetch the data with 'git lfs pull'"


def is_lfs_pointer(head: str | bytes) -> bool:
    """Does a file begin as the small file that Git LFS leaves in place of a large one?

    Git LFS specification, docs/spec.md: the first line is `version` and the address.
    """
    mark = "version https://git-lfs.github.com/spec/"
    return head.startswith(mark) if isinstance(head, str) else head.startswith(mark.encode())


def read_yaml(path: Path, error: type[InputError], missing: str = "no such file") -> Any:
    """What a YAML file holds; what OpenCV reads and YAML forbids is let pass (`plain_yaml`).

    Raises `error` with the row for what is no file, no text or no YAML of ours (`parse_yaml`).
    """
    text = _HEADER.sub(
        lambda header: "\n" * header.group().count("\n"), read_text(path, error, missing)
    )
    try:
        try:
            loaded = parse_yaml(text)
        except YamlError:
            return parse_yaml(plain_yaml(text))
        # without a blank after any colon, the whole file is one text
        return parse_yaml(plain_yaml(text)) if isinstance(loaded, str) else loaded
    except YamlError as problem:
        raise error.at(path, str(problem), "correct the file", row=problem.row) from None


_HEADER = re.compile(r"\A\s*%YAML\b[^\n]*")  # OpenCV's is no directive of YAML
_KEY_WITHOUT_BLANK = re.compile(r"^([ \t]*(?:- )?[A-Za-z_]\w*):(?=[^\s:])", re.MULTILINE)


def plain_yaml(text: str) -> str:
    """The text row by row as YAML wants it: tabs as blanks, and a blank after a key's colon."""
    return _KEY_WITHOUT_BLANK.sub(r"\1: ", text.replace("\t", "    "))


class YamlError(ValueError):
    """Text that is no YAML, or none that is read here; `row` (1-based) if it is known."""

    def __init__(self, problem: str, row: int | None = None) -> None:
        super().__init__(f"not valid YAML: {' '.join(problem.split())}")
        self.row = row


def parse_yaml(text: str) -> Any:
    """Plain values only: nothing is made or run that a tag names. Raises `YamlError`.

    A key given twice is an error, since the first one would be lost without a word; so is a text
    that is huge, also one that grows huge by its anchors.
    """
    if len(text) > _MOST_YAML_CHARACTERS:
        raise YamlError(f"more than {_MOST_YAML_CHARACTERS} characters")
    try:
        loaded = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error)
        raise YamlError(problem, None if mark is None else int(mark.line) + 1) from None
    except RecursionError:
        raise YamlError("nested too deeply") from None
    except Exception as error:  # what int(), date() and the like raise for a value
        raise YamlError(f"a value cannot be read: {error}") from None
    _refuse_huge(loaded)
    return loaded


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader, which keeps the last of equal keys; here they are an error."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # refused below
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"found '{key.value}' twice", key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
    """OpenCV's matrix as a plain mapping."""
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, "expected rows, cols, data")
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def _refuse_huge(loaded: Any) -> None:
    """Count the values as if anchors were written out: a few rows of them can make billions."""
    count, waiting = 0, [loaded]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict | list):
            waiting.extend(value.values() if isinstance(value, dict) else value)
        count += 1
        if count > _MOST_YAML_VALUES:
            raise YamlError(f"more than {_MOST_YAML_VALUES} values")
