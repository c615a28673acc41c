"""``s2r sim-arm`` and ``s2r world`` as commands."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner

from s2r_protocol.can import fd
from s2r_protocol.can.frames import CanFrame, connect_unix
from s2r_protocol.exits import S2RError, UsageError
from s2r_sim.cli import sim_arm, world
from s2r_sim.score import final_state
from s2r_sim.stand_in import StandInConfig
from s2r_sim.world import load_world


def run(command, *arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=True)


def test_drawn_world_prints_the_commitment_that_commit_confirms(tmp_path):
    drawn = run(world, "draw", "--seed", 4, "--out", tmp_path / "w.json")
    assert drawn.exit_code == 0
    assert run(world, "commit", tmp_path / "w.json").output == drawn.output
    assert drawn.output.strip() == load_world(tmp_path / "w.json").commitment


def test_another_object_does_not_replace_the_first(tmp_path):
    words = ("object", "--kind", "drawer", "--out", tmp_path / "o")
    assert run(world, *words, "--seed", 3).exit_code == 0
    first = (tmp_path / "o" / "scene.xml").read_text()
    assert "not empty; name a new folder" in str(run(world, *words, "--seed", 4).exception)
    assert (tmp_path / "o" / "scene.xml").read_text() == first


@pytest.mark.parametrize("arguments", [[], ["--seed", 1, "--world", "w.json"]])
def test_exactly_one_source_of_the_world_is_needed(arguments):
    assert isinstance(run(sim_arm, *arguments).exception, UsageError)


def test_real_clock_without_pace_is_refused():
    with pytest.raises(UsageError, match="--pace 0"):
        StandInConfig(clock="real", pace=0)


def test_malformed_injection_ends_before_anything_listens(tmp_path):
    result = run(sim_arm, "--seed", 1, "--inject", "burn:it", "--bus", f"unix:{tmp_path}/b.sock")
    assert isinstance(result.exception, UsageError)
    assert not (tmp_path / "b.sock").exists()


def test_a_truth_log_replaces_nothing(tmp_path):
    (tmp_path / "mine.csv").write_text("keep me")
    result = run(sim_arm, "--seed", 1, "--truth", tmp_path / "mine.csv", "--bus", f"unix:{tmp_path}/b.sock")
    assert isinstance(result.exception, UsageError)
    assert "mine.csv exists and would be replaced" in str(result.exception)
    assert (tmp_path / "mine.csv").read_text() == "keep me"


def test_a_stand_in_that_does_not_start_leaves_no_truth_log(tmp_path):
    (tmp_path / "taken").write_text("no socket")
    result = run(sim_arm, "--seed", 1, "--truth", tmp_path / "t.csv", "--bus", f"unix:{tmp_path}/taken")
    assert isinstance(result.exception, S2RError)
    assert not (tmp_path / "t.csv").exists()


def test_stand_in_serves_a_master_hides_its_world_and_ends_on_ctrl_c(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    run(world, "draw", "--seed", 4, "--out", tmp_path / "w.json")
    command = [sys.executable, "-m", "s2r_protocol", "sim-arm"]
    command += ["--world", tmp_path / "w.json", "--pace", "0", "--truth", tmp_path / "t.csv"]
    command += ["--bus", f"unix:{tmp_path}/b.sock", "--listen", f"tcp/127.0.0.1:{port}"]
    command += ["--ready-file", tmp_path / "ready"]
    command += ["--inject", "drop:0x123@0-99", "--inject", "delay:0x185@12000"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        end = time.monotonic() + 300
        while not (tmp_path / "ready").exists():
            assert process.poll() is None, process.communicate()[0]
            assert time.monotonic() < end
            time.sleep(0.05)
        with connect_unix(f"unix:{tmp_path}/b.sock") as node:
            node.settimeout(10.0)
            for k in range(1, 31):
                node.send(fd.set_frame(fd.pack_set(k, 0, k, [0.0] * 7)).pack())
                frames = [CanFrame.unpack(node.recv(128)) for _ in range(8)]
                assert frames.pop().is_error  # in lock-step the end of a tick is marked by an error frame
                assert [frame.can_id - fd.STAT_ID for frame in frames] == [1, 2, 3, 4, 5, 6, 7]
        os.kill(process.pid, signal.SIGINT)
        output, _ = process.communicate(timeout=30)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    drawn = load_world(tmp_path / "w.json")
    assert process.returncode == 0, output
    assert drawn.commitment in output
    assert "neither executor nor drives send 0x123 in the fd packing" in output
    assert "STAT 0x181 to 0x187" in output
    assert "0 frames disturbed by 'delay:0x185@12000'" in output
    for secret in (drawn.salt, drawn.object.mass_kg, drawn.object.coulomb_N, drawn.object.opening_m):
        assert str(secret) not in output
    assert not (tmp_path / "b.sock").exists()
    assert final_state(tmp_path / "t.csv").as_found == pytest.approx(drawn.object.opening_m)


def test_a_demo_whose_world_finds_no_place_says_so_with_its_code_and_leaves_no_half_world(tmp_path):
    """A limit on the size of files does what a full disk does, without one."""
    demo = [sys.executable, "-m", "s2r_protocol", "demo", "--out", tmp_path / "d"]
    limited = ["sh", "-c", 'ulimit -f 0; exec "$@"', "sh", *demo]
    ended = subprocess.run(limited, capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 3, ended.stderr
    assert "nothing can be written there; make room, raise the limit" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert list((tmp_path / "d").iterdir()) == []
