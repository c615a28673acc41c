"""A run against its twin: the recorded references fed to the nominal arm model, compared with what was measured."""

from __future__ import annotations

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.log.diff import GRID_S, Difference, MotionDifference
from s2r_host.log.segments import inside, segments
from s2r_host.log.tables import Recording
from s2r_host.twin import STEP_S, Twin
from s2r_protocol.arms import ArmDescription


def twin_difference(recording: Recording, arm: ArmDescription) -> Difference:
    """Twin minus measured, per executed plan.

    Raises:
        RecordingError: No executed plan with references in it.
    """
    measured, reference = recording.joints(), recording.joints("joint_commands")
    if measured.names != arm.joint_names:
        raise RecordingError(f"{recording.path} is of joints {', '.join(measured.names)}, not of {arm.name}")
    motions = []
    for segment in segments(recording):
        keep = inside(reference.stamp_ns, segment)
        if keep.sum() < 2:
            continue
        t_have = (reference.stamp_ns[keep] - segment.begin_ns) * 1e-9
        t_fine = np.arange(0.0, t_have[-1] + STEP_S, STEP_S)
        q_ref = _at(t_fine, t_have, reference.q[keep])
        dq_ref = _at(t_fine, t_have, reference.dq[keep])
        twin = Twin(arm)
        q_twin = np.array([twin.follow(t, q, dq) for t, q, dq in zip(t_fine, q_ref, dq_ref, strict=True)])
        t = np.arange(0.0, t_have[-1] + 1e-9, GRID_S)
        t_measured = (measured.stamp_ns - segment.begin_ns) * 1e-9
        q = _at(t, t_measured, measured.q)
        durations = [float(t_have[-1])] * 4  # the twin does all that was recorded
        motions.append(MotionDifference(segment.label, t, q, _at(t, t_fine, q_twin), *durations))
    if not motions:
        raise RecordingError(f"{recording.path} holds no executed plan with references")
    return Difference(measured.names, motions, [], [], {})


def _at(t: np.ndarray, t_have: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, t_have, column) for column in values.T])
