"""The bridge over a real Zenoh link: sealed queries in, verdicts and ROS 2 observations out."""

from __future__ import annotations

import json
import re
import socket
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from click.testing import CliRunner

from s2r_executor.bridge import Bridge
from s2r_executor.config import load_config
from s2r_executor.front_end import FrontEnd
from s2r_executor.observations import TOPICS, Encoder, Timeline
from s2r_executor.recorder import Recorder
from s2r_host import cli_drives
from s2r_protocol import codec
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import ExitCode, S2RError
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.ros2 import topic_key, unpack

KEYS = ArmKeys("lab", "xmate3pro")


def load_stepped_core():
    """The core of the unit tests; test folders are no packages."""
    import importlib.util
    from pathlib import Path

    path = Path(__file__).parents[1] / "unit" / "executor" / "conftest.py"
    spec = importlib.util.spec_from_file_location("executor_fixtures", path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    assert spec.loader is not None
    spec.loader.exec_module(module)
    return module.SteppedCore


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def rig(tmp_path):
    arm = load_arm("xmate3pro")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = load_config(overrides={"bus": "unix:none", "listen": [endpoint], "host_timeout_s": 5.0})
    core = load_stepped_core()(arm)
    encoder = Encoder(arm, Timeline(0, 1_000_000, stepped=True))
    recorder = Recorder(tmp_path, arm, "/lab/xmate3pro", encoder, config.recorder, {})
    front_end = FrontEnd(arm, config, core, recorder)
    bridge = Bridge(front_end, encoder, config)
    session = _client(endpoint)
    ended = threading.Event()

    def watch():
        while not ended.wait(0.002):
            core.advance(20)
            bridge.publish_events(front_end.step())

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    yield SimpleNamespace(
        arm=arm, core=core, front_end=front_end, bridge=bridge, session=session, seq=0, endpoint=endpoint
    )
    ended.set()
    watcher.join()
    session.close()
    bridge.close()
    recorder.close()


def _client(endpoint):
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("connect/endpoints", [endpoint]),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def ask_raw(rig, key, wire):
    replies = rig.session.get(key, payload=wire, timeout=10.0, consolidation=zenoh.ConsolidationMode.NONE)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def address(rig, **changes):
    rig.seq += 1
    me = rig.front_end.identity
    values = {
        "sender": "host:test",
        "boot_id": me.boot_id,
        "epoch": rig.core.epoch,
        "seq": rig.seq,
        "model_hash": me.model_hash,
        "limit_hash": me.limit_hash,
    }
    return codec.Address(**{**values, **changes})


def ask(rig, key, body, expected, **changes):
    (wire,) = ask_raw(rig, key, codec.seal(body, address(rig, **changes)))
    return codec.open_body(codec.open_envelope(wire), expected)


def small_plan(rig, amount=0.05, duration=0.5):
    q = np.tile(rig.core.q, (2, 1))
    q[1, 0] += amount
    zeros = np.zeros(14)
    return pb.Plan(
        joint_names=rig.arm.joint_names, t=[0.0, duration], q=q.ravel(), dq=zeros, ddq=zeros, label="small"
    )


def armed(rig):
    assert ask(rig, KEYS.lease, pb.LeaseRequest(), pb.LeaseReply).granted
    assert ask(rig, KEYS.control, pb.Control(kind=pb.ARM), pb.Verdict).accepted


def wait_for(condition, what):
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline, f"timed out: {what}"
        time.sleep(0.005)


def test_hello_tells_arm_hashes_and_state(rig):
    reply = ask(
        rig, KEYS.hello, pb.Hello(client="t"), pb.HelloReply, boot_id=0, model_hash=b"", limit_hash=b""
    )
    assert reply.model_hash == rig.arm.model_hash
    assert reply.limit_hash == rig.arm.limit_hash
    assert tuple(reply.joint_names) == rig.arm.joint_names
    assert reply.tick_ns == 1_000_000
    assert reply.host_timeout_ms == 5000
    assert reply.status.state == ExecutorState.DISARMED
    np.testing.assert_allclose(
        reply.status.q_ref, rig.core.q, atol=1e-4
    )  # unpowered, it follows the encoders


def test_plan_runs_is_recorded_and_the_recording_comes_back(rig):
    armed(rig)
    verdict = ask(rig, KEYS.plan, small_plan(rig), pb.Verdict)
    assert (verdict.accepted, verdict.code, verdict.reason) == (True, 0, "")
    assert verdict.duration == 0.5
    wait_for(lambda: rig.core.plan_done, "plan")
    for _ in range(300):
        rig.core.advance(1)
    request = pb.RecordingRequest(plan_seq=verdict.seq)
    replies = []

    def complete():
        replies[:] = [
            codec.open_body(codec.open_envelope(w), pb.RecordingReply)
            for w in ask_raw(rig, KEYS.recording, codec.seal(request, address(rig)))
        ]
        return all(reply.complete for reply in replies)

    wait_for(complete, "recording")
    data = b"".join(reply.mcap for reply in replies)
    assert data.startswith(b"\x89MCAP")
    assert data.endswith(b"\x89MCAP0\r\n")


def test_a_refused_plan_names_joint_time_quantity_value_and_limit(rig):
    armed(rig)
    verdict = ask(rig, KEYS.plan, small_plan(rig, amount=2.0, duration=0.3), pb.Verdict)
    assert not verdict.accepted
    assert verdict.joint == "joint1"
    assert 0 < verdict.t < 0.3
    assert verdict.quantity in ("velocity", "acceleration")
    assert abs(verdict.value) > abs(verdict.limit) > 0
    assert "joint1" in verdict.reason
    assert rig.core.submitted == []


def test_a_plan_for_fewer_joints_is_one_for_another_model(rig):
    armed(rig)
    plan = small_plan(rig)
    del plan.joint_names[-1]
    verdict = ask(rig, KEYS.plan, plan, pb.Verdict)
    assert (verdict.code, verdict.quantity) == (Refusal.MODEL, "joint_names")
    assert (verdict.value, verdict.limit) == (6, 7)


def test_a_duplicated_message_acts_once_and_gets_the_same_answer_each_time(rig):
    armed(rig)
    wire = codec.seal(small_plan(rig), address(rig))
    first = ask_raw(rig, KEYS.plan, wire)
    wait_for(lambda: rig.core.plan_done, "plan")
    for _ in range(50):
        again = ask_raw(rig, KEYS.plan, wire)
        assert codec.open_envelope(again[0]).body == codec.open_envelope(first[0]).body
    assert len(rig.core.submitted) == 1


def test_a_stop_of_the_same_bytes_stops_every_time(rig):
    """A button that needs no handshake sends nothing else."""
    armed(rig)
    wire = codec.seal(pb.Control(kind=pb.STOP), codec.Address(sender="button"))
    for _ in range(3):
        ask(rig, KEYS.plan, small_plan(rig), pb.Verdict)
        epoch = rig.core.epoch
        (reply,) = ask_raw(rig, KEYS.control, wire)
        verdict = codec.open_body(codec.open_envelope(reply), pb.Verdict)
        assert (verdict.accepted, verdict.epoch) == (True, epoch + 1)
        wait_for(lambda: rig.core.state == ExecutorState.HOLD, "rest")
        assert rig.core.cause == Cause.STOP_REQUESTED


def test_of_two_reordered_plans_the_older_is_stale(rig):
    armed(rig)
    older, newer = address(rig), address(rig)
    ask_raw(rig, KEYS.plan, codec.seal(small_plan(rig), newer))
    wait_for(lambda: rig.core.plan_done, "plan")
    (wire,) = ask_raw(rig, KEYS.plan, codec.seal(small_plan(rig), older))
    verdict = codec.open_body(codec.open_envelope(wire), pb.Verdict)
    assert (verdict.accepted, verdict.code) == (False, Refusal.STALE)
    assert len(rig.core.submitted) == 1


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"boot_id": 1}, Refusal.STALE),
        ({"epoch": 77}, Refusal.STALE),
        ({"model_hash": b"x" * 32}, Refusal.MODEL),
        ({"limit_hash": b""}, Refusal.MODEL),
        ({"sender": "somebody"}, Refusal.NO_LEASE),
    ],
)
def test_a_wrong_envelope_is_refused_before_its_body_is_parsed(rig, changes, code, monkeypatch):
    armed(rig)

    def must_not_parse(*_):
        raise AssertionError("the body was parsed")

    monkeypatch.setattr("s2r_executor.bridge.plan_from_message", must_not_parse)
    assert ask(rig, KEYS.plan, small_plan(rig), pb.Verdict, **changes).code == code
    assert rig.core.submitted == []


def test_every_single_bit_flip_of_a_plan_message_is_refused(rig):
    """Through the same steps as a received query, without the network in between."""
    armed(rig)
    wire = codec.seal(small_plan(rig), address(rig))
    for bit in range(8 * len(wire)):
        damaged = bytearray(wire)
        damaged[bit // 8] ^= 1 << (bit % 8)
        with pytest.raises(codec.MessageRefusedError):
            codec.open_envelope(bytes(damaged))


@pytest.mark.parametrize("key", ["hello", "lease", "plan", "control", "recording"])
def test_rubbish_gets_an_answer_that_says_malformed(rig, key):
    for wire in (b"", b"S2R1", b"hello", b"S2R1\0\0\0\0", b"\xff" * 100):
        (reply,) = ask_raw(rig, getattr(KEYS, key), wire)
        verdict = codec.open_body(codec.open_envelope(reply), pb.Verdict)
        assert (verdict.accepted, verdict.code) == (False, Refusal.MALFORMED)
        assert verdict.reason


def test_a_message_of_another_kind_is_refused(rig):
    armed(rig)
    verdict = ask(rig, KEYS.plan, pb.Control(kind=pb.ARM), pb.Verdict)
    assert (verdict.accepted, verdict.code) == (False, Refusal.MALFORMED)


def test_stop_from_a_stranger_is_obeyed_and_a_second_host_gets_no_lease(rig):
    armed(rig)
    ask(rig, KEYS.plan, small_plan(rig, amount=0.3, duration=25.0), pb.Verdict)
    assert rig.core.state == ExecutorState.RUN
    other = ask(rig, KEYS.lease, pb.LeaseRequest(), pb.LeaseReply, sender="other")
    assert (other.granted, other.holder) == (False, "host:test")
    verdict = ask(rig, KEYS.control, pb.Control(kind=pb.STOP), pb.Verdict, sender="stop:1", epoch=0, seq=1)
    assert verdict.accepted
    wait_for(lambda: rig.core.state == ExecutorState.HOLD, "rest")
    assert verdict.epoch == rig.core.epoch


def test_observations_are_ros_messages_on_rmw_zenoh_keys_with_attachments(rig):
    received = {}
    names = {
        "joint_states": "sensor_msgs/msg/JointState",
        "joint_commands": "sensor_msgs/msg/JointState",
        "executor_state": "s2r_msgs/msg/ExecutorState",
        "events": "rcl_interfaces/msg/Log",
    }
    subscribers = [
        rig.session.declare_subscriber(
            topic_key(f"/lab/xmate3pro/{topic}", type_name),
            lambda sample, topic=topic, type_name=type_name: received.setdefault(topic, []).append(
                (unpack(type_name, sample.payload.to_bytes()), sample.attachment.to_bytes())
            ),
        )
        for topic, type_name in names.items()
    ]
    armed(rig)
    ask(rig, KEYS.plan, small_plan(rig), pb.Verdict)
    wait_for(lambda: set(received) == set(names), f"topics, got {sorted(received)}")
    assert received["joint_states"][0][0]["name"] == list(rig.arm.joint_names)
    assert received["executor_state"][0][0]["lease_holder"] in ("", "host:test")
    wait_for(
        lambda: any("STATE, in ARMING" in event["msg"] for event, _ in received["events"]), "that it arms"
    )
    assert all(len(attachment) == 33 for seen in received.values() for _, attachment in seen)
    for subscriber in subscribers:
        subscriber.undeclare()


def test_the_ros_graph_shows_the_publishers(rig):
    tokens = [str(r.ok.key_expr) for r in rig.session.liveliness().get("@ros2_lv/**", timeout=5.0) if r.ok]
    assert sum("/NN/" in token for token in tokens) == 1
    assert sum("/MP/" in token for token in tokens) == len(TOPICS)


def test_the_executors_own_certificate_is_looked_after_as_long_as_it_runs(rig):
    looked = threading.Semaphore(0)
    rig.bridge._expiry = SimpleNamespace(look=looked.release)
    assert all(looked.acquire(timeout=10) for _ in range(2))


def test_a_second_executor_on_the_same_address_is_told_so(rig):
    from s2r_protocol.exits import NotReadyError

    config = load_config(overrides={"bus": "unix:none", "listen": [rig.endpoint]})
    with pytest.raises(NotReadyError, match="--listen"):
        Bridge(rig.front_end, Encoder(rig.arm, Timeline(0, 1, stepped=True)), config)


def test_publishing_that_fails_is_logged_and_seen_by_whoever_looks_after_the_executor(
    rig, monkeypatch, caplog
):
    from s2r_protocol.exits import NotReadyError

    rig.bridge.check()

    def fail(status):
        raise zenoh.ZError("the session is gone")

    monkeypatch.setattr(rig.bridge._encoder, "snapshot", fail)
    rig.bridge._publishing.join(60)
    with pytest.raises(NotReadyError, match="publishes no more: the session is gone"):
        rig.bridge.check()
    assert "publishing failed" in caplog.text


def test_an_executor_whose_address_is_taken_leaves_no_process_and_no_thread(rig, tmp_path, monkeypatch):
    from s2r_executor import assembly
    from s2r_protocol.exits import NotReadyError

    class Process:
        core = rig.core

        def __init__(self, config, arm):
            self.killed = False

        def kill(self):
            self.killed = True

    writers = []

    class Recorder(assembly.Recorder):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            writers.append(self)

    monkeypatch.setattr(assembly, "CoreProcess", Process)
    monkeypatch.setattr(assembly, "Recorder", Recorder)
    before = set(threading.enumerate())
    config = load_config(
        overrides={"bus": "unix:none", "listen": [rig.endpoint], "record": str(tmp_path / "records")}
    )
    with pytest.raises(NotReadyError, match="--listen"):
        assembly.Executor(config)
    (recorder,) = writers
    assert recorder._process.poll() is not None
    assert not [t for t in set(threading.enumerate()) - before if t.name.startswith("s2r-")]


# -- a client of somebody else's ----------------------------------------------------------------------


def test_the_page_s_client_moves_the_arm_and_is_not_locked_out_when_it_starts_again(rig, capsys):
    page = (Path(__file__).parents[2] / "docs/how-to/own-client.md").read_text()
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    assert "tcp/127.0.0.1:7447" in code
    for start in (1, 2):
        exec(compile(code.replace("tcp/127.0.0.1:7447", rig.endpoint), "own-client.md", "exec"), {})
        assert rig.core.q[0] == pytest.approx(rig.arm.q_home[0] + 0.2 * start, abs=5e-3)
    assert capsys.readouterr().out.count("joint1: ") == 2
    assert rig.core.state == ExecutorState.DISARMED
    assert rig.front_end.status().lease_holder == ""


# -- the terminal's commands --------------------------------------------------------------------------


def s2r(rig, name, *more):
    """Exit code and what is said of a command that talks with this executor."""
    arguments = [name, "--executor", rig.endpoint, *more]
    out = CliRunner().invoke(getattr(cli_drives, name), arguments[1:])
    if isinstance(out.exception, S2RError):
        return out.exception.exit_code, str(out.exception)
    assert out.exception is None, out.exception
    return out.exit_code, out.output


def test_a_terminal_clears_a_latch_and_arms_again_and_gives_the_lease_back_each_time(rig):
    code, said = s2r(rig, "arm")
    assert code == ExitCode.OK
    assert "it was DISARMED, it is HOLD" in said
    rig.core.drives[0].brake_released, rig.core.drives[0].brake_stuck = False, False
    rig.core.until(ExecutorState.FAULT)
    rig.core.drives[0].brake_stuck = None
    code, said = s2r(rig, "arm")
    assert code == ExitCode.REFUSED
    assert "refused ARM: ARM is not possible in FAULT" in said
    assert "'s2r reset', then 's2r arm'" in said
    code, said = s2r(rig, "reset")
    assert code == ExitCode.OK, said
    assert "it was FAULT, it is DISARMED" in said
    assert s2r(rig, "arm")[0] == ExitCode.OK
    code, said = s2r(rig, "disarm")
    assert code == ExitCode.OK, said
    assert rig.core.state == ExecutorState.DISARMED
    assert rig.front_end.status().lease_holder == ""


def test_a_terminal_gets_no_lease_while_another_client_holds_it(rig):
    assert ask(rig, KEYS.lease, pb.LeaseRequest(), pb.LeaseReply).granted
    code, said = s2r(rig, "arm")
    assert code == ExitCode.REFUSED
    assert "'host:test' holds the lease" in said
    assert rig.core.state == ExecutorState.DISARMED


def test_the_state_is_told_in_words_and_as_json(rig, tmp_path):
    code, said = s2r(rig, "state")
    assert code == ExitCode.OK
    assert "lab/xmate3pro at" in said
    assert "DISARMED. The drives are off" in said
    (tmp_path / "arm.yaml").write_text("name: xmate3pro\n")
    told = json.loads(s2r(rig, "state", "--json", "--arm", str(tmp_path))[1])
    assert (told["state"], told["cause"], told["lease_holder"]) == ("DISARMED", "NONE", "")
    assert told["joint_names"] == list(rig.arm.joint_names)


def test_silence_says_that_nothing_was_sent():
    code, said = s2r(SimpleNamespace(endpoint=f"tcp/127.0.0.1:{free_port()}"), "reset", "--timeout", "0.2")
    assert code == ExitCode.UNREACHABLE
    assert "RESET was not sent" in said
