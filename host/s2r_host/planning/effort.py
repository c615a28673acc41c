"""What moving a part takes of the arm, by statics: before anything is simulated.

The part resists with gravity, springs and the friction of its joint. Over the lever of the place that is a force, and
over the arm's Jacobian there a torque in every joint. Of places and postures that would do, those are better that need
less: the executor takes a large torque for a collision, and a slightly heavier part needs more.
"""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.planning.execution import FineWorld
from s2r_host.planning.kinematics import ToolKinematics
from s2r_host.planning.scene import Scene

_SPEED_M_S = 0.1  # of the fingertip with the part, which damping resists; the time law's
_LEAST_LEVER_M = 0.02


class Resistance:
    """How a part resists to being moved to a number of states, with everything else where it is."""

    def __init__(self, scene: Scene, world: FineWorld, states: list[float], sign: float) -> None:
        """Args: scene; world; the joint's values [m or rad]; ``sign`` of the motion."""
        self._scene, self._sign = scene, sign
        model, dof = scene.fine, scene.s_dof
        self._friction, self._damping = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
        self._static: list[float] = []
        self._axes: list[np.ndarray] = []
        self._anchors: list[np.ndarray] = []
        data = mujoco.MjData(model)
        data.qpos[:] = world.data.qpos
        for s in states:
            data.qpos[scene.s_qpos] = s
            mujoco.mj_forward(model, data)
            against = data.qfrc_bias[dof] - data.qfrc_passive[dof] - data.qfrc_actuator[dof]
            self._static.append(sign * float(against))
            self._axes.append(data.xaxis[scene.joint_id].copy())
            self._anchors.append(data.xanchor[scene.joint_id].copy())

    def force(self, state: int, p_world: np.ndarray) -> np.ndarray:
        """Force [N] along the motion that moves the part at points (n, 3) in one of the states, (n, 3).

        Zero where the part goes by itself and wants to be held.
        """
        axis, anchor = self._axes[state], self._anchors[state]
        if self._scene.prismatic:
            way, lever = np.tile(axis, (len(p_world), 1)), np.ones(len(p_world))
        else:
            sweep = np.cross(axis, p_world - anchor)
            lever = np.maximum(np.linalg.norm(sweep, axis=1), _LEAST_LEVER_M)
            way = sweep / lever[:, None]
        load = self._static[state] + self._friction + self._damping * _SPEED_M_S / lever
        return self._sign * (np.maximum(load, 0.0) / lever)[:, None] * way


def efforts(
    tool: ToolKinematics, resistance: Resistance, route: np.ndarray, tau_max: np.ndarray
) -> np.ndarray:
    """Largest joint torque over its limit along routes (states, n, dof), one posture per state, (n,)."""
    worst = np.zeros(route.shape[1])
    for state, q in enumerate(route):
        p, jacobian = tool.tips(q)
        share = np.abs(np.einsum("nij,ni->nj", jacobian, resistance.force(state, p))) / tau_max
        worst = np.maximum(worst, share.max(axis=1, initial=0.0))
    return worst
