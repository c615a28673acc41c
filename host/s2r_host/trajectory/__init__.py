"""Time laws: from joint paths to trajectories the executor admits."""

from s2r_host.trajectory.bridge import point_to_point
from s2r_host.trajectory.time_law import TimeLawSettings, time_law
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["TimeLawSettings", "Trajectory", "TrajectoryError", "point_to_point", "time_law"]
