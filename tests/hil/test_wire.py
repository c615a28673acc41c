"""T01, T05, T06, T08 to T21, T53, T55, T56, T58 with real processes: ``s2r executor`` with its ``s2r-rt`` and Zenoh.

The drives are the bench's, in lock-step, as fast as the machine goes. What is refused must leave no mark on the bus.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from hil_bench import ARM, DOF, LIMITS
from hil_front_end import move

from s2r_protocol import codec
from s2r_protocol.can.timing import BitRate
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_sim.bus import oracle
from s2r_sim.bus.bus import Bus
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.hub import Hub
from s2r_sim.bus.log import BusLog
from s2r_sim.bus.wire import Wire
from s2r_sim.drives_alone import DrivesAlone

KEYS = ArmKeys("lab", ARM.name)
DEADLINE_S = 60.0


def wait_for(condition, what="it"):
    deadline = time.monotonic() + DEADLINE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what} did not happen"
        time.sleep(0.01)
    return found


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Live:
    """Drives in a thread, the executor as a process, a raw client."""

    def __init__(self, folder: Path, limit_file_bytes: int | None = None, **options: object) -> None:
        self.plant = DrivesAlone(ARM)
        nodes = FdNodes(self.plant.drives)
        self.hub = Hub(f"unix:{folder}/bus")
        self.bus = Bus(self.hub, Wire(nodes.tick_ns, BitRate()), nodes, self.plant)
        self.log = BusLog()
        self.bus.taps.append(self.log)
        self.drives = threading.Thread(target=self.bus.run_lockstep, args=(0.0,), daemon=True)
        self.drives.start()
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        settings = {"core.collision_share": 10.0, "host_timeout_s": 5.0, **options}
        arguments = ["executor", "--bus", f"unix:{folder}/bus", "--clock", "lockstep", "--pace", "2"]
        arguments += [
            "--listen",
            self.endpoint,
            "--record",
            str(folder / "rec"),
            "--ready-file",
            str(folder / "ready"),
        ]
        arguments += [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]

        self.log_file = folder / "log"
        with self.log_file.open("w") as stream:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "s2r_protocol", *arguments],
                stdout=stream,
                stderr=subprocess.STDOUT,
            )
        wait_for(lambda: (folder / "ready").exists() or self.process.poll() is not None, "start")
        assert self.process.poll() is None, self.log_file.read_text()
        if limit_file_bytes is not None:
            resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (limit_file_bytes, limit_file_bytes))
        self.session = self.connect()
        self.seq = int(time.time() * 1000)
        self.beating = threading.Event()
        self._ended = threading.Event()
        threading.Thread(target=self._beat, daemon=True).start()

    def connect(self):
        config = zenoh.Config()
        for key, value in (
            ("mode", "peer"),
            ("connect/endpoints", [self.endpoint]),
            ("listen/endpoints", []),
            ("scouting/multicast/enabled", False),
        ):
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    def core_pid(self) -> int:
        return int(Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()[0])

    def ask_raw(self, key: str, wire: bytes) -> list[bytes]:
        replies = self.session.get(
            key, payload=wire, timeout=20.0, consolidation=zenoh.ConsolidationMode.NONE
        )
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

    def hello(self) -> pb.HelloReply:
        (wire,) = self.ask_raw(KEYS.hello, codec.seal(pb.Hello(client="t"), codec.Address(sender="host:t")))
        return codec.open_body(codec.open_envelope(wire), pb.HelloReply)

    def address(self, **changes: object) -> codec.Address:
        self.seq += 1
        hello = self.hello()
        values = {
            "sender": "host:t",
            "boot_id": hello.boot_id,
            "epoch": hello.epoch,
            "seq": self.seq,
            "model_hash": ARM.model_hash,
            "limit_hash": ARM.limit_hash,
        }
        return codec.Address(**{**values, **changes})

    def ask(self, key: str, body, expected, **changes: object):
        (wire,) = self.ask_raw(key, codec.seal(body, self.address(**changes)))
        return codec.open_body(codec.open_envelope(wire), expected)

    def control(self, kind: int, value: float = 0.0, **changes: object) -> pb.Verdict:
        return self.ask(KEYS.control, pb.Control(kind=kind, value=value), pb.Verdict, **changes)

    def send(self, plan, **changes: object) -> pb.Verdict:
        return self.ask(KEYS.plan, message(plan), pb.Verdict, **changes)

    def _beat(self) -> None:
        template = None
        while not self._ended.wait(0.05):
            if self.beating.is_set():
                if template is None:
                    template = self.address(seq=1)
                with contextlib.suppress(Exception):
                    self.session.put(KEYS.heartbeat, codec.seal(pb.Heartbeat(count=1), template))

    def hold(self) -> None:
        """Lease, heartbeat, drives on."""
        self.ask(KEYS.lease, pb.LeaseRequest(), pb.LeaseReply)
        self.beating.set()
        if self.hello().status.state == ExecutorState.DISARMED:
            assert self.control(pb.ARM).accepted

    def status(self) -> pb.Status:
        return self.hello().status

    def at(self, state: ExecutorState) -> pb.Status:
        wait_for(lambda: self.status().state == state, state.name)
        return self.status()

    def trace(self) -> oracle.Trace:
        return oracle.read_fd(self.log.frames(), DOF)

    def moves(self, since: int) -> int:
        """Setpoints of enabled drives that differ from the one before, since that many frames."""
        trace = oracle.read_fd(self.log.frames(since), DOF)
        held = trace.enabled.all(axis=1) & (trace.control == 2)
        return int((np.diff(trace.counts[held], axis=0) != 0).any(axis=1).sum())

    def check_limits(self) -> None:
        report = oracle.Report()
        oracle.check_setpoints(self.trace(), LIMITS, report)
        oracle.check_rhythm(self.trace(), report)
        assert not report.violations, str(report)

    def close(self) -> None:
        self._ended.set()
        self.session.close()
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.bus.stop()
        self.drives.join(10)
        self.hub.close()


def message(plan) -> pb.Plan:
    body = pb.Plan(
        joint_names=plan.joint_names, t=plan.t, q=plan.q.ravel(), dq=plan.dq.ravel(), ddq=plan.ddq.ravel(),
        parent_seq=plan.parent_seq, splice_t=plan.splice_t, payload_mass=plan.payload_mass, label="hil",
    )  # fmt: skip
    body.payload_com.extend(plan.payload_com)
    return body


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    rig = Live(tmp_path_factory.mktemp("live"))
    yield rig
    rig.close()


@pytest.fixture
def holding(live):
    live.hold()
    live.at(ExecutorState.HOLD)
    return live


@pytest.fixture
def own(tmp_path):
    """An executor that the test may kill."""
    made = []

    def make(**options: object) -> Live:
        made.append(Live(tmp_path, **options))
        return made[-1]

    yield make
    for rig in made:
        rig.close()


def refused(rig, plan, code, **expected):
    """Refused with everything an operator needs, and nothing moved."""
    frames = len(rig.log)
    verdict = rig.send(plan)
    assert not verdict.accepted
    assert verdict.code == code, verdict.reason
    for name, value in expected.items():
        assert getattr(verdict, name) == value, verdict.reason
    assert verdict.reason
    assert rig.moves(frames) == 0
    assert rig.status().state == ExecutorState.HOLD
    return verdict


def changed(plan, field, knot, joint, value):
    values = getattr(plan, field).copy()
    values[(knot, joint) if values.ndim == 2 else knot] = value
    return replace(plan, **{field: values})


def home(rig, distance=0.2, duration_s=2.0, **more):
    return move(np.array(rig.status().q_ref), distance, duration_s, **more)


# -- those that kill something: first, while no other executor runs ------------------------------------


def test_t01_a_host_process_that_is_killed_leaves_the_arm_holding(own, tmp_path):
    rig = own(host_timeout_s=0.3)
    script = f"""
import sys, time, numpy as np
from s2r_host.link import ExecutorLink
from s2r_protocol.arms import load_arm
sys.path.insert(0, {str(Path(__file__).parent)!r})
from hil_front_end import move
link = ExecutorLink({rig.endpoint!r}, load_arm("xmate3pro"))
link.take_lease()
link.arm_drives()
link.send_plan(move(np.array(link.status().q_ref), 0.4, 20.0), "long")
time.sleep(120)
"""
    host = subprocess.Popen([sys.executable, "-c", script])
    try:
        wait_for(lambda: rig.status().plan_t > 0.5, "motion")
        host.send_signal(signal.SIGKILL)
    finally:
        host.kill()
        host.wait()
    status = rig.at(ExecutorState.HOLD)
    assert status.cause == Cause.HOST_LOST
    assert status.lease_holder == ""
    assert 0.5 < status.plan_t < 19.0
    rig.check_limits()


def in_motion(rig):
    """The same rig, half a second and more into a motion of 20 s."""
    rig.hold()
    rig.at(ExecutorState.HOLD)
    assert rig.send(home(rig, 0.4, 20.0)).accepted
    wait_for(lambda: rig.status().plan_t > 0.5, "motion")
    return rig


def has_ended(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists() or "Z" in Path(f"/proc/{pid}/stat").read_text()


def test_t05_a_front_end_process_that_is_killed_leaves_the_core_holding(own):
    rig = in_motion(own())
    core = rig.core_pid()
    rig.beating.clear()
    rig.process.kill()
    rig.process.wait()

    def at_rest():
        trace = oracle.read_fd(rig.log.frames(max(0, len(rig.log) - 8000)), DOF)
        return len(trace.tick) > 900 and not np.diff(trace.counts[-800:], axis=0).any()

    try:
        wait_for(at_rest, "rest")
        trace = rig.trace()
        assert (trace.control[-500:] == 2).all()  # still powered, still holding
        assert Path(f"/proc/{core}").exists()
        rig.check_limits()
    finally:
        os.kill(core, signal.SIGTERM)
    wait_for(lambda: has_ended(core), "its end")


def test_t05_a_core_that_is_told_to_end_after_its_front_end_was_killed_stops_on_its_path_and_switches_off(
    own,
):
    """What systemd does with a crashed front end under the shipped unit: its KillSignal goes to all that is left."""
    rig = in_motion(own())
    core = rig.core_pid()
    rig.beating.clear()
    rig.process.kill()
    rig.process.wait()
    os.kill(core, signal.SIGINT)
    wait_for(lambda: has_ended(core), "its end")
    wait_for(lambda: rig.plant.at_rest, "brakes")
    rig.check_limits()
    trace = rig.trace()
    steps = np.abs(np.diff(trace.counts[trace.control == 2], axis=0)).max(axis=1)
    assert steps[-1] < 0.01 * steps.max()  # at rest before the power went
    assert list(dict.fromkeys(trace.control[np.flatnonzero(trace.control == 2)[0] :])) == [
        2,
        5,
        0,
    ]  # brakes first


@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("core_first_s", [None, 0.0, 0.3])
def test_an_end_that_reaches_the_core_as_well_is_an_orderly_one(own, moves, core_first_s):
    """A service manager, or whoever else signals all processes at once, in whatever order they are reached."""
    rig = in_motion(own()) if moves else own()
    core = rig.core_pid()
    if core_first_s is None:
        rig.process.send_signal(signal.SIGINT)
    os.kill(core, signal.SIGINT)
    if core_first_s is not None:
        time.sleep(core_first_s)
        rig.process.send_signal(signal.SIGINT)
    assert rig.process.wait(DEADLINE_S) == 0, rig.log_file.read_text()
    said = rig.log_file.read_text()
    assert "real-time core ended (exit 0)" in said
    assert "ERROR" not in said
    rig.check_limits()


def test_a_core_that_somebody_else_ends_is_reported(own):
    rig = own()
    os.kill(rig.core_pid(), signal.SIGTERM)
    assert rig.process.wait(DEADLINE_S) == 6
    assert "core ended in order (exit 0), but not for this executor" in rig.log_file.read_text()


def test_t06_a_killed_core_is_reported_and_the_drives_brake(own):
    rig = in_motion(own())
    os.kill(rig.core_pid(), signal.SIGKILL)
    wait_for(lambda: rig.plant.at_rest, "brakes")
    assert rig.process.wait(DEADLINE_S) == 6
    assert "core ended by itself" in rig.log_file.read_text()


def test_t56_a_full_disk_stops_no_motion(own):
    rig = own(limit_file_bytes=300_000)
    rig.hold()
    rig.at(ExecutorState.HOLD)
    for distance in (0.3, -0.3):
        verdict = rig.send(home(rig, distance, 3.0))
        assert verdict.accepted, verdict.reason
        wait_for(lambda v=verdict: rig.status().plan_done and rig.status().plan_seq == v.seq, "end of plan")
    assert rig.status().cause == Cause.NONE
    reply = rig.ask(KEYS.recording, pb.RecordingRequest(plan_seq=verdict.seq), pb.RecordingReply)
    assert not reply.complete
    rig.check_limits()


def test_t56_a_consumer_that_never_reads_is_counted_and_waited_for_by_nobody(make_bench):
    bench = make_bench(record_capacity=16)
    bench.takes_events = False
    bench.moving()
    bench.until(lambda s: s.plan_done)
    assert bench.shared.records_dropped > 1000
    bench.judge()


# -- one executor for the rest ------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["t", "q", "dq", "ddq"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_t08_not_a_number_is_refused_with_its_place(holding, field, value):
    verdict = refused(holding, changed(home(holding), field, 7, 3, value), Refusal.NONFINITE)
    if field != "t":
        assert (verdict.joint, verdict.quantity) == ("joint4", field)


def test_t08_a_denormal_is_a_number_like_any_other(holding):
    assert holding.send(changed(home(holding, 0.05), "ddq", -1, 3, 5e-324)).accepted
    holding.at(ExecutorState.HOLD)


def test_t09_a_position_outside_only_between_knots_is_refused(holding):
    start = np.array(holding.status().q_ref)
    top = ARM.limits.q_max[1]
    t = np.array([0.0, 2.0, 4.0, 6.0])
    q = np.tile(start, (4, 1))
    q[1:3, 1] = top - 1e-4
    dq = np.zeros((4, 7))
    dq[1, 1], dq[2, 1] = 0.05, -0.05
    plan = replace(home(holding), t=t, q=q, dq=dq, ddq=np.zeros((4, 7)))
    verdict = refused(holding, plan, Refusal.POSITION, joint="joint2", quantity="position")
    assert verdict.value > verdict.limit == pytest.approx(top)
    assert 2.0 < verdict.t < 4.0


@pytest.mark.parametrize(
    ("code", "quantity", "duration_s", "distance"),
    [
        (Refusal.VELOCITY, "velocity", 1.645, None),
        (Refusal.ACCELERATION, "acceleration", 0.65, 0.5),
        (Refusal.JERK, "jerk", 0.12, 0.01),
    ],
)
def test_t10_a_limit_exceeded_is_refused_with_its_numbers(holding, code, quantity, duration_s, distance):
    """Sweeps of a thousandth to both sides are in tests/safety/test_admission.py."""
    start = np.array(holding.status().q_ref)
    distance = -2.35 - start[0] if distance is None else distance
    plan = move(start, 1.0, duration_s)
    gains = np.array([distance, 0, 0, 0, 0, 0, 0])
    q = start + (plan.q[:, :1] - start[0]) * gains
    plan = replace(plan, q=q, dq=plan.dq[:, :1] * gains, ddq=plan.ddq[:, :1] * gains)
    verdict = refused(holding, plan, code, joint="joint1", quantity=quantity)
    assert abs(verdict.value) > abs(verdict.limit) > 0
    assert 0 < verdict.t < duration_s or quantity == "jerk"


def test_t11_a_torque_exceeded_only_with_the_payload_is_refused(holding):
    plan = home(holding, 0.25, 1.2)
    assert holding.send(home(holding, 0.01)).accepted
    holding.at(ExecutorState.HOLD)
    plan = home(holding, 0.25, 1.2)
    heavy = replace(plan, payload_mass=3.0, payload_com=(1.5, 1.5, 0.0))
    verdict = refused(holding, heavy, Refusal.TORQUE, quantity="torque")
    assert abs(verdict.value) > verdict.limit
    assert holding.send(plan).accepted
    holding.at(ExecutorState.HOLD)


def test_t12_a_collision_in_the_middle_of_a_segment_is_refused(holding):
    start = np.array(holding.status().q_ref)
    plan = home(holding)
    q = np.tile(start, (3, 1))
    q[1, 1], q[1, 3] = 1.6, 2.05  # the hand goes through the table and comes back
    t = np.array([0.0, 6.0, 12.0])
    verdict = holding.send(replace(plan, t=t, q=q, dq=np.zeros((3, 7)), ddq=np.zeros((3, 7))))
    assert verdict.code == Refusal.COLLISION, verdict.reason
    assert verdict.t > 0
    assert verdict.quantity


@pytest.mark.parametrize("value", [0.1, 0.0999999, -1.0, 2.0**63, 1e300])
def test_t13_times_that_do_not_rise_sanely_are_refused(holding, value):
    refused(holding, changed(home(holding), "t", 2, 0, value), Refusal.TIME)


@pytest.mark.parametrize("knots", [0, 1, 4097])
def test_t14_plans_of_impossible_size_are_refused(holding, knots):
    plan = home(holding)
    t = np.linspace(0.0, 20.0, knots) if knots else np.empty(0)
    many = replace(plan, t=t, q=np.zeros((knots, 7)), dq=np.zeros((knots, 7)), ddq=np.zeros((knots, 7)))
    refused(holding, many, Refusal.SIZE)


def test_t14_the_largest_plan_is_accepted(holding):
    assert holding.send(home(holding, 0.1, 5.0, knots=4096)).accepted
    holding.at(ExecutorState.HOLD)


def test_t14_a_length_field_of_two_gigabytes_is_refused_before_anything_is_allocated(holding):
    envelope = codec.open_envelope(codec.seal(message(home(holding)), holding.address()))
    body = b"\x12\xff\xff\xff\xff\x07"  # field 2, length delimited, 2^31 - 1 bytes that are not there
    before = Path(f"/proc/{holding.process.pid}/statm").read_text().split()[1]
    envelope.body = body
    frames = len(holding.log)
    rest = envelope.SerializeToString()
    wire = codec.MAGIC + struct.pack("<I", zlib.crc32(rest)) + rest
    (reply,) = holding.ask_raw(KEYS.plan, wire)
    verdict = codec.open_body(codec.open_envelope(reply), pb.Verdict)
    assert not verdict.accepted
    assert holding.moves(frames) == 0
    after = Path(f"/proc/{holding.process.pid}/statm").read_text().split()[1]
    assert (int(after) - int(before)) * 4096 < 50e6


@pytest.mark.parametrize(
    "names",
    [ARM.joint_names[:6], ARM.joint_names[::-1], (*ARM.joint_names[:6], ARM.joint_names[0])],
    ids=["count", "order", "twice"],
)
def test_t15_other_joints_are_refused(holding, names):
    plan = home(holding)
    n = len(names)
    plan = replace(plan, joint_names=names, q=plan.q[:, :n], dq=plan.dq[:, :n], ddq=plan.ddq[:, :n])
    refused(holding, plan, Refusal.MODEL)


def test_t16_a_start_a_hundredth_of_a_radian_off_is_refused(holding):
    off = np.array(holding.status().q_ref) + np.array([0, 0, 0.01, 0, 0, 0, 0])
    verdict = refused(holding, move(off, 0.1), Refusal.START, joint="joint3")
    assert verdict.value == pytest.approx(0.01)
    assert verdict.limit == pytest.approx(1e-4)


def test_t17_a_plan_that_ends_in_motion_is_refused(holding):
    refused(
        holding, changed(home(holding), "dq", -1, 5, 0.01), Refusal.NOT_AT_REST, joint="joint6", quantity="dq"
    )


@pytest.mark.parametrize("change", [{"boot_id": 12345}, {"epoch": 1_000_000}, {"seq": 1}])
def test_t18_stale_messages_are_refused(holding, change):
    frames = len(holding.log)
    verdict = holding.send(home(holding), **change)
    assert verdict.code == Refusal.STALE, verdict.reason
    assert holding.moves(frames) == 0


def test_t19_a_message_a_thousand_times_acts_once_and_gets_one_answer(holding):
    wire = codec.seal(message(home(holding, 0.05, 1.0)), holding.address())
    verdicts = set()
    for _ in range(1000):
        (reply,) = holding.ask_raw(KEYS.plan, wire)
        verdicts.add(codec.open_body(codec.open_envelope(reply), pb.Verdict).SerializeToString())
    (verdict,) = (pb.Verdict.FromString(v) for v in verdicts)
    assert verdict.accepted
    status = holding.at(ExecutorState.HOLD)
    assert status.plan_seq == verdict.seq


def test_t20_of_two_plans_in_the_wrong_order_the_newer_plays_and_the_older_is_stale(holding):
    older, newer = holding.address(), holding.address()
    plan = home(holding, 0.05, 1.0)
    (reply,) = holding.ask_raw(KEYS.plan, codec.seal(message(plan), newer))
    assert codec.open_body(codec.open_envelope(reply), pb.Verdict).accepted
    (reply,) = holding.ask_raw(KEYS.plan, codec.seal(message(plan), older))
    assert codec.open_body(codec.open_envelope(reply), pb.Verdict).code == Refusal.STALE
    assert holding.at(ExecutorState.HOLD).plan_seq == newer.seq


def test_t21_damaged_messages_are_refused_unread(holding):
    """Here 200 single bits, 50 cuts; every single bit is flipped in tests/integration/test_executor_wire.py."""
    wire = codec.seal(message(home(holding, 0.05, 1.0, knots=2)), holding.address())
    random = np.random.default_rng(21)
    frames = len(holding.log)
    damaged = []
    for bit in random.choice(8 * len(wire), 200, replace=False):
        flipped = bytearray(wire)
        flipped[bit // 8] ^= 1 << (bit % 8)
        damaged.append(bytes(flipped))
    damaged += [wire[:n] for n in random.choice(len(wire), 50, replace=False)]
    for item in damaged:
        (reply,) = holding.ask_raw(KEYS.plan, item)
        assert not codec.open_body(codec.open_envelope(reply), pb.Verdict).accepted
    assert holding.moves(frames) == 0


def test_t53_a_second_host_is_told_who_holds_the_lease(holding):
    reply = holding.ask(KEYS.lease, pb.LeaseRequest(), pb.LeaseReply, sender="host:other")
    assert not reply.granted
    assert reply.holder == "host:t"
    verdict = holding.control(pb.DISARM, sender="host:other")
    assert verdict.code == Refusal.NO_LEASE


@pytest.mark.parametrize("field", ["model_hash", "limit_hash"])
def test_t55_another_model_or_other_limits_are_refused(holding, field):
    for verdict in (
        holding.control(pb.DISARM, **{field: bytes(32)}),
        holding.send(home(holding), **{field: b""}),
    ):
        assert verdict.code == Refusal.MODEL, verdict.reason


def recorded(plan, speed=1.0):
    """What a replay sends of a recorded plan."""
    return replace(plan, t=plan.t / speed, dq=plan.dq * speed, ddq=plan.ddq * speed**2)


def test_t58_a_recording_played_at_twice_its_speed_goes_through_the_same_admission(holding):
    plan = home(holding, -0.3, 0.75)
    verdict = holding.send(plan)
    assert verdict.accepted, verdict.reason
    holding.at(ExecutorState.HOLD)
    back = home(holding, 0.3, 0.75)
    fast = holding.send(recorded(back, 2.0))
    assert fast.code in (Refusal.VELOCITY, Refusal.ACCELERATION, Refusal.TORQUE, Refusal.JERK), fast.reason
    assert fast.joint
    assert holding.send(back).accepted
    holding.at(ExecutorState.HOLD)
    holding.check_limits()


def test_t58_an_edited_recording_and_one_of_another_arm_are_refused(holding):
    wire = bytearray(codec.seal(message(home(holding)), holding.address()))
    wire[len(wire) // 2] ^= 0x10
    (reply,) = holding.ask_raw(KEYS.plan, bytes(wire))
    assert codec.open_body(codec.open_envelope(reply), pb.Verdict).code == Refusal.MALFORMED
    assert holding.send(home(holding), model_hash=bytes(range(32))).code == Refusal.MODEL


def test_everything_so_far_stayed_inside_the_limits_and_never_missed_a_tick(holding):
    holding.check_limits()
