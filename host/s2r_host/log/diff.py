"""``s2r log diff``: two recordings of the same plans on one time base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.log.segments import Segment, inside, segments
from s2r_host.log.tables import Joints, Recording

GRID_S = 0.01
_SHORTER_S = 0.05  # five states of the executor: less may be missing at the end of a motion that is the same


@dataclass(frozen=True, eq=False)
class MotionDifference:
    """One motion that both recordings hold.

    Attributes:
        label: Of the plan.
        t: Time since the motion began [s], shape (n,).
        q_a, q_b: Measured positions [rad], shape (n, dof).
        duration_a_s, duration_b_s: Of the whole motions, with the rest behind them.
        reached_a_s, reached_b_s: How far each comes [s]: in the plan's own time, or both durations where one recording
            does not tell it. The rest is not in it: how long it is recorded is up to the plan that comes next.
    """

    label: str
    t: np.ndarray
    q_a: np.ndarray
    q_b: np.ndarray
    duration_a_s: float
    duration_b_s: float
    reached_a_s: float
    reached_b_s: float

    @property
    def one_is_shorter(self) -> bool:
        """Whether a part of the motion is in one recording only, so that nobody can say whether it is the same."""
        return abs(self.reached_a_s - self.reached_b_s) > _SHORTER_S

    @property
    def residual(self) -> np.ndarray:
        """b minus a [rad], shape (n, dof)."""
        return self.q_b - self.q_a

    @property
    def rms_rad(self) -> np.ndarray:
        """Per joint, shape (dof,)."""
        return np.sqrt((self.residual**2).mean(axis=0))

    @property
    def worst(self) -> tuple[int, float, float]:
        """Joint index, time [s] and residual [rad] where the two differ most."""
        row, joint = np.unravel_index(np.abs(self.residual).argmax(), self.residual.shape)
        return int(joint), float(self.t[row]), float(self.residual[row, joint])


@dataclass(frozen=True, eq=False)
class Difference:
    """Two recordings, compared. ``facts`` are named values that differ, ``only_a``/``only_b`` unmatched motions."""

    joint_names: tuple[str, ...]
    motions: list[MotionDifference]
    only_a: list[str]
    only_b: list[str]
    facts: dict[str, tuple[str, str]]

    def exceeds(self, tolerance_rad: float) -> bool:
        """Whether the recordings differ by more than a tolerance, or do not hold the same motions to the same end."""
        return bool(self.only_a or self.only_b) or any(
            motion.one_is_shorter or abs(motion.worst[2]) > tolerance_rad for motion in self.motions
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "motions": [
                {
                    "label": m.label,
                    "duration_a_s": m.duration_a_s,
                    "duration_b_s": m.duration_b_s,
                    "reached_a_s": m.reached_a_s,
                    "reached_b_s": m.reached_b_s,
                    "rms_rad": dict(zip(self.joint_names, m.rms_rad.tolist(), strict=True)),
                    "worst": {
                        "joint": self.joint_names[m.worst[0]],
                        "t_s": m.worst[1],
                        "residual_rad": m.worst[2],
                    },
                }
                for m in self.motions
            ],
            "only_a": self.only_a,
            "only_b": self.only_b,
            "facts": {name: list(pair) for name, pair in self.facts.items()},
        }


def diff(a: Recording, b: Recording) -> Difference:
    """Compare motion by motion: same label, in order of time; without executor states, file by file.

    Raises:
        RecordingError: One has no joint states, or the arms differ.
    """
    joints_a, joints_b = a.joints(), b.joints()
    if joints_a.names != joints_b.names:
        raise RecordingError(
            f"{a.path} is of joints {', '.join(joints_a.names)}, {b.path} of {', '.join(joints_b.names)}"
        )
    pairs, only_a, only_b = _pair(_motions(a, joints_a), _motions(b, joints_b))
    motions = [_compare(joints_a, joints_b, one, other) for one, other in pairs]
    return Difference(joints_a.names, motions, only_a, only_b, _facts(a, b))


def _motions(recording: Recording, joints: Joints) -> list[Segment]:
    found = segments(recording)
    return found or [Segment(0, "whole", int(joints.stamp_ns[0]), int(joints.stamp_ns[-1]))]


def _pair(
    of_a: list[Segment], of_b: list[Segment]
) -> tuple[list[tuple[Segment, Segment]], list[str], list[str]]:
    if len(of_a) == len(of_b) == 1:  # two plan files: whatever they are called
        return [(of_a[0], of_b[0])], [], []
    left, pairs, only_a = list(of_b), [], []
    for one in of_a:
        match = next((other for other in left if other.label == one.label), None)
        if match is None:
            only_a.append(one.label)
        else:
            left.remove(match)
            pairs.append((one, match))
    return pairs, only_a, [segment.label for segment in left]


def _compare(joints_a: Joints, joints_b: Joints, one: Segment, other: Segment) -> MotionDifference:
    t_a, q_a = _part(joints_a, one)
    t_b, q_b = _part(joints_b, other)
    t = np.arange(0.0, min(t_a[-1], t_b[-1]) + 1e-9, GRID_S)
    durations = float(t_a[-1]), float(t_b[-1])
    reached = durations
    if one.reached_s is not None and other.reached_s is not None:
        reached = one.reached_s, other.reached_s
    return MotionDifference(one.label, t, _at(t, t_a, q_a), _at(t, t_b, q_b), *durations, *reached)


def _part(joints: Joints, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    keep = inside(joints.stamp_ns, segment)
    if not keep.any():
        raise RecordingError(f"no joint states during '{segment.label}'")
    return (joints.stamp_ns[keep] - segment.begin_ns) * 1e-9, joints.q[keep]


def _at(t: np.ndarray, t_have: np.ndarray, q: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, t_have, column) for column in q.T])


def _facts(a: Recording, b: Recording) -> dict[str, tuple[str, str]]:
    of_a, of_b = a.metadata.get("s2r", {}), b.metadata.get("s2r", {})
    keys = sorted((set(of_a) | set(of_b)) - {"config"})
    return {key: (of_a.get(key, "–"), of_b.get(key, "–")) for key in keys if of_a.get(key) != of_b.get(key)}
