"""Engineering units of both packings. Conversion happens here and nowhere else.

Position 4 nrad per count in an i32 (±8.59 rad), velocity 2e-4 rad/s in an i16 (±6.55 rad/s), torque 0.01 N·m in an
i16 (±327 N·m). Positions need 32 bits: 16 bits over ±12.5 rad are 0.38 mrad, which differenced at 1 kHz reads as
381 rad/s².
"""

from __future__ import annotations

from s2r_protocol.can.frames import FrameRefusedError

COUNTS_PER_RAD = 250_000_000
VELOCITY_UNIT = 2e-4  # rad/s
TORQUE_UNIT = 0.01  # N·m
FOLLOWING_UNIT = 1e-5  # rad; only in the classical packing's TPDO1

_I32 = 2**31 - 1
_I16 = 2**15 - 1


def position_counts(q: float) -> int:
    """Position in counts.

    Raises:
        FrameRefusedError: Not a number, or beyond the i32.
    """
    return _counts("position", q, q * COUNTS_PER_RAD, _I32)


def velocity_counts(dq: float) -> int:
    """Velocity in counts.

    Raises:
        FrameRefusedError: Not a number, or beyond the i16.
    """
    return _counts("velocity", dq, dq / VELOCITY_UNIT, _I16)


def torque_counts(tau: float) -> int:
    """Torque in counts.

    Raises:
        FrameRefusedError: Not a number, or beyond the i16.
    """
    return _counts("torque", tau, tau / TORQUE_UNIT, _I16)


def _counts(what: str, value: float, scaled: float, limit: int) -> int:
    if not -limit <= scaled <= limit:  # also refuses NaN
        raise FrameRefusedError(
            f"{what} {value!r} does not fit its field: {scaled:.6g} counts, limit ±{limit}"
        )
    return round(scaled)


def saturated_i16(value: float) -> int:
    """A measured value in an i16 field; a sensor saturates where a command would be refused."""
    counts = round(value)
    if -_I16 <= counts <= _I16:
        return counts
    return _I16 if counts > 0 else -_I16
