"""Going back after a contact that did not give way: acknowledge the stop, then out the way the arm came in."""

from __future__ import annotations

import numpy as np

from s2r_host.errors import ArmStoppedError
from s2r_host.run.session import Motion, Session
from s2r_host.run.travel import timed
from s2r_protocol.faults import Cause

ON_THE_WAY_RAD = 0.05  # largest joint's distance from the way in
STEP_RAD = 0.01  # chords of 0.03 cut corners of the way in by 5 mm
MOST_TRIES, LEAST_TRIES = 8, 3  # each frees a little of what is squeezed; so many may gain nothing
GAIN_RAD = 1e-3


def back_off(session: Session, error: ArmStoppedError, way_in: np.ndarray, label: str) -> None:
    """Bring the arm back to the beginning of the way on which the executor stopped it for a collision.

    Only contact is acknowledged like this, only where contact was meant, and only where the operator said so
    beforehand: an arm that stands elsewhere than on its way, or was stopped for another cause, waits for them.

    Args:
        session: Links.
        error: The stop.
        way_in: Joint path that was being followed, shape (n, dof).
        label: Of the motion back.

    Raises:
        ArmStoppedError: Not asked to, not a collision, not on the way, or stopped again and again.
    """
    if not session.settings.acknowledge_contact:
        raise error
    left, in_vain = np.inf, 0
    for _ in range(MOST_TRIES):
        session.link.wait_at_rest()
        off = np.abs(way_in - session.status().q_ref).max(axis=1)
        in_vain, left = (0 if off[0] < left - GAIN_RAD else in_vain + 1), min(left, float(off[0]))
        if in_vain == LEAST_TRIES:
            break
        if error.cause != Cause.COLLISION or off.min() > ON_THE_WAY_RAD:
            raise error
        session.journal.warn(f"contact that does not give way, backing off: {error}")
        with session.link.leased():
            session.link.reset()
            session.link.arm_drives()  # takes up the reference anew where the arm is: it may have sagged meanwhile
        q_now = session.status().q_ref
        back = _thinned(np.vstack([q_now, way_in[: int(off.argmin())][::-1], way_in[:1]]))
        if len(back) < 2:
            return
        try:
            # Beside the way in there may be no room at all.
            session.move([timed(session, back, label, session.settings.push_speed, clearance_m=0.0)])
        except ArmStoppedError as again:
            error = again  # jammed: each time the drives are armed anew, what is squeezed relaxes a little
        else:
            return
    raise error


def stopped_in(session: Session, motion: Motion) -> bool:
    """Whether a stop that :meth:`Session.move` has just told of came while this motion played, or right behind it.

    Where the arm stands does not tell: the way out of contact begins at the end of the way in, and the way to a push
    ends at its beginning.
    """
    return bool(session.executed) and session.executed[-1].trajectory is motion.trajectory


def _thinned(q: np.ndarray) -> np.ndarray:
    """A path without points closer than a step to the one before, its ends kept."""
    kept = [q[0]]
    for row in q[1:-1]:
        if np.abs(row - kept[-1]).max() > STEP_RAD and np.abs(row - q[-1]).max() > STEP_RAD:
            kept.append(row)
    if np.abs(q[-1] - kept[-1]).max() > 1e-3:
        kept.append(q[-1])
    return np.array(kept)
