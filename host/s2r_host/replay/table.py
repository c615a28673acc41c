"""A trajectory from a table: ``t`` [s] and ``q.<joint>`` [rad], as ``plan.csv`` of ``s2r plan`` has them.

``dq.<joint>`` and ``ddq.<joint>`` are taken where they are there (``knots.csv``). Otherwise they are the differences
of the positions; admission judges what comes of it.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.trajectory import Trajectory
from s2r_protocol.arms import ArmDescription

KNOT_S = 0.02  # closer rows are left out: differences of rounded positions would be all noise
_KINDS = ("q", "dq", "ddq")


def read_table(path: Path, arm: ArmDescription) -> Trajectory:
    """The knots of a table, from rest to rest, its columns brought into the arm's order by name.

    Raises:
        RecordingError: Columns of other joints, fewer than two rows, or values that are no finite numbers or times
            that do not rise; the text names the line.
    """
    header, rows = _read(path)
    # Each kind is of no use without those before it, and would be taken for one of them.
    last = max(
        (k for k, kind in enumerate(_KINDS) if any(n.startswith(f"{kind}.") for n in header)), default=0
    )
    kinds = _KINDS[: last + 1]
    wanted = ["t", *(f"{kind}.{joint}" for kind in kinds for joint in arm.joint_names)]
    missing = [name for name in wanted if name not in header]
    if missing:
        raise RecordingError(
            f"{path} has no column {', '.join(missing)}; a trajectory of {arm.name} has t [s] and "
            f"{', '.join(f'q.{joint}' for joint in arm.joint_names)} [rad]"
        )
    values = rows[:, [header.index(name) for name in wanted]]
    t, (q, *rest) = values[:, 0] - values[0, 0], np.split(values[:, 1:], len(kinds), axis=1)
    fallen = np.flatnonzero(np.diff(t) <= 0)
    if len(fallen):
        raise RecordingError(f"{path}, line {fallen[0] + 3}: t does not rise from the line before")
    dq = rest[0] if rest else np.gradient(q, t, axis=0)
    ddq = rest[1] if len(rest) > 1 else np.gradient(dq, t, axis=0)
    picks = np.arange(len(t)) if len(rest) > 1 else _thinned(t)
    knots = Trajectory(t[picks], q[picks], dq[picks].copy(), ddq[picks].copy())
    knots.dq[[0, -1]] = knots.ddq[[0, -1]] = 0.0  # a plan starts and ends at rest
    return knots


def _read(path: Path) -> tuple[list[str], np.ndarray]:
    """Header and values of a comma-separated file."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *lines = [[cell.strip() for cell in line] for line in csv.reader(file) if line] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path} cannot be read as a table: {error}") from error
    if len(lines) < 2:
        raise RecordingError(f"{path} has {len(lines)} rows below its header, needs at least 2")
    for number, line in enumerate(lines, start=2):
        try:
            if len(line) != len(header) or not np.isfinite([float(cell) for cell in line]).all():
                raise ValueError
        except ValueError:
            raise RecordingError(
                f"{path}, line {number}: needs {len(header)} finite numbers, as the header has columns"
            ) from None
    return header, np.array(lines, dtype=float)


def _thinned(t: np.ndarray) -> np.ndarray:
    """Rows about ``KNOT_S`` apart or more, the first and the last among them."""
    step = max(1, round(KNOT_S / float(np.median(np.diff(t)))))
    picks = np.arange(0, len(t) - 1, step)
    near = t[-1] - t[picks] < 0.5 * KNOT_S  # a short last segment would have to be fast
    near[0] = False
    return np.append(picks[~near], len(t) - 1)
