"""A recording in SI and the law that drove it; read by ``files.py``."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

KINDS = ("q", "dq", "tau", "q_cmd", "dq_cmd", "tau_ff", "current", "temp", "wrench")
REBUILT_BAND = 0.4  # of the rate of a slow log: rows of position and speed hold twice what positions alone do


@dataclass(frozen=True)
class Controller:
    """The control law that drove the recording; gains in SI, keyed by model joint.

    Attributes:
        kind: One of ``pd``, ``pid``, ``position_servo``, ``none``.
        rate_hz: Rate of the law; None means every sample.
    """

    kind: str = "none"
    kp: dict[str, float] = field(default_factory=dict)
    kd: dict[str, float] = field(default_factory=dict)
    ki: dict[str, float] = field(default_factory=dict)
    rate_hz: float | None = None


@dataclass(frozen=True)
class Recording:
    """One recording in SI.

    Attributes:
        name: File stem, the name used in every message.
        t: Time [s] since the first row, shape (time,), strictly rising; ``start_s`` is that row's own stamp.
        channels: ``channels[kind][joint]`` is an array of shape (time,); kinds are the columns of the contract.
        effort: ``commanded`` (before delay, lag, clip, scale) or ``measured``.
        driven_by: ``effort`` or ``q_cmd``: what drives the forward simulation.
        session: Label shared by recordings made in one go.
        effort_sigma: Accuracy of the effort channel where it is known better than the data show it, by joint: errors
            that go together for tenths of seconds look like physics [N·m or N].
        effort_gain_sigma: How far the scale of this recording's effort may be off, by joint, as a share.
        position_sigma: How far this recording's position may be off all along, by joint [rad or m].
        units: What the columns were converted from, where the side file says so, keyed by kind and joint (``q.elbow``).
        warnings: What the file costs: missing columns, dropped samples, coarse steps.
        rows: The rows of the file, where a slow log was rebuilt between them (``motion/slow_log.py``);
            ``effort_doubt``: how far the rebuilt effort may be off, by joint, each of shape (time,) [N·m or N].
        step_s: Step at which a second run is compared, that of the run it repeats [s]; None: its own.
    """

    name: str
    t: np.ndarray
    channels: dict[str, dict[str, np.ndarray]]
    controller: Controller
    effort: str
    driven_by: str
    session: str
    notes: str
    warnings: tuple[str, ...]
    start_s: float = 0.0
    units: dict[str, str] = field(default_factory=dict)
    effort_sigma: dict[str, float] = field(default_factory=dict)
    effort_gain_sigma: dict[str, float] = field(default_factory=dict)
    position_sigma: dict[str, float] = field(default_factory=dict)
    rows: Recording | None = None
    effort_doubt: dict[str, np.ndarray] = field(default_factory=dict)
    step_s: float | None = None

    @property
    def as_read(self) -> Recording:
        """The rows of the file, before anything was rebuilt between them."""
        return self.rows or self

    @property
    def band_hz(self) -> float:
        """Highest frequency at which efforts can be compared [Hz]."""
        return 0.3 / self.dt if self.rows is None else REBUILT_BAND / self.rows.dt

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with a measured position, in file order."""
        return tuple(self.channels["q"])

    @property
    def dt(self) -> float:
        """Median step [s], without the rounding of the time stamps: a log is slow by its rate, not by its last bit."""
        return float(f"{np.median(np.diff(self.t)):.7g}")

    def get(self, kind: str, joint: str) -> np.ndarray | None:
        """One channel or None."""
        return self.channels.get(kind, {}).get(joint)


def belongs(column: str) -> bool:
    """Is this a column of the contract: ``t``, or a kind and whose it is?"""
    kind, _, joint = column.partition(".")
    return column == "t" or (kind in KINDS and bool(joint))


def resolution(x: np.ndarray) -> float:
    """Smallest step that occurs in a recorded channel (its least significant bit), 0 for a constant."""
    step = np.abs(np.diff(np.unique(x)))
    step = step[step > 1e-12]
    return float(np.percentile(step, 5)) if step.size else 0.0
