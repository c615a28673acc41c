"""A set while it is being drawn: its key is there from the beginning, and what is drawn of it is kept sealed.

A draw that was interrupted goes on with the same seed, and the cases it has finished are not simulated again. Until
all are there is no manifest, so that no tool is run over half a set. The truths that are kept lie in the set's folder
under the same seal as the answers; beside them, under that seal, are the hashes of their files, so that nobody can
exchange a recording between an interruption and the end.
"""

from __future__ import annotations

import os
import secrets
import shutil
from pathlib import Path
from typing import Any

from s2r_conceal.errors import DrawError, SealError
from s2r_conceal.seal import MANIFEST, SCHEMA, Key, hashes_of, open_sealed, seal

UNFINISHED = "unfinished"


def begin(out: Path, key_file: Path, seed: int | None, asked: dict[str, Any]) -> Key:
    """The key of a draw: a fresh one, now in its file, or that of the same draw, interrupted there before.

    Args:
        out: Folder of the set.
        key_file: Where the key is or goes.
        seed: None for a random one, or for that of the interrupted draw.
        asked: What else the set is drawn with, JSON values by name.

    Raises:
        DrawError: The folder holds something else, the key is that of a finished set, or the draw was begun otherwise.
        SealError: The key file is none.
    """
    begun = (out / UNFINISHED).is_dir()
    used = out.exists() and any(out.iterdir())
    if not key_file.exists():
        if begun:
            raise DrawError(
                f"a draw into {out} was interrupted, and there is no key file {key_file} to go on with: name it with "
                "--key, or draw into a new folder"
            )
        if used:
            raise DrawError(f"{out} is not empty; draw into a new folder")
        chosen = secrets.randbits(63) if seed is None else seed
        key = Key.fresh({"seed": chosen, **asked, "schema": SCHEMA}, unfinished=True)
        key.write(key_file)
    else:
        key = Key.read(key_file)
        if not key.unfinished:
            raise DrawError(
                f"{key_file} opens a set that is drawn; name another file with --key, or move that one away"
            )
        if used and not begun:
            raise DrawError(
                f"{out} holds something, and not the draw that {key_file} was begun for; name its folder"
            )
        if key.drawn_with.get("schema") != SCHEMA:
            raise DrawError(
                f"the draw into {out} was begun by another version, which draws other cases: draw into a new folder "
                "with another --key"
            )
        _refuse_other_options(out, key, asked if seed is None else {"seed": seed, **asked})
    (out / UNFINISHED).mkdir(parents=True, exist_ok=True)
    return key


def _refuse_other_options(out: Path, key: Key, asked: dict[str, Any]) -> None:
    for name, value in asked.items():
        before = key.drawn_with.get(name)
        if before != value:
            # Not the seed itself: it stands in the key file, and nowhere that a tool may read.
            what = "another seed" if name == "seed" else f"{name} {before!r}, not {value!r}"
            raise DrawError(
                f"the draw into {out} was begun with {what}: give the same options to go on, or draw into a new folder "
                "with another --key"
            )


def keep(out: Path, first: int, truths: dict[str, Any], key: Key) -> None:
    """Keep the truths of finished cases, numbered from ``first``, whose files are written."""
    kept = {"truths": truths, "files": {case: hashes_of(out / case) for case in truths}}
    path = _part(out, first)
    half = path.with_suffix(".half")
    half.write_bytes(seal(kept, key)[0])
    os.replace(half, path)


def kept(out: Path, first: int, key: Key) -> dict[str, Any] | None:
    """Truths of cases finished before, numbered from ``first``; None where they are to be drawn (again).

    Those whose files are no longer what was written are drawn again.
    """
    path = _part(out, first)
    if not path.is_file():
        return None
    try:
        content = open_sealed(path.read_bytes(), key)
    except SealError:  # cut off by a full disk, or somebody else's: only what the key vouches for counts
        return None
    if any(hashes_of(out / case) != files for case, files in content["files"].items()):
        return None
    return content["truths"]


def end(out: Path, key_file: Path, key: Key) -> None:
    """After the set was published: its key is that of a finished one, and what was kept goes."""
    assert (out / MANIFEST).is_file()
    key.finished().write(key_file)
    shutil.rmtree(out / UNFINISHED)


def _part(out: Path, first: int) -> Path:
    return out / UNFINISHED / f"from-{first:04d}.sealed"
