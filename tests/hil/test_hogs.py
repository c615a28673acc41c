"""T57: a machine that is short of CPU, memory and disk.

In virtual time that may not change one bit on the bus. With the real clock it may not cost one deadline, which only a
machine that the preflight calls ready for real time can promise: `pytest -m realtime tests/hil/test_hogs.py` there.
"""

from __future__ import annotations

import os

import pytest

from s2r_executor.bench import load
from s2r_executor.bench.slice import SliceSettings, run_slice
from s2r_protocol.faults import ExecutorState
from s2r_protocol.machine.realtime import Verdict, judge, read_facts, worst

LATENESS_US = 100.0
SECONDS = 60


def test_t57_hogs_change_not_one_bit_on_the_bus(make_bench, tmp_path):
    logs = []
    for hungry in (False, True):
        bench = make_bench()
        if hungry:
            with load.hogs(os.sched_getaffinity(0), tmp_path):
                bench.moving(500)
        else:
            bench.moving(500)
        bench.until(lambda s: s.state == ExecutorState.HOLD)
        bench.step(20)
        bench.judge()
        logs.append(bench.log.frames())
    assert logs[0].tobytes() == logs[1].tobytes()


@pytest.mark.realtime
@pytest.mark.timeout(SECONDS + 120)
def test_t57_hogs_cost_no_deadline_on_a_real_time_machine():
    facts = judge(read_facts())
    if worst(facts) != Verdict.RT_OK:
        pytest.skip("no real-time machine: " + "; ".join(c.text for c in facts if c.verdict != Verdict.RT_OK))
    measured = run_slice(SliceSettings("hogs", SECONDS, max(os.sched_getaffinity(0))))
    loop = measured["loop"]
    assert isinstance(loop, dict)
    assert loop["missed"] == 0
    assert loop["p9999_us"] < LATENESS_US
