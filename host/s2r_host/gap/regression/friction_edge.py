"""Where dry friction turns round, and how sharply: read from the recordings before anything else is compared.

The sign of a filtered speed is not the direction of friction: noise of the speed blurs the edge of the step.

Friction that comes out of MuJoCo turns round before the joint does: its constraint pulls towards an acceleration of
-B v, so that the step lies where v + a/B changes its sign, 9.5 ms early with the stock ``solreffriction``. Recordings
of machines have no such lead; those made with MuJoCo do, and half a per cent of unexplained effort at every reversal
would be read as a clock that is late. Its constraint is soft as well: a heavy joint with much friction glides through
the step over a speed that the model tells, which no noise of the speed does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.gap.motion.command_steps import step_doubt
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.rest import rests_of
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.friction_seen import dry_level
from s2r_host.gap.regression.rows import compare, picks_of

EDGES = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)  # times the noise of the speed
SHARPER = 0.98  # of the misfit, from which on another edge is taken
DIFFERS = 0.1  # of a step
LEADS = 0.6  # of the misfit, from which on the friction is a simulator's; MuJoCo's has 0.02 to 0.15, others 1 and more
LEAST_ROWS = 20  # at which the two steps differ
SOFTENS = 0.72  # a hyperbolic tangent of this width misses as much of a step as a ramp that ends at 1


def find_edges(sessions: list[Session], model: RigidModel) -> None:
    """Choose edge and lead of every joint's dry friction, by how well a friction step fits; set in the sessions.

    A wrong edge would be read as a Stribeck hump. A late drive puts a step early as well, but not the step alone: a
    lead has to be worth it beside the change of the effort, which stands for any delay, where the two steps differ.
    A joint that hardly turns round has the lead that most others have: one simulator made them all.
    """
    told, open_ones = [], []
    for joint, name in enumerate(model.joints):
        lead, slip = model.friction_lead(name), model.friction_slip(name)
        steps = [_step(s, joint, name, lead, slip) for s in sessions if s.has_u[joint]]
        if not steps:
            continue
        (usual, _), (edge, led) = _best_edge(steps, 0.0, around=False), _best_edge(steps, lead, around=True)
        _, plain = _best_edge(steps, 0.0, around=True)
        if sum(int(np.sum(x.around[x.inner])) for x in steps) < LEAST_ROWS:
            open_ones.append((steps, usual, lead))
            continue
        leads = led < LEADS * plain
        told.append(leads)
        for x in steps:
            x.place(*((edge, lead) if leads else (usual, 0.0)))
    simulated = 2 * sum(told) > len(told)
    for steps, usual, lead in open_ones:
        for x in steps:
            x.place(usual, lead if simulated else 0.0)


@dataclass(frozen=True)
class _Step:
    """A recording that a friction step of any edge and lead is fitted to.

    Attributes:
        s, joint: The recording and the joint.
        left: Effort that the rigid body leaves over, shape (time,).
        others: What stands beside the step, shape (time, 4), and ``late``, what any delay of the drive would make.
        soft: Width of a step that leads [rad/s or m/s]: how slowly a simulator's friction turns round.
        around: Rows in motion at which a step with the lead differs from one without, shape (time,).
        inner: Numbers of the rows between the ends, where filters ring, and apart from steps of the command.
    """

    s: Session
    joint: int
    left: np.ndarray
    others: np.ndarray
    late: np.ndarray
    soft: float
    around: np.ndarray
    inner: np.ndarray

    def place(self, edge: float, lead: float) -> None:
        """Set edge and lead in the recording."""
        blurred = edge * self.s.v_noise[self.joint]
        self.s.v_eps[self.joint] = float(np.hypot(blurred, self.soft)) if lead > 0.0 else blurred
        self.s.lead[self.joint] = lead

    def misfit(self, *, around: bool) -> float:
        """Squared effort left over with the step as placed; ``around``: of some rows, beside a drive with any delay."""
        step = compare(self.s.sign(self.joint), self.s, self.joint, True)
        X = np.column_stack([step, self.others, self.late] if around else [step, self.others])[self.inner]
        y = self.left[self.inner]
        left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
        if around:
            left = left[self.around[self.inner]]
        return float(left @ left)


def _step(s: Session, joint: int, name: str, lead: float, slip: float) -> _Step:
    u = compare(s.u[:, joint], s, joint, True)
    v, a, load = s.v[:, joint], s.a[:, joint], s.load[:, joint]
    others = [compare(c, s, joint, True) for c in (v, a, load, np.ones(len(s.t)))]
    # At rest both signs are noise, and friction holds anything up to its level.
    differs = compare(np.where(rests_of(s, joint), 0.0, np.sign(v + lead * a) - np.sign(v)), s, joint, True)
    first, last = picks_of(s, joint)[[0, -1]]
    inner = np.arange(first, last)[step_doubt(s, joint, name)[first:last] == 0.0]
    return _Step(
        s, joint, u - compare(load, s, joint, False), np.stack(others, axis=1),
        np.gradient(u, s.dt), SOFTENS * slip * dry_level(s, joint), np.abs(differs) > DIFFERS, inner,
    )  # fmt: skip


def _best_edge(steps: list[_Step], lead: float, *, around: bool) -> tuple[float, float]:
    """The edge that fits best with this lead, and its misfit."""
    best, least = 1.0, np.inf
    for edge in EDGES:
        for x in steps:
            x.place(edge, lead)
        misfit = sum(x.misfit(around=around) for x in steps)
        if misfit < SHARPER * least:
            best, least = edge, misfit
    return best, least
