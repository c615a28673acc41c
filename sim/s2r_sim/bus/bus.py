"""The bus with its drives: clients' frames in, physics ticks, drives' frames out.

The frame that begins a period (SET, or SYNC) advances time by one tick in both clocks. In lock-step nothing else does.
With the real clock a period without it advances too, half a period late: the drives then extrapolate, and stop
themselves.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from s2r_protocol.can.frames import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_ERR_CRTL,
    CAN_ERR_CRTL_TX_OVERFLOW,
    CAN_ERR_FLAG,
    CLASSIC_BYTES,
    FD_BYTES,
    CanFrame,
)
from s2r_sim.bus.can_hub import CanHub
from s2r_sim.bus.classic_nodes import ClassicNodes
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.hub import Client, Hub
from s2r_sim.bus.wire import Wire
from s2r_sim.plant import Plant

Responder = Callable[[int, bytes], list[bytes]]
"""(identifier, packet) of a client's frame -> frames that a drive answers at once, such as SDOs."""

Tap = Callable[[int, bytes, object], None]
"""(time [ns], packet, sender): None is a drive, anything else a client."""

logger = logging.getLogger(__name__)

RUN_OUT_NS = 2_000_000_000  # simulated time in which drives without a master come to rest
RESYNC_NS = 20_000_000  # a machine that stalled longer does not catch up: time stretches
STALL_S = 0.5  # wall time of one tick in lock-step that is worth a line in the log
_TX_FULL = CanFrame(
    CAN_ERR_CRTL, bytes([0, CAN_ERR_CRTL_TX_OVERFLOW, 0, 0, 0, 0, 0, 0]), is_error=True
).pack()

_PERIOD_OVER = CanFrame(0, b"", is_error=True).pack()


class Bus:
    """Runs the stand-in's time. Single-threaded; only :meth:`stop` may be called from elsewhere."""

    def __init__(self, hub: Hub | CanHub, wire: Wire, nodes: FdNodes | ClassicNodes, plant: Plant) -> None:
        self.hub = hub
        self.wire = wire
        self.nodes = nodes
        self.plant = plant
        self.ticks = 0
        self.ignored = 0  # packets that are no CAN frame
        self.taps: list[Tap] = []  # hear what clients want to send and what drives have sent
        self.responders: list[Responder] = []
        self.announces_periods = False  # lock-step: tell the master when it has all answers it will get
        self._window_ns = plant.t_ns
        self._running = True
        self._stepped = False  # time advances only with what the clients send

    def stop(self) -> None:
        """Leave the loop; may be called from a signal handler or another thread."""
        self._running = False
        self.hub.wake()

    def run_lockstep(self, pace: float) -> None:
        """Advance one tick per SET or SYNC; idle without a master.

        Args:
            pace: At most this many simulated seconds per second; 0 = as fast as possible.
        """
        self._stepped = self.announces_periods = True
        allowed_ns = time.monotonic_ns()
        wall_tick_ns = int(self.nodes.tick_ns / pace) if pace > 0 else 0
        while self._running:
            for client, packet in self.hub.receive(None):
                if packet is None:
                    self._master_left(client)
                elif self._begins_period(packet) and wall_tick_ns:
                    now = time.monotonic_ns()
                    allowed_ns = max(allowed_ns + wall_tick_ns, now - RESYNC_NS)
                    if allowed_ns > now:
                        time.sleep((allowed_ns - now) * 1e-9)
                    self._take_timed(client, packet)
                else:
                    self._take_timed(client, packet)

    def _take_timed(self, client: Client, packet: bytes) -> None:
        """Take a frame, and say so if that kept the master waiting: a core that gives up names only the drives."""
        wall, cpu = time.monotonic(), time.thread_time()
        self.take(client, packet)
        waited_s = time.monotonic() - wall
        if waited_s > STALL_S:
            logger.warning(
                "tick %d took %.2f s, %.3f s of it computing: this machine or its disk stalled",
                self.ticks,
                waited_s,
                time.thread_time() - cpu,
            )

    def run_real(self, pace: float) -> None:
        """Advance with the wall clock, in step with the master's SET or SYNC while there is one."""
        wall_tick_ns = int(self.nodes.tick_ns / pace)
        deadline_ns = time.monotonic_ns() + wall_tick_ns
        while self._running:
            wait_ns = max(deadline_ns - time.monotonic_ns(), 0)
            for client, packet in self.hub.receive(wait_ns * 1e-9):
                if packet is None:
                    self._forget(client)
                    continue
                self.take(client, packet)
                if self._begins_period(packet):
                    deadline_ns = time.monotonic_ns() + wall_tick_ns * 3 // 2
            now = time.monotonic_ns()
            if now >= deadline_ns:
                self.tick()
                deadline_ns = max(deadline_ns + wall_tick_ns, now - RESYNC_NS)

    def take(self, client: Client, packet: bytes) -> None:
        """A client transmits. A frame that begins a period is followed by one tick."""
        if len(packet) not in (FD_BYTES, CLASSIC_BYTES):
            self.ignored += 1
            return
        self.wire.offer(packet, client, self.plant.t_ns, self.ticks)
        for tap in self.taps:
            tap(self.plant.t_ns, packet, client)
        if self._begins_period(packet):
            client.is_master = True
            self.tick()
            if self.announces_periods:
                self.hub.send(client, self._period_over(packet))
        else:
            self._carry(self._window_ns + self.wire.tick_ns)
            while self._time_stands_still and self.wire.waits:
                self.tick()
        self._report_refused()

    @property
    def _time_stands_still(self) -> bool:
        """Lock-step without a master: what others send, such as SDOs, takes its bit time all the same."""
        return self._stepped and not any(client.is_master for client in self.hub.clients)

    def tick(self) -> None:
        """One period: what is on the wire arrives, physics advances, the drives answer."""
        end_ns = self._window_ns + self.wire.tick_ns
        synced = self._carry(end_ns, until_sync=True)
        self.plant.master_tick = self.nodes.master_tick
        self.plant.advance(self.wire.tick_ns)
        self._answer(self.wire.free_ns if synced else self._window_ns, end_ns)
        self.wire.close_tick(end_ns)
        self._window_ns = end_ns
        self.ticks += 1

    def _answer(self, ready_ns: int, end_ns: int) -> None:
        """The drives' answers, and whatever else still fits before ``end_ns``."""
        packets = self.nodes.answers()
        ends = self.wire.pass_all(packets, ready_ns, end_ns) if self.nodes.answers_by_identifier else None
        if ends is None:
            for packet in packets:
                self.wire.offer(packet, None, ready_ns, self.ticks)
            self._carry(end_ns)
            return
        for packet, done_ns in zip(packets, ends, strict=True):
            self.hub.broadcast(packet)
            for tap in self.taps:
                tap(done_ns, packet, None)

    def _carry(self, end_ns: int, until_sync: bool = False) -> bool:
        """Deliver frames that fit before ``end_ns``; True when it ended with the frame that begins a period."""
        while (frame := self.wire.next(end_ns)) is not None:
            self.hub.broadcast(frame.packet, frame.sender)
            if frame.sender is None:
                for tap in self.taps:
                    tap(self.wire.free_ns, frame.packet, None)
            if frame.sender is not None:
                self.nodes.receive(frame.can_id, frame.packet)
                for respond in self.responders:
                    for packet in respond(frame.can_id, frame.packet):
                        self.wire.offer(packet, None, self.wire.free_ns, self.ticks)
            if until_sync and frame.can_id == self.nodes.sync_id:
                return True
        return False

    def _begins_period(self, packet: bytes) -> bool:
        raw = int.from_bytes(packet[:4], "little")
        return raw & (CAN_EFF_FLAG | CAN_ERR_FLAG | CAN_EFF_MASK) == self.nodes.sync_id

    def _period_over(self, packet: bytes) -> bytes:
        """An error frame of no error class, which no controller sends, with the counter of the period's command.

        Without it the master could not tell a lost answer from a stand-in that has no CPU to spare right now.
        """
        counter = self.nodes.counter_of(packet)
        return _PERIOD_OVER[:4] + bytes((len(counter),)) + _PERIOD_OVER[5:8] + counter.ljust(8, b"\0")

    def _report_refused(self) -> None:
        for frame in self.wire.refused:
            if isinstance(frame.sender, Client):
                self.hub.send(frame.sender, _TX_FULL)
        self.wire.refused.clear()

    def _master_left(self, client: Client) -> None:
        """Lock-step time would stand still for ever: let the drives' own watchdogs bring the arm to rest."""
        self._forget(client)
        if not client.is_master:
            return
        if not all(drive.braked for drive in self.plant.drives):
            logger.warning(
                "%r, the bus master, left before all brakes were on: the drives stop by themselves", client
            )
        end_ns = self.plant.t_ns + RUN_OUT_NS
        while not self.plant.at_rest and self.plant.t_ns < end_ns:
            self.tick()

    def _forget(self, client: Client) -> None:
        if client.is_master:
            self.nodes.forget_master()
