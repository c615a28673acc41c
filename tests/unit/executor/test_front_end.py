"""What reaches the core and what does not; the core is the native one, in virtual time."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_executor.config import load_config
from s2r_executor.front_end import FrontEnd
from s2r_executor.plan import CommandRefusedError
from s2r_executor.quintic import sample, spline_through
from s2r_protocol.can import fd
from s2r_protocol.can.frames import CanFrame
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
    return make_rig(arm, core, clock=clock, recorder=recorder)


def make_rig(arm, core, speed_cap=1.0, **parts):
    """A front end whose waiting moves the core's time and its own watch loop."""
    rig = SimpleNamespace(core=core, seq=0, **{"clock": SimpleNamespace(now=100.0), **parts})

    def idle():
        core.advance()
        rig.front_end.step()

    rig.front_end = FrontEnd(
        arm,
        load_config(overrides={"bus": "can:none"}),
        core,
        parts.get("recorder", NoRecorder()),
        now_s=lambda: rig.clock.now,
        idle=idle,
        speed_cap=speed_cap,
    )
    return rig


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
    rig.core.advance(700)
    accepted = rig.front_end.control(Address(sender="anybody"), pb.STOP, 0.0)
    assert rig.core.state == ExecutorState.STOPPING
    assert rig.core.cause == Cause.STOP_REQUESTED
    assert accepted.epoch == epoch + 1
    rig.core.until(ExecutorState.HOLD)


def test_after_a_stop_old_epochs_are_refused_until_the_sender_catches_up(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    late = address(rig)
    rig.front_end.stop(Cause.STOP_REQUESTED)
    rig.core.until(ExecutorState.HOLD)
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
        rig.core.command(pb.STOP, epoch)  # after the front end looked
        rig.core.advance()
        return submit(plan_id, epoch, *rest, **more)

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
    rig.core.die()
    assert code_of(rig.front_end.control, address(rig), pb.DISARM, 0.0) is Refusal.STATE
    assert "not running" in rig.front_end.status().why_not_moving


def bring_to(rig, state, smooth_plan):
    """From HOLD to the state, by whatever leads there."""
    if state == ExecutorState.DISARMED:
        rig.front_end.control(address(rig), pb.DISARM, 0.0)
    elif state == ExecutorState.RUN:
        rig.front_end.plan(address(rig), smooth_plan(), b"")
    elif state == ExecutorState.FAULT:
        rig.core.drives[0].brake_released, rig.core.drives[0].brake_stuck = False, False
        rig.core.until(ExecutorState.FAULT)


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
def test_commands_are_refused_in_states_where_they_mean_nothing(rig, smooth_plan, kind, state):
    armed(rig)
    bring_to(rig, state, smooth_plan)
    assert rig.core.state == state
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
        assert rig.core.speed_set == value
    else:
        assert code_of(rig.front_end.control, address(rig), pb.SET_SPEED, value) is Refusal.VELOCITY


def test_arming_that_ends_in_a_fault_is_refused_with_the_reason(rig):
    rig.core.drives[1].brake_stuck = False
    rig.front_end.lease(address(rig), release=False)
    with pytest.raises(CommandRefusedError, match=r"ARM ended in FAULT instead of HOLD.*'joint2': a brake"):
        rig.front_end.control(address(rig), pb.ARM, 0.0)


def test_arming_that_a_stop_ends_is_refused_at_once(rig, monkeypatch):
    idle = rig.front_end._idle

    def stop_while_arming():
        idle()
        if rig.core.state == ExecutorState.ARMING:
            rig.core.command(pb.STOP, rig.core.epoch)

    monkeypatch.setattr(rig.front_end, "_idle", stop_while_arming)
    rig.front_end.lease(address(rig), release=False)
    with pytest.raises(CommandRefusedError, match="ARM ended in DISARMED instead of HOLD"):
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
    rig.core.advance()
    rig.front_end.step()
    rig.core.until(ExecutorState.HOLD)
    assert rig.core.cause == Cause.HOST_LOST
    assert [c for c in rig.core.commands if c[0] == pb.STOP] == [(pb.STOP, 2, float(Cause.HOST_LOST))]


def test_the_lease_does_not_come_back_by_itself_after_silence(rig, smooth_plan):
    armed(rig)
    rig.clock.now += 1.0
    rig.front_end.step()
    rig.front_end.heartbeat(address(rig))
    assert rig.front_end.status().lease_holder == ""
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.NO_LEASE


def test_a_host_that_was_frozen_is_told_that_its_heartbeat_fell_silent(rig, smooth_plan):
    armed(rig)
    rig.clock.now += rig.front_end.config.effective_host_timeout_s + 8.0
    rig.front_end.step()
    with pytest.raises(
        CommandRefusedError, match=r"'host:1' lost the lease, nobody holds it now: its heartbeat"
    ):
        rig.front_end.plan(address(rig), smooth_plan(), b"")
    with pytest.raises(CommandRefusedError, match="'other' does not hold the lease"):
        rig.front_end.plan(address(rig, "other"), smooth_plan(), b"")


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
    rig.core.advance()
    rig.core.until(ExecutorState.HOLD)
    assert rig.core.cause == Cause.HOST_LOST


def falls_silent(rig):
    rig.clock.now += 1.0
    rig.front_end.step()


def gives_back(rig):
    rig.front_end.lease(address(rig), release=True)


def another_takes_over(rig):
    falls_silent(rig)
    assert rig.front_end.lease(address(rig, "other"), release=False).granted


@pytest.mark.parametrize("ends", [falls_silent, gives_back, another_takes_over])
def test_a_plan_whose_sender_loses_the_lease_during_its_admission_does_not_start(
    rig, smooth_plan, monkeypatch, ends
):
    armed(rig)
    admit = rig.front_end._admission.admit

    def slow(request, q_ref):
        ends(rig)
        return admit(request, q_ref)

    monkeypatch.setattr(rig.front_end._admission, "admit", slow)
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.NO_LEASE
    assert rig.core.submitted == []


def test_a_plan_that_starts_just_as_the_lease_ends_is_stopped(rig, smooth_plan, monkeypatch):
    armed(rig)
    submit = rig.core.submit_plan

    def late(*arguments, **more):
        falls_silent(rig)  # the watch sees an arm at rest
        return submit(*arguments, **more)

    monkeypatch.setattr(rig.core, "submit_plan", late)
    assert code_of(rig.front_end.plan, address(rig), smooth_plan(), b"") is Refusal.NO_LEASE
    rig.core.advance()
    rig.core.until(ExecutorState.HOLD)
    assert rig.core.cause == Cause.HOST_LOST
    assert not rig.core.plan_done


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
    who = address(rig)
    rig.front_end.plan(who, smooth_plan(), b"")
    entered, leave = threading.Event(), threading.Event()

    def stuck(request, start):
        entered.set()
        assert leave.wait(10)
        raise CommandRefusedError(Refusal.TIME, "stuck")

    monkeypatch.setattr(rig.front_end._admission, "admit_splice", stuck)
    next_plan = smooth_plan(parent_seq=who.seq, splice_t=1.0)
    worker = threading.Thread(
        target=lambda: code_of(rig.front_end.plan, address(rig), next_plan, b""), daemon=True
    )
    worker.start()
    assert entered.wait(10)
    rig.front_end.control(Address(sender="anybody"), pb.STOP, 0.0)
    assert rig.core.cause == Cause.STOP_REQUESTED
    assert rig.core.state in (ExecutorState.STOPPING, ExecutorState.HOLD)
    leave.set()
    worker.join(10)


def test_shut_down_stops_on_the_path_and_disarms(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    rig.core.advance(700)
    assert rig.front_end.shut_down()
    assert rig.core.state == ExecutorState.DISARMED


def test_whoever_moved_the_arm_is_told_that_the_executor_ends(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    rig.core.advance(300)
    rig.front_end.shut_down()
    assert rig.front_end.status().why_not_moving.startswith(
        "The executor is being ended (Ctrl-C, SIGTERM or a lost terminal there)"
    )


def test_shut_down_with_a_brake_that_does_not_close_says_so_and_keeps_the_power(rig):
    armed(rig)
    rig.core.drives[1].brake_stuck = True
    assert not rig.front_end.shut_down()
    assert rig.core.state == ExecutorState.HOLD


@pytest.mark.parametrize(
    ("state", "in_order"),
    [(ExecutorState.DISARMED, True), (ExecutorState.HOLD, False), (ExecutorState.RUN, False)],
)
def test_shut_down_of_a_core_that_has_ended_is_good_if_its_drives_were_off(rig, smooth_plan, state, in_order):
    bring_to(armed(rig), state, smooth_plan)
    rig.core.die()
    assert rig.front_end.shut_down() is in_order


@pytest.mark.parametrize("in_order", [True, False])
def test_a_core_that_ends_while_it_is_shut_down_is_good_if_its_drives_are_off(
    rig, monkeypatch, caplog, in_order
):
    armed(rig)
    command = rig.core.command

    def ends(*order):
        taken = command(*order)
        if in_order:
            rig.core.until(ExecutorState.DISARMED)
        rig.core.die()
        return taken

    monkeypatch.setattr(rig.core, "command", ends)
    assert rig.front_end.shut_down() is in_order
    assert ("not switched off" in caplog.text) is not in_order


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


def test_a_degraded_machine_is_capped_before_any_plan_can_start(arm, core):
    armed(make_rig(arm, core, speed_cap=0.25))
    assert core.speed_set == 0.25
    kinds = [kind for kind, _, _ in core.commands]
    assert kinds == [pb.ARM, pb.SET_SPEED]


def test_a_speed_above_the_cap_is_refused_and_below_it_taken(arm, core):
    rig = armed(make_rig(arm, core, speed_cap=0.25))
    with pytest.raises(
        CommandRefusedError, match=r"0\.26 is outside \(0, 0\.25\]; this machine allows no more"
    ):
        rig.front_end.control(address(rig), pb.SET_SPEED, 0.26)
    rig.front_end.control(address(rig), pb.SET_SPEED, 0.2)
    assert core.speed_set == 0.2


def losing(rig, monkeypatch, kind):
    """Commands of this kind never reach the core."""
    command = rig.core.command
    monkeypatch.setattr(rig.core, "command", lambda k, *rest: k == kind or command(k, *rest))


def test_a_core_that_does_not_take_the_cap_is_disarmed_again(arm, core, monkeypatch):
    rig = make_rig(arm, core, speed_cap=0.25)
    losing(rig, monkeypatch, pb.SET_SPEED)
    rig.front_end.lease(address(rig), release=False)
    with pytest.raises(CommandRefusedError, match="did not take the speed cap"):
        rig.front_end.control(address(rig), pb.ARM, 0.0)
    core.advance()
    core.until(ExecutorState.DISARMED)


# -- whether the core followed ------------------------------------------------------------------------


def running(rig, smooth_plan, ticks=700):
    """In the middle of a plan; returns it and its number."""
    armed(rig)
    who, plan = address(rig), smooth_plan()
    rig.front_end.plan(who, plan, b"")
    rig.core.advance(ticks)
    return plan, who.seq


def test_pause_is_answered_when_the_arm_stands_and_resume_when_it_goes_on(rig, smooth_plan):
    running(rig, smooth_plan)
    rig.front_end.control(address(rig), pb.PAUSE, 0.0)
    assert rig.core.state == ExecutorState.PAUSED
    rig.front_end.control(address(rig), pb.RESUME, 0.0)
    assert rig.core.state == ExecutorState.RUN
    rig.core.until(ExecutorState.HOLD)
    assert rig.core.plan_done


def test_a_pause_shortly_before_the_end_lets_the_plan_end(rig, smooth_plan):
    running(rig, smooth_plan, ticks=1997)
    rig.front_end.control(address(rig), pb.PAUSE, 0.0)
    assert (rig.core.state, rig.core.plan_done) == (ExecutorState.HOLD, True)


def test_a_speed_is_answered_when_the_core_has_taken_it(rig, smooth_plan):
    running(rig, smooth_plan)
    rig.front_end.control(address(rig), pb.SET_SPEED, 0.5)
    assert rig.core.speed_set == 0.5


@pytest.mark.parametrize("kind", [pb.PAUSE, pb.SET_SPEED])
def test_a_command_the_core_never_sees_is_not_called_accepted(rig, smooth_plan, monkeypatch, kind):
    running(rig, smooth_plan)
    losing(rig, monkeypatch, kind)
    monkeypatch.setattr(rig.front_end, "_wait", lambda done, limit_s: done(rig.core.snapshot()))
    assert code_of(rig.front_end.control, address(rig), kind, 0.5) is Refusal.INTERNAL


@pytest.mark.parametrize("kind", [pb.PAUSE, pb.SET_SPEED])
def test_a_command_that_the_core_refuses_is_refused_with_its_code(rig, smooth_plan, monkeypatch, kind):
    running(rig, smooth_plan)
    command = rig.core.command
    monkeypatch.setattr(rig.core, "command", lambda k, epoch, value=0.0: command(k, epoch - 1, value))
    assert code_of(rig.front_end.control, address(rig), kind, 0.5) is Refusal.STALE


def test_a_pause_that_a_stop_overtakes_is_not_called_accepted(rig, smooth_plan, monkeypatch):
    running(rig, smooth_plan)
    command = rig.core.command
    monkeypatch.setattr(
        rig.core, "command", lambda *order: command(*order) and command(pb.STOP, rig.core.epoch)
    )
    with pytest.raises(CommandRefusedError, match="PAUSE ended in STOPPING instead of PAUSED"):
        rig.front_end.control(address(rig), pb.PAUSE, 0.0)


def test_a_second_stop_while_the_arm_comes_to_rest_is_answered_at_once(rig, smooth_plan):
    running(rig, smooth_plan)
    first = rig.front_end.stop(Cause.STOP_REQUESTED)
    tick = rig.core.tick
    assert rig.front_end.stop(Cause.STOP_REQUESTED) == first
    assert rig.core.tick == tick
    assert rig.core.state == ExecutorState.STOPPING


def test_a_stop_to_a_dead_core_is_not_called_accepted(rig, smooth_plan):
    running(rig, smooth_plan)
    rig.core.die()
    with pytest.raises(CommandRefusedError, match="core is not running"):
        rig.front_end.control(Address(sender="anybody"), pb.STOP, 0.0)


def test_a_stop_the_core_never_sees_is_not_called_accepted(rig, smooth_plan, monkeypatch):
    running(rig, smooth_plan)
    losing(rig, monkeypatch, pb.STOP)
    monkeypatch.setattr("s2r_executor.front_end._STOP_WITHIN_S", 0.05)
    assert code_of(rig.front_end.stop, Cause.STOP_REQUESTED) is Refusal.INTERNAL


def asleep(rig, monkeypatch, call, *arguments):
    """The core sleeps for longer than an answer may take, and wakes up after it."""
    monkeypatch.setattr("s2r_executor.front_end._ANSWER_WITHIN_S", 0.05)
    monkeypatch.setattr(rig.front_end, "_wait", lambda done, limit_s=0.05: done(rig.core.snapshot()))
    assert code_of(call, *arguments) is Refusal.INTERNAL
    monkeypatch.undo()
    rig.core.advance(300)


def test_a_plan_that_the_core_did_not_take_in_time_does_not_start_later(rig, smooth_plan, monkeypatch):
    armed(rig)
    asleep(rig, monkeypatch, rig.front_end.plan, address(rig), smooth_plan(), b"")
    assert (rig.core.state, rig.core.plan_id) == (ExecutorState.HOLD, 0)
    assert len(rig.recorder.dropped) == 1
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    rig.core.until(ExecutorState.HOLD)
    assert rig.core.plan_done


def test_a_splice_that_the_core_did_not_take_in_time_does_not_take_over_later(rig, smooth_plan, monkeypatch):
    plan, seq = running(rig, smooth_plan, ticks=200)
    asleep(rig, monkeypatch, rig.front_end.plan, address(rig), continuation(plan, seq, 0.5), b"")
    rig.core.until(ExecutorState.HOLD)
    assert (rig.core.plan_id, rig.core.plan_done) == (1, False)


def test_an_arming_or_a_resume_that_the_core_did_not_take_in_time_does_not_happen_later(
    rig, smooth_plan, monkeypatch
):
    rig.front_end.lease(address(rig), release=False)
    asleep(rig, monkeypatch, rig.front_end.control, address(rig), pb.ARM, 0.0)
    assert rig.core.state == ExecutorState.DISARMED
    running(rig, smooth_plan, ticks=400)
    rig.front_end.control(address(rig), pb.PAUSE, 0.0)
    q = rig.core.q
    asleep(rig, monkeypatch, rig.front_end.control, address(rig), pb.RESUME, 0.0)
    assert rig.core.state == ExecutorState.HOLD
    np.testing.assert_allclose(rig.core.q, q, atol=1e-12)


class Asleep:
    """A snapshot of a core that has not ticked for so long that it counts as dead."""

    alive = False

    def __init__(self, snapshot):
        self._snapshot = snapshot

    def __getattr__(self, name):
        return getattr(self._snapshot, name)


def falling_asleep(rig, monkeypatch, call, *arguments):
    """The core sleeps as soon as it is given something, until it counts as dead, and wakes up later."""
    asleep, snapshot = [], rig.core.snapshot
    for name in ("command", "submit_plan"):
        give = getattr(rig.core, name)
        monkeypatch.setattr(rig.core, name, lambda *a, give=give, **k: asleep.append(1) or give(*a, **k))
    monkeypatch.setattr(rig.core, "snapshot", lambda: Asleep(snapshot()) if asleep else snapshot())
    assert code_of(call, *arguments) is Refusal.STATE
    monkeypatch.undo()
    rig.core.advance(300)


def test_what_a_core_got_that_slept_so_long_that_it_counts_as_dead_does_not_happen_later(
    rig, smooth_plan, monkeypatch
):
    rig.front_end.lease(address(rig), release=False)
    falling_asleep(rig, monkeypatch, rig.front_end.control, address(rig), pb.ARM, 0.0)
    assert rig.core.state == ExecutorState.DISARMED
    rig.front_end.control(address(rig), pb.ARM, 0.0)
    falling_asleep(rig, monkeypatch, rig.front_end.plan, address(rig), smooth_plan(), b"")
    assert (rig.core.state, rig.core.plan_id) == (ExecutorState.HOLD, 0)


def test_a_plan_to_a_core_that_dies_is_told_as_that(rig, smooth_plan, monkeypatch):
    armed(rig)
    submit = rig.core.submit_plan

    def last(*arguments, **more):
        rig.core.die()
        return submit(*arguments, **more)

    monkeypatch.setattr(rig.core, "submit_plan", last)
    with pytest.raises(CommandRefusedError, match="core is not running"):
        rig.front_end.plan(address(rig), smooth_plan(), b"")


def continuation(plan, seq, splice_t):
    """The rest of a plan, as a plan of its own that takes over from it."""
    spline = spline_through(plan.t, plan.q, plan.dq, plan.ddq)
    at = sample(spline, np.linspace(splice_t, plan.t[-1], 12))
    return replace(plan, t=at.t - splice_t, q=at.q, dq=at.dq, ddq=at.ddq, parent_seq=seq, splice_t=splice_t)


def test_plans_that_the_core_refused_leave_the_running_one_to_be_spliced(rig, smooth_plan, monkeypatch):
    plan, seq = running(rig, smooth_plan, ticks=200)
    admit = rig.front_end._admission.admit_splice

    def slowly(*arguments):
        admitted = admit(*arguments)
        rig.core.advance(100)  # the splice point passes meanwhile
        return admitted

    monkeypatch.setattr(rig.front_end._admission, "admit_splice", slowly)
    for _ in range(5):
        late = continuation(plan, seq, rig.core.plan_t + 0.06)
        assert code_of(rig.front_end.plan, address(rig), late, b"") is Refusal.LATE
    monkeypatch.undo()
    rig.front_end.plan(address(rig), continuation(plan, seq, 1.5), b"")
    rig.core.until(ExecutorState.HOLD)
    assert (rig.core.plan_id, rig.core.plan_done) == (7, True)


def test_what_is_known_of_plans_does_not_grow_with_every_plan(rig, smooth_plan):
    armed(rig)
    front_end = rig.front_end
    for _ in range(6):
        who = address(rig)
        front_end.plan(who, smooth_plan(start=rig.core.q), b"")
        assert front_end.status().plan_seq == who.seq
        front_end.stop(Cause.STOP_REQUESTED)
        rig.core.until(ExecutorState.HOLD)
        assert front_end.status().plan_seq == who.seq
    assert len(front_end._seq_of_plan) <= 3
    assert len(front_end._admitted) <= 3


# -- what the core refuses ----------------------------------------------------------------------------


def test_arming_with_a_drive_that_fell_silent_names_joint_age_and_limit(rig, monkeypatch):
    rig.front_end.lease(address(rig), release=False)
    answers = rig.core._nodes.answers
    monkeypatch.setattr(
        rig.core._nodes,
        "answers",
        lambda: [p for p in answers() if CanFrame.unpack(p).can_id != fd.STAT_ID + 3],
    )
    rig.core.advance(50)
    with pytest.raises(CommandRefusedError) as refused:
        rig.front_end.control(address(rig), pb.ARM, 0.0)
    error = refused.value
    assert str(error).startswith(
        "joint 'joint3' (index 2): the core refused ARM: its drive has not answered for 5"
    )
    assert "--packing and --clock" in str(error)
    assert (error.code, error.joint, error.quantity) == (Refusal.STATE, "joint3", "ticks without an answer")
    assert error.value > error.limit == rig.front_end.config.core.feedback_fault_ticks


def test_arming_beside_a_second_master_is_refused_for_it(rig):
    rig.front_end.lease(address(rig), release=False)
    rig.core.advance(5)
    rig.core._answers.append((0x000, b"\x01\x63", False))
    rig.core.advance()
    with pytest.raises(CommandRefusedError) as refused:
        rig.front_end.control(address(rig), pb.ARM, 0.0)
    error = refused.value
    assert str(error).startswith(
        "the core refused ARM: somebody else sends setpoints or network commands on the bus; mend that"
    )
    assert (error.code, error.joint, error.quantity) == (Refusal.STATE, "", "bus")


def test_arming_outside_a_position_limit_names_joint_place_and_limit(rig, arm):
    q = arm.limits.q_max[1] + 0.1
    rig.core._plant.q[1] = rig.core.drives[1]._q_brake = q
    rig.core.advance(20)
    rig.front_end.lease(address(rig), release=False)
    with pytest.raises(CommandRefusedError) as refused:
        rig.front_end.control(address(rig), pb.ARM, 0.0)
    error = refused.value
    assert str(error).startswith("joint 'joint2' (index 1): the core refused ARM: it stands at")
    assert (error.code, error.joint, error.quantity) == (Refusal.POSITION, "joint2", "position")
    assert error.limit == pytest.approx(arm.limits.q_max[1])


def test_a_reset_right_after_a_latch_waits_until_the_drives_have_braked(rig, smooth_plan):
    armed(rig)
    rig.front_end.plan(address(rig), smooth_plan(), b"")
    rig.core.advance(800)
    bring_to(rig, ExecutorState.FAULT, smooth_plan)
    rig.core.drives[0].brake_stuck = None
    latched = rig.core.tick
    rig.front_end.control(address(rig), pb.RESET, 0.0)
    assert rig.core.state == ExecutorState.DISARMED
    assert rig.core.tick - latched > 900


def test_a_stop_while_the_drives_are_off_voids_what_was_about_to_arm_and_move(rig):
    rig.front_end.lease(address(rig), release=False)
    before = address(rig)
    accepted = rig.front_end.control(Address(sender="anybody"), pb.STOP, 0.0)
    assert accepted.epoch == before.epoch + 1
    assert rig.core.state == ExecutorState.DISARMED
    assert code_of(rig.front_end.control, before, pb.ARM, 0.0) is Refusal.STALE
    assert "The last stop: a stop was requested." in rig.front_end.status().why_not_moving
