"""A disk that takes nothing more while the arm moves: the motion does not notice, the loss is counted and shown."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("s2r_executor._native", reason="the native core is not built")

from s2r_host.console.feed import Feed
from s2r_host.console.screens.timing import blame
from s2r_host.errors import CommandRefusedError
from s2r_host.link import ExecutorLink
from s2r_host.link_session import open_session
from s2r_host.testing.cell import quintic_motion
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.peers import stand_in_cell
from s2r_protocol.keys import ArmKeys

ARM = load_arm("xmate3pro")
KEYS = ArmKeys(arm=ARM.name)


def writer_of(executor_pid: int) -> int:
    """The recorder's process among the executor's children."""
    children = Path(f"/proc/{executor_pid}/task/{executor_pid}/children").read_text().split()
    found = [pid for pid in children if b"recorder_process" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert len(found) == 1, children
    return int(found[0])


def until(condition):
    deadline = time.monotonic() + 300
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def move(link, sign):
    """One motion; its reference and measured end, and its recording's length in ticks, None if there is none."""
    plan = quintic_motion(np.asarray(link.status().q_ref), sign * np.full(ARM.dof, 0.1), 1.0)
    verdict = link.send_plan(plan, "motion")
    status = link.wait_done(verdict)
    np.testing.assert_allclose(status.q_ref, plan.q[-1], atol=1e-9)
    return np.abs(status.q_meas - plan.q[-1]).max(), verdict


def test_a_full_disk_does_not_touch_the_motion_and_is_shown(tmp_path):
    with stand_in_cell(tmp_path, ("--seed", "3")) as cell, ExecutorLink(cell.executor, ARM) as link:
        session = open_session(cell.executor, KEYS)
        feed = Feed(session, f"/{KEYS.base}")
        with link.leased():
            link.arm_drives()
            off_before, verdict = move(link, 1.0)
            assert len(link.recording(verdict.seq)) > 100_000
            # No file may grow beyond this: what the kernel does on a full disk, without one.
            writer = writer_of(cell.executor_process.pid)
            resource.prlimit(writer, resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
            off_after, verdict = move(link, -1.0)
            assert off_after < 2 * off_before + 1e-3
            with pytest.raises(CommandRefusedError, match="File too large"):
                link.recording(verdict.seq)
        timing = until(lambda: (t := feed.timing()) and t["recording_lost_ticks"] > 0 and t)
        state = until(feed.state)
        assert (state["missed"], state["overruns"], state["tx_failed"]) == (0, 0, 0)
        said = [text for text, _ in blame(state, timing, feed.health())]
        assert any(text.startswith("Disk: ") and "File too large" in text for text in said), said
        feed.close()
        session.close()
