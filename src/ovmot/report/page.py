"""The page as one file: its template, styles and script from `assets/`, and the data.

Nothing of the data becomes markup: it is JSON that the script reads, and the script makes texts of
texts. What a policy in the page allows is its own script, its own styles and pictures that it
holds: no request, and no other script, whatever a file name says.
"""

import base64
import hashlib
import html
import json
from importlib.resources import files
from string import Template
from typing import Any

_SCRIPTS = (
    "uplot.min.js", "base.js", "clock.js", "map.js", "plots.js", "sortable.js", "tables.js",
    "main.js",
)  # fmt: skip
_STYLES = ("uplot.min.css", "page.css")
_BATCH_SCRIPTS = ("base.js", "sortable.js", "batch.js")


def report_page(contents: dict[str, Any]) -> str:
    """The page of `contents` (see `contents.page_contents`)."""
    title = " · ".join(run["name"] for run in contents["runs"])
    return page_of("page.html", _SCRIPTS, _STYLES, contents, f"ovmot: {title}")


def batch_page(contents: dict[str, Any]) -> str:
    """The page of many runs; see `batch/page.py`."""
    title = f"ovmot: {contents['name']}"
    return page_of("batch.html", _BATCH_SCRIPTS, ("page.css",), contents, title)


def page_of(
    body: str, scripts: tuple[str, ...], styles: tuple[str, ...], contents: Any, title: str
) -> str:
    """A page of files in `assets/` within `frame.html`, `contents` (values of JSON), a title."""
    script = "\n".join(_asset(name) for name in scripts)
    style = "\n".join(_asset(name) for name in styles)
    policy = "; ".join(
        [
            "default-src 'none'", "img-src data:", f"script-src '{_hash(script)}'",
            f"style-src '{_hash(style)}'", "base-uri 'none'", "form-action 'none'",
        ]
    )  # fmt: skip
    return Template(_asset("frame.html")).substitute(
        policy=html.escape(policy, quote=False), title=html.escape(printable(title)),
        style=style, body=_asset(body), script=script, data=embedded(contents),
    )  # fmt: skip


def embedded(contents: Any) -> str:
    """JSON that can stand in a page: no `<`, so that nothing in it can end its element."""
    text = json.dumps(contents, allow_nan=False, separators=(",", ":"))  # ASCII alone
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def printable(text: str) -> str:
    """A text without what is no character: a path's bytes need not be UTF-8."""
    return text.encode("utf-8", errors="replace").decode("utf-8")


def _asset(name: str) -> str:
    return (files("ovmot.report") / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """What a content security policy calls a script or a style by."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return "sha256-" + base64.b64encode(digest).decode("ascii")
