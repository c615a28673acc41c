"""What reaches the core and what does not, with a core that plays plans perfectly."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_executor.config import load_config
from s2r_executor.front_end import FrontEnd
from s2r_executor.plan import CommandRefusedError
from s2r_protocol.codec import Address
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb


class NoRecorder:
    """Remembers what it was told."""

    def __init__(self):
        self.opened, self.dropped = [], []

    def open_plan(self, identity, wire):
        self.opened.append((identity, wire))

    def drop_plan(self, plan_id, reason):
        self.dropped.append((plan_id, reason))

    def feed(self, records, events, holder):
        pass


@pytest.fixture
def rig(arm, core):
    clock = SimpleNamespace(now=100.0)
    recorder = NoRecorder()
    front_end = FrontEnd(
        arm, load_config(overrides={"bus": "can:none"}), core, recorder, now_s=lambda: clock.now
    )
    return SimpleNamespace(front_end=front_end, core=core, clock=clock, recorder=recorder, seq=0)


def address(rig, sender="host:1", **changes):
    rig.seq += 1
    me = rig.front_end.identity
    return Address(
        **{
            **{
                "sender": sender,
                "boot_id": me.boot_id,
                "epoch": rig.core.epoch,
                "seq": rig.seq,
                "model_hash": me.model_hash,
                "limit_hash": me.limit_hash,
            },
            **changes,
        }
    )


def armed(rig):
    rig.front_end.lease(address(rig), release=False)
    rig.front_end.control(address(rig), pb.ARM, 0.0)
    return rig


def code_of(call, *arguments):
    with pytest.raises(CommandRefusedError) as error:
        call(*arguments)
    assert str(error.value)
    return error.value.code


def test_a_plan_runs_and_the_status_shows_the_hosts_number(rig, smooth_plan):
    armed(rig)
    who = address(rig)
    accepted = rig.front_end.plan(who, smooth_plan(), b"wire")
    assert accepted.duration_s == 2.0
    assert rig.front_end.status().plan_seq == who.seq
    assert rig.core.submitted[0].stop_duration.shape == (11,)
    assert rig.recorder.opened[0][0].seq == who.seq
    assert rig.recorder.opened[0][1] == b"wire"
    rig.core.advance(2000)
    assert rig.front_end.status().core.plan_done


def test_nothing_moves_without_the_lease(rig, smooth_plan):
    assert code_of(rig.front_end.control, address(rig), pb.ARM, 0.0) is Refusal.NO_LEASE
    armed(rig)
    assert code_of(rig.front_end.plan, address(rig, sender="other"), smooth_plan(), b"") is Refusal.NO_LEASE
    assert rig.core.submitted == []


def test_a_stop_needs_neither_lease_nor_epoch_nor_process(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    epoch = rig.core.epoch
    accepted = rig.front_end.control(Address(sender="anybody"), pb.STOP, 0.0)
    assert rig.core.state == ExecutorState.HOLD
    assert rig.core.cause == Cause.STOP_REQUESTED
    assert accepted.epoch == epoch + 1


def test_after_a_stop_old_epochs_are_refused_until_the_sender_catches_up(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    late = address(rig)
    rig.front_end.stop(Cause.STOP_REQUESTED)
    assert code_of(rig.front_end.plan, late, smooth_plan(start=rig.core.q), b"") is Refusal.STALE
    rig.front_end.plan(address(rig), smooth_plan(start=rig.core.q), b"")


def test_a_plan_is_refused_unless_the_arm_holds(rig, smooth_plan):
    rig.front_end.lease(address(rig), release=False)
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.STATE
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.STATE
    assert len(rig.core.submitted) == 1


def test_a_refused_plan_leaves_the_running_state_unchanged(rig, smooth_plan):
    armed(rig)
    before = rig.core.snapshot()
    bad = smooth_plan()
    bad.q[3, 2] = np.nan
    assert code_of(rig.front_end.plan, address(rig), bad, b"") is Refusal.NONFINITE
    after = rig.core.snapshot()
    assert (after.state, after.epoch, after.plan_id) == (before.state, before.epoch, before.plan_id)
    assert rig.recorder.opened == []


def test_a_stop_during_admission_voids_the_plan(rig, smooth_plan, monkeypatch):
    armed(rig)
    admit = rig.front_end._admission.admit

    def slow(request, q_ref):
        rig.front_end.stop(Cause.STOP_REQUESTED)
        return admit(request, q_ref)

    monkeypatch.setattr(rig.front_end._admission, "admit", slow)
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.STALE
    assert rig.core.submitted == []


def test_a_plan_the_core_refuses_is_reported_with_its_code_and_not_recorded(rig, smooth_plan, monkeypatch):
    armed(rig)
    submit = rig.core.submit_plan

    def outdated(plan_id, epoch, *rest, **more):
        rig.core.epoch += 1  # a stop inside the core, after the front end looked
        result = submit(plan_id, epoch, *rest, **more)
        rig.front_end.step()
        return result

    monkeypatch.setattr(rig.core, "submit_plan", outdated)
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.STALE
    assert len(rig.recorder.dropped) == 1


def test_a_full_ring_is_an_error_and_not_a_silent_loss(rig, smooth_plan):
    armed(rig)
    rig.core.ring_full = True
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.INTERNAL
    assert code_of(rig.front_end.control, address(rig), pb.STOP, 0.0) is Refusal.INTERNAL


def test_a_dead_core_is_said_so(rig):
    armed(rig)
    rig.core.alive = False
    assert code_of(rig.front_end.control, address(rig), pb.DISARM, 0.0) is Refusal.STATE
    assert "not running" in rig.front_end.status().why_not_moving


@pytest.mark.parametrize(
    ("kind", "state"),
    [
        (pb.ARM, ExecutorState.HOLD),
        (pb.ARM, ExecutorState.FAULT),
        (pb.PAUSE, ExecutorState.HOLD),
        (pb.RESUME, ExecutorState.RUN),
        (pb.SET_SPEED, ExecutorState.DISARMED),
        (pb.RESET, ExecutorState.HOLD),
        (pb.DISARM, ExecutorState.RUN),
    ],
)
def test_commands_are_refused_in_states_where_they_mean_nothing(rig, kind, state):
    armed(rig)
    rig.core.state = state
    before = list(rig.core.commands)
    assert code_of(rig.front_end.control, address(rig), kind, 0.5) is Refusal.STATE
    assert rig.core.commands == before


@pytest.mark.parametrize("kind", [0, 99, 100])
def test_unknown_commands_and_quit_never_reach_the_core(rig, kind):
    armed(rig)
    before = list(rig.core.commands)
    assert code_of(rig.front_end.control, address(rig), kind, 0.0) is Refusal.MALFORMED
    assert rig.core.commands == before


@pytest.mark.parametrize(
    ("value", "good"), [(1.0, True), (1e-3, True), (0.0, False), (1.0001, False), (float("nan"), False)]
)
def test_speed_scale_is_above_zero_and_at_most_one(rig, value, good):
    armed(rig)
    if good:
        rig.front_end.control(address(rig), pb.SET_SPEED, value)
        assert rig.core.commands[-1][0] == pb.SET_SPEED
    else:
        assert code_of(rig.front_end.control, address(rig), pb.SET_SPEED, value) is Refusal.VELOCITY


def test_arming_that_ends_in_a_fault_is_refused_with_the_reason(rig):
    rig.core.refuses_arm = True
    rig.front_end.lease(address(rig), release=False)
    with pytest.raises(CommandRefusedError, match=r"did not reach 'operation enabled'"):
        rig.front_end.control(address(rig), pb.ARM, 0.0)


# -- host loss ----------------------------------------------------------------------------------------


def test_silence_of_the_holder_stops_the_arm_once_with_its_cause(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    for _ in range(10):
        rig.clock.now += 0.01
        rig.front_end.heartbeat(address(rig))
        rig.front_end.step()
    assert rig.core.state == ExecutorState.RUN
    rig.clock.now += 0.049
    rig.front_end.step()
    assert rig.core.state == ExecutorState.RUN
    rig.clock.now += 0.002
    rig.front_end.step()
    rig.front_end.step()
    assert rig.core.state == ExecutorState.HOLD
    assert rig.core.cause == Cause.HOST_LOST
    assert [c for c in rig.core.commands if c[0] == pb.STOP] == [(pb.STOP, 2, float(Cause.HOST_LOST))]


def test_the_lease_does_not_come_back_by_itself_after_silence(rig, smooth_plan):
    armed(rig)
    rig.clock.now += 1.0
    rig.front_end.step()
    rig.front_end.heartbeat(address(rig))
    assert rig.front_end.status().lease_holder == ""
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.NO_LEASE


def test_silence_while_holding_ends_the_lease_without_a_stop(rig):
    armed(rig)
    rig.clock.now += 1.0
    rig.front_end.step()
    assert rig.core.state == ExecutorState.HOLD
    assert all(kind != pb.STOP for kind, _, _ in rig.core.commands)


def test_giving_the_lease_back_in_motion_stops_the_arm(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    rig.front_end.lease(address(rig), release=True)
    assert rig.core.state == ExecutorState.HOLD
    assert rig.core.cause == Cause.HOST_LOST


def test_heartbeats_for_another_process_do_not_count(rig):
    armed(rig)
    rig.clock.now += 0.06
    rig.front_end.heartbeat(address(rig, boot_id=1))
    rig.front_end.step()
    assert rig.front_end.status().lease_holder == ""


def test_every_step_beats_the_core(rig):
    before = rig.core.beats
    for _ in range(5):
        rig.front_end.step()
    assert rig.core.beats == before + 5


def test_a_stop_does_not_wait_for_a_slow_admission(rig, smooth_plan, monkeypatch):
    armed(rig)
    entered, leave = threading.Event(), threading.Event()

    def stuck(request, q_ref):
        entered.set()
        assert leave.wait(10)
        raise CommandRefusedError(Refusal.TIME, "stuck")

    monkeypatch.setattr(rig.front_end._admission, "admit", stuck)
    worker = threading.Thread(
        target=lambda: code_of(rig.front_end.plan, address(rig), smooth_plan(), b""), daemon=True
    )
    worker.start()
    assert entered.wait(10)
    rig.core.state = ExecutorState.RUN
    rig.front_end.control(Address(sender="anybody"), pb.STOP, 0.0)
    assert rig.core.state == ExecutorState.HOLD
    leave.set()
    worker.join(10)


def test_shut_down_stops_on_the_path_and_disarms(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    started = time.monotonic()
    assert rig.front_end.shut_down(timeout_s=5.0)
    assert time.monotonic() - started < 4.0
    assert rig.core.state == ExecutorState.DISARMED


def test_addresses_for_another_arm_are_refused_before_anything_else(rig, smooth_plan):
    armed(rig)
    wrong = replace(address(rig), model_hash=b"x" * 32)
    for call, rest in (
        (rig.front_end.plan, (smooth_plan(), b"")),
        (rig.front_end.control, (pb.DISARM, 0.0)),
        (rig.front_end.lease, (False,)),
        (rig.front_end.check_door, ()),
    ):
        assert code_of(call, wrong, *rest) is Refusal.MODEL


def capped(arm, core, cap):
    config = load_config(overrides={"bus": "can:none"})
    front_end = FrontEnd(arm, config, core, NoRecorder(), speed_cap=cap)
    return SimpleNamespace(front_end=front_end, core=core, seq=0)


def test_a_degraded_machine_is_capped_before_any_plan_can_start(arm, core):
    armed(capped(arm, core, 0.25))
    assert core.speed == 0.25
    kinds = [kind for kind, _, _ in core.commands]
    assert kinds == [pb.ARM, pb.SET_SPEED]


def test_a_speed_above_the_cap_is_refused_and_below_it_taken(arm, core):
    rig = armed(capped(arm, core, 0.25))
    with pytest.raises(
        CommandRefusedError, match=r"0\.26 is outside \(0, 0\.25\]; this machine allows no more"
    ):
        rig.front_end.control(address(rig), pb.SET_SPEED, 0.26)
    rig.front_end.control(address(rig), pb.SET_SPEED, 0.2)
    assert core.speed == 0.2


def test_a_core_that_does_not_take_the_cap_is_disarmed_again(arm, core, monkeypatch):
    rig = capped(arm, core, 0.25)
    taken = core.command
    monkeypatch.setattr(core, "command", lambda kind, *rest: kind == pb.SET_SPEED or taken(kind, *rest))
    monkeypatch.setattr("s2r_executor.front_end._ANSWER_WITHIN_S", 0.01)
    rig.front_end.lease(address(rig), release=False)
    with pytest.raises(CommandRefusedError, match="did not take the speed cap"):
        rig.front_end.control(address(rig), pb.ARM, 0.0)
    assert core.state == ExecutorState.DISARMED
