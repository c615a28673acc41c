"""What recordings are called where several files are called alike."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def distinct_names(paths: Sequence[Path]) -> dict[Path, str]:
    """By path the name of each file without its suffix, and as many folders before it as tell it from the others.

    Files that differ by their suffix alone keep it. A file that is there twice has one name.
    """
    files = {path: path.resolve() for path in paths}
    parts = {path: _parts(file, set(files.values())) for path, file in files.items()}
    return {path: _shortest(own, set(parts.values())) for path, own in parts.items()}


def _parts(file: Path, files: set[Path]) -> tuple[str, ...]:
    alike = [other for other in files if other.with_suffix("") == file.with_suffix("")]
    return file.parts if len(alike) > 1 else file.with_suffix("").parts


def _shortest(own: tuple[str, ...], others: set[tuple[str, ...]]) -> str:
    """The end of a path that no other path has."""
    for depth in range(1, len(own)):
        if all(other == own or other[-depth:] != own[-depth:] for other in others):
            return "/".join(own[-depth:])
    return "/".join(own)
