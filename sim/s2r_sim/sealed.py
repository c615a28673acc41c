"""What the host is not told of its trial: where world and truth log lie, and by which number the world was drawn.

Kind and number are all of a world but its salt. The host imports nothing that could draw one; its arguments show that
it was not told which, either.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from s2r_sim.errors import StandInError
from s2r_sim.world import WorldSpec

WORLD, TRUTH = "world.json", "truth.csv"


def host_seed(number: int) -> int:
    """The host's ``--seed`` in the trial of a number: the same one each time, and not to be read back from it."""
    return int.from_bytes(hashlib.sha256(f"host of trial {number}".encode()).digest()[:4])


@contextmanager
def sealed(world: WorldSpec, folder: Path) -> Iterator[Path]:
    """As :func:`out_of_sight`, with the world in it."""
    with out_of_sight(folder) as hidden:
        world.save(hidden / WORLD)
        yield hidden


@contextmanager
def out_of_sight(folder: Path) -> Iterator[Path]:
    """A folder for the world and the truth log, away from the trial's own while the block goes on.

    At its end, when no process of the trial is left, both are put into the trial's folder: they are opened there.

    Raises:
        StandInError: No folder for temporary files takes one.
    """
    with _temporary("s2r-sealed-") as hidden:
        try:
            yield hidden
        finally:
            for file in (WORLD, TRUTH):
                if (hidden / file).exists():  # no truth log of a stand-in that did not start
                    shutil.move(hidden / file, folder / file)


@contextmanager
def nameless(folder: Path) -> Iterator[Path]:
    """The trial's folder by a path that does not name the trial, while the block goes on."""
    with _temporary("s2r-trial-") as place:
        link = place / "trial"
        link.symlink_to(folder.resolve(), target_is_directory=True)
        yield link


@contextmanager
def _temporary(prefix: str) -> Iterator[Path]:
    try:
        made = tempfile.TemporaryDirectory(prefix=prefix)
    except FileNotFoundError as error:  # as Python says that it could write to none of them
        raise StandInError(
            f"{error.strerror}: nothing can be written there; make room, raise the limit of this shell (ulimit -f), or "
            "name another place with TMPDIR"
        ) from error
    with made as name:
        yield Path(name)
