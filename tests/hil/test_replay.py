"""A bus log goes through the same binary again: every setpoint bit for bit, every decision the same."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
from hil_bench import DEADLINE_S, INFO, PAUSE, RESUME, STOP, Bench, move

from s2r_executor import _native
from s2r_executor.core_process import native_executable
from s2r_protocol.can.drive import DriveError, DriveState
from s2r_protocol.can.frames import CanFrame
from s2r_protocol.faults import ExecutorState
from s2r_sim.bus.hub import Hub


def lost_answers(bench: Bench) -> None:
    bench.lose(0x183, 4)
    bench.step(900)


def drive_fault(bench: Bench) -> None:
    bench.plant.drives[4]._fail(DriveError.OVER_CURRENT, DriveState.FAULT_REACTION)
    bench.step(900)


def emergency_stop(bench: Bench) -> None:
    for drive in bench.plant.drives:
        drive.estop_open = 3
    bench.step(300)


def pause_and_stop(bench: Bench) -> None:
    bench.command(PAUSE)
    bench.step(700)
    bench.command(RESUME)
    bench.step(300)
    bench.command(STOP)
    bench.step(800)


def damaged_frames(bench: Bench) -> None:
    bench.lose("*", 2, action="corrupt")
    bench.step(900)


def replay(bench: Bench, folder) -> tuple[list[bytes], list]:
    """Feed a fresh core what the first one was fed, tick by tick; returns its setpoints and events."""
    groups: list[list[bytes]] = []
    for row in bench.log.frames():
        packet = row["raw"][: row["size"]].tobytes()
        if row["sender"] == bench.master:
            groups.append([packet])
        elif groups:
            groups[-1].append(packet)
    orders: dict[int, list] = {}
    for tick, *what in bench.orders:
        orders.setdefault(tick, []).append(what)
    hub = Hub(f"unix:{folder}/replay")
    shared = _native.Shared.create(
        {**bench.settings, "bus": f"unix:{folder}/replay", "answer_timeout_s": DEADLINE_S}
    )
    shared.beat()
    child = subprocess.Popen([native_executable(), "--shm-fd", str(shared.fd)], pass_fds=[shared.fd])
    sent, events = [], []
    try:
        while len(sent) < len(groups):
            for client, packet in hub.receive(DEADLINE_S):
                assert packet is not None, "the core has ended"
                tick = len(sent)
                sent.append(packet)
                while shared.snapshot().tick < tick:
                    pass
                for order in orders.get(tick, ()):
                    if order[0] == "command":
                        shared.command(*order[1:])
                    else:
                        plan, plan_id, epoch, more = order[1:]
                        shared.submit_plan(
                            plan_id,
                            epoch,
                            plan.t,
                            plan.q,
                            plan.dq,
                            plan.ddq,
                            plan.stop_duration,
                            0.0,
                            0.0,
                            **more,
                        )
                shared.beat()
                for frame in groups[tick][1:]:
                    hub.send(client, frame)
                hub.send(client, CanFrame(0, packet[10:12], is_error=True).pack())
                events += list(shared.events())
                if len(sent) == len(groups):
                    break
    finally:
        child.kill()
        child.wait()
        hub.close()
    return sent, events


def told(events: list) -> list[tuple]:
    names = ("tick", "kind", "state", "cause", "joint", "plan_id", "value", "limit")
    return [tuple(e[n].item() for n in names) for e in events if e["kind"] != INFO]


@pytest.mark.parametrize(
    "happening", [lost_answers, drive_fault, emergency_stop, pause_and_stop, damaged_frames]
)
def test_a_replayed_bus_log_gives_the_same_bits_and_decisions(make_bench, tmp_path, happening):
    bench = make_bench()
    bench.moving(500)
    happening(bench)
    bench.step(20)
    sent, events = replay(bench, tmp_path)
    log = bench.log.frames()
    original = [r["raw"][: r["size"]].tobytes() for r in log[log["sender"] == bench.master]]
    assert len(sent) > 700
    assert sent == original[: len(sent)]
    last = max(e["tick"] for e in events)
    assert told(events) == told([e for e in bench.events() if e["tick"] <= last])


def test_a_replay_with_one_bit_changed_is_told_apart(make_bench, tmp_path):
    """The comparison above can fail: another plan gives other bits."""
    bench = make_bench()
    bench.arm()
    bench.run(move(np.asarray(bench.now.q_ref)))
    bench.step(300)
    plan_order = next(o for o in bench.orders if o[1] == "plan")
    plan_order[2].q[2, 0] += 1e-6
    sent, _ = replay(bench, tmp_path)
    log = bench.log.frames()
    original = [r["raw"][: r["size"]].tobytes() for r in log[log["sender"] == bench.master]]
    assert sent != original[: len(sent)]
    assert bench.now.state == ExecutorState.RUN
