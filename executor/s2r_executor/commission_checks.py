"""What the executor assumes of every drive, as a table over its object dictionary (CiA 301, CiA 402).

A judge returns what is wrong, or "". Limits of the drive must lie outside the executor's (it must not interfere with a
legal plan) but not far outside (it is the backstop).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from s2r_protocol.arms import ArmDescription
from s2r_protocol.can.units import COUNTS_PER_RAD, VELOCITY_UNIT

POSITION_SLACK_RAD = 0.1
LIMIT_SLACK = 1.5  # largest ratio of the drive's speed and torque limits to the executor's
QUICK_STOP_RANGE = (1.0, 5.0)  # of the executor's acceleration limit
MAX_FOLLOWING_RAD = 0.2
MAX_FOLLOWING_MS = 50
MAX_HEARTBEAT_MS = 100
MISSED_SETPOINTS = 3


@dataclass(frozen=True)
class Expected:
    """One joint's side of the comparison, SI units."""

    node: int
    q_min: float
    q_max: float
    dq_max: float
    ddq_max: float
    tau_max: float
    tick_ns: int

    @staticmethod
    def of(arm: ArmDescription, node: int, tick_ns: int) -> Expected:
        """For the drive of joint ``node - 1``."""
        limits, i = arm.limits, node - 1
        return Expected(
            node=node,
            q_min=float(limits.q_min[i]),
            q_max=float(limits.q_max[i]),
            dq_max=float(limits.dq_max[i]),
            ddq_max=float(limits.ddq_max[i]),
            tau_max=float(limits.tau_max[i]),
            tick_ns=tick_ns,
        )


class Read(Protocol):
    """Reads a number from the drive."""

    def __call__(self, index: int, sub: int = 0, signed: bool = False) -> int: ...  # noqa: D102


@dataclass(frozen=True)
class DriveCheck:
    """One row of the table. ``optional``: the entry is not in every drive's dictionary."""

    name: str
    judge: Callable[[Read, Expected], str]
    fix: Callable[[Expected], str]
    optional: bool = False


def _device(read: Read, _: Expected) -> str:
    profile = read(0x1000) & 0xFFFF
    return "" if profile == 402 else f"device profile {profile}, expected 402 (drives)"


def _error(read: Read, _: Expected) -> str:
    register = read(0x1001)
    return f"error register {register:#04x}" if register else ""


def _modes(read: Read, _: Expected) -> str:
    if not read(0x6502) & 1 << 7:
        return "does not offer cyclic synchronous position (0x6502 bit 7)"
    mode = read(0x6060, signed=True)
    return "" if mode == 8 else f"mode of operation {mode}, expected 8 (cyclic synchronous position)"


def _quick_stop(read: Read, _: Expected) -> str:
    code = read(0x605A, signed=True)
    return "" if code == 6 else f"quick stop option {code}, expected 6 (own ramp, then stay)"


def _on_silence(read: Read, _: Expected) -> str:
    code = read(0x6007, signed=True)
    return "" if code == 3 else f"option for lost communication {code}, expected 3 (quick stop)"


def _watchdog(read: Read, _: Expected) -> str:
    missed = read(0x2010)  # the stand-in's; manufacturers put theirs elsewhere between 0x2000 and 0x5FFF
    if 1 <= missed <= MISSED_SETPOINTS:
        return ""
    return f"bridges {missed} missed set-points, expected 1 to {MISSED_SETPOINTS}"


def _period(read: Read, expected: Expected) -> str:
    period_ns = round(read(0x60C2, 1) * 10 ** (9 + read(0x60C2, 2, signed=True)))
    if period_ns == expected.tick_ns:
        return ""
    return f"interpolation period {period_ns * 1e-6:g} ms, the executor sends every {expected.tick_ns * 1e-6:g} ms"


def _heartbeat(read: Read, _: Expected) -> str:
    period = read(0x1017)
    return (
        ""
        if 0 < period <= MAX_HEARTBEAT_MS
        else f"heartbeat every {period} ms, expected 1 to {MAX_HEARTBEAT_MS}"
    )


def _positions(read: Read, expected: Expected) -> str:
    low, high = (read(0x607D, sub, signed=True) / COUNTS_PER_RAD for sub in (1, 2))
    inside = expected.q_min - POSITION_SLACK_RAD <= low <= expected.q_min
    if inside and expected.q_max <= high <= expected.q_max + POSITION_SLACK_RAD:
        return ""
    ours = f"[{expected.q_min:.4f}, {expected.q_max:.4f}]"
    return f"position limits [{low:.4f}, {high:.4f}] rad, the executor's are {ours}"


def _speed(read: Read, expected: Expected) -> str:
    return _backstop("maximum speed", read(0x6080) * VELOCITY_UNIT, expected.dq_max, "rad/s")


def _torque(read: Read, expected: Expected) -> str:
    return _backstop("maximum torque", read(0x6072) * 1e-3 * read(0x6076) * 1e-3, expected.tau_max, "N·m")


def _deceleration(read: Read, expected: Expected) -> str:
    value = read(0x6085) * VELOCITY_UNIT
    low, high = (share * expected.ddq_max for share in QUICK_STOP_RANGE)
    if low <= value <= high:
        return ""
    return f"quick-stop deceleration {value:.3g} rad/s², expected {low:.3g} to {high:.3g}"


def _following(read: Read, _: Expected) -> str:
    window, timeout_ms = read(0x6065) / COUNTS_PER_RAD, read(0x6066)
    if 0 < window <= MAX_FOLLOWING_RAD and timeout_ms <= MAX_FOLLOWING_MS:
        return ""
    return (
        f"following error window {window:.3g} rad for {timeout_ms} ms, expected at most {MAX_FOLLOWING_RAD} rad "
        f"for {MAX_FOLLOWING_MS} ms"
    )


def _backstop(what: str, value: float, limit: float, unit: str) -> str:
    if limit * (1 - 1e-3) <= value <= LIMIT_SLACK * limit:
        return ""
    return (
        f"{what} {value:.4g} {unit}, the executor's limit is {limit:.4g} {unit} and the drive's must be 1 to "
        f"{LIMIT_SLACK} times that"
    )


def _write(entry: str, what: str) -> Callable[[Expected], str]:
    return lambda expected: f"write {what} to {entry} with the drive's own tool and store it (0x1010)"


CHECKS: tuple[DriveCheck, ...] = (
    DriveCheck("device", _device, lambda _: "this is no CiA 402 drive: take it off this bus"),
    DriveCheck("errors", _error, lambda _: "read 0x1003 with the drive's own tool and clear the cause"),
    DriveCheck("mode", _modes, _write("0x6060", "8")),
    DriveCheck("quick stop", _quick_stop, _write("0x605A", "6")),
    DriveCheck("on silence", _on_silence, _write("0x6007", "3")),
    DriveCheck("watchdog", _watchdog, _write("0x2010", f"at most {MISSED_SETPOINTS}"), optional=True),
    DriveCheck(
        "period", _period, lambda e: _write("0x60C2", f"{e.tick_ns // 1_000_000} (sub 1) and -3 (sub 2)")(e)
    ),
    DriveCheck("heartbeat", _heartbeat, _write("0x1017", str(MAX_HEARTBEAT_MS))),
    DriveCheck("positions", _positions, _write("0x607D", "limits just outside the executor's")),
    DriveCheck("speed", _speed, _write("0x6080", "1.1 times the executor's limit")),
    DriveCheck("torque", _torque, _write("0x6072", "the arm's limit in permille of 0x6076")),
    DriveCheck("quick-stop ramp", _deceleration, _write("0x6085", "twice the executor's acceleration limit")),
    DriveCheck("following error", _following, _write("0x6065", "0.1 rad (0x6066: 10 ms)")),
)
