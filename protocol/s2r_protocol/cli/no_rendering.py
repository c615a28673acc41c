"""MuJoCo without OpenGL, for commands that render nothing: it is loaded in two thirds of the time."""

from __future__ import annotations

import os


def without_rendering() -> None:
    """Keep MuJoCo, where it is loaded from now on in this process or its children, from loading OpenGL.

    What a user has set stays. Not for commands that start a tool of the user's own, which may render.
    """
    os.environ.setdefault("MUJOCO_GL", "disable")
