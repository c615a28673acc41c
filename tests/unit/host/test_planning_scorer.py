"""How rollouts are judged: compared with a loop over their records that takes them one number at a time."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from s2r_host import _native
from s2r_host.planning.hand_probe import quat_of
from s2r_host.planning.hook import Hook
from s2r_host.planning.rewards import native_weights
from s2r_host.planning.settings import RewardWeights

RNG = np.random.default_rng(0)
ROLLOUTS, STEPS, FINGERS, DOF = 5, 4, 3, 7
S_QPOS, S_DOF, CONTROL_DT_S = 8, 7, 0.05
HINGE = np.array([2.0, -1.0, 2.0]) / 3.0
R_WORLD_PART = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
STIFFNESS, DAMPING = RNG.uniform(1.0, 9.0, DOF), RNG.uniform(0.1, 0.9, DOF)
WEIGHTS = RewardWeights(contact_after=5.0)
PLACE = Hook(
    p_part=np.array([0.1, 0.2, 0.3]),
    R_part_tool=np.eye(3),
    push_part=np.array([0.01, 0.02, -0.005]),
    q=np.zeros(DOF),
    route=np.zeros((4, DOF)),
    approach=np.zeros((0, DOF)),
    axis_part=HINGE,
    s_start=0.2,
    follow=0.5,
)
SLIDE = replace(PLACE, axis_part=np.zeros(3), follow=1.0)


def scorer(hook: Hook, substeps: int, **other) -> _native.Scorer:
    given = {
        "place": hook.place,
        "weights": native_weights(WEIGHTS, DOF),
        "s_qpos": S_QPOS,
        "s_dof": S_DOF,
        "substeps": substeps,
        "control_dt_s": CONTROL_DT_S,
        "stiffness": STIFFNESS.tolist(),
        "damping": DAMPING.tolist(),
        "R_world_part": R_WORLD_PART.tolist(),
    }
    return _native.Scorer(**given | other)


def recorded(substeps: int) -> dict[str, np.ndarray]:
    """Random records with contacts now and then, as the coarse model's sensors would have them."""
    shape = ROLLOUTS, STEPS * substeps
    sensors = RNG.normal(size=(*shape, 8 + 4 * FINGERS))
    sensors[..., 3:7] /= np.linalg.norm(sensors[..., 3:7], axis=-1, keepdims=True)
    counts = RNG.integers(0, 2, size=(*shape, FINGERS)) * (RNG.random(shape) < 0.3)[..., None]
    sensors[..., 8::4] = counts
    for k in range(3):
        sensors[..., 9 + k :: 4] *= 20.0 * counts
    sensors[..., 7] = counts.sum(axis=-1) + (RNG.random(shape) < 0.1)
    return {
        "qpos": RNG.normal(size=(*shape, 9)),
        "qvel": RNG.normal(size=(*shape, 8)),
        "sensors": sensors,
        "targets": RNG.normal(size=(ROLLOUTS, STEPS + 1, DOF)),
        "dq_start": RNG.normal(size=8),
    }


def press_N(row: np.ndarray, s: float, hook: Hook) -> float:
    """Size of the force across the push, where the part has turned by s about the hook's axis."""
    ahead, turned = hook.push_part / np.linalg.norm(hook.push_part), np.empty(3)
    quat_wxyz = np.empty(4)
    mujoco.mju_axisAngle2Quat(quat_wxyz, hook.axis_part, s if hook.axis_part.any() else 0.0)
    mujoco.mju_rotVecQuat(turned, ahead, quat_wxyz)
    force = R_WORLD_PART.T @ row[8:].reshape(FINGERS, 4)[:, 1:].sum(axis=0)
    return float(np.linalg.norm(force - (force @ turned) * turned))


def turn_rad(tool_wxyz: np.ndarray, s: float, hook: Hook) -> float:
    """Angle between the tool and its orientation at the place, turned on by the share that it does not follow."""
    wanted, back, between = np.empty(4), np.empty(4), np.empty(4)
    lag = np.empty(4)
    mujoco.mju_axisAngle2Quat(lag, hook.axis_part, -(1.0 - hook.follow) * (s - hook.s_start))
    mujoco.mju_mulQuat(wanted, lag, quat_of(hook.R_part_tool))
    mujoco.mju_negQuat(back, wanted)
    mujoco.mju_mulQuat(between, back, tool_wxyz)
    return 2.0 * float(np.arccos(min(abs(between[0]), 1.0)))


@pytest.mark.parametrize("substeps", [1, 2, 5])
@pytest.mark.parametrize("hook", [PLACE, SLIDE])
def test_facts_are_those_of_every_row_on_its_own(substeps, hook):
    records = recorded(substeps)
    found = scorer(hook, substeps).facts(**records)
    last = STEPS * substeps - 1
    for rollout in range(ROLLOUTS):
        rows, s = records["sensors"][rollout], records["qpos"][rollout, :, S_QPOS]
        for step in range(STEPS):
            # The sensors lag: a row describes the state after the substep before. After the last there is none.
            seen = [min(step * substeps + k, last) for k in range(1, substeps + 1)]
            touching = [rows[k, 8::4].sum() for k in seen]
            at, end = (rollout, step), seen[-1]
            assert found["touches"][at] == any(count > 0 for count in touching)
            assert found["collides"][at] == any(rows[k, 7] > n for k, n in zip(seen, touching, strict=True))
            assert found["distance_m"][at] == pytest.approx(float(hook.distance(rows[end, :3][None])[0]))
            assert found["turn_rad"][at] == pytest.approx(turn_rad(rows[end, 3:7], s[end - 1], hook))
            expected = max(press_N(rows[k], s[k - 1], hook) for k in seen)
            assert found["press_N"][at] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("substeps", [1, 2, 5])
def test_speeds_and_loads_are_those_at_the_ends_of_control_steps(substeps):
    records = recorded(substeps)
    found = scorer(PLACE, substeps).facts(**records)
    q, dq = (records[name][:, substeps - 1 :: substeps] for name in ("qpos", "qvel"))
    start = np.broadcast_to(records["dq_start"][:DOF], (ROLLOUTS, 1, DOF))
    before = np.concatenate([start, dq[:, :-1, :DOF]], axis=1)
    assert np.array_equal(found["s"], q[..., S_QPOS])
    assert np.array_equal(found["ds"], dq[..., S_DOF])
    assert np.array_equal(found["dq"], dq[..., :DOF])
    assert found["ddq"] == pytest.approx((dq[..., :DOF] - before) / CONTROL_DT_S)
    missing = records["targets"][:, 1:] - q[..., :DOF]
    assert found["load"] == pytest.approx(STIFFNESS * missing - DAMPING * dq[..., :DOF])


@pytest.mark.parametrize("prismatic", [True, False])
def test_a_rollout_is_worth_the_mean_of_its_terms_over_the_steps(prismatic):
    records, judge = recorded(2), scorer(SLIDE if prismatic else PLACE, 2)
    task = _native.Task(s_initial=-0.3, s_target=0.4, tolerance=0.3, prismatic=prismatic)
    w, facts = native_weights(WEIGHTS, DOF), judge.facts(**records)
    found = judge.values(**records, task=task)
    assert found.shape == (ROLLOUTS,)
    for rollout in range(ROLLOUTS):
        total = 0.0
        for step in range(STEPS):
            f = {name: values[rollout, step] for name, values in facts.items()}
            total += _native.r_dist(f["distance_m"], f["turn_rad"], w)
            total += _native.r_target(f["s"], task, w) + _native.r_success(f["s"], task, w)
            total += _native.r_contact(f["s"], bool(f["touches"]), bool(f["collides"]), task, w)
            total += _native.r_reg(f["dq"].tolist(), f["ddq"].tolist(), w) + _native.r_calm(f["ds"], task, w)
            total += _native.r_press(f["press_N"], w) + _native.r_load(f["load"].tolist(), w)
        assert found[rollout] == pytest.approx(total / STEPS)


@pytest.mark.parametrize(
    ("name", "cut", "text"),
    [
        ("qpos", np.s_[:, :-1], "a row per substep"),
        ("qvel", np.s_[:-1], "a row per substep"),
        ("targets", np.s_[:, :, :-1], "a number per joint"),
        ("dq_start", np.s_[:5], "a number per joint"),
        ("qpos", np.s_[:, :, :8], "hold the arm and the object's joint"),
        ("qvel", np.s_[:, :, :7], "hold the arm and the object's joint"),
        ("sensors", np.s_[:, :, :-1], "four numbers per fingertip shape"),
    ],
)
def test_records_of_another_shape_are_refused(name, cut, text):
    records = recorded(2)
    records[name] = np.ascontiguousarray(records[name][cut])
    with pytest.raises(ValueError, match=text):
        scorer(PLACE, 2).facts(**records)


def test_an_arm_of_another_size_is_refused():
    with pytest.raises(ValueError, match="a number per joint"):
        scorer(PLACE, 2, stiffness=[1.0] * 6)
