"""Which arm a recording is of: from its own metadata, with the shipped descriptions as a library; and its joints."""

from __future__ import annotations

from s2r_host.errors import RecordingError
from s2r_host.log.tables import Joints, Recording
from s2r_protocol.arms import ArmDescription, load_arm, shipped_arms


def arm_of(recording: Recording, name: str | None = None) -> ArmDescription:
    """The arm of a recording.

    Args:
        recording: Its metadata names the arm; an older one is recognised by its joint names.
        name: A shipped arm or a folder with an arm.yaml, which wins.

    Raises:
        RecordingError: The arm is not known here.
    """
    if name is not None:
        return load_arm(name)
    facts = recording.metadata.get("s2r", {})
    for shipped in shipped_arms():
        arm = load_arm(shipped)
        if facts.get("arm") == shipped or (
            "arm" not in facts and recording.joints().names == arm.joint_names
        ):
            return arm
    raise RecordingError(
        f"{recording.path} is of the arm {facts.get('arm', 'without a name')!r}, which is not one of "
        f"{', '.join(shipped_arms())}; give its folder with --arm DIR"
    )


def in_arms_order(joints: Joints, arm: ArmDescription, recording: Recording) -> Joints:
    """Joint states of the arm alone, in its order: others record them in theirs, with those of a gripper among them.

    Raises:
        RecordingError: They are of other joints.
    """
    if not set(arm.joint_names) <= set(joints.names):
        raise RecordingError(
            f"{recording.path} is of joints {', '.join(joints.names)}; {arm.name} has {', '.join(arm.joint_names)}"
        )
    order = [joints.names.index(name) for name in arm.joint_names]
    tau = None if joints.tau is None else joints.tau[:, order]
    return Joints(arm.joint_names, joints.stamp_ns, joints.q[:, order], joints.dq[:, order], tau)
