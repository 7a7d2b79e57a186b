"""Which page of the site a file of the repository becomes, and how links follow."""

import posixpath
import re
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

ROOT_PAGES = {
    "BENCHMARK.md": "benchmark.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "README.md": "index.md",
    "examples/from_data_to_plots.ipynb": "notebook.md",
}
"""Files outside `docs/` that are pages of the site too; the README stands apart, and links to it
lead to the site's first page."""

CODE_PAGES = {"src/ovmot/settings.py": "settings.md", "src/ovmot/__init__.py": "api.md"}
"""Files of the code whose page is made from what they declare."""

_LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]*)?\)")
_FOLDER_LINK = re.compile(r"\[([^\]]+)\]\(([^)\s#]+)\)")


def home_of(site_page: str) -> str:
    """The file of the repository that a page is made from, as a path from the repository's root."""
    for name, page in ROOT_PAGES.items():
        if page == site_page and page != "index.md":
            return name
    return f"docs/{site_page}"


def site_path(repository_path: str) -> str:
    """Where a file of the repository is in the site, as a path from the site's root.

    Files outside `docs/` that are no page of their own get one that shows their text.
    """
    if page := (ROOT_PAGES | CODE_PAGES).get(repository_path):
        return page
    if repository_path.startswith("docs/"):
        return repository_path.removeprefix("docs/")
    return f"source/{repository_path}.md"


def relink(text: str, site_page: str, wanted: Callable[[str], None] = lambda _: None) -> str:
    """The text of a page with links that hold in the site.

    Parameters
    ----------
    text
        Markdown whose links are relative to the file that it stands in.
    site_page
        The page's path in the site.
    wanted
        Called with the repository's path of each linked file that needs a page of its own.

    Returns
    -------
    str
        Markdown whose links are relative to the page. Links to folders become plain text.
    """
    home = posixpath.dirname(home_of(site_page))
    base = posixpath.dirname(site_page)

    def target(link: str) -> str:
        return posixpath.normpath(posixpath.join(home, link))

    def without_folder(match: re.Match[str]) -> str:
        outside = not _is_elsewhere(match[2]) and (ROOT / target(match[2])).is_dir()
        return match[1] if outside else match[0]

    def moved(match: re.Match[str]) -> str:
        link, anchor = match[1], match[2] or ""
        if _is_elsewhere(link):
            return match[0]
        file = target(link)
        page = site_path(file)
        if page.startswith("source/"):
            wanted(file)
        return f"]({posixpath.relpath(page, base or '.')}{anchor})"

    return _LINK.sub(moved, _FOLDER_LINK.sub(without_folder, text))


def _is_elsewhere(link: str) -> bool:
    return "://" in link or link.startswith("mailto:")
