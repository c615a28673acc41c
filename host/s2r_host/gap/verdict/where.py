"""Where the residual lives: joint, time, position, speed, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from s2r_host.gap.motion.kinematics import Contradiction, load_keeps_sign, transmitted
from s2r_host.gap.motion.session import Session
from s2r_host.gap.motion.time_spans import time_spans
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.search.break_away import BreakAway
from s2r_host.gap.search.bursts import Bursts
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decision import Decision, Lasting
from s2r_host.gap.verdict.naming import Named

ACTING, MERGE_S = 0.2, 0.06
# Seen from position and speed; play that holds friction is not.
TRANSMISSIONS = ("joint_elasticity", "backlash")


@dataclass(frozen=True)
class Place:
    """One joint's share of the gap and the regime in which it lives."""

    joint: str
    share: float
    t: list[list[float]]
    q: list[float]
    dq: list[float]
    words: str

    def as_json(self) -> dict:
        """The contract's form."""
        regime = {"t": self.t, "q": self.q, "dq": self.dq, "words": self.words}
        return {"joint": self.joint, "share": round(self.share, 4), "regime": regime}


def locate(problem: Problem, rows: np.ndarray) -> list[Place]:
    """Places of a residual, largest share first.

    Args:
        problem: Gives blocks and noise floor.
        rows: Residual in effort units, shape (rows,), in the stacking order of the problem.
    """
    excess: dict[int, float] = {}
    for block in problem.blocks:
        r = rows[block.rows]
        floor = problem.floor[block.joint]
        # Joints of an arm differ in effort a hundredfold; what a gap is worth is measured in their noise.
        scale = floor if len(problem.joints) > 1 else float(np.std(block.session.u[:, block.joint]))
        scale = max(scale, 1e-12)
        gain = max(0.0, float(np.mean(r**2)) - floor**2) / scale**2
        excess[block.joint] = excess.get(block.joint, 0.0) + gain * len(r)
    total = sum(excess.values())
    if total <= 0:
        return []
    places = [_place(problem, rows, j, excess[j] / total) for j in excess if excess[j] > 0.02 * total]
    return sorted(places, key=lambda p: -p.share)


def with_named(problem: Problem, rows: np.ndarray, places: list[Place], decision: Decision) -> list[Place]:
    """The places, joints of named effects first; those missing among them have no share to speak of.

    What sits on one joint shows on all that carry it, and small errors of the model take a part of it away.
    """
    known = {p.joint for p in places}
    more = [e.joint for e in decision.effects if e.joint and e.joint not in known]
    index = problem.ctx.model.index
    own = [e.joint for e in decision.effects if e.term.joint >= 0]
    places = sorted(places, key=lambda p: own.index(p.joint) if p.joint in own else len(own))
    return places + [
        _place(problem, rows, index(j), 0.0) for j in dict.fromkeys(more) if index(j) in problem.joints
    ]


def contradicted(problem: Problem, found: Contradiction | Bursts | BreakAway | Lasting) -> Place:
    """What is known by its times alone: two sensors that contradict each other, a push; the ranges are the motion's."""
    s, j = problem.ctx.sessions[0], found.joint
    box = [[round(float(x.min()), 5), round(float(x.max()), 5)] for x in (s.q[:, j], s.v[:, j])]
    return Place(problem.ctx.model.joints[j], 1.0, found.intervals, box[0], box[1], found.words)


def somewhere(problem: Problem, rows: np.ndarray, places: list[Place]) -> list[Place]:
    """Places of what is unknown, each with times: all of the motion where none stand out.

    Where no joint stands above a floor that holds the force itself, it is the one that comes highest.
    """

    def floors(j: int) -> float:
        power = [float(np.mean(rows[b.rows] ** 2)) for b in problem.blocks if b.joint == j]
        return max(power, default=0.0) / max(problem.floor[j] ** 2, 1e-30)

    def throughout(j: int) -> Place:
        found = Lasting.along(problem.ctx.sessions[0], j, "throughout the motion")
        return contradicted(problem, found)

    if not places:
        return [throughout(max(problem.joints, key=floors))]
    index = problem.ctx.model.index
    return [p if p.t else replace(p, t=throughout(index(p.joint)).t) for p in places]


def _place(problem: Problem, rows: np.ndarray, j: int, share: float) -> Place:
    blocks = [b for b in problem.blocks if b.joint == j and not np.all(b.held)]
    block = max(blocks, key=lambda b: float(np.mean(rows[b.rows] ** 2)))
    s, r = block.session, rows[block.rows]
    t, q, v = s.t[block.picks], s.q[block.picks, j], s.v[block.picks, j]
    weight = np.maximum(r**2 - problem.floor[j] ** 2, 0.0)
    if weight.sum() <= 0:
        weight = r**2 + 1e-30
    return Place(
        problem.ctx.model.joints[j], share, intervals(t + s.rec.start_s, r, problem.floor[j]),
        weighted_range(q, weight),
        weighted_range(v, weight), words(s, j, q, v, weight, t),
    )  # fmt: skip


def intervals(t: np.ndarray, r: np.ndarray, floor: float) -> list[list[float]]:
    """Time intervals in which the residual stands above three floors, gaps under 0.15 s closed."""
    above = np.abs(r) > max(3.0 * floor, 0.35 * float(np.sqrt(np.mean(r**2))))
    step = float(t[1] - t[0]) if len(t) > 1 else 0.0
    return [[round(a, 3), round(b + step, 3)] for a, b in time_spans(t[above])][:200]


def acting(search: Search, decision: Decision, joint: int) -> tuple[Session, np.ndarray] | None:
    """Effort of the first effect named on a joint, along the recording in which it is strongest, shape (time,).

    None when nothing named acts there.
    """
    ctx = search.problem.ctx
    best: tuple[Session, np.ndarray] | None = None
    for named in decision.effects:
        if named.term.joint not in (-1, joint) or named.term.effect not in search.effects or best is not None:
            continue
        if named.name == "session_friction":
            best = _drifting(search.problem, joint)
            continue
        if named.name in TRANSMISSIONS and "loose" not in dict(named.term.shape):
            best = _between(search.problem, named.name, joint)
            continue
        for s in ctx.sessions:
            seen = _in_position(search, named, s, joint)
            if seen is not None:
                best = best or (s, seen)
                continue
            columns = search.effects[named.term.effect].columns(
                ctx, s, named.term.joint, dict(named.term.shape)
            )
            parts = [c * x for c, x in zip(columns.linear, named.theta, strict=True)]
            parts += [columns.fixed] if columns.fixed is not None else []
            effort = np.abs(sum((x[:, joint] if x.ndim == 2 else x for x in parts), np.zeros(len(s.t))))
            if np.any(effort > 0) and (best is None or np.mean(effort**2) > np.mean(best[1] ** 2)):
                best = (s, effort)
    return best


def _in_position(search: Search, named: Named, s: Session, joint: int) -> np.ndarray | None:
    """How far off an effect of the sensor puts the recorded position, shape (time,); None for all others."""
    effect = search.effects[named.term.effect]
    if named.name == "clock_skew":
        return np.abs(s.v[:, joint])
    if effect.side != "sensor":
        return None
    sense = effect.sense(search.problem.ctx, joint, dict(named.term.shape), named.theta)
    if sense is None:
        return None
    return np.abs(np.array([sense(float(q)) - float(q) for q in s.q[:, joint]]))


def _between(problem: Problem, name: str, joint: int) -> tuple[Session, np.ndarray]:
    """A spring winds up with the effort behind it, play is crossed where that changes its sign."""
    s = problem.ctx.sessions[0]
    link = transmitted(problem.ctx.model, s, joint)
    return s, np.abs(link) if name == "joint_elasticity" else (~load_keeps_sign(link, s.dt)).astype(float)


def _drifting(problem: Problem, joint: int) -> tuple[Session, np.ndarray] | None:
    for drift in problem.drift:
        s = drift.blocks[0].session
        if drift.blocks[0].joint == joint:
            return s, np.abs(s.sign(joint))
    return None


def narrowed(place: Place, s: Session, joint: int, effort: np.ndarray) -> Place:
    """A place with the regime in which an effect acts: its effort above a fifth of its peak."""
    active = effort > ACTING * max(float(np.percentile(effort, 98)), 1e-12)
    found = _runs(s.t, active)
    if not found:
        return place
    q, v = s.q[active, joint], s.v[active, joint]
    box = [[round(float(np.percentile(x, 1)), 5), round(float(np.percentile(x, 99)), 5)] for x in (q, v)]
    offset = s.rec.start_s
    return replace(
        place, t=[[round(a + offset, 3), round(b + offset, 3)] for a, b in found], q=box[0], dq=box[1]
    )


def _runs(t: np.ndarray, active: np.ndarray) -> list[tuple[float, float]]:
    """Intervals in which a mask holds, gaps under 60 ms closed and blips under 10 ms dropped."""
    return [(a, b) for a, b in time_spans(t[active], MERGE_S) if b - a >= MERGE_S / 6][:200]


def weighted_range(x: np.ndarray, weight: np.ndarray) -> list[float]:
    """5 and 95 % of the residual energy over a coordinate."""
    order = np.argsort(x)
    mass = np.cumsum(weight[order])
    mass = mass / mass[-1]
    low, high = (float(x[order][np.searchsorted(mass, p).clip(0, len(x) - 1)]) for p in (0.05, 0.95))
    return [round(low, 5), round(high, 5)]


def words(s: Session, j: int, q: np.ndarray, v: np.ndarray, weight: np.ndarray, t: np.ndarray) -> str:
    """The regime in one phrase: the split of the motion that concentrates the energy most."""
    top = float(np.percentile(np.abs(v), 99)) + 1e-12
    travel = float(q.max() - q.min()) + 1e-12
    u = np.abs(np.interp(t, s.t, s.u[:, j])) if s.has_u[j] else np.zeros(len(t))
    masks = {
        "at every reversal and at rest": np.abs(v) < 0.08 * top,
        "at high speed": np.abs(v) > 0.6 * top,
        "moving in the positive direction": v > 0.02 * top,
        "moving in the negative direction": v < -0.02 * top,
        "near the upper end of the travel": q > q.min() + 0.75 * travel,
        "near the lower end of the travel": q < q.min() + 0.25 * travel,
        "at high effort": u > 0.7 * (float(u.max()) + 1e-12),
        "late in the recording": t > t[0] + 0.6 * (t[-1] - t[0]),
        "early in the recording": t < t[0] + 0.4 * (t[-1] - t[0]),
    }
    best, lift = "throughout the motion", 1.8
    for phrase, mask in masks.items():
        share = float(np.mean(mask))
        if 0.005 < share < 0.9:
            value = float(weight[mask].sum() / weight.sum()) / share
            captured = float(weight[mask].sum() / weight.sum())
            if captured > 0.6 and value > lift:
                best, lift = phrase, value
    narrow = weighted_range(q, weight)
    if best == "throughout the motion" and narrow[1] - narrow[0] < 0.35 * travel:
        best = f"around position {0.5 * (narrow[0] + narrow[1]):.3g}"
    return best
