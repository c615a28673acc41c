"""What the coarse model's sensors say about contacts, and about the fingertip at its place."""

from __future__ import annotations

import functools

import numpy as np

from s2r_host.planning.hook import Hook

# The coarse model's sensors: tool pose (7), the robot's contacts (1), per finger contacts (1) and force (3).
POSITION, ORIENTATION, ROBOT_CONTACTS, FIRST_FINGER, PER_FINGER = slice(0, 3), slice(3, 7), 7, 8, 4
# What is made of them, a row each. The first eight are wanted at the ends of control steps.
_TOUCHES, _OTHERS = 0, 1
_PLACE, _COSINES = slice(2, 6), slice(6, 8)
_FORCE, _PUSH = slice(8, 11), slice(11, 14)
_FLAGS, _AT_ENDS, _ROWS = slice(0, 2), slice(0, 8), 14


class Readings:
    """Makes all that is linear in the sensors in one product, for one place of the fingertip.

    While rollouts run the processor's caches forget how numpy does things, so that an operation of a kind that comes
    first after them costs several times its arithmetic. What counts is how few kinds there are.
    """

    def __init__(
        self, sensors: int, substeps: int, R_world_part: np.ndarray, hook: Hook, *, prismatic: bool
    ) -> None:
        """Args: numbers in a row of sensors; substeps of a control step; the part at s = 0; place; slide or hinge."""
        self._substeps, self._hook, self._prismatic = substeps, hook, prismatic
        self._of_sensors = made = np.zeros((_ROWS, sensors))
        made[_OTHERS, ROBOT_CONTACTS] = 1.0
        made[_PLACE, POSITION] = hook.axes
        made[_COSINES, ORIENTATION] = hook.grips_wxyz
        for finger in range(FIRST_FINGER, sensors, PER_FINGER):
            made[_TOUCHES, finger], made[_OTHERS, finger] = 1.0, -1.0
            # The force of all finger shapes together, in the part's frame at s = 0.
            made[_FORCE, finger + 1 : finger + PER_FINGER] = R_world_part.T
        made[_PUSH] = hook.push_as_part_moves.T @ made[_FORCE]
        self._origin = (hook.axes @ hook.p_part)[:, None, None]

    def of(self, sensors: np.ndarray, s: np.ndarray) -> dict[str, np.ndarray]:
        """The fields of ``StepFacts`` that sensors tell, by name, (rollout, step) each.

        Args:
            sensors: Rows of every substep, (rollout, substep, number). They describe the state before it.
            s: The object's joint after every substep [m or rad], (rollout, substep).
        """
        made = np.empty((_ROWS, *s.shape))
        # A product per rollout: one over all is large enough for OpenBLAS to start threads, which go on spinning
        # beside the rollouts and take half of their speed.
        np.matmul(self._of_sensors, sensors.swapaxes(1, 2), out=made.swapaxes(0, 1))
        ends = self._at_ends(made[_AT_ENDS])
        within = ends[_FLAGS]
        for k in range(1, self._substeps):
            np.maximum(within, made[_FLAGS, :, k :: self._substeps], out=within)
        touches, collides = within > 0.0
        return {
            "distance_m": self._hook.distance_along(ends[_PLACE] - self._origin),
            "turn_rad": self._hook.turn(ends[_COSINES], self._at_ends(s)),
            "touches": touches,
            "collides": collides,
            "press_N": self._press(made[_FORCE], made[_PUSH], s),
        }

    def _at_ends(self, lagging: np.ndarray) -> np.ndarray:
        """Of values per substep, (..., substep), those where the next control step begins, (..., step).

        After the last control step there is none; there it is the last substep.
        """
        found = np.empty((*lagging.shape[:-1], lagging.shape[-1] // self._substeps))
        found[..., :-1], found[..., -1] = lagging[..., self._substeps :: self._substeps], lagging[..., -1]
        return found

    def _press(self, force_N: np.ndarray, push_N: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Largest force of the fingertip across the part's motion within a control step [N], (rollout, step).

        Args:
            force_N: On the part, (3, rollout, substep).
            push_N: Times (1, cos s, sin s) the part of it that pushes, (3, rollout, substep); the first on a slide.
            s: The object's joint, (rollout, substep).
        """
        ahead = push_N[0]
        if not self._prismatic:
            ahead = ahead + np.cos(s) * push_N[1] + np.sin(s) * push_N[2]
        x, y, z = force_N**2
        across = x + y + z - ahead**2
        most = functools.reduce(np.maximum, (across[:, k :: self._substeps] for k in range(self._substeps)))
        return np.sqrt(np.maximum(most, 0.0))
