"""The documentation agrees with the repository: links, file names, symbols and settings exist."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from pydantic import BaseModel

from ovmot.batch.plan import Features, Plan, Recorded, Rendered
from ovmot.settings import describe_settings
from ovmot.sim.miscalibration import Miscalibration
from ovmot.sim.scene_file import AcrossPart, AlongPart, SceneFile

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "ovmot"
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
HISTORY = [ROOT / "CHANGELOG.md", *sorted((ROOT / "docs" / "adr").glob("*.md"))]
"""Pages that also name what is not there any more; only their links are checked."""
PRESENT = [page for page in PAGES if page not in HISTORY]

LINK = re.compile(r"\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.M)
FENCED = re.compile(r"^```.*?^```", re.M | re.S)
CODE = re.compile(r"`([^`]+)`")
SYMBOL = re.compile(r"^([\w/]+\.py): ([\w.]+)$")
FILE = re.compile(r"^[\w./-]+\.py$|^(?:benchmarks|config|docs|src|tests)/[\w./-]+$")
MODULE = re.compile(r"^ovmot((?:\.\w+)+)$")
FILE_ENDINGS = {"csv", "json", "md", "py", "txt", "tum", "yaml"}


def page_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def anchor_of(heading: str) -> str:
    """GitHub's name of a heading in links."""
    kept = re.sub(r"[^\w\- ]", "", heading.lower())
    return kept.strip().replace(" ", "-")


def code_spans(page: Path) -> list[str]:
    """What stands between backticks, on one line each."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    return [" ".join(span.split()) for span in CODE.findall(text)]


def found_file(name: str) -> Path | None:
    """A file by its path in the repository, in `src/ovmot`, or by its name alone in the latter."""
    for place in (ROOT / name, SOURCE / name):
        if place.exists():
            return place
    return None if "/" in name else next(SOURCE.rglob(name), None)


@cache
def symbols_of(file: Path) -> frozenset[str]:
    """Functions, classes, members of classes, and constants that a file defines."""
    names: set[str] = set()

    def add(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names.add(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                add(node.body, f"{prefix}{node.name}.")
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
            names.update(prefix + t.id for t in targets if isinstance(t, ast.Name))

    add(ast.parse(file.read_text(encoding="utf-8")).body, "")
    return frozenset(names)


def missing_name(span: str) -> str | None:
    """What a code span names and is not there."""
    if found := SYMBOL.match(span):
        file = found_file(found[1])
        return None if file and found[2] in symbols_of(file) else span
    if FILE.match(span):
        return None if found_file(span) else span
    if found := MODULE.match(span):
        path = SOURCE.joinpath(*found[1][1:].split("."))
        return None if path.is_dir() or path.with_suffix(".py").is_file() else span
    return None


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_links_lead_somewhere(page: Path) -> None:
    broken = []
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" in link or link.startswith("mailto:"):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        anchors = set()
        if anchor and target.is_file():
            anchors = {anchor_of(h) for h in HEADING.findall(target.read_text(encoding="utf-8"))}
        if not target.exists() or (anchor and anchor not in anchors):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", PRESENT, ids=page_name)
def test_files_and_symbols_exist(page: Path) -> None:
    assert [span for span in map(missing_name, code_spans(page)) if span is not None] == []


@pytest.mark.parametrize("page", PRESENT, ids=page_name)
def test_settings_exist(page: Path) -> None:
    known = {key for key, *_ in describe_settings()}
    sections = {key.split(".")[0] for key in known}
    key = re.compile(rf"(?<![\w./])({'|'.join(sorted(sections))})\.(\w+)")
    named = [match for span in code_spans(page) for match in key.findall(span)]
    unknown = [f"{s}.{n}" for s, n in named if n not in FILE_ENDINGS and f"{s}.{n}" not in known]
    assert unknown == []


def keys_of(section: type[BaseModel], prefix: str = "") -> set[str]:
    """The keys of a section as the docs write them, those of single sections in it too."""
    keys = set()
    for name, field in section.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            keys |= keys_of(inner, f"{name}: ")
        else:
            keys.add(f"{prefix}{name}")
    return keys


@pytest.mark.parametrize(
    ("page", "sections"),
    [
        ("batch.md", (Plan, Recorded, Rendered, Features, Miscalibration)),
        ("simulator.md", (SceneFile, AlongPart, AcrossPart)),
    ],
)
def test_every_key_of_a_file_is_listed(page: str, sections: tuple[type[BaseModel], ...]) -> None:
    listed = set(re.findall(r"^\| `([^`]+)` \|", (ROOT / "docs" / page).read_text(), re.MULTILINE))
    missing = {key for section in sections for key in keys_of(section)} - listed
    assert missing - {"along", "across"} == set()


def test_what_is_missing_is_noticed() -> None:
    assert missing_name("odometry.py: Odometry.step") is None
    assert missing_name("odometry.py: Odometry.stride") == "odometry.py: Odometry.stride"
    assert missing_name("vio/no_such_file.py") == "vio/no_such_file.py"
    assert missing_name("ovmot.no_such_module") == "ovmot.no_such_module"
    assert anchor_of("8. Life of a `track`: end") == "8-life-of-a-track-end"
