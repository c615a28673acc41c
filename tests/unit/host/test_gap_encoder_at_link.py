"""A spring or play whose encoder sits behind it: what is recorded is the link, and the motor is nowhere in the log."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.two_masses import Gear
from s2r_host.gap.pipeline import analyse

MOTOR, LINK, DAMPING, FRICTION = 0.25, 0.38, 0.12, 0.35
MODEL = f"""<mujoco><worldbody><body name="plate">
<joint name="table" axis="0 0 1" armature="{MOTOR}" damping="{DAMPING}" frictionloss="{FRICTION}"/>
<inertial mass="9" pos="0 0 0" diaginertia="0.2 0.2 {LINK}"/></body></worldbody></mujoco>"""
KP, KD = 12.0, 2.5
STEP_S, TICK, EVERY, SECONDS = 0.0001, 10, 40, 16.0
LAW = f"{{type: pd, kp: {{table: {KP}}}, kd: {{table: {KD}}}, rate_hz: 1000}}"


def simulated(motion, gear):
    """A servo that reads the link: t, link, its speed, effort, commands; a row every 4 ms."""
    rng = np.random.default_rng(motion)
    f, phase = rng.uniform(0.1, 1.6, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    t = np.arange(round(SECONDS / STEP_S / TICK)) * STEP_S * TICK
    wave = 2.0 * np.pi * f[:, None] * t + phase[:, None]
    asked = np.sum(0.9 / np.sqrt(1 + 4 * f)[:, None] * np.sin(wave), axis=0)
    asked_speed = np.gradient(asked, t)
    q = link = float(asked[0])
    v = rate = float(asked_speed[0])
    rows = []
    dry = STEP_S / MOTOR * FRICTION
    for i, now in enumerate(t):
        u = KP * (asked[i] - link) + KD * (asked_speed[i] - rate)
        if i * TICK % EVERY == 0:
            rows.append((now, link, rate, u, asked[i], asked_speed[i]))
        for _ in range(TICK):
            windup = q - link
            over = windup - min(max(windup, -gear.gap), gear.gap)
            through = gear.stiffness * over + (gear.damping * (v - rate) if over else 0.0)
            free = v + STEP_S / MOTOR * (u - DAMPING * v - through)
            v = free - min(max(free, -dry), dry)
            rate += STEP_S / LINK * through
            q += STEP_S * v
            link += STEP_S * rate
    return np.array(rows)


def record(folder, name, rows, seed, *, law=LAW):
    """A log with the steps of an encoder and noise of speed and effort."""
    noise = np.random.default_rng(seed).standard_normal((2, len(rows)))
    rows = rows.copy()
    rows[:, 1] = np.round(rows[:, 1] / 1e-4) * 1e-4
    rows[:, 2] += 0.002 * noise[0]
    rows[:, 3] += 0.02 * noise[1]
    columns = "t,q.table,dq.table,tau.table,q_cmd.table,dq_cmd.table"
    path = folder / f"{name}.csv"
    np.savetxt(path, rows, delimiter=",", header=columns, comments="", fmt="%.7g")
    path.with_suffix(".yaml").write_text(f"controller: {law}\neffort: measured\nsession: one\n")
    return path


def asked(folder, gear, *, simulate, law=LAW):
    (folder / "model.xml").write_text(MODEL)
    one, other = simulated(1, gear), simulated(2, gear)
    fit, again = record(folder, "fit", one, 3, law=law), record(folder, "again", one, 4, law=law)
    held = record(folder, "held", other, 5, law=law)
    quick = GapConfig(simulate=simulate, baselines=False, report=False, next_experiment=False)
    return analyse(folder / "model.xml", [fit], [held], [again], quick, lambda _: None)


def assert_only(found, effect, parameter, true):
    """The one name, its parameter in the interval, and the encoder behind the gear."""
    assert found.decision is not None
    assert found.twin is not None
    assert [e.name for e in found.decision.effects] == [effect]
    low, high = found.decision.effects[0].parameters[parameter]["interval90"]
    assert low < true < high
    assert found.twin.at_link == {0}


@pytest.mark.parametrize("law", [LAW, "{type: none}"])
def test_a_spring_before_the_encoder_is_named(tmp_path, law):
    """The link is known to ask for; its motor, wound up by that, moves otherwise."""
    found = asked(tmp_path, Gear(MOTOR, 90.0, 1.2), simulate=law == LAW, law=law)
    assert_only(found, "joint_elasticity", "stiffness", 90.0)
    assert any("behind its gear" in note for note in found.notes)
    if law == LAW:  # the law in the simulation reads the link, too
        assert found.before is not None
        assert found.after is not None
        assert found.after.held[0] < 0.5 * found.before.held[0]


def test_play_before_the_encoder_is_named(tmp_path):
    found = asked(tmp_path, Gear(MOTOR, 3000.0, 8.0, 0.006), simulate=False)
    assert_only(found, "backlash", "half_width", 0.006)


def test_nothing_is_named_where_the_gear_is_rigid(tmp_path):
    found = asked(tmp_path, Gear(MOTOR, 9e5, 300.0), simulate=False)
    assert found.verdict == "nothing_missing"
