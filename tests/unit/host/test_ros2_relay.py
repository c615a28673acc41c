"""What the relay does with a stop at every moment before a motion: nothing moves afterwards."""

from __future__ import annotations

import threading
import time
from contextlib import closing, contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.link_session import open_session
from s2r_host.ros2 import relay as module
from s2r_host.ros2.relay import TRAJECTORY, TrajectoryRelay
from s2r_protocol.arms import load_arm
from s2r_protocol.keys import ArmKeys
from s2r_protocol.ros2 import pack

ARM = load_arm("xmate3pro")
NOWHERE = "tcp/127.0.0.1:1"


class Link:
    """Notes what is sent; ``at[name]`` is called when that method is. A stop that finds nothing changes nothing."""

    def __init__(self):
        self.at, self.sent, self.stops = {}, [], 0

    def _pass(self, name):
        self.at.get(name, lambda: None)()

    def meet(self):
        self._pass("meet")

    @contextmanager
    def leased(self):
        self._pass("leased")
        yield

    def arm_drives(self):
        self._pass("arm_drives")

    def status(self):
        self._pass("status")
        return SimpleNamespace(q_ref=ARM.q_home)

    def send_plan(self, plan, label):
        self.sent.append(label)
        return SimpleNamespace(seq=len(self.sent))

    def wait_done(self, verdict):
        self._pass("wait_done")

    def stop(self):
        self.stops += 1


def message(points):
    point = {
        "positions": ARM.q_home + 0.01,
        "velocities": np.zeros(0),
        "accelerations": np.zeros(0),
        "effort": np.zeros(0),
        "time_from_start": {"sec": 1, "nanosec": 0},
    }
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "test"}
    body = {"header": header, "joint_names": list(ARM.joint_names), "points": [point] * points}
    return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: pack(TRAJECTORY, body)))


@pytest.fixture
def cell(monkeypatch):
    """A relay without anybody around it; ``said`` is its log."""
    said = []
    monkeypatch.setattr(module.TrajectoryRelay, "_say", lambda self, level, text: said.append(text))
    session, link = open_session(NOWHERE, ArmKeys()), Link()
    relay = TrajectoryRelay(session, link, ARM, ArmKeys(), enable_drives=True)  # type: ignore[arg-type]
    yield SimpleNamespace(relay=relay, link=link, said=said)
    session.close()


def test_a_trajectory_is_carried_out(cell):
    with closing(cell.relay):
        done = threading.Event()
        cell.link.at["wait_done"] = done.set
        cell.relay._take(message(1))
        assert done.wait(10)
    assert cell.link.sent == ["ROS 2: test"]


@pytest.mark.parametrize("moment", ["meet", "leased", "arm_drives", "status"])
def test_a_stop_before_the_plan_is_sent_voids_the_trajectory(cell, moment):
    cell.link.at[moment] = lambda: cell.relay._take(message(0))
    with closing(cell.relay):
        cell.relay._take(message(1))
        _until(lambda: any("carried out" in text for text in cell.said))
    assert "stop accepted" in cell.said[0]
    assert "a stop came before it began to move" in cell.said[-1]
    assert not cell.link.sent


def test_closing_voids_a_trajectory_that_waits(cell):
    begun, closing_now = threading.Event(), threading.Event()

    def hold():
        begun.set()
        closing_now.wait(10)

    cell.link.at["meet"] = hold
    cell.relay._take(message(1))
    assert begun.wait(10)
    threading.Timer(0.2, closing_now.set).start()
    cell.relay.close()
    assert not cell.link.sent
    assert cell.link.stops == 1


def _until(condition):
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
