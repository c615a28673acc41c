"""What rows of sensors become: compared with a loop over substeps that takes them one number at a time."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from s2r_host.planning.hook import Hook
from s2r_host.planning.readings import Readings

RNG = np.random.default_rng(0)
ROLLOUTS, STEPS, FINGERS = 5, 4, 3
HINGE = np.array([2.0, -1.0, 2.0]) / 3.0
R_WORLD_PART = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
PLACE = Hook(
    p_part=np.array([0.1, 0.2, 0.3]),
    R_part_tool=np.eye(3),
    push_part=np.array([0.01, 0.02, -0.005]),
    q=np.zeros(7),
    route=np.zeros((4, 7)),
    approach=np.zeros((0, 7)),
    axis_part=HINGE,
    s_start=0.2,
    follow=0.5,
)
SLIDE = replace(PLACE, axis_part=np.zeros(3), follow=1.0)


def measured(substeps: int) -> tuple[np.ndarray, np.ndarray]:
    """Sensors (rollout, substep, number) with contacts now and then, and joint values (rollout, substep)."""
    shape = ROLLOUTS, STEPS * substeps
    sensors = RNG.normal(size=(*shape, 8 + 4 * FINGERS))
    sensors[..., 3:7] /= np.linalg.norm(sensors[..., 3:7], axis=-1, keepdims=True)
    counts = RNG.integers(0, 2, size=(*shape, FINGERS)) * (RNG.random(shape) < 0.3)[..., None]
    sensors[..., 8::4] = counts
    for k in range(3):
        sensors[..., 9 + k :: 4] *= 20.0 * counts
    sensors[..., 7] = counts.sum(axis=-1) + (RNG.random(shape) < 0.1)
    return sensors, RNG.normal(size=shape)


def press_N(row: np.ndarray, s: float, hook: Hook) -> float:
    """Size of the force across the push, where the part has turned by s about the hook's axis."""
    ahead, turned = hook.push_part / np.linalg.norm(hook.push_part), np.empty(3)
    quat_wxyz = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat_wxyz, hook.axis_part, s if hook.axis_part.any() else 0.0)
    mujoco.mju_rotVecQuat(turned, ahead, quat_wxyz)
    force = R_WORLD_PART.T @ row[8:].reshape(FINGERS, 4)[:, 1:].sum(axis=0)
    return float(np.linalg.norm(force - (force @ turned) * turned))


@pytest.mark.parametrize("substeps", [1, 2, 5])
@pytest.mark.parametrize("hook", [PLACE, SLIDE])
def test_readings_are_those_of_every_row_on_its_own(substeps, hook):
    sensors, s = measured(substeps)
    prismatic = hook is SLIDE
    found = Readings(sensors.shape[2], substeps, R_WORLD_PART, hook, prismatic=prismatic).of(sensors, s)
    last = s.shape[1] - 1
    for rollout in range(ROLLOUTS):
        for step in range(STEPS):
            # The sensors lag: what follows a control step's substep is what they say about it.
            seen = [min(step * substeps + k, last) for k in range(1, substeps + 1)]
            own = [step * substeps + k for k in range(substeps)]
            rows, end = sensors[rollout], seen[-1]
            touching = [rows[k, 8::4].sum() for k in seen]
            at = rollout, step
            assert found["touches"][at] == any(count > 0 for count in touching)
            assert found["collides"][at] == any(rows[k, 7] > n for k, n in zip(seen, touching, strict=True))
            assert found["distance_m"][at] == pytest.approx(float(hook.distance(rows[end, :3])))
            turn_rad = float(hook.turn(hook.grips_wxyz @ rows[end, 3:7], s[rollout, end]))
            assert found["turn_rad"][at] == pytest.approx(turn_rad)
            expected = max(press_N(rows[k], s[rollout, k], hook) for k in own)
            assert found["press_N"][at] == pytest.approx(expected, abs=1e-6)
