"""May this machine drive this bus, and how fast?"""

from typing import get_args

import pytest

from s2r_executor import preflight
from s2r_executor.config import Softer, load_config
from s2r_protocol.exits import NotReadyError, UsageError
from s2r_protocol.machine.realtime import Check, RealtimeFacts, Verdict

GOOD = {
    "fifo": "",
    "memory_lock": "",
    "preemption": "rt",
    "governors": ("performance",),
    "cpus": 4,
    "isolated": "3",
    "rt_runtime_share": 0.95,
    "hypervisor": False,
    "tx_queue": 128,
}


def decide(more=(), config=None, **change):
    settings = {"bus": "can:can0", **(config or {})}
    return preflight.decide(load_config(overrides=settings), RealtimeFacts(**{**GOOD, **change}), more)


def test_a_prepared_machine_moves_at_full_speed():
    answer = decide()
    assert (answer.verdict, answer.speed_cap, answer.line) == (Verdict.RT_OK, 1.0, "preflight RT_OK")


def test_a_machine_without_deadlines_is_slow_and_says_why(caplog):
    answer = decide(preemption="none", isolated="")
    assert (answer.verdict, answer.speed_cap) == (Verdict.DEGRADED, 0.25)
    assert answer.line == ("preflight DEGRADED (kernel, CPUs; see 's2r doctor'), speed capped at 25%")
    assert "linux-image-rt" in caplog.text
    assert "isolcpus=3" in caplog.text


def test_the_cap_is_the_configured_one():
    assert decide(config={"preflight.degraded_speed": 0.1}, hypervisor=True).speed_cap == 0.1


@pytest.mark.parametrize(
    "lack", [{"fifo": "Operation not permitted"}, {"memory_lock": "Cannot allocate memory"}]
)
def test_a_machine_without_real_time_rights_does_not_drive_hardware(lack):
    with pytest.raises(NotReadyError, match=r"must not drive can:can0:\n.*\n +fix: sudo install"):
        decide(**lack)


def test_insisting_makes_it_slow_not_fast():
    answer = decide(config={"allow_not_realtime": True}, fifo="Operation not permitted")
    assert (answer.verdict, answer.speed_cap) == (Verdict.DEGRADED, 0.25)


def test_an_interface_in_trouble_cannot_be_insisted_away():
    down = Check("CAN can0", Verdict.REFUSED, "the interface is down", "sudo ip link set can0 up")
    with pytest.raises(NotReadyError, match="the interface is down"):
        decide([down], config={"allow_not_realtime": True})


def test_what_the_laboratory_accepts_costs_nothing_and_is_logged(caplog):
    answer = decide(config={"preflight.accept": ["hypervisor"]}, hypervisor=True)
    assert (answer.verdict, answer.speed_cap) == (Verdict.RT_OK, 1.0)
    assert "accepted by the configuration" in caplog.text
    assert (
        decide(config={"preflight.accept": ["hypervisor"]}, hypervisor=True, preemption="none").speed_cap
        == 0.25
    )


def test_missing_rights_cannot_be_accepted():
    with pytest.raises(UsageError, match=r"preflight.accept.0 = 'FIFO priority': it should be 'kernel'"):
        decide(config={"preflight.accept": ["FIFO priority"]}, fifo="Operation not permitted")


def test_every_topic_that_slows_a_machine_can_be_accepted_by_its_name():
    worst = {
        "preemption": "none", "governors": ("powersave",), "isolated": "", "rt_runtime_share": 0.1,
        "hypervisor": True, "tx_queue": 10,
    }  # fmt: skip
    answer = decide(config={"preflight.accept": list(get_args(Softer))}, **worst)
    assert (answer.verdict, answer.speed_cap) == (Verdict.RT_OK, 1.0)


def test_the_stand_in_is_never_refused_nor_slowed():
    answer = decide(config={"bus": "unix:/tmp/x"}, fifo="Operation not permitted", tx_queue=None)
    assert (answer.verdict, answer.speed_cap) == (Verdict.REFUSED, 1.0)


def test_an_absent_interface_is_refused_on_this_very_machine():
    with pytest.raises(NotReadyError, match="no such CAN interface"):
        preflight.run_preflight(load_config(overrides={"bus": "can:nosuch0", "allow_not_realtime": True}))
