"""What cannot be compared where a command jumps: the effort jumps with it, between two rows of the log.

When it did so is known to half a row, and the motion that follows is smoothed once more than the effort is.
"""

from __future__ import annotations

import numpy as np

from s2r_host.gap.motion.session import Session

LEAST_SHARE = 0.1  # of all the positions commanded: from there on a change from row to row may be a step
LEAST_TIMES = 20.0  # the usual change from row to row where there is one
SMOOTHED = 0.03  # of the jump: how far differently smoothed channels part
BEFORE_AND_AFTER = 1.0  # periods of the comparison's cut that a jump reaches


def step_doubt(s: Session, joint: int, name: str) -> np.ndarray:
    """Effort that the steps of the commanded position leave open around them, else zero, shape (time,) [N·m or N].

    Args:
        s: A recording.
        joint, name: Of the joint.
    """
    doubt = np.zeros(len(s.t))
    asked = s.rec.get("q_cmd", name)
    effort = s.rec.get("tau", name)
    if asked is None or effort is None or len(asked) < 3:
        return doubt
    change = np.abs(np.diff(asked))
    moving = change[change > 0.0]
    usual = float(np.median(moving)) if len(moving) > 0.1 * len(change) else 0.0
    steps = np.flatnonzero((change > LEAST_SHARE * np.ptp(asked)) & (change > LEAST_TIMES * usual))
    share = SMOOTHED + 0.5 * s.rec.dt * float(s.cut[joint])
    reach = BEFORE_AND_AFTER / max(float(s.cut[joint]), 1e-9)
    for k in steps:
        near = effort[max(k - 1, 0) : k + 3]
        rows = np.abs(s.t - 0.5 * (s.rec.t[k] + s.rec.t[k + 1])) < reach
        doubt[rows] = np.maximum(doubt[rows], share * float(np.ptp(near)))
    return doubt
