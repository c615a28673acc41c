"""Friction by load, where the load is what passes the gear: a rotor's own inertia is not carried by its teeth."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse

ROTOR, DAMPING, FRICTION, COEFFICIENT = 0.55, 4.0, 1.8, 0.18
MASS, ARM, INERTIA = 3.2, 0.23, 0.055
MODEL = f"""<mujoco><worldbody><body name="forearm">
<joint name="elbow" axis="0 1 0" armature="{ROTOR}" damping="{DAMPING}" frictionloss="{FRICTION}"/>
<inertial mass="{MASS}" pos="0 0 {-ARM}" diaginertia="{INERTIA} {INERTIA} 0.002"/></body></worldbody></mujoco>"""
KP, KD, STEP_S, TICK, EVERY, SECONDS = 900.0, 45.0, 0.0002, 5, 20, 16.0
LINK = INERTIA + MASS * ARM**2


def record(folder, name, motion, seed, *, bearings_behind):
    """A servo whose friction follows the torque in its gear, behind its bearings or with them."""
    rng = np.random.default_rng(motion)
    f, phase = rng.uniform(0.1, 0.9, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    t = np.arange(round(SECONDS / STEP_S / TICK)) * STEP_S * TICK
    wave = 2.0 * np.pi * f[:, None] * t + phase[:, None]
    commands = np.sum(0.5 / np.sqrt(1 + 4 * f)[:, None] * np.sin(wave), axis=0)
    speeds = np.gradient(commands, t)
    q, v, carried = float(commands[0]), float(speeds[0]), 0.0
    rows = []
    for i, now in enumerate(t):
        u = KP * (commands[i] - q) + KD * (speeds[i] - v)
        if i * TICK % EVERY == 0:
            rows.append((now, q, v, u, commands[i], speeds[i]))
        for _ in range(TICK):
            weight = MASS * 9.81 * ARM * np.sin(q)
            free = v + STEP_S / (ROTOR + LINK) * (u - DAMPING * v - weight)
            dry = STEP_S / (ROTOR + LINK) * (FRICTION + COEFFICIENT * abs(carried))
            after = free - min(max(free, -dry), dry)
            carried = LINK * (after - v) / STEP_S + weight + (0.0 if bearings_behind else DAMPING * v)
            v = after
            q += STEP_S * v
    table, noise = np.array(rows), np.random.default_rng(seed).standard_normal((3, len(rows)))
    for column, level in zip((1, 2, 3), (1e-5, 0.001, 0.1), strict=True):
        table[:, column] += level * noise[column - 1]
    path = folder / f"{name}.csv"
    columns = "t,q.elbow,dq.elbow,tau.elbow,q_cmd.elbow,dq_cmd.elbow"
    np.savetxt(path, table, delimiter=",", header=columns, comments="", fmt="%.7g")
    law = f"{{type: pd, kp: {{elbow: {KP}}}, kd: {{elbow: {KD}}}, rate_hz: 1000}}"
    path.with_suffix(".yaml").write_text(f"controller: {law}\neffort: measured\nsession: one\n")
    return path


@pytest.mark.parametrize("bearings_behind", [False, True])
def test_a_rotor_is_no_load_of_its_gear(tmp_path, bearings_behind):
    (tmp_path / "model.xml").write_text(MODEL)
    files = [
        record(tmp_path, name, motion, seed, bearings_behind=bearings_behind)
        for name, motion, seed in (("fit", 1, 3), ("again", 1, 4), ("held", 2, 5))
    ]
    quick = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
    found = analyse(tmp_path / "model.xml", files[:1], files[2:], files[1:2], quick, lambda _: None)
    assert found.decision is not None
    assert [e.name for e in found.decision.effects] == ["load_dependent_friction"]
    low, high = found.decision.effects[0].parameters["coefficient"]["interval90"]
    assert low < COEFFICIENT < high
