"""The truth log: what really happened, written by the stand-in only, read by the scorer only.

CSV, one row per 10 ms of simulated time, the state at t = 0 first. ``object`` is the true joint coordinate (m or rad; a
drawer is closed at 0), ``master_tick`` the executor's tick of the newest set-point. Arm joints are those of the links,
from which encoders behind gears that give differ. Further columns, where there are any, are the joints of other parts
that move.
"""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

from s2r_sim.errors import TruthFileError
from s2r_sim.plant import Plant

ROW_NS = 10_000_000
CONTACT_COLUMNS = ("contact_part", "contact_base", "contact_table", "part_force_N")


class TruthLog:
    """Writes rows as an observer of the plant. The same commands give the same bytes."""

    def __init__(self, path: Path, plant: Plant) -> None:
        """Open the file and write the header and the first row.

        Raises:
            TruthFileError: The file cannot be written.
        """
        try:
            self._file: TextIO = path.open("w", buffering=1)
        except OSError as error:
            raise TruthFileError(f"truth log {path}: {error.strerror}") from error
        joints = plant.physics.arm.joint_names
        others = [f"other_{k}" for k in range(len(plant.physics.other_values))]
        self._file.write(
            ",".join(("t_s", "master_tick", "object", *joints, *CONTACT_COLUMNS, *others)) + "\n"
        )
        self._next_ns = plant.t_ns
        self(plant)

    def __call__(self, plant: Plant) -> None:
        """Write a row when one is due."""
        if plant.t_ns < self._next_ns:
            return
        self._next_ns += ROW_NS
        physics = plant.physics
        touch = physics.contacts()
        q = ",".join(f"{value:.9g}" for value in physics.q_link)
        self._file.write(
            f"{plant.t_ns * 1e-9:.3f},{plant.master_tick},{physics.object_value:.9g},{q},"
            f"{touch.part:d},{touch.base:d},{touch.table:d},{touch.part_force_N:.4g}"
            + "".join(f",{value:.9g}" for value in physics.other_values)
            + "\n"
        )

    def close(self) -> None:
        """Flush and close."""
        self._file.close()
