"""Believable objects: their draw, their models, rollouts with several of them."""

import mujoco.batch
import numpy as np
import pytest

from s2r_host.planning import PlanRequest, PlanSettings, PlanSettingsError, Stage, plan_manipulation
from s2r_host.planning.belief import Belief, draw_belief, draw_ensemble, moved_body, spread_over
from s2r_host.planning.planner import scene_of
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf
from s2r_host.planning.scene import GeomKind
from s2r_host.planning.settings import Doubt
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")


@pytest.fixture(scope="module")
def request_(tmp_path_factory) -> PlanRequest:
    path = tmp_path_factory.mktemp("drawer") / "object.xml"
    path.write_text(drawer_mjcf(DrawerShape(front_height=0.12, bottom=0.08)))
    return PlanRequest(
        ARM, path, s_initial=0.0, s_target=0.08, q_initial=ARM.q_home, settings=PlanSettings(threads=1)
    )


@pytest.fixture(scope="module")
def scene(request_):
    return scene_of(request_)


def test_an_ensemble_begins_with_the_believed_object_and_goes_on_in_opposite_pairs():
    first, up, down = draw_ensemble(Doubt(), 3, np.random.default_rng(4))
    assert first == Belief()
    assert up.damping + down.damping == pytest.approx(2.0)
    assert up.joint_friction + down.joint_friction == pytest.approx(2.0)
    assert np.array(up.shift_m) == pytest.approx(-np.array(down.shift_m))


def test_beliefs_stay_within_the_doubt_and_fill_it():
    rng = np.random.default_rng(0)
    drawn = [draw_belief(Doubt(), rng) for _ in range(500)]
    friction = np.array([b.friction for b in drawn])
    assert 0.6 <= friction.min() < 0.62
    assert 1.38 < friction.max() <= 1.4
    assert np.std([b.shift_m for b in drawn]) == pytest.approx(0.002, rel=0.1)


def test_a_belief_changes_a_copy_of_the_fine_model(scene):
    belief = Belief((0.001, 0.0, -0.002), 0.5, 2.0, 3.0)
    body = moved_body(scene)[0]
    before = scene.fine.body_pos[body].copy()
    other = belief.applied(scene)
    robot = scene.geom_kind >= GeomKind.ROBOT
    assert other.fine.body_pos[body] - before == pytest.approx([0.001, 0.0, -0.002])
    assert other.fine.dof_damping[scene.s_dof] == pytest.approx(2.0 * scene.fine.dof_damping[scene.s_dof])
    assert other.fine.dof_frictionloss[scene.s_dof] == pytest.approx(
        3.0 * scene.fine.dof_frictionloss[scene.s_dof]
    )
    assert other.fine.geom_friction[robot, 0] == pytest.approx(0.5 * scene.fine.geom_friction[robot, 0])
    assert np.array_equal(scene.fine.body_pos[body], before)


def test_rollouts_of_a_batch_have_the_beliefs_in_turn(scene):
    beliefs = (Belief(), Belief((0.0, 0.0, 0.0), 1.0, 2.0, 0.5))
    batch = mujoco.batch.Batch(scene.rollout_model(Stage()), nsim=4, nthread=1)
    spread_over(batch, scene, beliefs)
    damping = scene.coarse.dof_damping[scene.s_dof]
    assert batch.expand("dof_damping")[:, scene.s_dof] == pytest.approx(damping * np.array([1, 2, 1, 2]))
    friction = scene.coarse.dof_frictionloss[scene.s_dof]
    assert batch.expand("dof_frictionloss")[:, scene.s_dof] == pytest.approx(
        friction * np.array([1.0, 0.5, 1.0, 0.5])
    )


def test_a_plan_with_an_ensemble_costs_that_many_rollouts_and_is_the_same_for_any_thread_count(request_):
    plans = [
        plan_manipulation(
            PlanRequest(**{**request_.__dict__, "settings": PlanSettings(threads=threads, ensemble=3)})
        )
        for threads in (1, 2)
    ]
    assert plans[0].success, plans[0].reason
    assert np.array_equal(plans[0].q_cmd, plans[1].q_cmd)
    alone = plan_manipulation(request_)
    per_step = plans[0].env_steps / plans[0].control_steps
    assert per_step == pytest.approx(3.0 * alone.env_steps / alone.control_steps, rel=0.02)


@pytest.mark.parametrize("count", [0, 2, 4])
def test_an_ensemble_that_would_be_empty_or_one_sided_is_refused(count):
    with pytest.raises(PlanSettingsError, match=f"ensemble = {count} .* an odd number"):
        PlanSettings(ensemble=count)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_an_ensemble_is_believed_in_the_middle(count):
    drawn = draw_ensemble(Doubt(), count, np.random.default_rng(0))
    assert len(drawn) == count
    assert np.mean([b.joint_friction for b in drawn]) == pytest.approx(1.0)
    assert np.mean([b.shift_m for b in drawn], axis=0) == pytest.approx(np.zeros(3), abs=1e-15)
