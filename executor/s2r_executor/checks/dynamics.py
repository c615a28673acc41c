"""Joint torques of a plan by inverse dynamics (recursive Newton-Euler), with payload and margin."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from s2r_executor.plan import CommandRefusedError
from s2r_executor.quintic import Samples
from s2r_protocol.arms import ArmDescription
from s2r_protocol.faults import Refusal

_AT_ONCE = 4096
"""States per call: Pinocchio lets no other thread run meanwhile, and beats and heartbeats must come through."""


class InverseDynamics:
    """Rigid-body torques of one arm; a payload is a point mass fixed in the tool frame.

    Not thread-safe: one instance per admission worker.
    """

    def __init__(self, arm: ArmDescription) -> None:
        self._bare = pin.buildModelFromXML(arm.urdf)
        self._bare.gravity.linear = np.array([0.0, 0.0, -9.81])
        self._tool = self._bare.getFrameId(arm.tool_frame, pin.FrameType.BODY)
        self._payload = (0.0, (0.0, 0.0, 0.0))
        self._pool = pin.ModelPool(self._bare, 1)

    def carry(self, mass_kg: float, com_m: tuple[float, float, float]) -> None:
        """Use this payload from now on; ``com_m`` is in the tool frame."""
        if (mass_kg, com_m) == self._payload:
            return
        self._payload = (mass_kg, com_m)
        model = self._bare.copy()
        if mass_kg > 0:
            frame = model.frames[self._tool]
            load = pin.Inertia(mass_kg, np.array(com_m), np.zeros((3, 3)))
            model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + frame.placement.act(load)
        self._pool = pin.ModelPool(model, 1)

    def torque(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torques [N·m] for states of shape (m, dof)."""
        tau = np.empty_like(q)
        for first in range(0, len(q), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            columns = (np.asfortranarray(x[part].T) for x in (q, dq, ddq))
            tau[part] = pin.rneaInParallel(1, self._pool, *columns).T
        return tau


def check_torque(
    samples: Samples, tau: np.ndarray, tau_max: np.ndarray, margin: float, joint_names: tuple[str, ...]
) -> float:
    """Refuse the worst torque above ``(1 - margin) * tau_max``.

    Args:
        samples: Where the torques were computed.
        tau: [N·m], shape (m, dof).
        tau_max: [N·m], shape (dof,).
        margin: Share kept for what the rigid model does not know.
        joint_names: For the text.

    Returns:
        Largest share of the torque limit in use.
    """
    limit = (1 - margin) * tau_max
    share = np.abs(tau) / limit
    k, j = np.unravel_index(int(np.argmax(share)), share.shape)
    if not share[k, j] <= 1.0:
        raise CommandRefusedError(
            Refusal.TORQUE,
            f"joint '{joint_names[j]}' (index {j}): torque {tau[k, j]:.4g} N·m at {samples.t[k]:.3f} s exceeds "
            f"{limit[j]:.4g} N·m ({tau_max[j]:g} N·m less {margin:.0%} margin); give the motion more time, carry less, "
            "or plan with the arm less far out",
            joint=joint_names[j],
            t=float(samples.t[k]),
            quantity="torque",
            value=float(tau[k, j]),
            limit=float(limit[j]),
        )
    return float(np.max(np.abs(tau) / tau_max))
