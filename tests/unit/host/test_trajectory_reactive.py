"""Continuations of a running motion from live states, without an executor."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.planning import PlanRequest, PlanSettings
from s2r_host.planning.belief import Belief
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.planner import scene_of
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf
from s2r_host.trajectory import TrajectoryError, deliver, plan_trajectory
from s2r_host.trajectory.reactive import ReactivePlanner
from s2r_host.trajectory.to_rest import to_rest
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
STEP_S, LOOK_STEPS = 0.05, 4


def to_open(folder, shape: DrawerShape) -> PlanRequest:
    path = folder / "object.xml"
    path.write_text(drawer_mjcf(shape))
    return PlanRequest(
        ARM, path, s_initial=0.0, s_target=0.10, q_initial=ARM.q_home, settings=PlanSettings(threads=1)
    )


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    request = to_open(tmp_path_factory.mktemp("drawer"), DrawerShape(front_height=0.12, bottom=0.08))
    scene = scene_of(request)
    result, delivery = plan_trajectory(request, scene=scene)
    return request, scene, result.hook, delivery.trajectory


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """A drawer that the servos of the model give way to, opened by an arm whose drives do not.

    Returns:
        As ``planned``, for a motion that allows for it, and how much further the part goes than in the model [m].
    """
    shape = DrawerShape(front_height=0.12, bottom=0.08, friction=9.0)
    request = to_open(tmp_path_factory.mktemp("heavy"), shape)
    scene = scene_of(request)
    result, delivery = plan_trajectory(request, scene=scene, accept_fragile=True)
    beside = IntegralPlay((request, scene, result.hook, delivery.trajectory), Belief()).run(reactive=False)
    yields = request.s_target - beside - delivery.replay.final
    sent = replace(request, s_target=request.s_target - yields)
    motion = deliver(sent, result, scene=scene, accept_fragile=True).trajectory
    return (request, scene, result.hook, motion), yields


class Play:
    """A true object that differs from the believed one, and an arm that follows motions exactly."""

    def __init__(self, planned, truth: Belief, yields: float = 0.0) -> None:
        self.request, scene, hook, self.motion = planned
        self.world = FineWorld(truth.applied(scene), ARM.q_home, self.request.s_initial)
        self.planner = ReactivePlanner(self.request, scene, hook, yields=yields)
        self.planner.begin(self.motion)
        self.t, self.next, self.outlooks, self.contact = 0.0, None, [], None

    def step(self) -> None:
        if self.next is not None and self.t >= self.next.splice_t - 1e-9:
            self.t, self.motion, self.next = self.t - self.next.splice_t, self.next.motion, None
        dt = self.request.settings.fine_timestep_s
        self.drive(self.t + dt * np.arange(1, round(STEP_S / dt) + 1))
        self.t += STEP_S

    def drive(self, t: np.ndarray) -> None:
        """Through times of the motion [s]."""
        self.send(t, np.zeros(7))

    def send(self, t: np.ndarray, beyond: np.ndarray) -> np.ndarray:
        """Joint targets ``beyond`` [rad] the motion at some of its times [s]; where it is at the last, (dof,) [rad]."""
        servo = self.request.settings.servo
        q, dq, _ = self.motion.sample(t)
        self.contact = self.contact or self.world.play(q + servo.kd / servo.kp * dq + beyond).contact
        return q[-1]

    def look(self) -> None:
        outlook = self.planner.look(self.motion, self.t, self.world.s)
        self.outlooks.append(outlook)
        if outlook.motion is None:
            return
        self.planner.accept(outlook)
        self.next = outlook
        if self.t >= self.motion.duration_s:
            self.t, self.motion, self.next = 0.0, outlook.motion, None

    def run(self, *, reactive: bool) -> float:
        for step in range(400):
            self.step()
            if reactive and self.next is None and step % LOOK_STEPS == 0:
                self.look()
            ended = self.next is None and self.t > self.motion.duration_s + 0.5
            if ended and (not reactive or self.outlooks[-1].motion is None):
                return self.request.s_target - self.world.s
        raise AssertionError("the motion did not end")


class IntegralPlay(Play):
    """The drives have an integral part: pushing or not, the arm gets to where it is sent."""

    beyond = np.zeros(7)

    def drive(self, t: np.ndarray) -> None:
        for some in np.split(t, len(t) // 5):
            q = self.send(some, self.beyond)
            self.beyond = self.beyond + 0.1 * (q - self.world.q)


def test_an_object_as_believed_is_left_to_the_first_motion(planned):
    play = Play(planned, Belief())
    assert abs(play.run(reactive=True)) < 0.002
    assert all(outlook.motion is None for outlook in play.outlooks)
    assert all(abs(outlook.offset) < 0.001 for outlook in play.outlooks)


@pytest.mark.parametrize("every_s", [0.05, 0.2])
def test_a_motion_that_allows_for_what_the_servos_lack_is_left_alone(heavy, every_s, monkeypatch):
    """In the model it ends short of the target, on purpose; before it pushes nothing to the contrary is seen."""
    monkeypatch.setattr(f"{__name__}.LOOK_STEPS", round(every_s / STEP_S))
    planned, yields = heavy
    assert yields > 0.0015
    play = IntegralPlay(planned, Belief(), yields)
    assert abs(play.run(reactive=True)) < 0.001
    assert all(outlook.motion is None for outlook in play.outlooks)
    assert play.outlooks[-1].offset == pytest.approx(yields, abs=3e-4)


def test_a_planner_that_is_not_told_what_the_servos_lack_takes_the_motion_for_a_short_one(heavy):
    play = IntegralPlay(heavy[0], Belief())
    play.run(reactive=True)
    first = next(outlook for outlook in play.outlooks if outlook.motion is not None)
    assert first.new_end > first.running_end + 0.001


@pytest.mark.parametrize("shift_m", [-0.004, 0.004])
def test_an_object_beside_its_model_is_moved_nearer_to_the_target_than_without_looking(planned, shift_m):
    truth = Belief((shift_m, 0.002, 0.0), 1.3, 1.5, 1.4)
    open_loop = Play(planned, truth).run(reactive=False)
    play = Play(planned, truth)
    error = play.run(reactive=True)
    assert abs(open_loop) > 0.0025
    assert abs(error) < 0.8 * abs(open_loop)
    assert play.contact is None
    assert any(outlook.motion is not None for outlook in play.outlooks)


def test_a_continuation_begins_exactly_where_the_running_motion_is_and_ends_at_rest(planned):
    play = Play(planned, Belief((-0.004, 0.0, 0.0), 1.3, 1.5, 1.4))
    motion_before = play.motion
    play.run(reactive=True)
    outlook = next(o for o in play.outlooks if o.motion is not None)
    assert outlook.motion is not None
    there = motion_before.sample(outlook.splice_t)
    for mine, theirs in zip(
        (outlook.motion.q[0], outlook.motion.dq[0], outlook.motion.ddq[0]), there, strict=True
    ):
        assert mine == pytest.approx(theirs, abs=1e-9)
    assert not outlook.motion.dq[-1].any()
    assert not outlook.motion.ddq[-1].any()
    for order, limit in ((1, ARM.limits.dq_max), (2, ARM.limits.ddq_max), (3, ARM.limits.dddq_max)):
        assert (outlook.motion.peak(order) <= limit).all()


def test_an_object_that_somebody_moved_is_taken_as_it_is_and_not_for_a_displaced_one(planned):
    _, _, _, motion = planned
    play = Play(planned, Belief())
    for _ in range(8):
        play.step()
    play.look()
    before = play.planner.look(play.motion, play.t, play.world.s)
    moved = play.planner.look(play.motion, play.t, play.world.s + 0.05)
    assert moved.offset == before.offset
    assert moved.running_end > before.running_end - 0.001
    assert motion.duration_s > play.t


def test_the_sampler_is_asked_only_when_the_running_motion_misses(planned):
    request, scene, hook, motion = planned
    other = replace(request, s_target=0.13)
    outlook = ReactivePlanner(other, scene, hook).look(motion, motion.duration_s, 0.10)
    assert outlook.motion is not None
    assert outlook.running_end == pytest.approx(0.10, abs=0.003)
    assert outlook.new_end > 0.105


def test_a_motion_to_rest_that_cannot_be_held_inside_the_limits_is_refused():
    rest = np.zeros(7)
    fast = ARM.limits.dq_max.copy()
    low = (ARM.limits.q_max - 0.01, fast, rest)
    with pytest.raises(TrajectoryError):
        to_rest(low, ARM.limits.q_max - 0.005, ARM, 0.2)
