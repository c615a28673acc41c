"""Whether a simulation is still one: MuJoCo begins an unstable world anew from its zero pose, and counts a warning.

A stand-in that went on would write that pose down as the truth: a drawer closed that nobody pushed.
"""

from __future__ import annotations

import mujoco

from s2r_sim.errors import UnstableError

FASTEST = 1e3  # all joints together [rad/s and m/s]; nothing here moves at a tenth of that
_FASTEST_SQUARED = FASTEST**2
_QPOS, _QVEL, _QACC = (
    int(warning)
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
    )
)


class StabilityWatch:
    """Looks at a world's state after every step."""

    def __init__(self, data: mujoco.MjData) -> None:
        self._counts, self._dq = data.warning.number, data.qvel  # views: every millisecond passes here

    def check(self) -> None:
        """Whether what MuJoCo made of the newest step can be.

        Raises:
            UnstableError: A position, speed or acceleration is no number, or beyond anything real.
        """
        # MuJoCo itself warns beyond 1e10 only. A speed that is no number is not less than anything.
        counts, dq = self._counts, self._dq
        if counts[_QACC] or counts[_QVEL] or counts[_QPOS] or not dq.dot(dq) < _FASTEST_SQUARED:
            raise UnstableError(
                "the simulation of this world became unstable, and nothing after that would be true: a gear, spring "
                "or damper of it is too stiff for steps of 1 ms, or a mass too small for what acts on it; change the "
                "world file"
            )
