"""A dry run: looks and plans from where the arm stands, and moves nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from s2r_host.errors import HostError, NoMotionError
from s2r_host.motion.collision import Clearance, CollisionChecker
from s2r_host.motion.obstacles import Obstacle
from s2r_host.run.session import Session
from s2r_host.run.travel import at_home
from s2r_protocol.exits import RefusedError


class DryRunError(HostError, RefusedError):
    """Nothing can be planned from where the arm stands, and a dry run does not move it elsewhere."""


def off_home(session: Session) -> str:
    """Which joint stands farthest from home, as a clause; the arm is not there."""
    arm, q = session.arm.arm, session.status().q_ref
    worst = int(np.argmax(np.abs(q - arm.q_home)))
    return (
        f"joint '{arm.joint_names[worst]}' (index {worst}) is at {q[worst]:.3f} rad, "
        f"home is {arm.q_home[worst]:.3f} rad"
    )


def stay(session: Session, obstacles: Sequence[Obstacle]) -> str:
    """Go on from where the arm stands, as a clause for the journal.

    Raises:
        NoMotionError: It stands in touch with something: no motion begins there.
    """
    touched = CollisionChecker(session.arm, obstacles, Clearance()).touching(session.status().q_ref)
    if touched is not None:
        raise NoMotionError(f"the arm begins in touch ({touched})")
    return f"not there and not sent there: {off_home(session)}"


@contextmanager
def planned_where_it_stands(session: Session) -> Iterator[None]:
    """Inside, a refusal in a dry run says where the arm stands, unless that is home.

    Raises:
        DryRunError: Instead of what was refused.
    """
    try:
        yield
    except RefusedError as error:
        if not session.settings.dry_run or at_home(session):
            raise
        raise DryRunError(
            f"{error}. A dry run looks and plans from where the arm stands, and it is off home: {off_home(session)}; "
            "bring it home first, as a run without --dry-run does"
        ) from error
