"""What systemd is told, over its real kind of socket."""

import os
import socket
import threading

import pytest

from s2r_executor.service_manager import ServiceManager


@pytest.fixture
def line(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(tmp_path / "notify"))
        server.settimeout(10.0)
        yield server


def test_ready_alive_and_stopping_are_told(line, tmp_path):
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")})
    manager.ready("s2r executor\nready")
    manager.alive("HOLD: waits")
    manager.alive()
    manager.stopping()
    got = [line.recv(500).decode() for _ in range(4)]
    assert got == [
        "READY=1\nSTATUS=s2r executor ready",
        "WATCHDOG=1\nSTATUS=HOLD: waits",
        "WATCHDOG=1",
        "STOPPING=1",
    ]


def test_the_abstract_namespace_is_understood():
    name = f"s2r-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind("\0" + name)
        server.settimeout(10.0)
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).stopping()
        assert server.recv(100) == b"STOPPING=1"


def test_outside_systemd_nothing_happens():
    manager = ServiceManager({})
    manager.ready("x")
    assert manager.watchdog_s is None


def test_a_manager_that_went_away_is_noted_once_and_does_no_harm(tmp_path, caplog):
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    manager.alive()
    manager.alive()
    assert caplog.text.count("service manager not reached") == 1


def test_a_manager_that_was_not_reached_once_hears_the_next_sign_of_life(line, tmp_path):
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")})
    (tmp_path / "notify").rename(tmp_path / "away")
    manager.alive()
    (tmp_path / "away").rename(tmp_path / "notify")
    manager.alive("HOLD")
    assert line.recv(500) == b"WATCHDOG=1\nSTATUS=HOLD"


def test_a_manager_that_does_not_listen_is_not_waited_for(line, tmp_path, caplog):
    manager = ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "notify")})
    sender = threading.Thread(target=lambda: [manager.alive() for _ in range(2000)], daemon=True)
    sender.start()
    sender.join(20.0)
    assert not sender.is_alive()
    assert caplog.text.count("service manager not reached") == 1


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"WATCHDOG_USEC": "2000000"}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_period_is_read(environment, expected):
    assert ServiceManager(environment).watchdog_s == expected
