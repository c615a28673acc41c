"""Time laws: from joint paths to trajectories the executor admits."""

from s2r_host.trajectory.deliver import Delivery, deliver, plan_trajectory
from s2r_host.trajectory.time_law import TimeLawSettings, time_law
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError
from s2r_host.trajectory.verify import Replay, replay

__all__ = [
    "Delivery",
    "Replay",
    "TimeLawSettings",
    "Trajectory",
    "TrajectoryError",
    "deliver",
    "plan_trajectory",
    "replay",
    "time_law",
]
