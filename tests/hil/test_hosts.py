"""T01 to T05, T53: whoever commands falls silent, comes back, or is not alone. Front end in virtual time, real core."""

from __future__ import annotations

import pytest
from hil_bench import STOP_BEGUN, WATCHDOG, Stepped
from hil_front_end import Rig, move

from s2r_executor.plan import CommandRefusedError
from s2r_protocol.can.drive import DriveState
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_sim.bus.oracle import Stop


@pytest.fixture
def rig(make_bench):
    rig = Rig(make_bench(collision_share=10.0))
    rig.arm()
    rig.send(move(rig.bench.now.q_ref))
    rig.tick(700)
    assert rig.bench.now.state == ExecutorState.RUN
    return rig


def silent_host(rig):
    """The host falls silent; returns the tick of its last sign of life, once the arm rests."""
    rig.host_lives = False
    last = rig.beats[-1]
    rig.until(lambda s: s.state == ExecutorState.HOLD, 3000)
    rig.tick(30)
    rig.bench.one_cause(Cause.HOST_LOST)
    assert rig.bench.events(STOP_BEGUN)[0]["tick"] - last <= 60
    assert list(rig.bench.now.drive_state) == [DriveState.OPERATION_ENABLED] * 7
    rig.bench.judge(Stop(last, 60, 2.0, off=False))
    return last


def test_t01_a_killed_host_is_a_stop_on_the_path_within_sixty_milliseconds(rig):
    silent_host(rig)
    assert rig.front_end.status().lease_holder == ""


def test_t02_a_host_that_was_frozen_finds_its_lease_gone(rig):
    silent_host(rig)
    rig.host_lives = True
    rig.tick(100)
    assert rig.front_end.status().lease_holder == ""
    with pytest.raises(CommandRefusedError) as caught:
        rig.send(move(rig.bench.now.q_ref))
    assert caught.value.code is Refusal.NO_LEASE
    rig.tick(50)
    assert rig.bench.now.state == ExecutorState.HOLD


def test_t03_a_host_that_pauses_thirty_milliseconds_is_only_counted(rig):
    rig.tick((-rig.ticks) % 10)
    rig.host_lives = False
    late = rig.front_end._lease.late_beats
    rig.tick(30)
    rig.host_lives = True
    rig.until(lambda s: s.plan_done)
    assert rig.front_end._lease.late_beats == late + 1
    assert rig.bench.events(STOP_BEGUN) == []
    rig.bench.judge()


def test_t04_a_network_that_comes_back_alone_resumes_nothing(rig):
    silent_host(rig)
    rig.host_lives = True
    q = rig.bench.now.q_ref
    rig.tick(500)
    assert rig.bench.now.state == ExecutorState.HOLD
    assert (rig.bench.now.q_ref == q).all()
    rig.bench.judge()
    rig.front_end.lease(rig.address(), release=False)
    rig.send(move(rig.bench.now.q_ref, 0.1))
    rig.until(lambda s: s.plan_done)
    rig.bench.judge()


@pytest.mark.parametrize("timeout_s", [0.02, 0.1])
def test_t05_a_silent_front_end_is_a_stop_on_the_path_within_its_limit(timeout_s):
    bench = Stepped(front_end_timeout_s=timeout_s)
    bench.moving()
    bench.beats = False
    tick = bench.now.tick
    bench.until(lambda s: s.state == ExecutorState.HOLD, 3000)
    bench.step(30)
    (begun,) = bench.events(STOP_BEGUN)
    assert begun["cause"] == Cause.FRONT_END_LOST
    assert begun["tick"] - tick <= timeout_s * 1e3 + 1
    bench.judge(Stop(tick, int(timeout_s * 1e3) + 1, 0.6, off=False))


def test_t05_after_the_front_end_has_died_the_core_goes_on_holding(rig):
    rig.front_end_lives = rig.host_lives = False
    rig.bench.takes_events = True
    rig.until(lambda s: s.state == ExecutorState.HOLD, 3000)
    rig.tick(1000)
    rig.bench.one_cause(Cause.FRONT_END_LOST)
    assert len([e for e in rig.bench.events(WATCHDOG) if e["cause"] == Cause.FRONT_END_LOST]) == 1
    assert list(rig.bench.now.drive_state) == [DriveState.OPERATION_ENABLED] * 7
    rig.bench.judge()


def test_t53_of_two_hosts_exactly_one_gets_the_lease_and_the_other_is_told(rig):
    decision = rig.front_end.lease(rig.address("host:b"), release=False)
    assert not decision.granted
    assert decision.holder == "host:a"
    assert "'host:a' holds the lease" in decision.reason
    with pytest.raises(CommandRefusedError) as caught:
        rig.front_end.control(rig.address("host:b"), pb.PAUSE, 0.0)
    assert caught.value.code is Refusal.NO_LEASE
    rig.front_end.control(rig.address("host:b"), pb.STOP, 0.0)  # anybody may stop
    rig.until(lambda s: s.state == ExecutorState.HOLD)
    rig.bench.one_cause(Cause.STOP_REQUESTED)
