"""Where a page's picture lies: beside it and called as it is, so that two pages in one folder have two pictures."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote


def picture_of(page: Path) -> Path:
    """Of ``results.md`` it is ``results.png``."""
    return page.with_suffix(".png")


def picture_link(text: str, page: Path) -> str:
    """The Markdown that shows it."""
    return f"![{text}]({quote(picture_of(page).name)})"
