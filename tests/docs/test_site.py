"""The site: its own reading of Markdown and links, and the build, offline and without a warning."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from doc_blocks import ROOT

import ovmot
from generated import api_page, notebook_page, settings_page
from python_markdown import to_python_markdown
from site_map import relink, site_path

FETCHED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src"}
"""Tags whose address a browser fetches by itself."""


def test_lists_as_python_markdown_wants_them() -> None:
    page = "Text:\n- a\n  more\n\n  second\n- b\n  1. x\n     y\n\nEnd\n"
    expected = "Text:\n\n- a\n    more\n\n    second\n\n- b\n    1. x\n        y\n\nEnd\n"
    assert to_python_markdown(page) == expected


def test_blocks_of_code_stay_as_they_are() -> None:
    fenced = "```yaml\n- a\n  - b\n```\n"
    indented = "Text\n\n    - a\n      b\n\nText\n"
    assert to_python_markdown(fenced) == fenced
    assert to_python_markdown(indented) == indented


def test_code_inside_an_item() -> None:
    page = "- a\n\n      code\n\n  text\n- b\n"
    assert to_python_markdown(page) == "- a\n\n        code\n\n    text\n\n- b\n"


def test_links_follow_the_pages() -> None:
    wanted: list[str] = []
    text = "[a](../BENCHMARK.md#how-fast) [b](../benchmarks) [c](../examples/read_run.py) [d](https://x.org/)"
    moved = relink(text, "performance.md", wanted.append)
    assert moved == (
        "[a](benchmark.md#how-fast) b [c](source/examples/read_run.py.md) [d](https://x.org/)"
    )
    assert wanted == ["examples/read_run.py"]
    assert relink("[a](docs/adr/001-x.md)", "changelog.md") == "[a](adr/001-x.md)"
    assert relink("[a](../house.md)", "adr/001-x.md") == "[a](../house.md)"
    assert site_path("src/ovmot/settings.py") == "settings.md"
    assert site_path("examples/from_data_to_plots.ipynb") == "notebook.md"


def test_pages_from_the_code_are_whole() -> None:
    settings, api = settings_page(), api_page()
    for key, *_ in ovmot.describe_settings():
        section, _, leaf = key.partition(".")
        assert f"## {section}\n" in settings
        assert f"| `{leaf}` |" in settings
    for name in ovmot.__all__:
        assert f"### ovmot.{name}\n" in api


def test_a_notebook_as_a_page() -> None:
    text = '{"cells": [{"cell_type": "markdown", "source": ["# A\\n", "b"]},'
    text += ' {"cell_type": "code", "source": ["x = 1"]}]}'
    assert notebook_page(text) == "# A\nb\n\n```python\nx = 1\n```\n"


class Page(HTMLParser):
    """Links, names of places, what the browser fetches by itself, and paragraphs of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.names: set[str] = set()
        self.fetched: list[str] = []
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.names |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        address = given.get(FETCHED.get(tag, ""))
        if address and given.get("rel") not in ("canonical", "next", "prev"):
            self.fetched.append(address)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it: a warning fails the build; nothing can be fetched."""
    pytest.importorskip("mkdocs", reason="make install-docs")
    pytest.importorskip("mkdocstrings", reason="make install-docs")
    out = tmp_path_factory.mktemp("site")
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "ALL_PROXY"), "http://127.0.0.1:9")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)],
        cwd=ROOT, env=os.environ | nowhere | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr
    assert "WARNING" not in built.stdout + built.stderr
    return out


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


@pytest.mark.slow
@pytest.mark.xdist_group("site")
def test_every_link_of_the_site_leads_somewhere(site: Path, pages: dict[Path, Page]) -> None:
    broken = []
    for path, page in pages.items():
        if path.name == "404.html":  # its links are from the root of a server
            continue
        for link in [*page.links, *page.fetched]:
            name, _, place = unquote(link).partition("#")
            if "://" in name or name.startswith(("mailto:", "data:")):
                continue
            target = (path.parent / name.partition("?")[0]).resolve() if name else path
            target = target / "index.html" if target.is_dir() else target
            known = pages[target].names if target in pages else None
            if not target.exists() or (place and known is not None and place not in known):
                broken.append(f"{path.relative_to(site)}: {link}")
    assert broken == []


@pytest.mark.slow
@pytest.mark.xdist_group("site")
def test_nothing_comes_from_the_network(site: Path, pages: dict[Path, Page]) -> None:
    outside = re.compile(r"^(?:https?:)?//")
    fetched = [a for page in pages.values() for a in page.fetched if outside.match(a)]
    assert fetched == []
    styles = [path.read_text(encoding="utf-8") for path in site.rglob("*.css")]
    assert [a for text in styles for a in re.findall(r"url\(\s*['\"]?(https?:[^)]+)", text)] == []


@pytest.mark.slow
@pytest.mark.xdist_group("site")
def test_no_list_has_become_a_paragraph(pages: dict[Path, Page]) -> None:
    swallowed = [
        f"{path.name}: {found[:80]}"
        for path, page in pages.items()
        for found in re.findall(r"<p>(.*?)</p>", page.text, re.S)
        if re.search(r"\n\s*(?:[-*+]|\d+\.) ", found)
    ]
    assert swallowed == []
