"""A place for the fingertip at a part, with the arm's way there and on with the part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from s2r_host import _native
from s2r_host.planning.hand_probe import quat_of

# Height over a place beside it, and how fast that falls towards the place.
FUNNEL_M, _FUNNEL_SLOPE = 0.05, 5.0
TOUCH_WAYPOINT = 2  # row of a hook's route at which the fingertip meets the part


@dataclass(frozen=True, eq=False)
class Hook:
    """A place for the fingertip.

    Attributes:
        p_part: Tool tip in the part's frame [m], (3,).
        R_part_tool: Orientation of the tool there in the part's frame, (3, 3).
        push_part: From there to where the fingertip meets the part, along the part's motion, part frame [m], (3,).
        q: Joint solution there [rad], (dof,).
        route: Joint solutions above the place, at the place, at the touch, and on with the part to the target,
            (m, dof) [rad]. Only a proposal for the sampler.
        approach: Postures on a free way from the start posture to above the place, (k, dof) [rad]; none if the
            straight line there is free.
        axis_part: Axis of a hinge in the part's frame, (3,); zero for a slide.
        s_start: The object's joint at the place.
        follow: Share of a hinge's turn that the tool makes with it.
    """

    p_part: np.ndarray
    R_part_tool: np.ndarray
    push_part: np.ndarray
    q: np.ndarray
    route: np.ndarray
    approach: np.ndarray
    axis_part: np.ndarray
    s_start: float
    follow: float

    @cached_property
    def axes(self) -> np.ndarray:
        """Directions in the part's frame, (4, 3): the push; out along the tool; beside that in their plane; across."""
        ahead, away = self.push_part / np.linalg.norm(self.push_part), -self.R_part_tool[:, 2]
        beside, across = np.linalg.qr(np.column_stack([away, ahead]), mode="complete")[0][:, 1:].T
        return np.stack([ahead, away, beside, across])

    @cached_property
    def push_as_part_moves(self) -> np.ndarray:
        """Times (1, cos s, sin s) where the push points with the part at s, in the part's frame at s = 0, (3, 3)."""
        ahead, axis = self.axes[0], self.axis_part
        still = (ahead @ axis) * axis if axis.any() else ahead
        return np.column_stack([still, ahead - still, np.cross(axis, ahead)])

    @cached_property
    def place(self) -> _native.Place:
        """The same place as rollouts are judged by."""
        grip, turned = quat_of(self.R_part_tool), np.empty(4)
        mujoco.mju_mulQuat(turned, np.concatenate([[0.0], self.axis_part]), grip)
        return _native.Place(
            p=self.p_part.tolist(),
            push_m=float(np.linalg.norm(self.push_part)),
            axes=self.axes.tolist(),
            push_along=self.push_as_part_moves.T.tolist(),
            grips=[grip.tolist(), turned.tolist()],
            s_start=self.s_start,
            follow=self.follow,
            funnel_m=FUNNEL_M,
            funnel_slope=_FUNNEL_SLOPE,
        )

    @property
    def whole_route(self) -> np.ndarray:
        """Approach and route, (k + m, dof) [rad]."""
        return np.concatenate([self.approach, self.route])

    @property
    def touch_row(self) -> int:
        """Row of the whole route at which the fingertip meets the part."""
        return len(self.approach) + TOUCH_WAYPOINT

    def distance(self, p_tip_part: np.ndarray) -> np.ndarray:
        """Distance [m] that the reward sees, for tool tips in the part's frame (n, 3), (n,); see ``place.hpp``."""
        return self.place.distances(p_tip_part)
