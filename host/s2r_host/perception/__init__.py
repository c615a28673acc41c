"""Perception: depth views in, the one joint that moved between them out.

Start at `estimate.estimate_joint`, or at `several.estimate_joints` if more than one part moved; `loading.load_frame`
reads files.
"""

from typing import TYPE_CHECKING

from s2r_host.late_names import late_names

if TYPE_CHECKING:
    from s2r_host.perception.errors import AbstainError, BadViewError, InputError
    from s2r_host.perception.estimate import JointEstimate, estimate_joint
    from s2r_host.perception.frames import Cloud, DepthFrame
    from s2r_host.perception.loading import load_frame
    from s2r_host.perception.motion import JointMotion
    from s2r_host.perception.several import estimate_joints
else:
    __getattr__ = late_names(
        __name__,
        errors=("AbstainError", "BadViewError", "InputError"),
        estimate=("JointEstimate", "estimate_joint"),
        frames=("Cloud", "DepthFrame"),
        loading=("load_frame",),
        motion=("JointMotion",),
        several=("estimate_joints",),
    )

__all__ = [
    "AbstainError",
    "BadViewError",
    "Cloud",
    "DepthFrame",
    "InputError",
    "JointEstimate",
    "JointMotion",
    "estimate_joint",
    "estimate_joints",
    "load_frame",
]
