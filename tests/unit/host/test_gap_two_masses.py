"""Motor and link with a spring or play between them, against their equations of motion integrated to nine digits."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from s2r_host._native import behind_recorded_motor, under_servo
from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import lowpass, make_session
from s2r_host.gap.motion.two_masses import Gear, deflection
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

DT, T_END = 0.002, 3.0
T = np.arange(0.0, T_END, DT)


def pushed(windup, rate, gear):
    """Effort of the gear: flanks push and never pull."""
    over = windup - np.clip(windup, -gear.gap, gear.gap)
    effort = gear.stiffness * over + gear.damping * rate
    return np.where(over > 0, max(effort, 0.0), np.where(over < 0, min(effort, 0.0), 0.0))


def test_a_loose_link_behind_a_recorded_motor():
    gear = Gear(0.0, 500.0, 4.0, 0.003)
    inertia, load, slope = 0.1 + 0.02 * np.sin(T), 2.0 * np.sin(4.0 * T), 0.5 * np.cos(T)

    def slopes(t, y):
        pull = np.interp(t, T, load) + np.interp(t, T, slope) * y[0]
        return [y[1], (pushed(-y[0], -y[1], gear) - pull) / np.interp(t, T, inertia)]

    true = solve_ivp(slopes, (0.0, T[-1]), [-gear.gap, 0.0], t_eval=T, rtol=1e-9, atol=1e-12, max_step=2e-4).y
    wanted = np.array([pushed(-x, -v, gear) for x, v in true.T])
    found = deflection(DT, inertia, load, slope, np.zeros(len(T)), gear)
    free = np.mean(found == 0.0)
    assert 0.01 < free < 0.5
    assert np.sqrt(np.mean((found - wanted)[5:] ** 2)) < 0.02 * np.std(wanted)


def test_flanks_do_not_hold_on_to_what_leaves_them():
    """A link thrown off a flank: its damper would brake it, if flanks pulled."""
    rows = 200
    load = np.where(np.arange(rows) < 100, 5.0, -5.0)  # pressed to one flank, then drawn off it
    gear = Gear(0.0, 400.0, 20.0, 0.01)
    found = deflection(DT, np.full(rows, 0.1), load, np.zeros(rows), np.zeros(rows), gear)
    assert found[99] == pytest.approx(5.0, rel=1e-3)
    assert np.all(found[:100] >= 0.0)
    crossing = np.flatnonzero(found[100:] != 0.0)
    assert np.all(
        np.diff(np.sign(found[100:][crossing])) <= 0.0
    )  # from one flank to the other, none pulls before


@pytest.mark.parametrize(("k", "d"), [(60.0, 0.2), (60.0, 60.0), (30.0, 200.0), (2000.0, 10.0)])
def test_a_link_without_a_gap_takes_one_step_per_row(k, d):
    """Hardly damped, and damped so much that ordinary steps would have to be tiny: against such steps."""
    t = np.arange(0.0, 4.0, 0.004)
    rows: dict[str, Any] = {
        "inertia": 0.5 + 0.1 * np.sin(t),
        "load": 5.0 * np.sin(1.7 * t) + 2.0 * np.sin(9.0 * t),
    }
    rows |= {"slope": 8.0 * np.cos(1.1 * t), "bend": 5.0 * np.sin(t)}
    found = deflection(0.004, rows["inertia"], rows["load"], rows["slope"], rows["bend"], Gear(0.0, k, d))
    fine = behind_recorded_motor(dt=0.004, **rows, stiffness=k, damping=d, gap=0.0, phase=0.005)
    assert np.std(fine) > 3.0
    assert np.sqrt(np.mean((found - fine) ** 2)) < 0.02 * np.std(fine)


@pytest.mark.parametrize("reads_link", [False, True])
@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_a_motor_under_its_servo(gap, reads_link):
    """Its encoder is the motor's, or the link's."""
    gear = Gear(0.05, 800.0, 2.0, gap)
    q_cmd, dq_cmd = 0.5 * np.sin(3.0 * T), 1.5 * np.cos(3.0 * T)
    law: dict[str, Any] = (
        {"kp": 60.0, "kd": 6.0, "ki": 80.0} if reads_link else {"kp": 300.0, "kd": 12.0, "ki": 500.0}
    )
    rows = {
        "inertia": np.full(len(T), 0.2),
        "load": 3.0 * np.sin(2.0 * T) + 0.3,
        "slope": np.full(len(T), 4.0),
    }
    at, effort, turning = under_servo(
        dt=DT, **rows, bend=np.zeros(len(T)), stiffness=gear.stiffness, damping=gear.damping, gap=gap,
        q=np.zeros(len(T)), speed=0.0, motor_inertia=gear.motor, motor_damping=0.4, friction=0.0, **law, low=-np.inf,
        high=np.inf, ticks=1, q_cmd=q_cmd, dq_cmd=dq_cmd, ahead=0.2 * np.cos(T), integral=0.001, follow=0.0,
        reads_link=reads_link, phase=0.02,
    )  # fmt: skip
    windup = gap + 0.3 / gear.stiffness
    q, v, link, rate, total = windup if reads_link else 0.0, 0.0, 0.0 if reads_link else -windup, 0.0, 0.001
    wanted = []
    for i in range(len(T)):
        seen, speed = (link, rate) if reads_link else (q, v)
        total += (q_cmd[i] - seen) * DT
        asked = law["kp"] * (q_cmd[i] - seen) + law["kd"] * (dq_cmd[i] - speed) + law["ki"] * total
        asked += 0.2 * np.cos(T[i])
        wanted.append((seen, asked - 0.4 * v, v))

        def slopes(t, y, asked=asked):
            through = (
                pushed(y[0] - y[2], y[1] - y[3], gear) if gap else 800.0 * (y[0] - y[2]) + 2.0 * (y[1] - y[3])
            )
            pull = np.interp(t, T, rows["load"]) + 4.0 * y[2]
            return [y[1], (asked - 0.4 * y[1] - through) / 0.05, y[3], (through - pull) / 0.2]

        q, v, link, rate = solve_ivp(slopes, (T[i], T[i] + DT), [q, v, link, rate], rtol=1e-8, atol=1e-10).y[
            :, -1
        ]
    wanted = np.array(wanted)
    assert np.std(wanted[:, 0]) > 0.3
    assert np.max(np.abs(at - wanted[:, 0])) < 2e-3 * np.std(wanted[:, 0])
    assert np.sqrt(np.mean((effort - wanted[:, 1]) ** 2)) < 0.02 * np.std(wanted[:, 1])
    assert np.sqrt(np.mean((turning - wanted[:, 2]) ** 2)) < 0.02 * np.std(wanted[:, 2])


def test_dry_friction_holds_the_motor_and_the_drive_has_limits():
    rest = np.zeros(len(T))
    told: dict[str, Any] = {
        "inertia": rest + 0.2,
        "load": rest,
        "slope": rest,
        "bend": rest,
        "q": rest,
        "speed": 0.0,
    }
    law: dict[str, Any] = {
        "kp": 100.0,
        "kd": 5.0,
        "ki": 0.0,
        "ticks": 1,
        "dq_cmd": rest,
        "ahead": rest,
        "integral": 0.0,
    }
    gear: dict[str, Any] = {
        "stiffness": 500.0,
        "damping": 1.0,
        "gap": 0.0,
        "motor_inertia": 0.05,
        "motor_damping": 0.0,
    }

    def run(friction, high, far):
        return under_servo(
            dt=DT, **told, **law, **gear, friction=friction, low=-high, high=high, q_cmd=rest + far, follow=0.0,
            reads_link=False, phase=0.1,
        )  # fmt: skip

    assert np.all(run(1.5, 10.0, 0.01)[0] == 0.0)  # 1 N·m asked for, 1.5 needed
    moved, effort, speed = run(0.5, 2.0, 1.0)  # 100 N·m asked for, 2 given
    assert moved[-1] > 0.5
    assert effort[0] == pytest.approx(1.5)
    assert speed[0] == 0.0


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"load": np.ones(4)}, "a number per row"),
        ({"inertia": np.zeros(5)}, "inertia must be positive"),
        ({"stiffness": 0.0}, "stiffness"),
    ],
)
def test_numbers_that_make_no_machine_are_refused(wrong, named):
    right: dict[str, Any] = {name: np.ones(5) for name in ("inertia", "load", "slope", "bend")}
    right.update(dt=DT, stiffness=1.0, damping=0.0, gap=0.0, phase=0.1)
    assert len(behind_recorded_motor(**right)) == 5
    right.update(wrong)
    with pytest.raises(ValueError, match=named):
        behind_recorded_motor(**right)


def test_more_parts_than_an_int_holds_are_as_many_as_are_taken_at_most():
    rows: dict[str, Any] = {name: np.ones(5) for name in ("inertia", "load", "slope", "bend")}
    found, most = (
        behind_recorded_motor(dt=DT, **rows, stiffness=1e4, damping=1.0, gap=0.001, phase=phase)
        for phase in (1e-12, 1e-6)
    )
    assert np.array_equal(found, most)


@pytest.fixture(scope="module")
def bouncing(tmp_path_factory):
    """A recording of a stiff servo with play behind its motor, whose link bounces; flanks are hardly damped."""
    model = RigidModel(write_model(tmp_path_factory.mktemp("rig") / "model.xml", armature=0.1))
    joint = model.joints[0]
    t = np.arange(0.0, 20.0, 0.004)
    q_cmd = 0.6 * np.sin(2.0 * t) + 0.25 * np.sin(5.3 * t + 1.0) + 0.08 * np.sin(11.0 * t)
    dq_cmd = 1.2 * np.cos(2.0 * t) + 1.325 * np.cos(5.3 * t + 1.0) + 0.88 * np.cos(11.0 * t)
    m = model.model
    armature, damping = float(m.dof_armature[0]), float(m.dof_damping[0])
    friction = float(m.dof_frictionloss[0])
    kp, kd, gear = 600.0, 40.0, Gear(armature, 4000.0, 3.0, 0.004)
    ticks = 4
    fine = np.arange(len(t) * ticks) * 0.001
    commands = [np.interp(fine, t, x) for x in (q_cmd, dq_cmd)]
    # The truth: the link's weight taken where it is, every 4 ms, by the model itself.
    column = q_cmd[:, None]
    weight = model.inverse(column, 0 * column, 0 * column)[:, 0]
    further = model.inverse(column + 1e-3, 0 * column, 0 * column)[:, 0]
    inertia = model.mass_diagonal(column)[:, 0] - armature
    q, *_ = under_servo(
        dt=0.004, inertia=inertia, load=weight, slope=(further - weight) / 1e-3, bend=0.0 * t,
        stiffness=gear.stiffness, damping=gear.damping, gap=gear.gap, q=q_cmd, speed=float(dq_cmd[0]),
        motor_inertia=armature, motor_damping=damping, friction=friction, kp=kp, kd=kd, ki=0.0, low=-np.inf,
        high=np.inf, ticks=ticks, q_cmd=commands[0], dq_cmd=commands[1], ahead=np.zeros(len(fine)), integral=0.0,
        follow=0.0, reads_link=False, phase=0.02,
    )  # fmt: skip
    noise = np.random.default_rng(5).normal(size=(2, len(t)))
    measured = q + 2e-4 * noise[0]
    speed = np.gradient(q, t)
    channels = {
        "q": {joint: measured}, "dq": {joint: speed}, "q_cmd": {joint: q_cmd}, "dq_cmd": {joint: dq_cmd},
        "tau": {joint: kp * (q_cmd - q) + kd * (dq_cmd - speed) + 0.02 * noise[1]},
    }  # fmt: skip
    law = Controller("pd", {joint: kp}, {joint: kd}, {}, 1000.0)
    rec = Recording("r", t, channels, law, "commanded", "q_cmd", "s", "", ())
    s = make_session(model, rec, 0)
    return Context(model, [s]), s, gear, friction


def test_play_that_bounces_is_followed_with_the_servo_inside(bouncing):
    """Behind the recorded motion of the motor the same play explains less than nothing."""
    ctx, s, gear, friction = bouncing
    backlash = catalogue()["backlash"]
    J = float(np.mean(s.mass[:, 0]))
    link = J - gear.motor
    shape = {
        "w": gear.gap, "motor": gear.motor / J, "f": float(np.sqrt(gear.stiffness / link)) / (2.0 * np.pi),
        "zeta": gear.damping / (2.0 * np.sqrt(gear.stiffness * link)),
    }  # fmt: skip

    def low(x):
        return lowpass(x, 30.0, s.dt)[100:-100]

    left = low(s.u[:, 0] - s.load[:, 0] - friction * s.sign(0))
    explained = {}
    for name, more in (("servo", {"servo": 1.0}), ("recorded", {})):
        fixed = backlash.columns(ctx, s, 0, shape | more).fixed
        assert fixed is not None
        explained[name] = 1.0 - np.sum((left - low(fixed)) ** 2) / np.sum(left**2)
    assert explained["servo"] > 0.9
    assert explained["recorded"] < 0.7
    assert any("servo" in x for x in backlash.shapes(ctx, 0))


def test_without_a_declared_law_no_shape_needs_one(bouncing):
    ctx, s, _, _ = bouncing
    blind = Context(ctx.model, [make_session(ctx.model, replace(s.rec, controller=Controller()), 0)])
    for effect in ("backlash", "joint_elasticity"):
        assert not any("servo" in x for x in catalogue()[effect].shapes(blind, 0))
