"""The README as the package's own page: a package page knows no file of the repository."""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

SOURCE_URL = "Source"
"""The name in `[project.urls]` of the address that repository paths are below, up to the branch:
`https://HOST/OWNER/ovmot/blob/main`."""

_PICTURE = re.compile(r"!\[([^\]]*)\]\((?!https?:)([^)\s]+)\)\n?")
_LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)([^)\s]+)\)")


class PackageReadme(MetadataHookInterface):
    """Sets the `readme` of the package's metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Called by hatchling when it builds or installs the package."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        url = metadata.get("urls", {}).get(SOURCE_URL)
        metadata["readme"] = {"content-type": "text/markdown", "text": package_page(text, url)}


def package_page(text: str, url: str | None) -> str:
    """The README with links that hold anywhere.

    Parameters
    ----------
    text
        Markdown with links relative to the repository's root.
    url
        Where the repository's files are; None where it has no address yet: then links become plain
        text, and pictures are left out.
    """
    if url is None:
        return _LINK.sub(r"\1", _PICTURE.sub("", text))
    base = url.rstrip("/")
    raw = base.replace("/blob/", "/raw/")
    text = _PICTURE.sub(lambda m: f"![{m[1]}]({raw}/{m[2]})\n", text)
    return _LINK.sub(lambda m: f"[{m[1]}]({base}/{m[2]})", text)
