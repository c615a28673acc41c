"""From a click on STOP in the browser to the first changed setpoint, over many stops; and what the page costs.

The browser draws two frames a second, the console sends thirty.

    python tests/bench/bench_console_stop.py --stops 30                  # lock-step, pace 1
    python tests/bench/bench_console_stop.py --stops 30 --clock real

The click is stamped in the browser, the setpoints in the executor's recording: the first tick from which the
reference stays behind on the path of the accepted plan. Both clocks are this machine's wall clock; ticks are mapped
to it by the published states, so the granularity is the publishing period (10 ms).
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from s2r_host.console.feed import Feed
from s2r_host.errors import ArmStoppedError
from s2r_host.link import ExecutorLink
from s2r_host.link_session import open_session
from s2r_host.log.tables import read_recording
from s2r_host.testing.cell import quintic_motion
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.peers import peer, stand_in_cell
from s2r_protocol.faults import Cause, ExecutorState
from s2r_protocol.keys import ArmKeys
from s2r_protocol.ros2 import unpack

ARM = load_arm("xmate3pro")
STATE = "s2r_msgs/msg/ExecutorState"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
CLICK = "b => { const t = performance.timeOrigin + performance.now(); b.click(); return t; }"
# The browser shares the two cores with arm and executor here; on a lab's screen it draws on a GPU of its own.
FEW_FRAMES = """
window.requestAnimationFrame = act => setTimeout(() => act(performance.now()), 500);
window.cancelAnimationFrame = clearTimeout;
"""
BEHIND = 1e-3  # of the usual rate along the path


class TickClock:
    """Wall time of ticks, from when their states arrived."""

    def __init__(self) -> None:
        self.ticks: list[int] = []
        self.walls: list[float] = []

    def seen(self, sample) -> None:
        self.ticks.append(int(unpack(STATE, sample.payload.to_bytes())["tick"]))
        self.walls.append(time.time())

    def wall(self, tick: float) -> float:
        return float(np.interp(tick, self.ticks, self.walls))


def first_changed(recording: Path, plan, tick_ns: int) -> float:
    """Seconds from the plan's first tick to the first reference that is behind on the path and stays so.

    Ticks that come late on a machine without real-time rights freeze the path for themselves; after those the
    reference goes on at full rate, after a stop it does not.
    """
    q = read_recording(recording).joints("joint_commands").q[:, 0]
    u = np.linspace(0.0, plan.t[-1], 20_000)
    q_plan = plan.sample(u)[0][:, 0]
    order = np.argsort(q_plan)
    rate = np.diff(np.interp(q, q_plan[order], u[order])) / (tick_ns * 1e-9)
    usual = np.median(rate[len(rate) // 10 :][rate[len(rate) // 10 :] > 0.05])
    return float((np.flatnonzero(rate > (1.0 - BEHIND) * usual)[-1] + 2) * tick_ns * 1e-9)


def one_stop(link, button, clock: TickClock, folder: Path, sign: float) -> float | None:
    """Latency of one stop [s]; None when a busy machine disturbed the motion and another protection stopped it."""
    plan = quintic_motion(np.asarray(link.status().q_ref), sign * np.full(ARM.dof, 0.25), 3.0)
    link.meet()  # goes on after the stop before
    with link.leased():
        if link.status().state == ExecutorState.FAULT:
            link.reset()
        link.arm_drives()
        tick = link.status().tick
        verdict = link.send_plan(plan, "bench")
        time.sleep(float(np.random.default_rng().uniform(0.8, 1.4)))
        clicked = button.evaluate(CLICK) / 1e3
        try:
            link.wait_done(verdict)
        except ArmStoppedError as error:
            if error.cause != Cause.STOP_REQUESTED:
                return None
        data = link.recording(verdict.seq)
    path = folder / "bench.mcap"
    path.write_bytes(data)
    recording = read_recording(path)
    states = [unpack(STATE, m) for m in recording.topic("executor_state", STATE).messages]
    first_tick = min(int(s["tick"]) for s in states if s["plan_seq"] == verdict.seq)
    changed = first_tick + first_changed(path, plan, link.identity.tick_ns) / (link.identity.tick_ns * 1e-9)
    assert changed > tick
    return clock.wall(changed) - clicked


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=30)
    parser.add_argument("--clock", choices=["lockstep", "real"], default="lockstep")
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as root, sync_playwright() as playwright:
        folder = Path(root)
        (folder / "runs").mkdir()
        with stand_in_cell(folder, ("--seed", "3"), options.clock, 1.0) as cell:
            arguments = ("console", "--executor", cell.executor, "--port", "0", "--runs", folder / "runs")
            browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
            page = browser.new_page(viewport={"width": 760, "height": 640})
            page.add_init_script(FEW_FRAMES)
            started = time.monotonic()
            with peer("console", arguments, folder) as console:
                ready_s = time.monotonic() - started
                page.goto((folder / "console.ready").read_text().strip(), timeout=120_000)
                button = page.get_by_role("button", name="STOP")
                button.wait_for(timeout=120_000)
                page.get_by_text("states/s").first.wait_for(timeout=120_000)
                print(f"page usable {time.monotonic() - started:.1f} s after the console's start (budget 15 s), "
                      f"its server after {ready_s:.1f} s", flush=True)  # fmt: skip
                session = open_session(cell.executor, ArmKeys(arm=ARM.name))
                clock = TickClock()
                key = Feed.key("executor_state", f"/{ArmKeys(arm=ARM.name).base}")
                subscriber = session.declare_subscriber(key, clock.seen)
                handle = button.element_handle()
                with ExecutorLink(cell.executor, ARM) as link:
                    cpu, wall = cpu_s(console.pid), time.monotonic()
                    tried = [one_stop(link, handle, clock, folder, (-1.0) ** k) for k in range(options.stops)]
                    share = (cpu_s(console.pid) - cpu) / (time.monotonic() - wall)
                subscriber.undeclare()
                session.close()
                browser.close()
    late = 1e3 * np.array([late_s for late_s in tried if late_s is not None])
    p50, p99 = np.quantile(late, [0.5, 0.99])
    print(f"click to first changed setpoint, {options.clock}: p50 {p50:.0f} ms, p99 {p99:.0f} ms, "
          f"worst {late.max():.0f} ms over {len(late)} stops; in {len(tried) - len(late)} more a protection of the "
          "executor stopped the arm first")  # fmt: skip
    print(f"console process: {share:.0%} of one core while the arm moved half of the time (budget 15 %)")


def cpu_s(pid: int) -> float:
    """CPU time a process has used [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


if __name__ == "__main__":
    main()
