"""
Front end's side of the real-time core's shared memory, and the core's units for tests.
"""

from collections.abc import Sequence

import numpy
from numpy.typing import NDArray

MAX_JOINTS: int

MAX_KNOTS: int

PLAN_SLOTS: int

QUIT: int

RAD_PER_COUNT: float

START_TOLERANCE_RAD: float

SPLICE_POSITION_RAD: float

SPLICE_VELOCITY_RAD_S: float

SPLICE_ACCELERATION_RAD_S2: float = 0.0001

MIN_SEGMENT_S: float

MAX_DURATION_S: float

MAX_STOP_S: float

MAX_BUS_LOAD: float

EXECUTOR_STATES: dict[str, int]

STOP_CATEGORIES: dict[str, int]

CAUSES: dict[str, int]

CAUSE_CATEGORIES: dict[str, int]

REFUSALS: dict[str, int]

EVENT_KINDS: dict[str, int]

TRIGGERS: dict[str, int]

class Snapshot:
    """A consistent copy of the core's state after its newest tick."""

    @property
    def alive(self) -> bool:
        """The core runs and has shown a sign of life within a second."""

    @property
    def state(self) -> int:
        """ExecutorState number."""

    @property
    def cause(self) -> int:
        """
        Cause number of the last stop or latch; 0 since the last ARM or plan start.
        """

    @property
    def cause_joint(self) -> int:
        """-1: no joint in particular."""

    @property
    def cause_value(self) -> float: ...
    @property
    def cause_limit(self) -> float: ...
    @property
    def tick(self) -> int: ...
    @property
    def stamp_ns(self) -> int:
        """CLOCK_MONOTONIC."""

    @property
    def epoch(self) -> int: ...
    @property
    def plan_id(self) -> int:
        """Running or last plan; 0: none yet."""

    @property
    def plan_t(self) -> float:
        """Path time of that plan [s]."""

    @property
    def plan_done(self) -> bool:
        """That plan has ended at rest inside its goal tolerance."""

    @property
    def speed_scale(self) -> float:
        """
        Rate of path time now; between plans the rate the next one starts with.
        """

    @property
    def speed_set(self) -> float:
        """
        Rate of path time that was asked for last; a ramp leads there, a drive's warning stays below.
        """

    @property
    def q_ref(self) -> NDArray[numpy.float64]:
        """[rad], shape (dof,)."""

    @property
    def dq_ref(self) -> NDArray[numpy.float64]:
        """[rad/s]."""

    @property
    def ddq_ref(self) -> NDArray[numpy.float64]:
        """[rad/s2]."""

    @property
    def q_meas(self) -> NDArray[numpy.float64]:
        """[rad]."""

    @property
    def dq_meas(self) -> NDArray[numpy.float64]:
        """[rad/s]."""

    @property
    def tau_meas(self) -> NDArray[numpy.float64]:
        """[N m]."""

    @property
    def drive_state(self) -> numpy.ndarray:
        """CiA 402 state numbers as in the STAT frame."""

    @property
    def feedback_age(self) -> numpy.ndarray:
        """[ticks]; 65535: never answered."""

    @property
    def overruns(self) -> int:
        """Late wake-ups that lost a tick or more."""

    @property
    def missed(self) -> int:
        """Ticks lost by them."""

    @property
    def late_answers(self) -> int:
        """Drive answers that were not there when due."""

    @property
    def tx_failed(self) -> int:
        """Ticks whose setpoint did not leave."""

    @property
    def crc_errors(self) -> int:
        """Frames with a wrong checksum, length or counter."""

    @property
    def realtime(self) -> bool:
        """SCHED_FIFO, memory lock and the CPU of the configuration obtained."""

    @property
    def cpu(self) -> int:
        """The only CPU that the core runs on; -1: wherever the kernel puts it."""

    @property
    def next_plan_id(self) -> int:
        """Plan that waits for its splice point; 0: none."""

    @property
    def bus_load_foreign(self) -> float:
        """Share of the bus taken by frames of others."""

    @property
    def bus_load_computed(self) -> float:
        """Worst case, 0..1."""

class Shared:
    """The memory shared with s2r-rt. One thread may submit, one may read."""

    @staticmethod
    def create(config: dict) -> Shared:
        """Make the memory. ValueError names a bad, missing or unknown field."""

    @property
    def fd(self) -> int:
        """Descriptor to pass to s2r-rt --shm-fd."""

    def beat(self) -> None:
        """Show that the front end lives; at least every 20 ms."""

    def submit_plan(
        self,
        plan_id: int,
        epoch: int,
        t: NDArray[numpy.float64],
        q: NDArray[numpy.float64],
        dq: NDArray[numpy.float64],
        ddq: NDArray[numpy.float64],
        stop_duration: NDArray[numpy.float64],
        path_tolerance: float,
        goal_tolerance: float,
        parent_id: int = 0,
        splice_t: float = 0.0,
        tau_rest: NDArray[numpy.float64] | None = None,
        tau_move: NDArray[numpy.float64] | None = None,
    ) -> bool:
        """
        Hand a plan over; the core answers by events. False: no free slot.

        t (n,) [s], q, dq, ddq (n, dof), stop_duration (n - 1,) [s]; a tolerance of 0 is the configured one.
        tau_rest, tau_move (n, dof): torque [N m] standing at a knot and passing it as planned, for contact.
        """

    def command(self, kind: int, epoch: int, value: float = 0.0) -> bool:
        """Queue a control command (ControlKind number or QUIT). False: no room."""

    def snapshot(self) -> Snapshot:
        """A consistent copy of the core's state."""

    def records(self, max_records: int = 8192) -> numpy.ndarray:
        """Take the oldest cycle records out: structured array, one per tick."""

    def events(self, max_events: int = 1024) -> numpy.ndarray:
        """Take the oldest events out: structured array."""

    @property
    def records_dropped(self) -> int:
        """Records lost because nobody took them."""

    @property
    def events_dropped(self) -> int:
        """Events lost because nobody took them."""

class Core:
    """The real-time core without sockets or clock, stepped by a test."""

    def __init__(self, shared: Shared, first_tick: int = 0) -> None: ...
    def step(
        self,
        frames: Sequence[tuple[int, bytes, bool]],
        now_ns: int,
        skipped: int = 0,
        send_fails: bool = False,
    ) -> list[tuple[int, bytes, bool]]:
        """
        One tick: frames (identifier, data, is FD) in, frames out; `skipped` ticks were lost before it.
        """

    def request_quit(self) -> None:
        """As SIGTERM: stop on the path, disable, finish."""

    def close_bus(self) -> None:
        """The other side of the bus goes away."""

    def all_answered(self) -> bool:
        """Every drive has answered the newest setpoint."""

    @property
    def finished(self) -> bool: ...

class Packing:
    """Frames of one packing ('fd' or 'classic')."""

    def __init__(self, packing: str, dof: int, dt: float = 0.001) -> None: ...
    def encode(
        self, tick: int, seq: int, request: int, q: NDArray[numpy.float64], dq: NDArray[numpy.float64]
    ) -> list[tuple[int, bytes, bool]]:
        """Frames of one setpoint."""

    def decode(self, id: int, data: bytes, fd: bool) -> tuple[int, int]:
        """
        (kind, joint); kind 0 answer, 1 ignored, 2 corrupt, 3 foreign master, 4 emergency, 5 bus error, 6 bus off.
        """

    def drive(self, joint: int) -> dict:
        """What is known of a drive."""

    def tx_allowed(self, id: int, length: int, fd: bool) -> bool:
        """May this frame leave the core?"""

def evaluate_spline(
    t: NDArray[numpy.float64],
    q: NDArray[numpy.float64],
    dq: NDArray[numpy.float64],
    ddq: NDArray[numpy.float64],
    s: NDArray[numpy.float64],
) -> tuple:
    """
    Quintic Hermite spline at path times s (m,): q, dq, ddq, dddq, each (m, dof).
    """

def sample_polynomials(
    knots: NDArray[numpy.float64], coefficients: NDArray[numpy.float64], times: NDArray[numpy.float64]
) -> tuple:
    """
    Piecewise quintic of power-basis coefficients (segments, 6, dof), at times (m,) inside the knots:
    value and three derivatives, each (m, dof).
    """

def rate_ramp(start: float, changes: Sequence[tuple[int, float, float]], dt: float, ticks: int) -> tuple:
    """
    Rate, its slope and the path time covered, each (ticks,), with changes (tick, target, duration).
    """

def joint_stop(
    q: NDArray[numpy.float64],
    dq: NDArray[numpy.float64],
    ddq: NDArray[numpy.float64],
    ddq_max: NDArray[numpy.float64],
    dddq_max: NDArray[numpy.float64],
    times: NDArray[numpy.float64],
) -> tuple:
    """
    Per-joint jerk-limited stop: durations (dof,) and q, dq, ddq (m, dof) at the times.
    """

def gate_check(
    q: NDArray[numpy.float64], dq: NDArray[numpy.float64], dt: float, limits: dict, margin: float = 1.02
) -> tuple[int, int, int, float, float] | None:
    """
    First violation (index, cause, joint, value, limit) of setpoints (m, dof), or None; rests at the first.
    """

def shortest_blends(
    knots: NDArray[numpy.float64],
    coefficients: NDArray[numpy.float64],
    load: tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]],
    load_step_s: float,
    cell_s: float,
    durations: Sequence[float],
    ddq_limit: NDArray[numpy.float64],
    dddq_limit: NDArray[numpy.float64],
    tau_limit: NDArray[numpy.float64],
) -> tuple[list[float], int, tuple[NDArray[numpy.float64], NDArray[numpy.float64], NDArray[numpy.float64]]]:
    """
    Per segment the shortest of the durations [s] in which path time may stop or resume
    anywhere in it, NaN where there is none; the first such segment or -1, and the largest
    acceleration, jerk and torque (dof,) of the longest there. See s2r_executor.stop_ramps.
    """

def bus_load(packing: str, dof: int, tick_ns: int) -> float:
    """Share of the bus in the worst case of bit stuffing."""

def crc16(data: bytes, last: int) -> int:
    """CRC-16/CCITT-FALSE of data and one more byte."""

def controlword(request: int, state: int) -> int:
    """CiA 402 controlword for a request to a drive in this state."""

def drive_state(statusword: int) -> int:
    """CiA 402 state number of a statusword."""

def next_state(state: int, trigger: int) -> int:
    """The state machine."""
