"""Time laws: from joint paths to trajectories the executor admits."""
