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
from dataclasses import dataclass

import numpy as np

from s2r_executor.admission import Admission
from s2r_executor.config import ExecutorConfig
from s2r_executor.core import Core, CoreSnapshot, EventKind
from s2r_executor.door import Identity, SequenceBook, check_addressee, check_epoch
from s2r_executor.lease import Lease, LeaseDecision
from s2r_executor.plan import AdmittedPlan, CommandRefusedError, PlanRequest
from s2r_executor.recorder import PlanIdentity, Recorder, RecordingAnswer, RecordingLoss
from s2r_executor.status import ExecutorStatus, why_not_moving
from s2r_executor.tick_timing import TickTiming
from s2r_protocol.arms import ArmDescription
from s2r_protocol.codec import Address
from s2r_protocol.faults import Cause, ExecutorState, Refusal
from s2r_protocol.proto import s2r_pb2 as pb

logger = logging.getLogger(__name__)

_MOVING = {ExecutorState.RUN, ExecutorState.PAUSED, ExecutorState.STOPPING, ExecutorState.STOP1}
_POWERED = _MOVING - {ExecutorState.STOP1} | {ExecutorState.HOLD, ExecutorState.ARMING}
_ALLOWED_IN: dict[int, set[ExecutorState]] = {
    pb.ARM: {ExecutorState.DISARMED},
    pb.DISARM: {ExecutorState.DISARMED, ExecutorState.ARMING, ExecutorState.HOLD},
    pb.PAUSE: {ExecutorState.RUN},
    pb.RESUME: {ExecutorState.PAUSED},
    pb.SET_SPEED: {ExecutorState.HOLD, ExecutorState.RUN, ExecutorState.PAUSED},
    pb.RESET: {ExecutorState.FAULT, ExecutorState.ESTOP},
}
_ANSWER_WITHIN_S = 2.0
_STOP_WITHIN_S = 0.5
_POLL_S = 0.001
_KEPT_REJECTIONS = 64


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
        speed_cap: Largest share of planned speed, in (0, 1]; what the preflight allows.
    """

    def __init__(
        self,
        arm: ArmDescription,
        config: ExecutorConfig,
        core: Core,
        recorder: Recorder,
        now_s: Callable[[], float] = time.monotonic,
        speed_cap: float = 1.0,
    ) -> None:
        self.arm = arm
        self.config = config
        self.identity = Identity(secrets.randbits(63) + 1, arm.model_hash, arm.limit_hash)
        self.book = SequenceBook()
        self._core = core
        self._recorder = recorder
        self._now_s = now_s
        self._speed_cap = speed_cap
        self._lease = Lease(config.effective_host_timeout_s)
        self._admission = Admission(
            arm, config.admission, config.core.path_tolerance_rad, config.core.goal_tolerance_rad
        )
        self._command_lock = threading.Lock()  # one command at a time; STOP does not wait for it
        self._ring_lock = threading.Lock()  # the core's command rings have one producer
        self._lease_lock = threading.Lock()
        self._stops_asked = 0
        self._dropped_said = 0
        self._next_plan_id = 1
        self._seq_of_plan: dict[int, int] = {0: 0}
        self._rejections: OrderedDict[int, int] = OrderedDict()  # plan id -> code
        self._rejections_lock = threading.Lock()
        self._timing = TickTiming()

    # -- asking -------------------------------------------------------------------------------------

    def status(self) -> ExecutorStatus:
        """The state right now."""
        core = self._core.snapshot()
        holder = self._lease.holder
        return ExecutorStatus(
            core=core,
            plan_seq=self._seq_of_plan.get(core.plan_id, 0),
            lease_holder=holder,
            why_not_moving=why_not_moving(core, self.arm.joint_names, holder),
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
            if self._stops_asked != stops_before:
                raise CommandRefusedError(
                    Refusal.STALE,
                    "a stop was requested while the plan was being checked; send it again if still wanted",
                )
            return self._start(address, request, admitted, core.epoch, wire)

    def _start(
        self, address: Address, request: PlanRequest, admitted: AdmittedPlan, epoch: int, wire: bytes
    ) -> Accepted:
        plan_id = self._next_plan_id
        self._next_plan_id += 1
        self._seq_of_plan[plan_id] = address.seq
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
            )
        if not queued:
            self._recorder.drop_plan(plan_id, "the core's plan queue was full")
            raise CommandRefusedError(
                Refusal.INTERNAL, "the core's plan queue is full; is the core still running?"
            )
        started = self._wait(lambda c: c.plan_id == plan_id or self._rejection(plan_id) is not None)
        code = self._rejection(plan_id)
        if code is not None or not started:
            reason = f"the core did not take the plan within {_ANSWER_WITHIN_S:g} s"
            if code is not None:
                reason = (
                    f"the core refused the plan ({Refusal(code).name}): it stopped or changed state meanwhile"
                )
            self._recorder.drop_plan(plan_id, reason)
            raise CommandRefusedError(Refusal(code) if code else Refusal.INTERNAL, reason)
        logger.info(
            "plan %d '%s' of '%s' runs for %.2f s",
            address.seq,
            request.label,
            address.sender,
            admitted.duration_s,
        )
        return Accepted(epoch, admitted.duration_s)

    def control(self, address: Address, kind: int, value: float) -> Accepted:
        """Carry out a control command and wait until the core has done so.

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
                why = "" if self._speed_cap == 1.0 else "; this machine allows no more, 's2r doctor' says why"
                raise CommandRefusedError(
                    Refusal.VELOCITY,
                    f"speed scale {value:g} is outside (0, {self._speed_cap:g}]{why}",
                    quantity="speed_scale",
                    value=value,
                    limit=self._speed_cap,
                )
            return self._carry_out(kind, core, value)

    def stop(self, cause: Cause) -> Accepted:
        """Stop on the path (category 2) whatever the state; never waits for other commands."""
        self._stops_asked += 1
        before = self._core.snapshot()
        self._send(pb.STOP, before.epoch, 0.0 if cause is Cause.STOP_REQUESTED else float(cause))
        if ExecutorState(before.state) in _POWERED:  # the core answers each of these with a new epoch
            self._wait(lambda c: c.epoch != before.epoch, _STOP_WITHIN_S)
        logger.info("stop: %s, state was %s", cause.name, ExecutorState(before.state).name)
        return Accepted(self._core.snapshot().epoch)

    def _carry_out(self, kind: int, core: CoreSnapshot, value: float) -> Accepted:
        self._send(kind, core.epoch, value)
        config = self.config.core
        if kind == pb.ARM:
            # From DISARMED through ARMING to HOLD or a latched fault.
            self._wait(
                lambda c: (
                    c.epoch != core.epoch and c.state not in (ExecutorState.ARMING, ExecutorState.DISARMED)
                ),
                config.arming_timeout_s + _ANSWER_WITHIN_S,
            )
            self._expect(pb.ARM, ExecutorState.HOLD)
            self._cap_speed()
        elif kind == pb.RESET:
            self._wait(lambda c: c.state == ExecutorState.DISARMED)
            self._expect(pb.RESET, ExecutorState.DISARMED)
        elif kind == pb.DISARM:
            self._wait(lambda c: c.state == ExecutorState.DISARMED)
            self._expect(pb.DISARM, ExecutorState.DISARMED)
        elif kind == pb.PAUSE:
            self._wait(lambda c: c.state != ExecutorState.RUN)
        elif kind == pb.RESUME:
            self._wait(lambda c: c.state != ExecutorState.PAUSED)
        return Accepted(self._core.snapshot().epoch)

    def _cap_speed(self) -> None:
        """Arming starts at full speed in the core; no plan is taken before the cap holds."""
        if self._speed_cap == 1.0:
            return
        self._send(pb.SET_SPEED, self._core.snapshot().epoch, self._speed_cap)
        if not self._wait(lambda c: c.speed_scale <= self._speed_cap):
            self._send(pb.DISARM, self._core.snapshot().epoch)
            raise CommandRefusedError(Refusal.INTERNAL, "the core did not take the speed cap: disarmed again")

    def _expect(self, kind: int, wanted: ExecutorState) -> None:
        state = ExecutorState(self._core.snapshot().state)
        if state != wanted:
            raise CommandRefusedError(
                Refusal.STATE,
                f"{pb.ControlKind.Name(kind)} ended in {state.name} instead of {wanted.name}. "
                + self.status().why_not_moving,
                quantity="state",
                value=state,
                limit=wanted,
            )

    def _check_right(self, address: Address) -> CoreSnapshot:
        """Addressee, lease and epoch; returns the snapshot they were checked against."""
        check_addressee(address, self.identity)
        core = self._core.snapshot()
        if not core.alive:
            raise CommandRefusedError(
                Refusal.STATE, "the real-time core is not running: restart the executor"
            )
        with self._lease_lock:
            holder = self._lease.holder
        if address.sender != holder:
            raise CommandRefusedError(
                Refusal.NO_LEASE,
                f"'{address.sender}' does not hold the lease, {f'{holder!r}' if holder else 'nobody'} does; "
                "take it first",
                quantity="lease",
            )
        check_epoch(address, core.epoch)
        return core

    def _send(self, kind: int, epoch: int, value: float = 0.0) -> None:
        with self._ring_lock:
            queued = self._core.command(kind, epoch, value)
        if not queued:
            raise CommandRefusedError(
                Refusal.INTERNAL, "the core's command queue is full; is the core still running?"
            )

    def _wait(self, condition: Callable[[CoreSnapshot], bool], timeout_s: float = _ANSWER_WITHIN_S) -> bool:
        deadline = time.monotonic() + timeout_s
        while not condition(self._core.snapshot()):
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL_S)
        return True

    def _rejection(self, plan_id: int) -> int | None:
        with self._rejections_lock:
            return self._rejections.get(plan_id)

    # -- the watch loop -----------------------------------------------------------------------------

    def step(self) -> np.ndarray:
        """One round of the watch loop: beat, host watch, records and events. Call every few milliseconds.

        Returns:
            The core's new events.
        """
        self._core.beat()
        with self._lease_lock:
            silence_s = self._lease.silence_s(self._now_s())
            lost = self._lease.expire(self._now_s())
        if lost:
            logger.warning(
                "lease of '%s' ended: no heartbeat for %.0f ms, limit %.0f ms",
                lost,
                silence_s * 1e3,
                self.config.effective_host_timeout_s * 1e3,
            )
            self._stop_if_moving(Cause.HOST_LOST)
        events = self._core.events()
        records = self._core.records()
        if len(records):
            self._timing.add(records)
        self._note_rejections(events)
        dropped = self._core.records_dropped
        if dropped > self._dropped_said:
            if self._dropped_said == 0:
                logger.warning("%d ticks are missing from the recordings: the front end fell behind", dropped)
            self._dropped_said = dropped
        if len(events) or len(records):
            self._recorder.feed(records, events, self._lease.holder)
        return events

    def _stop_if_moving(self, cause: Cause) -> None:
        core = self._core.snapshot()
        if ExecutorState(core.state) in (ExecutorState.RUN, ExecutorState.PAUSED):
            self._stops_asked += 1
            self._send(pb.STOP, core.epoch, float(cause))

    def _note_rejections(self, events: np.ndarray) -> None:
        for event in events:
            if event["kind"] == EventKind.REJECTED and event["plan_id"]:
                with self._rejections_lock:
                    self._rejections[int(event["plan_id"])] = int(event["cause"])
                    if len(self._rejections) > _KEPT_REJECTIONS:
                        self._rejections.popitem(last=False)

    def shut_down(self, timeout_s: float = 5.0) -> bool:
        """Stop on the path, then switch the drives off; True if it came to rest and off in time."""
        core = self._core.snapshot()
        if not core.alive:
            return False
        if ExecutorState(core.state) in _MOVING:
            self.stop(Cause.STOP_REQUESTED)
            self._wait(lambda c: ExecutorState(c.state) not in _MOVING, timeout_s)
        core = self._core.snapshot()
        if ExecutorState(core.state) in (ExecutorState.HOLD, ExecutorState.ARMING):
            self._send(pb.DISARM, core.epoch)
            self._wait(lambda c: c.state == ExecutorState.DISARMED, timeout_s)
        return ExecutorState(self._core.snapshot().state) not in _MOVING | {ExecutorState.HOLD}
