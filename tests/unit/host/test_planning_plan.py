"""Whole plans on small drawers: success, repetition, refusals."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from s2r_host.planning import OutOfReachError, PlanRefusedError, PlanRequest, PlanSettings, plan_manipulation
from s2r_host.planning.belief import Belief
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.rollouts import ramp
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf
from s2r_host.planning.scene import build_scene
from s2r_host.trajectory import deliver, plan_trajectory, replay
from s2r_host.trajectory.deliver import judged
from s2r_host.trajectory.verify import replays, servo_targets, trace_of
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


@pytest.fixture(scope="module")
def request_(tmp_path_factory) -> PlanRequest:
    path = tmp_path_factory.mktemp("drawer") / "object.xml"
    path.write_text(drawer_mjcf(DrawerShape(front_height=0.12, bottom=0.08)))
    return PlanRequest(ARM, path, s_initial=-0.03, s_target=0.10, q_initial=ARM.q_home, seed=1)


@pytest.fixture(scope="module")
def plan(request_):
    return plan_manipulation(request_)


def test_plan_opens_the_drawer_and_holds_it(plan):
    assert plan.success, plan.reason
    assert abs(plan.error) < 0.002
    assert plan.final == pytest.approx(0.10, abs=0.002)
    assert np.abs(plan.s[-5:] - 0.10).max() < 0.002


def test_plan_is_a_list_of_bounded_target_changes_from_the_start_pose_to_a_held_end(plan):
    assert plan.q_cmd.shape == plan.q_meas.shape == (len(plan.s), 7)
    assert plan.q_cmd[0] == pytest.approx(ARM.q_home)
    assert np.abs(np.diff(plan.q_cmd, axis=0)).max() <= 0.05 + 1e-12
    assert not np.diff(plan.q_cmd[plan.hold_step :], axis=0).any()


def test_an_independent_replay_of_the_targets_finds_the_same_end_and_no_unexpected_contact(request_, plan):
    scene = build_scene(ARM, request_.object_mjcf, "object_joint", request_.settings)
    world = FineWorld(scene, ARM.q_home, request_.s_initial)
    report = world.play(ramp(plan.q_cmd[None], 25)[0])
    assert world.s == pytest.approx(plan.final, abs=1e-9)
    assert report.contact is None
    assert report.touched


def test_what_was_executed_from_saved_states_is_what_a_replay_from_the_start_gives_bit_for_bit(
    request_, plan
):
    scene = build_scene(ARM, request_.object_mjcf, "object_joint", request_.settings)
    world = FineWorld(scene, ARM.q_home, request_.s_initial)
    shares, touched = [], []
    for step, pair in enumerate(pairwise(plan.q_cmd)):
        assert np.array_equal(world.q, plan.q_meas[step])
        assert world.s == plan.s[step]
        report = world.play(ramp(np.array(pair)[None], 25)[0])
        shares.append(report.torque_share)
        touched.append(report.touched)
    assert world.s == plan.final
    assert max(shares) == plan.torque_share
    assert touched.index(True) + 1 == plan.touch_step


def test_plan_is_bit_identical_for_any_thread_count(request_, plan):
    for threads in (1, 3):
        again = plan_manipulation(replace(request_, settings=PlanSettings(threads=threads)))
        assert np.array_equal(again.q_cmd, plan.q_cmd)
        assert np.array_equal(again.s, plan.s)


def test_another_seed_gives_another_plan_when_no_sequences_are_offered(request_):
    # With them, both seeds may execute the same offered sequence from beginning to end.
    alone = replace(
        request_, settings=replace(PlanSettings(), proposal_speeds=(), cascade=PlanSettings().cascade[:1])
    )
    first, other = plan_manipulation(alone), plan_manipulation(replace(alone, seed=2))
    assert first.q_cmd.shape != other.q_cmd.shape or not np.array_equal(first.q_cmd, other.q_cmd)


def test_trace_has_one_entry_per_executed_action(plan):
    assert len(plan.trace) == plan.control_steps
    assert plan.trace[-1].s == pytest.approx(plan.s_target, abs=0.02)
    assert plan.env_steps > 0


def test_replays_side_by_side_are_those_of_one_world_after_the_other_step_by_step(request_, plan):
    scene = build_scene(ARM, request_.object_mjcf, "object_joint", request_.settings)
    trajectory = deliver(request_, plan, accept_fragile=True).trajectory
    nearer, stiffer = (Belief((-0.003, 0.0, 0.0)), Belief(damping=1.5, joint_friction=1.5))
    scenes = [scene, nearer.applied(scene), stiffer.applied(scene)]
    _, control, chunk = servo_targets(trajectory, request_)
    played = replays(trajectory, request_, scenes)
    for one, differs in zip(played, scenes, strict=True):
        world = FineWorld(differs, ARM.q_home, request_.s_initial)
        report, s = world.check_now(), [world.s]
        for start in range(0, len(control), chunk):
            report = report.merged(world.play(control[start : start + chunk]))
            s.append(world.s)
        assert np.array_equal(one.s, s)
        assert np.array_equal(one.q_meas[-1], world.q)
        assert one.final == world.s
        assert one.contact == report.contact
        assert one.torque_share == report.torque_share
        assert one.press_N == pytest.approx(report.press_N)
        assert one.contact_share == pytest.approx(report.contact_share)
    assert len({one.final for one in played}) == 3


def test_the_trace_notes_every_substep_with_the_torques_that_moved_the_arm(request_, plan):
    scene = build_scene(ARM, request_.object_mjcf, "object_joint", request_.settings)
    delivery = deliver(request_, plan, accept_fragile=True)
    trace = trace_of(delivery.trajectory, request_, scene)
    played = delivery.replay
    assert np.diff(trace.t) == pytest.approx(0.002)
    assert trace.s[-1] == played.final
    assert trace.s[25::25] == pytest.approx(played.s[1 : 1 + len(trace.s[25::25])], abs=0.0)
    assert np.abs(trace.tau / ARM.limits.tau_max).max() == pytest.approx(played.torque_share)
    assert (np.ptp(trace.tau, axis=0) > 0.1).all()  # they are not those of the start
    assert trace.touch.any()
    assert not trace.touch[0]
    assert np.gradient(trace.s, trace.t)[1:-1] == pytest.approx(trace.ds[1:-1], abs=0.01)


@pytest.mark.parametrize("seed", [1, 5])
def test_delivered_trajectory_ends_on_target_in_the_fine_model(request_, seed):
    asked = replace(request_, seed=seed)
    _, delivery = plan_trajectory(asked)
    again = replay(delivery.trajectory, asked)
    assert abs(again.error) < 0.001
    assert again.held
    assert again.contact is None
    assert again.torque_share < 0.9
    assert again.problem(0.002, asked.settings) is None


def test_half_a_path_is_reported_as_missing_the_target(request_):
    _, delivery = plan_trajectory(request_)
    back = replay(delivery.trajectory, replace(request_, s_target=0.13))
    assert back.problem(0.002, request_.settings) == "the timed motion ends at s = " + (
        f"{back.final:.4f}, {back.error:+.4f} from the target"
    )


def test_a_trajectory_that_loses_a_slightly_different_object_is_not_delivered(request_, plan):
    moved_away = (Belief((0.0, 0.0, 0.5)),)
    with pytest.raises(PlanRefusedError, match=r"fragile|touches|ends"):
        deliver(request_, plan, perturbations=moved_away)


def test_a_delivered_motion_does_not_press_on_the_part_across_its_motion(request_, plan):
    played = deliver(request_, plan).replay
    assert 0.0 < played.press_N < 20.0
    found = replace(played, press_N=41.0).problem(0.002, request_.settings)
    assert found == "the timed motion presses on the part with 41 N across its motion, limit 40 N"


def test_a_motion_whose_contact_the_executor_may_take_for_a_collision_is_named_or_refused(request_, plan):
    strict = replace(request_, settings=replace(request_.settings, contact_margin=1e-3))
    with pytest.raises(PlanRefusedError, match="contact takes"):
        deliver(strict, plan)
    delivery = deliver(strict, plan, accept_fragile=True)
    assert delivery.fragile is not None
    assert delivery.fragile.startswith("fragile: contact takes")
    assert np.isinf(delivery.strays)
    assert delivery.replay.held


def test_how_far_a_slightly_different_object_strays_is_told(request_, plan):
    believed, slippery = Belief(), Belief((0.0, 0.0, 0.012), friction=6.0)
    alone = deliver(request_, plan, perturbations=(believed,))
    assert alone.strays == pytest.approx(abs(alone.replay.error), abs=1e-9)
    scene = build_scene(ARM, request_.object_mjcf, "object_joint", request_.settings)
    played = replay(alone.trajectory, request_, slippery.applied(scene))
    told = judged(alone, request_, scene, (believed, slippery))
    assert played.contact is None
    assert told.strays == pytest.approx(abs(played.error))
    lost = judged(alone, request_, scene, (Belief((0.0, 0.0, 0.5)), slippery))
    assert lost.fragile is not None
    assert lost.strays > 0.05 or np.isinf(lost.strays)


def test_a_plan_may_not_press_more_than_told(request_):
    strict = replace(request_.settings, press_max_N=1e-3, cascade=request_.settings.cascade[:1])
    result = plan_manipulation(replace(request_, settings=strict))
    assert not result.success
    assert "presses on the part with" in result.reason


def test_perturbing_leaves_the_scene_as_it_was(request_):
    scene = build_scene(ARM, request_.object_mjcf, "object_joint", request_.settings)
    base = scene.fine.body("object/object_base").id
    before = scene.fine.body_pos[base].copy()
    other = Belief((0.003, 0.0, -0.002), damping=2.0).applied(scene)
    assert other.fine.body_pos[base] - before == pytest.approx([0.003, 0.0, -0.002])
    assert other.fine.dof_damping[7] == pytest.approx(2.0 * scene.fine.dof_damping[7])
    assert np.array_equal(scene.fine.body_pos[base], before)


def refusal(request_: PlanRequest, **changes) -> str:
    with pytest.raises((PlanRefusedError, OutOfReachError)) as caught:
        plan_manipulation(replace(request_, **changes))
    return str(caught.value)


def test_target_beyond_the_range_is_refused_with_the_range(request_):
    assert "target = 0.4000 m is beyond its range [-0.0700, 0.2100] m" in refusal(request_, s_target=0.4)


def test_target_equal_to_the_start_is_refused(request_):
    assert "there is nothing to move" in refusal(request_, s_target=-0.0295)


@pytest.mark.parametrize(("field", "name"), [("s_initial", "start"), ("s_target", "target")])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused_by_name(request_, field, name, value):
    assert f"{name} = {value} is not a finite number" in refusal(request_, **{field: value})


def test_nan_in_the_start_pose_is_refused_with_the_joint(request_):
    q = ARM.q_home.copy()
    q[4] = np.nan
    assert "'joint5'" in refusal(request_, q_initial=q)


def test_wrong_joint_count_is_refused(request_):
    assert "needs (7,)" in refusal(request_, q_initial=np.zeros(6))


def test_start_pose_outside_the_limits_is_refused(request_):
    q = ARM.q_home.copy()
    q[1] = 2.2
    assert "joint 'joint2' (index 1): start pose = 2.200 rad is outside" in refusal(request_, q_initial=q)


def test_start_pose_in_contact_is_refused(request_):
    assert "start pose is in contact" in refusal(
        request_, q_initial=np.array([0.0, 1.0, 0.0, 1.2, 0.0, 0.3, 0.0])
    )


def test_object_out_of_reach_is_refused(request_, tmp_path):
    far = tmp_path / "far.xml"
    far.write_text(drawer_mjcf(DrawerShape(x=1.6)))
    assert "out of reach" in refusal(request_, object_mjcf=far)


@pytest.mark.slow
def test_moving_an_object_as_much_nearer_as_the_refusal_says_brings_it_into_reach(request_, tmp_path):
    path = tmp_path / "drawer.xml"
    path.write_text(drawer_mjcf(DrawerShape(x=1.25)))
    text = refusal(request_, object_mjcf=path)
    nearer = re.search(r"move the object (0\.\d\d) m nearer to the base", text)
    assert nearer is not None, text
    path.write_text(drawer_mjcf(DrawerShape(x=1.25 - float(nearer[1]))))
    assert plan_manipulation(replace(request_, object_mjcf=path)).success


def test_a_drawer_without_a_gap_to_push_in_is_refused(request_, tmp_path):
    flush = tmp_path / "flush.xml"
    shape = DrawerShape(handle_gap=0.002, opening=0.031)
    flush.write_text(drawer_mjcf(shape))
    text = refusal(request_, object_mjcf=flush)
    assert "fits nowhere behind the part" in text or "out of reach" in text


def test_a_search_that_runs_out_of_steps_gives_the_reason_and_no_success(request_):
    result = plan_manipulation(replace(request_, settings=replace(PlanSettings(), max_steps=3)))
    assert not result.success
    assert "was not reached in 3 control steps" in result.reason
    assert result.control_steps == 3 * len(PlanSettings().cascade)


def test_a_plain_front_is_refused_for_want_of_a_handle_and_not_of_reach(tmp_path):
    path = tmp_path / "plate.xml"
    path.write_text(
        """<mujoco><worldbody><body name="object_part" pos="0.6 0 0.305">
        <joint name="object_joint" type="slide" axis="-1 0 0" range="0 0.3" damping="20" frictionloss="5"/>
        <geom name="part_front" type="box" size="0.009 0.3 0.3" mass="2"/></body></worldbody></mujoco>"""
    )
    with pytest.raises(OutOfReachError, match=r"from its far side at .* is there a handle") as refused:
        plan_manipulation(PlanRequest(ARM, path, 0.0, 0.08, ARM.q_home))
    assert "move the object" not in str(refused.value)
