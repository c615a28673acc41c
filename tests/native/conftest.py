"""The real-time core stepped in virtual time against seven drives written from the wire format alone."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

DOF = 7
TICK_NS = 1_000_000
RAD_PER_COUNT = 4e-9
SET = struct.Struct("<BBHI" + DOF * "ihh")
STAT = struct.Struct("<BBihhHBB")
CAN_ERR_FLAG = 0x2000_0000

LIMITS = {
    "q_min": [-2.9] * DOF,
    "q_max": [2.9] * DOF,
    "dq_max": [3.0] * DOF,
    "ddq_max": [6.0] * DOF,
    "dddq_max": [300.0] * DOF,
    "tau_max": [100.0] * DOF,
}
CONFIG = {
    "dof": DOF,
    "tick_ns": TICK_NS,
    "packing": "fd",
    "bus": "unix:/nowhere.sock",
    "clock": "lockstep",
    **LIMITS,
}


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


@dataclass
class Drives:
    """Seven perfect drives: enabled, they are at the setpoint when they answer."""

    counts: list[int] = field(default_factory=lambda: [25_000_000 * (j - 3) for j in range(DOF)])
    state: list[int] = field(default_factory=lambda: [1] * DOF)
    silent: set[int] = field(default_factory=set)
    offset: list[int] = field(default_factory=lambda: [0] * DOF)  # added to the answered position
    error: list[int] = field(default_factory=lambda: [0] * DOF)
    tau: list[float] = field(default_factory=lambda: [0.0] * DOF)
    temperature: list[int] = field(default_factory=lambda: [30] * DOF)
    estop: int = 0  # bit 0, 1: that channel of the chain is open
    brake_stuck: dict[int, bool] = field(default_factory=dict)  # joint: what its brake reports for ever
    stuck: dict[int, int] = field(default_factory=dict)  # joint: state it never leaves
    damage: Callable[[int, bytes], bytes] | None = None  # of an answer of joint
    ctrl: int = 0
    setpoints: list[tuple[int, int, list[int]]] = field(default_factory=list)  # tick, ctrl, position counts

    def answer(self, frames: list[tuple[int, bytes, bool]]) -> list[tuple[int, bytes, bool]]:
        answers = []
        for can_id, data, fd in frames:
            assert (can_id, len(data), fd) == (0x080, 64, True)
            seq, self.ctrl, tick, crc, *slots = SET.unpack(data)
            assert crc == zlib.crc32(data[:4] + data[8:])
            self.setpoints.append((tick, self.ctrl, slots[0::3]))
            for joint in range(DOF):
                self._follow(joint, slots[3 * joint])
                if joint not in self.silent:
                    answers.append((0x181 + joint, self._stat(joint, seq, tick), True))
        return answers

    def _follow(self, joint: int, position: int) -> None:
        state = self.state[joint]
        if self.ctrl == 0:
            state = 1 if state != 7 else 7
        elif self.ctrl == 1 and state in (1, 2, 4):
            state = 3 if state == 4 else state + 1
        elif self.ctrl == 5 and state == 4:
            state = 3
        elif self.ctrl == 2 and state == 3:
            state = 4
        elif self.ctrl == 3 and state == 4:
            state = 5
        elif self.ctrl == 4 and state == 7:
            state = 1
        self.state[joint] = self.stuck.get(joint, state)
        if self.state[joint] == 4:
            self.counts[joint] = position

    def _stat(self, joint: int, seq: int, tick: int) -> bytes:
        body = STAT.pack(
            seq,
            self.state[joint] | self.brake_stuck.get(joint, self.state[joint] >= 4) << 4 | self.estop << 6,
            self.counts[joint] + self.offset[joint],
            0,
            round(self.tau[joint] / 0.01),
            tick,
            self.error[joint],
            self.temperature[joint],
        )
        data = body + struct.pack("<H", crc16(body + bytes([joint + 1])))
        return self.damage(joint, data) if self.damage else data


class Cell:
    """Shared memory, stepped core and drives. Virtual time: one tick per millisecond."""

    def __init__(self, **config: object) -> None:
        self.shared = _native.Shared.create({**CONFIG, **config})
        self.core = _native.Core(self.shared)
        self.drives = Drives()
        self.now_ns = 0
        self.beats = True
        self._answers: list[tuple[int, bytes, bool]] = []
        self._seen_events: list = []

    def step(self, ticks: int = 1, *, skipped: int = 0, send_fails: bool = False, extra: tuple = ()) -> None:
        for _ in range(ticks):
            if self.beats:
                self.shared.beat()
            self.now_ns += TICK_NS * (1 + skipped)
            frames = self.core.step([*self._answers, *extra], self.now_ns, skipped, send_fails)
            self._answers = self.drives.answer(frames)

    def until(self, condition: Callable, ticks: int = 5000):
        for _ in range(ticks):
            snapshot = self.shared.snapshot()
            if condition(snapshot):
                return snapshot
            self.step()
        raise AssertionError(f"state {snapshot.state}, cause {snapshot.cause} after {ticks} ticks")

    @property
    def state(self):
        return self.shared.snapshot()

    def command(self, kind: int, value: float = 0.0, epoch: int | None = None) -> None:
        assert self.shared.command(kind, self.state.epoch if epoch is None else epoch, value)

    def arm(self) -> None:
        self.step(3)
        self.command(1)
        self.until(lambda s: s.state == 3, 100)

    def submit(self, plan: Plan, plan_id: int = 1, **changes: object) -> None:
        fields = {
            "plan_id": plan_id,
            "epoch": self.state.epoch,
            "t": plan.t,
            "q": plan.q,
            "dq": plan.dq,
            "ddq": plan.ddq,
            "stop_duration": plan.stop_duration,
            "path_tolerance": 0.0,
            "goal_tolerance": 0.0,
            **changes,
        }
        assert self.shared.submit_plan(**fields)

    def run_plan(self, plan: Plan, plan_id: int = 1) -> None:
        """Submit a plan and step until it plays."""
        self.submit(plan, plan_id)
        self.step()
        assert self.state.state == 4, self.events()

    def events(self, kind: int | None = None) -> list:
        """Everything that happened so far, oldest first."""
        self._seen_events += list(self.shared.events())
        return [e for e in self._seen_events if kind is None or e["kind"] == kind]

    def emitted(self) -> np.ndarray:
        """Setpoints sent to enabled drives [counts], shape (time, dof)."""
        return np.array([p for _, ctrl, p in self.drives.setpoints if ctrl == 2], dtype=np.int64)


@dataclass(frozen=True)
class Plan:
    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    stop_duration: np.ndarray


def make_plan(start: np.ndarray, distance: float = 0.8, duration_s: float = 1.4, knots: int = 8) -> Plan:
    """A minimum-jerk move of every joint, each by another amount, cut into equal segments.

    With the defaults: 1.07 rad/s, 2.4 rad/s2, 18 rad/s3; a stop ramp of 0.6 s adds at most 3.4 rad/s2.
    """
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s = 10 * x**3 - 15 * x**4 + 6 * x**5
    ds = (30 * x**2 - 60 * x**3 + 30 * x**4) / duration_s
    dds = (60 * x - 180 * x**2 + 120 * x**3) / duration_s**2
    gains = distance * np.linspace(-1.0, 1.0, DOF)
    return Plan(
        t,
        start + s[:, None] * gains,
        ds[:, None] * gains,
        dds[:, None] * gains,
        np.full(knots - 1, 0.6),
    )


def worst_use_of_limits(counts: np.ndarray, dt: float = 1e-3) -> float:
    """Largest |velocity|, |acceleration| or |jerk| of setpoints over its limit, by differences.

    Rounding to counts moves an n-th difference by up to 2^n / 2 counts; that is taken off before comparing.
    """
    worst = 0.0
    for order, name in ((1, "dq_max"), (2, "ddq_max"), (3, "dddq_max")):
        size = np.abs(np.diff(counts, n=order, axis=0)) * RAD_PER_COUNT
        size = np.maximum(0.0, size - 2**order / 2 * RAD_PER_COUNT) / dt**order
        worst = max(worst, float((size / np.array(LIMITS[name])).max(initial=0.0)))
    return worst


@pytest.fixture
def core_config() -> dict:
    return dict(CONFIG)


@pytest.fixture
def make_drives() -> Callable[[], Drives]:
    return Drives


@pytest.fixture
def make_cell() -> Callable[..., Cell]:
    return Cell


@pytest.fixture
def cell() -> Cell:
    return Cell()


@pytest.fixture
def armed(cell: Cell) -> Cell:
    cell.arm()
    return cell


@pytest.fixture
def plan_from() -> Callable[..., Plan]:
    return make_plan


@pytest.fixture
def use_of_limits() -> Callable[..., float]:
    return worst_use_of_limits
