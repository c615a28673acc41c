"""The way to a plan's start: along what was recorded before it where that leads there, else a checked move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.replay.sources import Replayable

JOINED_RAD = 5e-3
"""Ends that differ by less than this belong together; a short checked move closes the rest [rad]."""


def recorded_way(
    plans: Sequence[Replayable], plan: Replayable, q_now: np.ndarray, *, whole: bool = False
) -> list[Replayable]:
    """The recorded plans that lead from ``q_now`` to the start of ``plan``, in the order to send them.

    A replay does not know the object, but the recording's own way was free of it once. Only plans that ran count.

    Args:
        plans: All of the source, in the order they ran.
        plan: The one to replay.
        q_now: Where the arm stands [rad], shape (dof,).
        whole: The longest such way: in a world as the recording found it, it brings the object to where the plan
            met it. Otherwise the shortest, since in any other world earlier plans have moved the object already.

    Returns:
        Empty when the arm stands at the start, or when no unbroken row of recorded plans begins where it stands.
    """
    start = plan.trajectory.q[0]
    if not whole and joined(q_now, start):
        return []
    row: list[Replayable] = []
    found: list[Replayable] = []
    for earlier in reversed([p for p in plans if p.number < plan.number]):
        if earlier.first is None or not joined(earlier.trajectory.q[-1], start):
            break
        row.insert(0, earlier)
        start = earlier.trajectory.q[0]
        if joined(q_now, start):
            found = list(row)
            if not whole:
                break
    return found


def missing_of(
    plans: Sequence[Replayable], plan: Replayable, way: Sequence[Replayable]
) -> tuple[Replayable, ...]:
    """The plans that ran before ``plan`` and are no part of the way to it: a stop or a spliced motion broke the row."""
    sent = {one.number for one in way}
    return tuple(p for p in plans if p.number < plan.number and p.first is not None and p.number not in sent)


def joined(q: np.ndarray, other: np.ndarray) -> bool:
    """Whether two postures (dof,) [rad] belong together."""
    return bool(np.abs(np.asarray(q) - other).max() < JOINED_RAD)
