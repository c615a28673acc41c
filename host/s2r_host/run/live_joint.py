"""The part's joint value while the arm moves: camera frames, the arm taken out of them, the known surface followed."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.robot_mask import robot_mask
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.track import JointTracker
from s2r_host.run.belief import Belief
from s2r_host.run.observe import Observation
from s2r_host.run.session import Session
from s2r_host.trajectory.reactive_run import Seen
from s2r_protocol.exits import S2RError

logger = logging.getLogger(__name__)

_POLL_S = 0.005
_SAME_TIME_S = (
    0.05  # of a plan: a frame taken at an unknown moment within so much of it tells its time well enough
)


@dataclass(frozen=True, eq=False)
class PlanMoment:
    """Where a plan and the arm's measured joints, (dof,) [rad], were at a moment of this machine's monotonic clock."""

    stamp_ns: int
    seq: int
    t: float
    done: bool
    q: np.ndarray


def moment_of_frame(stamp_ns: int, moments: Sequence[PlanMoment]) -> PlanMoment | None:
    """Where the plan was when a frame was taken; None when that cannot be told.

    Args:
        stamp_ns: The camera's own stamp; it counts only where it lies between the question and the answer, that is,
            where the camera has this machine's clock.
        moments: From the question for the frame to the answer, in order, at least one.
    """
    first, last = moments[0], moments[-1]
    if first.seq != last.seq:
        return None  # what it shows may be of either plan
    if first.stamp_ns <= stamp_ns <= last.stamp_ns:
        return next(moment for moment in reversed(moments) if moment.stamp_ns <= stamp_ns)
    if first.done or last.t - first.t < _SAME_TIME_S:
        return last
    return None


@dataclass
class LiveCounts:
    """What a feed has seen: frames with the part, without it, of an unknown moment, wall time of them all [s]."""

    seen: int = 0
    lost: int = 0
    undated: int = 0
    frame_s: float = 0.0


class LiveJoint(threading.Thread):
    """Follows the part in a thread of its own until closed. A context manager.

    The tracker's values are shifted so that its look at the view before the motion gives what that view was measured
    to: a difference between two ways of looking is no motion. A part that is too small to be followed, or is not found
    in that view, is never seen: the thread does not begin.

    Attributes:
        known: The part is found in the view before the motion.
        counts: What was seen.
        problem: Why nothing is seen any more, or ever, where that is known; else empty.
    """

    def __init__(self, session: Session, belief: Belief, view: Observation, s_initial: float) -> None:
        """Args: links; the part; the look at it before the motion; the joint value measured there [m or rad]."""
        super().__init__(name="s2r-live-joint", daemon=True)
        self._camera, self._link, self._name = session.camera, session.link, session.settings.camera_name
        self._arm = ArmModel(session.arm.arm)  # its data is not to be shared between threads
        low, high = belief.model.range
        margin = 0.03 / belief.template.reach_m
        self.counts, self.problem = LiveCounts(), ""
        before: float | None = None
        try:
            self._tracker = JointTracker.of(belief.estimate, (low - margin, high + margin))
            before = self._tracker.update(view.capture.frame, view.arm_mask).value
        except BadViewError as error:
            self.problem = str(error)
        self.known = before is not None
        self._shift = s_initial - before if before is not None else 0.0
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._latest: Seen | None = None

    def latest(self) -> Seen | None:
        """What the newest frame shows; None when that does not show the part, or before the first one."""
        with self._lock:
            return self._latest

    def run(self) -> None:
        """Look until closed; a camera that falls silent or sends what is no frame ends it, which `problem` tells, and
        nothing is seen from then on."""
        try:
            with ThreadPoolExecutor(1, "s2r-live-frame") as taking:
                while not self._ended.is_set():
                    self._look(taking)
        except Exception as error:  # the arm goes on, and what was seen last must not stay in force
            said = str(error) if isinstance(error, S2RError) else f"{type(error).__name__}: {error}"
            logger.info("the part is no longer followed", exc_info=True)
            self.problem = said
            with self._lock:
                self._latest = None

    def close(self) -> None:
        """End the thread; returns once it has ended."""
        self._ended.set()
        if self.is_alive():
            self.join()

    def __enter__(self) -> LiveJoint:
        if self.known:
            self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _look(self, taking: ThreadPoolExecutor) -> None:
        moments = self._moments([])
        if not moments:
            time.sleep(_POLL_S)
            return
        asked = taking.submit(self._camera.capture, self._name)
        while not asked.done():
            time.sleep(_POLL_S)
            moments = self._moments(moments)
        capture, moments = asked.result(), self._moments(moments)
        moment = moment_of_frame(capture.stamp_ns, moments)
        self.counts.frame_s += (moments[-1].stamp_ns - moments[0].stamp_ns) * 1e-9
        if moment is None:
            self.counts.undated += 1
            return
        found = self._tracker.update(capture.frame, robot_mask(self._arm, moment.q, capture.frame))
        seen = None
        if found.value is not None and found.interval90 is not None:
            low, high = found.interval90
            seen = Seen(found.value + self._shift, (high - low) / 2.0, moment.seq, moment.t)
        with self._lock:
            self._latest = seen
        self.counts.seen += seen is not None
        self.counts.lost += seen is None

    def _moments(self, moments: list[PlanMoment]) -> list[PlanMoment]:
        """With the present one."""
        state, joints = self._link.state(), self._link.joints()
        if state is None or joints is None or state.plan_seq == 0:
            return moments
        now_ns = time.monotonic_ns()
        return [*moments, PlanMoment(now_ns, state.plan_seq, state.plan_t, state.plan_done, joints.q)]
