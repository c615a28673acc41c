"""Executor, stand-in, camera and host as real processes with certificates: the right lab gets through, no other."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from s2r_host.errors import PeerUnreachableError
from s2r_host.link import CameraLink, ExecutorLink
from s2r_protocol.arms import load_arm
from s2r_protocol.keys import ArmKeys
from s2r_protocol.session.certificates import make_certificates

pytestmark = pytest.mark.slow


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def s2r(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "s2r_protocol", *map(str, arguments)]


@contextmanager
def running(folder, name, *arguments):
    ready = folder / f"{name}.ready"
    with (folder / f"{name}.log").open("w+") as log:
        process = subprocess.Popen([*s2r(*arguments), "--ready-file", str(ready)], stdout=log, stderr=log)
        try:
            deadline = time.monotonic() + 300
            while not ready.exists():
                log.seek(0)
                assert process.poll() is None, log.read()
                assert time.monotonic() < deadline, log.read()
                time.sleep(0.05)
            yield
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A running cell whose network is closed to everybody without a certificate of its lab."""
    folder, lab, other = (tmp_path_factory.mktemp(name) for name in ("cell", "lab", "other"))
    make_certificates(lab)
    make_certificates(other)
    executor, camera, bus = free_endpoint(), free_endpoint(), f"unix:{folder}/bus.sock"
    clock = ("--bus", bus, "--clock", "lockstep", "--pace", "0", "--tls", lab)
    with (
        running(folder, "sim-arm", "sim-arm", "--seed", "1", "--listen", camera, *clock),
        running(folder, "executor", "executor", "--listen", executor, *clock),
    ):
        yield SimpleNamespace(executor=executor, camera=camera, lab=lab, other=other)


def test_a_host_of_the_lab_takes_the_lease_and_arms(cell):
    arm = load_arm("xmate3pro")
    with ExecutorLink(cell.executor, arm, connect_timeout_s=60.0, tls=cell.lab) as link, link.leased():
        assert link.arm_drives(timeout_s=60.0).state.name == "HOLD"
        deadline = time.monotonic() + 300
        while (seen := link.joints()) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert seen is not None
        link.disarm()


def test_a_host_of_the_lab_gets_a_picture(cell):
    with CameraLink(cell.camera, ArmKeys(), connect_timeout_s=60.0, tls=cell.lab) as link:
        assert link.capture(timeout_s=60.0).frame.depth_m.max() > 0.1


def test_a_host_of_another_lab_finds_nobody(cell):
    with pytest.raises(PeerUnreachableError, match="no executor answered"):
        ExecutorLink(cell.executor, load_arm("xmate3pro"), connect_timeout_s=2.0, tls=cell.other)
    with (
        CameraLink(cell.camera, ArmKeys(), connect_timeout_s=1.0, tls=cell.other) as link,
        pytest.raises(PeerUnreachableError, match="no camera 'front' answered"),
    ):
        link.capture(timeout_s=1.0)


def test_stop_works_with_the_labs_certificate_and_without_one_says_that_nothing_was_stopped(cell):
    stop = ("stop", "--executor", cell.executor, "--timeout")
    right = subprocess.run(s2r(*stop, 30, "--tls", cell.lab), capture_output=True, text=True)
    assert right.returncode == 0, right.stderr
    bare = subprocess.run(s2r(*stop, 1), capture_output=True, text=True)
    assert bare.returncode == 5
    assert "nothing was stopped" in bare.stderr


def test_the_monitors_certificate_alone_tells_the_state_and_does_not_stop(cell, tmp_path):
    for name in ("ca.pem", "monitor.pem", "monitor.key"):
        shutil.copy(cell.lab / name, tmp_path)
    told, stopped = (
        subprocess.run(
            s2r(word, "--executor", cell.executor, "--timeout", 30, "--tls", tmp_path),
            capture_output=True,
            text=True,
        )
        for word in ("state", "stop")
    )
    assert told.returncode == 0, told.stderr
    assert "lease held by nobody" in told.stdout
    assert stopped.returncode == 3, stopped.stderr
    assert "the certificate of monitor that is there may not do this" in stopped.stderr


def test_an_executor_does_not_listen_on_the_network_without_certificates(tmp_path):
    arguments = ("executor", "--bus", f"unix:{tmp_path}/none.sock", "--listen", "tcp/0.0.0.0:0")
    refused = subprocess.run(s2r(*arguments), capture_output=True, text=True)
    assert refused.returncode == 2, refused.stderr
    assert "anybody on that network could command the arm" in refused.stderr
