"""Every effect changes the motion in the way its equation says."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_conceal.effects.table import EFFECTS, KNOWN, NEEDS_OBJECT, UNKNOWN, finish_log
from s2r_conceal.motions import RATE_HZ
from s2r_conceal.parameters import Controller, Heating, Machine, Motion, Scale, Sensing
from s2r_conceal.plant import Active, Column, simulate
from s2r_conceal.rigs import rig_named

CONTRACT_NAMES = [
    "coulomb_friction",
    "viscous_friction",
    "stribeck",
    "presliding",
    "asymmetric_friction",
    "load_dependent_friction",
    "backlash",
    "joint_elasticity",
    "hysteresis",
    "armature",
    "motor_coupling",
    "payload",
    "gravity_tilt",
    "effort_scale",
    "saturation",
    "thermal_drift",
    "session_friction",
    "actuator_delay",
    "bandwidth",
    "clock_skew",
    "encoder_offset",
    "encoder_eccentricity",
    "cogging",
    "cable_spring",
    "spring_return",
    "detent",
    "soft_end_stop",
    "soft_close",
    "joint_play",
    "flexible_part",
    "contact_slip",
]
RIG = rig_named("one_joint")
SPEED = 0.5  # [rad/s] of the ramps
Q_RANGE = 0.4  # [rad] to either side


def _machine(gravity=9.81, coulomb=0.5, viscous=0.2, armature=0.1):
    return Machine(
        mass=np.array([2.0]),
        com=np.array([[0.2, 0.0, 0.0]]),
        inertia=np.array([np.diag([0.01, 0.02, 0.01])]),
        armature=np.array([armature]),
        viscous=np.array([viscous]),
        coulomb=np.array([coulomb]),
        gravity=np.array([0.0, 0.0, -gravity]),
    )


def _motion():
    """Half a second of rest, then there and back at constant speed, twice."""
    t = np.arange(round(4.0 * RATE_HZ)) / RATE_HZ
    knots = np.array([0.0, 0.3, 1.1, 2.7, 3.5, 4.0])
    q = np.interp(t, knots, [0.0, 0.0, Q_RANGE, -Q_RANGE, 0.0, 0.0])[:, None]
    return Motion(q_cmd=q, dq_cmd=np.gradient(q, 1 / RATE_HZ, axis=0), tau_ff=np.zeros_like(q))


def _column(effects=(), machine=None, kp=4000.0):
    ones = np.ones(1)
    return Column(
        machine=machine or _machine(),
        controller=Controller(kp=kp * ones, kd=0.02 * kp * ones, ki=8.0 * kp * ones),
        motion=MOTION,
        sensing=Sensing(1e-5 * ones, 0 * ones, 0 * ones, 0 * ones, 0 * ones, 0.1),
        heating=Heating(rise_K=30.0 * ones, u_typical=4.0 * ones, time_s=2.0),
        effects=tuple(effects),
    )


MOTION = _motion()
SCALE = Scale(
    torque=3.0, gravity=3.9, inertia=0.2, armature=0.1, coulomb=0.5, viscous=0.2, speed=0.5, speed_max=0.6,
    torque_max=6.0, q_lo=-0.4, q_hi=0.4, bandwidth=12.0, duration_s=4.0,
)  # fmt: skip
SET_BY_HAND = {
    "coulomb_friction": {"friction": 0.7},
    "viscous_friction": {"damping": 0.9},
    "stribeck": {"excess": 1.0, "velocity": 0.05},
    "presliding": {"displacement": 0.02},
    "asymmetric_friction": {"coulomb_difference": 0.6, "damping_ratio": 0.5, "direction": -1.0},
    "load_dependent_friction": {"coefficient": 0.2},
    "thermal_drift": {"per_kelvin": 0.02},
    "session_friction": {"factor": 1.5},
    "hysteresis": {"torque": 0.5, "width": 0.1, "shape": 0.8},
    "backlash": {"half_width": 0.01, "flank": 4000.0, "damping": 3.0, "encoder_at_motor": 1.0},
    "joint_elasticity": {"compliance": 2e-3, "damping": 1.0, "encoder_at_motor": 1.0},
    "effort_scale": {"deviation": 0.2, "direction": -1.0},
    "saturation": {"torque_max": 5.0, "reduction": 0.1, "no_load_speed": 1e9},
    "cogging": {"amplitude": 0.4, "order": 20.0, "phase": 0.3},
    "spring_return": {"stiffness": 2.0, "rest": -1.0},
    "detent": {"peak": 0.8, "place": 0.1, "width": 0.03},
    "soft_end_stop": {"stiffness": 30.0, "place": 0.3, "dissipation": 0.1, "side": 1.0},
    "soft_close": {"damping": 3.0, "place": 0.1, "ramp": 0.02, "side": 1.0},
    "payload": {"mass": 0.5, "reach": 1.0},
    "armature": {"inertia": 0.1},
    "gravity_tilt": {"angle": 0.1, "direction": 1.0, "heading": 0.0},
    "encoder_offset": {"offset": 0.05, "direction": 1.0},
    "encoder_eccentricity": {"amplitude": 0.02, "order": 2.0, "phase": 0.5},
    "clock_skew": {"delay": 0.02},
    "actuator_delay": {"delay": 0.004},
    "bandwidth": {"time_constant": 0.004},
}


@pytest.fixture(scope="module")
def runs():
    """One simulation with a column for every effect set by hand, and one without any."""
    names = list(SET_BY_HAND)
    columns = [_column()] + [_column([Active(n, 0, SET_BY_HAND[n])]) for n in names]
    traces = simulate(RIG, columns, substeps=2)
    finished = [finish_log(t, c.effects) for t, c in zip(traces, columns, strict=True)]
    return dict(zip([None, *names], finished, strict=True))


def _q():
    return MOTION.q_cmd[:, 0]


def _steady(direction):
    """Ticks in the middle of the constant-speed passes of one direction."""
    t = np.arange(len(_q())) / RATE_HZ
    up = ((t > 0.6) & (t < 1.0)) | ((t > 3.1) & (t < 3.4))
    down = (t > 1.5) & (t < 2.6)
    return up if direction > 0 else down


def _extra(runs, name):
    """Additional effort the controller needs because of an effect [N·m]."""
    return (runs[name].tau_commanded - runs[None].tau_commanded)[:, 0]


def test_the_catalogue_covers_every_name_of_the_contract():
    assert sorted((*KNOWN, *NEEDS_OBJECT)) == sorted(CONTRACT_NAMES)
    assert len(UNKNOWN) == 8


@pytest.mark.parametrize("name", list(EFFECTS))
def test_every_effect_is_drawn_complete_and_inside_its_limits(name):
    effect = EFFECTS[name]
    shape = effect.draw(np.random.default_rng(3), SCALE)
    low, high = effect.sizes(SCALE, shape)
    assert low < high
    assert set(shape) | {effect.size} == set(effect.units)
    assert effect.words


@pytest.fixture(scope="module")
def drawn():
    """(without, with) of every effect that one joint can show, drawn, under soft control."""
    short = Motion(*(getattr(MOTION, k)[:2200] for k in ("q_cmd", "dq_cmd", "tau_ff")))
    columns, names = [], [n for n in EFFECTS if EFFECTS[n].min_joints == 1]
    for name in names:
        shape = EFFECTS[name].draw(np.random.default_rng(5), replace(SCALE, duration_s=2.2))
        low, high = EFFECTS[name].sizes(SCALE, shape)
        active = Active(name, 0, shape | {EFFECTS[name].size: low + 0.2 * (high - low)})
        machine = _machine(gravity=0.0 if name == "backlash" else 9.81)  # a steady load hides play
        columns += [replace(_column(e, machine, kp=60.0), motion=short) for e in ((), (active,))]
    traces = simulate(RIG, columns, substeps=2)
    finished = [finish_log(t, c.effects) for t, c in zip(traces, columns, strict=True)]
    return {name: (finished[2 * k], finished[2 * k + 1]) for k, name in enumerate(names)}


@pytest.mark.parametrize("name", [n for n in EFFECTS if EFFECTS[n].min_joints == 1])
def test_every_effect_moves_effort_or_position_and_says_where(drawn, name):
    without, with_ = drawn[name]
    q_moved = np.abs(with_.q - without.q).max()
    tau_moved = np.abs(with_.tau_commanded - without.tau_commanded).max()
    assert q_moved > 1e-5 or tau_moved > 1e-3
    assert len(with_.contributions) == 1
    assert np.abs(with_.contributions[0]).max() > 0.0


def test_coulomb_friction_costs_its_torque_in_both_directions(runs):
    extra = _extra(runs, "coulomb_friction")
    assert extra[_steady(+1)] == pytest.approx(+0.7, abs=0.03)
    assert extra[_steady(-1)] == pytest.approx(-0.7, abs=0.03)


def test_viscous_friction_costs_torque_in_proportion_to_speed(runs):
    extra = _extra(runs, "viscous_friction")
    assert extra[_steady(+1)] == pytest.approx(+0.9 * SPEED, abs=0.03)
    assert extra[_steady(-1)] == pytest.approx(-0.9 * SPEED, abs=0.03)


def test_stribeck_hump_is_gone_at_ten_times_its_velocity(runs):
    assert np.abs(_extra(runs, "stribeck")[_steady(-1)]).max() < 0.03
    assert runs["stribeck"].contributions[0].max() > 0.9


def test_asymmetric_friction_acts_in_one_direction_only(runs):
    extra = _extra(runs, "asymmetric_friction")
    assert np.abs(extra[_steady(+1)]).max() < 0.03
    assert extra[_steady(-1)] == pytest.approx(-0.6 - 0.6 * 0.5 * SPEED, abs=0.03)


def test_load_dependent_friction_follows_the_gravity_torque(runs):
    gravity = 2.0 * 9.81 * 0.2 * np.cos(_q())
    chosen = _steady(-1)
    ratio = -_extra(runs, "load_dependent_friction")[chosen] / np.abs(gravity[chosen])
    assert ratio == pytest.approx(0.2, abs=0.02)


def test_presliding_builds_friction_over_its_displacement(runs):
    z = runs["presliding"].contributions[0]
    begin = int(0.3 * RATE_HZ)  # the motion starts upwards from rest
    moved = runs["presliding"].q[:, 0] - runs["presliding"].q[begin, 0]
    at = int(np.argmax(moved > 0.02))
    remaining = z[at] / z[begin + 5]
    assert remaining == pytest.approx(np.exp(-1.0), abs=0.12)


def test_session_friction_scales_all_friction(runs):
    total = 0.5 + 0.2 * SPEED
    assert _extra(runs, "session_friction")[_steady(+1)] == pytest.approx(0.5 * total, abs=0.03)


def test_session_friction_leaves_the_first_session_alone():
    change = EFFECTS["session_friction"].for_role
    assert change is not None
    assert change({"factor": 1.5}, "fit") == {"factor": 1.0}
    assert change({"factor": 1.5}, "holdout") == {"factor": 1.5}


def test_thermal_drift_lowers_friction_as_the_motor_warms(runs):
    warm = runs["thermal_drift"].temp_C[:, 0]
    assert warm[-1] > warm[0] + 5.0
    late = int(3.3 * RATE_HZ)
    expected = (np.exp(-0.02 * (warm[late] - 25.0)) - 1.0) * (0.5 + 0.2 * SPEED)
    assert _extra(runs, "thermal_drift")[late] == pytest.approx(expected, abs=0.03)


def test_hysteresis_saturates_at_its_torque(runs):
    chosen = (_q() < -0.3) & _steady(-1)
    assert _extra(runs, "hysteresis")[chosen] == pytest.approx(-0.5, abs=0.05)


def test_backlash_is_crossed_without_load_and_over_its_full_width():
    effect = [Active("backlash", 0, SET_BY_HAND["backlash"])]
    level = _machine(gravity=0.0)
    motor_side, load_side = (
        simulate(
            RIG,
            [_column([replace(effect[0], values=effect[0].values | {"encoder_at_motor": side})], level)],
            4,
        )[0]
        for side in (1.0, 0.0)
    )
    turned = int(1.3 * RATE_HZ)
    free = motor_side.contributions[0]
    assert free[turned - 150 : turned].max() == 1.0
    assert free[_steady(-1)].mean() < 1.0
    assert np.abs(load_side.q - motor_side.q).max() > 0.005


def test_elastic_joint_winds_up_by_compliance_times_load(runs):
    windup = runs["joint_elasticity"].contributions[0]
    gravity = 2.0 * 9.81 * 0.2 * np.cos(_q())
    chosen = _steady(-1)
    assert windup[chosen] == pytest.approx(-2e-3 * gravity[chosen], rel=0.1)


def test_effort_scale_asks_for_the_inverse_of_the_scale(runs):
    chosen = _steady(-1)
    ratio = runs["effort_scale"].tau_commanded[chosen, 0] / runs[None].tau_commanded[chosen, 0]
    assert ratio == pytest.approx(1.0 / 0.8, rel=0.02)


def test_saturation_clips_what_the_drive_reports(runs):
    assert np.abs(runs["saturation"].tau_measured).max() == pytest.approx(4.5)
    assert np.abs(runs["saturation"].tau_commanded).max() > 4.5


def test_cogging_is_a_sine_in_position(runs):
    chosen = _steady(-1)
    expected = -0.4 * np.sin(20.0 * runs["cogging"].q[chosen, 0] + 0.3)
    assert np.corrcoef(_extra(runs, "cogging")[chosen], expected)[0, 1] > 0.97


def test_spring_return_pulls_towards_its_rest(runs):
    chosen = _steady(+1) | _steady(-1)
    assert _extra(runs, "spring_return")[chosen] == pytest.approx(2.0 * (_q()[chosen] + 1.0), abs=0.04)


def test_detent_acts_near_its_place_only(runs):
    extra = _extra(runs, "detent")
    far = _steady(-1) & (np.abs(_q() - 0.1) > 0.2)
    assert np.abs(extra[far]).max() < 0.05
    assert np.abs(runs["detent"].contributions[0]).max() == pytest.approx(0.8, rel=0.02)


def test_end_stop_pushes_back_beyond_its_place_only(runs):
    push = runs["soft_end_stop"].contributions[0]
    assert push[_q() < 0.28].max() == 0.0
    assert push.max() == pytest.approx(30.0 * 0.1, rel=0.15)


def test_soft_close_damps_only_while_closing(runs):
    drag = runs["soft_close"].contributions[0]
    assert drag[_steady(+1) & (_q() > 0.2)] == pytest.approx(3.0 * SPEED, rel=0.05)
    assert np.abs(drag[_steady(-1)]).max() == 0.0


def test_payload_adds_its_weight(runs):
    chosen = _steady(-1)
    lever = RIG.tip(_machine())[0]
    assert _extra(runs, "payload")[chosen] == pytest.approx(
        -0.5 * 9.81 * lever * np.cos(_q()[chosen]), rel=0.03
    )


def test_armature_costs_torque_only_while_accelerating(runs):
    extra = np.abs(_extra(runs, "armature"))
    assert extra[_steady(-1)].max() < 0.05
    assert extra.max() > 1.0


def test_gravity_tilt_turns_the_weight(runs):
    chosen = _steady(-1)
    expected = -2.0 * 9.81 * 0.2 * (np.cos(_q() + 0.1) - np.cos(_q()))
    assert _extra(runs, "gravity_tilt")[chosen] == pytest.approx(expected[chosen], abs=0.03)


def test_encoder_offset_looks_like_a_tilt_of_gravity(runs):
    chosen = _steady(-1)
    expected = -2.0 * 9.81 * 0.2 * (np.cos(_q() - 0.05) - np.cos(_q()))
    assert _extra(runs, "encoder_offset")[chosen] == pytest.approx(expected[chosen], abs=0.03)


@pytest.mark.parametrize("sensor", ["encoder_offset", "encoder_eccentricity"])
@pytest.mark.parametrize("between", ["joint_elasticity", "backlash"])
def test_an_encoder_at_the_motor_errs_as_one_at_the_joint(sensor, between):
    erring, behind = (Active(name, 0, SET_BY_HAND[name]) for name in (sensor, between))
    rigid, beside = simulate(RIG, [_column([erring]), _column([erring, behind])], substeps=4)
    alone = simulate(RIG, [_column(), _column([behind])], substeps=4)
    chosen = _steady(-1)
    wanted = (rigid.tau_commanded - alone[0].tau_commanded)[chosen, 0]
    assert np.abs(wanted).mean() > 1e-3
    # Behind a windup the same error is met a little earlier or later on the way.
    assert (beside.tau_commanded - alone[1].tau_commanded)[chosen, 0].mean() == pytest.approx(
        wanted.mean(), rel=0.25
    )
    windup = beside.contributions[1] if between == "joint_elasticity" else np.zeros(1)
    assert np.abs(windup[:100]).max() < 0.02  # at rest when the recording begins


def test_eccentric_encoder_errs_once_or_twice_per_turn(runs):
    error = runs["encoder_eccentricity"].contributions[0]
    assert np.abs(error).max() <= 0.02 + 1e-9
    assert np.ptp(error) > 0.01


def test_late_stamps_shift_position_but_not_effort(runs):
    late, prompt = runs["clock_skew"], runs[None]
    assert late.tau_commanded == pytest.approx(prompt.tau_commanded)
    assert late.q[_steady(-1)] == pytest.approx(prompt.q[_steady(-1)] + 0.02 * SPEED, abs=1e-4)


def test_late_positions_are_whole_steps_of_the_encoder_as_all_others():
    effects = [Active("clock_skew", 0, {"delay": 0.0123})]
    columns = [replace(_column(e), noise=(1, 2, 3)) for e in ([], effects)]
    for column, trace in zip(columns, simulate(RIG, columns, substeps=1), strict=True):
        steps = finish_log(trace, column.effects).q.astype(float) / column.sensing.lsb
        assert np.abs(steps - np.rint(steps)).max() < 0.01


@pytest.mark.parametrize("name", ["actuator_delay", "bandwidth"])
def test_late_effort_lags_by_its_time(name):
    t = np.arange(1200)[:, None] / RATE_HZ
    swing = Motion(0.3 * np.sin(9.0 * t), 2.7 * np.cos(9.0 * t), np.zeros_like(t))
    column = _column([Active(name, 0, SET_BY_HAND[name])], _machine(coulomb=0.0), kp=40.0)
    trace = simulate(RIG, [replace(column, motion=swing)], substeps=10)[0]
    slope = np.gradient(trace.tau_commanded[:, 0].astype(float), 1 / RATE_HZ)[600:]
    late = trace.contributions[0][600:]
    assert -np.sum(late * slope) / np.sum(slope**2) == pytest.approx(0.004, rel=0.1)


def test_coupling_turns_the_neighbouring_joint():
    rig = rig_named("two_link")
    machine = replace(rig.draw(np.random.default_rng(1)), gravity=np.zeros(3))
    t = np.arange(800) / RATE_HZ
    q = np.stack([0.2 * (1.0 - np.cos(2 * np.pi * 2 * t)), np.zeros_like(t)], axis=1)
    motion = Motion(q, np.gradient(q, 1 / RATE_HZ, axis=0), np.zeros_like(q))
    two = np.ones(2)
    base = Column(
        machine,
        Controller(500.0 * two, 20.0 * two, 0.0 * two),
        motion,
        Sensing(1e-5 * two, 0 * two, 0 * two, 0 * two, 0 * two, 0.1),
        Heating(10.0 * two, 5.0 * two, 10.0),
    )
    coupled = replace(base, effects=(Active("motor_coupling", 1, {"inertia": 0.02, "drag_ratio": 0.0}),))
    without, with_ = simulate(rig, [base, coupled], substeps=2)
    extra = (with_.tau_commanded - without.tau_commanded)[:, 1]
    expected = 0.02 * np.gradient(with_.dq[:, 0], 1 / RATE_HZ)
    assert np.corrcoef(extra[100:], expected[100:])[0, 1] > 0.9
