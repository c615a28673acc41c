"""Whatever reads bytes from outside, fed with seeded inputs: random ones, and valid ones with a few bytes changed.

A decoder refuses by its own error or returns what is consistent; nothing else may come out of it. The decoders of the
native core have a fuzz target of their own (executor/native/tests/fuzz.cpp).
"""

from __future__ import annotations

import numpy as np
import pytest

from s2r_executor.bridge import plan_from_message
from s2r_executor.plan import CommandRefusedError
from s2r_protocol import codec
from s2r_protocol.arms import load_arm
from s2r_protocol.can import classic, fd, sdo
from s2r_protocol.can.drive import Control, DriveState
from s2r_protocol.can.frames import CLASSIC_BYTES, FD_BYTES, CanFrame, FrameRefusedError
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.ros2 import cdr

ARM = load_arm("xmate3pro")
COUNTS = [2000, pytest.param(200_000, marks=(pytest.mark.prove, pytest.mark.timeout(3600)))]


def damaged(random: np.random.Generator, valid: bytes) -> bytes:
    """Some bits flipped, cut off, lengthened, or replaced altogether; sometimes left as it is."""
    out = bytearray(valid)
    kind = random.integers(6)
    if kind == 0:
        return random.bytes(int(random.integers(2 * len(valid) + 2)))
    if kind == 1:
        return bytes(out[: random.integers(len(out) + 1)])
    if kind == 2:
        return bytes(out) + random.bytes(int(random.integers(1, 40)))
    if kind == 3:
        at = int(random.integers(len(out) + 1))
        return bytes(out[:at]) + random.bytes(int(random.integers(1, 9))) + bytes(out[at:])
    for _ in range(random.integers(4)):
        out[random.integers(len(out))] ^= 1 << int(random.integers(8))
    return bytes(out)


def plan_body(random: np.random.Generator) -> pb.Plan:
    """Two seconds from home to near home, at rest at both ends."""
    step = random.uniform(-0.1, 0.1, ARM.dof)
    x = np.linspace(0.0, 1.0, 5)
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 15 * x**2 * (1 - x) ** 2
    dds = 15 * x * (1 - x) * (1 - 2 * x)
    return pb.Plan(
        joint_names=ARM.joint_names,
        t=2.0 * x,
        q=(ARM.q_home + s[:, None] * step).ravel(),
        dq=(ds[:, None] * step).ravel(),
        ddq=(dds[:, None] * step).ravel(),
        label="ü",
    )


@pytest.mark.parametrize("count", COUNTS)
def test_a_damaged_message_is_refused_or_is_the_one_that_was_sent(count):
    random = np.random.default_rng(1)
    sent = codec.seal(plan_body(random), codec.Address("host:a", 1, 2, 3, b"m" * 32, b"l" * 32))
    opened = 0
    for _ in range(count):
        wire = damaged(random, sent)
        try:
            envelope = codec.open_envelope(wire)
        except codec.MessageRefusedError:
            continue
        assert wire == sent  # nothing that was changed has passed the checksum
        codec.open_body(envelope, pb.Plan)
        opened += 1
    assert opened > count // 100


@pytest.mark.parametrize("count", COUNTS)
def test_a_plan_of_any_content_under_a_right_checksum_is_refused_or_whole(count):
    """Somebody who can compute a checksum sends nonsense: it ends in a refusal, or in arrays of the shapes it says."""
    random = np.random.default_rng(2)
    whole = 0
    for _ in range(count):
        body = plan_body(random).SerializeToString()
        envelope = pb.Envelope(
            schema_version=1, kind=pb.Plan.DESCRIPTOR.full_name, body=damaged(random, body)
        )
        try:
            plan = plan_from_message(codec.open_body(envelope, pb.Plan))
        except (codec.MessageRefusedError, CommandRefusedError):
            continue
        shape = (len(plan.t), len(plan.joint_names))
        assert plan.q.shape == plan.dq.shape == plan.ddq.shape == shape
        whole += 1
    assert whole > count // 100


@pytest.mark.parametrize("count", COUNTS)
def test_any_packet_of_the_bus_is_refused_or_a_frame_that_packs_again(count):
    random = np.random.default_rng(3)
    frames = 0
    for _ in range(count):
        size = random.choice([CLASSIC_BYTES, FD_BYTES, int(random.integers(200))])
        packet = bytearray(random.bytes(int(size)))
        if len(packet) > 4:
            packet[4] %= 80  # lengths near the allowed ones
        try:
            frame = CanFrame.unpack(bytes(packet))
        except FrameRefusedError:
            continue
        frames += 1
        if not frame.is_fd or len(frame.data) in (*range(9), 12, 16, 20, 24, 32, 48, 64):
            assert CanFrame.unpack(frame.pack()) == frame
    assert frames > count // 10


@pytest.mark.parametrize("count", COUNTS)
def test_a_damaged_answer_of_a_drive_is_refused_or_packs_again(count):
    random = np.random.default_rng(4)
    read = 0
    for _ in range(count):
        node = int(random.integers(1, 8))
        seq, tick = int(random.integers(256)), int(random.integers(65536))
        q, dq, tau = random.uniform(-3.0, 3.0, 3)
        sent = fd.pack_stat(
            fd.Status(node, seq, tick, DriveState.OPERATION_ENABLED, True, False, q, dq, tau, 0, 30)
        )
        wire = damaged(random, sent)
        try:
            status = fd.unpack_stat(wire, node)
        except FrameRefusedError:
            continue
        read += 1
        assert (
            fd.pack_stat(status)[:14] == wire[:14] or wire[1] & 0xC0
        )  # emergency stop bits are not repacked
    assert read > count // 100


@pytest.mark.parametrize("count", COUNTS)
def test_a_damaged_setpoint_is_refused_or_is_the_one_that_was_sent(count):
    random = np.random.default_rng(6)
    q, zero = random.uniform(-2.0, 2.0, ARM.dof), np.zeros(ARM.dof)
    sent = fd.pack_set(7, Control.ENABLE, 99, q, zero, zero)
    read = 0
    for _ in range(count):
        wire = damaged(random, sent)
        try:
            fd.unpack_set(wire)
        except FrameRefusedError:
            continue
        assert wire == sent
        read += 1
    assert read > count // 100


@pytest.mark.parametrize("count", COUNTS)
def test_any_payload_of_a_classical_drive_is_refused_or_finite(count):
    random = np.random.default_rng(7)
    for _ in range(count):
        payload = random.bytes(int(random.integers(12)))
        for unpack in (classic.unpack_rpdo1, classic.unpack_tpdo1, classic.unpack_tpdo2):
            try:
                values = unpack(payload)
            except FrameRefusedError:
                continue
            numbers = [value for value in vars(values).values() if isinstance(value, float)]
            assert np.isfinite(numbers).all()
        if len(payload) == 8:
            assert len(sdo.segment_part(payload)[0]) <= 7


@pytest.mark.parametrize("count", COUNTS)
def test_any_bytes_from_ros_are_refused_or_a_message(count):
    random = np.random.default_rng(5)
    name = "sensor_msgs/msg/JointState"
    values = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "world"},
        "name": list(ARM.joint_names),
        "position": np.zeros(ARM.dof),
        "velocity": np.ones(ARM.dof),
        "effort": np.full(ARM.dof, 2.0),
    }
    sent = cdr.pack(name, values)
    read = 0
    for _ in range(count):
        try:
            message = cdr.unpack(name, damaged(random, sent))
        except cdr.CdrError:
            continue
        assert all(isinstance(text, str) for text in message["name"])
        read += 1
    assert read > count // 100
