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
GIVE_WAY_RAD = 0.03  # a centimetre or so at the fingertip


def back_off(session: Session, error: ArmStoppedError, way_in: np.ndarray, label: str) -> None:
    """Bring the arm back to the beginning of the way on which the executor stopped it for a collision.

    Only contact is acknowledged like this, only where contact was meant, and only where the operator said so
    beforehand: an arm that stands elsewhere than on its way, or was stopped for another cause, waits for them.

    A part that gives way may pull the fingertip along and hold it from behind. Where no try to go back gains
    anything, the arm goes a little further in, once, the way the contact pulls it, and tries again from there.

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
    stop = _go_back(session, error, way_in, label)
    if stop is None:
        return
    session.link.wait_at_rest()
    further = _further_in(session, way_in)
    if further is not None:
        _take_up(session, stop, way_in, "giving way")
        stop = _play(session, further, f"{label}, giving way first") or _play(
            session, _back(session, way_in), label
        )
        stop = stop and _go_back(session, stop, way_in, label)
    if stop is not None:
        raise stop


def _go_back(
    session: Session, stop: ArmStoppedError, way_in: np.ndarray, label: str
) -> ArmStoppedError | None:
    """Try until the arm is where it began; the newest stop if it does not get there."""
    left, in_vain = np.inf, 0
    for _ in range(MOST_TRIES):
        session.link.wait_at_rest()
        off = float(_off(session, way_in)[0])
        in_vain, left = (0 if off < left - GAIN_RAD else in_vain + 1), min(left, off)
        if in_vain == LEAST_TRIES:
            return stop
        _take_up(session, stop, way_in, "backing off")
        # Jammed: each time the drives are armed anew, what is squeezed relaxes a little.
        again = _play(session, _back(session, way_in), label)
        if again is None:
            return None
        stop = again
    return stop


def _take_up(session: Session, stop: ArmStoppedError, way_in: np.ndarray, what: str) -> None:
    """Acknowledge a stop for contact on the way, and take up the reference where the arm is.

    Raises:
        ArmStoppedError: This is no such stop.
    """
    if stop.cause != Cause.COLLISION or _off(session, way_in).min() > ON_THE_WAY_RAD:
        raise stop
    session.journal.warn(f"contact that does not give way, {what}: {stop}")
    with session.link.leased():
        session.link.reset()
        session.link.arm_drives()  # the arm may have sagged meanwhile


def _play(session: Session, q_path: np.ndarray, label: str) -> ArmStoppedError | None:
    """Follow a joint path; the stop that ends it, if one does."""
    if len(q_path) < 2:
        return None
    try:
        # Beside the way in there may be no room at all.
        session.move([timed(session, q_path, label, session.settings.push_speed, clearance_m=0.0)])
    except ArmStoppedError as stop:
        return stop
    return None


def _off(session: Session, way_in: np.ndarray) -> np.ndarray:
    """Largest joint's distance of the arm from each point of the way in [rad], (n,)."""
    return np.abs(way_in - session.status().q_ref).max(axis=1)


def _back(session: Session, way_in: np.ndarray) -> np.ndarray:
    """From where the arm is to the beginning of the way in."""
    here = int(_off(session, way_in).argmin())
    return _thinned(np.vstack([session.status().q_ref, way_in[:here][::-1], way_in[:1]]))


def _further_in(session: Session, way_in: np.ndarray) -> np.ndarray | None:
    """From where the arm is a little further along the way in; None where it ends."""
    off = _off(session, way_in)
    here = int(off.argmin())
    ahead = np.flatnonzero(off[here:] > GIVE_WAY_RAD)
    there = here + int(ahead[0]) if len(ahead) else len(way_in) - 1
    path = _thinned(np.vstack([session.status().q_ref, way_in[here + 1 : there + 1]]))
    return path if len(path) > 1 else None


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
