"""Facts about this machine, judged: what refuses the arm, what slows it, and how to mend it."""

from dataclasses import replace

import pytest

from s2r_protocol.machine import Level, can_interface, realtime, software, surroundings
from s2r_protocol.machine.realtime import RealtimeFacts, Verdict, judge, read_facts, worst

GOOD = RealtimeFacts(
    fifo="",
    memory_lock="",
    preemption="rt",
    governors=("performance",) * 4,
    cpus=4,
    isolated="3",
    rt_runtime_share=0.95,
    hypervisor=False,
    tx_queue=128,
)


def test_a_prepared_machine_is_rt_ok():
    assert worst(judge(GOOD)) == Verdict.RT_OK
    assert not any(check.fix for check in judge(GOOD))


@pytest.mark.parametrize(
    ("change", "verdict", "topic", "fix"),
    [
        ({"fifo": "Operation not permitted"}, Verdict.REFUSED, "FIFO priority", "limits-s2r.conf"),
        ({"memory_lock": "Cannot allocate memory"}, Verdict.REFUSED, "memory lock", "limits-s2r.conf"),
        ({"preemption": "full"}, Verdict.DEGRADED, "kernel", "linux-image-rt"),
        ({"preemption": "unknown"}, Verdict.DEGRADED, "kernel", "linux-image-rt"),
        ({"governors": ("performance", "powersave")}, Verdict.DEGRADED, "governor", "cpupower"),
        ({"isolated": ""}, Verdict.DEGRADED, "CPUs", "isolcpus=3"),
        ({"cpus": 1}, Verdict.DEGRADED, "CPUs", "second CPU"),
        ({"rt_runtime_share": 0.1}, Verdict.DEGRADED, "RT throttling", "sched_rt_runtime_us"),
        ({"hypervisor": True}, Verdict.DEGRADED, "hypervisor", "bare metal"),
        ({"tx_queue": 10}, Verdict.DEGRADED, "transmit queue", "ip link set can3 txqueuelen 128"),
    ],
)
def test_each_lack_has_its_verdict_and_its_fix(change, verdict, topic, fix):
    checks = judge(replace(GOOD, **change), interface="can3")
    bad = [check for check in checks if check.verdict != Verdict.RT_OK]
    assert [check.topic for check in bad] == [topic]
    assert bad[0].verdict == verdict == worst(checks)
    assert fix in bad[0].fix


def test_the_worst_finding_wins():
    assert worst(judge(replace(GOOD, preemption="none", fifo="no"))) == Verdict.REFUSED


def machine(tmp_path, **files):
    for name, text in files.items():
        path = tmp_path / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("files", "preemption"),
    [
        ({"sys/kernel/realtime": "1\n"}, "rt"),
        ({"sys/kernel/debug/sched/preempt": "none voluntary (full)\n"}, "full"),
        ({"proc/sys/kernel/version": "#1 SMP PREEMPT_RT Debian\n"}, "rt"),
        ({"proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian\n"}, "unknown"),
        ({"proc/sys/kernel/version": "#1 SMP Debian\n"}, "voluntary"),
    ],
)
def test_the_preemption_model_is_read_where_the_kernel_tells_it(tmp_path, files, preemption):
    assert read_facts(root=machine(tmp_path, **files)).preemption == preemption


def test_governors_isolation_queue_and_throttling_are_read(tmp_path):
    root = machine(
        tmp_path,
        **{
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "powersave\n",
            "sys/devices/system/cpu/isolated": "2-3\n",
            "sys/class/net/can1/tx_queue_len": "10\n",
            "proc/sys/kernel/sched_rt_runtime_us": "-1\n",
            "proc/sys/kernel/sched_rt_period_us": "1000000\n",
            "proc/cpuinfo": "flags : fpu hypervisor\n",
        },
    )
    facts = read_facts("can1", root=root)
    assert (facts.governors, facts.isolated, facts.tx_queue) == (("powersave",), "2-3", 10)
    assert (facts.rt_runtime_share, facts.hypervisor) == (1.0, True)


def test_a_priority_that_the_kernel_refuses_is_told_in_its_words():
    assert realtime._try_fifo(200) == "Invalid argument"


def test_trying_leaves_this_thread_as_it_was():
    import os

    before = os.sched_getscheduler(0)
    read_facts()
    assert os.sched_getscheduler(0) == before


def can_interface_folder(tmp_path, flags="0x1", mtu="72", kind="280"):
    return machine(
        tmp_path,
        **{
            "sys/class/net/can0/type": kind,
            "sys/class/net/can0/flags": flags,
            "sys/class/net/can0/mtu": mtu,
        },
    )


@pytest.mark.parametrize(
    ("folder", "packing", "level", "said"),
    [
        ({}, "fd", Level.OK, "up, mtu 72"),
        ({"mtu": "16"}, "classic", Level.OK, "up, mtu 16"),
        ({"mtu": "16"}, "fd", Level.PROBLEM, "no CAN FD"),
        ({"flags": "0x0"}, "fd", Level.PROBLEM, "is down"),
        ({"kind": "1"}, "fd", Level.PROBLEM, "no such CAN interface; this machine has: none"),
    ],
)
def test_a_can_interface_is_looked_at(tmp_path, folder, packing, level, said):
    (finding,) = can_interface.check_interface("can0", packing, can_interface_folder(tmp_path, **folder))
    assert finding.level == level
    assert said in finding.text
    assert level == Level.OK or finding.fix


def test_wrong_bit_rates_and_a_controller_in_trouble_are_named():
    link = {
        "info_kind": "can",
        "info_data": {"bittiming": {"bitrate": 500000}, "state": "BUS-OFF", "restart_ms": 100},
    }
    (finding,) = can_interface._details("CAN can0", "can0", "fd", 72, link)
    assert finding.level == Level.PROBLEM
    for said in ("bitrate 500000, expected 1000000", "controller is BUS-OFF", "restart-ms is set"):
        assert said in finding.text
    assert "dbitrate 5000000 fd on" in finding.fix


def test_a_package_of_the_wrong_version_is_named(monkeypatch):
    monkeypatch.setattr(
        software, "requires", lambda name: ["numpy>=99", "click>=8", "mujoco>=1; extra == 'sim'"]
    )
    base = next(f for f in software.check_software() if f.topic == "packages: base")
    assert base.level == Level.PROBLEM
    assert base.text.startswith("numpy ")
    assert "does not meet >=99" in base.text
    assert base.fix == "pip install 'sim2real2'"


def test_a_part_that_was_not_chosen_is_only_a_note(monkeypatch):
    monkeypatch.setattr(software, "requires", lambda name: ["click>=8"])
    monkeypatch.setattr(software, "is_installed", lambda module: module != "open3d")
    host = next(f for f in software.check_software() if f.topic == "packages: host")
    assert (host.level, host.fix) == (Level.NOTE, "pip install 'sim2real2[host]'")


def test_missing_shared_memory_is_a_note_with_its_fix(tmp_path):
    (finding,) = surroundings._shared_memory(tmp_path / "nowhere")
    assert finding.level == Level.NOTE
    assert "mount -t tmpfs" in finding.fix
