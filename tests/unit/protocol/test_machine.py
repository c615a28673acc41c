"""Facts about this machine, judged: what refuses the arm, what slows it, and how to mend it."""

from dataclasses import replace

import pytest

from s2r_protocol.machine import Level, can_interface, cpus, realtime, software, surroundings
from s2r_protocol.machine.realtime import RealtimeFacts, Verdict, judge, read_facts, worst

GOOD = RealtimeFacts(
    fifo="",
    memory_lock="",
    preemption="rt",
    governors=("performance",) * 4,
    cpus=(0, 1, 2, 3),
    isolated=(3,),
    cpu=3,
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
        ({"isolated": (), "cpu": None}, Verdict.DEGRADED, "CPUs", "isolcpus=3"),
        ({"isolated": (), "cpu": 2}, Verdict.DEGRADED, "CPUs", "isolcpus=2"),
        ({"cpu": 2}, Verdict.DEGRADED, "CPUs", "leave core.cpu out: s2r-rt then runs on CPU 3"),
        ({"cpu_refused": "Invalid argument"}, Verdict.REFUSED, "CPU of the core", "cpuset"),
        ({"cpus": (0,)}, Verdict.DEGRADED, "CPUs", "second CPU"),
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


def test_a_machine_that_follows_the_advice_on_its_cpus_is_rt_ok():
    advice = next(c.fix for c in judge(replace(GOOD, isolated=(), cpu=None)) if c.topic == "CPUs")
    assert advice.startswith("boot with isolcpus=3 nohz_full=3 rcu_nocbs=3")
    assert "Affinity" not in advice  # of the unit, it would put everything else on that CPU, too
    assert worst(judge(replace(GOOD, isolated=(3,), cpu=3))) == Verdict.RT_OK


def test_no_priority_asked_for_is_none_obtained():
    checks = judge(GOOD, priority=0)
    assert worst(checks) == Verdict.REFUSED
    assert checks[0].fix == "set core.realtime_priority to 80"


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
            "sys/devices/system/cpu/online": "0-2,4\n",
            "sys/devices/system/cpu/isolated": "2-4\n",
            "sys/class/net/can1/tx_queue_len": "10\n",
            "proc/sys/kernel/sched_rt_runtime_us": "-1\n",
            "proc/sys/kernel/sched_rt_period_us": "1000000\n",
            "proc/cpuinfo": "flags : fpu hypervisor\n",
        },
    )
    facts = read_facts("can1", root=root)
    assert (facts.governors, facts.tx_queue) == (("powersave",), 10)
    assert (facts.cpus, facts.isolated, facts.cpu) == ((0, 1, 2, 4), (2, 4), 2)
    assert read_facts("can1", root=root, cpu=1).cpu == 1
    assert (facts.rt_runtime_share, facts.hypervisor) == (1.0, True)


def test_a_priority_that_the_kernel_refuses_is_told_in_its_words():
    assert realtime._try_fifo(200) == "Invalid argument"


def test_a_cpu_that_is_not_there_is_told_in_the_kernels_words():
    assert cpus.refusal(1023) == "Invalid argument"
    assert cpus.refusal(cpus.online()[0]) == ""


def test_trying_leaves_this_thread_as_it_was():
    import os

    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    read_facts(cpu=min(os.sched_getaffinity(0)))
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before


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
