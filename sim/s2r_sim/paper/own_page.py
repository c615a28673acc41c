"""Where a benchmark's page may go: where none is, or one that the same command wrote (docs/conventions.md)."""

from __future__ import annotations

from pathlib import Path

from s2r_protocol.cli.outputs import check_place
from s2r_protocol.exits import UsageError
from s2r_sim.paper.picture import picture_of


def check_page(page: Path, command: str) -> None:
    """Refuse a place where the page, or the picture beside it, would replace what is not this command's.

    Told before the work. The page's folder is made if missing.

    Args:
        page: Where it is to be written.
        command: As the page says that it was "Written by", without options.

    Raises:
        UsageError: Something else lies there, or no file can be there.
    """
    if not _is_own(page, command):
        for path in (page, picture_of(page)):
            if path.exists():
                raise UsageError(
                    f"{path} exists and would be replaced, and no page of '{command}' is there; name another --page, "
                    "or move it away"
                )
    try:
        page.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"--page {page}: its folder cannot be made ({error.strerror}); name another --page"
        ) from error
    check_place(page)


def _is_own(page: Path, command: str) -> bool:
    try:
        lines = page.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return False
    return any(line.startswith(f"Written by `{command} ") for line in lines)
