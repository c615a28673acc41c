"""The part's joint value while the arm moves: camera frames, the arm taken out of them, the known surface followed."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from s2r_host.errors import PeerUnreachableError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.robot_mask import robot_mask
from s2r_host.perception.track import JointTracker
from s2r_host.run.belief import Belief
from s2r_host.run.observe import Observation
from s2r_host.run.session import Session
from s2r_host.trajectory.reactive_run import Seen

_POLL_S = 0.005


@dataclass
class LiveCounts:
    """What a feed has seen: frames with the part, frames without it, wall time of them all [s]."""

    seen: int = 0
    lost: int = 0
    frame_s: float = 0.0


class LiveJoint(threading.Thread):
    """Follows the part in a thread of its own until closed. A context manager.

    The tracker's values are shifted so that its look at the view before the motion gives what that view was measured
    to: a difference between two ways of looking is no motion.
    """

    def __init__(self, session: Session, belief: Belief, view: Observation, s_initial: float) -> None:
        """Args: links; the part; the look at it before the motion; the joint value measured there [m or rad]."""
        super().__init__(name="s2r-live-joint", daemon=True)
        self._camera, self._link, self._name = session.camera, session.link, session.settings.camera_name
        self._arm = ArmModel(session.arm.arm)  # its data is not to be shared between threads
        low, high = belief.model.range
        margin = 0.03 / belief.template.reach_m
        self._tracker = JointTracker.of(belief.estimate, (low - margin, high + margin))
        before = self._tracker.update(view.capture.frame, view.arm_mask).value
        self.known = before is not None
        self._shift = s_initial - before if before is not None else 0.0
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._latest: Seen | None = None
        self.counts, self.problem = LiveCounts(), ""

    def latest(self) -> Seen | None:
        """What the newest frame shows; None when that does not show the part, or before the first one."""
        with self._lock:
            return self._latest

    def run(self) -> None:
        """Look until closed; a camera that falls silent ends it, and nothing is seen from then on."""
        try:
            while not self._ended.is_set():
                self._look()
        except PeerUnreachableError as error:
            self.problem = str(error)
            with self._lock:
                self._latest = None

    def close(self) -> None:
        """End the thread; returns once it has ended."""
        self._ended.set()
        self.join()

    def __enter__(self) -> LiveJoint:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _look(self) -> None:
        state, joints = self._link.state(), self._link.joints()
        if state is None or joints is None or state.plan_seq == 0:
            time.sleep(_POLL_S)
            return
        begun_s = time.monotonic()
        frame = self._camera.capture(self._name).frame
        found = self._tracker.update(frame, robot_mask(self._arm, joints.q, frame))
        seen = None
        if found.value is not None and found.interval90 is not None and self.known:
            low, high = found.interval90
            seen = Seen(found.value + self._shift, (high - low) / 2.0, state.plan_seq, state.plan_t)
        with self._lock:
            self._latest = seen
        self.counts.seen += seen is not None
        self.counts.lost += seen is None
        self.counts.frame_s += time.monotonic() - begun_s
