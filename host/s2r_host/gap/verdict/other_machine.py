"""Parameters that moved so far that the recording must be of another machine."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.motion.model import FEW_JOINTS
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decision import LEFTOVER_LIMIT, Decision, doubt, leftover

OTHER_MACHINE = 0.4
FAR_RIGID, FAR_FRICTION, FAR_KINDS, FAR_MASS, FAR_SCALE = 0.08, 0.3, 4, 2.0, 1.5

# Set free, the numbers of a rigid body explain another machine's recording to the floor: gap over effort (rms) from
# which that is asked, usual errors by which the numbers may be off, relative change that is far.
FREED_SHARE, FREED, FREED_MOVED = 0.5, 30.0, 0.3
CLEAR = 2.0  # deviations by which a friction has to be far; a weak one is hardly seen
WEIGHT, INERTIA, FRICTION = ("mass", "com"), ("inertia", "armature"), ("damping", "frictionloss")


def other_machine(problem: Problem, decision: Decision) -> str | None:
    """A sentence when the parameters found belong to another machine than the model's."""
    m = problem.ctx.model.model
    few = len(problem.ctx.model.joints) <= FEW_JOINTS  # in an arm, centres trade off with masses further out
    for body in problem.ctx.model.jointed_bodies():
        name = problem.ctx.model.body_name(body)
        shifts = [
            p["to"] - p["from"]
            for p in decision.parameters_off if p["name"].startswith("com_") and p.get("body") == name
        ]  # fmt: skip
        arm, shift = float(np.linalg.norm(m.body_ipos[body])), float(np.linalg.norm(shifts))
        if few and shift > OTHER_MACHINE * arm > 0:
            return (
                f"the centre of mass of '{name}' would have to move by {shift:.3g} m from {arm:.3g} m off the joint: "
                "is this recording of another machine?"
            )
        for p in decision.parameters_off:
            ratio = (
                p["to"] / p["from"] if p["name"] == "mass" and p.get("body") == name and p["from"] else 1.0
            )
            if few and decision.effects and not 1.0 / FAR_MASS < ratio < FAR_MASS:
                return (
                    f"the mass of '{name}' would have to be {ratio:.2g} times what the model says, and more beside: "
                    "is this recording of another machine?"
                )
    moved: dict[str, float] = {}
    for p in decision.parameters_off:  # of a kind that several bodies have, the one that moved most counts
        kind = p["name"].split("_")[0]
        moved[kind] = max(moved.get(kind, 0.0), _moved(p))
    far = [
        n for n, x in moved.items() if x > (FAR_FRICTION if n in ("damping", "frictionloss") else FAR_RIGID)
    ]
    if few and len(far) >= FAR_KINDS - (len(decision.effects) > 1):
        return f"{', '.join(far)} would all have to change by much: is this recording of another machine?"
    scales = [e.parameters["scale"]["value"] for e in decision.effects if e.name == "effort_scale"]
    scales += [p["to"] for p in decision.parameters_off if p["name"] == "effort_scale"]
    beside = any(e.name != "effort_scale" for e in decision.effects)
    for scale in scales if beside else []:
        if not 1.0 / FAR_SCALE < scale < FAR_SCALE:
            return f"efforts {scale:.2g} times the recorded ones and more beside: is this recording of another machine?"
    return None


def all_numbers_elsewhere(problem: Problem, search: Search) -> str | None:
    """A sentence when a rigid body explains everything, but with weight, inertia and friction of another machine.

    No effect of the catalogue changes all three; springs and scales that imitate them leave more over.
    """
    if len(problem.ctx.model.joints) > FEW_JOINTS:
        return None
    shares = []
    for j in problem.joints:
        blocks = [b for b in problem.blocks if b.joint == j]
        gap = np.concatenate([problem.raw[b.rows] for b in blocks])
        effort = np.concatenate([b.session.u[b.picks, j] for b in blocks])
        shares.append(float(np.sqrt(np.mean(gap**2) / max(float(np.mean(effort**2)), 1e-30))))
    if max(shares, default=0.0) < FREED_SHARE:
        return None
    before = search.looseness
    usual = search.finish([], [], [])
    search.looseness = FREED
    freed = search.finish([], [], [])
    search.looseness = before
    enough = LEFTOVER_LIMIT * doubt(problem)
    if not leftover(problem, freed.unexplained) < enough < leftover(problem, usual.unexplained):
        return None
    moved = dict.fromkeys((WEIGHT, INERTIA, FRICTION), 0.0)
    for p, x, deviation in zip(problem.base, freed.base, freed.base_deviation, strict=True):
        for kinds in moved:
            if p.name.startswith(kinds):
                sure = abs(float(x)) - (CLEAR * float(deviation) if kinds == FRICTION else 0.0)
                moved[kinds] = max(moved[kinds], sure)
    if min(moved.values()) < FREED_MOVED:
        return None
    return (
        "a rigid joint explains all of it, but with weight, inertia and friction all far from the model's: is this "
        "recording of another machine?"
    )


def _moved(p: dict) -> float:
    """Relative change of a parameter."""
    return abs(p["to"] - p["from"]) / abs(p["from"]) if p["from"] else 0.0
