"""Which recording given with ``--repeat`` shows the motion of which one given with ``--fit``."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.motion.session import Session

MOST_LONGER = 0.1  # of its rows that a second run may have more or less
MOST_APART = 0.1  # of the spread of the motion that the positions of two runs may differ by, rms


def find_partner(twin: Session, fit: list[Session]) -> Session | None:
    """The fit session that shows the same motion, or None."""
    alike = [s for s in fit if _as_long(twin, s)]
    if not alike:
        return None
    best = min(alike, key=lambda s: _apart(twin, s))
    return None if _apart(twin, best) > MOST_APART * _spread(best) else best


def no_partner(twin: Session, fit: list[Session]) -> str | None:
    """Why a recording is a second run of none of ``fit``; None where it is one."""
    if find_partner(twin, fit) is not None:
        return None
    alike = [s for s in fit if _as_long(twin, s)]
    if alike:
        best = min(alike, key=lambda s: _apart(twin, s))
        why = (
            f"its positions differ from those of {best.rec.name} by {_apart(twin, best):.3g} rms, "
            f"{_apart(twin, best) / _spread(best):.0%} of that motion; {MOST_APART:.0%} is allowed"
        )
    else:
        lengths = ", ".join(f"{s.rec.name} has {len(s.t)} rows of {s.dt:.4g} s" for s in fit)
        why = f"it has {len(twin.t)} rows of {twin.dt:.4g} s as they are compared, {lengths}"
    return f"{twin.rec.name} is no second run of any --fit recording and is left out: {why}"


def _as_long(twin: Session, s: Session) -> bool:
    return abs(s.dt - twin.dt) <= 1e-6 and abs(len(s.t) - len(twin.t)) <= MOST_LONGER * len(s.t)


def _apart(twin: Session, s: Session) -> float:
    """Difference of the positions row by row, rms over rows and joints [rad or m]."""
    n = min(len(s.t), len(twin.t))
    return float(np.sqrt(np.mean((s.q[:n] - twin.q[:n]) ** 2)))


def _spread(s: Session) -> float:
    """Standard deviation of the position of the joint that moves most [rad or m]."""
    return max(float(np.max(np.std(s.q, axis=0))), 1e-9)
