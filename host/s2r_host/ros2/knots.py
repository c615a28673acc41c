"""A JointTrajectory as knots the executor plays: what each way of filling the message means, and what is refused.

A point may hold positions only, positions and velocities, or all three; all points of a message hold the same
(trajectory_msgs/JointTrajectoryPoint leaves the rest to the receiver). Between the points the arm then follows

- positions only: the quintic spline through all points that is at rest at both ends, four times differentiable;
- with velocities: quintics whose accelerations at inner points are the mean of both neighbouring cubics';
- with accelerations: exactly what was sent.

Whether the result may be moved is decided by the executor's admission, as for every plan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from s2r_host.errors import HostError
from s2r_protocol.exits import RefusedError

START_TOLERANCE_RAD = 5e-3
STALE_S = 1.0
_KINDS = ("positions", "velocities", "accelerations")


class RosTrajectoryError(HostError, RefusedError):
    """A JointTrajectory that cannot be turned into a plan; the text names the point, the value and the limit."""


@dataclass(frozen=True, eq=False)
class Knots:
    """A timed path with quintic segments: times ``t`` (n,) [s] from 0; ``q``, ``dq``, ``ddq`` (n, dof) [rad, s]."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


def plan_of(
    message: Mapping[str, Any], joint_names: Sequence[str], q_hold: np.ndarray, now_s: float
) -> Knots:
    """Knots of a message.

    Args:
        message: Unpacked ``trajectory_msgs/msg/JointTrajectory`` with at least one point.
        joint_names: Of the arm; the message may name them in any order.
        q_hold: The reference the arm holds [rad], shape (dof,): where every motion begins.
        now_s: Unix time [s], against which a stamp is judged.

    Raises:
        RosTrajectoryError: Wrong joints, sizes, times, numbers, start or stamp.
    """
    _check_stamp(message["header"]["stamp"], now_s)
    order = _order(message["joint_names"], joint_names)
    points = message["points"]
    t = np.array([_seconds(point["time_from_start"]) for point in points])
    q, dq, ddq = (_column(points, kind, order, joint_names) for kind in _KINDS)
    if q is None:
        raise RosTrajectoryError("point 0 has no positions; effort or velocity alone is not executed")
    if ddq is not None and dq is None:
        raise RosTrajectoryError("the points carry accelerations without velocities; send both, or neither")
    if any(len(point["effort"]) for point in points):
        raise RosTrajectoryError(
            "the points carry effort; this executor follows positions, leave effort empty"
        )
    _check_times(t)
    return _knots(*_from_hold(t, q, dq, ddq, q_hold, joint_names))


def _check_stamp(stamp: Mapping[str, int], now_s: float) -> None:
    begin_s = _seconds(stamp)
    if begin_s == 0.0:  # "now", says trajectory_msgs
        return
    if begin_s > now_s:
        raise RosTrajectoryError(
            f"header.stamp lies {begin_s - now_s:.3f} s ahead; waiting is not offered: send stamp 0 when it shall begin"
        )
    if now_s - begin_s > STALE_S:
        raise RosTrajectoryError(
            f"header.stamp is {now_s - begin_s:.3f} s old, limit {STALE_S:g} s; send it anew"
        )


def _order(sent: Sequence[str], ours: Sequence[str]) -> list[int]:
    """Column of the message for each joint of the arm."""
    if sorted(sent) != sorted(ours):
        missing, unknown = sorted(set(ours) - set(sent)), sorted(set(sent) - set(ours))
        parts = [f"missing {', '.join(missing)}"] if missing else []
        parts += [f"unknown {', '.join(unknown)}"] if unknown else []
        twice = sorted({name for name in sent if list(sent).count(name) > 1})
        parts += [f"{', '.join(twice)} more than once"] if twice else []
        what = "; ".join(parts)
        raise RosTrajectoryError(f"joint names do not match the arm: {what}; it has {', '.join(ours)}")
    return [list(sent).index(name) for name in ours]


def _column(
    points: Sequence[Mapping[str, Any]], kind: str, order: list[int], names: Sequence[str]
) -> np.ndarray | None:
    """One kind of all points in the arm's order, (n, dof); None if no point has it."""
    sizes = [len(point[kind]) for point in points]
    if not any(sizes):
        return None
    for i, size in enumerate(sizes):
        if size != len(order):
            raise RosTrajectoryError(
                f"point {i} has {size} {kind}, expected {len(order)}: all points hold the same or none"
            )
    values = np.array([np.asarray(point[kind], float)[order] for point in points])
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        i, j = bad[0]
        raise RosTrajectoryError(f"joint '{names[j]}': {kind} of point {i} is {values[i, j]}")
    return values


def _check_times(t: np.ndarray) -> None:
    if t[0] < 0.0:
        raise RosTrajectoryError(f"point 0 lies at {t[0]:g} s; time_from_start begins at 0 or later")
    steps = np.diff(t)
    if (steps <= 0.0).any():
        i = int(np.argmax(steps <= 0.0))
        raise RosTrajectoryError(
            f"time_from_start does not rise: point {i} at {t[i]:g} s, point {i + 1} at {t[i + 1]:g} s"
        )
    if len(t) == 1 and t[0] == 0.0:
        raise RosTrajectoryError("the only point lies at 0 s; give it the time the motion shall take")


def _from_hold(
    t: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray | None,
    ddq: np.ndarray | None,
    q_hold: np.ndarray,
    names: Sequence[str],
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Put the held reference first: in place of a point at 0 s, or before the first one."""
    if t[0] == 0.0:
        off = np.abs(q[0] - q_hold)
        j = int(np.argmax(off))
        if off[j] > START_TOLERANCE_RAD:
            raise RosTrajectoryError(
                f"joint '{names[j]}': point 0 at 0 s is {q[0, j]:.4f} rad, the arm holds {q_hold[j]:.4f} rad; they may "
                f"differ by {START_TOLERANCE_RAD:g} rad. Plan from the arm's own state, or begin later than 0 s"
            )
        for kind, values in (("velocities", dq), ("accelerations", ddq)):
            if values is not None and np.abs(values[0]).max() > 0.0:
                raise RosTrajectoryError(f"point 0 at 0 s has {kind}; the arm begins at rest")
        return t, np.vstack([q_hold, q[1:]]), dq, ddq
    rest = np.zeros((1, q.shape[1]))
    return (
        np.concatenate([[0.0], t]),
        np.vstack([q_hold, q]),
        None if dq is None else np.vstack([rest, dq]),
        None if ddq is None else np.vstack([rest, ddq]),
    )


def _knots(t: np.ndarray, q: np.ndarray, dq: np.ndarray | None, ddq: np.ndarray | None) -> Knots:
    if dq is None:
        return _spline(t, q)
    return Knots(t, q, dq, _mean_accelerations(t, q, dq) if ddq is None else ddq)


def _spline(t: np.ndarray, q: np.ndarray) -> Knots:
    rest = [(1, np.zeros(q.shape[1])), (2, np.zeros(q.shape[1]))]
    spline = make_interp_spline(t, q, k=5, bc_type=(rest, rest))
    dq, ddq = spline(t, 1), spline(t, 2)
    dq[[0, -1]] = ddq[[0, -1]] = 0.0  # rounding of the boundary conditions
    return Knots(t, q, dq, ddq)


def _mean_accelerations(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """At inner points the mean of the cubic Hermite segments' accelerations on both sides, 0 at both ends."""
    T = np.diff(t)[:, None]
    slope = np.diff(q, axis=0) / T
    at_start = (6 * slope - 4 * dq[:-1] - 2 * dq[1:]) / T
    at_end = (-6 * slope + 2 * dq[:-1] + 4 * dq[1:]) / T
    ddq = np.zeros_like(q)
    ddq[1:-1] = 0.5 * (at_end[:-1] + at_start[1:])
    return ddq


def _seconds(time: Mapping[str, int]) -> float:
    return int(time["sec"]) + 1e-9 * int(time["nanosec"])
