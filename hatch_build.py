"""Build hooks: the README as the package's own page, the commit and compiled code in the package.

A package page knows no file of the repository. `ovmot --version` prints the commit; a wheel that is
built from an sdist takes the sdist's. Compiled code is that of the folder which the variable
`OVMOT_COMPILED_CODE` names (`make wheel`).
"""

import os
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

SOURCE_URL = "Source"
"""The name in `[project.urls]` of the address that repository paths are below, up to the branch:
`https://HOST/OWNER/ovmot/blob/main`."""

_COMMIT_FILE = "ovmot/commit.txt"
_COMPILED_CODE = "ovmot/kernels/shipped"  # `SHIPPED` of ovmot.kernels.cache
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


class PackageHook(BuildHookInterface):  # type: ignore[type-arg]
    """Puts `commit.txt` and compiled code into the package."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before it packs; an editable install asks git when it is run."""
        if version == "editable":
            return
        if self.target_name == "wheel" and "OVMOT_COMPILED_CODE" in os.environ:
            code = Path(os.environ["OVMOT_COMPILED_CODE"])
            for file in (file for file in code.rglob("*") if file.is_file()):
                packed = f"{_COMPILED_CODE}/{file.relative_to(code)}"
                build_data["force_include"][str(file)] = packed
        if (Path(self.root) / "src" / _COMMIT_FILE).exists():
            return
        commit = self._commit()
        if commit is None:
            return
        self._folder = tempfile.TemporaryDirectory()
        file = Path(self._folder.name) / "commit.txt"
        file.write_text(f"{commit}\n", encoding="utf-8")
        packed = _COMMIT_FILE if self.target_name == "wheel" else f"src/{_COMMIT_FILE}"
        build_data["force_include"][str(file)] = packed

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Called after it has packed."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()

    def _commit(self) -> str | None:
        if not (Path(self.root) / ".git").exists():
            return None
        command = ["git", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
        try:
            asked = subprocess.run(
                command, cwd=self.root, check=True, capture_output=True, text=True
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return asked.stdout.strip()
