"""Read the truth log and say what the object's joint really did. For the scorer, never for the host."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.errors import TruthFileError
from s2r_sim.objects.scene import joint_truth, table_scene
from s2r_sim.truth import CONTACT_COLUMNS
from s2r_sim.world import WorldSpec


@dataclass(frozen=True, eq=False)
class Truth:
    """A truth log; every array has shape (rows,) or (rows, dof).

    Attributes:
        t: Simulated time [s].
        master_tick: Executor's tick of the newest set-point; begins anew with another executor.
        s: True joint coordinate of the object [m or rad].
        q: True arm joints [rad].
        contact_part, contact_base, contact_table: Whether the arm touched these.
        part_force_N: Normal force of the arm on the moving part.
        others: True joint coordinates of other parts that move, (rows, parts).
    """

    t: np.ndarray
    master_tick: np.ndarray
    s: np.ndarray
    q: np.ndarray
    contact_part: np.ndarray
    contact_base: np.ndarray
    contact_table: np.ndarray
    part_force_N: np.ndarray
    others: np.ndarray

    def of_moved(self, since_tick: int) -> Truth:
        """The same log, of the part that has moved most since the executor's ``master_tick`` was ``since_tick``."""
        values = np.column_stack([self.s, self.others])
        row = self.row_at_tick(since_tick)
        part = int(np.abs(values[-1] - values[row]).argmax())
        return replace(self, s=values[:, part], others=np.delete(values, part, axis=1))

    def s_at(self, t: float) -> float:
        """True coordinate at simulated time ``t`` [s] (the newest row not after it)."""
        return float(self.s[max(int(np.searchsorted(self.t, t, side="right")) - 1, 0)])

    def s_at_tick(self, master_tick: int) -> float:
        """True coordinate when the executor's ``master_tick`` was in force; see :meth:`row_at_tick`."""
        return float(self.s[self.row_at_tick(master_tick)])

    def row_at_tick(self, master_tick: int) -> int:
        """The newest row not after an executor's ``master_tick``.

        Raises:
            TruthFileError: Several executors have moved this arm: each counts anew, so a tick tells no time.
        """
        if (np.diff(self.master_tick) < 0).any():
            raise TruthFileError(
                "the truth log tells of several executors, one after the other, and each counts its ticks anew: which "
                "of them a run's ticks are of is not known. Start a stand-in for each executor whose runs are judged"
            )
        return max(int(np.searchsorted(self.master_tick, master_tick, side="right")) - 1, 0)


@dataclass(frozen=True)
class FinalState:
    """True joint values in the host's coordinate: 0 = as found, + = out of the cabinet.

    Attributes:
        as_found: Raw coordinate at the start (a drawer is closed at 0); the offset of the others.
        before_plan: Just before the planned manipulation; None if its time was not given.
        final: At the end of the log.
    """

    as_found: float
    before_plan: float | None
    final: float

    def delta(self, s_target: float) -> float:
        """Remaining error to a target in the host's coordinate: target minus final."""
        return s_target - self.final

    def delta_r(self, s_target: float) -> float:
        """Remaining error relative to the distance that was asked for.

        Raises:
            ValueError: The state before the plan is not known, or is the target already.
        """
        if self.before_plan is None or s_target == self.before_plan:
            raise ValueError(f"relative error needs a start other than the target, got {self.before_plan}")
        return self.delta(s_target) / (s_target - self.before_plan)


def read_truth(truth_csv: Path) -> Truth:
    """Read a truth log; a half-written last row is left out.

    Raises:
        TruthFileError: It cannot be read or holds no row.
    """
    try:
        written = Path(truth_csv).read_text().splitlines(keepends=True)
    except (OSError, ValueError) as error:
        raise TruthFileError(f"truth log {truth_csv} cannot be read: {error}") from error
    # A last number that was cut short looks like another one: only what ends its line is whole.
    header, *rows = [line[:-1].split(",") for line in written if line.endswith("\n")] or [[]]
    if not rows or header[:3] != ["t_s", "master_tick", "object"] or not {*CONTACT_COLUMNS} <= {*header}:
        raise TruthFileError(
            f"truth log {truth_csv} holds no rows of truth; was the stand-in run with --truth?"
        )
    try:
        table = np.array(rows, dtype=float)
    except ValueError as error:
        raise TruthFileError(f"truth log {truth_csv} is damaged: {error}") from error
    contacts = header.index(CONTACT_COLUMNS[0])
    part, base, on_table, force = (table[:, header.index(name)] for name in CONTACT_COLUMNS)
    return Truth(
        t=table[:, 0],
        master_tick=table[:, 1].astype(np.int64),
        s=table[:, 2],
        q=table[:, 3:contacts],
        contact_part=part.astype(bool),
        contact_base=base.astype(bool),
        contact_table=on_table.astype(bool),
        part_force_N=force,
        others=table[:, contacts + len(CONTACT_COLUMNS) :],
    )


def true_joint(world: WorldSpec) -> tuple[np.ndarray, np.ndarray]:
    """(point on the axis [m], its direction) of the object's joint as found, base frame."""
    joint = joint_truth(table_scene(world.object).compile(), world.object)
    return np.array(joint.origin_m), np.array(joint.direction)


def sense(world: WorldSpec, run: dict[str, Any]) -> float:
    """1 if the joint of a ``run.json`` grows as the true one does, -1 if it is the other way round."""
    axis = np.array(run["joint"]["axis_direction"])
    return 1.0 if axis @ true_joint(world)[1] >= 0.0 else -1.0


def final_state(
    truth_csv: Path, t_before_plan: float | None = None, tick_before_plan: int | None = None
) -> FinalState:
    """True object joint value at the start, before the plan and at the end.

    Args:
        truth_csv: The stand-in's log.
        t_before_plan: Simulated time at which the planned manipulation began, or
        tick_before_plan: the executor's tick at that moment (as in its status).

    Raises:
        TruthFileError: The log cannot be read.
    """
    truth = read_truth(truth_csv)
    before = None
    if tick_before_plan is not None:
        before = truth.s_at_tick(tick_before_plan)
    elif t_before_plan is not None:
        before = truth.s_at(t_before_plan)
    found = float(truth.s[0])
    return FinalState(found, None if before is None else before - found, float(truth.s[-1]) - found)
