"""Recordings against the user's model: clocks aligned, motion and effort on one grid, the control law seen through."""
