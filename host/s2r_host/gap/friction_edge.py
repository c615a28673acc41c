"""Where dry friction turns round, and how sharply: read from the recordings before anything else is compared.

The sign of a filtered speed is not the direction of friction: noise of the speed blurs the edge of the step.

Friction that comes out of MuJoCo turns round before the joint does: its constraint pulls towards an acceleration of
-B v, so that the step lies where v + a/B changes its sign, 9.5 ms early with the stock ``solreffriction``. Recordings
of machines have no such lead; those made with MuJoCo do, and half a per cent of unexplained effort at every reversal
would be read as a clock that is late.
"""

from __future__ import annotations

import numpy as np

from s2r_host.gap.model import RigidModel
from s2r_host.gap.rows import compare, picks_of
from s2r_host.gap.session import Session

EDGES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)  # times the noise of the speed
SHARPER = 0.98  # of the misfit, from which on another edge is taken
DIFFERS = 0.1  # of a step
LEADS = 0.6  # of the misfit, from which on the friction is a simulator's


def find_edge(sessions: list[Session], model: RigidModel, joint: int) -> None:
    """Choose edge and lead of a joint's dry friction, by how well a friction step fits; set in the sessions.

    A wrong edge would be read as a Stribeck hump. A late drive puts a step early as well, but not the step alone: a
    lead has to be worth it beside the change of the effort, which stands for any delay, where the two steps differ.
    """
    sessions = [s for s in sessions if s.has_u[joint]]
    if not sessions:
        return
    start = [float(s.v_eps[joint]) for s in sessions]
    usual, _ = _best_edge(sessions, joint, start, 0.0)
    lead = model.friction_lead(model.joints[joint])
    rows = [_around_reversals(s, joint, lead) for s in sessions]
    (_, plain), (edge, led) = (_best_edge(sessions, joint, start, x, rows) for x in (0.0, lead))
    if led < LEADS * plain:
        _set(sessions, joint, start, edge, lead)
    else:
        _set(sessions, joint, start, usual, 0.0)


def _best_edge(
    sessions: list[Session], joint: int, start: list[float], lead: float, rows: list[np.ndarray] | None = None
) -> tuple[float, float]:
    """The edge that fits best, and its misfit; ``rows``: only there, and beside a drive with any delay."""
    best, least = 1.0, np.inf
    for edge in EDGES:
        _set(sessions, joint, start, edge, lead)
        misfit = sum(_misfit(s, joint, None if rows is None else rows[i]) for i, s in enumerate(sessions))
        if misfit < SHARPER * least:
            best, least = edge, misfit
    return best, least


def _set(sessions: list[Session], joint: int, start: list[float], edge: float, lead: float) -> None:
    for s, v_eps in zip(sessions, start, strict=True):
        s.v_eps[joint], s.lead[joint] = edge * v_eps, lead


def _around_reversals(s: Session, joint: int, lead: float) -> np.ndarray:
    """Rows at which a step with this lead differs from one without, shape (time,)."""
    early, plain = (np.sign(s.v[:, joint] + x * s.a[:, joint]) for x in (lead, 0.0))
    return np.abs(compare(early - plain, s, joint, True)) > DIFFERS


def _misfit(s: Session, joint: int, rows: np.ndarray | None) -> float:
    """Squared effort that a rigid body with friction leaves over, of all rows or of some."""
    u = compare(s.u[:, joint], s, joint, True)
    r = u - compare(s.load[:, joint], s, joint, False)
    columns = [s.sign(joint), s.v[:, joint], s.a[:, joint], s.load[:, joint], np.ones(len(s.t))]
    columns = [compare(c, s, joint, True) for c in columns]
    if rows is not None:
        columns.append(np.gradient(u, s.dt))
    inner = slice(*picks_of(s, joint)[[0, -1]])  # filters ring at the ends
    X = np.stack(columns, axis=1)[inner]
    left = r[inner] - X @ np.linalg.lstsq(X, r[inner], rcond=None)[0]
    if rows is not None:
        left = left[rows[inner]]
    return float(left @ left)
