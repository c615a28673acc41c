"""PR2 pulls a cabinet door open with a hook: Jain and Kemp, "Pulling open doors and drawers" (2010), New BSD.

The door angle is the angle of the hook about the circle through its track; the effort is the tangential force times
that radius. No time stamps were kept: 100 Hz is assumed, and nothing depends on time in so slow a pull.
"""

from pathlib import Path

import numpy as np

from .case import Case, Check, named, shared_data, within, write_recording
from .page import Page

XML = """<mujoco model="cabinet">
  <option gravity="0 0 0"/>
  <worldbody><body name="door">
    <joint name="hinge" type="hinge" axis="0 0 1" damping="0.1"/>
    <inertial mass="3" pos="0.15 0 0" diaginertia="0.03 0.03 0.03"/>
  </body></worldbody>
</mujoco>
"""
PAGE = Page(
    title="PR2 opens a cabinet",
    source=(
        'Jain and Kemp, "Pulling open doors and drawers" (ICRA 2010); a log of '
        "[gt-ros-pkg/hrl](https://github.com/gt-ros-pkg/hrl)."
    ),
    licence="New BSD.",
    known=(
        "A robot pulls a door open with a hook, once; the force comes from its joint torques, without time stamps.\n"
        "The pull climbs to some 25 N near 8° and falls: a latch."
    ),
    given="A door of 3 kg without friction as model; one pull, whose last 30 % is held out.",
    missed=(
        "The place of the strongest pull: about the circle through the whole track it is a plateau from 6° to 13°, and "
        "the reference of 8° is the publisher's running estimate of a hinge that had not settled there."
    ),
)


def cases(folder: Path) -> list[Case]:
    """One pull."""
    model = folder / "pr2.xml"
    model.write_text(XML, encoding="utf-8")
    raw = np.load(shared_data() / "pr2_cabinet" / "ikea_cabinet_log_raw.npz")
    x, y = raw["ee"][:, 0].astype(float), raw["ee"][:, 1].astype(float)
    a, b, c = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones(len(x))], 1), x**2 + y**2, rcond=None)[0]
    radius = np.sqrt(c + a**2 + b**2)
    angle = np.unwrap(np.arctan2(y - b, x - a))
    force = -(raw["f"][:, 1] * np.cos(angle) - raw["f"][:, 0] * np.sin(angle))
    columns = {
        "t": np.arange(len(x)) / 100.0,
        "q.hinge": angle - angle[0],
        "tau.hinge": radius * force,
    }
    record = write_recording(
        folder / "pr2_door.csv", columns, {"effort": "measured", "input": "effort", "session": "pull"}
    )
    peak_deg, peak = 8.0, 26.5 * radius
    return [Case("pr2", model, [record], lambda answer: _judge(answer, peak_deg, float(peak)))]


def _judge(a: dict, peak_deg: float, peak: float) -> list[Check]:
    """The strongest pull is what the catch and everything else named beside it ask for where the catch is strongest."""
    values = {e["name"]: {k: v["value"] for k, v in e["parameters"].items()} for e in a["effects"]}
    where = force = None
    if "detent" in values:
        catch = values["detent"]
        where = catch["position"] + catch["width"]
        force = catch["peak"] + values.get("coulomb_friction", {}).get("level", 0.0)
        if "spring_return" in values:
            force += values["spring_return"]["stiffness"] * (where - values["spring_return"]["rest"])
    degrees = None if where is None else float(np.rad2deg(where))
    return [
        named(a, "latch", "detent"),
        within(f"strongest pull at {peak_deg:.0f}° within 2°", degrees, peak_deg - 2, peak_deg + 2, "°"),
        within(f"{peak:.2f} N·m within 15 %", force, 0.85 * peak, 1.15 * peak, "N·m"),
    ]
