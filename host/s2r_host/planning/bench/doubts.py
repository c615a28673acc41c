"""What is in doubt about a benchmark's objects: the usual, or what the model builder typically leaves open."""

from __future__ import annotations

from s2r_host.model.belief import prior
from s2r_host.perception.intervals import Intervals
from s2r_host.planning.doubt import Doubt
from s2r_host.planning.doubt_files import doubt_from_estimate
from s2r_protocol.exits import UsageError

DOUBTS = ("usual", "built")
# Medians of the 90 % intervals of 138, 30 and 25 runs of `s2r demo` on hidden drawers, laptops and faucets.
_BUILT = {
    "drawer": Intervals(axis_angle_rad=0.020, axis_offset_m=0.0, delta=(-0.001, 0.001)),
    "laptop": Intervals(axis_angle_rad=0.041, axis_offset_m=0.008, delta=(-0.016, 0.016)),
    "faucet": Intervals(axis_angle_rad=0.107, axis_offset_m=0.008, delta=(-0.025, 0.025)),
}


def doubt_about(task: str, kind: str) -> Doubt:
    """The doubt about a task's object.

    Args:
        task: Name of the task; it begins with that of the object.
        kind: One of ``DOUBTS``.

    Raises:
        UsageError: Nothing is known of how well the builder finds such objects.
    """
    if kind == "usual":
        return Doubt()
    name = task.partition("_")[0]
    if name not in _BUILT:
        raise UsageError(f"--doubt {kind}: task {task!r} is none of {', '.join(_BUILT)}")
    return doubt_from_estimate(_BUILT[name], prior("prismatic" if name == "drawer" else "revolute"))
