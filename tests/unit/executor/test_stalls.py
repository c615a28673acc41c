from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

from s2r_executor.stalls import SAY_AFTER_S, Patience, StallWatch


def core(tick: int, alive: bool = True) -> Any:
    return SimpleNamespace(tick=tick, alive=alive)


def test_with_the_real_clock_patience_is_wall_time():
    patience = Patience(2.0, stepped=False, tick=7, now_s=100.0)
    assert not patience.ended(core(7), 101.9)
    assert patience.ended(core(7), 102.1)


def test_in_lock_step_patience_counts_only_while_time_runs():
    patience = Patience(2.0, stepped=True, tick=7, now_s=100.0)
    assert not patience.ended(core(7), 110.0)  # the stand-in stalls
    looks = [patience.ended(core(8 + k), 110.0 + 0.04 * k) for k in range(60)]
    assert looks.index(True) == 51  # two seconds of looks at a core that ticks


def test_in_lock_step_a_stall_of_the_one_who_waits_hardly_counts():
    patience = Patience(2.0, stepped=True, tick=7, now_s=100.0)
    assert not patience.ended(core(8), 130.0)
    assert not patience.ended(core(9), 131.0)


def test_a_dead_core_is_not_waited_for():
    patience = Patience(2.0, stepped=True, tick=7, now_s=100.0)
    assert patience.ended(core(7, alive=False), 102.1)


def test_patience_with_a_stand_in_ends_after_a_minute():
    patience = Patience(2.0, stepped=True, tick=7, now_s=100.0)
    assert not patience.ended(core(7), 161.0)
    assert patience.ended(core(7), 163.0)


def test_a_stall_is_said_once_and_its_end_as_well(caplog):
    watch = StallWatch()
    with caplog.at_level(logging.WARNING):
        for i in range(100):
            watch.look(core(3), 10.0 + 0.1 * i)
        watch.look(core(4), 20.0)
        watch.look(core(5), 20.1)
    assert [r.getMessage().split(";")[0] for r in caplog.records] == [
        f"tick 3 waits for the stand-in since {SAY_AFTER_S:.0f} s: simulated time stands still",
        "the stand-in answered after 10.0 s: simulated time goes on",
    ]
