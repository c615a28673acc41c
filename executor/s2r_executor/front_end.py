"""The executor's front end: decides what reaches the core and watches over who asked for it.

No messages and no sockets here: the bridge turns messages into calls, the core is an interface.
Threads: :meth:`FrontEnd.step` belongs to one thread (the watch loop); commands may come from several others.
"""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from s2r_executor.admission import Admission
from s2r_executor.black_box import BlackBox
from s2r_executor.bridge_motion import PathState
from s2r_executor.config import ExecutorConfig
from s2r_executor.core import Core, CoreSnapshot, EventKind
from s2r_executor.core_refusals import refused_command, refused_plan
from s2r_executor.door import Identity, SequenceBook, check_addressee, check_epoch
from s2r_executor.lease import Lease, LeaseDecision
from s2r_executor.plan import AdmittedPlan, CommandRefusedError, PlanRequest
from s2r_executor.quintic import sample, spline_through
from s2r_executor.recorder import PlanIdentity, Recorder, RecordingAnswer, RecordingLoss
from s2r_executor.stalls import Patience, StallWatch
from s2r_executor.status import LOOK_AT, ExecutorStatus, silent_joints, why_not_moving
from s2r_executor.tick_timing import TickTiming
from s2r_protocol.arms import ArmDescription
from s2r_protocol.codec import Address
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb

logger = logging.getLogger(__name__)

_WITHOUT_POWER = {ExecutorState.BOOT, ExecutorState.DISARMED, ExecutorState.FAULT, ExecutorState.ESTOP}
_MOVING = {ExecutorState.RUN, ExecutorState.PAUSED, ExecutorState.STOPPING, ExecutorState.STOP1}
# Where the core answers a STOP with a new epoch. In STOPPING and STOP1 one is under way, which has made its own.
_STOP_HAS_EPOCH = {
    ExecutorState.DISARMED,
    ExecutorState.HOLD,
    ExecutorState.ARMING,
    ExecutorState.RUN,
    ExecutorState.PAUSED,
}
_ALLOWED_IN: dict[int, set[ExecutorState]] = {
    pb.ARM: {ExecutorState.DISARMED},
    pb.DISARM: {ExecutorState.DISARMED, ExecutorState.ARMING, ExecutorState.HOLD},
    pb.PAUSE: {ExecutorState.RUN},
    pb.RESUME: {ExecutorState.PAUSED},
    pb.SET_SPEED: {ExecutorState.HOLD, ExecutorState.RUN, ExecutorState.PAUSED},
    pb.RESET: {ExecutorState.FAULT, ExecutorState.ESTOP},
}
_ENDING = (
    "The executor is being ended (Ctrl-C, SIGTERM or a lost terminal there): the arm comes to rest and the drives go "
    "off. Start the executor again before anything else."
)
_ANSWER_WITHIN_S = 2.0
_STOP_WITHIN_S = 0.5
_POLL_S = 0.001
_RECORDS_EVERY = (
    5  # rounds of the watch loop: handing over few ticks at a time costs more than what is done with them
)
_KEPT_REJECTIONS = 64

T = TypeVar("T")


@dataclass(frozen=True)
class Accepted:
    """A command was accepted."""

    epoch: int
    duration_s: float = 0.0


class FrontEnd:
    """One arm's front end.

    Args:
        arm: What is being moved.
        config: How.
        core: The native core's shared memory.
        recorder: Gets every record, event and plan.
        now_s: Monotonic clock [s]; tests pass their own.
        idle: Called while waiting for the core; tests move their own time.
        speed_cap: Largest share of planned speed, in (0, 1]; what the preflight allows.
    """

    def __init__(
        self,
        arm: ArmDescription,
        config: ExecutorConfig,
        core: Core,
        recorder: Recorder,
        now_s: Callable[[], float] = time.monotonic,
        idle: Callable[[], None] = lambda: time.sleep(_POLL_S),
        speed_cap: float = 1.0,
    ) -> None:
        self.arm = arm
        self.config = config
        self.identity = Identity(secrets.randbits(63) + 1, arm.model_hash, arm.limit_hash)
        self.book = SequenceBook()
        self._core = core
        self._recorder = recorder
        self._black_box = (
            BlackBox(config.record, config.recorder.black_box_s, config.tick_ns) if config.record else None
        )
        self._now_s = now_s
        self._idle = idle
        self._speed_cap = speed_cap
        self._lease = Lease(config.effective_host_timeout_s)
        self._admission = Admission(arm, config.admission, config.core)
        self._command_lock = threading.Lock()  # one command at a time; STOP does not wait for it
        self._ring_lock = threading.Lock()  # the core's command rings have one producer
        self._lease_lock = threading.Lock()
        self._ending = False
        self._fell_silent = ""  # who lost the lease last, by silence
        self._stops_asked = 0
        self._dropped_said = 0
        self._next_plan_id = 1
        self._seq_of_plan: dict[int, int] = {0: 0}  # of those in the core and the newest
        self._rejections: OrderedDict[int, np.void] = OrderedDict()  # plan id -> the core's event
        self._refused_command: np.void | None = None  # the core's event for the command under way
        self._admitted: dict[int, AdmittedPlan] = {}  # plan id -> what the core plays or is about to
        self._rejections_lock = threading.Lock()
        self._timing = TickTiming()
        self._stepped = config.clock == "lockstep"
        self._stalls = StallWatch()
        self._rounds = 0

    # -- asking -------------------------------------------------------------------------------------

    def status(self) -> ExecutorStatus:
        """The state right now."""
        core = self._core.snapshot()
        holder = self._lease.holder
        return ExecutorStatus(
            core=core,
            plan_seq=self._seq_of_plan.get(core.plan_id, 0),
            lease_holder=holder,
            why_not_moving=_ENDING if self._ending else why_not_moving(core, self.arm.joint_names, holder),
            silent_joints=silent_joints(core, self.arm.joint_names),
        )

    def recording(self, plan_seq: int) -> RecordingAnswer:
        """The recording of the newest plan with this number."""
        return self._recorder.answer(plan_seq)

    def punctuality(self) -> tuple[TickTiming, int, RecordingLoss]:
        """Lateness of the ticks so far, ticks that never left the core, and ticks that are in no recording."""
        return self._timing, self._core.records_dropped, self._recorder.loss

    # -- the right to move --------------------------------------------------------------------------

    def lease(self, address: Address, release: bool) -> LeaseDecision:
        """Ask for or give back the lease.

        Raises:
            CommandRefusedError: The message is for another process or arm.
        """
        check_addressee(address, self.identity)
        with self._lease_lock:
            if not release:
                decision = self._lease.request(address.sender, self._now_s())
            else:
                decision = self._lease.release(address.sender)
        if decision.granted:
            logger.info("lease %s by '%s'", "returned" if release else "taken", address.sender)
            if address.sender == self._fell_silent:
                self._fell_silent = ""
            if release:
                self._stop_if_moving(Cause.HOST_LOST)
        return decision

    def heartbeat(self, address: Address) -> None:
        """Count a sign of life; one from anybody but the holder is ignored."""
        if address.boot_id == self.identity.boot_id:
            with self._lease_lock:
                self._lease.beat(address.sender, self._now_s())

    # -- commands -----------------------------------------------------------------------------------

    def check_door(self, address: Address) -> None:
        """Addressee, lease and epoch: what can be refused before a body is parsed.

        Raises:
            CommandRefusedError: STALE, MODEL or NO_LEASE.
        """
        self._check_right(address)

    def plan(self, address: Address, request: PlanRequest, wire: bytes) -> Accepted:
        """Admit a plan and start it.

        Raises:
            CommandRefusedError: With everything a verdict says; nothing has moved.
        """
        with self._command_lock:
            stops_before = self._stops_asked
            core = self._check_right(address)
            if request.parent_seq or request.splice_t:
                return self._splice(address, request, core, wire, stops_before)
            if core.state != ExecutorState.HOLD:
                raise CommandRefusedError(
                    Refusal.STATE,
                    f"a plan can start only while the arm holds; the executor is {ExecutorState(core.state).name}. "
                    + self.status().why_not_moving,
                    quantity="state",
                    value=core.state,
                    limit=ExecutorState.HOLD,
                )
            admitted = self._admission.admit(request, np.asarray(core.q_ref))
            self._refuse_if_void(address.sender, stops_before)
            return self._start(address, request, admitted, core.epoch, wire)

    def _refuse_if_void(self, sender: str, stops_before: int) -> None:
        """Admission takes its time: a stop or the end of the lease meanwhile counts for what was being checked."""
        self._check_holder(sender)
        if self._stops_asked != stops_before:
            raise CommandRefusedError(
                Refusal.STALE,
                "a stop was requested while the plan was being checked; send it again if still wanted",
            )

    def _splice(
        self, address: Address, request: PlanRequest, core: CoreSnapshot, wire: bytes, stops_before: int
    ) -> Accepted:
        """Replace the running plan from ``splice_t`` of its own time on; if that is refused, it goes on."""
        running_seq = self._seq_of_plan.get(core.plan_id, 0)
        if core.state != ExecutorState.RUN:
            raise CommandRefusedError(
                Refusal.STATE,
                f"a plan can be replaced only while it runs; the executor is {ExecutorState(core.state).name}. "
                + self.status().why_not_moving,
                quantity="state",
                value=core.state,
                limit=ExecutorState.RUN,
            )
        if request.parent_seq != running_seq:
            raise CommandRefusedError(
                Refusal.SPLICE,
                f"plan {request.parent_seq} does not run, plan {running_seq} does; splice into that one",
                quantity="parent_seq",
                value=request.parent_seq,
                limit=running_seq,
            )
        parent = self._admitted[core.plan_id]
        earliest = core.plan_t + self.config.admission.commit_horizon_s
        if not request.splice_t >= earliest:
            raise CommandRefusedError(
                Refusal.LATE,
                f"the new plan is to begin at {request.splice_t:.4f} s of plan {running_seq}, which is at "
                f"{core.plan_t:.4f} s; it must begin {self.config.admission.commit_horizon_s:g} s ahead or later",
                t=request.splice_t,
                quantity="splice_t",
                value=request.splice_t,
                limit=earliest,
            )
        if not request.splice_t <= parent.duration_s:
            raise CommandRefusedError(
                Refusal.SPLICE,
                f"plan {running_seq} ends at {parent.duration_s:.4f} s, before the splice at {request.splice_t:.4f} s",
                t=request.splice_t,
                quantity="splice_t",
                value=request.splice_t,
                limit=parent.duration_s,
            )
        at = sample(spline_through(parent.t, parent.q, parent.dq, parent.ddq), np.array([request.splice_t]))
        admitted = self._admission.admit_splice(request, PathState(at.q[0], at.dq[0], at.ddq[0]))
        self._refuse_if_void(address.sender, stops_before)
        return self._start(address, request, admitted, core.epoch, wire, core.plan_id)

    def _start(
        self,
        address: Address,
        request: PlanRequest,
        admitted: AdmittedPlan,
        epoch: int,
        wire: bytes,
        parent_id: int = 0,
    ) -> Accepted:
        plan_id = self._next_plan_id
        self._next_plan_id += 1
        self._seq_of_plan = {**self._of_plans_in_core(self._seq_of_plan), 0: 0, plan_id: address.seq}
        identity = PlanIdentity(plan_id, address.seq, epoch, address.sender, request.label)
        self._recorder.open_plan(identity, wire)
        with self._ring_lock:
            queued = self._core.submit_plan(
                plan_id,
                epoch,
                admitted.t,
                admitted.q,
                admitted.dq,
                admitted.ddq,
                admitted.stop_duration,
                admitted.path_tolerance,
                admitted.goal_tolerance,
                parent_id=parent_id,
                splice_t=request.splice_t if parent_id else 0.0,
                tau_rest=admitted.tau_rest,
                tau_move=admitted.tau_move,
            )
        if not queued:
            self._recorder.drop_plan(plan_id, "the core's plan queue was full")
            raise CommandRefusedError(
                Refusal.INTERNAL, "the core's plan queue is full; is the core still running?"
            )
        answered = self._wait(
            lambda c: (
                plan_id in (c.plan_id, c.next_plan_id if parent_id else 0)
                or self._rejection(plan_id) is not None
                or not c.alive
            )
        )
        rejection = self._rejection(plan_id)
        if rejection is not None:
            self._recorder.drop_plan(plan_id, "the core refused it")
            raise refused_plan(rejection, self.arm.joint_names)
        if not self._core.snapshot().alive:
            self._recorder.drop_plan(plan_id, "the core died")
            self._void_what_waits()
            raise _core_is_dead()
        self._keep_admitted(plan_id, admitted)
        if not answered:
            reason = f"the core did not take the plan within {_ANSWER_WITHIN_S:g} s"
            self._recorder.drop_plan(plan_id, reason)
            self._void_what_waits()
            raise CommandRefusedError(Refusal.INTERNAL, f"{reason}; it is void")
        self._stop_if_nobodys(address.sender)
        logger.info(
            "plan %d '%s' of '%s' runs for %.2f s",
            address.seq,
            request.label,
            address.sender,
            admitted.duration_s,
        )
        return Accepted(epoch, admitted.duration_s)

    def _void_what_waits(self) -> None:
        """What the core did not take in time must not happen later: a stop, taken first, makes another epoch."""
        self._stops_asked += 1
        with suppress(CommandRefusedError):  # no room: the core takes nothing at all
            self._send(pb.STOP, self._core.snapshot().epoch)

    def _stop_if_nobodys(self, sender: str) -> None:
        """Stop what began just when its lease ended: whoever watches the lease saw an arm at rest and let it be."""
        try:
            self._check_holder(sender)
        except CommandRefusedError:
            self._stop_if_moving(Cause.HOST_LOST)
            raise

    def _keep_admitted(self, plan_id: int, admitted: AdmittedPlan) -> None:
        """Remember a plan that may be spliced into, and forget those that the core has left behind."""
        self._admitted = {**self._of_plans_in_core(self._admitted), plan_id: admitted}

    def _of_plans_in_core(self, known: dict[int, T]) -> dict[int, T]:
        """What is known of the plan that the core plays, or played last, and of the one that waits for its splice."""
        core = self._core.snapshot()
        return {i: known[i] for i in (core.plan_id, core.next_plan_id) if i in known}

    def control(self, address: Address, kind: int, value: float) -> Accepted:
        """Carry out a control command and wait until the core has done so.

        STOP is begun then and PAUSE has come to rest, or its plan to its end; SET_SPEED is taken, its ramp goes on.

        Raises:
            CommandRefusedError: It is unknown, not possible now, or the core did not follow.
        """
        if kind == pb.STOP:
            return self.stop(Cause.STOP_REQUESTED)
        with self._command_lock:
            if kind not in _ALLOWED_IN:
                raise CommandRefusedError(Refusal.MALFORMED, f"unknown control command {kind}", value=kind)
            core = self._check_right(address)
            name = pb.ControlKind.Name(kind)
            state = ExecutorState(core.state)
            if state not in _ALLOWED_IN[kind]:
                possible = ", ".join(s.name for s in sorted(_ALLOWED_IN[kind]))
                raise CommandRefusedError(
                    Refusal.STATE,
                    f"{name} is not possible in {state.name}, only in {possible}. "
                    + self.status().why_not_moving,
                    quantity="state",
                    value=state,
                )
            if kind == pb.SET_SPEED and not 0.0 < value <= self._speed_cap:
                why = "; send a share of the planned speed, and PAUSE to stand still"
                if self._speed_cap < 1.0:
                    why = "; this machine allows no more, 's2r doctor' says why"
                raise CommandRefusedError(
                    Refusal.VELOCITY,
                    f"speed scale {value:g} is outside (0, {self._speed_cap:g}]{why}",
                    quantity="speed_scale",
                    value=value,
                    limit=self._speed_cap,
                )
            return self._carry_out(kind, core, value)

    def stop(self, cause: Cause) -> Accepted:
        """Stop on the path (category 2) whatever the state; never waits for other commands.

        Raises:
            CommandRefusedError: The core is dead or did not answer; the stop lies before it all the same.
        """
        self._stops_asked += 1
        before = self._core.snapshot()
        self._send(pb.STOP, before.epoch, 0.0 if cause is Cause.STOP_REQUESTED else float(cause))
        state = ExecutorState(before.state)
        logger.info("stop: %s, state was %s", cause.name, state.name)
        if not before.alive:
            raise _core_is_dead()
        answered = state not in _STOP_HAS_EPOCH or self._wait(
            lambda c: not c.alive or c.epoch != before.epoch or c.state not in _STOP_HAS_EPOCH, _STOP_WITHIN_S
        )
        after = self._core.snapshot()
        if not after.alive:
            raise _core_is_dead()
        if not answered:
            raise CommandRefusedError(
                Refusal.INTERNAL, f"the core did not answer the stop within {_STOP_WITHIN_S:g} s"
            )
        return Accepted(after.epoch)

    def _carry_out(self, kind: int, core: CoreSnapshot, value: float) -> Accepted:
        config = self.config
        if kind == pb.ARM:
            # From DISARMED through ARMING to HOLD or a latched fault; a stop on the way makes an epoch of its own.
            self._order(
                pb.ARM,
                core.epoch,
                lambda c: (
                    c.epoch > core.epoch + 1 or c.state not in (ExecutorState.DISARMED, ExecutorState.ARMING)
                ),
                within_s=config.core.arming_timeout_s + _ANSWER_WITHIN_S,
            )
            self._expect(pb.ARM, ExecutorState.HOLD)
            self._cap_speed()
        elif kind in (pb.RESET, pb.DISARM):
            self._order(kind, core.epoch, lambda c: c.state == ExecutorState.DISARMED)
            self._expect(kind, ExecutorState.DISARMED)
        elif kind == pb.PAUSE:
            within_s = config.longest_path_stop_s + config.core.goal_timeout_s + _ANSWER_WITHIN_S
            self._order(pb.PAUSE, core.epoch, lambda c: c.state != ExecutorState.RUN, within_s=within_s)
            self._expect_on_plan(pb.PAUSE, ExecutorState.PAUSED)
        elif kind == pb.RESUME:
            self._order(pb.RESUME, core.epoch, lambda c: c.state != ExecutorState.PAUSED)
            self._expect_on_plan(pb.RESUME, ExecutorState.RUN)
        elif kind == pb.SET_SPEED:
            self._order(pb.SET_SPEED, core.epoch, lambda c: c.speed_set == value, value)
        return Accepted(self._core.snapshot().epoch)

    def _order(
        self,
        kind: int,
        epoch: int,
        done: Callable[[CoreSnapshot], bool],
        value: float = 0.0,
        within_s: float = _ANSWER_WITHIN_S,
    ) -> None:
        """Send a command and wait until it is done.

        Raises:
            CommandRefusedError: The core refused it, died, or did neither in time.
        """
        self._refused_command = None
        self._send(kind, epoch, value)
        ended = self._wait(lambda c: done(c) or not c.alive or self._refused_command is not None, within_s)
        core, name = self._core.snapshot(), pb.ControlKind.Name(kind)
        if not (core.alive and ended) and not done(core) and kind in (pb.ARM, pb.RESUME):
            self._void_what_waits()
        if not core.alive:  # or asleep, for so long that it counts as dead
            raise _core_is_dead()
        if done(core):
            return
        refused = self._refused_command
        if refused is not None:
            raise refused_command(kind, refused, core, self.arm.joint_names, self.status().why_not_moving)
        if not ended:
            raise CommandRefusedError(
                Refusal.INTERNAL,
                f"the core has not carried out {name} within {within_s:g} s. " + self.status().why_not_moving,
            )

    def _cap_speed(self) -> None:
        """Arming starts at full speed in the core; no plan is taken before the cap holds."""
        if self._speed_cap == 1.0:
            return
        cap = self._speed_cap
        try:
            self._order(pb.SET_SPEED, self._core.snapshot().epoch, lambda c: c.speed_set <= cap, cap)
        except CommandRefusedError as error:
            self._send(pb.DISARM, self._core.snapshot().epoch)
            raise CommandRefusedError(
                Refusal.INTERNAL, f"the core did not take the speed cap: disarmed again ({error})"
            ) from error

    def _expect_on_plan(self, kind: int, wanted: ExecutorState) -> None:
        """As :meth:`_expect`, but a plan whose rest was shorter than the ramp may have come to its end."""
        core = self._core.snapshot()
        if not (core.state == ExecutorState.HOLD and core.plan_done):
            self._expect(kind, wanted)

    def _expect(self, kind: int, wanted: ExecutorState) -> None:
        core = self._core.snapshot()
        state = ExecutorState(core.state)
        if state != wanted:
            left_off = kind == pb.ARM and state == ExecutorState.DISARMED and not core.cause
            why = f"The drives did not switch on: {LOOK_AT}." if left_off else self.status().why_not_moving
            raise CommandRefusedError(
                Refusal.STATE,
                f"{pb.ControlKind.Name(kind)} ended in {state.name} instead of {wanted.name}. {why}",
                quantity="state",
                value=state,
                limit=wanted,
            )

    def _check_right(self, address: Address) -> CoreSnapshot:
        """Addressee, lease and epoch; returns the snapshot they were checked against."""
        check_addressee(address, self.identity)
        core = self._core.snapshot()
        if not core.alive:
            raise _core_is_dead()
        self._check_holder(address.sender)
        check_epoch(address, core.epoch)
        return core

    def _check_holder(self, sender: str) -> None:
        """Raises:
        CommandRefusedError: NO_LEASE.
        """
        with self._lease_lock:
            holder = self._lease.holder
        if sender == holder:
            return
        who = f"{holder!r}" if holder else "nobody"
        lasts_s = self.config.effective_host_timeout_s
        why = f"'{sender}' does not hold the lease, {who} does; take it first"
        if sender == self._fell_silent:
            why = (
                f"'{sender}' lost the lease, {who} holds it now: its heartbeat was silent for longer than "
                f"the {lasts_s:g} s that the lease lasts (was its process stopped?). An arm that moved was stopped "
                "then; look at the state, and take the lease again"
            )
        raise CommandRefusedError(Refusal.NO_LEASE, why, quantity="lease", limit=lasts_s)

    def _send(self, kind: int, epoch: int, value: float = 0.0) -> None:
        with self._ring_lock:
            queued = self._core.command(kind, epoch, value)
        if not queued:
            raise CommandRefusedError(
                Refusal.INTERNAL, "the core's command queue is full; is the core still running?"
            )

    def _wait(self, condition: Callable[[CoreSnapshot], bool], timeout_s: float = _ANSWER_WITHIN_S) -> bool:
        core = self._core.snapshot()
        patience = Patience(timeout_s, self._stepped, core.tick, time.monotonic())
        while not condition(core):
            if patience.ended(core, time.monotonic()):
                return condition(self._core.snapshot())
            self._idle()
            core = self._core.snapshot()
        return True

    def _rejection(self, plan_id: int) -> np.void | None:
        with self._rejections_lock:
            return self._rejections.get(plan_id)

    # -- the watch loop -----------------------------------------------------------------------------

    def step(self) -> np.ndarray:
        """One round of the watch loop: beat, host watch, records and events. Call every few milliseconds.

        Returns:
            The core's new events.
        """
        self._core.beat()
        if self._stepped:
            self._stalls.look(self._core.snapshot(), self._now_s())
        with self._lease_lock:
            silence_s = self._lease.silence_s(self._now_s())
            lost = self._lease.expire(self._now_s())
        if lost:
            self._fell_silent = lost
            logger.warning(
                "lease of '%s' ended: no heartbeat for %.0f ms, limit %.0f ms",
                lost,
                silence_s * 1e3,
                self.config.effective_host_timeout_s * 1e3,
            )
            self._stop_if_moving(Cause.HOST_LOST)
        events = self._core.events()
        self._note_rejections(events)
        self._rounds += 1
        if len(events) or self._rounds % _RECORDS_EVERY == 0:
            self._take_records(events)
        return events

    def _take_records(self, events: np.ndarray) -> None:
        """Pass on what the core wrote down: to the recorder, the timing and the black box."""
        records = self._core.records()
        if len(records):
            self._timing.add(records)
        if self._black_box is not None:
            self._black_box.add(records, events)
        dropped = self._core.records_dropped
        if dropped > self._dropped_said:
            if self._dropped_said == 0:
                logger.warning("%d ticks are missing from the recordings: the front end fell behind", dropped)
            self._dropped_said = dropped
        if len(events) or len(records):
            self._recorder.feed(records, events, self._lease.holder)

    def _stop_if_moving(self, cause: Cause) -> None:
        core = self._core.snapshot()
        if ExecutorState(core.state) in (ExecutorState.RUN, ExecutorState.PAUSED):
            self._stops_asked += 1
            self._send(pb.STOP, core.epoch, float(cause))

    def _note_rejections(self, events: np.ndarray) -> None:
        for event in events:
            if event["kind"] != EventKind.REJECTED:
                continue
            if not event["plan_id"]:
                self._refused_command = event
                continue
            with self._rejections_lock:
                self._rejections[int(event["plan_id"])] = event
                if len(self._rejections) > _KEPT_REJECTIONS:
                    self._rejections.popitem(last=False)

    def close(self) -> None:
        """Finish what is being written."""
        self._take_records(self._core.events())
        if self._black_box is not None:
            self._black_box.close()

    def shut_down(self, timeout_s: float | None = None) -> bool:
        """Stop on the path, then switch the drives off; True if it came to rest and off in time.

        A core that was told to end by the same signal does both by itself and may be gone before it is asked.

        Args:
            timeout_s: For each of the two [s]; None: what the configuration allows a stop to take.
        """
        core = self._core.snapshot()
        self._ending = True
        limit_s = self.config.longest_stop_s if timeout_s is None else timeout_s
        if core.alive and ExecutorState(core.state) in _MOVING:
            self._stop_if_moving(Cause.STOP_REQUESTED)
            self._wait(lambda c: not c.alive or ExecutorState(c.state) not in _MOVING, limit_s)
        core = self._core.snapshot()
        if core.alive and ExecutorState(core.state) in (ExecutorState.HOLD, ExecutorState.ARMING):
            try:
                self._order(
                    pb.DISARM, core.epoch, lambda c: c.state == ExecutorState.DISARMED, within_s=limit_s
                )
            except CommandRefusedError as error:
                if not self._is_without_power():
                    logger.error("the drives were not switched off: %s", error)
        return self._is_without_power()

    def _is_without_power(self) -> bool:
        """As the core said last, dead or alive."""
        return ExecutorState(self._core.snapshot().state) in _WITHOUT_POWER


def _core_is_dead() -> CommandRefusedError:
    return CommandRefusedError(
        Refusal.STATE,
        "the real-time core is not running, the drives stop by themselves: restart the executor",
    )
