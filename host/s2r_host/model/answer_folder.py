"""What `s2r build-model` writes into a folder, and how an earlier answer there makes room.

Only what this command wrote is taken away: a folder of its own says so in its ``model.json``.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path

from s2r_protocol.cli.outputs import check_inputs_stay, check_own_results, has_key

MODELS = ("object.xml", "object.urdf")
PICTURES = ("view_before.png", "view_after.png", "cloud.png", "model.png")
ANSWER = "model.json"
KEYS = ("abstain", "joint_type", "parts_found")  # one of them is in every answer
_MESH = re.compile(r'filename="(meshes/[^/"]+\.obj)"')


def check_room(out: Path, inputs: Sequence[Path], several: bool) -> None:
    """Refuse a folder where an answer would replace somebody else's files, or what it is made from.

    Args:
        out: Where the answer goes.
        inputs: The views.
        several: Whether parts have folders of their own in there.

    Raises:
        UsageError: Names the files.
    """
    for folder in (out, *_part_folders(out)):
        check_inputs_stay(folder, (ANSWER, *MODELS, *PICTURES), inputs)
        if several or folder == out:
            check_own_results(folder, ANSWER, KEYS, (*MODELS, *PICTURES))


def forget(out: Path) -> None:
    """Take away what an earlier answer left: its model is no part of a new one, least of an abstention."""
    for folder in (out, *_part_folders(out)):
        if has_key(folder / ANSWER, KEYS):
            for name in (*_meshes(folder / "object.urdf"), *MODELS, *PICTURES, ANSWER):
                (folder / name).unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # there is none, or somebody else's files lie there, too
                (folder / "meshes").rmdir()


def _part_folders(out: Path) -> list[Path]:
    return [
        path for path in out.glob("part_*") if path.is_dir() and path.name.removeprefix("part_").isdecimal()
    ]


def _meshes(urdf: Path) -> list[str]:
    """The shapes that a model refers to; none where there is no model."""
    try:
        return _MESH.findall(urdf.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
