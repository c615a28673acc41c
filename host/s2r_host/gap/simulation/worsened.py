"""Does the patched model predict held-out motion worse than the nominal one? Then it is not to be used."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.simulation.forward import Errors

WORSE, FLOORS = 1.5, 3.0  # times the nominal model's error, and the position's noise floor
EFFORT_GAIN = 0.9  # of the effort's error: a patch that explains the effort is worth a little position


def worsened(
    before: Errors, after: Errors, joints: list[int], position_floor: float
) -> tuple[int, float, float] | None:
    """The joint whose held-out position is predicted clearly worse, the worst of several, or None.

    None as well where other joints gain more by it: the mean of the logarithms of all changes counts.

    Returns:
        Joint, and its error by the nominal and by the patched model [rad or m].

    Args:
        before: Errors of the nominal model; closed loop counts where there is one.
        after: Those of the patched one.
        joints: Joints whose error counts.
        position_floor: Noise of the positions [rad or m].
    """
    rows = np.array(joints)
    closed = bool(np.isfinite(before.held[rows]).all())
    was, now = ((e.held if closed else e.open_held)[rows] for e in (before, after))
    if not closed and not np.isfinite(was).all():
        return None
    helps = closed & (after.u_held[rows] < EFFORT_GAIN * before.u_held[rows])
    lost = ~np.isfinite(now) | ((now > WORSE * was) & (now > FLOORS * position_floor) & ~helps)
    if not lost.any():
        return None
    bounds = [np.maximum(e, position_floor) for e in (was, now)]
    if np.isfinite(now).all() and np.mean(np.log(bounds[1]) - np.log(bounds[0])) < 0.0:
        return None
    ratio = np.where(np.isfinite(now), now / np.maximum(was, 1e-15), np.inf)
    worst = int(np.argmax(np.where(lost, ratio, -1.0)))
    return int(rows[worst]), float(was[worst]), float(now[worst])
