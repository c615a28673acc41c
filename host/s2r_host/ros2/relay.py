"""Carrying out JointTrajectory messages: one at a time, through the executor's own admission, with every outcome said.

The relay is a host like any other: it takes the lease for the time of a motion, and the executor's gate, stops and
watchdogs act on it as on every plan. A ROS 2 node with rmw_zenoh reaches it on the keys rmw_zenoh uses; whatever it
sends comes back in words on the topic ``trajectory_log``.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from typing import TYPE_CHECKING, Any

from s2r_host.errors import CommandRefusedError
from s2r_host.link import ExecutorLink
from s2r_host.ros2.knots import RosTrajectoryError, plan_of
from s2r_protocol.exits import S2RError
from s2r_protocol.ros2 import CdrError, pack, topic_key, unpack
from s2r_protocol.ros2.keys import node_token, publisher_token, subscription_token
from s2r_protocol.ros2.publisher import Publisher

if TYPE_CHECKING:
    import zenoh

    from s2r_protocol.arms import ArmDescription
    from s2r_protocol.keys import ArmKeys

logger = logging.getLogger(__name__)

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
LOG = "rcl_interfaces/msg/Log"
NODE = "s2r_trajectory_input"
_INFO, _WARN, _ERROR = 20, 30, 40


class TrajectoryRelay:
    """Listens on ``/<cell>/<arm>/joint_trajectory`` until closed. An empty trajectory stops the arm on its path."""

    def __init__(
        self,
        session: zenoh.Session,
        link: ExecutorLink,
        arm: ArmDescription,
        keys: ArmKeys,
        domain: int = 0,
        enable_drives: bool = False,
    ) -> None:
        """Declare everything.

        Args:
            session: Where ROS 2 is; stays the caller's.
            link: To the executor; stays the caller's.
            arm: Of the executor.
            keys: Cell and arm.
            domain: ROS_DOMAIN_ID.
            enable_drives: Enable the drives when a trajectory finds them off; otherwise it is refused.
        """
        self._link, self._arm, self._enable_drives = link, arm, enable_drives
        self._waiting: queue.Queue[tuple[int, dict[str, Any]] | None] = queue.Queue()
        self._stops = 0  # what came before one of them is void
        self._busy = threading.Lock()
        namespace = f"/{keys.base}"
        topic_in, topic_log = f"{namespace}/joint_trajectory", f"{namespace}/trajectory_log"
        zid = str(session.info.zid())
        self._tokens = [
            session.liveliness().declare_token(token)
            for token in (
                node_token(zid, NODE, namespace, domain),
                subscription_token(zid, 1, NODE, topic_in, TRAJECTORY, namespace, domain),
                publisher_token(zid, 2, NODE, topic_log, LOG, namespace, domain),
            )
        ]
        self._log = Publisher(session, topic_key(topic_log, LOG, domain))
        self._worker = threading.Thread(target=self._work, name="s2r-ros2", daemon=True)
        self._worker.start()
        self._subscriber = session.declare_subscriber(topic_key(topic_in, TRAJECTORY, domain), self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        """In Zenoh's thread: quick, except for a stop, which must not queue behind a motion."""
        stops = self._stops
        try:
            message = unpack(TRAJECTORY, sample.payload.to_bytes())
            if not message["points"]:
                self._stop()
                self._say(_INFO, "stop accepted: the trajectory has no points")
            elif not self._busy.acquire(blocking=False):
                raise RosTrajectoryError("a trajectory is being carried out; an empty one stops it")
            else:
                self._waiting.put((stops, message))
        except CdrError as error:
            self._say(_WARN, f"refused: not a {TRAJECTORY}: {error}")
        except S2RError as error:
            self._say(_WARN, f"refused: {error}")

    def _stop(self) -> None:
        self._stops += 1  # first: what is not sent yet must find it, what is sent is stopped by the executor
        try:
            self._link.stop()
        except CommandRefusedError:  # by an executor started since; asking first would delay every stop
            self._link.meet()
            self._link.stop()

    def _work(self) -> None:
        while (waiting := self._waiting.get()) is not None:
            try:
                outcome = _INFO, self._carry_out(*waiting)
            except S2RError as error:
                outcome = _WARN, f"not carried out: {error}"
            except Exception as error:
                logger.exception("a trajectory failed")
                outcome = _ERROR, f"not carried out, a bug of the relay: {type(error).__name__}: {error}"
            finally:
                self._busy.release()  # whoever hears the outcome may send the next one
            self._say(*outcome)

    def _carry_out(self, stops: int, message: dict[str, Any]) -> str:
        """Move; ``stops`` is how many there had been when the message came."""
        link = self._link
        link.meet()  # the relay outlives executors
        with link.leased():
            self._refuse_if_stopped(stops)
            if self._enable_drives:
                link.arm_drives()
            plan = plan_of(message, self._arm.joint_names, link.status().q_ref, time.time())
            self._refuse_if_stopped(stops)  # a stop from here on makes the plan stale
            verdict = link.send_plan(plan, f"ROS 2: {message['header']['frame_id'] or 'trajectory'}")
            count = len(message["points"])
            self._say(_INFO, f"accepted: {count} points in {plan.t[-1]:.3f} s, plan {verdict.seq}")
            link.wait_done(verdict)
        return f"done: plan {verdict.seq} ended at rest"

    def _refuse_if_stopped(self, stops: int) -> None:
        """A stop voids what came before it, also where the executor had nothing to stop yet.

        Raises:
            RosTrajectoryError: There was one.
        """
        if self._stops != stops:
            raise RosTrajectoryError("a stop came before it began to move; send it again if still wanted")

    def _say(self, level: int, text: str) -> None:
        logger.log(level, "%s", text)
        stamp_ns = time.time_ns()
        stamp = {"sec": stamp_ns // 1_000_000_000, "nanosec": stamp_ns % 1_000_000_000}
        self._log.put(pack(LOG, {"stamp": stamp, "level": level, "name": NODE, "msg": text}), stamp_ns)

    def close(self) -> None:
        """Stop a motion under way, void one that waits, and leave ROS 2's sight."""
        self._subscriber.undeclare()
        self._stops += 1  # also for one that is just arriving
        if self._busy.locked():
            self._stop()
        self._waiting.put(None)
        self._worker.join()
        for token in self._tokens:
            token.undeclare()
