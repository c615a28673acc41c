"""Which stage a trial's miss is owed to, told from the sealed truth beside what the host foresaw and saw.

δ of the last planned manipulation, target minus end, is the sum of three terms in the host's joint coordinate u, which
is counted so that the target stands where the sealed truth has it::

    δ = (target − foreseen)                             plan: the end foreseen was off already
      + (seen − stood)                                  state: the part stood elsewhere than the look before it said
      + (foreseen − seen) − (left − stood)              motion: the part was left elsewhere than foreseen

Beside them stand two that hide it from the host, of the sign of δ where they do::

    look  = seen at the end − left                      what the last look misjudged
    joint = what the joint as told makes of the way from the first plan's start to the end, less that way; of the point
            that the pushes touched, so of what a look without noise would read
"""

from __future__ import annotations

from typing import Any

import numpy as np

from s2r_sim.geometry import rotation_from_vector
from s2r_sim.score import sense, true_joint
from s2r_sim.world import WorldSpec

Row = dict[str, Any]
STAGES = ("perceive", "plan", "execute", "measure", "processes")
MISS = 0.10  # of what was asked for
HALF = 0.5  # of the miss: what hides this much of it explains that it stayed
_ENDED_BY = {  # what begins with none of these is between the host's stages, or a process of the trial
    "home": "execute",
    "view": "perceive",
    "first push": "perceive",
    "estimate joint": "perceive",
    "build model": "perceive",
    "tell joint": "perceive",
    "physics": "perceive",
    "lost motion": "perceive",
    "plan": "plan",
    "manipulation": "execute",
    "measure": "measure",
}
_BY_TERM = {"plan": "plan", "state": "perceive", "motion": "execute"}


def terms_of_error(
    world: WorldSpec, run: Row, begun: list[float], s_end: float, change: float, s_touched: float
) -> Row:
    """The terms of the last manipulation's δ and what hides it [m or rad], as the module says.

    ``corrections_left`` tells whether the host might have gone on, ``no_correction`` whether it looked for a plan to do
    so and found none.

    Args:
        world: The sealed one.
        run: ``run.json``.
        begun: True joint value at the start of each manipulation [m or rad], at least one.
        s_end: True joint value at the end.
        change: What was asked for, counted as the host's joint.
        s_touched: True joint value when the push began whose contact ``run.json`` tells.
    """
    last, way = [entry for entry in run["attempts"] if entry["tick_start"] is not None][-1], sense(world, run)
    target_true = begun[0] + way * change

    def counted(s: float) -> float:
        return last["s_target"] - way * (target_true - s)

    stood, left = counted(begun[-1]), counted(s_end)
    return {
        "plan": last["s_target"] - last["s_planned"],
        "state": last["s_initial"] - stood,
        "motion": last["s_planned"] - last["s_initial"] - (left - stood),
        "look": last["s_final"] - left,
        "joint": _misread(world, run, s_touched, begun[0], s_end) if run["push"] else 0.0,
        "corrections_left": len(begun) < int(run["inputs"]["settings"]["attempts"]),
        "no_correction": run["stages"][-1]["failed"] and run["stages"][-1]["name"].startswith("plan"),
    }


def _misread(world: WorldSpec, run: Row, s_touched: float, s_from: float, s_to: float) -> float:
    """What the joint as told makes of a true motion of the touched point, less that motion [m or rad].

    The point is where ``run.json`` says while the part stands at ``s_touched``.
    """
    origin, direction = true_joint(world)
    said, along = np.array(run["joint"]["axis_origin_m"]), np.array(run["joint"]["axis_direction"])
    moved = sense(world, run) * (s_to - s_from)
    touched = np.array(run["push"]["contact_m"])
    if run["joint"]["joint_type"] == "prismatic":
        return float((s_to - s_from) * (direction @ along)) - moved
    before, after = (
        origin + rotation_from_vector((direction * (s - s_touched)).tolist()) @ (touched - origin)
        for s in (s_from, s_to)
    )
    a, b = (p - said - ((p - said) @ along) * along for p in (before, after))
    read = float(np.arctan2(np.cross(a, b) @ along, a @ b))
    return float(np.remainder(read - moved + np.pi, 2.0 * np.pi) - np.pi)


def missed(row: Row) -> bool:
    """Whether a trial ended a tenth or more of what was asked for off, or without a manipulation."""
    return row["delta"] is None or not abs(row["delta"]) < MISS * abs(row["change"])


def stage_of_miss(row: Row) -> str | None:
    """One of ``STAGES``; None if the trial is no miss, or its row was written before terms were kept.

    The first of these that holds:

    1. A stage ended the trial: that one.
    2. *perceive*: the joint as told hides at least half of the miss.
    3. *measure*: the last look hid at least half of the miss, and a correction was left.
    4. *plan*: a plan for a correction was looked for and not found.
    5. The largest share of δ: *plan*, *perceive* (state) or *execute* (motion).

    Terms count with their sign: one that made the miss smaller, or look larger, does not explain it.
    """
    if not missed(row):
        return None
    if row["stage"] is not None:
        named = [stage for name, stage in _ENDED_BY.items() if row["stage"].startswith(name)]
        return named[0] if named else "processes"
    if (terms := row.get("terms")) is None:
        return None
    shares = {
        name: terms[name] / sum(terms[part] for part in _BY_TERM) for name in (*_BY_TERM, "look", "joint")
    }
    if shares["joint"] >= HALF:
        return "perceive"
    if shares["look"] >= HALF and terms["corrections_left"]:
        return "measure"
    if terms["no_correction"]:
        return "plan"
    return _BY_TERM[max(_BY_TERM, key=lambda name: shares[name])]
