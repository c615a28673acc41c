"""The link against a small executor that speaks the real wire on a real session."""

import contextlib
import dataclasses
import datetime
import re
import socket
import threading
import time

import numpy as np
import pytest
import zenoh
from click.testing import CliRunner

from s2r_host.cli_stop import send_stop, stop
from s2r_host.console.jobs import JobBusyError
from s2r_host.console.operator import NoControlError, Operator
from s2r_host.errors import (
    ArmMismatchError,
    ArmStoppedError,
    CommandRefusedError,
    DamagedAnswerError,
    PeerUnreachableError,
)
from s2r_host.link import ExecutorLink
from s2r_host.link_observations import JOINTS, STATE
from s2r_host.link_session import open_session, silence_hint
from s2r_protocol import codec
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import ExitCode, UsageError
from s2r_protocol.faults import NOTHING_RECORDED, Cause, ExecutorState, Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.ros2 import pack, topic_key
from s2r_protocol.session.certificates import make_certificates

STATE_KEY = topic_key("/lab/xmate3pro/executor_state", STATE)


@dataclasses.dataclass(frozen=True)
class Path:
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class FakeExecutor:
    """Answers hello, lease, plan, control and recording; plans end when the test says so."""

    def __init__(self, endpoint: str, arm) -> None:
        self.arm = arm
        self.boot_id = 77
        self.status = pb.Status(
            state=ExecutorState.DISARMED, q_ref=[0.0] * 7, q_meas=[0.0] * 7, epoch=3, speed_scale=1.0
        )
        self.beats = []
        self.plans = []
        self.controls = []
        self.refuse = None
        self.ticking = True
        self.recording_parts = []
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("listen/endpoints", f'["{endpoint}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        keys = ArmKeys()
        for key, answer in (
            (keys.hello, self.on_hello),
            (keys.lease, lambda envelope: self.on_lease(envelope)),
            (keys.plan, self.on_plan),
            (keys.control, lambda envelope: self.on_control(envelope)),  # a test may replace it
            (keys.recording, self.on_recording),
        ):
            self.session.declare_queryable(key, lambda query, answer=answer: self.reply(query, answer))
        self.session.declare_subscriber(keys.heartbeat, lambda sample: self.beats.append(sample))

    def reply(self, query, answer) -> None:
        envelope = codec.open_envelope(query.payload.to_bytes())
        self.status.tick += self.ticking
        bodies = answer(envelope)
        for body in bodies if isinstance(bodies, list) else [bodies]:
            query.reply(query.key_expr, codec.seal(body, codec.Address("executor", boot_id=77)))
        query.drop()

    def on_hello(self, envelope):
        return pb.HelloReply(
            boot_id=self.boot_id,
            epoch=self.status.epoch,
            arm=self.arm.name,
            model_hash=self.arm.model_hash,
            limit_hash=self.arm.limit_hash,
            joint_names=self.arm.joint_names,
            tick_ns=1_000_000,
            status=self.status,
            host_timeout_ms=500,
        )

    def on_lease(self, envelope):
        release = codec.open_body(envelope, pb.LeaseRequest).release
        if self.refuse:
            return pb.LeaseReply(granted=False, holder="host:1", reason=self.refuse)
        self.status.lease_holder = "" if release else envelope.sender
        return pb.LeaseReply(granted=True, epoch=self.status.epoch, holder=envelope.sender)

    def on_plan(self, envelope):
        if self.refuse:
            return pb.Verdict(accepted=False, code=Refusal.VELOCITY, reason=self.refuse, seq=envelope.seq)
        if envelope.epoch != self.status.epoch:
            return pb.Verdict(accepted=False, code=Refusal.STALE, reason="stopped since", seq=envelope.seq)
        plan = codec.open_body(envelope, pb.Plan)
        self.plans.append((envelope, plan))
        self.status.state = ExecutorState.RUN
        self.status.plan_seq = envelope.seq
        self.status.plan_done = False
        return pb.Verdict(accepted=True, seq=envelope.seq, duration=plan.t[-1], epoch=self.status.epoch)

    def on_control(self, envelope):
        kind = codec.open_body(envelope, pb.Control).kind
        self.controls.append(kind)
        if kind == pb.ARM:
            self.status.epoch += 1
            self.status.state = ExecutorState.HOLD
        if kind == pb.DISARM:
            self.status.epoch += 1
            self.status.cause = Cause.DISARM_REQUESTED
            self.status.state = ExecutorState.DISARMED
        if kind == pb.STOP and self.status.state in (ExecutorState.HOLD, ExecutorState.RUN):
            self.status.epoch += 1
            self.status.cause = Cause.STOP_REQUESTED
            self.status.state = ExecutorState.HOLD
        return pb.Verdict(accepted=True, seq=envelope.seq, epoch=self.status.epoch)

    def on_recording(self, envelope):
        return self.recording_parts or [pb.RecordingReply(reason="no such plan")]

    def finish(self, state=ExecutorState.HOLD, cause=Cause.NONE) -> None:
        self.status.plan_done = cause == Cause.NONE
        self.status.cause = cause
        self.status.state = state


@pytest.fixture(scope="module")
def arm():
    return load_arm("xmate3pro")


@pytest.fixture
def executor(arm):
    endpoint = free_endpoint()
    fake = FakeExecutor(endpoint, arm)
    fake.endpoint = endpoint
    yield fake
    fake.session.close()


@pytest.fixture
def link(executor, arm):
    with ExecutorLink(executor.endpoint, arm, connect_timeout_s=5.0, query_timeout_s=1.0) as link:
        yield link


@pytest.fixture
def path():
    t = np.array([0.0, 1.0])
    q = np.array([np.zeros(7), np.full(7, 0.1)])
    return Path(t, q, np.zeros((2, 7)), np.zeros((2, 7)))


def test_absent_executor_is_unreachable_with_the_endpoint_in_the_text(arm):
    endpoint = free_endpoint()
    with pytest.raises(PeerUnreachableError, match=endpoint) as caught:
        ExecutorLink(endpoint, arm, connect_timeout_s=0.3)
    assert caught.value.exit_code == ExitCode.UNREACHABLE


def test_an_executor_that_starts_a_moment_later_is_met(arm):
    endpoint = free_endpoint()
    begun = []
    later = threading.Timer(0.7, lambda: begun.append(FakeExecutor(endpoint, arm)))
    later.start()
    try:
        with ExecutorLink(endpoint, arm, connect_timeout_s=10.0) as link:
            assert link.identity.boot_id == 77
    finally:
        later.join()
        begun[0].session.close()


def test_another_model_is_refused_with_both_hashes(executor, arm):
    class OtherArm:
        name, dof, joint_names = arm.name, arm.dof, arm.joint_names
        model_hash, limit_hash = b"\x01" * 32, arm.limit_hash

    with pytest.raises(ArmMismatchError, match="010101010101") as caught:
        ExecutorLink(executor.endpoint, OtherArm())
    assert arm.model_hash.hex()[:12] in str(caught.value)
    assert caught.value.exit_code == ExitCode.REFUSED


def test_other_limits_are_refused(executor, arm):
    class OtherArm:
        name, dof, joint_names = arm.name, arm.dof, arm.joint_names
        model_hash, limit_hash = arm.model_hash, b"\x02" * 32

    with pytest.raises(ArmMismatchError, match="limits"):
        ExecutorLink(executor.endpoint, OtherArm())


def test_heartbeat_lives_exactly_as_long_as_the_lease(executor, link):
    assert not executor.beats
    with link.leased():
        assert executor.status.lease_holder == link.name
        deadline = time.monotonic() + 5.0
        while len(executor.beats) < 5 and time.monotonic() < deadline:
            time.sleep(0.01)
        beat = codec.open_envelope(executor.beats[-1].payload.to_bytes())
        assert beat.boot_id == 77
        assert beat.epoch == 3
    counts = [
        codec.open_body(codec.open_envelope(s.payload.to_bytes()), pb.Heartbeat).count for s in executor.beats
    ]
    assert counts == list(range(1, len(counts) + 1))
    assert len(counts) >= 5
    assert executor.status.lease_holder == ""


def test_an_executor_started_again_is_met_anew(executor, link):
    executor.boot_id = 78
    link.meet()
    with link.leased():
        deadline = time.monotonic() + 5.0
        while not executor.beats and time.monotonic() < deadline:
            time.sleep(0.01)
        assert codec.open_envelope(executor.beats[-1].payload.to_bytes()).boot_id == 78


def test_lease_held_by_another_is_refused_by_name(executor, link):
    executor.refuse = "held by host:1 since 12 s"
    with pytest.raises(CommandRefusedError, match="held by host:1"):
        link.take_lease()


def test_plan_carries_names_hashes_knots_and_rising_numbers(executor, link, path, arm):
    with link.leased():
        link.arm_drives()
        first = link.send_plan(path, "push 1")
        executor.finish()
        assert link.wait_done(first).plan_done
        link.send_plan(path, "push 2")
        executor.finish()
    (one, plan), (two, _) = executor.plans
    assert two.seq > one.seq
    assert one.model_hash == arm.model_hash
    assert tuple(plan.joint_names) == arm.joint_names
    assert np.array_equal(np.reshape(plan.q, (2, 7)), path.q)
    assert plan.label == "push 1"


def test_refused_plan_raises_the_verdicts_sentence(executor, link, path):
    executor.refuse = "joint 'joint2': velocity 3.1 rad/s at t = 0.4 s is over 2.618 rad/s"
    with pytest.raises(CommandRefusedError, match=r"joint2.*2\.618") as caught:
        link.send_plan(path, "too fast")
    assert caught.value.code == Refusal.VELOCITY
    assert caught.value.exit_code == ExitCode.REFUSED


def test_protection_stop_ends_the_wait_with_its_cause(executor, link, path):
    verdict = link.send_plan(path, "push")
    threading.Timer(0.1, lambda: executor.finish(ExecutorState.FAULT, Cause.FOLLOWING)).start()
    with pytest.raises(ArmStoppedError, match="FOLLOWING") as caught:
        link.wait_done(verdict)
    assert caught.value.cause == Cause.FOLLOWING
    assert caught.value.exit_code == ExitCode.PROTECTION


def test_requested_stop_ends_the_wait_too(executor, link, path):
    verdict = link.send_plan(path, "push")
    send_stop(executor.endpoint, ArmKeys(), timeout_s=2.0)
    with pytest.raises(ArmStoppedError, match="on request"):
        link.wait_done(verdict)


def in_lease(link, act):
    """Whatever ``act`` does with the drives on."""
    with link.leased():
        link.arm_drives()
        act()


def fail(error):
    raise error


def stop_elsewhere(executor):
    """Somebody else's; the arm holds afterwards."""
    send_stop(executor.endpoint, ArmKeys(), timeout_s=2.0)


def test_a_stop_from_another_thread_makes_what_was_to_be_sent_stale(executor, link, path):
    def send_after_stop():
        stopping = threading.Thread(target=link.stop)
        stopping.start()
        stopping.join()
        link.send_plan(path, "push")

    with pytest.raises(CommandRefusedError, match="STALE"):
        in_lease(link, send_after_stop)
    assert not executor.plans


def test_a_stop_while_the_host_computes_is_not_forgotten(executor, link, path):
    with link.leased():
        link.arm_drives()
    stop_elsewhere(executor)
    assert link.status().state == ExecutorState.HOLD  # asking makes no difference
    for _ in range(2):  # nor does trying again
        with pytest.raises(ArmStoppedError, match="STOP_REQUESTED") as caught, link.leased():
            link.send_plan(path, "push")
        assert caught.value.exit_code == ExitCode.PROTECTION
        assert executor.status.lease_holder == ""
    assert not executor.plans


def test_drives_switched_off_while_the_host_computes_are_not_switched_on_again(executor, link):
    with link.leased():
        link.arm_drives()
    executor.on_control(codec.open_envelope(codec.seal(pb.Control(kind=pb.DISARM), codec.Address("other"))))
    with pytest.raises(ArmStoppedError, match="DISARM_REQUESTED"), link.leased():
        link.arm_drives()
    assert executor.status.state == ExecutorState.DISARMED


def test_whoever_says_hello_anew_goes_on_after_a_stop(executor, link, path):
    with link.leased():
        link.arm_drives()
    stop_elsewhere(executor)
    link.meet()
    with link.leased():
        link.send_plan(path, "push")
    assert len(executor.plans) == 1


def test_a_host_goes_on_after_its_own_stop_and_after_one_it_was_told_of(executor, link, path):
    def push_until_stopped():
        verdict = link.send_plan(path, "push")
        stop_elsewhere(executor)
        link.wait_done(verdict)

    with pytest.raises(ValueError, match="a bug"):
        in_lease(link, lambda: fail(ValueError("a bug")))
    with pytest.raises(ArmStoppedError, match="on request"):
        in_lease(link, push_until_stopped)
    with link.leased():
        link.send_plan(path, "push again")
    assert len(executor.plans) == 2


def test_a_stop_between_the_last_motion_and_the_end_of_the_lease_counts(executor, link, path):
    with link.leased():
        link.arm_drives()
        verdict = link.send_plan(path, "push")
        executor.finish()
        link.wait_done(verdict)
        stop_elsewhere(executor)
    with pytest.raises(ArmStoppedError), link.leased():
        pass


def test_a_stop_right_after_arming_counts(executor, link, path):
    answer = executor.on_control

    def stopped_at_once(envelope):
        verdict = answer(envelope)
        if codec.open_body(envelope, pb.Control).kind == pb.ARM:
            executor.status.epoch += 1
            verdict.epoch += 1
        return verdict

    executor.on_control = stopped_at_once
    with pytest.raises(CommandRefusedError, match="STALE"):
        in_lease(link, lambda: link.send_plan(path, "push"))


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_lease_that_ends_early_leaves_the_arm_at_rest_first(executor, link, path, error):
    """Ctrl-C in a replay is a stop on request; the end of the lease would stop the arm as "host lost"."""
    at_release = []
    answer = executor.on_lease

    def on_lease(envelope):
        if codec.open_body(envelope, pb.LeaseRequest).release:
            at_release.append(ExecutorState(executor.status.state))
        return answer(envelope)

    executor.on_lease = on_lease

    def push_and_fail():
        link.send_plan(path, "push")
        raise error

    with pytest.raises(error):
        in_lease(link, push_and_fail)
    assert pb.STOP in executor.controls
    assert at_release == [ExecutorState.HOLD]


def test_a_second_interrupt_still_returns_the_lease(executor, link, monkeypatch):
    monkeypatch.setattr(link, "wait_at_rest", lambda: fail(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        in_lease(link, lambda: fail(ValueError("a bug")))
    assert executor.status.lease_holder == ""


def test_a_heartbeat_that_ends_is_said_once_and_ends_the_wait(executor, link, path, monkeypatch, caplog):
    failing = threading.Event()
    beat = link._heartbeat_bytes

    def beat_or_fail(count):
        if failing.is_set():
            raise zenoh.ZError("session closed")
        return beat(count)

    monkeypatch.setattr(link, "_heartbeat_bytes", beat_or_fail)

    def push_until_it_fails():
        verdict = link.send_plan(path, "push")
        failing.set()
        link.wait_done(verdict)

    with pytest.raises(PeerUnreachableError, match=r"heartbeat .* has ended \(session closed\)"):
        in_lease(link, push_until_it_fails)
    assert caplog.text.count("the heartbeat ended") == 1
    assert executor.status.state == ExecutorState.HOLD


def test_executor_that_dies_during_a_plan_is_noticed(executor, link, path):
    verdict = link.send_plan(path, "push")
    executor.session.close()
    with pytest.raises(PeerUnreachableError):
        link.wait_done(verdict)


def test_an_executor_that_was_started_again_during_a_plan_is_noticed(executor, link, path):
    """Its clock goes on, and what was sent to the one before it never ends there."""
    verdict = link.send_plan(path, "push")
    executor.boot_id, executor.status.plan_seq = 78, 0
    executor.status.epoch, executor.status.state = 1, ExecutorState.DISARMED
    with pytest.raises(PeerUnreachableError, match=f"started again during plan {verdict.seq}"):
        link.wait_done(verdict)


def test_a_stop_before_a_plan_takes_over_ends_the_wait_for_it(executor, link, path):
    """The executor goes on to name the plan that played."""
    running = link.send_plan(path, "push")
    waiting = link.send_plan(path, "corrected push", running=running, splice_t=0.5)
    executor.status.plan_seq, executor.status.epoch = running.seq, waiting.epoch + 1
    executor.finish(cause=Cause.STOP_REQUESTED)
    with pytest.raises(ArmStoppedError, match="STOP_REQUESTED"):
        link.wait_done(waiting)


@pytest.mark.parametrize("waits_for", ["the one that played", "the one that waited"])
def test_a_plan_whose_place_a_newer_splice_took_ends_the_wait_for_it(executor, link, path, waits_for):
    """Nothing stopped the arm, so the epoch is the same, and the executor names the plan that came to its end."""
    running = link.send_plan(path, "push")
    waiting = link.send_plan(path, "corrected push", running=running, splice_t=0.5)
    newest = link.send_plan(path, "corrected again", running=running, splice_t=0.6)
    executor.finish()
    lost = running if waits_for == "the one that played" else waiting
    with pytest.raises(
        ArmStoppedError, match=f"plan {lost.seq} was not played to its end: plan {newest.seq}"
    ):
        link.wait_done(lost)
    assert link.wait_done(newest).plan_done


@pytest.mark.parametrize(
    "wire", [b"", b"S2R1 and so on", codec.seal(pb.Frame(), codec.Address(sender="camera"))]
)
def test_an_answer_that_cannot_be_read_is_refused_by_name(link, path, wire, monkeypatch):
    monkeypatch.setattr("s2r_host.link.ask", lambda *_: [wire])
    for question in (
        link.status,
        lambda: link.send_plan(path, "push"),
        link.take_lease,
        lambda: link.recording(1),
    ):
        with pytest.raises(
            DamagedAnswerError, match=f"executor at {link._endpoint} sent an answer"
        ) as caught:
            question()
        assert caught.value.exit_code == ExitCode.REFUSED


def test_clock_that_stands_still_is_noticed(executor, link, path):
    verdict = link.send_plan(path, "push")
    executor.ticking = False
    with pytest.raises(PeerUnreachableError, match="stands still"):
        link.wait_done(verdict, stalled_s=0.2)


def test_published_states_are_followed_without_asking(executor, link, path):
    verdict = link.send_plan(path, "push")
    asked = executor.status.tick
    done = {
        "state": int(ExecutorState.HOLD),
        "plan_seq": verdict.seq,
        "plan_done": True,
        "epoch": verdict.epoch,
    }

    def publish():
        for tick in range(30):
            body = {**done, "state": int(ExecutorState.RUN), "plan_done": False, "tick": tick}
            executor.session.put(STATE_KEY, pack(STATE, body))
            time.sleep(0.01)
        executor.finish()
        executor.session.put(STATE_KEY, pack(STATE, {**done, "tick": 99}))

    thread = threading.Thread(target=publish)
    thread.start()
    assert link.wait_done(verdict).plan_done
    thread.join()
    assert executor.status.tick - asked < 15  # far fewer questions than the 30 states that were published


def test_a_fault_that_was_reset_just_now_does_not_end_the_arming(executor, link):
    """The newest published state is from before the reset."""
    stale = {"state": int(ExecutorState.FAULT), "cause": int(Cause.COLLISION)}
    executor.session.put(STATE_KEY, pack(STATE, stale))
    deadline = time.monotonic() + 5.0
    while link.state() is None:
        assert time.monotonic() < deadline
        executor.session.put(STATE_KEY, pack(STATE, stale))
        time.sleep(0.01)
    assert link.state().state == ExecutorState.FAULT
    assert link.arm_drives().state == ExecutorState.HOLD


@contextlib.contextmanager
def published(executor):
    """The executor's state goes out every 20 ms, as a live one's does."""
    ended = threading.Event()

    def publish():
        while not ended.wait(0.02):
            executor.session.put(STATE_KEY, pack(STATE, {"state": int(executor.status.state)}))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.fixture
def slow(executor):
    """The first control command takes longer than a query lasts; the numbers of all that came."""
    answer, seen = executor.on_control, []

    def late(envelope):
        seen.append(envelope.seq)
        if len(seen) == 1:
            time.sleep(2.5)
        return answer(envelope)

    executor.on_control = late
    return seen


def test_a_live_executor_is_waited_for_and_asked_again_with_the_same_command(slow, executor, link):
    with published(executor), link.leased():
        assert link.arm_drives().state == ExecutorState.HOLD
    assert len(slow) > 1
    assert len(set(slow)) == 1


def test_an_executor_that_neither_answers_nor_publishes_is_gone(slow, executor, link):
    with link.leased(), pytest.raises(PeerUnreachableError, match="did not answer on"):
        link.arm_drives()


def test_an_executor_that_dies_under_a_lease_is_named_and_not_the_lease_that_went_with_it(executor, link):
    def lose_it() -> None:
        with link.leased():
            executor.session.close()
            link.status()

    with pytest.raises(PeerUnreachableError, match="has not answered for 1 s, and did before"):
        lose_it()
    with pytest.raises(PeerUnreachableError, match=r"did not answer on '.*/ctl'; it has ended"):
        link.stop()


def test_silence_after_the_own_certificate_ended_is_told_as_that(executor, link, tmp_path):
    long_ago = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=40)
    make_certificates(tmp_path, days=30, now=long_ago)
    link._tls = tmp_path
    executor.session.close()
    with pytest.raises(PeerUnreachableError, match=r"and did before: .*host.pem holds from .* renew it"):
        link.status()
    assert "host.pem holds from" in silence_hint(tmp_path)


def test_published_joints_reach_the_host(executor, link):
    body = {"header": {"stamp": {"sec": 3, "nanosec": 5}}, "position": np.arange(7.0), "velocity": np.ones(7)}
    executor.session.put(topic_key("/lab/xmate3pro/joint_states", JOINTS), pack(JOINTS, body))
    deadline = time.monotonic() + 5.0
    while (sample := link.joints()) is None and time.monotonic() < deadline:
        executor.session.put(topic_key("/lab/xmate3pro/joint_states", JOINTS), pack(JOINTS, body))
        time.sleep(0.02)
    assert sample.stamp_ns == 3_000_000_005
    assert np.array_equal(sample.q, np.arange(7.0))


def test_recording_is_put_together_from_its_chunks(executor, link):
    executor.recording_parts = [
        pb.RecordingReply(plan_seq=1, complete=True, mcap=b"one", pieces=2),
        pb.RecordingReply(plan_seq=1, complete=True, mcap=b"two", pieces=2),
    ]
    assert link.recording(1) == b"onetwo"


def test_a_recording_that_lost_a_chunk_on_its_way_is_not_taken_for_whole(executor, link):
    executor.recording_parts = [pb.RecordingReply(plan_seq=1, complete=True, mcap=b"one", pieces=2)]
    with pytest.raises(CommandRefusedError, match=r"incomplete after 0\.3 s; 1 of 2 pieces came"):
        link.recording(1, timeout_s=0.3)


def test_an_executor_that_records_nothing_is_told_before_anything_moves(executor, link):
    link.check_records()
    executor.recording_parts = [pb.RecordingReply(reason=NOTHING_RECORDED)]
    with pytest.raises(
        CommandRefusedError, match=r"records nothing; start it with --record DIR; nothing was moved"
    ):
        link.check_records()


def test_missing_recording_is_refused_with_the_reason(executor, link):
    with pytest.raises(CommandRefusedError, match="no such plan"):
        link.recording(9)


def test_a_console_whose_lease_ended_by_silence_takes_it_anew(executor, arm):
    """As on a machine that was suspended: the page has control, the executor has taken the lease away."""
    operator = Operator(executor.endpoint, arm, ArmKeys())
    with contextlib.closing(operator):
        operator.take_control(1)
        operator.command(1, lambda link: link.arm_drives())
        answer = executor.on_control
        executor.on_control = lambda envelope: pb.Verdict(code=Refusal.NO_LEASE, reason="it lost the lease")
        with pytest.raises(CommandRefusedError, match="lost the lease"):
            operator.command(1, lambda link: link.pause())
        executor.on_control = answer
        assert (operator.controller, operator.has_lease) == (None, False)
        executor.status.lease_holder = ""
        operator.take_control(1)
        assert executor.status.lease_holder != ""
        operator.command(1, lambda link: link.pause())


def test_a_console_leaves_the_lease_to_the_run_it_started_until_that_has_ended(executor, arm):
    """A run plans between its motions with the lease free: taken then, the next motion is refused and the run ends."""
    under_way = [True]
    operator = Operator(executor.endpoint, arm, ArmKeys())
    with contextlib.closing(operator):
        operator.take_control(1)
        assert executor.status.lease_holder != ""
        operator.lend_lease(1, lambda: lambda: under_way[0])
        assert executor.status.lease_holder == ""
        for act in (ExecutorLink.arm_drives, lambda link: link.set_speed(0.5)):
            with pytest.raises(NoControlError, match="the run that this console started has the lease"):
                operator.command(1, act)
        operator.take_control(1)
        operator.give_back(1)
        operator.take_control(2)  # to cancel the run, from another page
        assert (executor.status.lease_holder, operator.has_lease) == ("", False)
        assert operator.stop().startswith("stop accepted")
        under_way[0] = False
        operator.command(2, lambda link: link.pause())
        assert operator.has_lease


def test_a_job_that_cannot_be_started_has_borrowed_nothing(executor, arm):
    def busy():
        raise JobBusyError("another is still running")

    operator = Operator(executor.endpoint, arm, ArmKeys())
    with contextlib.closing(operator):
        operator.take_control(1)
        with pytest.raises(JobBusyError):
            operator.lend_lease(1, busy)
        operator.command(1, lambda link: link.pause())


def test_stop_needs_no_lease(executor):
    verdict, before = send_stop(executor.endpoint, ArmKeys(), timeout_s=2.0)
    assert verdict.accepted
    assert before.lease_holder == ""


def test_a_stop_finds_its_arm_by_the_folder_of_its_description(executor, arm, tmp_path):
    (tmp_path / "arm.yaml").write_text(f"name: {arm.name}\n")
    options = ["--executor", executor.endpoint, "--timeout", "2", "--arm"]
    ended = CliRunner().invoke(stop, [*options, str(tmp_path)])
    assert ended.exit_code == 0, ended.output
    assert f"stop accepted by lab/{arm.name}" in ended.output
    assert executor.controls == [pb.STOP]
    (tmp_path / "arm.yaml").write_text("name: another\n")
    ended = CliRunner().invoke(
        stop, ["--executor", executor.endpoint, "--timeout", "0.2", "--arm", str(tmp_path)]
    )
    assert isinstance(ended.exception, PeerUnreachableError)
    assert executor.controls == [pb.STOP]


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (None, "there is no .*arm.yaml; name the folder"),
        ("name: [", "is no YAML"),
        ("joints: []\n", "says no 'name'"),
    ],
)
def test_a_folder_that_names_no_arm_stops_nothing_and_says_so(tmp_path, said, reason):
    if said is not None:
        (tmp_path / "arm.yaml").write_text(said)
    ended = CliRunner().invoke(stop, ["--arm", str(tmp_path)])
    assert isinstance(ended.exception, UsageError)
    assert re.search(f"{reason}.*nothing was sent", str(ended.exception), re.DOTALL)


def test_stop_without_executor_says_that_nothing_was_stopped():
    with pytest.raises(PeerUnreachableError, match="nothing was stopped"):
        send_stop(free_endpoint(), ArmKeys(), timeout_s=0.2)


def test_session_to_nobody_opens_at_once_and_answers_nothing():
    session = open_session(free_endpoint(), ArmKeys())
    assert list(session.get("lab/xmate3pro/hello", timeout=0.2)) == []
    session.close()
