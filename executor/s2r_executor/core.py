"""What the front end knows of the native core: the shared memory's Python face, as a protocol.

The real one is ``s2r_executor._native.Shared``; tests use a small fake. Shapes are (dof,), units SI.
"""

from __future__ import annotations

import enum
from typing import Protocol

import numpy as np

QUIT = 100
"""Command kind that ends the core's process; the others are ``pb.ControlKind`` numbers."""


class EventKind(enum.IntEnum):
    """Kinds of the core's events."""

    STATE = 1
    PLAN_STARTED = 2
    PLAN_DONE = 3
    REJECTED = 4
    STOP_BEGUN = 5
    STOP_DONE = 6
    GATE_TRIP = 7
    OVERRUN = 8
    WATCHDOG = 9
    DRIVE = 10
    LATCH = 11
    INFO = 12


class CoreSnapshot(Protocol):
    """A consistent copy of the core's state."""

    @property
    def alive(self) -> bool: ...  # noqa: D102
    @property
    def state(self) -> int: ...  # noqa: D102
    @property
    def cause(self) -> int: ...  # noqa: D102
    @property
    def cause_joint(self) -> int: ...  # noqa: D102
    @property
    def cause_value(self) -> float: ...  # noqa: D102
    @property
    def cause_limit(self) -> float: ...  # noqa: D102
    @property
    def tick(self) -> int: ...  # noqa: D102
    @property
    def stamp_ns(self) -> int: ...  # noqa: D102
    @property
    def epoch(self) -> int: ...  # noqa: D102
    @property
    def plan_id(self) -> int: ...  # noqa: D102
    @property
    def next_plan_id(self) -> int: ...  # noqa: D102
    @property
    def plan_t(self) -> float: ...  # noqa: D102
    @property
    def plan_done(self) -> bool: ...  # noqa: D102
    @property
    def speed_scale(self) -> float: ...  # noqa: D102
    @property
    def speed_set(self) -> float: ...  # noqa: D102
    @property
    def q_ref(self) -> np.ndarray: ...  # noqa: D102
    @property
    def dq_ref(self) -> np.ndarray: ...  # noqa: D102
    @property
    def ddq_ref(self) -> np.ndarray: ...  # noqa: D102
    @property
    def q_meas(self) -> np.ndarray: ...  # noqa: D102
    @property
    def dq_meas(self) -> np.ndarray: ...  # noqa: D102
    @property
    def tau_meas(self) -> np.ndarray: ...  # noqa: D102
    @property
    def drive_state(self) -> np.ndarray: ...  # noqa: D102
    @property
    def feedback_age(self) -> np.ndarray: ...  # noqa: D102
    @property
    def overruns(self) -> int: ...  # noqa: D102
    @property
    def missed(self) -> int: ...  # noqa: D102
    @property
    def tx_failed(self) -> int: ...  # noqa: D102
    @property
    def crc_errors(self) -> int: ...  # noqa: D102
    @property
    def realtime(self) -> bool: ...  # noqa: D102
    @property
    def cpu(self) -> int: ...  # noqa: D102
    @property
    def bus_load_computed(self) -> float: ...  # noqa: D102


class Core(Protocol):
    """Commands into the core, state and records out of it. Each ring has one producer and one consumer:
    ``submit_plan`` and ``command`` are serialised by the caller, ``records`` and ``events`` are read by one thread.
    """

    @property
    def records_dropped(self) -> int: ...  # noqa: D102

    def beat(self) -> None: ...  # noqa: D102

    def submit_plan(  # noqa: D102
        self,
        plan_id: int,
        epoch: int,
        t: np.ndarray,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        stop_duration: np.ndarray,
        path_tolerance: float,
        goal_tolerance: float,
        parent_id: int = 0,
        splice_t: float = 0.0,
        tau_rest: np.ndarray | None = None,
        tau_move: np.ndarray | None = None,
    ) -> bool: ...

    def command(self, kind: int, epoch: int, value: float = 0.0) -> bool: ...  # noqa: D102

    def snapshot(self) -> CoreSnapshot: ...  # noqa: D102

    def records(self, max_records: int = 8192) -> np.ndarray: ...  # noqa: D102

    def events(self, max_events: int = 1024) -> np.ndarray: ...  # noqa: D102
