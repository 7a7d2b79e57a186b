"""Markdown as GitHub reads it, rewritten so that Python-Markdown reads the same.

The pages are written for both. Python-Markdown differs in lists: it wants an empty line before
one, and four columns of indentation for what belongs to an item, whatever the marker's width.
"""

import re

_ITEM = re.compile(r"^ *(?:[-*+]|\d+[.)]) +(?=\S)")
_FENCE = re.compile(r"^ *(?:```|~~~)")


def to_python_markdown(text: str) -> str:
    """The same page with lists as Python-Markdown wants them; fenced blocks stay as they are."""
    out: list[str] = []
    items: list[int] = []  # the columns at which the texts of the open items begin
    fenced = False
    for line in text.split("\n"):
        width = len(line) - len(line.lstrip(" "))
        fence = _FENCE.match(line) is not None
        item = None if fenced or fence else _item(line, width, items)
        if line.strip() and not fenced:
            after_gap = not out or not out[-1].strip()
            while items and width < items[-1] and (item or after_gap):
                items.pop()
        if item:
            if _ends_in_a_paragraph(out):
                out.append("")
            out.append(" " * 4 * len(items) + line.lstrip(" "))
            items.append(item)
        else:
            beyond = max(width - items[-1], 0) if items else width
            indented = " " * (4 * len(items) + beyond) + line.lstrip(" ")
            out.append(indented if line.strip() else "")
        fenced ^= fence
    return "\n".join(out)


def _item(line: str, width: int, items: list[int]) -> int | None:
    """The column of an item's text; None for another line, and for one in an indented block."""
    found = _ITEM.match(line)
    if found is None or width >= (items[-1] if items else 0) + 4:
        return None
    return found.end()


def _ends_in_a_paragraph(out: list[str]) -> bool:
    """Whether the last lines are a paragraph that is not the first one of a list's item."""
    block: list[str] = []
    for line in reversed(out):
        if not line.strip():
            break
        block.append(line)
    return bool(block) and not _ITEM.match(block[-1])
