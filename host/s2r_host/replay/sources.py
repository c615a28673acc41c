"""Where plans to replay come from: a run, an executor's recording, or anybody's recording or table of a trajectory.

Whatever the file says goes through the same admission as any plan; here it is only read and brought into knots.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.log.recording_file import recording_file
from s2r_host.log.segments import inside, notes, segments
from s2r_host.log.tables import EXECUTOR_STATE, TRAJECTORY, Recording, read_recording
from s2r_host.recording import JointTrack, during_plan
from s2r_host.replay.table import KNOT_S, read_table
from s2r_host.trajectory import TimeLawSettings, Trajectory, time_law
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import UsageError
from s2r_protocol.ros2 import nanoseconds

DEFAULT_LABEL = "manipulation"
SESSION = "session-"
MOST_NAMED = 5
_WAYPOINT_SPEED = 0.3


@dataclass(frozen=True, eq=False)
class Replayable:
    """A plan to replay.

    Attributes:
        number: Counts the plans of the source from 1.
        label: E.g. "push 1".
        trajectory: Knots.
        first: Its first execution, None when the source holds none.
        cut_s: Plan time at which a stop broke off the motion that the knots are read from; what follows is the
            executor's braking. None: the knots are a plan.
    """

    number: int
    label: str
    trajectory: Trajectory
    first: JointTrack | None
    cut_s: float | None = None


def read_source(path: Path, arm: ArmDescription) -> list[Replayable]:
    """All plans of a recording or of a run's or plan's folder; the one of a table (``.csv``).

    Raises:
        RecordingError: It holds none, or of another arm.
        UsageError: The folder is neither a run's nor a plan's.
    """
    if path.suffix.lower() == ".csv":
        return [Replayable(1, path.stem, read_table(path, arm), None)]
    file = recording_file(path)
    recording = read_recording(file)
    if recording.damage.any:
        raise RecordingError(
            f"{file} is damaged ({recording.damage.reason}); mend it with: s2r log recover {shlex.quote(str(file))}"
        )
    topics = recording.of_type(TRAJECTORY)
    if topics:
        found = _from_trajectories(recording, arm)
    else:
        found = _from_references(recording, arm)
    if not found:
        raise RecordingError(f"{file} holds no plan; {_where_plans_are(file)}")
    return found


def _where_plans_are(file: Path) -> str:
    """What to do about a recording without plans."""
    if not file.name.startswith(SESSION):
        return "was the run stopped before the first motion?"
    beside = sorted(file.parent.glob("plan-*.mcap"))
    if not beside:
        return "an executor's session never does: it keeps each plan in a plan-….mcap, and beside it there is none"
    names = ", ".join(one.name for one in beside[:MOST_NAMED])
    more = f" and {len(beside) - MOST_NAMED} more" if len(beside) > MOST_NAMED else ""
    return f"an executor's session never does, its plans are beside it: {names}{more}; name one of them"


def pick(plans: list[Replayable], number: int | None, who: Path) -> Replayable:
    """A plan by its number; by default the first planned manipulation, else the last plan.

    Raises:
        UsageError: There is no such number.
    """
    if number is None:
        named = [plan for plan in plans if plan.label.startswith(DEFAULT_LABEL)]
        return named[0] if named else plans[-1]
    for plan in plans:
        if plan.number == number:
            return plan
    known = ", ".join(f"{plan.number} ({plan.label})" for plan in plans)
    raise UsageError(f"--plan {number}: {who} has no such plan; it has {known}")


def _from_trajectories(recording: Recording, arm: ArmDescription) -> list[Replayable]:
    """A run's plans with what its notes say about them; a foreign file has no notes."""
    known = [note for note in notes(recording) if note["kind"] == "plan"]
    tracks = _Tracks(recording)
    found = []
    for topic in recording.of_type(TRAJECTORY):
        for body in recording.bodies(topic):
            number = len(found) + 1
            note = known[number - 1] if number <= len(known) else None
            label = note["label"] if note is not None else body["header"]["frame_id"]
            first = tracks.of(int(note["seq"])) if note is not None else None
            trajectory = trajectory_of_message(body, arm)
            found.append(Replayable(number, label or f"trajectory {number}", trajectory, first))
    return found


class _Tracks:
    """Measured joints of each executed plan; the file is decoded once, not once per plan."""

    def __init__(self, recording: Recording) -> None:
        states: dict[int, list[tuple[int, float]]] = {}
        for topic in recording.of_type(EXECUTOR_STATE):
            for body in recording.bodies(topic):
                seen = nanoseconds(body["header"]["stamp"]), float(body["plan_t"])
                states.setdefault(int(body["plan_seq"]), []).append(seen)
        self._states = {seq: sorted(seen) for seq, seen in states.items()}
        self._joints = recording.joints() if states else None

    def of(self, seq: int) -> JointTrack | None:
        """None when that plan never ran."""
        joints, during = self._joints, self._states.get(seq)
        if joints is None or during is None:
            return None
        return during_plan(joints.stamp_ns, joints.q, joints.dq, during)


def _from_references(recording: Recording, arm: ArmDescription) -> list[Replayable]:
    """The executor's own recordings: knots from the references it played."""
    joints = recording.joints("joint_commands")
    order = _order(joints.names, arm)
    tracks = _Tracks(recording)
    found = []
    for number, segment in enumerate(segments(recording), start=1):
        keep = np.nonzero(inside(joints.stamp_ns, segment))[0]
        if not len(keep):  # the commands end before the states do
            continue
        t_all = (joints.stamp_ns[keep] - joints.stamp_ns[keep[0]]) * 1e-9
        moving = np.nonzero(np.abs(joints.dq[keep]).max(axis=1) > 0)[0]
        if len(moving) < 2:
            continue
        end_s = float(t_all[min(int(moving[-1]) + 1, len(t_all) - 1)])
        t = np.arange(0.0, end_s + KNOT_S, KNOT_S)
        q = _sampled(t, t_all, joints.q[keep][:, order])
        dq = _sampled(t, t_all, joints.dq[keep][:, order])
        dq[0] = dq[-1] = 0.0
        ddq = np.gradient(dq, t, axis=0)
        ddq[0] = ddq[-1] = 0.0
        first = tracks.of(segment.seq)
        cut = segment.cut_ns
        cut_s = None if cut is None else max(0.0, (cut - int(joints.stamp_ns[keep[0]])) * 1e-9)
        found.append(Replayable(number, segment.label, Trajectory(t, q, dq, ddq), first, cut_s))
    return found


def _sampled(t: np.ndarray, t_have: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, t_have, column) for column in values.T])


def _order(names: tuple[str, ...] | list[str], arm: ArmDescription) -> list[int]:
    if sorted(names) != sorted(arm.joint_names):
        raise RecordingError(
            f"the trajectory is of joints {', '.join(names)}; {arm.name} has {', '.join(arm.joint_names)}"
        )
    return [list(names).index(name) for name in arm.joint_names]


def trajectory_of_message(body: Mapping[str, Any], arm: ArmDescription) -> Trajectory:
    """A ``trajectory_msgs/JointTrajectory`` as knots, joints brought into the arm's order by name.

    Without any velocities the positions are way-points and get a time law of ours. Without any accelerations these are
    the differences of the velocities; admission judges what comes of it.

    Raises:
        RecordingError: Other joints, fewer than two points, arrays that do not fit, or numbers that are not finite.
        TrajectoryError: Way-points that cannot be timed.
    """
    order = _order(body["joint_names"], arm)
    points = body["points"]
    if len(points) < 2:
        raise RecordingError(f"the trajectory has {len(points)} points, needs at least 2")
    q, dq, ddq = (_column(points, kind, order, arm) for kind in ("positions", "velocities", "accelerations"))
    if q is None:
        raise RecordingError("the trajectory's points have no positions")
    if dq is None:
        return time_law(q, arm, TimeLawSettings(speed=_WAYPOINT_SPEED))
    stamps = [p["time_from_start"] for p in points]
    t = np.array([s["sec"] + 1e-9 * s["nanosec"] for s in stamps], float)
    if (np.diff(t) <= 0).any():
        raise RecordingError(
            "the trajectory's times do not rise; time_from_start must grow from point to point"
        )
    if ddq is None:
        ddq = np.gradient(dq, t, axis=0)
        ddq[0] = ddq[-1] = 0.0
    return Trajectory(t - t[0], q, dq, ddq)


def _column(
    points: Sequence[Mapping[str, Any]], kind: str, order: list[int], arm: ArmDescription
) -> np.ndarray | None:
    """One kind of all points in the arm's order, (n, dof); None if no point has it."""
    rows = [np.asarray(point[kind], float) for point in points]
    if not any(len(row) for row in rows):
        return None
    bad = next((i for i, row in enumerate(rows) if len(row) != arm.dof), None)
    if bad is not None:
        raise RecordingError(f"point {bad} has {len(rows[bad])} {kind}, {arm.name} has {arm.dof} joints")
    values = np.array(rows)[:, order]
    for i, j in np.argwhere(~np.isfinite(values)):
        raise RecordingError(
            f"point {i}, joint {arm.joint_names[j]!r}: {kind} = {values[i, j]} is no finite number"
        )
    return values
