"""The README is short, and its form on a package page has no link to a file of the repository."""

import re
import sys

from doc_blocks import ROOT
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

sys.path.insert(0, str(ROOT))

from hatch_build import package_page

README = (ROOT / "README.md").read_text(encoding="utf-8")
RELATIVE = re.compile(r"\]\((?!https?:)")


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) < 90
    assert len(README.encode()) < 10_000


def test_links_without_an_address_become_text() -> None:
    text = "See [here](docs/start.md#a) and [there](https://x.org/).\n\n![P](docs/p.gif)\n\nEnd\n"
    assert package_page(text, None) == "See here and [there](https://x.org/).\n\n\nEnd\n"


def test_links_with_an_address_are_absolute() -> None:
    text = "[here](docs/start.md) [there](https://x.org/)\n![P](docs/p.gif)\n"
    assert package_page(text, "https://h/o/ovmot/blob/main/") == (
        "[here](https://h/o/ovmot/blob/main/docs/start.md) [there](https://x.org/)\n"
        "![P](https://h/o/ovmot/raw/main/docs/p.gif)\n"
    )


def test_the_metadata_have_that_form() -> None:
    metadata = ProjectMetadata(str(ROOT), PluginManager())
    assert metadata.core.readme_content_type == "text/markdown"
    assert metadata.core.readme.startswith("# ovmot")
    assert not RELATIVE.search(metadata.core.readme)
