"""Lock-step: which silence of the stand-in is a lost answer, and which is only a busy machine."""

from __future__ import annotations

import time

from hil_bench import ARM_, DEADLINE_S, STOP_BEGUN

from s2r_protocol.faults import Cause, ExecutorState

ANSWER_TIMEOUT_S = 0.05
STALL_S = 1.0  # twenty time-outs; a longer one on a busy machine proves the same


def test_a_stand_in_that_stalls_is_no_lost_answer(make_bench):
    """A machine or disk that stalls for three time-outs used to end a run with FEEDBACK_LOST.

    The core sent its next setpoint after every time-out, so the answers' age grew by the wall clock although nobody
    had lost one. A stand-in says itself when a period is over: before that, simulated time stands still.
    """
    bench = make_bench(answer_timeout_s=ANSWER_TIMEOUT_S)
    bench.moving()
    for _ in range(2):
        before = bench.tick
        time.sleep(STALL_S)
        assert bench.tick == before
        bench.step(20)
    bench.until(lambda s: s.plan_done)
    assert bench.events(STOP_BEGUN) == []
    bench.judge()


def test_a_period_that_ends_without_an_answer_is_a_lost_answer_at_once(make_bench):
    bench = make_bench(answer_timeout_s=ANSWER_TIMEOUT_S)
    bench.moving()
    before = bench.tick
    bench.lose(0x181, 3)
    bench.until(lambda s: s.state == ExecutorState.STOP1, 10)
    assert bench.tick - before <= 5
    assert [Cause(int(e["cause"])) for e in bench.events(STOP_BEGUN)] == [Cause.FEEDBACK_LOST]


def test_on_a_bus_that_does_not_announce_periods_silence_is_loss_after_the_time_out(make_bench):
    bench = make_bench(answer_timeout_s=ANSWER_TIMEOUT_S)
    bench.bus.announces_periods = False
    bench.step(3)
    bench.command(ARM_)
    bench.step(400)  # to HOLD; a machine that stalls here is silence as well, and the test the same
    deadline = time.monotonic() + DEADLINE_S
    while bench.now.cause != Cause.FEEDBACK_LOST:
        bench.shared.beat()
        assert time.monotonic() < deadline, "silence is taken for an answer"
        time.sleep(0.01)
