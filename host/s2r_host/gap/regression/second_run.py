"""Which recording given with ``--repeat`` shows the motion of which one given with ``--fit``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, make_session
from s2r_host.gap.recordings.recording import Recording

MOST_LONGER = 0.1  # of its time that a second run may last longer or shorter
OTHER_RATE = 0.05  # of the step between rows
SAME_STEP_S = 1e-6
SMOOTH = 1e-6  # of the spread of the motion: steps below it are digits of the file
LED = 0.002  # of the spread of the motion that two runs under one controller differ by at most, rms
COPIED = 0.9  # of the rows in which an encoder steps
ONE_SIZE = 0.5  # ratio of two of the smallest gaps between values that lie on steps
STAMP_S = 1e-4  # stamps this close together are of one row
MOST_APART = 0.1  # of the spread of the motion that the positions of two runs may differ by, rms


def find_partner(twin: Session, fit: list[Session]) -> Session | None:
    """The fit session that shows the same motion, or None.

    A run whose encoder repeats to the last step is none: what its steps make of speeds, accelerations and hence of the
    residual comes back in it, and would pass for physics.
    """
    best, apart = _nearest(twin, fit)
    return (
        best if best is not None and apart <= MOST_APART * _spread(best) and not _copied(twin, best) else None
    )


def beside_first(model: RigidModel, twin: Session, fit: list[Session]) -> Session:
    """A second run at the steps of the run it repeats; itself where it has them, or repeats none of ``fit``.

    Stamps that jitter give each recording a step of its own, and two runs are held against each other step by step.
    """
    first = find_partner(twin, fit)
    if first is None or first.dt == twin.dt:
        return twin
    return make_session(model, replace(twin.rec, step_s=first.dt), twin.index)


def led_by_hand(twin: Session, partner: Session | None) -> bool:
    """Do two runs of one motion differ by more than a drive lets them?"""
    return partner is not None and _apart(twin, partner) > LED * _spread(partner)


def no_partner(twin: Session, fit: list[Session]) -> str | None:
    """Why a recording is a second run of none of ``fit``; None where it is one."""
    best, apart = _nearest(twin, fit)
    if best is None:
        lengths = ", ".join(f"{s.rec.name} has {len(s.t)} rows of {s.dt:.4g} s" for s in fit)
        why = f"it has {len(twin.t)} rows of {twin.dt:.4g} s as they are compared, {lengths}"
    elif _copied(twin, best):
        why = (
            f"its positions repeat nearly every encoder step of {best.rec.name}, which no machine does, and the noise "
            "of the effort alone is not that of the comparison"
        )
    elif apart > MOST_APART * _spread(best):
        why = (
            f"its positions differ from those of {best.rec.name} by {apart:.3g} rms, "
            f"{apart / _spread(best):.0%} of that motion; {MOST_APART:.0%} is allowed"
        )
    else:
        return None
    return f"{twin.rec.name} is no second run of any --fit recording and is left out: {why}"


def _nearest(twin: Session, fit: list[Session]) -> tuple[Session | None, float]:
    """The session as long whose positions are nearest, and how far apart they are, rms [rad or m]."""
    apart = [(_apart(twin, s), k) for k, s in enumerate(fit) if _as_long(twin, s)]
    if not apart:
        return None, np.inf
    least, k = min(apart)
    return fit[k], least


def _as_long(twin: Session, s: Session) -> bool:
    alike = abs(s.dt - twin.dt) <= SAME_STEP_S or _as_fast(twin.rec.as_read, s.rec.as_read)
    return alike and abs(len(s.t) - len(twin.t) * (twin.dt / s.dt)) <= MOST_LONGER * len(s.t)


def _as_fast(one: Recording, other: Recording) -> bool:
    """Do rows come as fast, by the middle of their steps, which lost rows leave alone, or the mean, as jitter does?"""
    means = (float(rec.t[-1]) / (len(rec.t) - 1) for rec in (one, other))
    return any(abs(a - b) <= OTHER_RATE * b for a, b in ((one.dt, other.dt), means))


def _apart(twin: Session, s: Session) -> float:
    """Difference of the positions at the steps of one, rms over steps and joints [rad or m]."""
    n = min(len(s.t), len(twin.t))
    q = twin.q[:n]
    if s.dt != twin.dt:
        n = int(np.searchsorted(s.t, twin.t[-1], side="right"))
        q = np.stack([np.interp(s.t[:n], twin.t, x) for x in twin.q.T], axis=1)
    return float(np.sqrt(np.mean((s.q[:n] - q) ** 2)))


def _copied(twin: Session, s: Session) -> bool:
    """Do the encoders of all joints repeat nearly every step? Machines do that of one joint, not of all.

    Positions without steps, as of an equation, leave nothing that comes back.
    """
    one, other = s.rec.as_read, twin.rec.as_read
    _, here, there = np.intersect1d(
        np.round(one.t / STAMP_S), np.round(other.t / STAMP_S), return_indices=True
    )
    if len(here) < 2:
        return False
    for joint, q in one.channels["q"].items():
        again = other.get("q", joint)
        if again is None:
            return False
        pair = np.stack([q[here], again[there]])
        if not _stepped(pair[0], SMOOTH * _spread(s)):
            return False
        steps = np.any(np.diff(pair, axis=1) != 0.0, axis=0)
        if not steps.any() or np.mean((pair[0] == pair[1])[1:][steps]) < COPIED:
            return False
    return True


def _stepped(x: np.ndarray, least: float) -> bool:
    """Do values lie on steps that are larger than ``least``? Between those of a smooth curve are gaps of every size."""
    gaps = np.diff(np.unique(x))
    if len(gaps) == 0:
        return False
    small, next_small = np.percentile(gaps, (1, 5))
    return bool(small > max(least, ONE_SIZE * next_small))


def _spread(s: Session) -> float:
    """Standard deviation of the position of the joint that moves most [rad or m]."""
    return max(float(np.max(np.std(s.q, axis=0))), 1e-9)
