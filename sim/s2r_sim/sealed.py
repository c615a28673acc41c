"""Where a world and its truth log lie while the host is at work: out of its sight, until nobody is left to look."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from s2r_sim.world import WorldSpec

WORLD, TRUTH = "world.json", "truth.csv"


@contextmanager
def sealed(world: WorldSpec, folder: Path) -> Iterator[Path]:
    """A folder with the world, for it and the truth log, away from the trial's own while the block goes on.

    At its end, when no process of the trial is left, both are put into the trial's folder: they are opened there.
    """
    with tempfile.TemporaryDirectory(prefix="s2r-sealed-") as name:
        hidden = Path(name)
        world.save(hidden / WORLD)
        try:
            yield hidden
        finally:
            for file in (WORLD, TRUTH):
                if (hidden / file).exists():  # no truth log of a stand-in that did not start
                    shutil.move(hidden / file, folder / file)
