"""May this machine drive this bus, and how fast?"""

from types import SimpleNamespace
from typing import get_args

import pytest

from s2r_executor import assembly, preflight
from s2r_executor.config import Softer, load_config
from s2r_protocol.exits import NotReadyError, UsageError
from s2r_protocol.machine.realtime import Check, RealtimeFacts, Verdict

GOOD = {
    "fifo": "",
    "memory_lock": "",
    "preemption": "rt",
    "governors": ("performance",),
    "cpus": (0, 1, 2, 3),
    "isolated": (3,),
    "cpu": 3,
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
    answer = decide(preemption="none", isolated=(), cpu=None)
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


def test_a_core_that_does_not_ask_for_real_time_is_slow_not_fast():
    insisting = {"allow_not_realtime": True, "core.realtime_priority": 0}
    answer = decide(config=insisting)
    assert (answer.verdict, answer.speed_cap) == (Verdict.DEGRADED, 0.25)
    with pytest.raises(NotReadyError, match=r"core.realtime_priority is 0\n +fix: set"):
        decide(config={"core.realtime_priority": 0})


def started(monkeypatch, realtime, bus="can:none"):
    """An executor without its network and its watch loop, on a machine where everything was permitted."""
    core = SimpleNamespace(snapshot=lambda: SimpleNamespace(realtime=realtime))
    process = SimpleNamespace(core=core, kill=lambda: None)
    monkeypatch.setattr(assembly, "run_preflight", lambda _: preflight.Preflight(Verdict.RT_OK, (), 1.0))
    monkeypatch.setattr(assembly, "OneMaster", lambda _: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(assembly, "CoreProcess", lambda *_: process)
    monkeypatch.setattr(assembly.Executor, "_assemble", lambda _: None)
    return assembly.Executor(load_config(overrides={"bus": bus, "listen": []})).preflight


def test_the_speed_follows_what_the_core_got_not_what_was_permitted(monkeypatch):
    answer = started(monkeypatch, realtime=False)
    assert (answer.verdict, answer.speed_cap) == (Verdict.DEGRADED, 0.25)
    assert "real-time core" in answer.line
    assert started(monkeypatch, realtime=True).speed_cap == 1.0
    assert started(monkeypatch, realtime=False, bus="unix:/tmp/x").speed_cap == 1.0


def test_a_cpu_that_the_core_would_not_get_is_refused():
    with pytest.raises(NotReadyError, match="CPU of the core: CPU 9: Invalid argument"):
        decide(cpu=9, cpu_refused="Invalid argument")


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
        "preemption": "none", "governors": ("powersave",), "isolated": (), "rt_runtime_share": 0.1,
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
