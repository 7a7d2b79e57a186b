"""What MkDocs does beside reading `docs/`: pages from the code and from files outside `docs/`.

Named in `mkdocs.yml`. Nothing is fetched: every page and every file is made from this repository.
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # MkDocs loads this file alone

from mkdocs.structure.files import File, Files

from generated import api_page, notebook_page, settings_page, source_page
from python_markdown import to_python_markdown
from site_map import ROOT, ROOT_PAGES, home_of, relink

_DECISIONS = "adr/*"

_SHIM_ADDRESS = "https://unpkg.com/iframe-worker/shim"
_SHIM = Path(__file__).parent / "iframe-worker"
"""The theme's search needs this script in pages that are opened from a folder (version 1.0.4, MIT),
and would have it fetched."""


def on_config(config: Any) -> Any:
    """The navigation names the decision records by a pattern."""
    found = sorted((ROOT / "docs" / "adr").glob("[0-9]*.md"))
    names = [f"adr/{path.name}" for path in found if not path.name.startswith("000")]
    config.nav = _with_decisions(config.nav, names)
    return config


def on_files(files: Files, *, config: Any) -> Files:
    """Add the pages that are not files of `docs/`."""
    made = {"settings.md": settings_page(), "api.md": api_page()}
    for name, page in ROOT_PAGES.items():
        if page != "index.md":
            text = (ROOT / name).read_text(encoding="utf-8")
            made[page] = notebook_page(text) if name.endswith(".ipynb") else text
    shown: set[str] = set()
    for page in files.documentation_pages():
        relink(page.content_string, page.src_uri, shown.add)
    for page, text in made.items():
        relink(text, page, shown.add)
        files.append(File.generated(config, page, content=text))
    for file in sorted(shown):
        if (ROOT / file).is_file():  # else the link stays, and MkDocs says that it is broken
            text = source_page(ROOT, file)
            files.append(File.generated(config, f"source/{file}.md", content=text))
    for name in ("shim.js", "LICENSE"):
        path = str(_SHIM / name)
        files.append(File.generated(config, f"assets/iframe-worker/{name}", abs_src_path=path))
    return files


def on_post_page(output: str, *, page: Any, **_: Any) -> str:
    """The built page with the script for its search from the site itself."""
    up = "../" * page.url.count("/")
    return output.replace(_SHIM_ADDRESS, f"{up}assets/iframe-worker/shim.js")


def on_post_template(output: str, **_: Any) -> str:
    """The same of pages that are none of the docs' (404.html)."""
    return output.replace(_SHIM_ADDRESS, "/assets/iframe-worker/shim.js")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links that hold in the site, and lists as Python-Markdown wants them."""
    name = page.file.src_uri
    if name.startswith("source/"):
        return markdown
    page.meta.setdefault("home", home_of(name))
    return to_python_markdown(relink(markdown, name))


def _with_decisions(nav: Any, names: list[str]) -> Any:
    if isinstance(nav, dict):
        return {key: _with_decisions(value, names) for key, value in nav.items()}
    if isinstance(nav, list):
        return [
            entry
            for given in nav
            for entry in (names if given == _DECISIONS else [_with_decisions(given, names)])
        ]
    return nav
