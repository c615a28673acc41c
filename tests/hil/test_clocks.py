"""T07, T29, T30, T31: time that stalls, jumps, drifts and wraps. Virtual time; T29 with the real ``s2r-rt``."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
from hil_bench import LIMITS, OVERRUN, STOP, STOP_BEGUN, Stepped, move

from s2r_protocol.can.drive import DriveState
from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.tick_clock import TickClock
from s2r_sim.bus.oracle import Stop, longest_joint_stop_s


def test_t07_a_stall_of_two_ticks_is_bridged_without_a_jerk():
    bench = Stepped()
    bench.moving()
    before = len(bench.drive_setpoints)
    bench.step(1, skipped=2)
    bench.until(lambda s: s.plan_done)
    assert (bench.now.overruns, bench.now.missed) == (1, 2)
    assert bench.events(STOP_BEGUN) == []
    bench.judge(gaps_allowed=True)
    # What the drives made of the gap: constant velocity for two periods, then back on the plan.
    q = np.array(bench.drive_setpoints[before - 5 : before + 8])
    assert np.abs(np.diff(q, n=2, axis=0)).max() / 1e-6 < 1.02 * LIMITS.ddq_max.max()


def test_t07_a_stall_of_five_ticks_is_a_category_one_stop():
    bench = Stepped()
    bench.moving()
    tick = bench.now.tick
    bench.step(1, skipped=5)
    assert bench.now.state == ExecutorState.STOP1
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    begun = bench.events(STOP_BEGUN)
    assert [int(e["cause"]) for e in begun] == [Cause.OVERRUN]
    assert begun[0]["value"] == 5
    bench.step(30)
    bench.judge(Stop(tick, 6, longest_joint_stop_s(LIMITS), off=True), gaps_allowed=True)


def test_t07_after_a_stall_of_twenty_ticks_the_drives_have_stopped_by_themselves():
    bench = Stepped()
    bench.moving()
    bench.step(1, skipped=20)
    assert [d.state for d in bench.plant.drives] == [DriveState.QUICK_STOP_ACTIVE] * 7
    bench.until(lambda s: s.state == ExecutorState.FAULT, 1500)
    assert [int(e["kind"]) for e in bench.events(OVERRUN)] == [OVERRUN]
    assert int(bench.events(STOP_BEGUN)[0]["cause"]) == Cause.OVERRUN
    bench.judge(gaps_allowed=True)


WALL_CLOCK = """
#include <dlfcn.h>
#include <sys/time.h>
#include <time.h>
/* The wall clock runs backwards, jumps by an hour every call and loses a leap second; the monotonic one is as ever. */
static long calls = 0;
int clock_gettime(clockid_t id, struct timespec *out) {
  static int (*real)(clockid_t, struct timespec *) = 0;
  if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  int result = real(id, out);
  if (id == CLOCK_REALTIME) out->tv_sec += (++calls % 2 ? 3600 : -3600) - calls;
  return result;
}
time_t time(time_t *out) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (out) *out = now.tv_sec;
  return now.tv_sec;
}
int gettimeofday(struct timeval *out, void *zone) {
  struct timespec now;
  (void)zone;
  clock_gettime(CLOCK_REALTIME, &now);
  out->tv_sec = now.tv_sec;
  out->tv_usec = now.tv_nsec / 1000;
  return 0;
}
"""


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler for the shim")
def test_t29_a_wall_clock_that_jumps_changes_not_one_bit_on_the_bus(make_bench, tmp_path):
    source, shim = tmp_path / "clock.c", tmp_path / "clock.so"
    source.write_text("#define _GNU_SOURCE\n" + WALL_CLOCK)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", shim, source, "-ldl"], check=True)
    logs = []
    for env in ({}, {"LD_PRELOAD": str(shim)}):
        bench = make_bench(env=env)
        bench.moving(500)
        bench.command(STOP)
        bench.until(lambda s: s.state == ExecutorState.HOLD)
        bench.step(50)
        bench.judge()
        logs.append(bench.log.frames())
    assert logs[0].tobytes() == logs[1].tobytes()


def test_t30_a_host_knows_the_executors_tick_to_a_millisecond_over_ten_hours_of_drift():
    """Virtual: a host clock 500 ppm off, asked once a second over a link of 0.1 to 5 ms, sometimes 50 ms."""
    random = np.random.default_rng(30)
    drift, tick_s, clock = 500e-6, 1e-3, TickClock(tick_s=1e-3)
    hits = errors = 0
    worst_s = 0.0
    for i in range(36_000):
        now_s = float(i)  # true time
        out_s, back_s = random.exponential(0.3e-3, 2) + 1e-4
        if random.random() < 0.01:
            back_s += 0.05
        sent, received = now_s * (1 + drift), (now_s + out_s + back_s) * (1 + drift)
        clock.observe(sent, int((now_s + out_s) / tick_s), received)
        if i < 20:  # it needs some answers first
            continue
        at_s = now_s + random.uniform(0.1, 1.0)
        error_s = abs(clock.tick_at(at_s * (1 + drift)) * tick_s - at_s)
        worst_s = max(worst_s, error_s)
        errors += error_s >= 1e-3
        hits += 1
    assert errors / hits <= 1e-3, f"{errors} of {hits}, worst {worst_s * 1e3:.2f} ms"
    assert worst_s < 2e-3


@pytest.mark.parametrize("wrap", [1 << 16, 1 << 32])
@pytest.mark.parametrize("ticks_before", [1, 300, 700])
def test_t31_a_counter_that_wraps_in_motion_is_no_event(wrap, ticks_before):
    plain, wrapping = Stepped(), Stepped(first_tick=wrap - ticks_before)
    for bench in (plain, wrapping):
        bench.moving(0)
        bench.until(lambda s: s.plan_done)
        bench.step(20)
        assert bench.events(STOP_BEGUN) == []
        bench.judge()
    np.testing.assert_array_equal(plain.trace().counts, wrapping.trace().counts)
    assert wrapping.now.tick > wrap


def test_t31_a_stop_across_the_wrap_is_the_same_stop():
    traces = []
    for first in (0, (1 << 16) - 400):
        bench = Stepped(first_tick=first)
        bench.moving(330, move(np.array([d.q_meas for d in bench.plant.drives])))
        bench.command(STOP)
        bench.until(lambda s: s.state == ExecutorState.HOLD)
        traces.append(bench.trace().counts)
    np.testing.assert_array_equal(*traces)
