"""Judges an executor by what was on the bus, and by nothing else.

It reads a bus log, decodes the frames by itself (written from docs/protocol.md, sharing no code with the executor),
and checks:

* I1 every setpoint of an enabled drive is inside position, velocity, acceleration and jerk limits;
* I2 after a stop decision all joints are at rest in time, and in a joint-space stop none speeds up by more than
  unwinding its acceleration takes (a stop on the path keeps to the path, and with it to I1);
* I3 drives are enabled and setpoints begin to move only after an order that is newer than the last stop;
* I5 the stop has begun within its bound after what caused it;
* I6 the executor neither dies nor stutters: one setpoint per tick, counters without a gap.

I4 (one cause with its tick) cannot be seen on the bus; tests read it from the executor's events.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

RAD_PER_COUNT = 4e-9
ENABLED, ENABLE = 4, 2
MARGIN = 1.02
"""On velocity, acceleration and jerk: what the executor promises of its own last check."""

_SET = struct.Struct("<BBHI" + 7 * "ihh")


@dataclass(frozen=True)
class Limits:
    """Per joint, SI units, each of shape (dof,)."""

    q_min: np.ndarray
    q_max: np.ndarray
    dq_max: np.ndarray
    ddq_max: np.ndarray
    dddq_max: np.ndarray


@dataclass(frozen=True)
class Stop:
    """A stop that has to happen.

    Attributes:
        after_tick: When its cause appeared on the bus, or when it was ordered.
        within_ticks: Until the stop has begun.
        rest_within_s: From then on until all setpoints stand still.
        off: Drives are switched off in the end (category 1 and 0); False: they stay on (category 2).
        braking: False where the drives brake by themselves and setpoints say nothing.
    """

    after_tick: int
    within_ticks: int
    rest_within_s: float
    off: bool
    braking: bool = True


@dataclass(frozen=True)
class Violation:
    """What is wrong, where and by how much."""

    invariant: str
    tick: int
    joint: int
    quantity: str
    value: float
    limit: float

    def __str__(self) -> str:
        where = f" joint {self.joint + 1}" if self.joint >= 0 else ""
        return f"{self.invariant} at tick {self.tick}{where}: {self.quantity} {self.value:.6g}, limit {self.limit:.6g}"


@dataclass(frozen=True)
class Trace:
    """The master's commands of a log, one row per SET or SYNC.

    Attributes:
        tick: Unwrapped counter, shape (n,).
        control: 0 disable, 1 switch on, 2 enable, 3 quick stop, 4 fault reset, 5 disable operation, shape (n,).
        counts: Commanded positions [4 nrad], shape (n, dof).
        enabled: The drive had said "operation enabled" before this command, shape (n, dof).
        faulty: Answers said "fault" or "fault reaction", shape (n, dof).
        dt: Seconds between ticks.
    """

    tick: np.ndarray
    control: np.ndarray
    counts: np.ndarray
    enabled: np.ndarray
    faulty: np.ndarray
    dt: float


@dataclass
class Report:
    """Outcome of a check.

    Attributes:
        violations: Empty when all is well.
        use: Largest share of each limit that a setpoint took, e.g. ``{"velocity": 0.4}``.
    """

    violations: list[Violation] = field(default_factory=list)
    use: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return "\n".join(str(v) for v in self.violations[:20]) or f"no violation, {self.use}"


def read_fd(frames: np.ndarray, dof: int, master: int = 1, dt: float = 1e-3) -> Trace:
    """The trace of a log in the CAN FD packing.

    Args:
        frames: Structured array with ``sender``, ``size`` and ``raw``; sender 0 is a drive.
        dof: Joints.
        master: Which sender is the executor.
        dt: Seconds per tick.
    """
    ids = frames["raw"][:, :4].copy().view("<u4")[:, 0]
    rows: list[tuple[int, int, tuple[int, ...]]] = []
    enabled, faulty = [], []
    state = np.zeros(dof, int)
    tick = -1
    of_interest = ((ids == 0x080) & (frames["sender"] == master)) | (
        (frames["sender"] == 0) & (ids > 0x180) & (ids <= 0x180 + dof)
    )
    for i in np.flatnonzero(of_interest & (frames["size"] == 72)):
        payload = frames["raw"][i, 8:].tobytes()
        if ids[i] != 0x080:
            state[ids[i] - 0x181] = payload[1] & 0x0F
            continue
        seq_control = _SET.unpack(payload)
        if seq_control[3] != zlib.crc32(payload[8:], zlib.crc32(payload[:4])):
            continue
        wire = seq_control[2]
        tick = wire if tick < 0 else tick + ((wire - tick) & 0xFFFF)
        rows.append((tick, seq_control[1], seq_control[4::3][:dof]))
        enabled.append(state == ENABLED)
        faulty.append((state == 6) | (state == 7))
    return Trace(
        tick=np.array([r[0] for r in rows], np.int64),
        control=np.array([r[1] for r in rows], np.int64),
        counts=np.array([r[2] for r in rows], np.int64).reshape(-1, dof),
        enabled=np.array(enabled, bool).reshape(-1, dof),
        faulty=np.array(faulty, bool).reshape(-1, dof),
        dt=dt,
    )


def judge(
    trace: Trace,
    limits: Limits,
    stop: Stop | None = None,
    arm_ticks: Sequence[int] = (),
    motion_ticks: Sequence[int] = (),
    gaps_allowed: bool = False,
) -> Report:
    """Check everything that applies.

    Args:
        trace: Of the master.
        limits: Of the arm.
        stop: The one stop that has to happen, if any.
        arm_ticks: Ticks at which ARM was ordered.
        motion_ticks: Ticks at which a plan or RESUME was ordered.
        gaps_allowed: Ticks may be missing (a stalled master, a full transmit queue).
    """
    report = Report()
    check_setpoints(trace, limits, report)
    check_orders(trace, arm_ticks, motion_ticks, report)
    if not gaps_allowed:
        check_rhythm(trace, report)
    if stop is not None:
        check_stop(trace, limits, stop, report)
    return report


def check_setpoints(trace: Trace, limits: Limits, report: Report) -> None:
    """I1. Rounding to counts moves an n-th difference by up to 2^n / 2 counts; that is taken off before comparing."""
    commanded = trace.enabled & (trace.control == ENABLE)[:, None]
    q = trace.counts * RAD_PER_COUNT
    half = 0.51 * RAD_PER_COUNT
    outside = commanded & ~((q >= limits.q_min - half) & (q <= limits.q_max + half))
    for i, j in np.argwhere(outside)[:10]:
        report.violations.append(
            Violation("I1", int(trace.tick[i]), int(j), "position", float(q[i, j]), float(limits.q_max[j]))
        )
    usable = commanded.copy()
    for order, (name, bound) in enumerate(
        (("velocity", limits.dq_max), ("acceleration", limits.ddq_max), ("jerk", limits.dddq_max)), start=1
    ):
        if len(q) <= order:
            break
        step = np.diff(trace.tick)
        regular = np.ones(len(q) - order, bool)
        for k in range(order):
            regular &= step[k : len(step) - (order - 1 - k)] == 1
        usable = commanded[order:].copy()
        for k in range(order):
            usable &= commanded[k : len(q) - order + k]
        usable &= regular[:, None]
        change = np.abs(np.diff(trace.counts, n=order, axis=0)) * RAD_PER_COUNT
        value = np.maximum(0.0, change - 2**order / 2 * RAD_PER_COUNT) / trace.dt**order
        share = np.where(usable, value / bound, 0.0)
        report.use[name] = float(share.max(initial=0.0))
        for i, j in np.argwhere(share > MARGIN)[:10]:
            report.violations.append(
                Violation("I1", int(trace.tick[i + order]), int(j), name, float(value[i, j]), float(bound[j]))
            )


def check_orders(trace: Trace, arm_ticks: Sequence[int], motion_ticks: Sequence[int], report: Report) -> None:
    """I3. Only an order enables drives, and only a later order moves them."""
    patience = 4  # ticks between an order and its first effect on the bus
    asked = np.isin(trace.control, (1, 2, 5))
    rising = np.flatnonzero(asked & ~np.concatenate([[False], asked[:-1]]))
    for i in rising:
        last_off = trace.tick[i - 1] if i else -1
        if not any(last_off - patience <= a <= trace.tick[i] for a in arm_ticks):
            report.violations.append(
                Violation("I3", int(trace.tick[i]), -1, "drives enabled without an order", 1, 0)
            )
    held = trace.enabled & (trace.control == ENABLE)[:, None]
    both = held[1:] & held[:-1]
    moves = ((np.diff(trace.counts, axis=0) != 0) & both).any(axis=1)
    quiet = 20  # commands without any motion make a stand-still
    moving = np.flatnonzero(moves)
    begins = np.flatnonzero(np.diff(moving, prepend=-quiet - 1) > quiet)
    for k in begins:
        now = int(trace.tick[moving[k] + 1])
        since = int(trace.tick[moving[k - 1] + 1]) if k else -1
        if not any(since < m <= now for m in motion_ticks):
            report.violations.append(Violation("I3", now, -1, "motion begins without an order", 1, 0))


def check_rhythm(trace: Trace, report: Report) -> None:
    """I6. One command per tick."""
    for i in np.flatnonzero(np.diff(trace.tick) != 1)[:10]:
        report.violations.append(
            Violation(
                "I6",
                int(trace.tick[i]),
                -1,
                "ticks to the next setpoint",
                float(trace.tick[i + 1] - trace.tick[i]),
                1,
            )
        )


def check_stop(trace: Trace, limits: Limits, stop: Stop, report: Report) -> None:
    """I2 and I5."""
    begin = int(np.searchsorted(trace.tick, stop.after_tick + stop.within_ticks))
    if begin + 2 >= len(trace.tick):
        report.violations.append(Violation("I5", stop.after_tick, -1, "trace ends before the stop", 0, 1))
        return
    speed = np.diff(trace.counts, axis=0) * RAD_PER_COUNT / trace.dt
    enable = trace.control == ENABLE
    end = begin + 1 + int(np.argmax(~enable[begin + 1 :])) if (~enable[begin + 1 :]).any() else len(enable)
    if stop.braking and stop.off and enable[begin]:
        v = speed[begin - 1 : end - 1]
        a = np.diff(speed[max(begin - 3, 0) : begin + 1], axis=0) / trace.dt
        unwinding = np.abs(a).max(axis=0, initial=0.0) ** 2 / (2 * limits.dddq_max)
        allowed = np.abs(speed[begin - 1]) + MARGIN * unwinding + 4 * RAD_PER_COUNT / trace.dt
        for k, j in np.argwhere(np.abs(v) > allowed + 1e-9)[:5]:
            report.violations.append(
                Violation(
                    "I2",
                    int(trace.tick[begin + k]),
                    int(j),
                    "speed while stopping",
                    float(v[k, j]),
                    float(allowed[j]),
                )
            )
    # A trace that ends before the time is up has to end with the stop carried out.
    rest_by = min(begin + int(np.ceil(stop.rest_within_s / trace.dt)) + 5, len(speed) - 1)
    tail = slice(rest_by, None)
    still = speed[tail][enable[1:][tail]]
    if len(still) and np.abs(still).max() > 0:
        i = rest_by + int(np.argmax(np.abs(speed[tail]).max(axis=1) > 0))
        report.violations.append(
            Violation(
                "I2",
                int(trace.tick[i]),
                int(np.abs(speed[i]).argmax()),
                "speed after the stop",
                float(np.abs(speed[i]).max()),
                0,
            )
        )
    if bool(enable[rest_by:].any()) == stop.off:
        report.violations.append(
            Violation(
                "I2",
                int(trace.tick[rest_by]),
                -1,
                "drives enabled after the stop",
                float(stop.off),
                float(not stop.off),
            )
        )


def longest_joint_stop_s(limits: Limits, dq: np.ndarray | None = None) -> float:
    """T = v / a + 2 a / j of the slowest joint [s]; ``dq`` are the speeds it starts from, the largest by default."""
    v = limits.dq_max if dq is None else np.abs(dq)
    return float((v / limits.ddq_max + 2 * limits.ddq_max / limits.dddq_max).max())
