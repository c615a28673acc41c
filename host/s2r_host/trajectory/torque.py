"""Joint torques of a motion by inverse dynamics, and how much slower it must be to stay within the limits."""

from __future__ import annotations

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports]  # an extension module without stubs

from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError
from s2r_protocol.arms import ArmDescription

STANDARD_GRAVITY = np.array([0.0, 0.0, -9.81])  # in the base frame of an upright arm [m/s²]
LOOK_STEP_S = 0.01  # as often as the executor's admission looks at torques (``admission.sample_step_s``)


class InverseDynamics:
    """Recursive Newton-Euler for one arm with its tool, without payload. Not for several threads."""

    def __init__(self, arm: ArmDescription, gravity: np.ndarray | None = None) -> None:
        """Args: the arm, whose URDF is read; ``gravity`` in its base frame [m/s²], (3,), None: upright on earth."""
        self._model = pin.buildModelFromXML(arm.urdf)
        if gravity is not None:
            self._model.gravity.linear = np.asarray(gravity, dtype=float)
        self._data = self._model.createData()
        self._tool = self._model.getFrameId(arm.tool_frame, pin.FrameType.BODY)

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torques [N·m], (dof,), for position, velocity and acceleration, (dof,) each."""
        return pin.rnea(self._model, self._data, np.asarray(q), np.asarray(dq), np.asarray(ddq)).copy()

    def tool_positions(self, q: np.ndarray) -> np.ndarray:
        """Fingertip in the base frame [m], (n, 3), at joint positions (n, dof)."""
        positions = []
        for row in q:
            pin.forwardKinematics(self._model, self._data, row)
            positions.append(pin.updateFramePlacement(self._model, self._data, self._tool).translation.copy())
        return np.array(positions)

    def tool_jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian of the fingertip's position in the base frame at joint positions (dof,), (3, dof) [m/rad]."""
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return pin.computeFrameJacobian(self._model, self._data, np.asarray(q), self._tool, frame)[:3].copy()

    def point_jacobian(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Motion of a point (3,) [m] of the tool and turn of the tool per unit of each joint, base frame, (6, dof)."""
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(self._model, self._data, np.asarray(q), self._tool, frame)
        x, y, z = p - self._data.oMf[self._tool].translation
        at = J[:3] - np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ J[3:]
        return np.concatenate([at, J[3:]])

    @property
    def link_masses(self) -> np.ndarray:
        """Mass that each joint carries before the next one [kg], (dof,)."""
        return np.array([inertia.mass for inertia in self._model.inertias[1:]])

    def regressor(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Derivatives of the torques by the inertial parameters of all links at many states, (n, dof, 10 dof)."""
        return np.array(
            [
                pin.computeJointTorqueRegressor(self._model, self._data, *state).copy()
                for state in zip(q, dq, ddq, strict=True)
            ]
        )

    def along(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torques at many states, (n, dof)."""
        return np.array([self(*state) for state in zip(q, dq, ddq, strict=True)])


def torque_stretch(
    trajectory: Trajectory, arm: ArmDescription, dynamics: InverseDynamics, share: float
) -> float:
    """Factor, at least 1, by which the trajectory must be slowed to need no more than a share of the torque limits.

    Slowing divides everything but gravity by the factor's square. Checked at the knots, midway between them, and as
    often between those as the executor does.

    Raises:
        TrajectoryError: Gravity alone exceeds the share somewhere; no speed helps.
    """
    factor = 1.0
    # Slowed down there are more places to look at, and one of them may need a trifle more.
    while (more := _stretch_at(trajectory.stretched(factor), arm, dynamics, share)) > 1.0:
        factor *= more * (1.0 + 1e-9)  # the limit itself must not be exceeded by a rounding error
    return factor


def _stretch_at(
    trajectory: Trajectory, arm: ArmDescription, dynamics: InverseDynamics, share: float
) -> float:
    """The factor for the places that are looked at as fast as the trajectory is now; up to 1 for none."""
    times = _looked_at(trajectory.t)
    q, dq, ddq = trajectory.sample(times)
    still = np.zeros_like(q)
    gravity = dynamics.along(q, still, still)
    motion = dynamics.along(q, dq, ddq) - gravity
    limit = share * arm.limits.tau_max
    room = limit - np.sign(motion) * gravity
    if (np.abs(gravity) > limit).any() or (room <= 0.0).any():
        at, joint = np.unravel_index(int((np.abs(gravity) / limit).argmax()), gravity.shape)
        raise TrajectoryError(
            f"joint {arm.joint_names[joint]!r} (index {joint}): holding the arm at {times[at]:.2f} s takes "
            f"{abs(gravity[at, joint]):.1f} N·m, more than {share:.0%} of {arm.limits.tau_max[joint]:.1f} N·m"
        )
    return float(np.sqrt((np.abs(motion) / room).max()))


def _looked_at(t: np.ndarray) -> np.ndarray:
    """Knots, and even times between them no more than ``LOOK_STEP_S`` apart, at least the middle."""
    pieces = np.maximum(2, np.ceil(np.diff(t) / LOOK_STEP_S - 1e-6).astype(int))
    between = [a + (b - a) * np.arange(n) / n for a, b, n in zip(t[:-1], t[1:], pieces, strict=True)]
    return np.append(np.concatenate(between), t[-1])
